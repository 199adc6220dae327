# SPDX-License-Identifier: Apache-2.0
"""The watchdog's node: the order in which it reads, its reset, and its end."""

from __future__ import annotations

from array import array
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from robot_bench import PERIOD, Wires
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from watched_robot import MOVING, TIMEOUT, WatchedRobot

from impact_rs_ros import watchdog_node
from impact_rs_ros.message_types import torques_of
from impact_rs_ros.watchdog_node import WatchdogNode
from impact_rs_trials.cell.effort_arms import EffortArms, watched_topic
from impact_rs_trials.cell.robot_states import STATES


def command(torque: np.ndarray) -> bytes:
    return bytes(serialize_message(Float64MultiArray(data=array("d", torque.tobytes()))))


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", command(np.ones(7))[:-1]], ids=["nothing", "no data", "cut off"])
def test_bytes_that_are_no_torques_are_none(data: bytes) -> None:
    assert torques_of(data) is None
    np.testing.assert_array_equal(torques_of(command(np.arange(7.0))), np.arange(7.0))


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
        self.bench, self.wires = WatchedRobot(), Gathered()
        self.said: list[bool] = []
        self._last_check = 0.0
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
        self._check()
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
