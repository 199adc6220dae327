# SPDX-License-Identifier: Apache-2.0
"""Recordings that were not made here: what is in them, how a signal looks, and the files that say what they are.

A preview goes the way of an analysis, by a mapping and :func:`read_series`, so that what is seen is what will be used.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import Field
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole_folder
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import Scenario, load_scenario
from impact_rs_sim.schema import Name, Schema, validate
from impact_rs_trials.recordings.array_file import ArrayFile
from impact_rs_trials.recordings.bag_file import register
from impact_rs_trials.recordings.experiment import Experiment, read_runs
from impact_rs_trials.recordings.mapping import QUANTITY, REQUIRED, UNITS, Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.series import Names
from impact_rs_trials.recordings.sources import ARRAY_SUFFIXES, BAG_SUFFIXES, TABLE_SUFFIXES, is_bag_folder, read_series
from impact_rs_trials.recordings.table_file import TableFile
from impact_rs_workbench.workspace import RUN_TABLE, Workspace

MAPPING, EXPERIMENT = "mapping.yaml", "experiment.yaml"
ROBOT = "franka_fer"  # only to look at a signal; what is written names that of the scenario
MOST_POINTS = 300  # of a preview
MOST_WIDE = 40  # numbers in a sample of what may be joints
DEEPEST = 3  # fields of a message inside of each other
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
SI = {"position": "rad", "velocity": "rad/s", "torque": "N m", "length": "m"}


@dataclass(frozen=True)
class SignalCandidate:
    """Something in a recording that may be a signal.

    Attributes:
        label: How a list calls it.
        source: Where it is, as a mapping says it; without unit.
        pose: Whether it is the pose of something; else numbers of joints.
        guess: The signal that its name hints at; empty: none.
    """

    label: str
    source: dict[str, Any]
    pose: bool
    guess: str = ""


@dataclass
class Found:
    """What is in a recording.

    Attributes:
        streams: What may be signals.
        joints: Names of joints, in order of their numbers; empty: the recording names none.
    """

    streams: list[SignalCandidate] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)


class PreviewRequest(Schema):
    """A signal to be looked at."""

    path: str = Field(description="recording")
    signal: SignalName = Field(description="what it is taken for")
    source: SignalSource = Field(description="where it is")
    position: SignalSource = Field(description="where the joint positions are, whose clock the others are brought to")
    joints: tuple[str, ...] = Field(min_length=1, max_length=MOST_WIDE, description="joints in order")


class RunEntry(Schema):
    """One row of the table of runs."""

    bag: str = Field(min_length=1, max_length=200, description="recording")
    object: Name = Field(description="object, or none")
    kind: str = Field(description="hit or free motion")
    condition: Name = Field(description="what repeats have in common")


class Description(Schema):
    """What a folder of recordings is."""

    path: str = Field(description="the folder")
    scenario: str = Field(description="scenario with robot, objects and support")
    joints: tuple[str, ...] = Field(min_length=1, max_length=MOST_WIDE, description="joints in order")
    command_includes_gravity: bool = Field(True, description="whether the command holds the arm's own weight")
    signals: dict[SignalName, SignalSource] = Field(description="where each signal is")
    runs: tuple[RunEntry, ...] = Field(min_length=1, description="the runs")


def look(workspace: Workspace, folder: str) -> dict[str, Any]:
    """What the first recording of a folder holds.

    Raises:
        InputError: There is none, or it cannot be read.
    """
    directory = workspace.existing(folder)
    lab = next((one for one in workspace.contents().laboratories if one.path == folder), None)
    if lab is None or not lab.recordings:
        raise InputError("no recording of others in this folder", file=directory)
    path = directory / lab.recordings[0]
    found = _look(path)
    if not found.streams:
        raise InputError("nothing in it looks like the signals of a robot", file=path)
    return {
        "recording": lab.recordings[0],
        "path": workspace.name(path),
        "joints": found.joints or [f"joint{number}" for number in range(1, 8)],
        "streams": [asdict(stream) for stream in found.streams],
    }


def _look(path: Path) -> Found:
    if is_bag_folder(path) or path.suffix in BAG_SUFFIXES:
        return _look_at_bag(path)
    if path.suffix in TABLE_SUFFIXES:
        return _look_at_table(path)
    if path.suffix in ARRAY_SUFFIXES:
        return _look_at_arrays(path)
    raise InputError("no recording that can be looked at", file=path)


def _look_at_bag(path: Path) -> Found:
    """The first message of every topic."""
    found = Found()
    store = get_typestore(Stores.ROS2_JAZZY)
    seen: set[str] = set()
    try:
        with Reader(path) as reader:
            for connection in reader.connections:
                register(store, connection)
            for connection, _, data in reader.messages():
                if connection.topic in seen:
                    continue
                seen.add(connection.topic)
                message = store.deserialize_cdr(data, connection.msgtype)
                _look_at_message(found, connection.topic, connection.msgtype, message)
                if len(seen) == len(reader.topics):
                    break
    except Exception as error:  # a damaged file can fail anywhere inside the library
        raise InputError(f"not a readable bag ({type(error).__name__}: {error})", file=path) from None
    return found


def _look_at_message(found: Found, topic: str, kind: str, message: Any) -> None:
    if _holds_pose(message):
        found.streams.append(SignalCandidate(topic, {"topic": topic, "type": kind}, True, "object_pose"))
    names = _names(message)
    for place, numbers in _numbers(message):
        source = {"topic": topic, "type": kind, "field": place}
        if names is not None and len(names) == numbers:
            source["names"] = "name"
            found.joints = found.joints or sorted(names, key=_natural)
        guess = {"effort": "torque"}.get(place, place)
        guess = "command" if "command" in topic else guess if "names" in source else ""
        label = f"{topic}: {place} ({numbers})"
        found.streams.append(SignalCandidate(label, source, False, guess))


def _names(message: Any) -> list[str] | None:
    names = getattr(message, "name", None)
    return list(names) if isinstance(names, list) and all(isinstance(name, str) for name in names) else None


def _natural(name: str) -> list[Any]:
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def _holds_pose(message: Any, depth: int = DEEPEST) -> bool:
    if hasattr(message, "transforms"):
        return True
    pairs = (("position", "orientation"), ("translation", "rotation"))
    if any(hasattr(message, a) and hasattr(message, b) for a, b in pairs):
        return True
    inner = (getattr(message, name, None) for name in ("pose", "transform"))
    return depth > 0 and any(_holds_pose(part, depth - 1) for part in inner if part is not None)


def _numbers(message: Any, before: str = "", depth: int = DEEPEST) -> Iterator[tuple[str, int]]:
    """Fields that hold several numbers, by path, and how many."""
    for name, value in vars(message).items():
        if name.startswith("__"):
            continue
        place = f"{before}{name}"
        if isinstance(value, np.ndarray):
            if value.ndim == 1 and 1 < value.size <= MOST_WIDE and np.issubdtype(value.dtype, np.floating):
                yield place, int(value.size)
        elif depth > 0 and hasattr(value, "__msgtype__") and name != "header":
            yield from _numbers(value, f"{place}.", depth - 1)


def _look_at_table(path: Path) -> Found:
    """Columns whose names differ in a number, and those of a pose."""
    found = Found()
    columns = TableFile.columns_of(path)
    groups: dict[str, set[int]] = {}
    for column in columns:
        for number in re.finditer(r"\d+", column):
            groups.setdefault(f"{column[: number.start()]}{{joint}}{column[number.end() :]}", set()).add(int(number[0]))
    for pattern, numbers in groups.items():
        if len(numbers) > 1 and numbers == set(range(1, len(numbers) + 1)):
            found.joints = found.joints or [f"joint{number}" for number in sorted(numbers)]
            label = f"{pattern.replace('{joint}', '1')} … {pattern.replace('{joint}', str(len(numbers)))}"
            found.streams.append(SignalCandidate(label, {"column": pattern}, False, _guess(pattern)))
    for column in columns:
        before = column.removesuffix("qw")
        names = [f"{before}{axis}" for axis in POSE_COLUMNS]
        if before != column and set(names) <= set(columns):
            found.streams.append(SignalCandidate(f"{names[0]} … {names[-1]}", {"columns": names}, True, "object_pose"))
    return found


def _look_at_arrays(path: Path) -> Found:
    found = Found()
    for name, shape in ArrayFile.shapes_of(path).items():
        if len(shape) != 2 or not 1 < shape[1] <= MOST_WIDE:
            continue
        pose = shape[1] == len(POSE_COLUMNS) and ("pose" in name or "object" in name)
        found.joints = found.joints or ([] if pose else [f"joint{number + 1}" for number in range(shape[1])])
        guess = "object_pose" if pose else _guess(name)
        found.streams.append(SignalCandidate(f"{name} ({shape[0]} × {shape[1]})", {"array": name}, pose, guess))
    return found


def _guess(name: str) -> str:
    """What a name hints at."""
    low = name.lower()
    for part, signal in (("command", "command"), ("cmd", "command"), ("desired", "command"), ("vel", "velocity"),
                         ("dq", "velocity"), ("pos", "position"), ("eff", "torque"), ("tau", "torque"),
                         ("tor", "torque"), ("q", "position")):  # fmt: skip
        if part in low:
            return signal
    return ""


def preview(workspace: Workspace, request: PreviewRequest) -> dict[str, Any]:
    """A signal over time, in SI units, thinned out.

    Raises:
        InputError: The signal cannot be read as what it is taken for.
    """
    path = workspace.existing(request.path)
    signals: dict[SignalName, SignalSource] = {"position": request.position, request.signal: request.source}
    mapping = _mapping(ROBOT, request.joints, signals, True, path)
    wanted: list[SignalName] = ["position", request.signal]
    series = read_series(path, mapping, wanted, [request.signal])[request.signal]
    kept = slice(None, None, max(1, math.ceil(series.time.size / MOST_POINTS)))
    time = series.time - series.time[0]
    values = series.values[:, :3] if request.signal == "object_pose" else series.values
    names = [f"{axis}" for axis in "xyz"] if request.signal == "object_pose" else list(request.joints)
    span = float(time[-1])
    return {
        "place": series.place,
        "samples": int(time.size),
        "rate": (time.size - 1) / span if span > 0.0 else 0.0,
        "low": float(np.nanmin(values)),
        "high": float(np.nanmax(values)),
        "unit": SI[QUANTITY[request.signal]],
        "time": _short(time[kept]),
        "columns": [{"name": name, "values": _short(values[kept, n])} for n, name in enumerate(names)],
    }


def _short(values: Array) -> list[float | None]:
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values]


def _mapping(
    robot: str, joints: tuple[str, ...], signals: dict[SignalName, SignalSource], gravity: bool, file: Path
) -> Mapping:
    """A mapping; where needed signals are not chosen yet, one that is chosen stands for them.

    Raises:
        InputError: It breaks its schema.
    """
    first = next(iter(signals.values()))
    stand_ins = {
        name: first.model_copy(update={"unit": next(iter(UNITS[QUANTITY[name]]))})
        for name in REQUIRED
        if name not in signals
    }
    content = {
        "description": "recordings as described in the workbench",
        "robot": robot,
        "joints": list(joints),
        "command_includes_gravity": gravity,
        "signals": {
            name: source.model_dump(exclude_defaults=True) for name, source in {**signals, **stand_ins}.items()
        },
    }
    return validate(Mapping, content, file)


def describe(workspace: Workspace, description: Description) -> list[str]:
    """Write ``mapping.yaml``, ``runs.csv`` and ``experiment.yaml`` beside the recordings, all of them or none.

    Returns:
        The files as they are seen from the folder.

    Raises:
        InputError: A file is there already, something in the description cannot be, or the first run cannot be read
            with it.
    """
    folder = workspace.existing(description.path)
    for name in (MAPPING, RUN_TABLE, EXPERIMENT):
        if (folder / name).exists():
            raise InputError("this file exists already; take it away to describe the folder anew", file=folder / name)
    for needed in REQUIRED:
        if needed not in description.signals:
            raise InputError("this signal is needed", key=f"signals.{needed}")
    scenario_name = workspace.scenario_path(description.scenario)
    scenario = load_scenario(scenario_name)
    robot = next(iter(scenario.robots.values()))
    if not isinstance(robot.facts, str):
        raise InputError("its robot has a file of its own: name it in a mapping file by hand", file=scenario_name)
    signals = {name: _for_all_objects(source, scenario) for name, source in description.signals.items()}
    mapping = _mapping(robot.facts, description.joints, signals, description.command_includes_gravity, folder / MAPPING)
    if scenario_name.endswith((".yaml", ".yml")):
        scenario_name = os.path.relpath(scenario_name, folder)
    experiment = {"scenario": scenario_name, "mapping": MAPPING, "runs": RUN_TABLE}
    texts = {
        MAPPING: yaml.safe_dump(mapping.model_dump(mode="json", exclude_defaults=True), sort_keys=False),
        EXPERIMENT: yaml.safe_dump(experiment, sort_keys=False),
        RUN_TABLE: _table(description.runs),
    }
    with whole_folder(folder) as aside:
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        table = (aside / RUN_TABLE).relative_to(folder)
        row = read_runs(folder, Experiment(scenario=scenario_name, runs=str(table)), scenario)[0]
        names = Names(object=row.object or "*", arm=next(iter(scenario.robots)), run=row.name)
        read_series(row.path, mapping, list(signals), REQUIRED, names)
    return [workspace.name(folder / name) for name in (EXPERIMENT, MAPPING, RUN_TABLE)]


def _for_all_objects(source: SignalSource, scenario: Scenario) -> SignalSource:
    """A topic that has the name of an object in it stands for those of all objects."""
    if source.topic is None:
        return source
    parts = ["{object}" if part in scenario.objects else part for part in source.topic.split("/")]
    return source.model_copy(update={"topic": "/".join(parts)})


def _table(runs: tuple[RunEntry, ...]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["bag", "object", "kind", "condition"])
    writer.writerows([run.bag, run.object, run.kind, run.condition] for run in runs)
    return text.getvalue()
