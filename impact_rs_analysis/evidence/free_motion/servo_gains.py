# SPDX-License-Identifier: Apache-2.0
"""Gains of servos that are known to some percent: nuisance parameters that every model is compared with.

Where no torque was recorded, it is computed by the law of the servos with the gains of the mapping. If a gain is too
high by the share s_j, the torque of joint j is too high by the same share:

    tau_r = (1 + s_j) tau(theta) + tau_late,    s_j = 0 +- 0.3    (prior: one standard deviation)

with tau_late, the torque of late commands (:mod:`impact_rs_analysis.evidence.free_motion.torque_balance`).

For every theta the s_j minimise the residual (variable projection: Golub and Pereyra 1973, SIAM J. Numer. Anal. 10). A
parameter that cannot be distinguished from a gain, such as the mass of all links, then changes no residual, and
friction is known in proportion to the masses. Where a joint carries only friction torque, only the prior separates gain
and friction: it enters as measurements of s_j in the K stretches with mean 0 and scatter 0.3 sqrt(K), so that their
mean has the standard deviation of the prior.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array

GAIN_DEVIATION = 0.3  # of gains that were found from gravity and inertia of the model, without friction [-]


class ServoGains:
    """Fits the gains of servos to a predicted torque.

    Args:
        recorded: Torque of the servos with the gains of the mapping, ``(k, m)`` [N m].
        noise: Noise of every column, ``(m,)`` [N m].
        stretches: Number of stretches K.

    Attributes:
        noise: Deviation of the prior of one stretch, ``(m,)`` [-].
        recorded: Measurements of s_j by stretch that stand for the prior, ``(K, m)`` [-].
    """

    def __init__(self, recorded: Array, noise: Array, stretches: int) -> None:
        self._torque, self._penalty = recorded, np.square(np.maximum(noise, 1e-12) / GAIN_DEVIATION)
        joints = recorded.shape[1]
        self.noise = np.full(joints, GAIN_DEVIATION * np.sqrt(stretches))
        signs = np.resize((1.0, -1.0), stretches)  # alternating, so that parts of the log have mean 0 as well
        self.recorded = np.outer((signs - signs.mean()) / signs.std(), self.noise)

    def fitted(self, torque: Array, late: Array) -> Array:
        """The s_j, ``(m,)`` [-].

        Args:
            torque: Predicted tau + tau_late, ``(k, m)`` [N m].
            late: Its part tau_late, ``(k, m)`` [N m].
        """
        servo_torque = torque - late
        scores = np.sum(servo_torque * (self._torque - torque), axis=0)
        return np.asarray(scores / (np.sum(np.square(servo_torque), axis=0) + self._penalty))

    def predicted(self, share: Array) -> Array:
        """:attr:`recorded` as predicted with gains that are too high by ``share`` ``(m,)``, ``(K, m)`` [-]."""
        return np.broadcast_to(share, self.recorded.shape)
