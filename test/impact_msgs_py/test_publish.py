# SPDX-License-Identifier: Apache-2.0
"""Our interfaces travel through the middleware."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message

from impact_msgs_py import ControllerState

DOMAIN = 71


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Context]:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    yield context
    rclpy.shutdown(context=context)


def test_a_message_is_received_as_it_was_published(context: Context) -> None:
    node = rclpy.create_node("sender_and_receiver", context=context)
    typed: list[ControllerState] = []
    raw: list[bytes] = []
    publisher = node.create_publisher(ControllerState, "state", 1)
    node.create_subscription(ControllerState, "state", typed.append, 1)
    node.create_subscription(ControllerState, "state", raw.append, 1, raw=True)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    sent = ControllerState(
        robot="franka",
        mode=ControllerState.MODE_POST,
        net_feedback=np.array([0.1, -0.2, 0.3]),
        commanded_torque=[1.0] * 7,
    )

    deadline = time.monotonic() + 30.0
    while publisher.get_subscription_count() < 2 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.02)
    publisher.publish(sent)
    while not (typed and raw) and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.02)

    assert typed == [sent]
    assert deserialize_message(raw[0], ControllerState) == sent
    node.destroy_node()
