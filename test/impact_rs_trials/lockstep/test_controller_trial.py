# SPDX-License-Identifier: Apache-2.0
"""A controller that is told nonsense holds its arm, says what it was told, and never commands what is no number."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from robot_bench import ARM_JOINTS, MODEL, MOTORS, PUSH, START, STILL, Wires, state_message

from impact_rs_control.fallback import holding_torque
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.lockstep.controller_trial import ControllerTrial

STATES = topics.joint_states("arm")
HELD = holding_torque(MODEL, MOTORS, START, STILL)


class Bench(Wires):
    """One trial of the controller at the start pose, tick by tick."""

    def __init__(self, first_ns: int | None = None) -> None:
        """``first_ns``: stamp of the first state in ROS time; None: stamps are trial time."""
        super().__init__()
        self.trial = ControllerTrial(PUSH, MessageMaker(RosbagsTypes(), PUSH), self, self, first_ns is not None)
        self.first_ns = first_ns or 0
        self.tick = 0

    @property
    def torques(self) -> list[np.ndarray]:
        return [command.torque for command in self.samples]

    def send(self, names: list[str] = ARM_JOINTS, tick: int | None = None, **changes: Any) -> None:
        """The state of the next tick, or of another one."""
        values = {"effort": STILL} | changes
        stamp = self.first_ns + (self.tick if tick is None else tick) * 1_000_000
        self.bring(state_message(stamp, names=names, **values))
        self.tick += 1

    def bring(self, data: bytes) -> None:
        """A message comes."""
        self.waiting.append((STATES, data))
        while self.waiting:
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
    changes: dict[str, Any], complaint: str
) -> None:
    bench = Bench()
    for _ in range(5):
        bench.send()
    assert bench.trial.failure == ""
    bench.send(**changes)
    bench.send()
    assert len(bench.torques) == 7
    for torque in bench.torques[5:]:
        np.testing.assert_allclose(torque, HELD)
    assert bench.trial.failure.startswith(f"/arm/joint_states at t = 0.005 s: {complaint}")
    assert bench.trial.failure.endswith("the arms were held from there on")
    assert bench.trial.status()[0] == bench.trial.failure
    assert len(bench.kept) == 7


def test_an_arm_whose_state_is_lost_comes_to_rest() -> None:
    """Kills a fallback that brakes on the last valid velocity for ever: it goes backwards at 0.38 rad/s by then."""
    bench, velocity = Bench(), np.array([0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0])
    position = START.copy()
    for tick in range(200):
        bench.send(position=position, velocity=velocity if tick < 5 else np.full(7, np.nan))
        inertia = MODEL.mass_matrix(position) + np.diag(MOTORS)
        bias = MODEL.terms(position, velocity).bias
        velocity = velocity + 1e-3 * np.linalg.solve(inertia, bench.torques[-1] - bias)
        position = position + 1e-3 * velocity
    assert np.abs(velocity).max() < 0.1


def test_a_first_state_that_cannot_be_used_is_answered_as_well() -> None:
    bench = Bench()
    bench.send(effort=[np.nan] * 7)
    np.testing.assert_allclose(bench.torques[0], HELD)


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
    assert np.isfinite(bench.torques).all()
    assert bench.trial.failure.startswith("the torque for arm at t = 0.001 s is not finite")


def test_joints_in_another_order_are_the_same_joints() -> None:
    plain, turned = Bench(), Bench()
    moved = START + 0.01 * np.arange(7)
    plain.send(position=moved)
    turned.send(names=ARM_JOINTS[::-1], position=moved[::-1])
    np.testing.assert_array_equal(plain.torques[0], turned.torques[0])


def test_a_state_from_outside_the_trial_is_left_alone_and_told() -> None:
    bench = Bench()
    bench.send()
    bench.send(tick=1_700_000_000)
    bench.send(tick=1)
    assert len(bench.torques) == 2
    assert bench.trial.failure == ""
    assert "1 states with a stamp outside the trial" in bench.trial.status()[0]


@pytest.mark.parametrize("first_ns", [1_700_000_000_123_456_789, pytest.param(1, marks=pytest.mark.slow)])
def test_torques_do_not_depend_on_when_a_trial_begins(first_ns: int) -> None:
    """In ROS time the first state is tick 0; a period off in the origin would change the torques of a moving arm."""
    plain, later = Bench(), Bench(first_ns)
    for bench in (plain, later):
        for tick in range(400):
            bench.send(position=START + 1e-6 * tick)
    np.testing.assert_array_equal(plain.torques, later.torques)
    assert (plain.origin_ns, later.origin_ns) == (0, first_ns)
    assert later.trial.now == plain.trial.now == 399_000_000
    later.send(tick=-1)
    assert "1 states with a stamp outside the trial" in later.trial.status()[0]


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 200])
def test_bytes_that_are_no_state_are_silence_and_counted(data: bytes) -> None:
    bench = Bench()
    for _ in range(3):
        bench.bring(data)
        bench.send()
    assert len(bench.torques) == 3
    assert bench.trial.failure == ""
    assert (bench.trial.unreadable, bench.trial.note()) == (3, "3 messages could not be read")


def test_a_controller_that_raises_holds_the_arms_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.send()

    def burst(tick: int, measured: object) -> object:
        raise RuntimeError("burst")

    monkeypatch.setattr(bench.trial._controller, "update", burst)
    bench.send()
    np.testing.assert_allclose(bench.torques[1], HELD)
    assert bench.trial.failure.startswith("the controller at t = 0.001 s: RuntimeError: burst")
