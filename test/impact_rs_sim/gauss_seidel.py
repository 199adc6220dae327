# SPDX-License-Identifier: Apache-2.0
"""The laws of an impact by brute force: projected Gauss-Seidel, with nothing taken from the solvers of the package.

Point by point: set the normal impulse so that the point just closes, or to 0; pull the tangential one towards sticking
and put it back on its disk; until nothing moves any more. Many starts are solved side by side.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.impact_map.laws import ContactTerms


def gauss_seidel(
    terms: ContactTerms, starts: np.ndarray, sweeps: int = 20000, tolerance: float = 1e-12
) -> tuple[np.ndarray, np.ndarray]:
    """Solve from many starts.

    Args:
        terms: The problem at its m contact points.
        starts: Impulses to start from, ``(s, m, 3)`` [N s].
        sweeps: Over all points, at most.
        tolerance: Largest change of a velocity in a sweep that ends it [m/s].

    Returns:
        Impulses ``(s, m, 3)`` [N s], and the last change of a velocity by start ``(s,)`` [m/s].
    """
    count = len(terms.contacts)
    jacobian = terms.jacobian.reshape(count, 3, -1)
    frames = []
    for normal in terms.normals:
        tangent = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.7 else [0.0, 1.0, 0.0])
        tangent /= np.linalg.norm(tangent)
        frames.append(np.array([tangent, np.cross(normal, tangent), normal]))
    rows = np.array([frame @ block for frame, block in zip(frames, jacobian, strict=True)])
    response = np.array([terms.response[:, 3 * i : 3 * i + 3] @ frames[i].T for i in range(count)])
    impulses = np.einsum("mij,smj->smi", np.array(frames), starts)
    velocity = terms.before + np.einsum("mvi,smi->sv", response, impulses)
    own = np.einsum("miv,mvj->mij", rows, response)
    yielding = [float(np.max(np.linalg.eigvalsh(block[:2, :2]))) for block in own]
    changes = np.full(len(starts), np.inf)
    for _ in range(sweeps):
        before = velocity.copy()
        for i in range(count):
            pressing = impulses[:, i, 2] - (velocity @ rows[i, 2] + terms.rebound[i]) / own[i, 2, 2]
            pressing = np.maximum(pressing, 0.0)
            velocity += np.outer(pressing - impulses[:, i, 2], response[i, :, 2])
            impulses[:, i, 2] = pressing
            held = impulses[:, i, :2] - velocity @ rows[i, :2].T / yielding[i]
            length = np.maximum(np.linalg.norm(held, axis=1), 1e-300)
            held *= np.minimum(1.0, terms.friction[i] * pressing / length)[:, None]
            velocity += (held - impulses[:, i, :2]) @ response[i, :, :2].T
            impulses[:, i, :2] = held
        changes = np.max(np.abs(velocity - before), axis=1)
        if np.max(changes) < tolerance:
            break
    return np.einsum("mji,smj->smi", np.array(frames), impulses), changes
