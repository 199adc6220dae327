# SPDX-License-Identifier: Apache-2.0
"""Transmission: a load twists it by torque over stiffness."""

import pytest
from bench import ACROSS, FIRST_MOMENT, GRAVITY, STIFFNESS, bench, run, switched_on


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_joint_stiffness_decides_how_far_weight_twists_a_joint(scale):
    """A pendulum that stands out level along +x falls about +y, so it is held by a negative torque."""
    weight = -FIRST_MOMENT * GRAVITY
    motion = run(switched_on(bench(ACROSS), "joint_stiffness", scale=scale), lambda time: weight)
    twist = motion.motor_position[-1] - motion.position[-1]
    assert twist == pytest.approx(weight / (scale * STIFFNESS), rel=1e-3)
    assert motion.torque[-1] == pytest.approx(weight, rel=1e-3)
