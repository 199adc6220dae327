# SPDX-License-Identifier: Apache-2.0
"""Stability of a flexible joint in discrete time, at the period of the torque loop.

The loop (:mod:`impact_rs_sim.drive`) reduces the motor inertia from B_rho to B_theta. With the deflection
s = theta - q, links of mass matrix M and the period h, one step of motors and links, both semi-implicit Euler, is

    ds+ = ds - h W (K s + D ds),   s+ = s + h ds+,   W = B_theta^-1 + M^-1

Rigid motion and gravity have no influence on s. For a single joint, W = 1 / m, the two eigenvalues have the product
1 - h D / m and the sum 2 - h D / m - h^2 K / m; by Jury's criterion both lie inside the unit circle exactly if

    D > 0   and   h^2 K + 2 h D < 4 m.

The smallest link inertia at joint i is its effective inertia with all other joints free, 1 / (M^-1)_ii.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class JointStability:
    """Stability margins of one joint at its smallest link inertia.

    Attributes:
        link_inertia: Smallest inertia of the link [kg m^2].
        spectral_radius: Largest magnitude of the two eigenvalues; below 1: stable.
        damping_below: Largest stable damping [N m s/rad]; <= 0: unstable at any damping.
        stiffness_below: Largest stable stiffness [N m/rad]; <= 0: unstable at any stiffness.
        period_below: Largest stable period [s].
    """

    link_inertia: float
    spectral_radius: float
    damping_below: float
    stiffness_below: float
    period_below: float


def joint_stability(
    link_inertia: float, motor_inertia: float, stiffness: float, damping: float, period: float
) -> JointStability:
    """Stability of one joint by itself.

    Args:
        link_inertia: Inertia of the link about the joint [kg m^2].
        motor_inertia: B_theta [kg m^2].
        stiffness: K [N m/rad].
        damping: D [N m s/rad].
        period: h [s].
    """
    inertia = 1.0 / (1.0 / link_inertia + 1.0 / motor_inertia)
    radius = spectral_radius(np.array([[1.0 / inertia]]), np.array([stiffness]), np.array([damping]), period)
    return JointStability(
        link_inertia=link_inertia,
        spectral_radius=radius,
        damping_below=(4.0 * inertia - period**2 * stiffness) / (2.0 * period),
        stiffness_below=(4.0 * inertia - 2.0 * period * damping) / period**2,
        period_below=(np.sqrt(damping**2 + 4.0 * inertia * stiffness) - damping) / stiffness,
    )


def spectral_radius(inverse_inertia: Array, stiffness: Array, damping: Array, period: float) -> float:
    """Largest magnitude of the eigenvalues of one step of all joints together.

    Args:
        inverse_inertia: W, ``(n, n)`` [1/(kg m^2)].
        stiffness: K, ``(n,)`` [N m/rad].
        damping: D, ``(n,)`` [N m s/rad].
        period: h [s].
    """
    identity = np.eye(len(stiffness))
    from_stretch = -period * inverse_inertia * stiffness  # ds+ of s: a column per joint
    from_rate = identity - period * inverse_inertia * damping
    step = np.block([[identity + period * from_stretch, period * from_rate], [from_stretch, from_rate]])
    return float(np.abs(np.linalg.eigvals(step)).max())
