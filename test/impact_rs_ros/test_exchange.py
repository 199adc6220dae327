"""What is encoded and decoded by hand is what rclpy makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.exchange import joint_signals
from impact_rs_ros.message_types import RosidlTypes, message_type
from impact_rs_trials.bags import topics


@pytest.mark.parametrize("names", [[], ["a"], ["arm_joint_1", "arm_joint_12", "b"]])
@pytest.mark.parametrize("frame", ["", "world", "a_frame"])
def test_joint_signals_are_those_that_were_sent(names: list[str], frame: str) -> None:
    rng = np.random.default_rng(1)
    sent = JointState(name=names, position=rng.normal(size=7).tolist(), effort=rng.normal(size=3).tolist())
    sent.header.frame_id = frame
    sent.header.stamp.sec, sent.header.stamp.nanosec = 3, 999_999_999
    found = joint_signals(serialize_message(sent))
    assert found.stamp == 3_999_999_999
    np.testing.assert_array_equal(found.values[0], sent.position)
    assert found.values[1].size == 0
    np.testing.assert_array_equal(found.values[2], sent.effort)


def test_a_message_made_from_all_its_fields_is_like_a_constructed_one() -> None:
    types = RosidlTypes()
    stamp = types.type("builtin_interfaces/msg/Time")(sec=1, nanosec=2)
    header = types.type("std_msgs/msg/Header")(stamp=stamp, frame_id="world")
    floats = types.floats(np.array([1.0, 2.0]))
    fields = {"header": header, "name": ["a", "b"], "position": floats, "velocity": floats, "effort": floats}
    made = types.type(topics.JOINT_STATE)(**fields)
    kind = message_type(topics.JOINT_STATE)
    assert isinstance(made, kind)
    assert deserialize_message(serialize_message(made), kind) == made
