# SPDX-License-Identifier: Apache-2.0
"""The watchdog passes torques on, takes over arms that move without any, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from robot_bench import GRAB, MOTORS, PERIOD, RATE, TestClock, state_message
from watched_robot import MOVING, TIMEOUT, WatchedRobot

from impact_rs_trials.cell.effort_arms import EffortArms
from impact_rs_trials.cell.robot_states import RobotStates, joint_names
from impact_rs_trials.cell.watchdog import Watchdog


def test_commands_that_stop_while_the_arm_moves_make_it_take_over_once() -> None:
    bench = WatchedRobot()
    assert not any(bench.period(np.full(7, 5.0)) for _ in range(100))
    taken = [bench.period() for _ in range(100)]
    assert sum(taken) == 1
    assert taken.index(True) * PERIOD == pytest.approx(TIMEOUT, abs=2 * PERIOD)
    assert bench.watchdog.braking


def test_torques_go_on_at_once_and_as_fast_as_the_robot_allows_in_time() -> None:
    bench, slow = WatchedRobot(), np.full(7, 0.5)
    bench.period(slow)
    np.testing.assert_allclose(bench.robot.sent, [slow])
    for _ in range(10):  # in one instant, as of commands that waited in a queue
        bench.watchdog.heard("arm", np.full(7, 20.0), bench.robot.clock())
    np.testing.assert_allclose(bench.robot.sent[-1], slow)
    bench.period(np.full(7, 20.0))
    np.testing.assert_allclose(bench.robot.sent[-1], 0.5 + RATE * PERIOD)
    bench.robot.clock.time += 1.0  # a pause permits no jump
    bench.watchdog.heard("arm", np.full(7, 20.0), bench.robot.clock())
    np.testing.assert_allclose(bench.robot.sent[-1], 0.5 + 2.0 * RATE * PERIOD)


def test_before_it_knows_a_state_it_passes_nothing_on() -> None:
    """The cell sends a torque for each state, so this one has another topic or other joints."""
    bench = WatchedRobot()
    bench.watchdog.heard("arm", np.zeros(7), bench.robot.clock())
    assert bench.robot.sent == [] and not bench.watchdog.commanded


def test_what_a_cell_sends_that_comes_back_goes_nowhere_until_the_reset() -> None:
    """One stream reaches the robot, and each torque in it follows the one before within the rate."""
    bench = WatchedRobot()
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
    bench = WatchedRobot()
    for _ in range(10):
        bench.period(np.full(7, 5.0))
    while not bench.period():
        pass
    bench.robot.clock.time += PERIOD
    bench.robot.arms.rest()
    np.testing.assert_allclose(bench.robot.sent[-1], 5.0 - RATE * PERIOD, atol=1e-9)  # the brake is on the other side


@pytest.mark.parametrize("torque", [None, np.zeros(3), np.full(7, np.nan)], ids=["unreadable", "three", "nan"])
def test_what_is_no_torque_goes_nowhere_and_is_silence(torque: np.ndarray | None) -> None:
    bench = WatchedRobot()
    bench.period(np.full(7, 0.5))
    while not bench.watchdog.braking:
        bench.watchdog.heard("arm", torque, bench.robot.clock())
        bench.period()
    assert bench.count * PERIOD == pytest.approx(TIMEOUT, abs=3 * PERIOD)
    assert len(bench.robot.sent) == 1


def test_an_arm_at_rest_may_keep_its_torque_while_a_trial_is_loaded() -> None:
    bench = WatchedRobot(velocity=np.full(7, 0.01))
    bench.period(np.full(7, 5.0))
    assert not any(bench.period() for _ in range(3000))
    bench.velocity = MOVING  # it is pushed
    assert any(bench.period() for _ in range(1000))


def test_an_arm_that_was_never_commanded_is_none_of_its_business() -> None:
    bench = WatchedRobot()
    assert not any(bench.period() for _ in range(200))


def test_after_a_reset_it_waits_for_the_next_command() -> None:
    bench = WatchedRobot()
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
                watchdog.heard(arm, np.zeros(7), clock())
        if watchdog.look(clock()):
            break
    assert tick * PERIOD == pytest.approx(20 * PERIOD + TIMEOUT, abs=3 * PERIOD)
    assert sent == {arms[0]: tick + 1, arms[1]: 20}


def test_a_watchdog_that_was_passed_over_sends_nothing_any_more() -> None:
    """It comes back after a stall, in which the cell has taken the robot: a command without torques says so."""
    fresh = WatchedRobot()
    fresh.watchdog.heard("arm", np.empty(0), fresh.robot.clock())
    assert not fresh.watchdog.deposed  # one that was started since
    for last in (np.full(7, 5.0), None):  # before it brakes, and while it does
        bench = WatchedRobot()
        for _ in range(20 if last is not None else 100):
            bench.period(np.full(7, 5.0) if bench.count < 20 else None)
        sent = len(bench.robot.sent)
        bench.watchdog.heard("arm", np.empty(0), bench.robot.clock())
        for _ in range(100):
            assert not bench.period(last)
        assert bench.watchdog.deposed and not bench.watchdog.braking and not bench.watchdog.commanded
        assert len(bench.robot.sent) == sent
