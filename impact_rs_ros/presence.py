# SPDX-License-Identifier: Apache-2.0
"""Liveliness: a killed or frozen node is noticed within 3 s, and so are two nodes of one name.

Every node has a publisher on ``~/alive``. The middleware asserts its *liveliness* from a thread of its own, so that
long work in Python raises no alarm. When no assertion has come for a lease, it notifies the subscribers. A node that is
alive and hangs in our own code is noticed by the timeouts of its callers.

Its one message is latched. A process that receives it knows that the node has discovered all subscriptions that the
process made before (:class:`SubscriptionsMatched`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial

from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Empty

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.qos import ALIVE, LEASE_S, PRESENT

UNKNOWN = "_NODE_NAME_UNKNOWN_"  # the middleware's name of a node with only a publisher discovered
LEASE_GRACE_S = 1.0  # a lease can lapse and be renewed at once when another publisher of the same topic leaves
LEAVING_S = 5.0  # from a publisher's end to the end of its process, on a busy machine; a frozen node's lease lapses


def announce(node: Node, topic: str = "~/alive") -> Publisher:
    """Publish the liveliness of a node for as long as its process runs."""
    publisher = node.create_publisher(Empty, topic, ALIVE)
    publisher.publish(Empty())
    return publisher


class Presence:
    """Liveliness of all nodes, as seen by one node.

    Args:
        node: Observing node; its executor delivers the liveliness events.
        names: Names of nodes, relative to its namespace.
    """

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        self._node = node
        self._alive = dict.fromkeys(names, 0)
        self._changed_at = dict.fromkeys(self._alive, -float("inf"))  # last change, on the monotonic clock [s]
        self._once_alive: set[str] = set()  # names of nodes that were alive at some time
        self._lapsed = dict.fromkeys(self._alive, False)  # whether there is a publisher whose lease lapsed
        for name in self._alive:
            node.create_subscription(
                Empty,
                f"{name}/alive",
                lambda _: None,
                PRESENT,
                raw=True,  # another publisher's bytes need not be a message
                event_callbacks=SubscriptionEventCallbacks(liveliness=partial(self._on_change, name)),
            )

    def _on_change(self, name: str, event: QoSLivelinessChangedInfo) -> None:
        if event.alive_count:
            self._once_alive.add(name)
        self._lapsed[name] = event.not_alive_count > 0
        if event.alive_count != self._alive[name]:
            self._alive[name] = event.alive_count
            self._changed_at[name] = time.monotonic()

    def forget(self, *names: str) -> None:
        """Forget nodes that may have been started again: they can be lost only after they were alive once more."""
        self._once_alive.difference_update(names)

    def absent(self) -> list[str]:
        """Nodes that are not alive now, lost or never started."""
        return [name for name, count in self._alive.items() if not count]

    def lost(self, *names: str) -> list[str]:
        """Names of given nodes that were alive and no longer are."""
        now = time.monotonic()
        return [
            name
            for name in self.absent()
            if name in names
            and name in self._once_alive
            and self._changed_at[name] < now - (LEASE_GRACE_S if self._lapsed[name] else LEAVING_S)
        ]

    def duplicates(self) -> dict[str, bool]:
        """Names that several nodes share, and whether that is certain.

        Within a lease after a change it is uncertain: one of the two may have died.
        """
        latest = time.monotonic() - LEASE_S - LEASE_GRACE_S
        return {name: self._changed_at[name] < latest for name, count in self._alive.items() if count > 1}

    def full_name(self, name: str) -> str:
        """Name of a node with its namespace, as remapped."""
        return self._node.resolve_topic_name(f"{name}/alive").removesuffix("/alive")

    def publishers(self, topic: str) -> list[str]:
        """Names, with namespace, of the nodes that publish a topic.

        A node that died is listed for 20 s. Hidden nodes such as ``ros2 topic pub`` are included.
        """
        endpoints = self._node.get_publishers_info_by_topic(topic)
        named_endpoints = [endpoint for endpoint in endpoints if endpoint.node_name != UNKNOWN]
        return sorted({f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}" for endpoint in named_endpoints})


class SubscriptionsMatched:
    """Whether the publishers of other nodes have discovered the subscriptions of this process.

    A subscription that knows its publisher receives nothing until the publisher knows the subscription as well. The
    publisher's count of subscribers is no evidence: it includes a killed one for 20 s. A process announces its
    subscriptions in order, so this class makes one more, on the latched ``~/alive`` of each node: the node that
    delivers its message has discovered all earlier subscriptions.

    Args:
        node: Node of this process.
        names: Nodes that have to discover its subscriptions, relative to its namespace.
    """

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        self._node = node
        self._topics = [f"{name}/alive" for name in names]
        self._inbox = Inbox(node, ALIVE)
        self._matched: set[str] = set()

    def begin(self) -> None:
        """Wait anew, for the discovery of every subscription that exists now."""
        self._matched.clear()
        self._inbox.connect(dict.fromkeys(self._topics, "std_msgs/msg/Empty"))

    def awaited(self) -> list[str]:
        """``NAME/alive`` of the running nodes that have not discovered the subscriptions yet."""
        self._inbox.gather()
        self._matched.update(topic for topic, _ in self._inbox.take())
        return [
            topic
            for topic in self._topics
            if topic not in self._matched and self._node.count_publishers(self._node.resolve_topic_name(topic))
        ]

    def close(self) -> None:
        """Destroy the subscriptions to ``~/alive``."""
        self._inbox.close()
