# SPDX-License-Identifier: Apache-2.0
"""The shipped layouts of RViz, Foxglove and PlotJuggler name nothing that a bag of `push` does not have.

None of the three can be installed here; what they do with a layout is not tested.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from impact_rs_sim.paths import config_directory
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore

VIEWERS = config_directory() / "viewers"


class FirstMessages:
    """The first message of every topic of a bag, and the names that /tf has."""

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, object] = {}
        self.kinds: dict[str, str] = {}
        self.frames = {"world"}
        with AnyReader([path], default_typestore=typestore()) as reader:
            for connection, _, data in reader.messages():
                if connection.topic not in self.messages:
                    self.messages[connection.topic] = reader.deserialize(data, connection.msgtype)
                    self.kinds[connection.topic] = connection.msgtype
        for topic in (topics.TF, topics.TF_STATIC):
            self.frames |= {transform.child_frame_id for transform in self.messages[topic].transforms}

    def number(self, topic: str, path: list[str | int]) -> float:
        """What stands in a message at attributes and indices."""
        found = self.messages[topic]
        for step in path:
            found = found[step] if isinstance(step, int) else getattr(found, step)
        return float(found)


@pytest.fixture(scope="module")
def bag(push_campaign: Path) -> FirstMessages:
    path = next(path for path in sorted(push_campaign.iterdir()) if path.is_dir())
    assert TrialBag.open(path).outcome == "OK"
    return FirstMessages(path)


def steps(text: str) -> list[str | int]:
    """``twist[1]`` and ``pose/position/x`` as attributes and indices."""
    return [int(step) if step.isdigit() else step for step in re.findall(r"[A-Za-z_0-9]+", text)]


def entries(tree: object, key: str) -> Iterator[object]:
    """Every value of a key anywhere in a document."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            if name == key:
                yield value
            yield from entries(value, key)
    elif isinstance(tree, list):
        for value in tree:
            yield from entries(value, key)


def test_foxglove_names_topics_fields_and_frames_of_the_bag(bag: FirstMessages) -> None:
    layout = json.loads((VIEWERS / "impact_rs_foxglove.json").read_text())
    panels = layout["configById"]
    plots = [path["value"] for name, panel in panels.items() for path in panel.get("paths", [])]
    assert len(plots) > 8
    for path in plots:
        topic, _, field = path.partition(".")
        assert np.isfinite(bag.number(topic, steps(field))), path
    described = [layer["topic"] for layer in panels["3D!scene"]["layers"].values() if "topic" in layer]
    assert described == [topics.ROBOT_DESCRIPTION, topics.OBJECT_DESCRIPTION]
    assert {bag.kinds[topic] for topic in described} == {topics.STRING}
    assert set(panels["3D!scene"]["topics"]) <= set(bag.messages)
    assert panels["3D!scene"]["followTf"] in bag.frames
    shown = re.findall(r'"((?:3D|Plot|StateTransitions)!\w+)"', json.dumps(layout["layout"]))
    assert sorted(shown) == sorted(panels)


def test_plotjuggler_names_series_of_the_bag(bag: FirstMessages) -> None:
    """Joint states are series by joint there: ``TOPIC/JOINT/position``."""
    root = Xml.parse(VIEWERS / "impact_rs_plotjuggler.xml").getroot()
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert len(curves) > 30
    for curve in curves:
        topic = max((topic for topic in bag.messages if curve.startswith(f"{topic}/")), key=len, default=None)
        assert topic is not None, curve
        path = steps(curve.removeprefix(topic))
        if bag.kinds[topic] == topics.JOINT_STATE:
            joint, field = path
            path = [field, bag.messages[topic].name.index(joint)]
        assert np.isfinite(bag.number(topic, path)), curve


def test_rviz_names_topics_and_frames_of_the_bag(bag: FirstMessages) -> None:
    document = yaml.safe_load((VIEWERS / "impact_rs.rviz").read_text())
    manager = document["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] in bag.frames
    named = [*entries(manager, "Topic"), *entries(manager, "Description Topic")]
    assert {entry["Value"] for entry in named if isinstance(entry, dict)} <= set(bag.messages)
    models = [one for one in manager["Displays"] if one["Class"] == "rviz_default_plugins/RobotModel"]
    for model in models:
        latched = model["Description Topic"]
        assert bag.kinds[latched["Value"]] == topics.STRING
        assert latched["Durability Policy"] == "Transient Local"  # what is said once is not heard otherwise
    assert len(models) == 2
