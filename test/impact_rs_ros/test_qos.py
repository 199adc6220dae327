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

from impact_rs_ros.qos import AWAITED, EVENT, LATCHED, RECORD, STREAM, WATCH


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


def test_who_comes_late_still_hears_what_is_said_once() -> None:
    assert LATCHED.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
    assert qos_check_compatible(LATCHED, LATCHED)[0] != QoSCompatibility.ERROR
    assert qos_check_compatible(STREAM, LATCHED)[0] == QoSCompatibility.ERROR
