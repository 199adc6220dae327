# SPDX-License-Identifier: Apache-2.0
"""Messages say what was measured and decided: stamps, frames, axes and order of every field."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of, ticks_of

from impact_rs_control.controller import ArmCommand, ImpactDetection, Mode
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.plant.plant import ArmTruth
from impact_rs_sim.plant.sensors import ArmMeasurement, ObjectMeasurement
from impact_rs_sim.scene import BodyState
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import Frame, MessageMaker, RosbagsTypes, reference_columns
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.bags.types import typestore

TICK = 1234  # 1.234 s
SEVEN = np.arange(7, dtype=float)


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_of("push", "juice", "case_1", 0.9)


@pytest.fixture(scope="module")
def maker(plan: TrialPlan) -> MessageMaker:
    return MessageMaker(RosbagsTypes(), plan)


@pytest.mark.parametrize(("tick", "stamp"), [(0, (0, 0)), (TICK, (1, 234_000_000)), (2000, (2, 0))])
def test_a_stamp_is_the_trial_time_of_its_tick(maker: MessageMaker, tick: int, stamp: tuple[int, int]) -> None:
    header = maker.header(tick)
    assert (header.stamp.sec, header.stamp.nanosec) == stamp
    assert maker.nanoseconds(tick) == stamp[0] * 1_000_000_000 + stamp[1]
    assert header.frame_id == "world"


def test_joint_topics_carry_each_signal_in_its_own_field(maker: MessageMaker) -> None:
    measured = ArmMeasurement(*(SEVEN + 10.0 * number for number in range(5)))
    state = maker.joint_states(TICK, "arm", measured)
    np.testing.assert_array_equal(state.position, SEVEN)
    np.testing.assert_array_equal(state.velocity, SEVEN + 10.0)
    np.testing.assert_array_equal(state.effort, SEVEN + 20.0)
    assert state.name == [f"arm_joint{number}" for number in range(1, 8)]
    motors = maker.motor_states(TICK, "arm", measured)
    np.testing.assert_array_equal(motors.position, SEVEN + 30.0)
    np.testing.assert_array_equal(motors.velocity, SEVEN + 40.0)
    assert motors.effort.size == 0
    command = maker.joint_command(TICK, "arm", SEVEN)
    np.testing.assert_array_equal(command.effort, SEVEN)
    assert command.position.size == command.velocity.size == 0


def command(**changes: object) -> ArmCommand:
    values = {
        "torque": SEVEN,
        "mode": Mode.INTERIM,
        "gamma": 0.25,
        "position": np.array([1.0, 2.0, 3.0]),
        "twist": np.arange(6.0),
        "task_feedback": np.arange(7.0) + 100.0,
        "net_feedback": np.array([7.0, 8.0, 9.0]),
        "wrench": np.arange(6.0) + 50.0,
        "qp_status": QpStatus.RELAXED,
        "qp_iterations": 12,
        "qp_solve_time": 3e-5,
        "detection": None,
    }
    return ArmCommand(**{**values, **changes})


def test_a_controller_state_holds_the_references_of_its_own_tick(maker: MessageMaker, plan: TrialPlan) -> None:
    message = maker.controller_state(TICK, "arm", command())
    arm = plan.arms["arm"]
    for phase, path, posture in (
        ("ante", arm.ante_position, arm.ante_posture),
        ("post", arm.post_position, arm.post_posture),
    ):
        for name in ("position", "velocity", "acceleration"):
            np.testing.assert_array_equal(getattr(message, f"{phase}_{name}"), getattr(path, name)[TICK])
        expected = [posture.position[TICK, 0], posture.velocity[TICK, 0], posture.acceleration[TICK, 0]]
        np.testing.assert_array_equal(getattr(message, f"{phase}_posture"), expected)
    assert np.any(message.ante_velocity != message.post_velocity)


def test_a_controller_state_holds_what_was_decided(maker: MessageMaker) -> None:
    message = maker.controller_state(TICK, "arm", command())
    assert (message.robot, message.mode, message.gamma) == ("arm", 1, 0.25)
    np.testing.assert_array_equal(message.feedback_acceleration, [100.0, 101.0, 102.0])
    np.testing.assert_array_equal(message.net_feedback, [7.0, 8.0, 9.0])
    np.testing.assert_array_equal(message.twist, np.arange(6.0))
    np.testing.assert_array_equal(message.external_wrench, np.arange(6.0) + 50.0)
    np.testing.assert_array_equal(message.commanded_torque, SEVEN)
    assert (message.qp_status, message.qp_iterations, message.qp_solve_time) == (1, 12, 3e-5)


def test_an_impact_event_tells_when_how_hard_and_against_what(maker: MessageMaker) -> None:
    detection = ImpactDetection(0.901, 33.0, 15.0, np.arange(6.0), np.arange(6.0) + 10.0)
    message = maker.impact_event(TICK, "arm", detection)
    assert (message.detected_time, message.residual, message.threshold) == (0.901, 33.0, 15.0)
    np.testing.assert_array_equal(message.external_wrench, np.arange(6.0))
    np.testing.assert_array_equal(message.twist, np.arange(6.0) + 10.0)


def test_a_message_tells_each_number_once(maker: MessageMaker) -> None:
    """Kills: a second field with the same twist, which every tick of every bag pays for."""
    decided = command(twist=np.arange(6.0) + 0.25, wrench=np.arange(6.0) + 0.75)
    detection = ImpactDetection(0.9, 12.0, 10.0, decided.wrench, decided.twist)
    for message in (maker.controller_state(3, "arm", decided), maker.impact_event(3, "arm", detection)):
        data = bytes(typestore().serialize_cdr(message, message.__msgtype__))
        for vector in (decided.twist, decided.wrench):
            assert data.count(vector.tobytes()) == 1


def test_poses_tell_the_quaternion_as_x_y_z_w_and_the_truth_as_it_is(maker: MessageMaker) -> None:
    turn = pin.rpy.rpyToMatrix(0.1, 0.2, 0.9)
    quaternion = np.array(pin.Quaternion(turn).coeffs())
    place = np.array([0.4, -0.2, 0.5])
    for message in (
        maker.object_pose(TICK, ObjectMeasurement(1.234, place, quaternion)),
        maker.truth_object_pose(TICK, BodyState(place, turn, np.zeros(6))),
    ):
        found = message.pose
        np.testing.assert_array_equal([found.position.x, found.position.y, found.position.z], place)
        given = found.orientation
        np.testing.assert_allclose(pin.Quaternion(given.w, given.x, given.y, given.z).matrix(), turn, atol=1e-12)
    twist = maker.truth_object_twist(TICK, BodyState(place, turn, np.arange(6.0))).twist
    assert [twist.linear.x, twist.linear.y, twist.linear.z] == [0.0, 1.0, 2.0]
    assert [twist.angular.x, twist.angular.y, twist.angular.z] == [3.0, 4.0, 5.0]


def test_the_contact_wrench_is_the_force_on_the_pad(maker: MessageMaker) -> None:
    truth = ArmTruth(SEVEN, SEVEN, SEVEN, SEVEN, SEVEN, np.array([1.0, -2.0, 3.0]))
    force = maker.truth_contact_wrench(TICK, truth).wrench.force
    assert [force.x, force.y, force.z] == [1.0, -2.0, 3.0]


def test_transforms_place_every_frame_in_its_parent(maker: MessageMaker) -> None:
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, 0.0), np.array([1.0, 2.0, 3.0]))
    frames = [Frame("world", "a", placement), Frame("a", "b", pin.SE3.Identity())]
    found = maker.transforms(TICK, frames).transforms
    assert [entry.child_frame_id for entry in found] == ["a", "b"]
    assert [entry.header.frame_id for entry in found] == ["world", "a"]
    place, turn = found[0].transform.translation, found[0].transform.rotation
    assert [place.x, place.y, place.z] == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(pin.Quaternion(turn.w, turn.x, turn.y, turn.z).matrix(), placement.rotation)


def test_reference_columns_have_a_row_per_tick(plan: TrialPlan) -> None:
    columns = reference_columns(plan.arms["arm"])
    ticks = plan.scene.scenario.timing.ticks + 1
    assert {values.shape for values in columns.values()} == {(ticks, 3)}
    assert len(columns) == 8


# ---- identity of a trial --------------------------------------------------------------------------------------------


KEY = TrialKey("juice", "case_1", 0.9, 3)


@pytest.fixture(scope="module")
def info(plan: TrialPlan) -> TrialInfo:
    return TrialInfo.of(plan, KEY, KEY.seed(5), "inprocess", "model text")


def test_it_says_what_was_planned(info: TrialInfo, plan: TrialPlan) -> None:
    assert info.key == KEY
    assert info.predicted_post_velocity == plan.predicted_post_velocity
    assert info.reference_post_velocity == pytest.approx(0.9 * info.predicted_post_velocity)
    assert info.ante_velocity == -0.5
    assert (info.window_start, info.window_end, info.nominal_impact_time) == pytest.approx((0.8, 1.5, 0.9))
    assert (info.robots, info.axis, info.duration) == (("arm",), "y", 1.8)
    assert (info.motor_inertia, info.via, info.model_yaml) == ("reduced", "inprocess", "model text")


def test_the_trial_can_be_planned_again_from_it(info: TrialInfo, plan: TrialPlan) -> None:
    again = info.spec.plan
    assert again is info.spec.plan
    assert again.scene.scenario == plan.scene.scenario
    np.testing.assert_array_equal(again.arms["arm"].post_position.position, plan.arms["arm"].post_position.position)


def test_a_message_holds_every_field(info: TrialInfo, plan: TrialPlan) -> None:
    assert TrialInfo.from_message(MessageMaker(RosbagsTypes(), plan).trial_info(info)) == info
    assert set(info.values()) == {name for name, _ in typestore().fielddefs["impact_rs/msg/TrialInfo"][1]}


def test_a_message_of_version_0_1_0_is_read_by_its_former_names(info: TrialInfo) -> None:
    values = info.values()
    values["scenario_yaml"] = values.pop("scenario_json")
    assert TrialInfo.from_message(SimpleNamespace(**values)) == info


def test_a_message_that_lacks_a_field_is_of_another_kind(info: TrialInfo) -> None:
    values = info.values()
    del values["axis"]
    with pytest.raises(AttributeError, match="axis"):
        TrialInfo.from_message(SimpleNamespace(**values))


def test_bag_names_are_unique_and_seeds_follow_from_them() -> None:
    assert KEY.name == "juice__case_1__s0.900__r3"
    keys = [TrialKey("juice", "case_1", scale, repeat) for scale in (0.8, 1.0) for repeat in range(3)]
    assert len({key.name for key in keys}) == len(keys)
    seeds = {(campaign, key): key.seed(campaign) for campaign in (0, 1) for key in keys}
    assert len(set(seeds.values())) == len(seeds)
    assert keys[0].seed(0) == TrialKey("juice", "case_1", 0.8, 0).seed(0)


# ---- a burst of samples becomes, byte for byte, the messages that it stands for -------------------------------------


STORE = typestore()


@pytest.fixture(scope="module")
def brief_plan() -> TrialPlan:
    timing = {"nominal_impact": 0.02, "approach": 0.02, "window_before": 0.01, "window_after": 0.01, "duration": 0.03}
    return plan_of("push", "juice", "case_1", **timing)


@pytest.fixture(scope="module")
def samples(brief_plan: TrialPlan) -> list[tuple[int, Any, Any, Any]]:
    """Tick, measurement, truth and command of every tick."""
    return [
        (tick.number, tick.measurement.arms["arm"], truth.arms["arm"], tick.commands["arm"])
        for tick, truth in ticks_of(brief_plan)
    ]


Case = tuple[str, Callable[[StreamMaker], Stream], Callable[[MessageMaker, int, tuple], Any], int]
CASES: dict[str, Case] = {
    "joint states": (
        topics.JOINT_STATE, lambda m: m.joint_states("arm"), lambda m, t, s: m.joint_states(t, "arm", s), 1
    ),
    "motor states": (
        topics.JOINT_STATE, lambda m: m.motor_states("arm"), lambda m, t, s: m.motor_states(t, "arm", s), 1
    ),
    "true states": (
        topics.JOINT_STATE, lambda m: m.joint_states("arm"), lambda m, t, s: m.joint_states(t, "arm", s), 2
    ),
    "contact wrench": (
        topics.WRENCH, lambda m: m.contact_wrench("arm"), lambda m, t, s: m.truth_contact_wrench(t, s), 2
    ),
    "joint command": (
        topics.JOINT_STATE, lambda m: m.joint_command("arm"), lambda m, t, s: m.joint_command(t, "arm", s.torque), 3
    ),
    "controller state": (
        topics.CONTROLLER_STATE,
        lambda m: m.controller_state("arm"),
        lambda m, t, s: m.controller_state(t, "arm", s),
        3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_burst_is_what_the_messages_one_by_one_would_be(brief_plan: TrialPlan, samples: list, name: str) -> None:
    kind, make, message, which = CASES[name]
    stream, maker = make(StreamMaker(brief_plan)), MessageMaker(RosbagsTypes(), brief_plan)
    for entry in samples:
        stream.add(entry[0], entry[which])
    expected = [bytes(STORE.serialize_cdr(message(maker, entry[0], entry[which]), kind)) for entry in samples]
    assert stream.take() == ([maker.nanoseconds(entry[0]) for entry in samples], expected)
    assert stream.take() == ([], [])


def test_a_sample_that_is_awaited_is_the_same_as_in_a_burst(brief_plan: TrialPlan, samples: list) -> None:
    stream = StreamMaker(brief_plan).joint_states("arm")
    for tick, measured, _, _ in samples[:3]:
        stream.add(tick, measured)
    assert stream.take()[1] == [stream.serialized(tick, measured) for tick, measured, _, _ in samples[:3]]


def test_a_sample_kept_after_a_burst_belongs_to_the_next(brief_plan: TrialPlan, samples: list) -> None:
    stream = StreamMaker(brief_plan).joint_command("arm")
    (first, *_, one), (second, *_, other) = samples[0], samples[1]
    stream.add(first, one)
    stream.take()
    stream.add(second, other)
    _, (row,) = stream.take()
    np.testing.assert_array_equal(STORE.deserialize_cdr(row, topics.JOINT_STATE).effort, other.torque)
