# SPDX-License-Identifier: Apache-2.0
"""Programs that are none of ours read, publish and call while a trial runs: it goes on, or is aborted and says who."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import rclpy
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.srv import FinishTrial
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from impact_rs_ros.graph import Graph
from impact_rs_ros.message_types import available, message_type
from impact_rs_ros.qos import LATCHED, STREAM
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

PATIENCE = 60.0  # s, of the tests; never reached on a machine that works
STATES, COMMAND = topics.joint_states("arm"), topics.joint_command("arm")


def goal(folder: Path) -> RunTrial.Goal:
    values = {"scenario": "push", "object_name": "parcel", "case_name": "1", "velocity_scale": 1.0, "seed": 5}
    return RunTrial.Goal(**values, output_directory=str(folder))


def spin_until(graph: Graph, condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        graph.spin(0.05)


@contextmanager
def node(graph: Graph, name: str) -> Iterator[Node]:
    """A node beside the graph, which nothing runs."""
    other = rclpy.create_node(name, context=graph.node.context, start_parameter_services=False)
    try:
        yield other
    finally:
        other.destroy_node()


@pytest.mark.parametrize("durability", list(QoSDurabilityPolicy)[1:3])
def test_a_reader_of_whatever_quality_of_service_delays_no_trial(
    graph: Graph, tmp_path: Path, durability: QoSDurabilityPolicy
) -> None:
    wanted = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=durability)
    with node(graph, "_ros2cli_1") as stranger:
        for topic, kind in topics.recorded(["arm"]).items():
            if topic != topics.TRIAL_INFO and available(kind):
                stranger.create_subscription(message_type(kind), topic, lambda _: None, wanted)
        result = graph.call_trial(goal(tmp_path))
    assert (result.success, result.outcome, result.message) == (True, "OK", "")


def test_a_trial_is_not_finished_before_its_end(graph: Graph, tmp_path: Path) -> None:
    client = graph.node.create_client(FinishTrial, "recorder/finish_trial")
    spin_until(graph, client.service_is_ready, "no recorder")
    asked = []

    def finish(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.2 * (1 + len(asked)):
            asked.append(client.call_async(FinishTrial.Request()))

    result = graph.call_trial(goal(tmp_path), finish)
    spin_until(graph, lambda: all(future.done() for future in asked), "no answer")
    graph.node.destroy_client(client)
    assert asked
    for answer in (future.result() for future in asked):
        assert not answer.success
        assert answer.message.startswith(
            "recorder: push/parcel__case_1__s1.000__r0 is not over: /arm/joint_states ends"
        )
    assert (result.outcome, result.message) == ("OK", "")
    assert TrialBag.open(Path(result.bag_path)).counts[STATES] == 1801


def test_counts_of_another_trial_finish_nothing(graph: Graph, tmp_path: Path) -> None:
    client = graph.node.create_client(FinishTrial, "recorder/finish_trial")
    spin_until(graph, client.service_is_ready, "no recorder")
    asked = []

    def finish(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.2 and not asked:
            request = FinishTrial.Request(topics=["/left/joint_states"], counts=[1801])
            asked.append(client.call_async(request))

    result = graph.call_trial(goal(tmp_path), finish)
    spin_until(graph, asked[0].done, "no answer")
    graph.node.destroy_client(client)
    assert asked[0].result().message == (
        "recorder: /left/joint_states is no topic of push/parcel__case_1__s1.000__r0, which is recorded"
    )
    assert result.outcome == "OK"


@pytest.mark.parametrize("name", ["stranger", "_ros2cli_2"])
def test_a_second_publisher_that_comes_in_mid_trial_is_named_and_ends_it(
    graph: Graph, tmp_path: Path, name: str
) -> None:
    with node(graph, name) as stranger:
        publishers: list[Publisher] = []

        def publish(message: RunTrial.Impl.FeedbackMessage) -> None:
            if message.feedback.time > 0.2 and not publishers:
                publishers.append(stranger.create_publisher(JointState, COMMAND, 10))

        result = graph.call_trial(goal(tmp_path), publish)
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert f"/arm/joint_command is published by /{name} and /controller: stop all but one" in result.message or (
        f"/arm/joint_command is published by /controller and /{name}: stop all but one" in result.message
    )
    assert TrialBag.open(Path(result.bag_path)).counts[STATES] < 1801
    spin_until(graph, lambda: len(graph.presence.publishers(COMMAND)) == 1, "it does not leave")


def test_bytes_that_are_no_messages_end_neither_a_node_nor_the_trial(graph: Graph, tmp_path: Path) -> None:
    rng = random.Random(0)
    pids = {name: process.pid for name, process in graph.processes.items()}
    cut = bytes(serialize_message(JointState(name=["x"] * 7, position=[0.0] * 7)))[:60]
    endless = b"\0\1\0\0" + b"\xff" * 200
    kinds = {topic: kind for topic, kind in topics.recorded(["arm"]).items() if topic not in topics.latched(["arm"])}
    with node(graph, "plant") as plant, node(graph, "controller") as controller:  # nodes that may publish there
        publishers = []
        for topic, kind in kinds.items():
            owner = controller if topic in (COMMAND, *map_of_controller()) else plant
            if available(kind):
                publishers.append(owner.create_publisher(message_type(kind), topic, STREAM))

        def throw(message: RunTrial.Impl.FeedbackMessage) -> None:
            if message.feedback.time > 0.0:
                for publisher in publishers:
                    short = publisher.topic_name == topics.CLOCK  # the middleware sends no more than its type can have
                    publisher.publish(b"\0\1\0\0abc" if short else rng.choice([rng.randbytes(7), cut, endless]))

        result = graph.call_trial(goal(tmp_path), throw)
    assert {name: process.pid for name, process in graph.processes.items()} == pids
    assert not graph.nodes.dead()
    assert result.outcome == "OK", result.message
    assert "messages are not in the bag" in result.message
    bag = TrialBag.open(Path(result.bag_path))
    assert (bag.outcome, bag.reason) == ("OK", result.message)
    assert bag.counts[STATES] == 1801
    assert len(bag.joints(STATES).time) == 1801


def map_of_controller() -> tuple[str, str]:
    return topics.controller_state("arm"), topics.impact_event("arm")


def test_viewers_have_a_robot_before_the_first_trial(graph: Graph) -> None:
    graph.nodes.kill("experiment")
    graph.revive()
    graph.wait_until_ready()
    told: list[String] = []
    subscription = graph.node.create_subscription(String, "/robot_description", told.append, LATCHED)
    spin_until(graph, lambda: bool(told), "no description")
    graph.node.destroy_subscription(subscription)
    assert "<robot" in told[0].data


def test_a_cancelled_campaign_counts_its_trial_neither_as_finished_nor_as_failed(graph: Graph, tmp_path: Path) -> None:
    request = RunCampaign.Goal(
        scenario="push",
        objects=["parcel"],
        cases=["1"],
        velocity_scales=[1.0],
        trials=2,
        output_directory=str(tmp_path),
    )
    bag = tmp_path / ".partial" / "parcel__case_1__s1.000__r0"
    sent = graph.run_campaign.send_goal_async(request)
    spin_until(graph, sent.done, "no answer to the goal")
    spin_until(graph, bag.exists, "no trial begins")
    sent.result().cancel_goal_async()
    ended = sent.result().get_result_async()
    spin_until(graph, ended.done, "no result")
    result = ended.result().result
    assert (result.success, result.message) == (False, "cancelled")
    assert (result.finished, result.failed) == (0, 0)
