# SPDX-License-Identifier: Apache-2.0
"""Impact detection from measured signals: a link-side momentum observer and a test for a sudden force.

    p = M(q) dq,   dp/dt = tau_J + C^T dq - g + tau_ext
    r = K_o (p - integral(tau_J + C^T dq - g + r) dt),     r -> tau_ext with time constant 1 / K_o

(De Luca and Mattone; see Haddadin et al. 2017, the survey the paper cites.) The joint torque is measured on the link
side of the motor, so motor friction and the torque loop do not enter. The dynamically consistent inverse of J^T maps
the residual to a wrench at the end effector,

    w = (J M^-1 J^T)^-1 J M^-1 r,      F = -n . w_lin - F_slow,      dF_slow/dt = F / T while F is below the threshold

with n the direction of the ante-impact velocity. A slow force, as from a wrong payload, is thus removed by a high-pass
filter with the time constant T; an impact is detected when F exceeds the threshold. The integral and F_slow advance by
the control period (explicit Euler) in ``src/control.cpp``; over ticks without a measurement p is interpolated.

Near a singular pose this inverse amplifies noise of the residual to hundreds of newtons. The rows of J are therefore
orthogonalised in order, the force along n first, then the forces across it, then the moments, and a linearly dependent
row is dropped (:func:`separable_wrench`). A contact force f against the approach, r = -J_lin^T n f, is then f in every
pose in which E can move along n. Where nothing else can be separated, F is the scalar projection with the effective
mass along n, (n^T J M^-1 r) / (n^T J M^-1 J^T n). Alone, that projection would take a force across n for an impact: 40
N along x for 28 N in the pose of ``push``. Where E cannot move along n (n^T J_lin = 0), bearings carry the force, no
joint feels it, and F is 0; nor can the arm approach along n there.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim import _kernel
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RigidTerms, RobotModel
from impact_rs_sim.scenarios.trial_settings import Detection

BASELINE_TIME_S = 0.05  # time constant of the slow part of the residual


def separable_wrench(jacobians: Array, masses: Array, torques: Array) -> Array:
    """Wrench at E from external joint torques, (J M^-1 J^T)^-1 J M^-1 tau, also in and near singular poses.

    Rows of J are orthogonalised in order (Gram-Schmidt in the metric M^-1). A row that is linearly dependent on the
    rows before it up to 2 % (``SEPARABLE``), or without leverage (``MOVABLE``, both in ``src/control.hpp``), is not
    separable: its component is 0, and the other components explain the torques.

    Args:
        jacobians: J of frame E, ``(k, 6, n)``: three orthonormal linear rows, then three of moments.
        masses: M, ``(k, n, n)`` [kg m^2].
        torques: tau, ``(k, n)`` [N m].

    Returns:
        Along the rows of J, ``(k, 6)`` [N, N m].
    """
    right_sides = np.concatenate((np.swapaxes(jacobians, 1, 2), torques[..., None]), axis=2)
    solutions = jacobians @ np.linalg.solve(masses, right_sides)
    mobility, wrench = solutions[:, :, :6], solutions[:, :, 6:]
    diagonal, remaining = np.einsum("kii->ki", mobility), mobility.copy()
    separable = diagonal > _kernel.MOVABLE * diagonal[:, :3].sum(axis=1, keepdims=True)
    for row in range(6):
        separable[:, row] &= remaining[:, row, row] > _kernel.SEPARABLE * diagonal[:, row]
        pivot = np.where(separable[:, row], remaining[:, row, row], np.inf)
        remaining = remaining - remaining[:, :, row, None] * remaining[:, None, row] / pivot[:, None, None]
    both_separable = separable[:, :, None] & separable[:, None]
    return np.asarray(
        np.linalg.solve(np.where(both_separable, mobility, np.eye(6)), np.where(separable[..., None], wrench, 0.0))[
            ..., 0
        ]
    )


class ImpactDetector:
    """Detects impacts of one arm.

    Args:
        model: Rigid model of the arm as the controller believes it.
        settings: Observer gain and threshold.
        direction: Direction of the ante-impact velocity, unit vector in A, ``(3,)``.
        period: Control period [s].

    Attributes:
        threshold: Threshold of the sudden force [N].
    """

    def __init__(self, model: RobotModel, settings: Detection, direction: Array, period: float) -> None:
        self._model = model
        self.threshold = settings.threshold
        self._observer = _kernel.Observer(
            model.joint_count,
            settings.observer_gain,
            period,
            settings.threshold,
            period / BASELINE_TIME_S,
            direction,
        )

    @property
    def wrench(self) -> Array:
        """External wrench on E, in E[A], ``(6,)`` [N, N m], as :func:`separable_wrench` estimates it."""
        return self._observer.wrench

    @property
    def force(self) -> float:
        """Sudden part of the force against ``direction`` [N]."""
        return self._observer.force

    def update(self, q: Array, dq: Array, torque: Array, terms: RigidTerms, steps: int = 1) -> bool:
        """Take one measurement; True when the sudden force is above the threshold.

        Args:
            q: Measured joint positions, ``(n,)`` [rad].
            dq: Measured joint velocities, ``(n,)`` [rad/s].
            torque: Measured joint torques tau_J, ``(n,)`` [N m].
            terms: Rigid-body terms at ``q``, ``dq``.
            steps: Control periods since the last measurement.
        """
        coriolis = pin.computeCoriolisMatrix(self._model.pinocchio, self._model.data, q, dq)
        return self._observer.update(dq, torque, terms, coriolis, steps)
