# SPDX-License-Identifier: Apache-2.0
"""Impact detection from measured signals: a link-side momentum observer and a test for a sudden force.

    p = M(q) dq,   dp/dt = tau_J + C^T dq - g + tau_ext
    r = K_o (p - integral(tau_J + C^T dq - g + r) dt),     r -> tau_ext with time constant 1 / K_o

(De Luca and Mattone; see Haddadin et al. 2017, the survey the paper cites.) The joint torque is measured on the link
side of the motor, so motor friction and the torque loop do not enter. The dynamically consistent inverse of J^T maps
the residual to a wrench at the end effector,

    f = (J M^-1 J^T)^-1 J M^-1 r,      F = -n . f_lin - F_slow,      dF_slow/dt = F / T while F is below the threshold

with n the direction of the ante-impact velocity. A slow force, as a wrong payload causes, is thus taken out with the
time constant T, and an impact is detected when F exceeds the threshold. The integral and F_slow advance by the control
period (explicit Euler) in ``src/control.cpp``.
"""

from __future__ import annotations

import pinocchio as pin

from impact_rs_sim import _kernel
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RigidTerms, RobotModel
from impact_rs_sim.scenario import Detection

BASELINE_TIME = 0.05  # s, time constant of the slow part of the residual


class ImpactDetector:
    """Detects impacts of one arm.

    Args:
        model: Rigid model of the arm as the controller believes it.
        settings: Observer gain and threshold.
        direction: Direction of the ante-impact velocity, unit vector in A, ``(3,)``.
        period: Control period [s].

    Attributes:
        threshold: What the sudden force has to exceed [N].
    """

    def __init__(self, model: RobotModel, settings: Detection, direction: Array, period: float) -> None:
        self._model = model
        self.threshold = settings.threshold
        self._observer = _kernel.Observer(
            model.joint_count,
            settings.observer_gain,
            period,
            settings.threshold,
            period / BASELINE_TIME,
            direction,
        )

    @property
    def wrench(self) -> Array:
        """Estimate of the external wrench on frame E, in E[A], ``(6,)`` [N, N m]."""
        return self._observer.wrench

    @property
    def force(self) -> float:
        """Sudden part of the force against ``direction`` [N]."""
        return self._observer.force

    def update(self, q: Array, dq: Array, torque: Array, terms: RigidTerms) -> bool:
        """Take one measurement; True when the sudden force is above the threshold.

        Args:
            q: Measured joint positions, ``(n,)`` [rad].
            dq: Measured joint velocities, ``(n,)`` [rad/s].
            torque: Measured joint torques tau_J, ``(n,)`` [N m].
            terms: Rigid-body terms at ``q``, ``dq``.
        """
        coriolis = pin.computeCoriolisMatrix(self._model.pinocchio, self._model.data, q, dq)
        return self._observer.update(dq, torque, terms, coriolis)
