# SPDX-License-Identifier: Apache-2.0
"""A follower that runs while damaged trials arrive: each is a hit or refused with its reason, and it goes on."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from damage import repeatable
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import BagDoor
from impact_rs_cli.following import FollowedHits, HitsArguments
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_cli.identify import Lessons
from impact_rs_sim.model import load_model
from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.types import typestore

NOMINAL = load_model("nominal")
JOINTS, MOTORS, POSE = topics.joint_states("arm"), topics.motor_states("arm"), topics.OBJECT_POSE
CHANGED = (JOINTS, MOTORS, POSE)
Messages = list[tuple[str, int, Any]]  # topic, time of the recording [ns], message; of other topics its bytes


class Damage(NamedTuple):
    """What happens to a recording, and where."""

    kind: str
    topic: str
    place: float
    field: str
    number: float


damages = st.builds(
    Damage,
    st.sampled_from(
        ("number", "names", "swapped names", "order", "same stamp", "backwards", "lost topic", "empty", "cut", "lost")
    ),
    st.sampled_from(CHANGED),
    st.floats(0.0, 0.999),
    st.sampled_from(("position", "velocity", "effort")),
    st.sampled_from((np.nan, np.inf, -1e300, 1e9, 0.0)),
)


def damaged(messages: Messages, damage: Damage) -> Messages:
    """The messages of a trial after that."""
    own = [place for place, (topic, _, _) in enumerate(messages) if topic == damage.topic]
    at = own[int(damage.place * len(own))]
    after = own[min(int(damage.place * len(own)) + 1, len(own) - 1)]
    message, joints = messages[at][2], damage.topic != POSE
    if damage.kind == "lost topic":
        return [one for one in messages if one[0] != damage.topic]
    if damage.kind == "cut":
        return messages[:at]
    if damage.kind == "lost":
        return [one for place, one in enumerate(messages) if not at <= place < at + 200 or one[0] != damage.topic]
    if damage.kind in ("same stamp", "backwards"):
        messages[after][2].header.stamp = messages[own[0] if damage.kind == "backwards" else at][2].header.stamp
    elif damage.kind == "order":
        for place, other in ((at, messages[after][2]), (after, message)):
            messages[place] = (damage.topic, messages[place][1], other)
    elif not joints:
        message.pose.position.y = damage.number
    elif damage.kind == "number":
        numbers = np.array(getattr(message, damage.field))
        numbers[:1] = damage.number
        setattr(message, damage.field, numbers)
    elif damage.kind == "empty":
        setattr(message, damage.field, np.array([]))
    elif damage.kind == "names":
        message.name = ["elsewhere", *message.name[1:]]
    else:
        message.name = [message.name[1], message.name[0], *message.name[2:]]
    return messages


class Live:
    """A follower of a folder, as the node has it, and a trial that is recorded again and again."""

    def __init__(self, folder: Path, original: Path) -> None:
        from rosbags.rosbag2 import Reader

        self.folder, self._numbers = folder, itertools.count()
        with Reader(original) as reader:
            self._kinds = {one.topic: one.msgtype for one in reader.connections}
            self._recorded = [(one.topic, time, bytes(data)) for one, time, data in reader.messages()]
            custom = dict(reader.storage.metadata.custom or {})
        self._custom = {key: value for key, value in custom.items() if key != checksums.NAME}
        self.follower = Follower(BagDoor(folder, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass"], learnt=4)
        diagnosis = FullDiagnosis({}, folder)
        self.lessons = Lessons(FollowedHits(HitsArguments(folder), self.follower, None, None), diagnosis)

    def add(self, change: Callable[[Messages], Messages]) -> str:
        """Record the trial once more, changed; gives its name."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        name, store = f"again_{next(self._numbers)}", typestore()
        aside = self.folder / f".{name}"
        read = [
            (topic, time, store.deserialize_cdr(data, self._kinds[topic]) if topic in CHANGED else data)
            for topic, time, data in self._recorded
        ]
        writer = Writer(aside, version=9, storage_plugin=StoragePlugin.MCAP)
        for key, value in self._custom.items():
            writer.set_custom_data(key, value)
        with writer:
            left = change(read)
            connections = {
                topic: writer.add_connection(topic, self._kinds[topic], typestore=store)
                for topic in dict.fromkeys(topic for topic, _, _ in left)
            }
            for topic, time, message in left:
                data = store.serialize_cdr(message, self._kinds[topic]) if topic in CHANGED else message
                writer.write(connections[topic], time, data)
        aside.rename(self.folder / name)
        return name

    def taken(self) -> tuple[list[str], dict[str, str]]:
        """Names of new hits, and reasons of what was refused, until nothing waits any more."""
        hits: list[str] = []
        refused: dict[str, str] = {}
        while found := self.lessons.arrived():
            for lesson in found:
                if lesson.refused:
                    document = json.loads(lesson.refused)
                    refused[document["hit"]] = document["reason"]
                elif lesson.hit:
                    hits.append(lesson.line.split(":")[0])
        return hits, refused


@pytest.fixture(scope="module")
def live(hidden_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Live:
    folder = tmp_path_factory.mktemp("live") / "runs"
    shutil.copytree(hidden_campaign, folder)
    found = Live(folder, sorted((folder / "push").glob("juice*"))[0])
    hits, refused = found.taken()
    assert len(hits) == 6 and not refused
    return found


@repeatable(24)
@given(damages)
def test_a_damaged_trial_is_a_hit_or_refused_with_its_reason(live: Live, damage: Damage) -> None:
    name = live.add(lambda messages: damaged(messages, damage))
    hits, refused = live.taken()
    assert [*hits, *refused] == [name]
    assert all(reason and "\n" not in reason for reason in refused.values())
    if text := live.lessons.prediction():  # none like a hit that ends early, which was seen once
        json.dumps(json.loads(text), allow_nan=False)
    assert all(np.isfinite(one.estimate) for one in live.follower.followed())


REFUSED = [
    (Damage("names", JOINTS, 0.5, "position", 0.0), "joint_states: other joints, or another order, at t = 0.9"),
    (Damage("swapped names", MOTORS, 0.5, "position", 0.0), "motor_states: other joints, or another order, at t"),
    (Damage("same stamp", JOINTS, 0.5, "position", 0.0), "joint_states: time stamps run backwards at t = 0.9"),
    (Damage("same stamp", MOTORS, 0.5, "position", 0.0), "have different stamps at t = 0.9"),
    (Damage("backwards", POSE, 0.5, "position", 0.0), "object/pose: time stamps run backwards at t"),
    (Damage("number", JOINTS, 0.5, "velocity", np.nan), "velocity is not finite at t = 0.9"),
    (Damage("lost topic", MOTORS, 0.5, "position", 0.0), "no /arm/motor_states"),
    (Damage("cut", JOINTS, 0.3, "position", 0.0), "hits nothing"),
]


@pytest.mark.parametrize(("damage", "reason"), REFUSED, ids=[f"{one.kind} of {one.topic}" for one, _ in REFUSED])
def test_what_would_be_misread_is_refused_with_place_and_time(live: Live, damage: Damage, reason: str) -> None:
    name = live.add(lambda messages: damaged(messages, damage))
    hits, refused = live.taken()
    assert not hits and reason in refused[name]


def test_joints_in_another_order_than_the_robots_are_refused(live: Live) -> None:
    """The same in all messages, as another program may name them."""

    def turned(messages: Messages) -> Messages:
        for topic, _, message in messages:
            if topic in (JOINTS, MOTORS):
                message.name = message.name[::-1]
        return messages

    name = live.add(turned)
    hits, refused = live.taken()
    assert not hits and "joints in the order arm_" in refused[name]


def test_after_damaged_trials_a_sound_one_is_a_hit(live: Live) -> None:
    name = live.add(lambda messages: messages)
    assert live.taken() == ([name], {})


def test_repeats_of_one_condition_with_and_without_the_object_are_hits_alike(live: Live) -> None:
    """Sensitivities of the one are not those of the other: they have other features."""
    for lost in (True, True, True, False):
        name = live.add(lambda messages, lost=lost: [one for one in messages if not lost or one[0] != POSE])  # type: ignore[misc]
        assert live.taken() == ([name], {})
