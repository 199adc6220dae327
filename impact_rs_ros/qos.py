# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every connection, with the reason; the only place it is stated."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy

from impact_rs_trials.bags import topics


def offered(topic: str) -> QoSProfile:
    """What the publisher of a recorded topic offers, as :func:`impact_rs_trials.bags.topics.offer` has it.

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
"""Publishers of signals: deep, for the recorder."""

AWAITED = QoSProfile(
    reliability=QoSReliabilityPolicy.BEST_EFFORT,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=10,
)
"""Subscribers of the lockstep. One sample is on its way at a time, more only in real time. Best effort, because an
acknowledgement per message costs a third of a round trip, and a sample that got lost is asked for again anyway."""

RECORD = QoSProfile(
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_ALL,
)
"""Subscribers of the recorder: reliable, and nothing is thrown away before it is written."""

WATCH = QoSProfile(
    reliability=QoSReliabilityPolicy.BEST_EFFORT,
    durability=QoSDurabilityPolicy.VOLATILE,
    history=QoSHistoryPolicy.KEEP_LAST,
    depth=1,
)
"""Subscribers that only want to know how things stand. Best effort: a reliable one that lost a sample shows none of the
later ones until the publisher's next heartbeat, up to 3 s later, and looks like a dead publisher meanwhile."""

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
"""Subscribers of what is said once (``/impact_event``)."""

LATCHED = offered(topics.TRIAL_INFO)
"""What is said once per trial (``/trial_info``, ``/robot_description`` and the like): who comes late still hears it."""


LEASE = 1.5  # s


def _alive(durability: QoSDurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=durability,
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=1,
        liveliness=QoSLivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=LEASE),
    )


ALIVE = _alive(QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Publishers of ``~/alive``, and who wants to be met by them. Asserted by the middleware every two thirds of the lease;
asserted by our own loops it would call a node dead that loads a scene."""

PRESENT = _alive(QoSDurabilityPolicy.VOLATILE)
"""Subscribers of ``~/alive`` that only want to know who is there."""
