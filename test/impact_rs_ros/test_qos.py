# SPDX-License-Identifier: Apache-2.0
"""Every subscriber can hear its publisher: an offer is never less than what is asked for."""

from __future__ import annotations

import pytest
from rclpy.qos import (
    QoSCompatibility,
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSReliabilityPolicy,
    qos_check_compatible,
)

from impact_rs_ros.qos import AWAITED, EVENT, LATCHED, RECORD, STREAM, WATCH, offered
from impact_rs_trials.bags import topics


@pytest.mark.parametrize("subscriber", [AWAITED, RECORD, WATCH, EVENT], ids=["awaited", "record", "watch", "event"])
@pytest.mark.parametrize("publisher", [STREAM, LATCHED], ids=["stream", "latched"])
def test_a_subscriber_of_any_kind_hears_a_publisher_of_any_kind(publisher, subscriber) -> None:
    compatibility, reason = qos_check_compatible(publisher, subscriber)
    assert compatibility != QoSCompatibility.ERROR, reason


def test_the_recorder_loses_nothing_and_nobody_waits_for_it() -> None:
    assert RECORD.reliability == QoSReliabilityPolicy.RELIABLE
    assert RECORD.history == QoSHistoryPolicy.KEEP_ALL
    assert STREAM.reliability == QoSReliabilityPolicy.RELIABLE
    assert STREAM.history == QoSHistoryPolicy.KEEP_LAST, "a publisher that keeps all blocks when a subscriber dies"


def test_only_signals_of_every_tick_have_a_deep_history() -> None:
    depths = {topic: offered(topic).depth for topic in topics.recorded(["arm"])}
    deep = {topic for topic, depth in depths.items() if depth == STREAM.depth}
    arms = (topics.joint_states, topics.motor_states, topics.joint_command, topics.controller_state)
    arms += (topics.truth_joint_states, topics.truth_contact_wrench)
    poses = {topics.OBJECT_POSE, topics.TRUTH_OBJECT_POSE, topics.TRUTH_OBJECT_TWIST}
    assert deep == {*(name("arm") for name in arms), *poses}
    assert max(depth for topic, depth in depths.items() if topic not in deep) == 100


def test_static_frames_are_latched_as_tf2_expects() -> None:
    assert offered(topics.TF_STATIC).durability == QoSDurabilityPolicy.TRANSIENT_LOCAL


def test_who_comes_late_still_hears_what_is_said_once() -> None:
    assert LATCHED.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
    assert qos_check_compatible(LATCHED, LATCHED)[0] != QoSCompatibility.ERROR
    assert qos_check_compatible(STREAM, LATCHED)[0] == QoSCompatibility.ERROR
