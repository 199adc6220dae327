# SPDX-License-Identifier: Apache-2.0
"""Who watches a graph knows the newest of what it tells, and what is going on."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fake_graph import FakeGraph, fake_graph
from impact_rs.msg import CellChange, ChangeCause, ControllerState, HitPrediction, PredictedValue, RefusedHit
from processes import until as until_true
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from impact_rs_ros.spectator import FOLLOWED, Spectator
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics
from impact_rs_trials.snapshot import Snapshot

POSE = np.array([0.4, -0.1, 0.5, 0.0, 0.0, 0.6, 0.8])
URDF = "<robot name='r'><link name='a'/></robot>"


@pytest.fixture(scope="module")
def domain(domain_ids: Callable[[], int]) -> int:
    return domain_ids()


@pytest.fixture
def graph(domain: int) -> Iterator[FakeGraph]:
    with fake_graph(domain, "/cell_a") as made:
        yield made


@pytest.fixture
def spectator(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Spectator]:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with Spectator.watching("cell_a") as made:
        yield made


def until(
    spectator: Spectator, shown: Callable[[Snapshot], object], tell: Callable[[], None] = lambda: None
) -> Snapshot:
    """What is seen as soon as something is; told again and again, for nobody waits for a spectator."""

    def step() -> None:
        tell()
        time.sleep(0.01)

    return until_true(lambda: found if shown(found := spectator.look()) else None, step)


def test_the_newest_state_is_by_joint_name_and_forces_act_on_the_object(graph: FakeGraph, spectator: Spectator) -> None:
    assert spectator.look().situation == "absent"
    spec = graph.trial("push")
    found = until(spectator, lambda seen: seen.physics)
    assert found.title == "push, cat_food, case_2, scale 1, repeat 0"
    assert found.physics is not None
    np.testing.assert_array_equal(found.physics.object.size, spec.scene.physics.object.size)
    assert until(spectator, lambda seen: seen.situation == "idle").positions == {}
    position, count = np.arange(7) / 10.0, 0

    def tell() -> None:
        nonlocal count
        for _ in range(100):  # of a stream that is faster than anybody looks
            count += 1
            graph.joints("arm", position, 1e-3 * count)
        graph.object(POSE)
        graph.force_on_pad("arm", (1.0, -20.0, 3.0))

    def everything(seen: Snapshot) -> bool:
        return bool(seen.forces and seen.positions and seen.object is not None and seen.situation == "running")

    found = until(spectator, everything, tell)
    assert found.positions == {f"arm_joint{number + 1}": number / 10.0 for number in range(7)}
    newest = until(spectator, lambda seen: seen.time == pytest.approx(1e-3 * count), tell)
    assert newest.number == found.number
    np.testing.assert_array_equal(newest.object, POSE)
    np.testing.assert_array_equal(newest.forces["arm"], [-1.0, 20.0, -3.0])
    last = until(spectator, lambda seen: seen.situation == "over")
    assert last.positions == newest.positions


def test_neighbours_of_the_object_are_seen_by_name(graph: FakeGraph, spectator: Spectator) -> None:
    graph.trial("push_two_boxes", "box")
    until(spectator, lambda seen: seen.physics)
    found = until(spectator, lambda seen: seen.neighbours, lambda: graph.object(POSE, "behind"))
    np.testing.assert_array_equal(found.neighbours["behind"], POSE)
    assert found.object is None


def test_another_scenario_is_another_scene_and_a_repeat_keeps_its_state(graph: FakeGraph, spectator: Spectator) -> None:
    graph.trial("push")
    first = until(spectator, lambda seen: seen.physics)
    until(spectator, lambda seen: seen.positions, lambda: graph.joints("arm", np.zeros(7), 0.1))
    graph.trial("grab")
    other = until(spectator, lambda seen: seen.number != first.number)
    assert list(other.physics.arms) == ["left", "right"]
    assert other.positions == {}

    def tell() -> None:
        for arm in ("left", "right"):
            graph.joints(arm, np.ones(7), 0.2)

    until(spectator, lambda seen: len(seen.positions) == 14, tell)
    graph.trial("grab", repeat=1)
    repeated = until(spectator, lambda seen: seen.title.endswith("repeat 1"))
    assert (repeated.number, len(repeated.positions)) == (other.number, 14)


def test_a_robot_without_a_trial_is_known_by_its_own_description(graph: FakeGraph, spectator: Spectator) -> None:
    graph.say(topics.ROBOT_DESCRIPTION, topics.STRING, String(data=URDF), latched=True)
    assert until(spectator, lambda seen: seen.description).description == URDF


def test_where_the_nodes_have_ended_the_last_state_stays(domain: int, spectator: Spectator) -> None:
    with fake_graph(domain, "/cell_a") as graph:
        graph.trial("push")
        until(spectator, lambda seen: seen.physics)
        until(spectator, lambda seen: seen.positions, lambda: graph.joints("arm", np.zeros(7), 0.1))
    assert len(until(spectator, lambda seen: seen.situation == "gone").positions) == 7


def test_positions_without_a_number_and_unseen_objects_are_left_out(graph: FakeGraph, spectator: Spectator) -> None:
    graph.trial("push")
    until(spectator, lambda seen: seen.physics)
    until(spectator, lambda seen: seen.object is not None, lambda: graph.object(POSE))
    found = until(spectator, lambda seen: seen.object is None, lambda: graph.object(np.full(7, np.nan)))
    assert found.positions == {}
    until(spectator, lambda seen: seen.object is not None, lambda: graph.object(POSE))
    graph.joints("arm", np.full(7, np.nan), 0.1)
    until(spectator, lambda seen: seen.object is None, lambda: graph.object(np.zeros(7)))
    assert spectator.look().positions == {}


@pytest.mark.parametrize("time", [math.nan, math.inf])
def test_a_trial_time_without_a_number_is_left_out(spectator: Spectator, time: float) -> None:
    """Kills: the time of a controller of others is taken as it comes; the live page cannot write NaN, and ended."""
    topic = topics.controller_state("arm")
    for trial_time in (0.25, time):
        spectator._take_state(topic, serialize_message(ControllerState(trial_time=trial_time)))
    assert spectator.look().time == 0.25


def test_what_identify_publishes_is_kept_through_trials_with_every_change_once(
    graph: FakeGraph, spectator: Spectator
) -> None:
    def publish(name: str, message: Any) -> None:
        graph.say(f"/identify/{name}", FOLLOWED[f"/identify/{name}"], message, latched=True)

    known: list[str] = []
    for text in ("first", "second", "second", "third"):  # one twice, by a node that was started again
        publish("change", CellChange(hit=text, since_time=math.nan, causes=[ChangeCause(effect="pad_friction")]))
        known = list(dict.fromkeys((*known, text)))
        until(spectator, lambda seen, known=known: len(seen.followed.changes) == len(known))
    for like in ("older", "newest"):
        publish("prediction", HitPrediction(like=like, values=[PredictedValue(ci95=[-1.0, 2.0])]))
    publish("refused", RefusedHit(hit="a bag"))
    found = until(spectator, lambda seen: seen.followed.refused and "newest" in seen.followed.prediction).followed
    changes = [json.loads(text) for text in found.changes]
    assert [change["hit"] for change in changes] == known
    assert (changes[0]["since_time"], changes[0]["causes"][0]["effect"]) == (None, "pad_friction")
    assert json.loads(found.prediction)["values"][0]["ci95"] == [-1.0, 2.0]
    assert (json.loads(found.refused), found.diagnosis) == ({"hit": "a bag", "reason": ""}, "")
    graph.trial("push")
    assert until(spectator, lambda seen: seen.physics).followed == found


def test_a_namespace_that_ros_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="namespace = '7'"), Spectator.watching("7"):
        pass
