# SPDX-License-Identifier: Apache-2.0
"""Newton's method on the contact laws; minimum-norm impulses where the solution is not unique.

With s_i = (J_c u^+)_i + e (J_n u^-)_i n_i + (rho / m) L_i, the mass m of the object, the impulse L_n >= a of every
contact point, r_i = 1 / g_i and the projection P onto the disk of radius mu L_n, the laws of
:mod:`impact_rs_sim.impact_map.problem` are

    F_n = L_n - max(a, L_n - r s_n) = 0,        F_t = L_t - P(L_t - r s_t) = 0

(Alart and Curnier 1991), and u^+ = u^- + H^-1 J_c^T L. a = 0 but in the second phase of Poisson's law.

**Uniqueness.** Four corners of a face share a load in many ways. Where they slide, each share has its own friction, and
u^+ is not unique. A compliance rho > 0 makes it unique: every contact point yields by rho / m per impulse. As rho goes
to 0 the impulses tend to those of minimum norm among all with the same velocities. With ``COMPLIANCE`` a point yields
by 1e-8 of the velocity that its impulse gives the object. The solution is then :func:`hardened <harden>`: rho L / m is
replaced by rho (L - L') / m with the previous solution L' (proximal point method, Rockafellar 1976). This removes the
effect of the compliance, keeps the choice, and the result obeys the rigid laws.

The laws, their derivatives and the iterations are compiled (``src/laws.cpp``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.impact_map.residual import ContactTerms
from impact_rs_sim.robot import Array

COMPLIANCE = 1e-8  # rho [-]; ten times less, and rounding errors begin to decide the shares of the load


@dataclass(frozen=True)
class Linearisation:
    """The laws at one L and their derivatives: dF_i = by_impulse dL_i + by_velocity ds_i + by_friction dmu_i.

    Attributes:
        defect: F, ``(m, 3)`` [N s].
        by_impulse: ``(m, 3, 3)`` [-].
        by_velocity: ``(m, 3, 3)`` [kg].
        by_friction: ``(m, 3)`` [N s].
        state: Per point ``open``, ``stick`` or ``slide``, ``(m,)``.
        margin: Distance to another contact state, as a velocity, ``(m,)`` [m/s].
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
    return Linearisation(*terms.kernel.linearise(impulses, velocity, least))


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
    return terms.kernel.settle(impulses, least, compliance)


def harden(terms: ContactTerms, impulses: Array, least: Array | float = 0.0, compliance: float = COMPLIANCE) -> Array:
    """The answer of :func:`settle`, ``(m, 3)`` [N s], with the velocity taken out that the compliance let points yield.

    Where that does not converge the answer stays as it is. Arguments as there.
    """
    return terms.kernel.harden(impulses, least, compliance)
