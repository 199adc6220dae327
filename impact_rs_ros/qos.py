# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every connection, with the reason; the only place it is stated."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy

from impact_rs_trials.bags import topics


def offered(topic: str) -> QoSProfile:
    """QoS that the publisher of a recorded topic offers, from :func:`impact_rs_trials.bags.topics.offer`.

    Reliable, because the recorder must not lose a sample.

    Args:
        topic: Its name in the root namespace.
    """
    offer = topics.offer(topic)
    return QoSProfile(
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if offer.latched else QoSDurabilityPolicy.VOLATILE,
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=offer.depth,
    )


STREAM = offered(topics.joint_states("arm"))
"""Publishers of signals, with a long history for the recorder."""

AWAITED = QoSProfile(
    reliability=QoSReliabilityPolicy.BEST_EFFORT,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=10,
)
"""Subscribers of the lockstep. One sample is under way at a time, more only in real time. Best effort, because an
acknowledgement per message costs a third of a round trip, and a lost sample is requested again anyway."""

RECORD = QoSProfile(
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_ALL,
)
"""Subscribers of the recorder: reliable, and no sample is discarded before it is written."""

WATCH = QoSProfile(
    reliability=QoSReliabilityPolicy.BEST_EFFORT,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=1,
)
"""Subscribers that need only the newest sample. Best effort: a reliable subscriber that lost a sample delivers no later
ones until the publisher's next heartbeat, up to 3 s later; meanwhile the publisher seems dead."""

COMMAND = QoSProfile(
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=1,
)
"""Publishers of torques for ros2_control, whose controllers subscribe reliably. Only the newest torque is worth
sending."""

EVENT = QoSProfile(
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=10,
)
"""Subscribers of events (``/impact_event``)."""

LATCHED = offered(topics.TRIAL_INFO)
"""Topics with one message per trial (``/trial_info``, ``/robot_description``); late subscribers receive it, too."""


LEASE_S = 1.5


def _alive(durability: QoSDurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=durability,
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=1,
        liveliness=QoSLivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=LEASE_S),
    )


ALIVE = _alive(QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Publishers of ``~/alive``, and the subscribers that test for discovery by them. The middleware asserts liveliness
every two thirds of the lease; asserted by our own loops, a node that loads a scene would seem dead."""

PRESENT = _alive(QoSDurabilityPolicy.VOLATILE)
"""Subscribers of ``~/alive`` that only observe liveliness."""
