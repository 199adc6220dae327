# SPDX-License-Identifier: Apache-2.0
"""States and torques beyond the limits of an arm are told, with joint, value, limit and unit."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_control.arm_limits import MEASURED, rate_limited, state_complaint, torque_complaint
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
MODEL = PLAN.scene.models["arm"]
START = PLAN.arms["arm"].initial
JOINTS = [f"arm_joint{number + 1}" for number in range(7)]
STILL = np.zeros(7)


def at(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[index] = value
    return changed


def test_a_state_within_every_limit_is_no_complaint() -> None:
    assert state_complaint(MODEL, JOINTS, START, STILL, STILL) == ""
    assert state_complaint(MODEL, JOINTS, MODEL.position_max, MODEL.velocity_max, -MEASURED * MODEL.torque_max) == ""


@pytest.mark.parametrize("beyond", [1e-6, 1.0, np.nan])
def test_a_joint_beyond_a_limit_is_told_by_name(beyond: float) -> None:
    high, low = MODEL.position_max[2] + beyond, MODEL.position_min[2] - beyond
    for position in (high, low):
        told = state_complaint(MODEL, JOINTS, at(START, 2, position), STILL, STILL)
        assert told.startswith("arm_joint3 at ") and told.endswith(f"to {MODEL.position_max[2]:.4g} rad")
    for velocity in (MODEL.velocity_max[5] + beyond, -MODEL.velocity_max[5] - beyond):
        told = state_complaint(MODEL, JOINTS, START, at(STILL, 5, velocity), STILL)
        assert told.startswith("arm_joint6 at ") and told.endswith(f"limit {MODEL.velocity_max[5]:.4g} rad/s")


@pytest.mark.parametrize("measured", [1e6, -1e6, np.nan])
def test_a_torque_that_no_impact_explains_is_no_measurement(measured: float) -> None:
    complaint = state_complaint(MODEL, JOINTS, START, STILL, at(STILL, 3, measured))
    assert complaint.startswith("arm_joint4 measures ") and complaint.endswith("more than 5 times its limit of 87 N m")


@pytest.mark.parametrize("beyond", [1e-3, np.nan, np.inf])
def test_a_torque_beyond_its_limit_is_told_by_name(beyond: float) -> None:
    assert torque_complaint(MODEL, JOINTS, MODEL.torque_max) == ""
    for torque in (MODEL.torque_max[1] + beyond, -MODEL.torque_max[1] - beyond):
        told = torque_complaint(MODEL, JOINTS, at(STILL, 1, torque))
        assert told.startswith("torque of ") and told.endswith(f"for arm_joint2, limit {MODEL.torque_max[1]:.4g} N m")


def test_a_torque_that_jumps_is_approached_at_the_largest_rate() -> None:
    before, wanted = np.array([0.0, 5.0, -5.0, 5.0]), np.array([0.5, 9.0, -9.0, 4.7])
    np.testing.assert_allclose(rate_limited(wanted, before, 1.0), [0.5, 6.0, -6.0, 4.7])
