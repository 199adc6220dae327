# SPDX-License-Identifier: Apache-2.0
"""Onset of a contact in a force or an acceleration: the first sample outside the scatter of free motion.

A force-torque sensor or an accelerometer is often faster than encoders, and its onset is sharper than a kink of
positions. The force or acceleration f has the mean m and the covariance C before the impact; a sample belongs to the
contact if its Mahalanobis distance is large,

    (f - m)^T C^-1 (f - m) > MIN_MAHALANOBIS^2

and that of the next sample is large, too: a single sample may be an outlier. The contact begins between this sample and
the previous sample; the standard deviation of its time is period / sqrt(12).
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.readers.series import Series

MIN_MAHALANOBIS = 6.0  # distance of a sample in contact from free motion [-]
FREE_MOTION_S = 0.2  # window of free motion before the impact
MIN_FREE_SAMPLES = 20  # in that window
MIN_RATE_RATIO = 2.0  # of sensor to joints; a slower sensor does not time the contact
ONSET_HALF_WIDTH_S = 0.03  # searched on either side of the time by the joints


def onset_of(sensor: Series, position: Series, near: float) -> tuple[float, float] | None:
    """Time at which a contact begins in the signal of a fast sensor.

    Args:
        sensor: Force and moment, ``(k, 6)`` [N, N m], or acceleration, ``(k, 3)`` [m/s^2].
        position: Joint positions, for their rate.
        near: Time of the impact by the joint positions [s].

    Returns:
        Time of the onset and its standard deviation [s]; None: the sensor is not faster than the joints, or does not
        exceed its scatter.
    """
    if min(sensor.time.size, position.time.size) < MIN_FREE_SAMPLES:
        return None
    period, joint_period = (float(np.median(np.diff(series.time))) for series in (sensor, position))
    reach = max(ONSET_HALF_WIDTH_S, 2.0 * joint_period)
    if joint_period < MIN_RATE_RATIO * period:
        return None
    free = (sensor.time >= near - reach - FREE_MOTION_S) & (sensor.time < near - reach)
    nearby = np.flatnonzero((sensor.time >= near - reach) & (sensor.time <= near + reach))
    if np.count_nonzero(free) < MIN_FREE_SAMPLES or nearby.size < 2:
        return None
    forces = sensor.values[:, :3]
    outside = _mahalanobis_distance(forces[nearby], forces[free]) > MIN_MAHALANOBIS
    pairs = np.flatnonzero(outside[:-1] & outside[1:])
    if not pairs.size or pairs[0] == 0:  # already in contact
        return None
    first = int(nearby[pairs[0]])
    return 0.5 * float(sensor.time[first - 1] + sensor.time[first]), float(period / np.sqrt(12.0))


def _mahalanobis_distance(samples: Array, free_motion: Array) -> Array:
    """Mahalanobis distance of each sample from the free-motion distribution, ``(k,)`` [-]."""
    deviations = samples - np.mean(free_motion, axis=0)
    covariance = np.cov(free_motion.T) + 1e-12 * np.eye(3)
    return np.asarray(np.sqrt(np.einsum("ki,ki->k", deviations, np.linalg.solve(covariance, deviations.T).T)))
