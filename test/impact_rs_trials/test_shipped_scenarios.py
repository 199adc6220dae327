# SPDX-License-Identifier: Apache-2.0
"""Shipped scenarios of robots by name: stable drives, and a trial of each with sane figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trials import recorded, ticks_of

from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.robot_check import failures_of
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

ROBOTS = {"push_fr3": "franka_fr3", "push_ur5e": "ur5e", "push_iiwa7": "kuka_iiwa7", "grab_fr3": "franka_fr3"}
NEAR = {"push": 0.05, "grab": 0.1}  # the weight of the box pulls at a grab until friction carries it
AFTER = (0.05, 0.10)  # s after the nominal impact: contacts have settled, and feedback has hardly changed the speed


@pytest.mark.parametrize("name", ROBOTS)
def test_a_shipped_scenario_is_that_of_its_robot_and_its_drives_are_stable(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert {robot.facts for robot in scenario.robots.values()} == {ROBOTS[name]}
    assert failures_of(scenario) == []


@pytest.mark.parametrize("name", ROBOTS)
def test_a_trial_ends_well_within_the_limits_and_near_the_impact_map(name: str, tmp_path: Path) -> None:
    """The heaviest box: below 65 % of joint speeds and 95 % of joint torques; the map is met as in ``NEAR``."""
    scenario = load_scenario(name)
    plan = TrialSpec.of(scenario, "juice", next(iter(scenario.cases))).plan
    verdict = recorded(plan, tmp_path / "bag", seed=1)
    assert (verdict.outcome, verdict.reason) == ("OK", "")
    axis, begin = scenario.axis_index, scenario.timing.nominal_impact
    speeds: dict[str, list[float]] = {arm: [] for arm in plan.arms}
    for tick, _ in ticks_of(plan, seed=1):
        for arm, measured in tick.measurement.arms.items():
            model = plan.scene.models[arm]
            assert np.abs(measured.velocity / model.velocity_max).max() < 0.65
            assert np.abs(measured.torque / model.torque_max).max() < 0.95
            if AFTER[0] < tick.measurement.time - begin < AFTER[1]:
                speeds[arm].append(float((model.jacobian(measured.position)[:3] @ measured.velocity)[axis]))
    settled = predict_impact(ImpactProblem.at_nominal_impact(plan.scene), "settled")
    for arm, found in speeds.items():
        assert np.mean(found) == pytest.approx(settled.end_effector_twist[arm][axis], rel=NEAR[name.split("_")[0]])
