# SPDX-License-Identifier: Apache-2.0
"""Messages say what was measured and decided: stamps, frames, axes and order of every field."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of

from impact_rs_control.controller import ArmCommand, ImpactDetection, Mode
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.plant import ArmTruth
from impact_rs_sim.scene import BodyState
from impact_rs_sim.sensors import ArmMeasurement, ObjectMeasurement
from impact_rs_trials.bags.messages import Frame, MessageMaker, RosbagsTypes, reference_columns

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


def test_twist_and_wrench_are_there_as_messages_of_geometry_too(maker: MessageMaker) -> None:
    decided = command(twist=np.arange(6.0), wrench=np.arange(6.0, 12.0))
    detection = ImpactDetection(0.9, 12.0, 10.0, decided.wrench, decided.twist)
    for message in (maker.controller_state(3, "arm", decided), maker.impact_event(3, "arm", detection)):
        twist, wrench = message.end_effector_twist, message.end_effector_wrench
        for part, numbers in (
            (twist.linear, message.twist[:3]),
            (twist.angular, message.twist[3:]),
            (wrench.force, message.external_wrench[:3]),
            (wrench.torque, message.external_wrench[3:]),
        ):
            np.testing.assert_array_equal([part.x, part.y, part.z], numbers)


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
