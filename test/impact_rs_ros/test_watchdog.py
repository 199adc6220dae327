# SPDX-License-Identifier: Apache-2.0
"""The watchdog passes torques on, takes over arms that move without any, and no others."""

from __future__ import annotations

from array import array
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from robot_bench import GRAB, MOTORS, PERIOD, RATE, START, Robot, TestClock, Wires, state_message
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from impact_rs_ros import watchdog_node
from impact_rs_ros.effort_arms import EffortArms, watched_topic
from impact_rs_ros.robot_states import STATES, RobotStates, joint_names
from impact_rs_ros.watchdog_node import Watchdog, WatchdogNode

TIMEOUT = 0.05  # s
MOVING = np.full(7, 0.5)


def command(torque: np.ndarray) -> bytes:
    return bytes(serialize_message(Float64MultiArray(data=array("d", torque.tobytes()))))


class Bench:
    """A robot that moves, and a cell that sends five newton metres until it dies."""

    def __init__(self, velocity: np.ndarray = MOVING) -> None:
        self.robot = Robot()
        self.watchdog = Watchdog(self.robot.arms, TIMEOUT)
        self.velocity, self.position = velocity, START
        self.count = 0

    def period(self, sent: np.ndarray | None = None) -> bool:
        """A state comes, and a command of the cell if it lives; whether the arms are taken over."""
        self.robot.state(position=self.position, velocity=self.velocity)
        self.position = self.position + self.velocity * PERIOD
        self.count += 1
        if sent is not None:
            self.watchdog.heard("arm", command(sent), self.robot.clock())
        return self.watchdog.look(self.robot.clock())


def test_commands_that_stop_while_the_arm_moves_make_it_take_over_once() -> None:
    bench = Bench()
    assert not any(bench.period(np.full(7, 5.0)) for _ in range(100))
    taken = [bench.period() for _ in range(100)]
    assert sum(taken) == 1
    assert taken.index(True) * PERIOD == pytest.approx(TIMEOUT, abs=2 * PERIOD)
    assert bench.watchdog.braking


def test_torques_go_on_at_once_and_as_fast_as_the_robot_allows_in_time() -> None:
    bench, slow = Bench(), np.full(7, 0.5)
    bench.period(slow)
    np.testing.assert_allclose(bench.robot.sent, [slow])
    for _ in range(10):  # in one instant, as of commands that waited in a queue
        bench.watchdog.heard("arm", command(np.full(7, 20.0)), bench.robot.clock())
    np.testing.assert_allclose(bench.robot.sent[-1], slow)
    bench.period(np.full(7, 20.0))
    np.testing.assert_allclose(bench.robot.sent[-1], 0.5 + RATE * PERIOD)
    bench.robot.clock.time += 1.0  # a pause permits no jump
    bench.watchdog.heard("arm", command(np.full(7, 20.0)), bench.robot.clock())
    np.testing.assert_allclose(bench.robot.sent[-1], 0.5 + 2.0 * RATE * PERIOD)


def test_before_it_knows_a_state_it_passes_nothing_on() -> None:
    """The cell sends a torque for each state, so this one has another topic or other joints."""
    bench = Bench()
    bench.watchdog.heard("arm", command(np.zeros(7)), bench.robot.clock())
    assert bench.robot.sent == [] and not bench.watchdog.commanded


def test_what_a_cell_sends_that_comes_back_goes_nowhere_until_the_reset() -> None:
    """One stream reaches the robot, and each torque in it follows the one before within the rate."""
    bench = Bench()
    while not bench.period(np.full(7, 5.0) if bench.count < 20 else None):
        pass
    for _ in range(100):
        bench.period(np.full(7, -5.0))
        bench.watchdog.arms.rest()
    assert len(bench.robot.sent) == 20 + 100
    bench.velocity = np.zeros(7)
    for _ in range(20):
        bench.period()
        bench.watchdog.arms.rest()
    assert bench.watchdog.arms.held
    bench.watchdog.reset()
    for _ in range(20):
        bench.period(np.full(7, -5.0))
    np.testing.assert_allclose(bench.robot.sent[-1], -5.0)
    assert np.abs(np.diff(bench.robot.sent, axis=0)).max() <= RATE * PERIOD + 1e-9


def test_its_first_torque_follows_the_last_one_of_the_cell() -> None:
    bench = Bench()
    for _ in range(10):
        bench.period(np.full(7, 5.0))
    while not bench.period():
        pass
    bench.robot.clock.time += PERIOD
    bench.robot.arms.rest()
    np.testing.assert_allclose(bench.robot.sent[-1], 5.0 - RATE * PERIOD, atol=1e-9)  # the brake is on the other side


@pytest.mark.parametrize(
    "data", [b"\0\1\0\0", command(np.zeros(3)), command(np.full(7, np.nan))], ids=["cut off", "three", "nan"]
)
def test_bytes_that_are_no_torques_go_nowhere_and_are_silence(data: bytes) -> None:
    bench = Bench()
    bench.period(np.full(7, 0.5))
    while not bench.watchdog.braking:
        bench.watchdog.heard("arm", data, bench.robot.clock())
        bench.period()
    assert bench.count * PERIOD == pytest.approx(TIMEOUT, abs=3 * PERIOD)
    assert len(bench.robot.sent) == 1


def test_an_arm_at_rest_may_keep_its_torque_while_a_trial_is_loaded() -> None:
    bench = Bench(velocity=np.full(7, 0.01))
    bench.period(np.full(7, 5.0))
    assert not any(bench.period() for _ in range(3000))
    bench.velocity = MOVING  # it is pushed
    assert any(bench.period() for _ in range(1000))


def test_an_arm_that_was_never_commanded_is_none_of_its_business() -> None:
    bench = Bench()
    assert not any(bench.period() for _ in range(200))


def test_after_a_reset_it_waits_for_the_next_command() -> None:
    bench = Bench()
    bench.period(np.zeros(7))
    while not bench.period():
        pass
    bench.watchdog.reset()
    assert not bench.watchdog.braking
    assert not any(bench.period() for _ in range(200))
    bench.period(np.zeros(7))
    assert any(bench.period() for _ in range(200))


def test_of_two_arms_the_one_whose_commands_stop_counts() -> None:
    clock, arms = TestClock(), list(GRAB.arms)
    names = joint_names("{arm}_{number}", dict.fromkeys(arms, 7))
    states = RobotStates({arm: GRAB.scene.models[arm] for arm in arms}, names, PERIOD, 0.01, clock)
    sent = dict.fromkeys(arms, 0)

    def count(arm: str, torque: np.ndarray) -> None:
        sent[arm] += 1

    watchdog = Watchdog(EffortArms(states, dict.fromkeys(arms, MOTORS), True, RATE, count), TIMEOUT)
    start = np.concatenate([GRAB.arms[arm].initial for arm in arms])
    velocity = np.concatenate((np.zeros(7), MOVING))
    for tick in range(200):
        clock.time += PERIOD
        joints = [name for arm in arms for name in names[arm]]
        states.read(state_message(clock.now(), start + tick * PERIOD * velocity, velocity, np.zeros(14), joints))
        for arm in arms:
            if arm == arms[0] or tick < 20:
                watchdog.heard(arm, command(np.zeros(7)), clock())
        if watchdog.look(clock()):
            break
    assert tick * PERIOD == pytest.approx(20 * PERIOD + TIMEOUT, abs=3 * PERIOD)
    assert sent == {arms[0]: tick + 1, arms[1]: 20}


def test_a_watchdog_that_was_passed_over_sends_nothing_any_more() -> None:
    """It comes back after a stall, in which the cell has taken the robot: a command without torques says so."""
    fresh = Bench()
    fresh.watchdog.heard("arm", command(np.empty(0)), fresh.robot.clock())
    assert not fresh.watchdog.deposed  # one that was started since
    for last in (np.full(7, 5.0), None):  # before it brakes, and while it does
        bench = Bench()
        for _ in range(20 if last is not None else 100):
            bench.period(np.full(7, 5.0) if bench.count < 20 else None)
        sent = len(bench.robot.sent)
        bench.watchdog.heard("arm", command(np.empty(0)), bench.robot.clock())
        for _ in range(100):
            assert not bench.period(last)
        assert bench.watchdog.deposed and not bench.watchdog.braking and not bench.watchdog.commanded
        assert len(bench.robot.sent) == sent


class Gathered(Wires):
    """An inbox in which some of what has come waits until all of it is gathered."""

    def __init__(self) -> None:
        super().__init__()
        self.came: list[tuple[str, bytes]] = []

    def gather(self) -> None:
        self.waiting, self.came = self.waiting + self.came, []


class Offline(WatchdogNode):
    """The node without a middleware, on the clock and the wires of a test; the arm moves, and a cell sends torques."""

    def __init__(self) -> None:
        self.bench, self.wires = Bench(), Gathered()
        self.said: list[bool] = []
        self._looked = 0.0
        self._clock, self._inbox, self._watchdog = self.bench.robot.clock, self.wires, self.bench.watchdog  # type: ignore[assignment]
        self._arm_of = {watched_topic("arm"): "arm"}
        self._braking = SimpleNamespace(publish=lambda message: self.said.append(message.data))  # type: ignore[assignment]
        self.log = SimpleNamespace(error=lambda text: None, info=lambda text: None)  # type: ignore[assignment]

    def passes(self, seconds: float, *commands: bytes, velocity: np.ndarray = MOVING, wait: bool = False) -> bool:
        """So much time of the robot passes before the node looks; whether it brakes. Commands may wait for a gather."""
        self.bench.robot.clock.time += seconds
        self.wires.waiting = [(STATES, self.bench.robot.message(velocity=velocity))]
        behind = self.wires.came if wait else self.wires.waiting
        behind += [(watched_topic("arm"), data) for data in commands]
        self._look()
        return self.bench.watchdog.braking

    def reset(self) -> str:
        """Why it is not reset; empty: it is."""
        answer = self._on_reset(Trigger.Request(), Trigger.Response())
        assert answer.success is not bool(answer.message)
        return str(answer.message)


def test_a_watchdog_that_did_not_run_hears_what_waited_before_it_judges() -> None:
    program, alive = Offline(), command(np.zeros(7))
    assert not any(program.passes(PERIOD, alive) for _ in range(2))
    assert not program.passes(10.0 * TIMEOUT, alive, wait=True)  # a busy machine let it wait, and the cell was alive
    assert not program.passes(0.9 * TIMEOUT)
    assert program.passes(0.2 * TIMEOUT)


def test_a_slow_simulator_is_no_silence_of_the_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour of this machine passes between two looks, and a millisecond of the robot."""
    program, hours = Offline(), count(step=3600.0)
    monkeypatch.setattr(watchdog_node, "time", SimpleNamespace(monotonic=lambda: next(hours)))
    assert not any(program.passes(PERIOD, command(np.zeros(7))) for _ in range(2))
    assert not any(program.passes(PERIOD) for _ in range(round(0.9 * TIMEOUT / PERIOD)))
    assert any(program.passes(PERIOD) for _ in range(round(0.2 * TIMEOUT / PERIOD)))


def test_it_says_that_it_brakes_until_it_is_reset_with_arms_at_rest() -> None:
    program = Offline()
    assert not any(program.passes(PERIOD, command(np.zeros(7))) for _ in range(2))
    assert (program.reset(), program.status()) == ("watchdog: it is not braking", ("ok", {"braking": False}))
    assert program.passes(2.0 * TIMEOUT)
    assert program.reset() == "watchdog: the arms are not at rest yet"
    assert program.status()[0].startswith("braking: ") and program.status()[1] == {"braking": True}
    for _ in range(1000):
        program.passes(PERIOD, command(np.ones(7)), velocity=np.zeros(7))  # of a cell that has come back
    assert program.said == [True]
    assert (program.reset(), program.said) == ("", [True, False])
    assert not program.passes(2.0 * TIMEOUT)


def test_before_it_ends_it_brakes_the_arms_that_it_has_sent_torques(monkeypatch: pytest.MonkeyPatch) -> None:
    """On Ctrl-C or SIGTERM: no other process can change the last torque then."""
    program, looks, said = Offline(), [], []

    def look(arms: EffortArms, *others: object) -> None:
        looks.append(arms)
        arms.held = len(looks) == 5

    monkeypatch.setattr(watchdog_node, "rest_until", look)
    program.log = SimpleNamespace(error=said.append)  # type: ignore[assignment]
    program.brake()
    assert looks == []  # nothing was sent
    assert not any(program.passes(PERIOD, command(np.zeros(7))) for _ in range(2))
    program.brake()
    assert len(looks) == 5 and said == []
    program.bench.watchdog.arms.held = False
    monkeypatch.setattr(watchdog_node, "MAX_BRAKING_S", 0.0)
    program.brake()
    assert said == ["the arms did not come to rest within 0 s: press the emergency stop"]
