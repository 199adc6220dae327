# SPDX-License-Identifier: Apache-2.0
"""A real robot's trial is ended, and its arm held, by whatever is late, beyond a limit, or no number.

The clock is the test's: nothing here depends on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from impact_msgs_py.conversions import pose_to_message
from impact_rs_control.fallback import holding_torque
from impact_rs_ros import cell_node
from impact_rs_ros.cell_node import STATES, CellTrial, Patience, off_its_place
from impact_rs_ros.effort_arms import EffortArms, StateReader, joint_names
from impact_rs_ros.motion_capture import MOCAP, TrackerPoses
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.spec import TrialSpec

PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
MODEL = PLAN.scene.models["arm"]
START = PLAN.arms["arm"].initial
STILL = np.zeros(7)
WEIGHT = MODEL.gravity_torque(START)
JOINTS = joint_names("fr3_joint{number}", "arm", 7)
COMMAND = topics.joint_command("arm")
PERIOD = 0.001  # s
SWITCHED_ON = 1_700_000_000 * 10**9  # ns, on the robot's clock
LIMIT = 0.01  # s


class Bench:
    """A trial of one arm, a robot that tells what the test says, and a controller that answers what the test says."""

    due = False

    def __init__(self, adds_gravity: bool = True) -> None:
        self.time = 100.0  # s
        self.waiting: list[tuple[str, bytes]] = []
        self.asked: list[int] = []
        self.sent: list[np.ndarray] = []
        self.poses: list[PoseStamped] = []
        self.step = 0
        self.arms = EffortArms(
            {"arm": MODEL}, {"arm": JOINTS}, adds_gravity, 1.0, lambda arm, torque: self.sent.append(torque)
        )
        self.trial = CellTrial(
            PLAN,
            self.arms,
            Patience(LIMIT, LIMIT),
            0.01,
            TrackerPoses("tracker", np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
            self,  # type: ignore[arg-type]
            self,  # type: ignore[arg-type]
            lambda: SWITCHED_ON + round(1e9 * (self.time - 100.0)),
            lambda: self.time,
        )
        self.trial.begin()

    def wait(self, timeout: float) -> None:
        """Time passes only here, and only where nothing is on its way."""
        if not self.waiting:
            self.time += timeout

    def take(self) -> Iterator[tuple[str, bytes]]:
        while self.waiting:
            yield self.waiting.pop(0)

    def now(self, topic: str, tick: int, sample: object) -> bytes:
        self.asked.append(tick)
        return b""

    def repeat(self, topic: str, data: bytes) -> None:
        """Asked again."""

    def later(self, topic: str, message: PoseStamped) -> None:
        assert topic == topics.OBJECT_POSE
        self.poses.append(message)

    def work(self) -> None:
        self.trial.work(self.time + 1e-9)

    def state(self, age: float = 0.0, names: list[str] | None = None, **changes: np.ndarray) -> None:
        """The robot's next state, a period after the last one."""
        self.time = 100.0 + self.step * PERIOD
        message = JointState(name=names or JOINTS)
        values = {"position": START, "velocity": STILL, "effort": WEIGHT} | changes
        for name, value in values.items():
            setattr(message, name, list(value))
        stamp = SWITCHED_ON + self.step * 1_000_000 - round(1e9 * age)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.step += 1
        self.waiting.append((STATES, bytes(serialize_message(message))))
        self.work()

    def pose(self, taken: int, x: float = 0.5, frame: str = "tracker") -> None:
        """A pose of the object, ``taken`` [ns] after the robot was switched on."""
        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(SWITCHED_ON + taken, 10**9)
        message.pose.position.x = x
        self.waiting.append((MOCAP, bytes(serialize_message(message))))
        self.work()

    def answer(self, torque: np.ndarray, tick: int | None = None, after: float = 0.0) -> None:
        """The controller's answer to the last state, or to another."""
        self.time += after
        message = JointState(name=[f"arm_joint{n}" for n in range(1, 8)], effort=list(torque))
        stamp = (self.asked[-1] if tick is None else tick) * 1_000_000
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.waiting.append((COMMAND, bytes(serialize_message(message))))
        self.work()

    def under_way(self) -> Bench:
        """Tick 0 has its answer, and tick 1 as well."""
        self.state()
        self.answer(WEIGHT)
        self.state()
        self.answer(WEIGHT)
        assert self.asked == [0, 1]
        assert not self.trial.over
        self.sent.clear()
        return self


def test_ticks_are_those_of_the_robots_stamps_and_every_one_is_sent_one_torque() -> None:
    bench = Bench().under_way()
    for _ in range(5):
        bench.state()
        bench.answer(WEIGHT + 0.5)
    assert bench.asked == list(range(7))
    assert bench.trial.now == 6_000_000
    np.testing.assert_allclose(bench.sent, 0.5)  # without gravity, which the robot adds


def test_a_robot_that_adds_no_gravity_is_sent_the_whole_torque() -> None:
    bench = Bench(adds_gravity=False).under_way()
    bench.state()
    bench.answer(WEIGHT + 0.5)
    np.testing.assert_allclose(bench.sent, [WEIGHT + 0.5])


def test_until_the_controller_answers_the_first_state_the_arm_is_held_and_time_stands_still() -> None:
    bench = Bench()
    for _ in range(50):
        bench.state()
    assert bench.asked == [0]
    assert not bench.trial.over
    np.testing.assert_allclose(bench.sent, 0.0, atol=1e-12)
    assert len(bench.sent) == 50
    bench.answer(WEIGHT + 5.0, tick=0)  # of a state that is long gone: it says that the controller is there
    assert len(bench.sent) == 50
    bench.state()
    assert bench.asked == [0, 1]


def test_a_trial_is_over_when_its_last_tick_has_its_answer() -> None:
    bench = Bench().under_way()
    last = PLAN.scene.scenario.timing.ticks
    while not bench.trial.over:
        bench.state()
        bench.answer(WEIGHT)
    assert bench.asked == list(range(last + 1))
    assert bench.trial.failure == ""


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"velocity": np.array([np.nan, 0, 0, 0, 0, 0, 0])}, "velocity of fr3_joint1 is nan"),
        ({"position": np.full(3, 0.1)}, "3 values of position, expected 7"),
        ({"names": JOINTS[:6] + ["finger"]}, "no fr3_joint7 among fr3_joint1"),
        ({"position": START + [0, 0, 3.0, 0, 0, 0, 0]}, "arm_joint3 at "),
        ({"velocity": np.array([0, 0, 0, 0, 3.0, 0, 0])}, "arm_joint5 at 3 rad/s, limit "),
        ({"age": 0.0201}, "the robot's state is 0.0201 s old, state_timeout is 0.01 s"),
        ({"age": -0.0201}, "the robot's state is -0.0201 s old"),
    ],
)
def test_a_state_that_cannot_be_used_ends_the_trial_and_the_arm_is_held(changes: dict[str, object], told: str) -> None:
    bench = Bench().under_way()
    bench.state(**changes)  # type: ignore[arg-type]
    assert bench.trial.over
    assert bench.trial.failure.startswith(f"at t = 0.001 s: {told}")
    assert bench.asked == [0, 1]
    held = len(bench.sent)
    assert held == 1
    assert np.isfinite(bench.sent).all()
    bench.trial.rest(bench.time + 1e-9)
    bench.state()
    bench.trial.rest(bench.time + 1e-9)
    assert len(bench.sent) == held + 1  # by the next good state


@pytest.mark.parametrize(
    ("torque", "told"),
    [
        (np.full(7, np.nan), "effort of arm_joint1 is nan"),
        (WEIGHT + [0, 1000.0, 0, 0, 0, 0, 0], "torque of "),
    ],
)
def test_a_torque_that_no_arm_may_have_never_leaves(torque: np.ndarray, told: str) -> None:
    bench = Bench().under_way()
    bench.state()
    bench.answer(torque)
    assert bench.trial.over
    assert bench.trial.failure.startswith(f"{COMMAND} at t = 0.002 s: {told}")
    np.testing.assert_allclose(bench.sent, [np.zeros(7)], atol=1e-12)


def test_an_answer_that_is_late_ends_the_trial_whether_it_comes_or_not() -> None:
    late, never = Bench().under_way(), Bench().under_way()
    late.state()
    late.answer(WEIGHT + 0.5, after=0.0101)
    for _ in range(12):
        never.state()
    for bench in (late, never):
        assert bench.trial.over
        assert "no torque of the controller for 0.01" in bench.trial.failure
        assert "answer_timeout is 0.01 s" in bench.trial.failure


def test_an_answer_that_got_lost_is_counted_and_does_not_end_the_trial() -> None:
    bench = Bench().under_way()
    bench.state()
    bench.state()
    bench.answer(WEIGHT)
    assert not bench.trial.over
    assert bench.trial.status()[1]["missed_ticks"] == 1
    bench.answer(WEIGHT, tick=2)  # it comes after all: too old to be sent
    assert len(bench.sent) == 1


def test_a_robot_that_falls_silent_ends_the_trial_and_its_brake_is_released() -> None:
    """Nobody corrects a torque of which nobody knows what it does: what is left is the arm's own weight."""
    bench = Bench().under_way()
    for _ in range(5):  # braking in full: it is fast
        bench.state(velocity=np.full(7, 1.0))
        bench.answer(WEIGHT + 5.0)
    assert np.all(bench.sent[-1] > 2.0)
    bench.trial.work(bench.time + 1.0)
    assert bench.trial.over
    assert "no state of the robot for 0.0" in bench.trial.failure
    bench.trial.rest(bench.time + 0.02)
    np.testing.assert_allclose(bench.sent[-1], 0.0, atol=1e-12)


def test_poses_are_told_in_trial_time_by_when_they_were_taken_and_in_world() -> None:
    bench = Bench()
    bench.pose(0)  # before the trial
    bench.under_way()  # with its origin at the stamp of its first state
    for taken, x in ((-1, 0.1), (700_000, 0.2), (900_000, np.nan), (1_600_000_000, 0.4), (1_800_000_001, 0.5)):
        bench.pose(taken, x)
    times = [pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec for pose in bench.poses]
    assert times == [700_000, 1_600_000_000]
    assert [pose.pose.position.x for pose in bench.poses] == [0.2, 0.4]
    assert {(pose.header.frame_id, pose.pose.position.z) for pose in bench.poses} == {("world", 1.0)}
    assert not bench.trial.over
    bench.pose(1_700_000_000, frame="world")
    assert "frame_id of /mocap/object_pose = 'world': expected tracker" in bench.trial.failure


def test_what_a_wrong_placement_of_the_tracker_does_is_told_by_distance_and_angle() -> None:
    """As with a yaw that is 3 degrees off, and an origin 25 mm too high."""
    there = PLAN.scene.object
    turned = pin.SE3(
        pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(3.0)) @ there.rotation, there.position + [0.0, 0.0, 0.025]
    )
    pose = PoseStamped(pose=pose_to_message(pin.SE3ToXYZQUAT(turned)))
    assert off_its_place(PLAN, pose) == "25.0 mm and 3.0 deg from its place in the scenario"


def test_the_time_of_a_simulator_is_not_known_until_it_is_told_nor_after_it_was_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Topic(list[Clock]):
        """What waits on ``/clock``."""

        def __init__(self, node: object, name: str, qos: object) -> None:
            super().__init__()

        def connect(self, kinds: object) -> None:
            """Listened to."""

        def gather(self) -> None:
            """All that waits is here."""

        def take(self) -> Iterator[tuple[str, Clock]]:
            while self:
                yield topics.CLOCK, self.pop(0)

    monkeypatch.setattr(cell_node, "Inbox", Topic)
    monkeypatch.setattr(cell_node, "value", lambda node, name: name == "use_sim_time")
    clock = cell_node.RobotClock(None)  # type: ignore[arg-type]
    waiting = clock._inbox
    assert isinstance(waiting, Topic)
    assert not clock.told
    waiting.append(Clock(clock=Time(sec=2, nanosec=5)))
    assert clock.told
    assert clock.now() == 2_000_000_005
    waiting.append(Clock(clock=Time(sec=3)))  # of the one that has ended
    clock.forget()
    assert not clock.told


def test_states_that_are_missing_end_the_trial() -> None:
    bench = Bench().under_way()
    bench.step += 15
    bench.time = 100.0 + bench.step * PERIOD - 0.005
    bench.trial._heard = bench.time  # they came, and were lost on the way to the program
    bench.state()
    assert bench.trial.failure == "at t = 0.001 s: 15 states of the robot are missing"


def test_the_brake_is_that_of_the_fallback_within_the_rate_that_the_robot_allows() -> None:
    bench = Bench().under_way()
    velocity = np.full(7, 0.5)
    bench.state(velocity=velocity)
    bench.trial.stop("the trial was aborted")
    braking = holding_torque(MODEL, START, velocity) - WEIGHT
    np.testing.assert_allclose(bench.sent[-1], np.clip(braking, -1.0, 1.0))
    for _ in range(100):
        bench.state(velocity=velocity)
        bench.trial.rest(bench.time + 1e-9)
    np.testing.assert_allclose(bench.sent[-1], braking)
    assert np.all(np.abs(np.diff(bench.sent, axis=0)) <= 1.0 + 1e-12)


def test_an_arm_at_rest_is_held_only_when_the_torque_that_led_it_has_left_it() -> None:
    bench = Bench().under_way()
    for _ in range(5):
        bench.state()
        bench.answer(WEIGHT + 5.0)
    bench.trial.stop("the trial was aborted")
    assert np.all(bench.sent[-1] > 3.0)
    assert not bench.arms.held  # though it rests
    for _ in range(5):
        bench.state()
        bench.trial.rest(bench.time + 1e-9)
    np.testing.assert_allclose(bench.sent[-1], 0.0, atol=1e-12)
    assert bench.arms.held
    bench.state(velocity=np.full(7, 0.1))
    bench.trial.rest(bench.time + 1e-9)
    assert not bench.arms.held


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"position": START + [0, 0, 0, 0.02, 0, 0, 0]}, "joint 4 of arm is +0.0200 rad from where the trial starts"),
        ({"velocity": np.full(7, 0.1)}, "arm moves at 0.1 rad/s"),
    ],
)
def test_no_trial_begins_with_an_arm_elsewhere_or_in_motion(changes: dict[str, np.ndarray], told: str) -> None:
    bench = Bench()
    bench.state(**changes)  # type: ignore[arg-type]
    assert bench.trial.over
    assert bench.trial.failure.startswith(told)
    assert bench.asked == []


def test_joints_are_found_among_others_in_any_order_and_messages_of_others_are_left_alone() -> None:
    reader = StateReader({arm: joint_names("{arm}_fr3_joint{number}", arm, 2) for arm in ("left", "right")})

    def told(names: list[str]) -> object:
        numbers = [float(1 + index) for index in range(len(names))]
        finger = [np.nan if name == "finger" else value for name, value in zip(names, numbers, strict=True)]
        message = JointState(name=names, position=numbers, velocity=numbers, effort=finger)
        return reader.read(bytes(serialize_message(message)))

    found = told(["right_fr3_joint2", "finger", "left_fr3_joint1", "right_fr3_joint1", "left_fr3_joint2"])
    assert found.complaint == ""  # type: ignore[attr-defined]
    np.testing.assert_array_equal(found.arms["left"].position, [3.0, 5.0])  # type: ignore[attr-defined]
    np.testing.assert_array_equal(found.arms["right"].torque, [4.0, 1.0])  # type: ignore[attr-defined]
    assert told(["finger", "other_finger"]) is None
