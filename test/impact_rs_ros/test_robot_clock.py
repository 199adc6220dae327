# SPDX-License-Identifier: Apache-2.0
"""The clock of a robot's timestamps is this machine's, or a simulator's, however slow."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from impact_rs_ros import robot_clock
from impact_rs_ros.robot_clock import MAX_CLOCK_SILENCE_S, RobotClock
from impact_rs_trials.bags import topics


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
    clock.saw(6_300_000_000)
    assert not clock.known and clock.now() == 0
    simulator.tick(6.0)
    clock.saw(6_300_000_000)
    assert clock.now() == 6_300_000_000
    simulator.tick(8.0)
    assert clock.now() == 8 * 10**9


def test_one_state_from_far_ahead_does_not_move_the_simulated_time(simulator: Simulator) -> None:
    """Kills the newest stamp of all as the time: all states after it were an hour old, until the node was restarted."""
    simulator.tick(5.0)
    simulator.clock.saw(3600 * 10**9)
    assert simulator.clock.now() == 5 * 10**9


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
