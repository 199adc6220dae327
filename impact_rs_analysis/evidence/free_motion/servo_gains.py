# SPDX-License-Identifier: Apache-2.0
"""Gains of servos that are known to some percent: nuisance parameters that every model is compared with.

Where no torque was recorded, it is that of the servos with the gains of the mapping. A gain that is too high by s_j
makes the torque of joint j too high by that share:

    tau_r = (1 + s_j) tau(theta) + tau_late,    s_j = 0 +- 0.3    (prior: one standard deviation)

with tau_late of commands that act late (:mod:`impact_rs_analysis.evidence.free_motion.torque_balance`).

For every theta the s_j that minimise the residual are put in (variable projection: Golub and Pereyra 1973, SIAM J.
Numer. Anal. 10), so that what cannot be distinguished from a gain, such as the mass of all links, changes nothing, and
friction is known in proportion to the masses. Where a joint carries no torque but its friction, only the prior keeps
both apart: it enters as measurements of s_j in the K stretches, whose mean is 0 and whose scatter is 0.3 sqrt(K), so
that the mean has the standard deviation of the prior.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array

GAIN_DEVIATION = 0.3  # of gains that were found from gravity and inertia of the model, without friction [-]


class ServoGains:
    """Fits the gains of servos to a predicted torque.

    Args:
        recorded: Torque of the servos with the gains of the mapping, ``(k, m)`` [N m].
        noise: Of every column, ``(m,)`` [N m].
        stretches: Number of stretches K.

    Attributes:
        noise: Deviation of the prior of one stretch, ``(m,)`` [-].
        recorded: Measurements of s_j by stretch that stand for the prior, ``(K, m)`` [-].
    """

    def __init__(self, recorded: Array, noise: Array, stretches: int) -> None:
        self._torque, self._penalty = recorded, np.square(np.maximum(noise, 1e-12) / GAIN_DEVIATION)
        joints = recorded.shape[1]
        self.noise = np.full(joints, GAIN_DEVIATION * np.sqrt(stretches))
        turns = np.resize((1.0, -1.0), stretches)  # alternating, so that parts of the log have mean 0 as well
        self.recorded = np.outer((turns - turns.mean()) / turns.std(), self.noise)

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
