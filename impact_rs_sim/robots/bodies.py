# SPDX-License-Identifier: Apache-2.0
"""Physically consistent inertial parameters: pseudo-inertia and its positive definiteness.

A mass density that is nowhere negative gives a body of mass m, centre c and inertia I about c the pseudo-inertia
(Wensing, Kim and Slotine 2018, IEEE RA-L 3(1), eq. 8)

    P = [[S + m c c^T, m c], [m c^T, m]],    S = tr(I)/2 1 - I    (second moments of mass about c)

which is positive definite. By the Schur complement this holds exactly if m > 0 and S is positive definite, for any c.
Thin rods and point masses, whose S is singular, are limits of such bodies and are allowed. (Fits with the log-Cholesky
factor of P as parameters stay inside this set; effects do not, see :mod:`impact_rs_sim.effects.changed_bodies`.)
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array

IDENTITY = np.eye(3)
EIGENVALUE_ROUNDING = 1e-9  # share of tr(S) by which an eigenvalue may be below 0, for rounding of sums [-]
SURE_MINOR_SHARE = 1e-6  # of a power of tr(S); larger minors are positive beyond their rounding of 1e-15 [-]


def second_moments(inertia: Array) -> Array:
    """Second moments of mass S = tr(I)/2 1 - I about the centre of mass, ``(3, 3)`` [kg m^2]."""
    return np.asarray(0.5 * inertia.trace() * IDENTITY - inertia)


def inertia_of(moments: Array) -> Array:
    """Inertia I = tr(S) 1 - S of second moments of mass S, ``(3, 3)`` [kg m^2]."""
    return np.asarray(moments.trace() * IDENTITY - moments)


def is_physically_consistent(mass: float, inertia: Array) -> bool:
    """Whether mass [kg] and inertia about the centre of mass ``(3, 3)`` [kg m^2] are physically consistent."""
    moments = second_moments(inertia)
    if mass > 0.0 and _surely_positive(moments):
        return True
    return mass > 0.0 and bool(np.linalg.eigvalsh(moments)[0] >= -EIGENVALUE_ROUNDING * abs(float(np.trace(moments))))


def _surely_positive(moments: Array) -> bool:
    """Whether a symmetric matrix ``(3, 3)`` is positive definite beyond rounding, by its minors (Sylvester)."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = moments.tolist()
    threshold, second = SURE_MINOR_SHARE * (xx + yy + zz), xx * yy - xy * xy
    third = zz * second - yz * (xx * yz - xy * xz) + xz * (xy * yz - yy * xz)
    return xx > threshold > 0.0 and second > threshold * (xx + yy + zz) and third > threshold * (xx + yy + zz) ** 2


def ellipsoid_contains(mass: float, com: Array, inertia: Array, point: Array) -> bool:
    """Whether a point lies in the homogeneous ellipsoid with these inertial parameters.

    With semi-axes a_i along its principal axes it has the second moments m a_i^2 / 5, so d = point - com lies in it if
    d^T S^-1 d <= 5 / m.

    Args:
        mass: m [kg].
        com: Centre of mass, ``(3,)`` [m].
        inertia: About the centre of mass, ``(3, 3)`` [kg m^2].
        point: In the same axes, ``(3,)`` [m].
    """
    moments, axes = np.linalg.eigh(second_moments(inertia))
    along = axes.T @ (point - com)
    semi = np.sqrt(5.0 * np.maximum(moments, 0.0) / mass)
    within = np.abs(along) <= semi  # checked separately, because an axis without extent has no quotient below
    return bool(np.all(within)) and float(np.sum(np.square(along[semi > 0.0] / semi[semi > 0.0]))) <= 1.0
