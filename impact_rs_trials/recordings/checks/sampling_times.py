# SPDX-License-Identifier: Apache-2.0
"""Test whether samples were taken at their timestamps, by the common timing error of all joints.

A sample that was taken later by d deviates from the smooth motion by d times the velocity, in every joint. Its residual
from the cubic polynomial through its four neighbours, which fits smooth motions, is

    r_i = q_i - sum_k q_k prod_{l != k} (t_i - t_l) / (t_k - t_l) = d_i dq_i + noise,    k, l in i-2, i-1, i+1, i+2

Over the noise of each joint, r has a component along dq and n - 1 components across it. Noise has the same power in all
of them; errors of the timestamps have power along dq alone.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array

RMS_PER_PERIOD_ERROR = float(np.sqrt(20.0) / 6.0)  # of r / dq, for independent errors of the periods: third differences
MIN_TIMESTAMPS = 50
MIN_POWER_RATIO = 10.0  # along the velocity over across it, with wrong timestamps; F(50, 50) is at most 3
MIN_JITTER_PERIODS = 0.03  # rms; less does not harm derivatives
MAX_ROUNDING_PERIODS = 1e-3  # by which even timestamps differ because they are rounded


def timestamp_warning(time: Array, position: Array) -> str | None:
    """Warning that samples of a motion were not taken at their timestamps; None: no evidence.

    Args:
        time: Timestamps, increasing, ``(k,)`` [s].
        position: q, ``(k, n)`` [rad].
    """
    count = position.shape[1]
    if count < 2 or time.size < MIN_TIMESTAMPS:
        return None
    period = float(np.median(np.diff(time)))
    residual = _residual_from_neighbours(time, position)
    velocity = np.gradient(position, time, axis=0)[2:-2]
    steps = np.diff(time)
    excluded = np.all(np.diff(position, axis=0) == 0.0, axis=1) | (np.abs(steps / period - 1.0) > 0.5)
    windows = [excluded[first : excluded.size - 3 + first] for first in range(4)]
    usable = ~np.any(windows, axis=0)  # no gap, no repeated sample
    if np.count_nonzero(usable) < MIN_TIMESTAMPS:
        return None
    residual, velocity = residual[usable], velocity[usable]
    delay = np.zeros(len(residual))
    for _ in range(3):  # noise of a joint: scatter about the common error
        noise = np.sqrt(np.mean(np.square(residual - delay[:, None] * velocity), axis=0)) + 1e-12
        r, v = residual / noise, velocity / noise
        delay = np.sum(r * v, axis=1) / np.maximum(np.sum(np.square(v), axis=1), 1e-300)
    along = np.square(delay) * np.sum(np.square(v), axis=1)
    across = (np.sum(np.square(r), axis=1) - along) / (count - 1)
    error = float(np.sqrt(np.mean(np.square(delay)))) / RMS_PER_PERIOD_ERROR
    if np.mean(along) < MIN_POWER_RATIO * np.mean(across) or error < MIN_JITTER_PERIODS * period:
        return None
    if np.max(np.abs(steps / period - np.round(steps / period))) < MAX_ROUNDING_PERIODS:  # lost rows: whole periods
        return (
            f"timestamps are nominal: exactly even ({1.0 / period:.4g} Hz), as a number of samples over a rate, while "
            f"all joints together show periods that vary by {100.0 * error / period:.0f} % (rms). Velocities and "
            "accelerations computed from them are wrong by as much: record the time of each sample"
        )
    return (
        "samples were not taken at their timestamps: all joints together show periods that differ from them by "
        f"{1e3 * error:.2g} ms (rms; the period is {1e3 * period:.3g} ms). Velocities and accelerations computed "
        "from them are wrong by as much: take the timestamps of the measurement, not of a log"
    )


def _residual_from_neighbours(time: Array, position: Array) -> Array:
    """Residual of every sample from the cubic polynomial through its four neighbours, ``(k - 4, n)`` [rad]."""
    ends = [(first, time.size - 4 + first) for first in range(5)]
    centre, *neighbours = (ends[index] for index in (2, 0, 1, 3, 4))
    t = time[slice(*centre)]
    residual = position[slice(*centre)].copy()
    for k in neighbours:
        weight = np.ones(t.size)
        for l in neighbours:  # noqa: E741 (as in the equation above)
            if l != k:
                weight *= (t - time[slice(*l)]) / (time[slice(*k)] - time[slice(*l)])
        residual -= weight[:, None] * position[slice(*k)]
    return np.asarray(residual)
