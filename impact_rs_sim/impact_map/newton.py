# SPDX-License-Identifier: Apache-2.0
"""Newton's method on the laws of an impact, which ends at the answer that is told where there are several.

With s_i = (J_c u^+)_i + e (J_n u^-)_i n_i + (rho / m) L_i, the mass m of the object, the impulse L_n >= a of every
contact point, r_i = 1 / g_i and the projection P onto the disk of radius mu L_n, the laws of
:mod:`impact_rs_sim.impact_map.problem` are

    F_n = L_n - max(a, L_n - r s_n) = 0,        F_t = L_t - P(L_t - r s_t) = 0

(Alart and Curnier 1991), and u^+ = u^- + H^-1 J_c^T L. a = 0 but in the second phase of Poisson's law.

**Which answer.** Four corners of a face carry a load in many ways, and where they slide, each way has a friction of
its own: u^+ is not unique. rho > 0 makes it so: every contact point yields by the same rho / m per impulse. As rho goes
to 0 this singles out the impulses of least norm among those that hold the same velocities. At the ``COMPLIANCE`` taken
here a point gives way by a hundred-millionth of the velocity that its impulse gives the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.impact_map.residual import ContactTerms
from impact_rs_sim.robot import Array

COMPLIANCE = 1e-8  # rho [-]; ten times less and rounding begins to decide who carries a load
CONVERGED = 1e-15  # m/s, |g F| that ends the iteration
ACCEPTED = 1e-10  # m/s, |g F| that is an answer where rounding ends it before
ITERATIONS = 25  # most problems take five to ten
CONTINUATION = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # rho, where the iteration does not get there at once


@dataclass(frozen=True)
class Linearisation:
    """The laws at one L and their derivatives: dF_i = by_impulse dL_i + by_velocity ds_i + by_friction dmu_i.

    Attributes:
        defect: F, ``(m, 3)`` [N s].
        by_impulse: ``(m, 3, 3)`` [-].
        by_velocity: ``(m, 3, 3)`` [kg].
        by_friction: ``(m, 3)`` [N s].
        state: Per point ``open``, ``stick`` or ``slide``, ``(m,)``.
        margin: How far the point is from another state, as a velocity, ``(m,)`` [m/s].
    """

    defect: Array
    by_impulse: Array
    by_velocity: Array
    by_friction: Array
    state: tuple[str, ...]
    margin: Array


def delassus(terms: ContactTerms, compliance: float = COMPLIANCE) -> Array:
    """J_c H^-1 J_c^T + rho / m, ``(3 m, 3 m)`` [1/kg]."""
    operator = terms.jacobian @ terms.response
    if not len(operator):
        return operator
    return np.asarray((operator + operator.T) / 2.0 + compliance * terms.mobility * np.eye(len(operator)))


def linearise(terms: ContactTerms, impulses: Array, velocity: Array, least: Array | float = 0.0) -> Linearisation:
    """The laws at impulses ``(m, 3)`` [N s] and velocities s ``(m, 3)`` [m/s], with L_n >= ``least`` [N s]."""
    count, normals = len(impulses), terms.normals
    ratio = 1.0 / terms.inverse_mass
    along = normals[:, :, None] * normals[:, None, :]
    across = np.eye(3) - along
    pressing, tangential = terms.split(impulses)
    opening, sliding = terms.split(velocity)
    wanted_normal = pressing - ratio * opening
    closed = wanted_normal > least
    wanted = tangential - ratio[:, None] * sliding
    length = np.linalg.norm(wanted, axis=1)
    carried = np.maximum(pressing, 0.0)
    radius = terms.friction * carried
    sticks = length <= radius
    direction = wanted / np.maximum(length, 1e-300)[:, None]
    held = np.where(closed, wanted_normal, least)
    disk = np.where(sticks[:, None], wanted, radius[:, None] * direction)
    turning = (radius / np.maximum(length, 1e-300))[:, None, None] * (
        across - direction[:, :, None] * direction[:, None, :]
    )
    # The normal law, then the tangential one.
    by_impulse = np.where(closed[:, None, None], 0.0, along)
    by_velocity = np.where(closed[:, None, None], ratio[:, None, None] * along, 0.0)
    grip = (terms.friction * (pressing > 0.0))[:, None, None] * direction[:, :, None] * normals[:, None, :]
    by_impulse = by_impulse + np.where(sticks[:, None, None], 0.0, across - grip - turning)
    by_velocity = by_velocity + ratio[:, None, None] * np.where(sticks[:, None, None], across, turning)
    by_friction = np.where(sticks[:, None], 0.0, -carried[:, None] * direction)
    touching = closed | (carried > 0.0)
    state = tuple("open" if not touching[i] else "stick" if sticks[i] else "slide" for i in range(count))
    gap_normal, gap_friction = np.abs(wanted_normal - least), np.abs(length - radius)
    margin = terms.inverse_mass * np.where(touching, np.minimum(gap_normal, gap_friction), gap_normal)
    return Linearisation(
        defect=(pressing - held)[:, None] * normals + tangential - disk,
        by_impulse=by_impulse,
        by_velocity=by_velocity,
        by_friction=by_friction,
        state=state,
        margin=margin,
    )


def yielding_velocity(terms: ContactTerms, operator: Array, impulses: Array) -> Array:
    """s at impulses ``(m, 3)``, ``(m, 3)`` [m/s]; ``operator`` is that of :func:`delassus`."""
    moved = (terms.jacobian @ terms.before + operator @ impulses.ravel()).reshape(-1, 3)
    return np.asarray(moved + terms.rebound[:, None] * terms.normals)


def slope(linear: Linearisation, operator: Array) -> Array:
    """dF / dL with u^+ following L, ``(3 m, 3 m)``."""
    count = len(linear.defect)
    matrix = np.einsum("mij,mjk->mik", linear.by_velocity, operator.reshape(count, 3, 3 * count))
    matrix = matrix.reshape(3 * count, 3 * count)
    for index, block in enumerate(linear.by_impulse):
        where = slice(3 * index, 3 * index + 3)
        matrix[where, where] += block
    return np.asarray(matrix)


def states(terms: ContactTerms, impulses: Array, compliance: float = COMPLIANCE) -> tuple[str, ...]:
    """``open``, ``stick`` or ``slide`` of every contact point of an answer."""
    if not len(impulses):
        return ()
    return linearise(terms, impulses, yielding_velocity(terms, delassus(terms, compliance), impulses)).state


def settle(
    terms: ContactTerms, impulses: Array, least: Array | float = 0.0, compliance: float = COMPLIANCE
) -> tuple[Array, bool]:
    """The answer nearest to a first guess.

    Args:
        terms: The problem at its m contact points.
        impulses: First guess on the object, ``(m, 3)`` [N s].
        least: Bound a of the normal impulses, ``(m,)`` [N s].
        compliance: rho [-].

    Returns:
        Impulses ``(m, 3)`` [N s], and whether the iteration converged; else they are the first guess.
    """
    for chain in ((compliance,), CONTINUATION):
        found, converged = impulses, True
        for step in (*(value for value in chain if value > compliance), compliance):
            found, converged = _full_steps(terms, found, least, step)
            if not converged:
                break
        if converged:
            return found, True
    return impulses, False


def _full_steps(terms: ContactTerms, impulses: Array, least: Array | float, compliance: float) -> tuple[Array, bool]:
    """Newton's steps without a line search: at the kinks between states it would only stall."""
    operator = delassus(terms, compliance)
    weight = terms.inverse_mass[:, None]
    best, lowest = impulses, np.inf
    for _ in range(ITERATIONS):
        linear = linearise(terms, impulses, yielding_velocity(terms, operator, impulses), least)
        error = float(np.linalg.norm(weight * linear.defect))
        stalled = error >= lowest
        if not stalled:
            best, lowest = impulses, error
        if lowest <= CONVERGED or (lowest <= ACCEPTED and stalled):
            break
        try:
            impulses = impulses + np.linalg.solve(slope(linear, operator), -linear.defect.ravel()).reshape(-1, 3)
        except np.linalg.LinAlgError:
            break
    return best, lowest <= ACCEPTED
