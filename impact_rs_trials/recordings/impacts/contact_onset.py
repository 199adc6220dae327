# SPDX-License-Identifier: Apache-2.0
"""Onset of a contact in a force or an acceleration: the first sample outside the scatter of free motion.

A force-torque sensor or an accelerometer is often faster than encoders, and its onset is sharper than a kink of
positions. The force or acceleration f has the mean m and the covariance C before the impact; a sample belongs to the
contact if its Mahalanobis distance is large,

    (f - m)^T C^-1 (f - m) > MIN_MAHALANOBIS^2

and the next one's as well, because a single sample may be an outlier. The contact begins between this sample and the
previous one, with a standard deviation of a period over sqrt(12).
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.readers.series import Series

MIN_MAHALANOBIS = 6.0  # distance of a sample in contact from free motion [-]
FREE_MOTION_S = 0.2  # before the impact
MIN_FREE_SAMPLES = 20  # of free motion
MIN_RATE_RATIO = 2.0  # of the sensor over the joints, from which the sensor times the contact
ONSET_HALF_WIDTH_S = 0.03  # about the time by the joints


def onset_of(sensor: Series, position: Series, near: float) -> tuple[float, float] | None:
    """Onset of a contact by a sensor, and its standard deviation [s].

    Args:
        sensor: Force and moment, ``(k, 6)`` [N, N m], or acceleration, ``(k, 3)`` [m/s^2].
        position: Joint positions, for their rate.
        near: Onset of the contact by the joint positions [s].

    Returns:
        None: the sensor is not faster than the joints, or does not exceed its scatter.
    """
    if min(sensor.time.size, position.time.size) < MIN_FREE_SAMPLES:
        return None
    period, of_joints = (float(np.median(np.diff(one.time))) for one in (sensor, position))
    reach = max(ONSET_HALF_WIDTH_S, 2.0 * of_joints)
    if of_joints < MIN_RATE_RATIO * period:
        return None
    quiet = (sensor.time >= near - reach - FREE_MOTION_S) & (sensor.time < near - reach)
    about = np.flatnonzero((sensor.time >= near - reach) & (sensor.time <= near + reach))
    if np.count_nonzero(quiet) < MIN_FREE_SAMPLES or about.size < 2:
        return None
    felt = sensor.values[:, :3]
    far = _distance(felt[about], felt[quiet]) > MIN_MAHALANOBIS
    both = np.flatnonzero(far[:-1] & far[1:])
    if not both.size or both[0] == 0:  # it pressed already
        return None
    first = int(about[both[0]])
    return 0.5 * float(sensor.time[first - 1] + sensor.time[first]), float(period / np.sqrt(12.0))


def _distance(felt: Array, quiet: Array) -> Array:
    """Mahalanobis distance of each sample from the free-motion distribution, ``(k,)`` [-]."""
    off = felt - np.mean(quiet, axis=0)
    spread = np.cov(quiet.T) + 1e-12 * np.eye(3)
    return np.asarray(np.sqrt(np.einsum("ki,ki->k", off, np.linalg.solve(spread, off.T).T)))
