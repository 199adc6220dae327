# SPDX-License-Identifier: Apache-2.0
"""A trial through the nodes, five processes and DDS between them, equals the trial in one process."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages
from node_trials import whole_trial
from rosbags.highlevel import AnyReader

from impact_rs_ros.graph import Graph
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.campaign import Manifest, make_manifest, run_one

TOLERANCE = 1e-9
SKIPPED = {topics.DIAGNOSTICS}
OBJECTS = {
    "hit_ball": "solid",
    "push_two_boxes": "box",
    "push_bottle": "bottle",
    "hit_wall": "wall",
    "push_door": "door",
    "grab_cylinder": "can",
}


@pytest.fixture(
    scope="module",
    params=["push", *(pytest.param(name, marks=pytest.mark.slow) for name in ("grab", *OBJECTS))],
)
def manifest(request: pytest.FixtureRequest, short: str) -> Manifest:
    """One arm, then two: the nodes meet new topics between them. The push has every phase and is short."""
    scenario = short if request.param == "push" else request.param
    object_name = OBJECTS.get(scenario, "cat_food")
    return make_manifest(scenario, [object_name], ["2"], [1.1], trials=1, seed=3)


@pytest.fixture(scope="module")
def inprocess(manifest: Manifest, tmp_path_factory: pytest.TempPathFactory) -> TrialBag:
    folder = tmp_path_factory.mktemp("inprocess")
    run_one(folder, manifest.trial(manifest.keys[0]))
    return TrialBag.open(folder / manifest.keys[0].name)


@pytest.fixture(scope="module")
def through_nodes(graph: Graph, manifest: Manifest, tmp_path_factory: pytest.TempPathFactory) -> list[TrialBag]:
    """The same trial twice, so that the second one follows another trial in the same nodes."""
    return [whole_trial(graph, tmp_path_factory.mktemp(name), manifest) for name in ("first", "second")]


@pytest.mark.parametrize("which", [0, 1])
def test_every_topic_has_the_same_number_of_messages(
    inprocess: TrialBag, through_nodes: list[TrialBag], which: int
) -> None:
    nodes = through_nodes[which]
    counts = {topic: nodes.counts[topic] for topic in inprocess.counts if topic not in SKIPPED}
    assert counts == {topic: count for topic, count in inprocess.counts.items() if topic not in SKIPPED}
    assert nodes.outcome == inprocess.outcome == "OK"


@pytest.mark.parametrize("which", [0, 1])
def test_every_column_is_the_same(inprocess: TrialBag, through_nodes: list[TrialBag], which: int) -> None:
    nodes = through_nodes[which]
    arms = inprocess.info.robots
    pairs = [
        (inprocess.joints(topic(arm)), nodes.joints(topic(arm)))
        for arm in arms
        for topic in (topics.joint_states, topics.motor_states, topics.joint_command, topics.truth_joint_states)
    ]
    bodies = ("object", *inprocess.info.neighbours)
    poses = [topic(body) for body in bodies for topic in (topics.pose, topics.truth_pose)]
    pairs += [(inprocess.poses(topic), nodes.poses(topic)) for topic in poses]
    pairs += [(inprocess.controller(arm), nodes.controller(arm)) for arm in arms]
    for one, other in pairs:
        for field in fields(one):
            if field.name != "qp_solve_time":
                np.testing.assert_allclose(
                    getattr(other, field.name), getattr(one, field.name), rtol=0.0, atol=TOLERANCE, err_msg=field.name
                )
    assert [nodes.impact_time(arm) for arm in arms] == [inprocess.impact_time(arm) for arm in arms]


@pytest.mark.parametrize("which", [0, 1])
def test_every_transform_is_the_same(inprocess: TrialBag, through_nodes: list[TrialBag], which: int) -> None:
    expected, found = transforms(inprocess), transforms(through_nodes[which])
    assert [(time, frame) for time, frame, _ in found] == [(time, frame) for time, frame, _ in expected]
    np.testing.assert_allclose([v for _, _, v in found], [v for _, _, v in expected], rtol=0.0, atol=TOLERANCE)


def transforms(bag: TrialBag) -> list[tuple[int, str, list[float]]]:
    """Time [ns], frame, and translation with rotation, of everything on ``/tf``."""
    found = []
    with AnyReader([bag.path], default_typestore=typestore()) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topics.TF]
        for connection, time, data in reader.messages(wanted):
            for item in reader.deserialize(data, connection.msgtype).transforms:
                at, turn = item.transform.translation, item.transform.rotation
                found.append((time, item.child_frame_id, [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]))
    return found


def test_the_trial_says_how_it_was_run(inprocess: TrialBag, through_nodes: list[TrialBag]) -> None:
    one, other = inprocess.info, through_nodes[0].info
    assert (one.via, other.via) == ("inprocess", "nodes")
    # Every process asks for the revision once, and the sources may be edited while tests run.
    assert replace(other, via=one.via, git_revision=one.git_revision) == one
    assert bool(other.git_revision) == bool(one.git_revision)


def test_someone_elses_reader_finds_the_same_messages(through_nodes: list[TrialBag]) -> None:
    bag = through_nodes[0]
    command = topics.joint_command(bag.info.robots[0])
    counts: dict[str, int] = {}
    efforts = []
    for file in bag.path.glob("*.mcap"):
        for message in read_ros2_messages(file):
            topic = message.channel.topic
            counts[topic] = counts.get(topic, 0) + 1
            if topic == command:
                efforts.append(list(message.ros_msg.effort))
    assert counts == {topic: count for topic, count in bag.counts.items() if count}
    np.testing.assert_array_equal(np.array(efforts), bag.joints(command).effort)
