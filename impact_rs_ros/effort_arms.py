# SPDX-License-Identifier: Apache-2.0
"""Arms behind ros2_control: joint states of one broadcaster in, torques for one effort controller per arm out.

A robot that compensates gravity itself (franka_ros2) is sent ``tau - g(q)``, every other one ``tau``. What is sent
changes no faster than the robot allows, and between trials it is the torque that brings the arm to rest and holds it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from impact_rs_control.fallback import holding_torque
from impact_rs_control.guard import rate_limited
from impact_rs_ros.joint_signals import FIELDS, joint_signals, names_of
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.sensors import ArmMeasurement

REST = 0.02  # rad/s, m/s; slower is at rest: the holding torque then changes by a thousandth of what an arm weighs


def joint_names(pattern: str, arm: str, count: int) -> list[str]:
    """Names that the robot gives the joints of an arm, base to tip.

    Args:
        pattern: With ``{arm}`` and ``{number}``, which counts from 1.
        arm: Name in the scenario.
        count: Number of joints.
    """
    return [pattern.replace("{arm}", arm).replace("{number}", str(number + 1)) for number in range(count)]


@dataclass(frozen=True)
class ArmStates:
    """One message of the joint states.

    Attributes:
        stamp: On the robot's clock [ns].
        arms: Measured state by arm; the motor's is not known, and stands for the link's.
        complaint: Why they cannot be used, in one line; empty: they can.
    """

    stamp: int
    arms: dict[str, ArmMeasurement] = field(default_factory=dict)
    complaint: str = ""


class StateReader:
    """Picks the joints of some arms out of a ``sensor_msgs/JointState``, which may hold others, in any order.

    Args:
        joints: The robot's names of the joints, by arm.
    """

    def __init__(self, joints: Mapping[str, list[str]]) -> None:
        self._joints = joints
        self._names = b""
        self._order: dict[str, list[int]] = {}
        self._count = 0

    def read(self, data: bytes) -> ArmStates | None:
        """The arms' state; None: the message is about something else, a gripper for example."""
        found = joint_signals(data)
        if found.names != self._names:
            names = names_of(found)
            wanted = [joint for joints in self._joints.values() for joint in joints]
            missing = [joint for joint in wanted if joint not in names]
            if len(missing) == len(wanted):
                return None
            if missing:
                return ArmStates(found.stamp, complaint=f"no {', '.join(missing)} among {', '.join(names)[:200]}")
            self._order = {arm: [names.index(joint) for joint in joints] for arm, joints in self._joints.items()}
            self._names, self._count = found.names, len(names)
        for name, values in zip(FIELDS, found.values, strict=True):
            if values.size != self._count:
                return ArmStates(found.stamp, complaint=f"{values.size} values of {name}, expected {self._count}")
        arms = {}
        for arm, order in self._order.items():
            position, velocity, torque = (values[order] for values in found.values)
            for name, values in zip(FIELDS, (position, velocity, torque), strict=True):
                for index in np.flatnonzero(~np.isfinite(values)):
                    told = f"{name} of {self._joints[arm][index]} is {values[index]}"
                    return ArmStates(found.stamp, complaint=told)
            arms[arm] = ArmMeasurement(position, velocity, torque, position, velocity)
        return ArmStates(found.stamp, arms)


class EffortArms:
    """The arms of one trial.

    Args:
        models: By arm.
        joints: The robot's names of the joints, by arm.
        adds_gravity: Whether the robot compensates gravity itself.
        largest_change: Of what is sent, from one message to the next [N m].
        send: Sends an arm's effort controller its torques.

    Attributes:
        states: What was measured last and can be used; None: nothing yet.
        limited: How many torques were changed because they jumped too far.
        held: Whether the last thing that was sent may stay: the arms rest, and get no more than what holds them.
    """

    def __init__(
        self,
        models: Mapping[str, RobotModel],
        joints: Mapping[str, list[str]],
        adds_gravity: bool,
        largest_change: float,
        send: Callable[[str, Array], None],
    ) -> None:
        self.states: ArmStates | None = None
        self.limited = 0
        self.held = False
        self._models = models
        self._reader = StateReader(joints)
        self._adds_gravity = adds_gravity
        self._largest_change = largest_change
        self._send = send
        self._sent: dict[str, Array] = {}

    def read(self, data: bytes) -> ArmStates | None:
        """Read a message of the joint states, and remember it if it can be used."""
        states = self._reader.read(data)
        if states is not None and not states.complaint:
            self.states = states
        return states

    def command(self, arm: str, torque: Array) -> None:
        """Send a torque, ``(n,)`` [N m], with gravity; there must be a state."""
        assert self.states is not None
        gravity = self._models[arm].gravity_torque(self.states.arms[arm].position)
        carried = gravity if self._adds_gravity else np.zeros_like(gravity)
        before = self._sent.get(arm, gravity - carried)
        wanted = torque - carried
        sent = rate_limited(wanted, before, self._largest_change)
        self.limited += not np.allclose(sent, wanted)
        self.held = False
        self._sent[arm] = sent
        self._send(arm, sent)

    def hold(self) -> None:
        """Brake, and hold; without any state nothing is sent."""
        if self.states is not None:
            before, still = self.limited, True
            for name, arm in self.states.arms.items():
                self.command(name, holding_torque(self._models[name], arm.position, arm.velocity))
                still = still and bool(np.all(np.abs(arm.velocity) <= REST))
            self.held = still and self.limited == before

    def let_go(self) -> None:
        """Carry the arms' weight and no more.

        Where no state comes nobody knows how they move, and a brake that stays on turns them round.
        """
        if self.states is not None:
            before = self.limited
            for name, arm in self.states.arms.items():
                self.command(name, self._models[name].gravity_torque(arm.position))
            self.held = self.limited == before
