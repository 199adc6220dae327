# SPDX-License-Identifier: Apache-2.0
"""Joints and objects beside an impact: planted jumps, friction and ways are found from encoders and trackers alone."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_trials.recordings.arm_impacts import joint_jump
from impact_rs_trials.recordings.motion_fits import move, rest
from impact_rs_trials.recordings.series import Series

IMPACT = 0.5003  # s
JUMP = np.array([-0.21, 0.35, 0.04])  # rad/s
SPEED = np.array([0.6, -0.8, 0.1])


def joints(rate: float, noise: float, seed: int) -> Series:
    """Three joints that swing, whose velocities jump at a moment between two samples."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = time[:, None] - IMPACT
    values = SPEED * t + np.sin(3.0 * t) * 0.1 + np.maximum(t, 0.0) * JUMP + 0.8 * np.maximum(t, 0.0) ** 2
    noisy = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    return Series("q", time, noisy)


@pytest.mark.parametrize(("rate", "noise"), [(1000.0, 1e-5), (500.0, 2e-5), (200.0, 1e-5)])
def test_a_planted_jump_of_joint_velocities_is_found_with_its_noise(rate: float, noise: float) -> None:
    errors, moments = [], []
    for seed in range(30):
        found = joint_jump(joints(rate, noise, seed), IMPACT + 0.006)
        assert found is not None
        errors.append((found.after - found.before - JUMP) / found.noise)
        moments.append(found.time - IMPACT)
        np.testing.assert_allclose(found.before, SPEED + 0.3, atol=0.03)
    assert np.sqrt(np.mean(np.square(moments))) < 1.5e-3
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2.5


def test_too_few_samples_about_an_impact_are_no_impact() -> None:
    series = joints(100.0, 0.0, 0)
    assert joint_jump(Series("q", series.time[48:], series.values[48:]), IMPACT) is None


def test_an_object_that_slides_shows_its_speed_and_its_friction() -> None:
    """0.9 m/s with mu = 0.25, tracked at 200 Hz to 0.1 mm."""
    errors, frictions = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        time = np.arange(0.002, 0.15, 0.005)
        way = 0.9 * time - 0.5 * 0.25 * 9.81 * time**2
        place = np.outer(way, [0.0, -1.0, 0.0]) + 1e-4 * rng.standard_normal((time.size, 3))
        motion = move(time, place, np.repeat(np.eye(3)[None], time.size, axis=0), 0.0)
        twist = motion.at(0.0)[2]
        errors.append((twist[:3] - [0.0, -0.9, 0.0]) / motion.noise[0])
        frictions.append(motion.acceleration[1] / 9.81)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.2)
    assert np.mean(frictions) == pytest.approx(0.25, abs=0.005)


def test_rest_has_the_scatter_of_the_tracker() -> None:
    rng = np.random.default_rng(0)
    place = np.array([0.4, 0.1, 0.2]) + 2e-4 * rng.standard_normal((50, 3))
    motion = rest(place, np.repeat(np.eye(3)[None], 50, axis=0), 1.0)
    assert motion.scatter[0] == pytest.approx(2e-4, rel=0.15)
    np.testing.assert_array_equal(motion.at(1.0)[2], np.zeros(6))
