# SPDX-License-Identifier: Apache-2.0
"""A state of the robot is usable if it is new, fresh, complete, within limits and agrees with the states before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from robot_bench import GRAB, JOINTS, LIMIT, MODEL, PERIOD, START, WEIGHT, Robot, state_message
from rosgraph_msgs.msg import Clock

from impact_msgs_py.conversions import pose_from_message, pose_to_message
from impact_rs_ros import robot_clock
from impact_rs_ros.motion_capture import TrackerPoses
from impact_rs_ros.robot_clock import MAX_CLOCK_SILENCE_S, RobotClock
from impact_rs_ros.robot_states import EXTRA, StateReader, joint_names
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics


def test_a_usable_state_is_the_latest_and_ages() -> None:
    robot = Robot()
    assert robot.states.age == np.inf
    states = robot.state(age=0.004)
    assert states.complaint == "" and robot.states.latest is states
    np.testing.assert_array_equal(states.arms["arm"].position, START)
    assert robot.states.age == pytest.approx(0.004)
    robot.clock.time += 0.5
    assert robot.states.age == pytest.approx(0.504)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"velocity": np.array([np.nan, 0, 0, 0, 0, 0, 0])}, "velocity of fr3_joint1 is nan"),
        ({"effort": np.array([0, 0, 0, 0, 0, 0, -np.inf])}, "effort of fr3_joint7 is -inf"),
        ({"effort": np.array([0, 0, 1e6, 0, 0, 0, 0])}, "fr3_joint3 measures 1e+06 N m, more than 5 times its limit"),
        ({"position": np.full(3, 0.1)}, "3 values of position, expected 7"),
        ({"effort": np.zeros(8)}, "8 values of effort, expected 7"),
        ({"velocity": np.zeros(0)}, "0 values of velocity, expected 7"),
        ({"names": JOINTS[:6] + ["finger"]}, "no fr3_joint7 among fr3_joint1"),
        ({"names": JOINTS[:6] + ["fr3_joint6"]}, "no fr3_joint7"),
        (
            {"names": [*JOINTS, "fr3_joint2"], **{k: np.zeros(8) for k in ("position", "velocity", "effort")}},
            "fr3_joint2 is 2 times in one message",
        ),
        ({"position": START + [0, 0, 3.0, 0, 0, 0, 0]}, "fr3_joint3 at "),
        ({"velocity": np.array([0, 0, 0, 0, 3.0, 0, 0])}, "fr3_joint5 at 3 rad/s, limit "),
        ({"age": LIMIT + 1e-4}, "the robot's state is 0.0101 s old, state_timeout is 0.01 s"),
        ({"age": -PERIOD - 1e-4}, "the robot's state is stamped 0.0011 s in the future, by this machine's clock"),
        (
            {"position": START + [0, 0.1, 0, 0, 0, 0, 0]},
            "position of fr3_joint2 changed by 0.1 rad more than its velocity",
        ),
    ],
)
def test_a_state_that_is_not_usable_says_why_and_leaves_the_latest_one(
    changes: dict[str, object], complaint: str
) -> None:
    robot = Robot()
    before = robot.state()
    robot.clock.time += 0.02
    found = robot.state(**changes)
    assert found.complaint.startswith(complaint)
    assert found.stamp == robot.clock.now() - round(1e9 * changes.get("age", 0.0))
    assert robot.states.latest is before
    assert robot.states.age == pytest.approx(PERIOD + 0.02)


def test_stamps_at_the_limits_are_usable() -> None:
    robot = Robot()
    assert robot.state(age=LIMIT).complaint == ""
    assert robot.state(age=-PERIOD).complaint == ""


def test_a_frozen_encoder_is_noticed_under_control_and_not_at_rest() -> None:
    for led in (True, False):
        robot, complaints = Robot(), set()
        for step in range(200):
            if led:
                robot.states.commanded["arm"] = WEIGHT + 0.2 * MODEL.torque_max * np.sin(0.05 * step)
            complaints.add(robot.state().complaint)
        assert any("a frozen sensor" in complaint for complaint in complaints) is led


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0" * 7, bytes(range(256)) * 4, b"\0\1\0\0" + b"\xff" * 60])
def test_bytes_that_are_no_message_are_silence_and_counted(data: bytes) -> None:
    robot = Robot()
    before = robot.state()
    assert robot.states.read(data) is robot.states.read(data) is None
    assert robot.states.latest is before
    assert robot.states.unreadable == 2


def test_a_repeated_state_is_no_sign_of_life_and_many_are_a_complaint() -> None:
    robot = Robot()
    robot.state()
    message = robot.message()
    for _ in range(EXTRA):
        robot.clock.time += 1e-5
        assert robot.states.read(message) is None
    assert robot.states.age == pytest.approx(EXTRA * 1e-5)
    assert "are there two publishers of these joints?" in robot.states.read(message).complaint


def test_a_second_robot_on_the_same_topic_is_noticed_by_its_stamps() -> None:
    robot, complaints = Robot(), []
    for _ in range(60):
        complaints.append(robot.state().complaint)
        robot.clock.time += 0.3 * PERIOD
        found = robot.states.read(robot.message(position=START + 1e-3))
        complaints.append("" if found is None else found.complaint)
        robot.clock.time -= 0.3 * PERIOD
    assert any("two publishers of these joints" in complaint for complaint in complaints)


def test_stamps_that_jitter_by_a_third_of_the_period_are_one_robots() -> None:
    rng, robot = np.random.default_rng(3), Robot()
    found = [robot.state(age=float(age)) for age in rng.uniform(0.0, 0.3 * PERIOD, 300)]
    assert all(states is not None and states.complaint == "" for states in found)


def test_a_robot_restarted_with_an_earlier_clock_is_old_not_repeated() -> None:
    robot = Robot()
    robot.state()
    assert "old, state_timeout" in robot.state(age=1000.0).complaint


def test_joints_are_found_among_others_and_messages_of_others_ignored() -> None:
    reader = StateReader(joint_names("{arm}_fr3_joint{number}", {"left": 2, "right": 2}))

    def read(names: list[str]):  # noqa: ANN202
        numbers = [float(1 + index) for index in range(len(names))]
        finger = [np.nan if name == "finger" else value for name, value in zip(names, numbers, strict=True)]
        return reader.read(state_message(0, np.array(numbers), np.array(numbers), np.array(finger), names))

    found = read(["right_fr3_joint2", "finger", "left_fr3_joint1", "right_fr3_joint1", "left_fr3_joint2"])
    assert found.complaint == ""
    np.testing.assert_array_equal(found.arms["left"].position, [3.0, 5.0])
    np.testing.assert_array_equal(found.arms["right"].torque, [4.0, 1.0])
    assert read(["finger", "other_finger"]) is None


@pytest.mark.parametrize(("pattern", "missing"), [("fr3_joint{number}", "{arm}"), ("{arm}_joint", "{number}")])
def test_joints_of_two_arms_need_names_of_their_own(pattern: str, missing: str) -> None:
    with pytest.raises(InputError, match=f"expected {missing} in it: 14 joints of ") as error:
        joint_names(pattern, {arm: GRAB.scene.models[arm].joint_count for arm in GRAB.arms})
    assert error.value.key == "joints"
    assert len(set(sum(joint_names("{arm}_{number}", {"a": 7, "b": 7}).values(), []))) == 14


def test_a_state_that_was_overtaken_is_no_new_one() -> None:
    robot = Robot()
    newest = robot.state()
    assert robot.states.read(robot.message(age=0.3 * LIMIT)) is None
    assert robot.states.latest is newest


def test_the_largest_age_of_a_state_is_kept() -> None:
    robot = Robot()
    for age in (0.2 * LIMIT, 0.7 * LIMIT, 0.1 * LIMIT):
        robot.clock.time += LIMIT
        assert robot.state(age=age).complaint == ""
    assert robot.states.oldest == pytest.approx(0.7 * LIMIT)


def test_the_motors_of_a_robot_are_where_its_links_are() -> None:
    measured = Robot().state(velocity=np.full(7, 1e-3)).arms["arm"]
    np.testing.assert_array_equal(measured.motor_position, measured.position)
    np.testing.assert_array_equal(measured.motor_velocity, measured.velocity)


class Simulator:
    """What waits on ``/clock``, and how late it is in this room."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.waiting: list[Clock] = []
        self.room = 1000.0
        outer = self

        class Topic:
            def __init__(self, node: object, qos: object) -> None:
                self.connect = self.gather = lambda *arguments: None
                self.clear = outer.waiting.clear

            def take(self) -> Iterator[tuple[str, Clock]]:
                while outer.waiting:
                    yield topics.CLOCK, outer.waiting.pop(0)

        monkeypatch.setattr(robot_clock, "Inbox", Topic)
        monkeypatch.setattr(robot_clock, "value", lambda node, name: name == "use_sim_time")
        monkeypatch.setattr(robot_clock.time, "monotonic", lambda: self.room)
        self.clock = RobotClock(None)  # type: ignore[arg-type]

    def tick(self, seconds: float) -> None:
        nanoseconds = round(1e9 * seconds)
        self.waiting.append(Clock(clock=Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)))


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> Simulator:
    return Simulator(monkeypatch)


def test_simulated_time_is_unknown_until_published_and_after_a_restart(
    simulator: Simulator,
) -> None:
    clock = simulator.clock
    assert not clock.known
    simulator.tick(2.000000005)
    assert clock.known
    assert clock.now() == 2_000_000_005
    simulator.tick(3.0)  # of the one that has ended
    clock.forget()
    assert not clock.known


def test_simulated_time_is_not_before_the_newest_state(simulator: Simulator) -> None:
    """Else states would come from the future wherever ``/clock`` takes longer; a robot's stamps alone are no clock."""
    clock = simulator.clock
    clock.saw(7 * 10**9)
    assert not clock.known and clock.now() == 0
    simulator.tick(6.0)
    assert clock.now() == 7 * 10**9
    simulator.tick(8.0)
    assert clock.now() == 8 * 10**9


def test_time_follows_a_slow_simulator_and_the_machine_once_it_stops(simulator: Simulator) -> None:
    clock = simulator.clock
    simulator.tick(50.0)
    begin = clock.steady()
    for step in range(1, 11):  # a hundred times slower than the room
        simulator.room += 0.1
        simulator.tick(50.0 + 0.001 * step)
        assert clock.steady() - begin == pytest.approx(0.001 * step)
    for _ in range(20):
        simulator.room += 0.1
        clock.steady()
    assert clock.steady() - begin == pytest.approx(0.01 + 2.0 - MAX_CLOCK_SILENCE_S)
    simulator.tick(1.0)  # started again
    assert clock.steady() - begin == pytest.approx(0.01 + 2.0 - MAX_CLOCK_SILENCE_S)
    simulator.tick(1.5)
    assert clock.steady() - begin == pytest.approx(0.01 + 2.0 - MAX_CLOCK_SILENCE_S + 0.5)


def test_setting_the_machines_clock_changes_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_clock, "value", lambda node, name: False)
    monkeypatch.setattr(robot_clock.time, "monotonic", lambda: 12.5)
    assert RobotClock(None).steady() == 12.5  # type: ignore[arg-type]


PLACEMENT = np.array([1.2, -0.7, 0.3, 0.4, -0.3, 2.1])  # m, rad
SEEN = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(np.array([0.3, -0.8, 1.4])), np.array([0.4, -0.1, 0.5])))


def told(pose: np.ndarray, frame: str = "tracker") -> bytes:
    message = PoseStamped(pose=pose_to_message(pose))
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 7, 123_456_789
    return bytes(serialize_message(message))


def test_a_pose_that_was_seen_from_elsewhere_is_found_again_in_world() -> None:
    """A truth in world, told as the tracker would see it: turned about fixed axes, x first."""
    roll, pitch, yaw = PLACEMENT[3:]
    turn = pin.utils.rotate("z", yaw) @ pin.utils.rotate("y", pitch) @ pin.utils.rotate("x", roll)
    truth = pin.XYZQUATToSE3(SEEN)
    seen = pin.SE3ToXYZQUAT(pin.SE3(turn, PLACEMENT[:3]).actInv(truth))
    pose = TrackerPoses("tracker", PLACEMENT).read(told(seen))
    assert pose is not None
    assert pose.header.frame_id == "world"
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec) == (7, 123_456_789)
    found = pin.XYZQUATToSE3(pose_from_message(pose.pose))
    np.testing.assert_allclose(found.homogeneous, truth.homogeneous, atol=1e-12)


def test_in_a_frame_that_is_world_a_pose_stays_as_it_is_bit_by_bit() -> None:
    pose = TrackerPoses("world", np.zeros(6)).read(told(SEEN, "world"))
    assert pose is not None
    np.testing.assert_array_equal(pose_from_message(pose.pose), SEEN)


def test_the_trackers_frame_is_on_tf_static_where_poses_are_moved_to() -> None:
    tracker = TrackerPoses("tracker", PLACEMENT)
    (frame,) = tracker.frames("cell_a/")
    assert (frame.parent, frame.name) == ("cell_a/world", "tracker")
    moved = tracker.read(told(SEEN))
    assert moved is not None
    np.testing.assert_allclose(frame.placement.act(SEEN[:3]), pose_from_message(moved.pose)[:3], atol=1e-12)
    assert TrackerPoses("world", np.zeros(6)).frames("cell_a/") == []  # nor a loop of world and cell_a/world


@pytest.mark.parametrize("frame", ["world", "tracker_2", ""])
def test_a_pose_in_another_frame_is_refused(frame: str) -> None:
    with pytest.raises(InputError, match="frame_id of /mocap/object_pose = .*: expected tracker, see mocap_frame"):
        TrackerPoses("tracker", PLACEMENT).read(told(SEEN, frame))


@pytest.mark.parametrize("pose", [np.full(7, np.nan), np.zeros(7), np.append(np.full(3, np.inf), SEEN[3:])])
def test_what_a_tracker_says_of_an_object_out_of_sight_is_no_pose(pose: np.ndarray) -> None:
    assert TrackerPoses("tracker", PLACEMENT).read(told(pose)) is None


@pytest.mark.parametrize(
    "data",
    [b"", b"\0\1\0\0abc", told(SEEN)[:-1], b"\0\1\0\0" + b"\xff" * 80],
    ids=["nothing", "short", "cut off", "endless"],
)
def test_bytes_that_are_no_pose_are_an_object_out_of_sight(data: bytes) -> None:
    assert TrackerPoses("tracker", PLACEMENT).read(data) is None
