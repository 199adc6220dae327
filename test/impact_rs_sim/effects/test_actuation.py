# SPDX-License-Identifier: Apache-2.0
"""Actuation: what a joint delivers is gain times the desired torque, late, and an offset."""

import numpy as np
import pytest
from bench import MASS_MATRIX, MOTOR_INERTIA, bench, run, slope, switched_on

INERTIA = MASS_MATRIX + MOTOR_INERTIA


@pytest.mark.parametrize("offset", [0.4, -0.4])
def test_torque_offset_moves_a_joint_that_nobody_asked_to_move(offset):
    motion = run(switched_on(bench(), "torque_offset", offset_joint1=offset))
    assert slope(motion.time, motion.velocity, 0.2, 0.39) == pytest.approx(offset / INERTIA, rel=0.005)


def test_torque_gain_of_1_01_delivers_1_percent_more():
    asked = run(bench(), lambda time: 2.0)
    more = run(switched_on(bench(), "torque_gain", gain_joint1=1.01), lambda time: 2.0)
    assert asked.momentum[-1] == pytest.approx(2.0 * asked.time[-1], rel=1e-6)
    assert more.momentum[-1] / asked.momentum[-1] == pytest.approx(1.01, rel=1e-6)


def test_gain_does_not_multiply_the_offset():
    physics = switched_on(switched_on(bench(), "torque_gain", gain_joint1=1.2), "torque_offset", offset_joint1=0.5)
    motion = run(physics, lambda time: 2.0)
    assert motion.momentum[-1] == pytest.approx((1.2 * 2.0 + 0.5) * motion.time[-1], rel=1e-6)


@pytest.mark.parametrize("delay", [0.001, 0.0031, 0.02])
def test_actuation_delay_shifts_the_delivered_torque(delay):
    """A step of the desired torque at 50 ms begins to push at 50 ms and the delay; the momentum tells when."""
    motion = run(switched_on(bench(), "actuation_delay", delay=delay), lambda time: 2.0 if time > 0.0495 else 0.0)
    np.testing.assert_allclose(motion.momentum[motion.time < 0.05 + delay - 1e-9], 0.0, atol=1e-9)
    assert motion.momentum[-1] == pytest.approx(2.0 * (motion.time[-1] - 0.05 - delay), rel=1e-6)
