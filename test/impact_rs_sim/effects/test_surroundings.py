# SPDX-License-Identifier: Apache-2.0
"""Surroundings: where gravity comes from, and which way a cable pulls."""

from dataclasses import replace

import numpy as np
import pytest
from bench import FIRST_MOMENT, GRAVITY, MASS_MATRIX, MOTOR_INERTIA, REACH, bench, run, slope, switched_on

INERTIA = MASS_MATRIX + MOTOR_INERTIA


@pytest.mark.parametrize("angle", [0.1, -0.1])
def test_things_fall_to_the_side_that_the_tilt_lowers(angle):
    """Roll about +x lifts the side +y, so things fall to -y; pitch about +y lowers the side +x, so they fall there."""
    sine, cosine = GRAVITY * np.sin(angle), GRAVITY * np.cos(angle)
    for name, gravity in (("roll", (0.0, -sine, -cosine)), ("pitch", (sine, 0.0, -cosine))):
        motion = run(switched_on(bench(), "base_tilt", **{name: angle}), seconds=0.2, box=(5.0, 0.0, 3.0))
        found = [slope(motion.time, motion.box_velocity[:, axis], 0.0, 0.2) for axis in range(3)]
        np.testing.assert_allclose(found, gravity, atol=1e-6)


def test_tilt_turns_a_level_turntable_downhill():
    motion = run(switched_on(bench(), "base_tilt", roll=0.1), seconds=0.25)
    expected = -FIRST_MOMENT * GRAVITY * np.sin(0.1) / INERTIA
    assert slope(motion.time, motion.velocity, 0.1, 0.2) == pytest.approx(expected, rel=0.02)


def test_roll_and_pitch_together_keep_the_size_of_gravity():
    tilted = switched_on(bench(), "base_tilt", roll=0.05, pitch=-0.03).gravity
    expected = GRAVITY * np.array([np.sin(-0.03), -np.sin(0.05) * np.cos(-0.03), -np.cos(0.05) * np.cos(-0.03)])
    np.testing.assert_allclose(tilted, expected, atol=1e-12)


@pytest.mark.parametrize("pull", [3.0, -3.0])
def test_a_cable_turns_the_arm_to_the_side_it_pulls_to(pull):
    motion = run(switched_on(bench(), "external_spring", pull_y=pull), seconds=0.25)
    assert slope(motion.time, motion.velocity, 0.1, 0.2) == pytest.approx(pull * REACH / INERTIA, rel=0.02)


@pytest.mark.parametrize("side", [0.1, -0.1])
def test_a_spring_pulls_with_stiffness_times_distance(side):
    physics = bench()
    anchored = replace(physics.arms["arm"], impact_position=np.array([REACH, side, 0.0]))
    physics = switched_on(replace(physics, arms={"arm": anchored}), "external_spring", stiffness=40.0)
    motion = run(physics, seconds=0.1)
    away = np.sin(motion.position[-1]) * REACH
    assert 0.0 < away / side < 0.2
    assert slope(motion.time, motion.velocity, 0.0, 0.099) == pytest.approx(40.0 * side * REACH / INERTIA, rel=0.05)
