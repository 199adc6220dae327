# SPDX-License-Identifier: Apache-2.0
"""What is encoded and decoded by hand is what rclpy makes of it, and nothing that was sent is lost on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import rclpy
from node_trials import until
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.joint_signals import joint_signals
from impact_rs_ros.message_types import RosidlTypes, message_type
from impact_rs_ros.qos import RECORD, STREAM
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


@contextmanager
def node_with(inbox_name: str, domain: int, remap: str) -> Iterator[tuple[Node, Inbox]]:
    """A node that renames a topic, with an inbox."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node("owner", context=context, cli_args=["--ros-args", "-r", remap])
        inbox = Inbox(node, inbox_name, RECORD, raw=True)
        yield node, inbox
        inbox.close()
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def test_an_inbox_holds_everything_in_order_until_it_is_taken(domain_ids: Callable[[], int]) -> None:
    with node_with("inbox", domain_ids(), "signal:=renamed") as (node, inbox):
        inbox.connect({"signal": topics.JOINT_STATE})
        publisher = node.create_publisher(JointState, "/renamed", STREAM)
        until(lambda: inbox.publishers() == {"signal": 1}, lambda: time.sleep(0.01))

        def send(numbers: range) -> None:
            for number in numbers:
                message = JointState()
                message.header.stamp.sec = number
                publisher.publish(message)

        def receive() -> list[int]:
            return [joint_signals(data).stamp // 1_000_000_000 for topic, data in inbox.take() if topic == "signal"]

        send(range(500))
        found: list[int] = []
        until(lambda: found.extend(receive()) or len(found) == 500, lambda: inbox.wait(0.1))
        assert found == list(range(500))

        send(range(5))
        time.sleep(0.2)
        inbox.clear()
        send(range(7, 9))
        time.sleep(0.2)
        inbox.gather()
        assert receive() == [7, 8]
        assert receive() == []


def test_an_inbox_returns_readable_messages_and_counts_the_others(domain_ids: Callable[[], int]) -> None:
    with node_with("inbox", domain_ids(), "signal:=renamed") as (node, _):
        inbox = Inbox(node, "messages", RECORD)
        inbox.connect({"signal": topics.JOINT_STATE})
        publisher = node.create_publisher(JointState, "/renamed", STREAM)
        until(lambda: inbox.publishers() == {"signal": 1}, lambda: time.sleep(0.01))
        for data in (b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 100):
            publisher.publish(data)
        publisher.publish(JointState(name=["a"]))
        found = until(lambda: [message.name for _, message in inbox.take()], lambda: inbox.wait(0.1))
        assert found == [["a"]]
        assert inbox.unreadable == {"signal": 3}
        inbox.close()


def test_the_nodes_of_inboxes_are_hidden(domain_ids: Callable[[], int]) -> None:
    with node_with("inbox", domain_ids(), "signal:=renamed") as (node, _):
        assert set(node.get_node_names()) >= {"owner", "_owner_inbox"}


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
