"""Sending and receiving past the executor, where microseconds count.

An rclpy executor builds a wait set of everything a node has for every single callback. What is awaited in the lockstep,
and what the recorder stores, is taken by the node itself instead; services and parameters stay with the executor.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

from impact_rs_ros.message_types import available, message_type
from impact_rs_ros.streams import Stream
from impact_rs_sim.robot import Array

BURST = 40  # samples that wait for each other, some ten ticks
BURST_AGE = 0.1  # s, wall clock: a slow trial still shows that it goes on


class _NotForTheExecutor(CallbackGroup):
    """Callback group that no executor ever executes."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return


class Inbox:
    """Subscriptions that their owner reads.

    Args:
        node: Node that subscribes.
        topics: Type ``package/msg/Name`` by topic.
        qos: Quality of service of all of them.
        raw: Hand out serialized (CDR) messages.
    """

    def __init__(self, node: Node, topics: Mapping[str, str], qos: QoSProfile, raw: bool = False) -> None:
        self._node = node
        group = _NotForTheExecutor()
        self._subscriptions = {
            topic: node.create_subscription(message_type(kind), topic, _ignore, qos, callback_group=group, raw=raw)
            for topic, kind in topics.items()
            if available(kind)
        }
        self._handles = [(topic, s.handle, s.msg_type) for topic, s in self._subscriptions.items()]
        self._raw = raw
        self._wait_set = rclpy_implementation.WaitSet(len(self._handles), 0, 0, 0, 0, 0, node.context.handle)

    def wait(self, timeout: float) -> None:
        """Return when a message is there, or after ``timeout`` [s]."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        for _, handle, _ in self._handles:
            wait_set.add_subscription(handle)
        wait_set.wait(max(0, int(timeout * 1e9)))

    def take(self) -> Iterator[tuple[str, Any]]:
        """Everything that has been received: topic and message."""
        raw = self._raw
        for topic, handle, kind in self._handles:
            while (taken := handle.take_message(kind, raw)) is not None:
                yield topic, taken[0]

    def clear(self) -> None:
        """Throw away what has been received."""
        for _ in self.take():
            pass

    def publishers(self) -> dict[str, int]:
        """Number of matched publishers by topic."""
        return {topic: handle.get_publisher_count() for topic, handle, _ in self._handles}

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)


class Outbox:
    """Publishers that count what they publish.

    Args:
        node: Node that publishes.
        topics: Type ``package/msg/Name`` by topic.
        qos: Quality of service of all of them.
    """

    def __init__(self, node: Node, topics: Mapping[str, str], qos: QoSProfile) -> None:
        self._node = node
        self._publishers = {
            topic: node.create_publisher(message_type(kind), topic, qos)
            for topic, kind in topics.items()
            if available(kind)
        }
        self._publish = {topic: publisher.handle.publish_raw for topic, publisher in self._publishers.items()}
        self.counts = dict.fromkeys(self._publishers, 0)
        self._waiting: list[tuple[str, Any]] = []
        self._streams: dict[str, Stream] = {}
        self._samples = 0
        self._flushed = 0.0

    def reset(self, streams: Mapping[str, Stream]) -> None:
        """Begin a trial: count from zero.

        Args:
            streams: Signals of every tick, by topic.
        """
        self._waiting.clear()
        self._streams = dict(streams)
        self._samples = 0
        self.counts = dict.fromkeys(self._publishers, 0)

    def now(self, topic: str, tick: int, sample: Any) -> bytes:
        """Publish a sample that is awaited; returns its bytes."""
        data = self._streams[topic].one(tick, sample)
        self._publish[topic](data)
        self.counts[topic] += 1
        return data

    def repeat(self, topic: str, data: bytes) -> None:
        """Publish once more what may have got lost; it has the stamp it had, and counts as the same message."""
        self._publish[topic](data)

    def keep(self, topic: str, tick: int, sample: Any) -> None:
        """Publish a sample that nobody waits for with the next burst, which wakes its readers once."""
        self._streams[topic].add(tick, sample)
        self._samples += 1

    def later(self, topic: str, message: Any) -> None:
        """Publish a message that nobody waits for with the next burst."""
        self._waiting.append((topic, message))

    @property
    def due(self) -> bool:
        """Whether a burst has come together."""
        return self._samples >= BURST or time.monotonic() - self._flushed > BURST_AGE

    def flush(self) -> None:
        """Publish what waits."""
        for topic, stream in self._streams.items():
            rows, publish = stream.take(), self._publish[topic]
            for row in rows:
                publish(row)
            self.counts[topic] += len(rows)
        for topic, message in self._waiting:
            if (publisher := self._publishers.get(topic)) is not None:  # else its type is not installed
                publisher.publish(message)
                self.counts[topic] += 1
        self._waiting.clear()
        self._samples = 0
        self._flushed = time.monotonic()

    def unmatched(self) -> list[str]:
        """Topics that nobody listens to, or not everybody yet of whom this node knows."""
        return [
            topic
            for topic, publisher in self._publishers.items()
            if publisher.get_subscription_count() < max(1, self._node.count_subscribers(topic))
        ]

    def close(self) -> None:
        """Take the publishers down."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)


@dataclass(frozen=True)
class JointSignals:
    """A ``sensor_msgs/JointState`` without its names.

    Attributes:
        stamp: Time of the signals [ns].
        values: Position, velocity and effort, ``(n,)`` or ``(0,)`` each.
    """

    stamp: int
    values: tuple[Array, Array, Array]


def joint_signals(data: bytes) -> JointSignals:
    """Decode a serialized ``sensor_msgs/JointState``; rclpy takes ten times as long over it.

    XCDR1: a value is aligned to its size, counted from behind the four bytes of the encapsulation header; a sequence
    and a string begin with their length.
    """
    order = "<" if data[1] else ">"
    integer = struct.Struct(order + "I").unpack_from
    seconds, nanoseconds, length = struct.unpack_from(order + "iII", data, 4)
    at = 16 + length
    at += -at % 4
    (names,) = integer(data, at)
    at += 4
    for _ in range(names):
        at += -at % 4
        at += 4 + integer(data, at)[0]
    values = []
    for _ in range(3):
        at += -at % 4
        (count,) = integer(data, at)
        at += 4
        if count:
            at += -(at - 4) % 8
        values.append(np.frombuffer(data, order + "f8", count, at).astype(np.float64))
        at += 8 * count
    return JointSignals(seconds * 1_000_000_000 + nanoseconds, (values[0], values[1], values[2]))


def _ignore(message: Any) -> None:
    del message
