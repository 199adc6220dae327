# SPDX-License-Identifier: Apache-2.0
"""A follower of a folder, and a trial that is recorded there again and again, changed each time."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st

from impact_rs_analysis.application.followed_hits import FollowedHits, hits_options
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import BagHitSource
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_cli.identify import HitReports
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


DAMAGES = st.builds(
    Damage,
    st.sampled_from(
        ("number", "names", "swapped names", "order", "same stamp", "backwards", "lost topic", "empty", "cut", "lost")
    ),
    st.sampled_from(CHANGED),
    st.floats(0.0, 0.999),
    st.sampled_from(("position", "velocity", "effort")),
    st.sampled_from((np.nan, np.inf, -1e300, 1e9, 0.0)),
)


def damaged_messages(messages: Messages, damage: Damage) -> Messages:
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

    @classmethod
    def of_campaign(cls, campaign: Path, folder: Path) -> Live:
        """It has followed all six trials of a campaign, one of which is recorded again."""
        shutil.copytree(campaign, folder)
        found = cls(folder, sorted((folder / "push").glob("juice*"))[0])
        hits, refused = found.taken()
        assert len(hits) == 6 and not refused
        return found

    def __init__(self, folder: Path, original: Path) -> None:
        from rosbags.rosbag2 import Reader

        self.folder, self._numbers = folder, itertools.count()
        with Reader(original) as reader:
            self._kinds = {one.topic: one.msgtype for one in reader.connections}
            self._recorded = [(one.topic, time, bytes(data)) for one, time, data in reader.messages()]
            custom = dict(reader.storage.metadata.custom or {})
        self._custom = {key: value for key, value in custom.items() if key != checksums.NAME}
        self.follower = Follower(BagHitSource(folder, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass"], learnt=4)
        diagnosis = FullDiagnosis({}, folder)
        self.reports = HitReports(FollowedHits(hits_options(folder), self.follower, None, None), diagnosis)

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
        while found := self.reports.arrived():
            for report in found:
                if report.topic == "refused":
                    refused[report.document["hit"]] = report.document["reason"]
                elif report.hit:
                    hits.append(report.line.split(":")[0])
        return hits, refused
