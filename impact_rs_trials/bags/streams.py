# SPDX-License-Identifier: Apache-2.0
"""Signals of every tick, stored as samples and serialized in bursts.

Filling and serializing a message object per tick and topic costs more than the physics. Here a sample is stored when it
is measured, and a whole burst is serialized column by column. The bytes equal the messages that
:class:`~impact_rs_trials.bags.messages.MessageMaker` makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any

import numpy as np

from impact_rs_control.controller import ArmCommand, Mode
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.plant.plant import ArmTruth
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.cdr import Template
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes, reference_columns
from impact_rs_trials.bags.types import NS_PER_S, typestore


def _component(name: str, index: int) -> Callable[[Any], float]:
    """Reads one entry of a vector of a sample."""

    def get(sample: Any) -> float:
        return float(getattr(sample, name)[index])

    return get


_STATE = {"position": "position", "velocity": "velocity", "effort": "torque"}
_MOTOR = {"position": "motor_position", "velocity": "motor_velocity"}
_COMMAND = {
    "mode": "mode",
    "gamma": "gamma",
    "position": "position",
    "twist": "twist",
    "feedback_acceleration": "feedback",
    "net_feedback": "net_feedback",
    "commanded_torque": "torque",
    "external_wrench": "wrench",
    "qp_status": "qp_status",
    "qp_iterations": "qp_iterations",
    "qp_solve_time": "qp_solve_time",
}


class Stream:
    """One topic with a sample per tick.

    Args:
        kind: Type ``package/msg/Name``.
        example: A message of the ``rosbags`` typestore.
        period_ns: Duration of a tick [ns].
        fields: Attribute of the sample by field path of the message.
        tables: One row per tick of the trial, by field path.

    Attributes:
        origin_ns: Stamp of tick 0 [ns].
    """

    def __init__(
        self,
        kind: str,
        example: Any,
        period_ns: int,
        fields: Mapping[str, str | Callable[[Any], Any]],
        tables: Mapping[str, Array] | None = None,
    ) -> None:
        self.origin_ns = 0
        self._template = Template.of(typestore(), kind, example)
        self._period_ns = period_ns
        self._fields = {path: attrgetter(get) if isinstance(get, str) else get for path, get in fields.items()}
        self._tables = tables or {}
        self._ticks: list[int] = []
        self._samples: list[Any] = []

    def add(self, tick: int, sample: Any) -> None:
        """Store a sample; it must not be changed afterwards."""
        self._ticks.append(tick)
        self._samples.append(sample)

    def take(self) -> tuple[list[int], list[bytes]]:
        """Stored samples, which are removed: trial times [ns] and serialized messages."""
        if not self._ticks:
            return [], []
        ticks, samples = np.array(self._ticks), self._samples
        self._ticks, self._samples = [], []
        times = ticks * self._period_ns
        seconds, nanoseconds = np.divmod(self.origin_ns + times, NS_PER_S)
        columns: dict[str, Any] = {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds}
        columns |= {path: list(map(get, samples)) for path, get in self._fields.items()}
        columns |= {path: table[ticks] for path, table in self._tables.items()}
        return times.tolist(), self._template.rows(columns, len(ticks))

    def serialized(self, tick: int, sample: Any) -> bytes:
        """The message of one sample, serialized at once."""
        seconds, nanoseconds = divmod(self.origin_ns + tick * self._period_ns, NS_PER_S)
        columns: dict[str, Any] = {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds}
        columns |= {path: get(sample) for path, get in self._fields.items()}
        (row,) = self._template.rows(columns, 1)
        return row


class StreamMaker:
    """Makes the streams of one trial.

    Args:
        plan: The trial.
    """

    def __init__(self, plan: TrialPlan) -> None:
        self._plan = plan
        self._maker = MessageMaker(RosbagsTypes(), plan)
        self._period_ns = self._maker.nanoseconds(1)

    def of_plant(self) -> dict[str, Stream]:
        """Streams of the signals that the plant publishes in every tick, by topic."""
        streams = {}
        for arm in self._plan.arms:
            streams[topics.joint_states(arm)] = self.joint_states(arm)
            streams[topics.motor_states(arm)] = self.motor_states(arm)
            streams[topics.truth_joint_states(arm)] = self.joint_states(arm)
            streams[topics.truth_contact_wrench(arm)] = self.contact_wrench(arm)
        return streams

    def of_controller(self) -> dict[str, Stream]:
        """Streams of the signals that the controller publishes in every tick, by topic."""
        streams = {}
        for arm in self._plan.arms:
            streams[topics.joint_command(arm)] = self.joint_command(arm)
            streams[topics.controller_state(arm)] = self.controller_state(arm)
        return streams

    def _joints(self, arm: str) -> Array:
        return np.zeros(self._plan.arms[arm].initial.size)

    def _state_example(self, arm: str) -> Any:
        return self._maker.joint_states(0, arm, ArmMeasurement(*[self._joints(arm)] * 5))

    def joint_states(self, arm: str) -> Stream:
        """Stream of joint states, from measurements or truth."""
        return Stream(topics.JOINT_STATE, self._state_example(arm), self._period_ns, _STATE)

    def motor_states(self, arm: str) -> Stream:
        """Stream of motor states, from measurements."""
        example = self._maker.motor_states(0, arm, ArmMeasurement(*[self._joints(arm)] * 5))
        return Stream(topics.JOINT_STATE, example, self._period_ns, _MOTOR)

    def contact_wrench(self, arm: str) -> Stream:
        """Stream of contact wrenches, from truth."""
        q = self._joints(arm)
        example = self._maker.truth_contact_wrench(0, ArmTruth(q, q, q, q, q, np.zeros(3)))
        fields = {f"wrench.force.{axis}": _component("pad_force", index) for index, axis in enumerate("xyz")}
        return Stream(topics.WRENCH, example, self._period_ns, fields)

    def joint_command(self, arm: str) -> Stream:
        """Stream of commanded torques, from commands of the controller."""
        example = self._maker.joint_command(0, arm, self._joints(arm))
        return Stream(topics.JOINT_STATE, example, self._period_ns, {"effort": "torque"})

    def controller_state(self, arm: str) -> Stream:
        """Stream of controller states, from commands of the controller."""
        three, six = np.zeros(3), np.zeros(6)
        command = ArmCommand(
            torque=self._joints(arm),
            mode=next(iter(Mode)),
            gamma=0.0,
            position=three,
            twist=six,
            task_feedback=np.zeros(7),
            net_feedback=three,
            wrench=six,
            qp_status=next(iter(QpStatus)),
            qp_iterations=0,
            qp_solve_time=0.0,
            detection=None,
        )
        example = self._maker.controller_state(0, arm, command)
        tables = reference_columns(self._plan.arms[arm])
        tables["trial_time"] = 1e-9 * (self._period_ns * np.arange(len(tables["ante_position"]), dtype=np.float64))
        return Stream(topics.CONTROLLER_STATE, example, self._period_ns, _COMMAND, tables)
