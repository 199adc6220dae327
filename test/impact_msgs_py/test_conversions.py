# SPDX-License-Identifier: Apache-2.0
"""Messages and arrays: what goes in comes out again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message

import impact_msgs_py
from impact_msgs_py import ControllerState, FinishTrial, ImpactProblem, RunTrial, TrialOutcome
from impact_msgs_py import conversions as convert
from impact_rs_trials.bags.trial_info import OUTCOMES

numbers = st.floats(allow_nan=False, allow_infinity=False)


def vectors(size: int) -> st.SearchStrategy[list[float]]:
    return st.lists(numbers, min_size=size, max_size=size)


@given(st.integers(-(2**23), 2**23 - 1), st.integers(0, 10**9 - 1))
def test_time_round_trip_is_exact_to_the_nanosecond(sec: int, nanosec: int) -> None:
    message = Time(sec=sec, nanosec=nanosec)
    assert convert.time_to_message(convert.time_from_message(message)) == message


@given(st.floats(-(2.0**31), 2.0**31 - 1))
def test_time_is_off_by_at_most_half_a_nanosecond(seconds: float) -> None:
    back = convert.time_from_message(convert.time_to_message(seconds))
    assert abs(back - seconds) <= 0.5e-9 * (1 + 1e-6) + np.spacing(abs(seconds))


@pytest.mark.parametrize(
    ("seconds", "sec", "nanosec"),
    [(1.8, 1, 800_000_000), (-0.25, -1, 750_000_000), (0.9999999999, 1, 0), (0.001, 0, 1_000_000)],
)
def test_time_of_known_values(seconds: float, sec: int, nanosec: int) -> None:
    assert convert.time_to_message(seconds) == Time(sec=sec, nanosec=nanosec)


@pytest.mark.parametrize("seconds", [np.nan, np.inf, 2.0**31, -(2.0**31) - 1])
def test_time_outside_of_the_range_is_refused(seconds: float) -> None:
    with pytest.raises(ValueError):
        convert.time_to_message(seconds)


@pytest.mark.parametrize(("kind", "size"), [("point", 3), ("vector", 3), ("pose", 7), ("twist", 6), ("wrench", 6)])
@given(data=st.data())
def test_vector_like_messages_round_trip(kind: str, size: int, data: st.DataObject) -> None:
    values = np.array(data.draw(vectors(size)))
    to_message: Callable[..., Any] = getattr(convert, f"{kind}_to_message")
    from_message: Callable[..., Any] = getattr(convert, f"{kind}_from_message")
    message = to_message(values)
    message = deserialize_message(serialize_message(message), type(message))
    np.testing.assert_array_equal(from_message(message), values)


@pytest.mark.parametrize("kind", ["point", "vector", "pose", "twist", "wrench"])
def test_a_wrong_shape_is_refused(kind: str) -> None:
    with pytest.raises(ValueError, match="shape"):
        getattr(convert, f"{kind}_to_message")(np.zeros((2, 2)))


def test_fields_land_where_ros_expects_them() -> None:
    pose = convert.pose_to_message([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8])
    assert (pose.position.z, pose.orientation.z, pose.orientation.w) == (3.0, 0.6, 0.8)
    twist = convert.twist_to_message(np.arange(6.0))
    assert (twist.linear.y, twist.angular.x) == (1.0, 3.0)
    wrench = convert.wrench_to_message(np.arange(6.0))
    assert (wrench.force.z, wrench.torque.z) == (2.0, 5.0)


@given(st.integers(0, 9).flatmap(lambda n: st.tuples(vectors(n), vectors(n), vectors(n))))
def test_joint_state_round_trips(signals: tuple[list[float], list[float], list[float]]) -> None:
    names = [f"joint_{i}" for i in range(len(signals[0]))]
    message = convert.joint_state_to_message(names, *signals, time=1.25)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 250_000_000)
    back_names, *back = convert.joint_state_from_message(message)
    assert back_names == names
    for sent, received in zip(signals, back, strict=True):
        np.testing.assert_array_equal(received, sent)


def test_joint_state_may_leave_signals_out_but_not_joints() -> None:
    names, position, velocity, effort = convert.joint_state_from_message(
        convert.joint_state_to_message(["a", "b"], [1.0, 2.0])
    )
    assert (names, position.size, velocity.size, effort.size) == (["a", "b"], 2, 0, 0)
    with pytest.raises(ValueError, match="velocity"):
        convert.joint_state_to_message(["a", "b"], [1.0, 2.0], [1.0])


@pytest.mark.parametrize("name", impact_msgs_py.__all__)
def test_every_interface_is_exported_with_its_type_support(name: str) -> None:
    interface = getattr(impact_msgs_py, name)
    parts = [interface] if not hasattr(interface, "Request") else []
    if hasattr(interface, "Request"):
        parts = [interface.Request, interface.Response]
    elif hasattr(interface, "Goal"):
        parts = [interface.Goal, interface.Result, interface.Feedback]
    for part in parts:
        message = part()
        assert deserialize_message(serialize_message(message), part) == message


# ---- What a caller relies on who fills in no more than he must: constants, and defaults that mean the scenario's


def test_every_outcome_has_one_constant() -> None:
    values = {name: getattr(TrialOutcome, f"OUTCOME_{name.replace('-', '_')}") for name in OUTCOMES}
    assert not [name for kind in (FinishTrial.Response, RunTrial.Result) for name in dir(kind) if "OUTCOME" in name]
    assert values == {name: name for name in OUTCOMES}


def test_a_restitution_that_is_not_given_is_the_scenarios_and_not_zero() -> None:
    assert ImpactProblem().restitution < 0.0


def test_a_velocity_scale_that_is_not_given_is_that_of_the_prediction_and_not_zero() -> None:
    assert RunTrial.Goal().velocity_scale == 1.0


# ---- Our interfaces travel through the middleware


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
