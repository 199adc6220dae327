# SPDX-License-Identifier: Apache-2.0
"""Recorded velocity against the derivative of the recorded position, independent of the model of the arm.

With the readings q_r = s q + o and v_r = s s_v dq(t - d), filtered (:mod:`impact_rs_sim.readings`), and without a lag
of the velocity,

    v_r = s_v dq_r/dt (t - d),

whatever the arm. Features are the projections of v_r on w = dq_r/dt and on w = d2q_r/dt2 in every stretch k, by joint,

    c_k = K sum_(i in k) v_i w_i / sqrt(N sum_i w_i^2)    [rad/s]

with N samples in K stretches. Their mean over the stretches is the gain times the rms of dq_r/dt, and minus the delay
times the rms of d2q_r/dt2 (the normal equations of v = s_v dq_r/dt - d d2q_r/dt2). Their noise is the scatter over the
stretches unexplained by a gain and a delay, and ``NOISE_FLOOR_SHARE`` of a noticeable change, added in quadrature.
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
NOISE_FLOOR_SHARE = 0.1  # of a noticeable change; filters and clocks of velocities are not exact
SPLINE_DEGREE = 5  # of low-passed positions, which usually have ten or more samples per period of the cut-off


class VelocityRelation:
    """Velocities of some motions against the derivatives of their positions, in stretches.

    Args:
        motions: Filtered recordings with recorded velocities.
        stretches: Samples of each stretch, among those between the edges of all motions.

    Attributes:
        recorded: Projections of the recorded velocity by stretch: on dq_r/dt of all joints, then on d2q_r/dt2,
            ``(K, 2 n)`` [rad/s].
        noise: Their standard deviation, ``(2 n,)`` [rad/s].
    """

    def __init__(self, motions: Sequence[Motion], stretches: Sequence[slice]) -> None:
        splines = [
            scipy.interpolate.make_interp_spline(m.time, m.low_pass(m.position), k=SPLINE_DEGREE) for m in motions
        ]
        self._motions, self._stretches = motions, stretches
        self._rates = [np.asarray(spline(m.time, 1)) for spline, m in zip(splines, motions, strict=True)]
        rate = self._stacked(self._rates)
        acceleration = self._stacked(
            [np.asarray(spline(m.time, 2)) for spline, m in zip(splines, motions, strict=True)]
        )
        squares = np.maximum(np.sum(np.square((rate, acceleration)), axis=1), 1e-300)
        scale = len(stretches) / np.sqrt(squares * rate.shape[0])
        self._weights = np.stack((rate, acceleration)) * scale[:, None, :]
        velocity = self._stacked([motion.low_pass(motion.velocity) for motion in motions])
        self.recorded = self._projections(velocity)
        residual = velocity.copy()
        for joint in range(velocity.shape[1]):
            regressors = self._weights[:, :, joint].T
            residual[:, joint] -= regressors @ np.linalg.lstsq(regressors, velocity[:, joint], rcond=None)[0]
        scatter = np.sqrt(np.mean(np.square(self._projections(residual)), axis=0))
        rms = np.sqrt(squares / velocity.shape[0])
        noticeable = np.concatenate((NOTICEABLE_GAIN * rms[0], NOTICEABLE_DELAY_S * rms[1]))
        self.noise = np.maximum(np.hypot(scatter, NOISE_FLOOR_SHARE * noticeable), 1e-12)

    def predicted(self, readings: ArmReadings) -> Array:
        """:attr:`recorded` as predicted from the positions by the sensor models, ``(K, 2 n)`` [rad/s]."""
        rows = [
            readings.velocity(motion.time, rate / readings.position_scale)
            for motion, rate in zip(self._motions, self._rates, strict=True)
        ]
        return self._projections(self._stacked(rows))

    def _stacked(self, rows: Sequence[Array]) -> Array:
        """Samples between the edges of all motions, ``(k, n)``."""
        return np.concatenate([row[motion.inner] for row, motion in zip(rows, self._motions, strict=True)])

    def _projections(self, velocity: Array) -> Array:
        """Projections c_k of a velocity by stretch, ``(K, 2 n)`` [rad/s]."""
        parts = velocity * self._weights
        return np.array([np.concatenate(parts[:, rows].sum(axis=1)) for rows in self._stretches])
