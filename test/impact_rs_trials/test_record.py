# SPDX-License-Identifier: Apache-2.0
"""A short trial as a bag: every topic at its rate, transforms from measurements, numbers as the loop had them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from trials import BRIEF, plan_of, recorded, ticks_of

from impact_rs_control.plan import TrialPlan
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import Frame
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.record import FrameSource, descriptions, record_trial
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey

TICKS = 250


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    """A trial of a quarter of a second."""
    return plan_of("push", "juice", "case_1", **BRIEF)


@pytest.fixture(scope="module")
def bag(plan: TrialPlan, tmp_path_factory: pytest.TempPathFactory) -> TrialBag:
    path = tmp_path_factory.mktemp("record") / "trial"
    verdict = recorded(plan, path, seed=3)
    assert verdict.outcome == "OK", verdict.reason
    return TrialBag.open(path)


@pytest.fixture(scope="module")
def ticks(plan: TrialPlan) -> list:
    """The same trial once more, without a bag."""
    return ticks_of(plan, 3)


def test_every_topic_has_its_rate(bag: TrialBag) -> None:
    expected = {
        topics.joint_states("arm"): TICKS + 1,
        topics.motor_states("arm"): TICKS + 1,
        topics.joint_command("arm"): TICKS + 1,
        topics.controller_state("arm"): TICKS + 1,
        topics.truth_joint_states("arm"): TICKS + 1,
        topics.truth_contact_wrench("arm"): TICKS + 1,
        topics.OBJECT_POSE: TICKS // 4 + 1,
        topics.TRUTH_OBJECT_POSE: TICKS // 4 + 1,
        topics.TF: TICKS // 20 + 1,
        topics.TF_STATIC: 1,
        topics.CLOCK: TICKS // 20 + 1,
        topics.impact_event("arm"): 1,
        topics.TRIAL_INFO: 1,
        topics.ROBOT_DESCRIPTION: 1,
    }
    assert {name: bag.counts[name] for name in expected} == expected


def test_columns_hold_what_the_loop_measured_and_decided(bag: TrialBag, ticks: list) -> None:
    joints, states = bag.joints(topics.joint_states("arm")), bag.controller("arm")
    motors, truth = bag.joints(topics.motor_states("arm")), bag.joints(topics.truth_joint_states("arm"))
    commands = bag.joints(topics.joint_command("arm"))
    np.testing.assert_allclose(joints.time, np.arange(TICKS + 1) * 1e-3, atol=1e-12)
    for row, (tick, true) in enumerate(ticks):
        measured, command = tick.measurement.arms["arm"], tick.commands["arm"]
        np.testing.assert_array_equal(joints.position[row], measured.position)
        np.testing.assert_array_equal(joints.velocity[row], measured.velocity)
        np.testing.assert_array_equal(joints.effort[row], measured.torque)
        np.testing.assert_array_equal(motors.position[row], measured.motor_position)
        np.testing.assert_array_equal(truth.position[row], true.arms["arm"].position)
        np.testing.assert_array_equal(commands.effort[row], command.torque)
        np.testing.assert_array_equal(states.feedback_acceleration[row], command.feedback)
        np.testing.assert_array_equal(states.net_feedback[row], command.net_feedback)
    detected = next(tick.commands["arm"].detection for tick, _ in ticks if tick.commands["arm"].detection)
    assert bag.impact_time("arm") == pytest.approx(detected.time)
    assert np.isnan(bag.impact_time("nobody"))


def test_poses_of_the_object_are_those_of_the_tracker_and_of_the_truth(bag: TrialBag, ticks: list) -> None:
    seen = [tick.measurement.object for tick, _ in ticks if tick.measurement.object is not None]
    poses = bag.poses(topics.OBJECT_POSE)
    np.testing.assert_array_equal(poses.position, [each.position for each in seen])
    np.testing.assert_array_equal(poses.quaternion, [each.quaternion for each in seen])
    np.testing.assert_allclose(poses.time, [each.time for each in seen], atol=1e-12)
    true = [state.object.position for _, state in ticks if state.object is not None]
    np.testing.assert_array_equal(bag.poses(topics.TRUTH_OBJECT_POSE).position, true)


@pytest.fixture(scope="module")
def two_boxes(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrialBag, list]:
    """A trial with a neighbour, recorded, and once more without a bag."""
    plan = plan_of("push_two_boxes", "box", "case_1", **BRIEF)
    path = tmp_path_factory.mktemp("two_boxes") / "trial"
    assert recorded(plan, path, seed=3).outcome == "OK"
    return TrialBag.open(path), ticks_of(plan, 3)


def test_a_neighbour_is_in_the_bag_as_the_object_is(two_boxes: tuple[TrialBag, list]) -> None:
    bag, ticks = two_boxes
    seen = [tick.measurement.neighbours["behind"] for tick, _ in ticks if tick.measurement.neighbours]
    poses, true = bag.poses(topics.pose("behind")), bag.poses(topics.truth_pose("behind"))
    np.testing.assert_array_equal(poses.position, [each.position for each in seen])
    np.testing.assert_array_equal(poses.quaternion, [each.quaternion for each in seen])
    np.testing.assert_allclose(poses.time, bag.poses(topics.OBJECT_POSE).time, atol=1e-12)
    states = [state.neighbours["behind"] for _, state in ticks if state.neighbours]
    np.testing.assert_array_equal(true.position, [each.position for each in states])
    twists = [message.twist.linear.y for message in bag.messages(topics.truth_twist("behind"))]
    np.testing.assert_array_equal(twists, [each.twist[1] for each in states])
    assert twists[-1] < -0.1 < twists[0]  # it is pushed along -y
    noise = [bag.poses(measured).position - bag.poses(real).position for measured, real in (
        (topics.OBJECT_POSE, topics.TRUTH_OBJECT_POSE), (topics.pose("behind"), topics.truth_pose("behind"))
    )]  # fmt: skip
    assert all(0.5e-4 < own.std() < 2e-4 for own in noise)
    assert abs(np.corrcoef(*(own.ravel() for own in noise))[0, 1]) < 0.3  # each has its own
    (urdf,) = bag.messages(topics.robot_description("behind"))
    assert 'link name="behind"' in urdf.data and 'mass value="0.6"' in urdf.data
    assert {"object", "behind"} <= {one.child_frame_id for one in bag.messages(topics.TF)[0].transforms}
    assert bag.missing == [] and bag.info.neighbours == ("behind",)
    signals = bag.run().signals
    np.testing.assert_array_equal(signals.neighbours["behind"].position, poses.position)


def test_an_old_bag_without_its_neighbours_is_read(
    two_boxes: tuple[TrialBag, list], tmp_path: Path, rewrite_bag: Callable
) -> None:
    rewrite_bag(two_boxes[0].path, tmp_path / "old", lambda topic: "/behind" not in topic)
    old = TrialBag.open(tmp_path / "old")
    signals = old.run().signals
    assert signals.object_time.size and signals.neighbours["behind"].time.size == 0
    assert topics.pose("behind") in old.missing


def test_frames_follow_measured_joints_and_the_last_object_pose(plan: TrialPlan) -> None:
    frames = FrameSource(plan.scene)
    q = plan.scene.arms["arm"].position
    place, turn = np.array([0.4, -0.3, 0.5]), pin.rpy.rpyToMatrix(0.0, 0.0, 0.4)
    quaternion = np.array(pin.Quaternion(turn).coeffs())
    first = in_world([*frames.static, *frames.at({"arm": q}, {})])
    np.testing.assert_allclose(first["object"].translation, plan.scene.object.position)
    np.testing.assert_allclose(
        first["arm_end_effector"].homogeneous, plan.scene.models["arm"].placement(q).homogeneous, atol=1e-12
    )
    frames.at({"arm": q}, {"object": (place, quaternion)})
    later = in_world([*frames.static, *frames.at({"arm": q}, {})])
    np.testing.assert_allclose(later["object"].translation, place)
    np.testing.assert_allclose(later["object"].rotation, turn, atol=1e-12)
    assert [tick for tick in range(45) if frames.due(tick)] == [0, 20, 40]


def test_frames_in_a_namespace_have_its_prefix_and_the_same_poses(plan: TrialPlan) -> None:
    q = {"arm": plan.scene.arms["arm"].position}
    sources = FrameSource(plan.scene), FrameSource(plan.scene, "cell_a/")
    alone, beside = ([*source.static, *source.at(q, {})] for source in sources)
    assert [(frame.parent, frame.name) for frame in beside if frame.parent == "world"] == [("world", "cell_a/world")]
    expected, found = in_world(alone), in_world(beside)
    assert set(found) - {"cell_a/world"} == {f"cell_a/{name}" for name in expected}
    for name, placement in expected.items():
        np.testing.assert_array_equal(found[f"cell_a/{name}"].homogeneous, placement.homogeneous)


def test_frames_that_never_move_are_static_and_no_others(plan: TrialPlan, bag: TrialBag) -> None:
    frames = FrameSource(plan.scene)
    assert [frame.name for frame in frames.static] == ["support", "arm_base", "arm_end_effector", "arm_pad"]
    moving = frames.at({"arm": plan.scene.arms["arm"].position}, {})
    assert [frame.name for frame in moving] == [*(f"arm_link{number}" for number in range(1, 8)), "object"]
    beside = FrameSource(plan.scene, "cell_a/")
    assert [frame.name for frame in beside.static[:2]] == ["cell_a/world", "cell_a/support"]
    (recorded,) = bag.messages(topics.TF_STATIC)
    assert [one.child_frame_id for one in recorded.transforms] == [frame.name for frame in frames.static]
    assert {one.child_frame_id for one in bag.messages(topics.TF)[0].transforms} == {frame.name for frame in moving}


def test_robot_state_publisher_may_publish_the_links_and_then_nobody_else_does(plan: TrialPlan) -> None:
    """Two publishers of one frame would make it jump: no link is left, and all that is no link is still there."""
    q = {"arm": plan.scene.arms["arm"].position}
    every, rest = FrameSource(plan.scene), FrameSource(plan.scene, links=False)
    model = pin.buildModelFromXML(descriptions(plan.scene.physics)[topics.robot_description("arm")])
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY} - {"universe", "world"}
    names = [{one.name for one in (*source.static, *source.at(q, {}))} for source in (every, rest)]
    assert (names[0] - names[1], names[1]) == (links, {"support", "arm_pad", "object"})


def test_the_pad_is_where_its_tilt_and_offset_put_it(plan: TrialPlan) -> None:
    arm = plan.scene.physics.arms["arm"]
    effector = replace(arm.end_effector, pad_tilt=(0.1, 0.0), pad_offset=(0.0, 0.02, 0.0))
    scene = replace(plan.scene, physics=replace(plan.scene.physics, arms={"arm": replace(arm, end_effector=effector)}))
    (pad,) = (frame for frame in FrameSource(scene).static if frame.name == "arm_pad")
    assert pad.parent == "arm_end_effector"
    face = pad.placement.act(np.array([0.0, 0.0, effector.pad_size[2] / 2.0]))
    np.testing.assert_allclose(face, [0.0, 0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(pad.placement.rotation[:, 2], [0.0, -np.sin(0.1), np.cos(0.1)], atol=1e-12)


def in_world(frames: list[Frame]) -> dict[str, pin.SE3]:
    """Placement of every frame in the world, in whatever order they are told."""
    above = {frame.name: frame for frame in frames}
    assert len(above) == len(frames), "a frame has one parent"

    def placement(name: str) -> pin.SE3:
        return pin.SE3.Identity() if name == "world" else placement(above[name].parent) * above[name].placement

    return {name: placement(name) for name in above}


def test_a_trial_that_hits_nothing_says_so(plan: TrialPlan, tmp_path: Path) -> None:
    away = replace(plan.scene.object, position=plan.scene.object.position + [0.6, 0.0, 0.0])
    missed = replace(plan, scene=replace(plan.scene, object=away))
    info = TrialInfo.of(missed, TrialKey("juice", "case_1", 1.0, 0), 3, "inprocess")
    verdict, net = record_trial(missed, info, tmp_path / "trial")
    assert (verdict.outcome, verdict.reason) == ("NO-IMPACT", "arm detected no impact")
    found = TrialBag.open(tmp_path / "trial")
    assert (found.outcome, found.reason) == (verdict.outcome, verdict.reason)
    np.testing.assert_array_equal(found.controller("arm").net_feedback[-1], net["arm"])
    assert found.metadata["object"] == "juice"
    assert "scenario_json" not in found.metadata
    assert found.info == info
