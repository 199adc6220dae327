# SPDX-License-Identifier: Apache-2.0
"""A real robot's trial is ended, and its arm held, by whatever is late, beyond a limit, or no number.

The clock is the test's: nothing here depends on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from robot_bench import (
    LIMIT,
    MODEL,
    MOTORS,
    PERIOD,
    PUSH,
    START,
    SWITCHED_ON,
    WEIGHT,
    Robot,
    Wires,
    torque_message,
)

from impact_rs_control.fallback import holding_torque
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.cell.cell_trial import CellTrial, TrialLimits
from impact_rs_trials.cell.motion_capture import MOCAP, TrackerPoses
from impact_rs_trials.cell.robot_states import STATES

COMMAND = topics.joint_command("arm")
LAST = PUSH.scene.scenario.timing.ticks
DELAY = 0.05  # s, from the first state for the controller to tick 0
SWAY = np.full(7, 0.03)  # rad/s, of an arm that is not at rest


class Bench(Wires):
    """A trial of one arm, a robot that reports what the test says, and a controller that answers what it says."""

    def __init__(self, adds_gravity: bool = True, mocap: bool = False, delay: float = DELAY) -> None:
        super().__init__()
        self.robot = Robot(adds_gravity)
        self.arms, self.sent = self.robot.arms, self.robot.sent
        self.step = 0
        self.trial = CellTrial(
            PUSH,
            MessageMaker(RosbagsTypes(), PUSH),
            self.arms,
            TrialLimits(LIMIT, LIMIT, 0.2, 0.01, delay),
            TrackerPoses("tracker", np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])) if mocap else None,
            self,  # type: ignore[arg-type]
            self,  # type: ignore[arg-type]
            self.robot.clock,
        )
        self.trial.begin()

    @property
    def time(self) -> float:
        return self.robot.clock.time

    def wait(self, timeout: float) -> None:
        """Time passes only here, and only where nothing is on its way."""
        if not self.waiting:
            self.robot.clock.time += timeout

    def bring(self, topic: str, data: bytes) -> None:
        """A message comes."""
        self.waiting.append((topic, data))
        self.trial.work(self.time + 1e-9)

    def state(self, **changes: object) -> None:
        """The robot's next state, a period after the last one."""
        self.robot.clock.time = 100.0 + self.step * PERIOD
        self.step += 1
        self.bring(STATES, self.robot.message(**changes))  # type: ignore[arg-type]

    def sway(self) -> None:
        """The next state of an arm that is not at rest."""
        self.state(velocity=SWAY * (-1.0) ** self.step)

    def pose(self, taken: int, x: float = 0.5, frame: str = "tracker") -> None:
        """A pose of the object, ``taken`` [ns] after the robot was switched on."""
        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(SWITCHED_ON + taken, 10**9)
        message.pose.position.x = x
        self.bring(MOCAP, bytes(serialize_message(message)))

    def answer(self, torque: np.ndarray, tick: int | None = None, after: float = 0.0) -> None:
        """The controller's answer to the last state, or to another."""
        self.robot.clock.time += after
        self.bring(COMMAND, torque_message(self.asked[-1] if tick is None else tick, torque, self.origin_ns))

    def under_way(self) -> Bench:
        """Tick 0 has its answer, and tick 1 as well."""
        self.state()
        self.answer(WEIGHT)
        while self.asked == [0]:
            self.state()
        self.answer(WEIGHT)
        assert self.asked == [0, 1]
        assert not self.trial.over
        self.sent.clear()
        return self


def test_ticks_follow_the_robots_stamps_with_one_torque_each() -> None:
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


def test_a_trial_is_over_when_its_last_tick_has_its_answer() -> None:
    bench = Bench().under_way()
    while not bench.trial.over:
        bench.sway()
        bench.answer(WEIGHT)
    assert bench.asked == list(range(LAST + 1))
    assert bench.trial.failure == ""


def test_an_arm_that_rests_away_from_its_references_ends_the_trial() -> None:
    """As a robot that has stopped itself and goes on reporting; 0.1 s after both references are 3 cm away."""
    bench = Bench().under_way()
    while not bench.trial.over:
        bench.state()
        bench.answer(WEIGHT)
    assert "arm has rested for 0.1 s more than 0.03 m from its references" in bench.trial.failure
    plan, start = PUSH.arms["arm"], PUSH.scene.models["arm"].placement(PUSH.arms["arm"].initial).translation
    far = [np.linalg.norm(path.position - start, axis=1) for path in (plan.ante_position, plan.post_position)]
    since = int(np.argmax(np.min(far, axis=0) > 0.03))
    assert bench.asked[-1] == pytest.approx(since + 100, abs=2)


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


def test_until_tick_0_the_arm_is_held_whenever_its_answer_comes() -> None:
    """The time of tick 0 is fixed with the first state; an answer before it moves nothing."""
    bench = Bench()
    for _ in range(30):
        bench.state()
    assert bench.asked == [0]
    assert bench.origin_ns == SWITCHED_ON + round(1e9 * DELAY)
    bench.answer(WEIGHT + 0.5, tick=0)
    for _ in range(20):
        bench.state()
    assert bench.asked == [0]
    np.testing.assert_allclose(bench.sent, 0.0, atol=1e-12)
    assert len(bench.sent) == 50
    bench.state()  # of tick 0: its torque goes to the robot
    np.testing.assert_allclose(bench.sent[50:], [np.full(7, 0.5)])
    bench.state()
    assert bench.asked == [0, 1]
    assert bench.trial.now == 1_000_000


def test_a_controller_that_does_not_answer_before_tick_0_ends_the_trial() -> None:
    bench = Bench()
    while not bench.trial.over:
        bench.state()
    assert "the controller does not answer the first state within 0.05 s" in bench.trial.failure
    assert bench.time == pytest.approx(100.0 + DELAY)
    bench.answer(WEIGHT + 0.5, tick=0)
    np.testing.assert_allclose(bench.sent, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"velocity": np.array([np.nan, 0, 0, 0, 0, 0, 0])}, "velocity of fr3_joint1 is nan"),
        ({"velocity": np.array([0, 0, 0, 0, 3.0, 0, 0])}, "fr3_joint5 at 3 rad/s, limit "),
        ({"effort": np.full(7, 1e6)}, "fr3_joint1 measures 1e+06 N m"),
        (
            {"position": START + [0, 0.8, 0, 0, 0, 0, 0]},
            "position of fr3_joint2 changed by 0.8 rad more than its velocity",
        ),
        ({"age": -0.02}, "the robot's state is stamped 0.0200 s in the future"),
    ],
)
def test_an_unusable_state_ends_the_trial_and_the_brake_uses_the_last_one(
    changes: dict[str, object], complaint: str
) -> None:
    bench = Bench().under_way()
    bench.state(**changes)
    assert bench.trial.failure.startswith(f"at t = 0.001 s: {complaint}")
    assert bench.asked == [0, 1]
    np.testing.assert_allclose(bench.sent, [np.zeros(7)], atol=1e-9)


def test_a_state_that_is_older_than_the_limit_ends_the_trial() -> None:
    bench = Bench().under_way()
    bench.step += 12
    bench.trial._last_state_at = 100.0 + bench.step * PERIOD  # others came and were of no use
    bench.state(age=LIMIT + 1e-4)
    assert bench.trial.failure == "at t = 0.001 s: the robot's state is 0.0101 s old, state_timeout is 0.01 s"


def test_only_usable_states_are_a_sign_of_life() -> None:
    bench = Bench().under_way()
    for _ in range(3):
        bench.bring(STATES, b"no message")
        bench.bring(STATES, bench.robot.message())  # of the same time
    bench.robot.clock.time += LIMIT + 1e-4
    bench.bring(STATES, b"no message")
    assert "no state of the robot for 0.01" in bench.trial.failure
    assert bench.trial.unreadable == 4


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 60, b"x" * 200_000])
def test_bytes_that_are_no_message_end_no_trial_and_reach_no_robot(data: bytes) -> None:
    bench = Bench().under_way()
    for topic in (STATES, COMMAND):
        bench.bring(topic, data)
    assert not bench.trial.over
    assert bench.sent == []
    bench.state()
    bench.answer(WEIGHT + 0.5)
    np.testing.assert_allclose(bench.sent, [np.full(7, 0.5)])


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"position": START + [0, 0, 0, 0.02, 0, 0, 0]}, "joint 4 of arm is +0.0200 rad from where the trial starts"),
        ({"velocity": np.full(7, 0.1)}, "arm moves at 0.1 rad/s"),
    ],
)
def test_no_trial_begins_with_an_arm_elsewhere_or_in_motion(changes: dict[str, np.ndarray], complaint: str) -> None:
    bench = Bench()
    bench.state(**changes)
    assert bench.trial.failure.startswith(complaint)
    assert bench.asked == []


def test_an_arm_that_drifts_before_tick_0_begins_no_trial() -> None:
    """At 0.015 rad/s, below the speed that is rest, 0.02 rad/s."""
    bench = Bench(delay=3.0)
    for step in range(3000):
        if bench.trial.over:
            break
        bench.state(position=START + 0.015 * PERIOD * step, velocity=np.full(7, 0.015))
    assert "rad from where the trial starts" in bench.trial.failure
    assert bench.asked == [0]


def test_states_that_are_missing_end_the_trial() -> None:
    bench = Bench().under_way()
    bench.step += 15
    bench.trial._last_state_at = 100.0 + bench.step * PERIOD  # they came, and were lost on the way to the program
    bench.state()
    assert bench.trial.failure == "at t = 0.001 s: 15 states of the robot are missing"


def test_a_last_state_that_is_missing_ends_the_trial() -> None:
    bench = Bench().under_way()
    while bench.asked[-1] < LAST - 1 and not bench.trial.over:
        bench.sway()
        bench.answer(WEIGHT)
    bench.step += 1
    bench.state()
    assert bench.trial.failure.endswith("the last state of the trial is missing")


def test_a_silent_robot_ends_the_trial_and_its_brake_is_released() -> None:
    """A torque that no state corrects does not brake: what is left is the arm's own weight."""
    bench = Bench().under_way()
    for count in range(5):
        bench.state(position=START + PERIOD * count, velocity=np.full(7, 1.0))
        bench.answer(WEIGHT + 5.0)
    assert np.all(bench.sent[-1] > 2.0)
    bench.trial.work(bench.time + 1.0)
    assert bench.trial.over
    assert "no state of the robot for 0.01" in bench.trial.failure
    for _ in range(60):
        bench.robot.clock.time += PERIOD
        bench.arms.rest()
    np.testing.assert_allclose(bench.sent[-1], 0.0, atol=1e-9)


def test_stopping_a_trial_brakes() -> None:
    bench = Bench().under_way()
    velocity = np.full(7, 0.5)
    bench.state(velocity=velocity)
    bench.trial.stop("the trial was aborted")
    braking = holding_torque(MODEL, MOTORS, START, velocity) - WEIGHT
    np.testing.assert_allclose(bench.sent[-1], np.clip(braking, -1.0, 1.0))
    assert bench.trial.over


def late_torques(bench: Bench, ticks: int, answered: Callable[[int], int | None]) -> None:
    """States of so many ticks; after each the torque of the tick that ``answered`` says, or none."""
    for _ in range(ticks):
        if not bench.trial.over:
            bench.state()
            tick = answered(bench.asked[-1])
            if tick is not None and not bench.trial.over:
                bench.answer(WEIGHT, tick=tick)


@pytest.mark.parametrize(
    "answered",
    [
        lambda tick: tick if tick % 9 == 0 else None,  # a torque in every ninth tick
        lambda tick: max(1, tick - 8),  # every torque eight ticks old
        lambda tick: tick if tick % 4 else None,
    ],
)
def test_torques_that_are_late_or_missing_too_often_end_the_trial(answered: Callable[[int], int | None]) -> None:
    bench = Bench().under_way()
    late_torques(bench, 120, answered)
    assert "of the last " in bench.trial.failure
    assert "torques came after the next state or never, late_torque_share is 0.2" in bench.trial.failure


def test_torques_that_are_seldom_late_are_counted() -> None:
    bench = Bench().under_way()
    late_torques(bench, 300, lambda tick: tick if tick % 6 else None)
    assert not bench.trial.over
    assert bench.trial.status()[1]["missed_ticks"] == 50
    assert bench.trial.status()[1]["late_torques"] == pytest.approx(100 / 6, abs=1)


def test_an_answer_that_got_lost_is_counted_and_does_not_end_the_trial() -> None:
    bench = Bench().under_way()
    bench.state()
    bench.state()
    bench.answer(WEIGHT)
    assert not bench.trial.over
    assert bench.trial.status()[1]["missed_ticks"] == 1
    bench.answer(WEIGHT, tick=2)  # it comes after all: too old to be sent
    assert len(bench.sent) == 1


def test_two_torques_for_one_state_are_of_two_controllers() -> None:
    bench = Bench().under_way()
    bench.state()
    bench.answer(WEIGHT + 0.1)
    bench.answer(WEIGHT + 0.1)  # repeated: the first may have got lost
    assert not bench.trial.over and len(bench.sent) == 1
    bench.answer(WEIGHT + 0.2)
    assert bench.trial.failure.endswith("two torques for one state; are there two controllers?")


def test_a_torque_from_before_the_first_state_is_of_another_controller() -> None:
    """Kills a look-up of an answer that was not given yet: KeyError."""
    bench = Bench()
    bench.state()
    bench.answer(WEIGHT, tick=-1)
    assert bench.trial.failure.endswith("two torques for one state; are there two controllers?")


def test_poses_are_passed_on_in_world_with_their_own_stamps() -> None:
    bench = Bench(mocap=True)
    bench.pose(0)  # before the trial
    bench.under_way()
    begin = round(1e9 * DELAY)
    for taken, x in ((-1, 0.1), (700_000, 0.2), (900_000, np.nan), (1_600_000_000, 0.4), (1_800_000_001, 0.5)):
        bench.pose(begin + taken, x)
    published = [deserialize_message(data, PoseStamped) for data in bench.kept]
    times = [pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec for pose in published]
    assert times == [SWITCHED_ON + begin + taken for taken in (700_000, 1_600_000_000)]
    assert [pose.pose.position.x for pose in published] == [0.2, 0.4]
    assert {(pose.header.frame_id, pose.pose.position.z) for pose in published} == {("world", 1.0)}
    assert not bench.trial.over
    bench.pose(1_700_000_000, frame="world")
    assert "frame_id of /mocap/object_pose = 'world': expected tracker" in bench.trial.failure


@pytest.mark.parametrize("seen", [True, False])
def test_a_trial_whose_object_was_never_seen_is_no_success(seen: bool) -> None:
    bench = Bench(mocap=True).under_way()
    while not bench.trial.over:
        bench.sway()
        if seen and bench.asked[-1] == 900:
            bench.pose(800_000_000)
        bench.answer(WEIGHT)
    assert bench.asked[-1] == LAST
    assert ("no pose of the object came during the trial" in bench.trial.failure) is not seen


@settings(max_examples=300)
@given(data=st.data())
def test_no_bytes_raise_or_make_a_torque_beyond_a_limit(data: st.DataObject) -> None:
    """On every topic of the cell: random bytes, and well-formed messages that are cut off or have flipped bits."""
    bench = Bench(mocap=True).under_way()
    state = bench.robot.message()
    pose = bytes(serialize_message(PoseStamped()))
    for _ in range(data.draw(st.integers(1, 4))):
        topic = data.draw(st.sampled_from([STATES, COMMAND, MOCAP]))
        payload = bytearray(data.draw(st.sampled_from([state, pose, b""])) or data.draw(st.binary(max_size=300)))
        for bit in data.draw(st.lists(st.integers(0, 8 * len(payload) - 1), max_size=5)) if payload else ():
            payload[bit // 8] ^= 1 << bit % 8
        bench.bring(topic, bytes(payload[: data.draw(st.integers(0, len(payload)))]))
    bench.arms.rest()
    assert all(np.all(np.abs(torque) <= 2.0 * MODEL.torque_max) for torque in bench.sent)
