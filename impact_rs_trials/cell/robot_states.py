# SPDX-License-Identifier: Apache-2.0
"""Joint states of a robot behind ros2_control: decoded, and checked before use.

A state is usable if it is new, fresh, within the limits of the arm, and consistent with the states before it
(:mod:`impact_rs_control.motion_monitor`). Arming, trials, the brake and the watchdog share this check, so that none of
them uses a state that another refuses.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from impact_rs_control.arm_limits import state_complaint
from impact_rs_control.motion_monitor import MotionMonitor
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags.joint_signals import FIELDS, joint_signals, names_of

STATES = "/joint_states"  # of joint_state_broadcaster
MIN_STEP_PERIODS = 0.5  # between the measurements of two states
RECENT, EXTRA = 100, 10  # newest messages; largest number of them that repeat a state or come between two states


class Clock(Protocol):
    """Time of the robot's timestamps, and monotonic time."""

    @property
    def known(self) -> bool:
        """Whether the time is known."""

    def now(self) -> int:
        """Time for comparisons with timestamps [ns]."""

    def steady(self) -> float:
        """Monotonic time for differences [s]."""

    def saw(self, stamp: int) -> None:
        """Note the timestamp [ns] of a received state."""


def joint_names(pattern: str, arms: Mapping[str, int]) -> dict[str, list[str]]:
    """Names that the robot gives the joints of its arms, base to tip.

    Args:
        pattern: Name with ``{arm}`` and ``{number}``, which counts from 1; or all names of an arm, base to tip,
            separated by commas, with ``{arm}`` in each name if there are several arms.
        arms: Number of joints by name of the arm in the scenario.

    Raises:
        InputError: Two joints would have one name, a name is empty, or there is not one name per joint.
    """
    joints = {}
    for arm, count in arms.items():
        arm_names = (
            [name.strip().replace("{arm}", arm) for name in pattern.split(",")] if "," in pattern else [pattern] * count
        )
        if len(arm_names) != count:
            raise InputError(
                f"{len(arm_names)} names, expected one per joint of {arm} ({count})", key="joints", value=pattern
            )
        joints[arm] = [
            name.replace("{arm}", arm).replace("{number}", str(number))
            for number, name in enumerate(arm_names, start=1)
        ]
    names = [name for arm_names in joints.values() for name in arm_names]
    if "" in names:
        raise InputError("a name is empty: expected one joint between two commas", key="joints", value=pattern)
    if len(set(names)) < len(names):
        missing = "{number}" if any(len(set(arm_names)) < len(arm_names) for arm_names in joints.values()) else "{arm}"
        expected = f"{missing} in it: {len(names)} joints of {', '.join(arms)} need names of their own"
        raise InputError(f"expected {expected}", key="joints", value=pattern)
    return joints


@dataclass(frozen=True)
class ArmStates:
    """One message of the joint states.

    Attributes:
        stamp: Timestamp on the robot's clock [ns].
        arms: Measured state by arm; the unknown state of a motor is set to the state of its link.
        complaint: Reason why the states are not usable, in one line; empty: they are usable.
    """

    stamp: int
    arms: dict[str, ArmMeasurement] = field(default_factory=dict)
    complaint: str = ""


class StateReader:
    """Reads the joints of some arms from a ``sensor_msgs/JointState``, which may have further joints, in any order.

    Args:
        joints: The robot's names of the joints, by arm.

    Attributes:
        unreadable: Number of messages that could not be decoded.
    """

    def __init__(self, joints: Mapping[str, list[str]]) -> None:
        self.unreadable = 0
        self._joints = joints
        self._names = b""
        self._order: dict[str, list[int]] = {}
        self._count = 0

    def read(self, data: bytes) -> ArmStates | None:
        """The arms' states; None: a message of other joints, such as a gripper's, or not readable (as if lost)."""
        signals = joint_signals(data)
        if not signals.readable:
            self.unreadable += 1
            return None
        if signals.names != self._names:
            names = names_of(signals)
            needed = [joint for joints in self._joints.values() for joint in joints]
            missing = [joint for joint in needed if joint not in names]
            if len(missing) == len(needed):
                return None
            if missing:
                return ArmStates(signals.stamp, complaint=f"no {', '.join(missing)} among {', '.join(names)[:200]}")
            if repeated := [joint for joint in needed if names.count(joint) > 1]:
                return ArmStates(
                    signals.stamp, complaint=f"{repeated[0]} is {names.count(repeated[0])} times in one message"
                )
            self._order = {arm: [names.index(joint) for joint in joints] for arm, joints in self._joints.items()}
            self._names, self._count = signals.names, len(names)
        for name, values in zip(FIELDS, signals.values, strict=True):
            if values.size != self._count:
                return ArmStates(signals.stamp, complaint=f"{values.size} values of {name}, expected {self._count}")
        arms = {}
        for arm, order in self._order.items():
            position, velocity, torque = (values[order] for values in signals.values)
            for name, values in zip(FIELDS, (position, velocity, torque), strict=True):
                for index in np.flatnonzero(~np.isfinite(values)):
                    complaint = f"{name} of {self._joints[arm][index]} is {values[index]}"
                    return ArmStates(signals.stamp, complaint=complaint)
            arms[arm] = ArmMeasurement(position, velocity, torque, position, velocity)
        return ArmStates(signals.stamp, arms)


class RobotStates:
    """The usable states of the robot's arms.

    Args:
        models: Models by arm.
        joints: The robot's names of the joints, by arm.
        period: Period of the states [s].
        timeout: Largest age of a usable state [s].
        clock: Clock of the robot.

    Attributes:
        models, joints, period, clock: As above.
        latest: The last usable state; None: not yet.
        commanded: Torque of a controller by arm, with or without gravity, ``(n,)`` [N m]; empty: the arms are held.
        oldest: Largest age of a state on arrival [s].
    """

    def __init__(
        self,
        models: Mapping[str, RobotModel],
        joints: Mapping[str, list[str]],
        period: float,
        timeout: float,
        clock: Clock,
    ) -> None:
        self.latest: ArmStates | None = None
        self.commanded: dict[str, Array] = {}
        self.oldest = 0.0
        self.models = models
        self.joints = joints
        self.period = period
        self._timeout = timeout
        self.clock = clock
        self._reader = StateReader(joints)
        self._monitors = {arm: MotionMonitor(model, joints[arm]) for arm, model in models.items()}
        self._measured = 0.0  # time of measurement of the last usable state, on the steady clock [s]
        self._newest: int | None = None  # stamp [ns]
        self._extra: deque[bool] = deque(maxlen=RECENT)

    @property
    def unreadable(self) -> int:
        """Number of messages that could not be decoded; they are treated as lost."""
        return self._reader.unreadable

    @property
    def age(self) -> float:
        """Age of the last usable state [s]."""
        return float("inf") if self.latest is None else self.clock.steady() - self._measured

    def read(self, data: bytes) -> ArmStates | None:
        """The state in a message, with a complaint if it is not usable; None: no new state."""
        states = self._reader.read(data)
        if states is None:
            return None
        if not states.complaint:
            self.clock.saw(states.stamp)
            if not self._is_new(states):
                return self._two_sources(states)
            complaint = self._too_old(states) or self._impossible(states)
            states = replace(states, complaint=complaint)
        if not states.complaint:
            self.latest = states
            self._measured = self.clock.steady() - max(0.0, self._age_of(states))
        return states

    def _age_of(self, states: ArmStates) -> float:
        """Age by its timestamp [s]; negative: from the future."""
        return 1e-9 * (self.clock.now() - states.stamp)

    def _is_new(self, states: ArmStates) -> bool:
        """Whether a state was measured a period after the newest one: neither a repetition nor from a second source."""
        min_step = MIN_STEP_PERIODS * self.period * 1e9
        new = self._newest is None or states.stamp - self._newest > min_step
        # An old timestamp: a late state, or a restarted robot. The next states show which.
        new = new or (self._newest is not None and self._newest - states.stamp > self._timeout * 1e9)
        self._extra.append(not new)
        if new:
            self._newest = states.stamp
        return new

    def _two_sources(self, states: ArmStates) -> ArmStates | None:
        extra = sum(self._extra)
        if extra <= EXTRA:
            return None
        complaint = (
            f"{extra} of the last {len(self._extra)} states repeat one or come between two: are there two publishers "
            f"of these joints? Or do the states come faster than timing.control_period, {1e3 * self.period:g} ms?"
        )
        return replace(states, complaint=complaint)

    def _too_old(self, states: ArmStates) -> str:
        age, limit = self._age_of(states), self._timeout
        self.oldest = max(self.oldest, age)
        if age > limit:
            return f"the robot's state is {age:.4f} s old, state_timeout is {limit:g} s"
        if age < -self.period:
            return f"the robot's state is stamped {-age:.4f} s in the future, by this machine's clock"
        return ""

    def _impossible(self, states: ArmStates) -> str:
        for name, arm in states.arms.items():
            model, joints = self.models[name], self.joints[name]
            if complaint := state_complaint(model, joints, arm.position, arm.velocity, arm.torque):
                return complaint
        for name, arm in states.arms.items():
            time, torque = 1e-9 * states.stamp, self.commanded.get(name)
            if complaint := self._monitors[name].complaint(time, arm.position, arm.velocity, torque):
                return complaint
        return ""
