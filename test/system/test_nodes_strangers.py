# SPDX-License-Identifier: Apache-2.0
"""Other programs read, publish and call while a trial runs: it goes on, or is aborted and names who disturbs it."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from impact_rs.srv import FinishTrial
from node_trials import beside, goal, in_trial, result_of, spin_until
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.graph import Graph
from impact_rs_ros.message_types import available, message_type
from impact_rs_ros.qos import STREAM
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

STATES, COMMAND = topics.joint_states("arm"), topics.joint_command("arm")
OF_CONTROLLER = {COMMAND, topics.controller_state("arm"), topics.impact_event("arm")}
SAMPLES = 801  # of the trial ``short``


def test_a_reader_of_any_quality_of_service_delays_no_trial(graph: Graph, tmp_path: Path, short: str) -> None:
    with beside(graph, "_ros2cli_1") as stranger:
        for durability in (QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE):
            wanted = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=durability)
            for topic, kind in topics.recorded(["arm"]).items():
                if topic != topics.TRIAL_INFO and available(kind):
                    stranger.create_subscription(message_type(kind), topic, lambda _: None, wanted)
        result = graph.call_trial(goal(tmp_path, scenario=short))
    assert (result.success, result.outcome, result.message) == (True, "OK", "")


def test_a_trial_is_not_finished_by_another_program(graph: Graph, tmp_path: Path, short: str) -> None:
    """By a request that comes too early, nor by one of another trial."""
    client = graph.node.create_client(FinishTrial, "recorder/finish_trial")
    spin_until(graph, client.service_is_ready, "no recorder")
    asked: list[Any] = []

    def ask() -> None:
        asked.append(client.call_async(FinishTrial.Request()))
        asked.append(client.call_async(FinishTrial.Request(topics=["/left/joint_states"], counts=[1801])))

    result = graph.call_trial(goal(tmp_path, scenario=short), in_trial(ask))
    answers = [result_of(graph, future) for future in asked]
    graph.node.destroy_client(client)
    for answer, reason in zip(answers, ("is not over: /arm/joint_states ends", "/left/joint_states"), strict=True):
        assert not answer.success
        assert reason in answer.message
    assert (result.outcome, result.message) == ("OK", "")
    assert TrialBag.open(Path(result.bag_path)).counts[STATES] == SAMPLES


@pytest.mark.parametrize(
    ("name", "namespace", "after"),
    [("stranger", "/cell", None), ("stranger", "", 0.2), ("_ros2cli_2", "", 0.2)],
    ids=["before the trial", "in the trial", "of ros2 topic pub"],
)
def test_a_second_publisher_of_torques_is_named_and_ends_the_trial(
    graph: Graph, tmp_path: Path, short: str, name: str, namespace: str, after: float | None
) -> None:
    with beside(graph, name, namespace) as stranger:

        def publish() -> None:
            stranger.create_publisher(JointState, COMMAND, 10)

        if after is None:
            publish()
        result = graph.call_trial(goal(tmp_path, scenario=short), None if after is None else in_trial(publish, after))
    assert (result.success, result.outcome) == (False, "ABORTED")
    named = sorted((f"{namespace}/{name}", "/controller"))
    assert f"/arm/joint_command is published by {' and '.join(named)}: stop all but one" in result.message
    if after is not None:
        assert TrialBag.open(Path(result.bag_path)).counts[STATES] < SAMPLES
    spin_until(graph, lambda: len(graph.presence.publishers(COMMAND)) == 1, "it does not leave")


def test_bytes_that_are_no_messages_end_neither_a_node_nor_the_trial(graph: Graph, tmp_path: Path, short: str) -> None:
    rng = random.Random(0)
    cut = bytes(serialize_message(JointState(name=["x"] * 7, position=[0.0] * 7)))[:60]
    endless = b"\0\1\0\0" + b"\xff" * 200
    pids = {name: process.pid for name, process in graph.processes.items()}
    kinds = {topic: kind for topic, kind in topics.recorded(["arm"]).items() if topic not in topics.latched(["arm"])}
    with beside(graph, "plant") as plant, beside(graph, "controller") as controller:  # nodes that may publish there
        publishers = [
            (controller if topic in OF_CONTROLLER else plant).create_publisher(message_type(kind), topic, STREAM)
            for topic, kind in kinds.items()
            if available(kind)
        ]

        def throw(message: Any) -> None:
            for publisher in publishers if message.feedback.time > 0.0 else ():
                short = publisher.topic_name == topics.CLOCK  # the middleware sends no more than its type can have
                publisher.publish(b"\0\1\0\0abc" if short else rng.choice([rng.randbytes(7), cut, endless]))

        result = graph.call_trial(goal(tmp_path, scenario=short), throw)
    assert {name: process.pid for name, process in graph.processes.items()} == pids
    assert not graph.lost()
    assert result.outcome == "OK", result.message
    assert "messages are not in the bag" in result.message
    bag = TrialBag.open(Path(result.bag_path))
    assert (bag.outcome, bag.reason) == ("OK", result.message)
    assert bag.counts[STATES] == len(bag.joints(STATES).time) == SAMPLES
