# SPDX-License-Identifier: Apache-2.0
"""A robot behind ros2_control without processes: its clock is the test's, its messages are what a test says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.cell.effort_arms import EffortArms
from impact_rs_trials.cell.robot_states import RobotStates, joint_names
from impact_rs_trials.spec import TrialSpec

PUSH = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
GRAB = TrialSpec.of(load_scenario("grab"), "juice", "case_1").plan
MAKER = MessageMaker(RosbagsTypes(), PUSH)
MODEL = PUSH.scene.models["arm"]
MOTORS = PUSH.scene.physics.arms["arm"].motor_inertia_reduced
START = PUSH.arms["arm"].initial
STILL = np.zeros(7)
WEIGHT = MODEL.gravity_torque(START)
JOINTS = joint_names("fr3_joint{number}", {"arm": 7})["arm"]
ARM_JOINTS = [f"arm_joint{number}" for number in range(1, 8)]
PERIOD = 0.001  # s
RATE = 1000.0  # N m/s
LIMIT = 0.01  # s, state_timeout
SWITCHED_ON = 1_700_000_000 * 10**9  # ns, on the robot's clock


class TestClock:
    """Time passes where the test says so."""

    __test__ = False
    known = True

    def __init__(self) -> None:
        self.time = 100.0  # s

    def __call__(self) -> float:
        return self.time

    def now(self) -> int:
        return SWITCHED_ON + round(1e9 * (self.time - 100.0))

    def steady(self) -> float:
        return self.time

    def saw(self, stamp: int) -> None:
        """This clock needs no states."""


def state_message(
    stamp: int,
    position: np.ndarray = START,
    velocity: np.ndarray = STILL,
    effort: np.ndarray = WEIGHT,
    names: list[str] | None = None,
) -> bytes:
    """A serialized ``sensor_msgs/JointState``; ``stamp`` in ns."""
    message = JointState(name=JOINTS if names is None else names)
    message.position, message.velocity, message.effort = list(position), list(velocity), list(effort)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return bytes(serialize_message(message))


@dataclass
class Robot:
    """One arm, what was sent to it, and the next state's stamp."""

    adds_gravity: bool = True
    clock: TestClock = field(default_factory=TestClock)
    sent: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.states = RobotStates({"arm": MODEL}, {"arm": JOINTS}, PERIOD, LIMIT, self.clock)
        self.arms = EffortArms(
            self.states, {"arm": MOTORS}, self.adds_gravity, RATE, lambda arm, tau: self.sent.append(tau)
        )

    def message(self, age: float = 0.0, **changes: object) -> bytes:
        """The state of now, or of ``age`` [s] before."""
        return state_message(self.clock.now() - round(1e9 * age), **changes)  # type: ignore[arg-type]

    def state(self, age: float = 0.0, **changes: object):  # noqa: ANN201
        """A period passes, and a state comes."""
        self.clock.time += PERIOD
        return self.states.read(self.message(age, **changes))


def torque_message(tick: int, torque: np.ndarray, origin_ns: int = 0) -> bytes:
    """The controller's answer to a tick of 1 ms, ``torque`` in N m by joint."""
    message = JointState(name=ARM_JOINTS, effort=list(torque))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(origin_ns + tick * 1_000_000, 10**9)
    return bytes(serialize_message(message))


class Wires:
    """Inbox and outbox of a trial, without a middleware: what waits, and what was published."""

    due = False

    def __init__(self) -> None:
        self.waiting: list[tuple[str, bytes]] = []
        self.asked: list[int] = []  # ticks of samples that were published at once
        self.samples: list[Any] = []  # these samples
        self.kept: list[Any] = []  # samples and messages of the next burst
        self.origin_ns = 0  # stamp of tick 0

    def wait(self, timeout: float) -> None:
        """Nothing is on its way."""

    def take(self) -> Iterator[tuple[str, bytes]]:
        while self.waiting:
            yield self.waiting.pop(0)

    def begin(self, origin_ns: int) -> None:
        self.origin_ns = origin_ns

    def now(self, topic: str, tick: int, sample: Any) -> bytes:
        self.asked.append(tick)
        self.samples.append(sample)
        return b""

    def keep(self, topic: str, tick: int, sample: Any) -> None:
        self.kept.append(sample)

    def later(self, topic: str, message: Any) -> None:
        self.kept.append(message)

    def repeat(self, topic: str, data: bytes) -> None:
        """Published again."""

    def flush(self) -> None:
        """Nothing waits."""


class Wire:
    """An inbox whose messages come when the clock has reached them."""

    def __init__(self, clock: TestClock) -> None:
        self._clock = clock
        self._waiting: list[tuple[float, str, bytes]] = []

    def put(self, when: float, topic: str, data: bytes) -> None:
        """A message that comes at ``when`` [s]."""
        self._waiting.append((when, topic, data))
        self._waiting.sort(key=lambda message: message[0])

    def wait(self, timeout: float) -> None:
        until = self._clock.time + timeout
        self._clock.time = min(until, max(self._clock.time, self._waiting[0][0])) if self._waiting else until

    def take(self) -> Iterator[tuple[str, bytes]]:
        while self._waiting and self._waiting[0][0] <= self._clock.time + 1e-12:
            _, topic, data = self._waiting.pop(0)
            yield topic, data
