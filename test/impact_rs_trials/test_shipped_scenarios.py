# SPDX-License-Identifier: Apache-2.0
"""Shipped scenarios of robots by name: stable drives, and a trial of each with sane figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from trials import recorded

from impact_rs_analysis.measure.analyze import analyze_campaign
from impact_rs_analysis.measure.departure import MAX_CONTACT_DISTANCE_M, departures
from impact_rs_analysis.measure.net_feedback import net_feedback
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.robot_check import failures_of
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import Uncertainties
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.trial_info import VIA
from impact_rs_trials.spec import TrialSpec

# By scenario of a round object: which one, what is predicted, and when after the impact it holds [s]
ROUND = {"hit_ball": ("solid", "first", (0.015, 0.03)), "push_bottle": ("can", "settled", (0.05, 0.10))}
ROBOTS = {"push_fr3": "franka_fr3", "push_ur5e": "ur5e", "push_iiwa7": "kuka_iiwa7", "grab_fr3": "franka_fr3"}
NEAR = {"push": 0.05, "grab": 0.1}  # the weight of the box pulls at a grab until friction carries it
AFTER = (0.05, 0.10)  # s after the nominal impact: contacts have settled, and feedback has hardly changed the speed


@pytest.mark.parametrize("name", ROBOTS)
def test_a_shipped_scenario_is_that_of_its_robot_and_its_drives_are_stable(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert {robot.facts for robot in scenario.robots.values()} == {ROBOTS[name]}
    assert failures_of(scenario) == []


@pytest.mark.parametrize(
    "name", ["push_ur5e", *(pytest.param(name, marks=pytest.mark.slow) for name in ("push_fr3", "push_iiwa7"))]
)
def test_the_interval_of_a_prediction_reaches_what_an_assumed_motor_inertia_may_be(name: str) -> None:
    """From a third of the number to twice it; 10 %, as of a measured one, do not reach that far."""
    scenario = load_scenario(name)
    scene = Scene.resolve(scenario, "juice", "case_1")
    problem = ImpactProblem.at_nominal_impact(scene)

    def velocity(share: float) -> float:
        motors = {arm: share * values for arm, values in problem.motor_inertia.items()}
        return float(predict_impact(replace(problem, motor_inertia=motors)).end_effector_twist["arm"][1])

    found = [velocity(share) for share in (1.0 / 3.0, 2.0)]
    low, high = interval(problem, scenario.uncertainty, scene)
    assert low < min(found) and max(found) < high
    low, high = interval(problem, scenario.uncertainty.model_copy(update={"motor_inertia": 0.1}), scene)
    assert not low < min(found) or not max(found) < high


def interval(problem: ImpactProblem, stated: Uncertainties, scene: Scene) -> tuple[float, float]:
    """95 % interval of the arm's velocity along y [m/s]."""
    return predict(problem, stated, scene.models, draws=100).interval_of({"arm.velocity.y": 1.0})


@pytest.mark.parametrize(
    "name", ["grab_fr3", "push_ur5e", "push_iiwa7", pytest.param("push_fr3", marks=pytest.mark.slow)]
)
def test_a_trial_ends_well_within_the_limits_and_near_the_impact_map(name: str, tmp_path: Path) -> None:
    """The heaviest box: below 65 % of joint speeds and 95 % of joint torques; the map is met as in ``NEAR``."""
    scenario = load_scenario(name)
    plan = TrialSpec.of(scenario, "juice", next(iter(scenario.cases))).plan
    verdict = recorded(plan, tmp_path / "bag", seed=1)
    assert (verdict.outcome, verdict.reason) == ("OK", "")
    axis, begin, bag = scenario.axis_index, scenario.timing.nominal_impact, TrialBag.open(tmp_path / "bag")
    settled = predict_impact(ImpactProblem.at_nominal_impact(plan.scene), "settled")
    for arm, model in plan.scene.models.items():
        joints = bag.joints(topics.joint_states(arm))
        assert np.abs(joints.velocity / model.velocity_max).max() < 0.65
        assert np.abs(joints.effort / model.torque_max).max() < 0.95
        after = np.flatnonzero((AFTER[0] < joints.time - begin) & (joints.time - begin < AFTER[1]))
        speeds = [(model.jacobian(joints.position[row])[:3] @ joints.velocity[row])[axis] for row in after]
        assert np.mean(speeds) == pytest.approx(settled.end_effector_twist[arm][axis], rel=NEAR[name.split("_")[0]])


@pytest.mark.parametrize("name", ROUND)
def test_a_trial_with_a_round_object_ends_near_the_impact_map(name: str, tmp_path: Path) -> None:
    """Kills a plant that still has a box (it would slide and not roll), and a ball that is said to have tipped."""
    (object_name, contact, (begins, ends)), scenario = ROUND[name], load_scenario(name)
    plan = TrialSpec.of(scenario, object_name, "case_1").plan
    verdict = recorded(plan, tmp_path / "bag", seed=1)
    assert (verdict.outcome, verdict.reason) == ("OK", "")
    bag, model = TrialBag.open(tmp_path / "bag"), plan.scene.models["arm"]
    joints, begin = bag.joints(topics.joint_states("arm")), scenario.timing.nominal_impact
    predicted = predict_impact(ImpactProblem.at_nominal_impact(plan.scene), contact)
    after = np.flatnonzero((begins < joints.time - begin) & (joints.time - begin < ends))
    speeds = [(model.jacobian(joints.position[row])[:3] @ joints.velocity[row])[1] for row in after]
    assert np.mean(speeds) == pytest.approx(predicted.end_effector_twist["arm"][1], rel=0.05)
    pose = bag.poses(topics.OBJECT_POSE)
    angle = 2.0 * np.arccos(np.abs(pose.quaternion[-1] @ pose.quaternion[0]))
    assert (angle > 1.0) == (name == "hit_ball")  # it rolls, the can stands
    assert np.ptp(pose.position[:, 2]) < 1e-3
    (parted,) = departures(bag, {"arm": bag.controller("arm")})
    assert (parted.distance > MAX_CONTACT_DISTANCE_M) == (name == "hit_ball")  # within 0.6 s, not within 0.1 s


def test_a_trial_against_a_wall_ends_at_rest_on_it_in_both_plants(tmp_path: Path) -> None:
    """Kills a wall that falls or is pushed away in a plant, and a clamping force that makes up for its weight."""
    scenario = load_scenario("hit_wall")
    plan = TrialSpec.of(scenario, "wall", "case_1").plan
    model, begin = plan.scene.models["arm"], scenario.timing.nominal_impact
    signals = []
    for via in VIA.values():
        verdict = recorded(plan, tmp_path / via, seed=1, via=via)
        assert (verdict.outcome, verdict.reason) == ("OK", "")
        bag = TrialBag.open(tmp_path / via)
        assert abs(net_feedback(bag).net) < 0.03
        assert np.ptp(bag.poses(topics.TRUTH_OBJECT_POSE).position, axis=0).max() == 0.0
        joints = bag.joints(topics.joint_states("arm"))
        hit = [begin - 0.01 < time < begin + 0.03 for time in joints.time]
        signals.append(
            [model.jacobian(q)[1] @ dq for q, dq in zip(joints.position[hit], joints.velocity[hit], strict=True)]
        )
        resting = np.flatnonzero((joints.time - begin > 0.4) & (joints.time - begin < 0.6))
        speeds = [(model.jacobian(joints.position[row]) @ joints.velocity[row])[:3] for row in resting]
        np.testing.assert_allclose(np.mean(speeds, axis=0), 0.0, atol=2e-3)
    np.testing.assert_allclose(*signals, atol=0.03)
    (without,) = analyze_campaign(tmp_path).incomplete
    assert "wall is fixed" in without.reason


@pytest.mark.parametrize("name", ["door", "flap", "drawer"])
def test_a_trial_with_a_door_goes_alike_in_both_plants_and_as_the_map_says(name: str, tmp_path: Path) -> None:
    """Kills a door that is free in one plant, its hinge that moves, and a weight that the controller carries for it."""
    plan = TrialSpec.of(load_scenario("push_door"), name, "case_1").plan
    assert not np.any(plan.arms["arm"].wrench)
    object_, state, begin = plan.scene.physics.object, plan.scene.object, plan.scene.scenario.timing.nominal_impact
    guide = object_.guide_at(state.rotation, np.zeros(3))
    predicted = predict_impact(ImpactProblem.at_nominal_impact(plan.scene)).object_twist @ guide / (guide @ guide)
    ends = []
    for via in VIA.values():
        verdict = recorded(plan, tmp_path / via, seed=1, via=via)
        assert (verdict.outcome, verdict.reason) == ("OK", "")
        pose = TrialBag.open(tmp_path / via).poses(topics.TRUTH_OBJECT_POSE)
        axis = int(np.argmax(np.abs(guide[3:])))
        angles = 2.0 * np.arctan2(pose.quaternion[:, axis], pose.quaternion[:, 3])
        travel = pose.position[:, 1] - pose.position[0, 1] if name == "drawer" else angles
        after = np.flatnonzero((begin + 0.01 < pose.time) & (pose.time < begin + 0.04))
        speed = np.polyfit(pose.time[after], travel[after], 1)[0]
        assert speed == pytest.approx(predicted, rel=0.08)  # the pad throws it back with 0.06
        if name != "drawer":
            point = np.array([-0.25, 0.0, 0.0] if name == "door" else [0.0, 0.0, 0.3])
            hinges = [
                p + pin.Quaternion(q).matrix() @ point for p, q in zip(pose.position, pose.quaternion, strict=True)
            ]
            assert np.ptp(hinges, axis=0).max() < 1e-12
        ends.append(travel)
    np.testing.assert_allclose(*ends, atol=0.01 * np.abs(ends[0]).max())


def test_two_boxes_in_a_row_are_pushed_as_one_in_both_plants(tmp_path: Path) -> None:
    """Near the map of both; that of the first alone is 9 % off. Kills a neighbour that a plant leaves out."""
    plan = TrialSpec.of(load_scenario("push_two_boxes"), "box", "case_1").plan
    model, begin = plan.scene.models["arm"], plan.scene.scenario.timing.nominal_impact
    predicted, ends = predict_impact(ImpactProblem.at_nominal_impact(plan.scene), "settled"), []
    for via in VIA.values():
        verdict = recorded(plan, tmp_path / via, seed=1, via=via)
        assert (verdict.outcome, verdict.reason) == ("OK", "")
        bag = TrialBag.open(tmp_path / via)
        joints, pose = bag.joints(topics.joint_states("arm")), bag.poses(topics.OBJECT_POSE)
        after = np.flatnonzero((AFTER[0] < joints.time - begin) & (joints.time - begin < AFTER[1]))
        speeds = [(model.jacobian(joints.position[row])[:3] @ joints.velocity[row])[1] for row in after]
        assert np.mean(speeds) == pytest.approx(predicted.end_effector_twist["arm"][1], rel=NEAR["push"])
        ends.append(np.mean(pose.position[-50:], axis=0))
    np.testing.assert_allclose(*ends, atol=2e-3)


def test_two_arms_lift_a_cylinder_in_both_plants(tmp_path: Path) -> None:
    """By line contacts of flat pads; kills a cylinder that is a box in one of the plants."""
    plan, ends = TrialSpec.of(load_scenario("grab_cylinder"), "bottle", "case_1").plan, []
    for via in VIA.values():
        verdict = recorded(plan, tmp_path / via, seed=1, via=via)
        assert (verdict.outcome, verdict.reason) == ("OK", "")
        pose = TrialBag.open(tmp_path / via).poses(topics.OBJECT_POSE)
        assert pose.position[-1, 2] - pose.position[0, 2] > 0.1
        ends.append(np.mean(pose.position[-50:], axis=0))
    np.testing.assert_allclose(*ends, atol=0.01)
