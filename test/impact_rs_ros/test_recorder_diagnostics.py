# SPDX-License-Identifier: Apache-2.0
"""Diagnostics carry the time of day, a bag trial time: the recorder stores them when they came."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.recorder_node import OpenTrial
from impact_rs_trials.bags import topics


class Bag:
    """Remembers what is written, and when [ns]."""

    def __init__(self) -> None:
        self.written: list[tuple[str, int]] = []

    def write_raw(self, topic: str, nanoseconds: int, data: bytes) -> None:
        self.written.append((topic, nanoseconds))


def test_diagnostics_are_stored_at_the_trial_time_of_the_newest_signal() -> None:
    values = [0.0] * 7
    state = JointState(name=["a"] * 7, position=values, velocity=values, effort=values)
    bag, told = Bag(), DiagnosticArray()
    trial = OpenTrial("push/one", bag, ["arm"], 1.8, None, tracked=True)  # type: ignore[arg-type]
    state.header.stamp.nanosec = 200_000_000
    told.header.stamp.sec = 1_790_000_000
    for topic, message in (
        (topics.DIAGNOSTICS, told),
        (topics.joint_states("arm"), state),
        (topics.DIAGNOSTICS, told),
    ):
        trial.store(topic, bytes(serialize_message(message)))
    assert bag.written == [
        (topics.DIAGNOSTICS, 0),
        (topics.joint_states("arm"), 200_000_000),
        (topics.DIAGNOSTICS, 200_000_000),
    ]
    assert trial.time == 0.2
