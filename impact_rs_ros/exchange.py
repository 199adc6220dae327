# SPDX-License-Identifier: Apache-2.0
"""Publishing and subscribing past the node's executor, for latencies of microseconds.

An rclpy executor builds a wait set of all entities of a node for every single callback. Messages of the lockstep, and
those that the recorder stores, are taken by their owner, who waits for these subscriptions alone. They belong to the
node; a callback group keeps them from its executor, as ``automatically_add_to_executor_with_node`` can in rclcpp. That
takes a third of the time, and services and parameters do not interfere.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from impact_rs_ros.message_types import available, decoded, message_type
from impact_rs_ros.names import on_network
from impact_rs_ros.qos import offered
from impact_rs_trials.bags.streams import Stream

BURST_SAMPLES = 40  # published together, some ten ticks
MAX_BURST_AGE_S = 0.1  # wall clock: a slow trial still shows progress


class TakenByOwner(CallbackGroup):
    """Subscriptions whose messages no executor takes."""

    def can_execute(self, entity: Any) -> bool:
        del entity
        return False

    def beginning_execution(self, entity: Any) -> bool:
        del entity
        return False

    def ending_execution(self, entity: Any) -> None:
        del entity


class Inbox:
    """Subscriptions of a node polled by their owner; empty until :meth:`connect`.

    Topics are named as in :mod:`impact_rs_ros.names`, here and in :class:`Outbox`.

    Args:
        node: Node that they belong to.
        qos: Quality of service of all subscriptions.
        raw: Return serialized (CDR) messages as received; otherwise decoded messages, without unreadable ones.

    Attributes:
        unreadable: Number of messages that could not be decoded, by topic.
    """

    def __init__(self, node: Node, qos: QoSProfile, raw: bool = False) -> None:
        self._node = node
        self._qos = qos
        self._raw = raw
        self._group = TakenByOwner()
        self._subscriptions: dict[str, Subscription] = {}
        self._received: deque[tuple[str, bytes]] = deque()
        self._kinds: dict[str, Any] = {}  # classes of the messages, by topic
        self._wait_set = rclpy_implementation.WaitSet(0, 0, 0, 0, 0, 0, node.context.handle)
        self.unreadable: Counter[str] = Counter()

    def connect(self, topics: Mapping[str, str]) -> None:
        """Subscribe to these topics, type ``package/msg/Name`` by topic, and to no others."""
        self.close()
        self._kinds = {topic: message_type(kind) for topic, kind in topics.items() if available(kind)}
        self._wait_set = rclpy_implementation.WaitSet(len(self._kinds), 0, 0, 0, 0, 0, self._node.context.handle)
        for topic, kind in self._kinds.items():  # raw, because the middleware raises where bytes are no message
            self._subscriptions[topic] = self._node.create_subscription(
                kind,
                on_network(topic),
                _no_callback,
                self._qos,
                callback_group=self._group,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),  # each would be waited for
                raw=True,
            )
        self._received.clear()

    def wait(self, timeout: float) -> None:
        """Return when messages have come, or after ``timeout`` [s]."""
        if not self._subscriptions:
            time.sleep(max(0.0, timeout))
            return
        self._wait_set.clear_entities()
        for subscription in self._subscriptions.values():
            self._wait_set.add_subscription(subscription.handle)
        self._wait_set.wait(max(0, round(timeout * 1e9)))
        self.gather()

    def gather(self) -> None:
        """Receive everything that has come, in the order in which it came."""
        messages: list[tuple[int, str, bytes]] = []
        for topic, subscription in self._subscriptions.items():
            kind, take = self._kinds[topic], subscription.handle.take_message
            while (taken_message := take(kind, True)) is not None:
                data, message_info = taken_message
                messages.append((message_info["received_timestamp"], topic, data))
        messages.sort(key=_when)
        self._received.extend((topic, data) for _, topic, data in messages)

    def take(self) -> Iterator[tuple[str, Any]]:
        """Everything that has been received: topic and message."""
        while self._received:
            topic, data = self._received.popleft()
            if self._raw:
                yield topic, data
            elif (message := decoded(data, self._kinds[topic])) is not None:
                yield topic, message
            else:
                self.unreadable[topic] += 1

    def clear(self) -> None:
        """Discard received messages."""
        self.gather()
        self._received.clear()

    def publishers(self) -> dict[str, int]:
        """Number of matched publishers by topic."""
        return {topic: subscription.get_publisher_count() for topic, subscription in self._subscriptions.items()}

    def close(self) -> None:
        """Destroy the subscriptions."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.popitem()[1])


def _when(received: tuple[int, str, bytes]) -> int:
    return received[0]


def _no_callback(message: Any) -> None:
    """Callback of subscriptions that no executor serves."""
    del message


class Outbox:
    """Publishers that count their messages; empty until :meth:`connect`.

    Args:
        node: Node that publishes.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publishers: dict[str, Publisher] = {}
        self.counts: dict[str, int] = {}
        self._waiting: list[tuple[str, Any]] = []
        self._streams: dict[str, Stream] = {}
        self._samples = 0
        self._flushed = 0.0

    def connect(self, topics: Mapping[str, str]) -> None:
        """Publish these topics, type ``package/msg/Name`` by topic, and no others."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self._publishers = {
            topic: self._node.create_publisher(message_type(kind), on_network(topic), offered(topic))
            for topic, kind in topics.items()
            if available(kind)
        }
        self.reset({})

    def reset(self, streams: Mapping[str, Stream]) -> None:
        """Begin a trial: count from zero.

        Args:
            streams: Signals of every tick, by topic.
        """
        self._waiting.clear()
        self._streams = dict(streams)
        self._samples = 0
        self.begin(0)
        self.counts = dict.fromkeys(self._publishers, 0)

    def begin(self, origin_ns: int) -> None:
        """Tick 0 has this stamp [ns]."""
        for stream in self._streams.values():
            stream.origin_ns = origin_ns

    def now(self, topic: str, tick: int, sample: Any) -> bytes:
        """Publish a sample at once; returns its bytes."""
        data = self._streams[topic].serialized(tick, sample)
        self._publishers[topic].publish(data)
        self.counts[topic] += 1
        return data

    def repeat(self, topic: str, data: bytes) -> None:
        """Publish a message again that may have been lost; its timestamp is unchanged, and it is counted once."""
        self._publishers[topic].publish(data)

    def keep(self, topic: str, tick: int, sample: Any) -> None:
        """Publish a sample that no node waits for with the next burst, which wakes its subscribers once."""
        self._streams[topic].add(tick, sample)
        self._samples += 1

    def later(self, topic: str, message: Any) -> None:
        """Publish a message that no node waits for with the next burst."""
        self._waiting.append((topic, message))

    @property
    def due(self) -> bool:
        """Whether the next burst is large or old enough."""
        return self._samples >= BURST_SAMPLES or time.monotonic() - self._flushed > MAX_BURST_AGE_S

    def flush(self) -> None:
        """Publish the burst."""
        for topic, stream in self._streams.items():
            (_, rows), publish = stream.take(), self._publishers[topic].publish
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
        """Topics without a subscriber.

        The recorder checks by itself that it is a reader (:class:`~impact_rs_ros.presence.SubscriptionsMatched`). The
        number of discovered readers would not show that: one of another quality of service is never matched.
        """
        return [topic for topic, publisher in self._publishers.items() if publisher.get_subscription_count() == 0]
