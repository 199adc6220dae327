# SPDX-License-Identifier: Apache-2.0
"""What is encoded and decoded by hand is what rclpy makes of it, and nothing that was sent is lost on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from node_trials import participant
from processes import until
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import RosidlTypes, message_type
from impact_rs_ros.qos import RECORD, STREAM
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import joint_signals


@pytest.fixture(scope="module")
def owner(domain_ids: Callable[[], int]) -> Iterator[Node]:
    """A node that renames a topic."""
    with participant(domain_ids(), "owner", cli_args=["--ros-args", "-r", "signal:=renamed"]) as node:
        yield node


@contextmanager
def connected(owner: Node, raw: bool) -> Iterator[tuple[Inbox, Publisher]]:
    """An inbox, and who publishes to it."""
    inbox, publisher = Inbox(owner, RECORD, raw), owner.create_publisher(JointState, "/renamed", STREAM)
    inbox.connect({"signal": topics.JOINT_STATE})
    until(lambda: inbox.publishers() == {"signal": 1}, lambda: time.sleep(0.01))
    yield inbox, publisher
    owner.destroy_publisher(publisher)
    inbox.close()


def test_an_inbox_holds_everything_in_order_until_it_is_taken(owner: Node) -> None:
    with connected(owner, raw=True) as (inbox, publisher):

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
        until(lambda: len(inbox._received) == 5, lambda: inbox.wait(0.1))
        inbox.clear()
        send(range(7, 9))
        found.clear()
        until(lambda: found.extend(receive()) or len(found) >= 2, lambda: (time.sleep(0.01), inbox.gather()))
        assert found == [7, 8]


def test_an_inbox_returns_readable_messages_and_counts_the_others(owner: Node) -> None:
    with connected(owner, raw=False) as (inbox, publisher):
        names = owner.get_subscriber_names_and_types_by_node("owner", owner.get_namespace())
        assert ("/renamed", ["sensor_msgs/msg/JointState"]) in names  # as `ros2 node info` shows them
        assert owner.get_node_names() == ["owner"]  # and there is no other node
        for data in (b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 100):
            publisher.publish(data)
        publisher.publish(JointState(name=["a"]))
        found = until(lambda: [message.name for _, message in inbox.take()], lambda: inbox.wait(0.1))
        assert found == [["a"]]
        assert inbox.unreadable == {"signal": 3}


def test_the_executor_of_a_node_leaves_messages_to_their_owner(owner: Node) -> None:
    """Kills: a subscription that the executor serves as well, so that half of the messages go nowhere."""
    executor = SingleThreadedExecutor(context=owner.context)
    executor.add_node(owner)
    try:
        with connected(owner, raw=True) as (inbox, publisher):
            for _ in range(5):
                publisher.publish(JointState())
                executor.spin_once(timeout_sec=0.01)
            until(lambda: len(inbox._received) == 5, lambda: inbox.wait(0.1))
    finally:
        executor.remove_node(owner)
        executor.shutdown()


def test_messages_of_several_topics_are_received_in_the_order_in_which_they_came(owner: Node) -> None:
    """Kills: topic after topic, by which a recorder would see the pose of the object behind all states of its tick."""
    inbox, names = Inbox(owner, RECORD, raw=True), ("first", "second")
    ways = {name: owner.create_publisher(JointState, name, STREAM) for name in names}
    inbox.connect(dict.fromkeys(names, topics.JOINT_STATE))
    until(lambda: inbox.publishers() == {"first": 1, "second": 1}, lambda: time.sleep(0.01))
    sent = ["second", "first", "second", "second", "first"]
    for name in sent:
        ways[name].publish(JointState())
        time.sleep(0.002)  # two threads of the middleware receive them
    found: list[str] = []
    until(lambda: found.extend(name for name, _ in inbox.take()) or len(found) == 5, inbox.gather)
    assert found == sent
    inbox.close()
    for way in ways.values():
        owner.destroy_publisher(way)


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
