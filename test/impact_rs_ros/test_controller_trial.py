# SPDX-License-Identifier: Apache-2.0
"""A controller that is told nonsense holds its arm, says what it was told, and never commands what is no number."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_control.fallback import holding_torque
from impact_rs_ros.controller_node import ControllerTrial
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.spec import TrialSpec

PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
ARM = PLAN.arms["arm"]
MOTORS = PLAN.scene.physics.arms["arm"].motor_inertia_reduced
PERIOD_NS = 1_000_000


class Wires:
    """What comes in and goes out, without a middleware."""

    due = False

    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        self.torques: list[np.ndarray] = []
        self.states = 0

    def wait(self, timeout: float) -> None:
        """Nothing is on its way."""

    def take(self) -> Iterator[tuple[str, bytes]]:
        while self.waiting:
            yield topics.joint_states("arm"), self.waiting.pop(0)

    def now(self, topic: str, tick: int, command: object) -> bytes:
        self.torques.append(command.torque)  # type: ignore[attr-defined]
        return b""

    def keep(self, topic: str, tick: int, command: object) -> None:
        self.states += 1

    def repeat(self, topic: str, data: bytes) -> None:
        """Asked again."""

    def flush(self) -> None:
        """Nothing waits."""


class Bench:
    """One trial of the controller at the start pose, tick by tick."""

    def __init__(self) -> None:
        self.wires = Wires()
        self.trial = ControllerTrial(PLAN, self.wires, self.wires)  # type: ignore[arg-type]
        self.names = self.trial._maker.joints["arm"]
        self.tick = 0

    def send(self, names: list[str] | None = None, tick: int | None = None, **changes: list[float]) -> None:
        still = {"position": ARM.initial.tolist(), "velocity": [0.0] * 7, "effort": [0.0] * 7}
        message = JointState(name=self.names if names is None else names, **still | changes)
        nanoseconds = (self.tick if tick is None else tick) * PERIOD_NS
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        self.wires.waiting.append(bytes(serialize_message(message)))
        self.tick += 1
        self.work()

    def work(self) -> None:
        """Until everything that waits was taken."""
        while self.wires.waiting:
            self.trial.work(time.monotonic() + 0.01)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"velocity": [np.nan] + [0.0] * 6}, "velocity of arm_joint1 is nan"),
        ({"position": [np.inf] * 7}, "position of arm_joint1 is inf"),
        ({"position": [0.0] * 3}, "3 values of position, expected 7"),
        ({"names": ["a", "b", "c"], "position": [0.0] * 3}, "joints a, b, c; expected arm_joint1"),
    ],
)
def test_what_cannot_be_used_is_answered_with_a_torque_that_holds_the_arm(
    changes: dict[str, list[float]], complaint: str
) -> None:
    bench = Bench()
    for _ in range(5):
        bench.send()
    assert bench.trial.failure == ""
    bench.send(**changes)  # type: ignore[arg-type]
    bench.send()
    held = holding_torque(PLAN.scene.models["arm"], MOTORS, ARM.initial, np.zeros(7))
    assert len(bench.wires.torques) == 7
    for torque in bench.wires.torques[5:]:
        np.testing.assert_allclose(torque, held)
    assert bench.trial.failure.startswith(f"/arm/joint_states at t = 0.005 s: {complaint}")
    assert bench.trial.failure.endswith("the arms were held from there on")
    assert bench.trial.status()[0] == bench.trial.failure
    assert bench.wires.states == 7


def test_a_first_state_that_cannot_be_used_is_answered_as_well() -> None:
    bench = Bench()
    bench.send(effort=[np.nan] * 7)
    np.testing.assert_allclose(
        bench.wires.torques[0], holding_torque(PLAN.scene.models["arm"], MOTORS, ARM.initial, np.zeros(7))
    )


def test_a_torque_that_is_not_finite_never_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.send()
    solve = bench.trial._controller.update

    def broken(tick: int, measured: object) -> object:
        commands = solve(tick, measured)  # type: ignore[arg-type]
        commands["arm"].torque[2] = np.nan
        return commands

    monkeypatch.setattr(bench.trial._controller, "update", broken)
    bench.send()
    assert np.isfinite(bench.wires.torques).all()
    assert bench.trial.failure.startswith("the torque for arm at t = 0.001 s is not finite")


def test_joints_in_another_order_are_the_same_joints() -> None:
    plain, turned = Bench(), Bench()
    moved = (ARM.initial + 0.01 * np.arange(7)).tolist()
    plain.send(position=moved)
    turned.send(names=turned.names[::-1], position=moved[::-1])
    np.testing.assert_array_equal(plain.wires.torques[0], turned.wires.torques[0])


def test_a_state_from_outside_the_trial_is_left_alone_and_told() -> None:
    bench = Bench()
    bench.send()
    bench.send(tick=1_700_000_000)
    bench.send(tick=1)
    assert len(bench.wires.torques) == 2
    assert bench.trial.failure == ""
    assert "1 states with a stamp outside the trial" in bench.trial.status()[0]


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 200])
def test_bytes_that_are_no_state_are_silence_and_counted(data: bytes) -> None:
    bench = Bench()
    for _ in range(3):
        bench.wires.waiting.append(data)
        bench.send()
    assert len(bench.wires.torques) == 3
    assert bench.trial.failure == ""
    assert (bench.trial.unreadable, bench.trial.note()) == (3, "3 messages could not be read")


def test_a_controller_that_raises_holds_the_arms_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.send()

    def burst(tick: int, measured: object) -> object:
        raise RuntimeError("burst")

    monkeypatch.setattr(bench.trial._controller, "update", burst)
    bench.send()
    held = holding_torque(PLAN.scene.models["arm"], MOTORS, ARM.initial, np.zeros(7))
    np.testing.assert_allclose(bench.wires.torques[1], held)
    assert bench.trial.failure.startswith("the controller at t = 0.001 s: RuntimeError: burst")
