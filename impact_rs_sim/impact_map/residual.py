"""How far an answer is from the laws, judged from the answer alone and by the same code for every engine.

With w = J_n u^+ + e J_n u^- and, per point, the inverse mass g = tr(G_ii) / 3 that turns impulses into velocities,

    penetration      max(0, -w)
    complementarity  max(w, 0) L_n / max(L_n),  g max(0, -L_n)
    friction         g |L_t - P(L_t - J_t u^+ / g)|,   P: projection onto the disk of radius mu max(L_n, 0)
    momentum         |H^-1 (H (u^+ - u^-) - J_c^T L)|

The friction term is the natural map of Coulomb's law: zero exactly when the point sticks inside the cone or slides
with the impulse on its edge, against the sliding velocity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.problem import Residual
from impact_rs_sim.impact_map.system import System
from impact_rs_sim.robot import Array


def evaluate_residual(
    system: System, contacts: Sequence[ContactPoint], impulses: Array, velocity: Array, restitution: float
) -> Residual:
    """Residuals of an answer.

    Args:
        system: Terms of the problem.
        contacts: The m contact points of the answer.
        impulses: L on the object in axes of A, ``(m, 3)`` [N s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        restitution: Newton restitution e [-].
    """
    jump = velocity - system.velocity
    if not contacts:
        return Residual(0.0, 0.0, 0.0, float(np.max(np.abs(jump))))
    jacobian = system.jacobian(contacts)
    response = np.linalg.solve(system.inertia, jacobian.T)
    momentum = np.max(np.abs(jump - response @ impulses.ravel()))
    inverse_mass = np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1)
    normals = np.array([contact.normal for contact in contacts])
    friction = np.array([contact.friction for contact in contacts])
    after = (jacobian @ velocity).reshape(-1, 3)
    before = (jacobian @ system.velocity).reshape(-1, 3)
    separation = np.sum(normals * (after + restitution * before), axis=1)
    pressing = np.sum(normals * impulses, axis=1)
    tangential = impulses - pressing[:, None] * normals
    sliding = after - np.sum(normals * after, axis=1)[:, None] * normals
    largest = max(float(np.max(pressing)), 1e-300)
    carried = np.maximum(separation, 0.0) * np.maximum(pressing, 0.0) / largest
    wanted = tangential - sliding / inverse_mass[:, None]
    length = np.linalg.norm(wanted, axis=1)
    radius = friction * np.maximum(pressing, 0.0)
    wanted = wanted * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None]
    cone = inverse_mass * np.linalg.norm(tangential - wanted, axis=1)
    return Residual(
        penetration_velocity=float(np.max(np.maximum(-separation, 0.0))),
        complementarity=float(max(np.max(carried), np.max(inverse_mass * np.maximum(-pressing, 0.0)))),
        friction_cone=float(np.max(cone)),
        momentum=float(momentum),
    )
