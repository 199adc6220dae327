# SPDX-License-Identifier: Apache-2.0
"""The recorded velocity against the derivative of the recorded position, in which the model of the arm has no part.

With the readings q_r = s q + o and v_r = s s_v dq(t - d), filtered (:mod:`impact_rs_sim.readings`),

    v_r = s_v dq_r/dt (t - d),

whatever the arm. Of every stretch and joint two numbers enter, the parts of v_r along dq_r/dt and along d2q_r/dt2:

    c_k = K sum_(i in k) v_i w_i / sqrt(N sum_i w_i^2),    w = dq_r/dt or d2q_r/dt2    [rad/s]

with N samples in K stretches: a wrong gain changes the first by its share of the rms velocity, a delay d the second by
d times the rms acceleration (the normal equations of v = s_v dq_r/dt - d d2q_r/dt2). Their noise is the scatter over
the stretches that no gain and no delay explains, and at least ``EXACT_SHARE`` of a noticeable change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.evidence.free_motion.torque_balance import Motion
from impact_rs_sim.effects.sensing import VELOCITY_DELAY, VELOCITY_GAIN
from impact_rs_sim.readings import ArmReadings
from impact_rs_sim.robots.robot import Array

NOTICEABLE_GAIN = VELOCITY_GAIN.parameters[0].scale  # [-]
NOTICEABLE_DELAY_S = VELOCITY_DELAY.parameters[0].scale
EXACT_SHARE = 0.1  # of a noticeable change; filters and clocks of velocities are not exact
SPLINE_DEGREE = 5  # of low-passed positions, which have ten samples per period of the cut-off


class VelocityRelation:
    """Velocities of some motions against the derivatives of their positions, in stretches.

    Args:
        motions: Filtered recordings with recorded velocities.
        stretches: Samples of each stretch, among those between the edges of all motions.

    Attributes:
        recorded: Numbers of the recorded velocity by stretch, those along the velocities of all joints before those
            along their accelerations, ``(K, 2 n)`` [rad/s].
        noise: Their noise, ``(2 n,)`` [rad/s].
    """

    def __init__(self, motions: Sequence[Motion], stretches: Sequence[slice]) -> None:
        splines = [scipy.interpolate.make_interp_spline(m.time, m.position, k=SPLINE_DEGREE) for m in motions]
        self._motions, self._stretches = motions, stretches
        self._slopes = [np.asarray(spline(m.time, 1)) for spline, m in zip(splines, motions, strict=True)]
        slope = self._stacked(self._slopes)
        change = self._stacked([np.asarray(spline(m.time, 2)) for spline, m in zip(splines, motions, strict=True)])
        squares = np.maximum(np.sum(np.square((slope, change)), axis=1), 1e-300)
        scale = len(stretches) / np.sqrt(squares * slope.shape[0])
        self._weights = np.stack((slope, change)) * scale[:, None, :]
        velocity = self._stacked([motion.velocity for motion in motions])
        self.recorded = self._numbers(velocity)
        rest = velocity.copy()
        for joint in range(velocity.shape[1]):
            both = self._weights[:, :, joint].T
            rest[:, joint] -= both @ np.linalg.lstsq(both, velocity[:, joint], rcond=None)[0]
        scatter = np.sqrt(np.mean(np.square(self._numbers(rest)), axis=0))
        rms = np.sqrt(squares / velocity.shape[0])
        noticeable = np.concatenate((NOTICEABLE_GAIN * rms[0], NOTICEABLE_DELAY_S * rms[1]))
        self.noise = np.maximum(np.hypot(scatter, EXACT_SHARE * noticeable), 1e-12)

    def predicted(self, readings: ArmReadings) -> Array:
        """:attr:`recorded` as predicted from the positions by the sensor models, ``(K, 2 n)`` [rad/s]."""
        rows = [
            readings.velocity(motion.time, slope / readings.position_scale)
            for motion, slope in zip(self._motions, self._slopes, strict=True)
        ]
        return self._numbers(self._stacked(rows))

    def _stacked(self, rows: Sequence[Array]) -> Array:
        """Samples between the edges of all motions, ``(k, n)``."""
        return np.concatenate([row[motion.kept] for row, motion in zip(rows, self._motions, strict=True)])

    def _numbers(self, velocity: Array) -> Array:
        """Parts of a velocity along slope and change of the positions by stretch, ``(K, 2 n)`` [rad/s]."""
        parts = velocity * self._weights
        return np.array([np.concatenate(parts[:, rows].sum(axis=1)) for rows in self._stretches])
