# SPDX-License-Identifier: Apache-2.0
"""Impact detection from measured signals: a link-side momentum observer and a test for a sudden force.

    p = M(q) dq,   dp/dt = tau_J + C^T dq - g + tau_ext
    r = K_o (p - integral(tau_J + C^T dq - g + r) dt),     r -> tau_ext with time constant 1 / K_o

(De Luca and Mattone; see Haddadin et al. 2017, the survey the paper cites.) The measured joint torque stands on the
link side of the motor, so motor friction and the torque loop do not enter. The residual is turned into the force at
the end effector with the dynamically consistent inverse of J^T. What counts is its sudden part: a slow baseline,
which a wrong payload would leave, is subtracted.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RigidTerms, RobotModel
from impact_rs_sim.scenario import Detection

BASELINE_TIME = 0.05  # s, time constant of the slow part of the residual


class ImpactDetector:
    """Watches one arm.

    Args:
        model: Rigid model of the arm as the controller believes it.
        settings: Observer gain and threshold.
        direction: Direction of the ante-impact velocity, unit vector in A, ``(3,)``.
        period: Control period [s].

    Attributes:
        wrench: Estimate of the external wrench on frame E, in E[A], ``(6,)`` [N, N m].
        force: Sudden part of the force against ``direction`` [N].
    """

    def __init__(self, model: RobotModel, settings: Detection, direction: Array, period: float) -> None:
        self._model = model
        self._gain = settings.observer_gain
        self.threshold = settings.threshold
        self._direction = direction
        self._period = period
        self._integral: Array | None = None
        self._residual = np.zeros(model.joint_count)
        self._right = np.zeros((model.joint_count, 7), order="F")
        self._baseline = 0.0
        self.wrench = np.zeros(6)
        self.force = 0.0

    def update(self, q: Array, dq: Array, torque: Array, terms: RigidTerms) -> bool:
        """Take one measurement; True when the sudden force is above the threshold.

        Args:
            q: Measured joint positions, ``(n,)`` [rad].
            dq: Measured joint velocities, ``(n,)`` [rad/s].
            torque: Measured joint torques tau_J, ``(n,)`` [N m].
            terms: Rigid-body terms at ``q``, ``dq``.
        """
        model, data = self._model.pinocchio, self._model.data
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        momentum = terms.mass_matrix @ dq
        known = torque + coriolis.T @ dq - (terms.bias - coriolis @ dq)
        if self._integral is None:
            self._integral = momentum.copy()
        self._integral += self._period * (known + self._residual)
        self._residual = self._gain * (momentum - self._integral)
        jacobian = terms.jacobian
        self._right[:, :6] = jacobian.T
        self._right[:, 6] = self._residual
        mobility = jacobian @ scipy.linalg.lapack.dposv(terms.mass_matrix, self._right)[1]
        self.wrench = scipy.linalg.lapack.dposv(mobility[:, :6], mobility[:, 6])[1]
        against = -float(self._direction @ self.wrench[:3])
        self.force = against - self._baseline
        if self.force < self.threshold:
            self._baseline += self._period / BASELINE_TIME * self.force
        return self.force > self.threshold
