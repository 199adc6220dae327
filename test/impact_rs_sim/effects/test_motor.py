# SPDX-License-Identifier: Apache-2.0
"""Motor side: friction takes momentum from a moving joint, and the motor inertia adds to that of the link."""

import numpy as np
import pytest
from bench import MASS_MATRIX, MOTOR_INERTIA, bench, run, slope, switched_on

INERTIA = MASS_MATRIX + MOTOR_INERTIA


def pushed(direction):
    """4 N m for 0.15 s, then nothing."""
    return lambda time: 4.0 * direction if time < 0.15 else 0.0


def test_without_friction_a_joint_that_is_let_go_keeps_its_speed():
    motion = run(bench(), pushed(1.0))
    assert motion.momentum[-1] == pytest.approx(4.0 * 0.15, rel=1e-3)
    assert slope(motion.time, motion.velocity, 0.25, 0.39) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_coulomb_friction_slows_a_joint_by_torque_over_inertia(direction):
    motion = run(switched_on(bench(), "joint_coulomb_friction", coulomb_joint1=0.3), pushed(direction))
    assert direction * motion.velocity[-1] > 0.1
    assert slope(motion.time, motion.velocity, 0.25, 0.39) == pytest.approx(-direction * 0.3 / INERTIA, rel=0.01)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_viscous_speed_decays_with_inertia_over_coefficient(direction):
    motion = run(switched_on(bench(), "joint_viscous_friction", viscous_joint1=0.5), pushed(direction))
    assert direction * motion.velocity[-1] > 0.1
    later = motion.time > 0.2
    decay = slope(motion.time[later], np.log(np.abs(motion.velocity[later])), 0.25, 0.39)
    assert decay == pytest.approx(-0.5 / INERTIA, rel=0.01)


def test_stribeck_friction_holds_a_joint_below_the_breakaway_torque():
    stuck = switched_on(bench(), "joint_stribeck_friction", breakaway_joint1=1.0)
    assert abs(run(stuck, lambda time: 0.5).position[-1]) < 2e-3
    assert run(bench(), lambda time: 0.5).position[-1] > 0.05


def test_stribeck_friction_falls_to_1_over_e_at_its_velocity():
    physics = switched_on(bench(), "joint_stribeck_friction", breakaway_joint1=1.0, stribeck_velocity=0.2)
    motion = run(physics, lambda time: 1.5, seconds=0.4)
    rate = np.gradient(motion.momentum, motion.time)
    speed = motion.motor_velocity
    settled = motion.time > 0.05
    there = np.flatnonzero(settled & (speed > 0.2))[0]
    assert rate[there] == pytest.approx(1.5 - 1.0 / np.e, abs=0.03)
    assert speed[-1] > 0.6
    assert np.mean(rate[settled & (speed > 0.6)][1:-1]) == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_motor_inertia_scale_adds_to_the_inertia_that_a_torque_moves(scale):
    motion = run(switched_on(bench(), "motor_inertia_scale", scale=scale), lambda time: 2.0)
    expected = 2.0 / (MASS_MATRIX + scale * MOTOR_INERTIA)
    assert slope(motion.time, motion.velocity, 0.2, 0.39) == pytest.approx(expected, rel=0.005)


def test_added_motor_inertia_resists_as_much_as_the_assumed_one():
    scaled, added = (
        switched_on(bench(), name, **{parameter: value}).arms["arm"].motor_inertia_reduced
        for name, parameter, value in (
            ("motor_inertia_scale", "scale", 1.8),
            ("added_motor_inertia", "inertia_joint1", 0.12),
        )
    )
    np.testing.assert_allclose(added, scaled)
