# SPDX-License-Identifier: Apache-2.0
"""Foreign recordings: preview of their signals, and the files that describe them.

A preview reads a signal as an analysis does, by a mapping and :func:`read_series`. Before a description is written, one
run has been read with it.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping as AbstractMapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import yaml
from pydantic import Field

from impact_rs_analysis.application.described_folder import check_undescribed, described_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import Name, Schema, load_mapping, validate
from impact_rs_trials.file_names import EXPERIMENT_FILE, MAPPING_FILE, RUN_TABLE
from impact_rs_trials.recordings.checks.plausibility import check_gravity_torque
from impact_rs_trials.recordings.experiment import (
    FREE_MOTION,
    HIT,
    NO_OBJECT,
    Experiment,
    MotionCapture,
    read_runs,
)
from impact_rs_trials.recordings.file_units import SLIDES, TURNS, UNITS, si_unit
from impact_rs_trials.recordings.importing.candidates import (
    MAX_JOINT_NUMBERS,
    OBJECT_POSE,
    Proposal,
    SignalCandidate,
    candidates_of,
    propose,
)
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.importing.import_texts import PossibleReading
from impact_rs_trials.recordings.laboratory import Laboratory
from impact_rs_trials.recordings.laboratory_runs import MAX_IMPACT_SHARE, read_run, with_tracker_frame
from impact_rs_trials.recordings.mapping import (
    JOINT_SIGNALS,
    QUANTITY,
    REQUIRED,
    Mapping,
    SignalName,
    SignalSource,
    TableLayout,
    TimeSource,
)
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.recording import check_limits, check_velocity
from impact_rs_workbench.workspace import Workspace

MAX_PREVIEW_POINTS = 300  # of a preview
MAX_OTHER_READINGS = 2  # described alternatives to the chosen reading of a signal

ArmSignal = Literal["position", "velocity", "torque", "command"]


class PreviewRequest(Schema):
    """A signal to be looked at."""

    path: str = Field(description="recording")
    scenario: str = Field(description="scenario with the recorded robot")
    arm: str = Field(description="arm of the signal; for the pose of the object the arm whose clock it has")
    signal: SignalName = Field(description="meaning of the signal")
    source: SignalSource = Field(description="location of the signal")
    position: SignalSource = Field(description="location of the joint positions, whose clock is the reference")
    joints: tuple[str, ...] = Field(min_length=1, max_length=MAX_JOINT_NUMBERS, description="joints in order")
    command_includes_gravity: bool = Field(True, description="whether the command holds the arm's own weight")
    time: TimeSource = Field(default_factory=TimeSource, description="time stamps")
    table: TableLayout = Field(default_factory=TableLayout, description="where a text table has its names and rows")


class RunEntry(Schema):
    """One row of the table of runs."""

    bag: str = Field(min_length=1, max_length=200, description="recording")
    object: Name = Field(description="object, or none")
    kind: str = Field(description="hit or free motion")
    condition: Name = Field(description="what repeats have in common")


class ArmDescription(Schema):
    """Recorded signals of one arm."""

    joints: tuple[str, ...] = Field(min_length=1, max_length=MAX_JOINT_NUMBERS, description="joints in order")
    command_includes_gravity: bool = Field(True, description="whether the command holds the arm's own weight")
    signals: dict[ArmSignal, SignalSource] = Field(description="where each signal is")
    time: TimeSource = Field(default_factory=TimeSource, description="time stamps")
    table: TableLayout = Field(default_factory=TableLayout, description="where a text table has its names and rows")


class Description(Schema):
    """Description of a folder of recordings."""

    path: str = Field(description="the folder")
    scenario: str = Field(description="scenario with robots, objects and support")
    arms: dict[str, ArmDescription] = Field(description="what was recorded of each arm")
    object_pose: SignalSource | None = Field(None, description="where the pose of the object is")
    world_from_hits: bool = Field(False, description="whether the tracker's world is found from contact in the hits")
    runs: tuple[RunEntry, ...] | None = Field(
        None, min_length=1, description="the runs; null: runs.csv of the folder says what they are"
    )


def look(workspace: Workspace, folder: str, scenario_name: str) -> dict[str, Any]:
    """Contents of the first recording of a folder, with candidates for the signals of a scenario's arms.

    Raises:
        InputError: There is no recording, or it cannot be read; or there is no such scenario.
    """
    directory = workspace.existing(folder)
    lab = next((item for item in workspace.contents().laboratories if item.path == folder), None)
    if lab is None or not lab.recordings:
        raise InputError("no recordings of another controller in this folder", file=directory)
    path = directory / lab.recordings[0]
    streams = candidates_of(path)
    scenario = load_scenario(workspace.scenario_path(scenario_name))
    robots = scenario.robots
    run_table = _own_table(directory, scenario_name, scenario)
    files = {arm: _robot(workspace, scenario_name, scenario, arm) for arm in robots}
    proposals = propose(streams, {arm: robot.robot_facts.joint_count for arm, robot in robots.items()})
    guesses = {arm: _Guesses({}, {}, ()) for arm in robots}
    if len(robots) == 1:  # import describes one robot
        ((arm, file),) = files.items()
        guesses[arm] = _by_numbers(path, directory, file)
        proposals[arm] = _chosen(streams, proposals[arm], guesses[arm])
    if not streams:
        raise InputError("none of its signals looks like one of a robot", file=path)
    return {
        "recording": lab.recordings[0],
        "table": run_table,
        "path": workspace.name(path),
        "streams": [asdict(candidate) for candidate in streams],
        "arms": {
            arm: {
                "robot": Path(files[arm]).stem,
                "slides": [kind == "prismatic" for kind in robots[arm].robot_facts.joint_types],
                **asdict(proposal),
                "units": {name: section["unit"] for name, section in guesses[arm].signals.items()},
                **guesses[arm].layout,
                "said": guesses[arm].evidence,
                "readings": {
                    name: [asdict(item) for item in alternatives]
                    for name, alternatives in guesses[arm].readings.items()
                },
            }
            for arm, proposal in proposals.items()
        },
        "units": {
            name: [list(table.get(QUANTITY[name], {})) for table in (TURNS, SLIDES)] for name in get_args(ArmSignal)
        }
        | {OBJECT_POSE: [list(UNITS[QUANTITY[OBJECT_POSE]]), []]},
        "object_pose": next((number for number, item in enumerate(streams) if item.guess == OBJECT_POSE), None),
    }


@dataclass(frozen=True)
class _Guesses:
    """Findings of import in a recording.

    Attributes:
        signals: Sections of a mapping, by signal.
        layout: Sections ``time`` and ``table`` of a mapping, where it needs them.
        evidence: Evidence of the guesses, line by line.
        joints: Names of the joints.
        readings: Possible readings by signal, the chosen one first.
    """

    signals: dict[str, dict[str, Any]]
    layout: dict[str, Any]
    evidence: tuple[str, ...]
    joints: tuple[str, ...] = ()
    readings: AbstractMapping[str, tuple[PossibleReading, ...]] = field(default_factory=dict)


def _by_numbers(path: Path, folder: Path, robot: str) -> _Guesses:
    """Sections of a mapping that ``impact-rs import`` guesses from a recording, or the reason of its refusal."""
    try:
        draft = draft_import([path], folder, ImportOptions(robot=robot))
    except InputError as error:
        return _Guesses({}, {}, (f"Chosen by names alone, for impact-rs import says: {error.message}",))
    content = yaml.safe_load(draft.texts[MAPPING_FILE])
    signal_names = (*get_args(ArmSignal), OBJECT_POSE)
    signals = {name: section for name, section in content["signals"].items() if name in signal_names}
    if "torque_constant" in content:  # of currents, which runs with contact have not
        del signals["torque"]
    layout = {name: content[name] for name in ("time", "table") if name in content}
    lines_of_signals = [line for line in draft.lines if line.key.split(".")[0] in ("signals", "time", "joints")]
    assumed = ("", "assumed: ")
    evidence = tuple(f"{line.key}: {line.value} ({assumed[not line.sure]}{line.evidence})" for line in lines_of_signals)
    evidence += tuple(
        f"signals.{name}: next {reading.stream} in {reading.unit} (log odds {reading.behind:.2g}; {reading.evidence})"
        for name, alternatives in draft.readings.items()
        for reading in alternatives[1 : 1 + MAX_OTHER_READINGS]
    )
    return _Guesses(signals, layout, evidence, tuple(content["joints"]), draft.readings)


def _chosen(streams: list[SignalCandidate], named: Proposal, guesses: _Guesses) -> Proposal:
    """A proposal in which guesses by numbers replace guesses by names; new sources are appended to the streams."""
    signals = dict(named.signals)
    for name, section in guesses.signals.items():
        source = {key: value for key, value in section.items() if key != "unit"}
        index = next((number for number, candidate in enumerate(streams) if candidate.source == source), None)
        if index is None:
            index = len(streams)
            label = ", ".join(f"{key} {value}" for key, value in source.items())
            streams.append(SignalCandidate(label, source, name == OBJECT_POSE, name, 0, named.joints))
        if name != OBJECT_POSE:
            signals[name] = index
    return Proposal(guesses.joints or named.joints, signals)


def _own_table(folder: Path, scenario_name: str, scenario: Scenario) -> dict[str, Any] | None:
    """Rows of the user's own table of runs in the folder; None: the folder has no table."""
    if not (folder / RUN_TABLE).is_file():
        return None
    try:
        rows = read_runs(folder, Experiment(scenario=scenario_name), scenario)
    except InputError as error:
        return {"name": RUN_TABLE, "rows": [], "error": str(error)}
    listed = [
        {"bag": row.name, "object": row.object or NO_OBJECT, "kind": HIT if row.hit else FREE_MOTION}
        | {"condition": row.condition}
        for row in rows
    ]
    return {"name": RUN_TABLE, "rows": listed, "error": ""}


def preview(workspace: Workspace, request: PreviewRequest) -> dict[str, Any]:
    """A signal over time, in SI units, thinned out, with one line if its values are implausible.

    Raises:
        InputError: The signal cannot be read as what it is taken for.
    """
    path = workspace.existing(request.path)
    scenario = load_scenario(workspace.scenario_path(request.scenario))
    if request.arm not in scenario.robots:
        raise InputError(f"scenario {scenario.name!r} has no arm {request.arm!r}", key="arm")
    signals: dict[SignalName, SignalSource] = {"position": request.position, request.signal: request.source}
    robot = _robot(workspace, request.scenario, scenario, request.arm)
    mapping = _mapping(robot, request, signals, path)
    signal_names: list[SignalName] = ["position", request.signal]
    read_signals = read_series(path, mapping, signal_names, [request.signal])
    series, pose = read_signals[request.signal], request.signal == OBJECT_POSE
    thinned = slice(None, None, max(1, math.ceil(series.time.size / MAX_PREVIEW_POINTS)))
    time = series.time - series.time[0]
    values = series.values[:, :3] if pose else series.values
    names = list("xyz") if pose else list(request.joints)
    quantity = QUANTITY[request.signal]
    units = [si_unit(quantity, mapping.unit(request.signal, number), quantity) for number in range(len(names))]
    span = float(time[-1])
    return {
        "place": series.label,
        "samples": int(time.size),
        "rate": (time.size - 1) / span if span > 0.0 else 0.0,
        "ranges": [
            {"unit": unit, "low": float(np.nanmin(values_of_unit)), "high": float(np.nanmax(values_of_unit))}
            for unit in dict.fromkeys(units)
            for values_of_unit in [values[:, [other_unit == unit for other_unit in units]]]
        ],
        "time": _short(time[thinned]),
        "columns": [
            {"name": name, "unit": unit, "values": _short(values[thinned, number])}
            for number, (name, unit) in enumerate(zip(names, units, strict=True))
        ],
        "wrong": _wrong(path, scenario, request, mapping, read_signals),
    }


def _wrong(
    path: Path,
    scenario: Scenario,
    request: PreviewRequest,
    mapping: Mapping,
    signals: dict[SignalName, Series],
) -> str:
    """Why the analysis would refuse a joint signal; empty: it would not."""
    name, series = request.signal, signals[request.signal]
    if name not in JOINT_SIGNALS:
        return ""
    try:
        _ = mapping.facts  # whose joints have these units
        position = signals["position"].at(series.time)
        if name in REQUIRED:
            check_limits(path, name, series.time, series.values, mapping, MAX_IMPACT_SHARE)
        if name == "velocity":
            check_velocity(path, series.time, position, series.values, mapping)
        if name == "torque" or (name == "command" and request.command_includes_gravity):
            model = Physics.nominal(scenario, next(iter(scenario.objects))).robot_model(request.arm)
            remedy = "wrong unit or sign, or without the gravity torque?"
            check_gravity_torque(path, name, model, position, series.values, remedy)
    except InputError as error:
        return error.message
    return ""


def _robot(workspace: Workspace, scenario_name: str, scenario: Scenario, arm: str) -> str:
    """The robot of an arm: its name in config/robots, or the path of its file.

    Raises:
        InputError: It has no file.
    """
    facts = scenario.robots[arm].facts
    if isinstance(facts, str):
        return facts
    path = Path(workspace.scenario_path(scenario_name))
    facts_entry = load_mapping(path)["robots"][arm]["facts"]
    if not isinstance(facts_entry, str):
        message = "the robot is described in the scenario itself: put it into a file of its own, and name that here"
        raise InputError(message, file=path, key=f"robots.{arm}.facts")
    return str((path.parent / facts_entry).resolve())


def _short(values: Array) -> list[float | None]:
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values]


def describe(workspace: Workspace, description: Description) -> tuple[list[str], tuple[str, ...]]:
    """Write experiment file, mappings and table of runs beside the recordings, all of them or none.

    A table of runs that the user has written is used as it is.

    Returns:
        The files as they are seen from the folder, the experiment file first; and what the user should know of how the
        first run was read.

    Raises:
        InputError: A file is there already, something in the description cannot be, or the first run (of those that
            hit something) cannot be read with it.
    """
    folder = workspace.existing(description.path)
    scenario_name = workspace.scenario_path(description.scenario)
    scenario = load_scenario(scenario_name)
    files = _mapping_files(scenario)
    new = [EXPERIMENT_FILE, *files.values(), *([] if description.runs is None else [RUN_TABLE])]
    check_undescribed(folder, new)
    mappings = {arm: _mapping_of(workspace, description, scenario, arm, folder / file) for arm, file in files.items()}
    if scenario_name.endswith((".yaml", ".yml")):
        scenario_name = os.path.relpath(scenario_name, folder)
    experiment: dict[str, Any] = {"scenario": scenario_name, "runs": RUN_TABLE}
    experiment["mapping"] = files if len(files) > 1 else next(iter(files.values()))
    motion_capture = MotionCapture(estimate=description.world_from_hits)
    if motion_capture.estimate:
        experiment["motion_capture"] = {"estimate": True}
    texts = {file: _yaml(_seen_from(folder, mappings[arm])) for arm, file in files.items()}
    texts[EXPERIMENT_FILE] = _yaml(experiment)
    if description.runs is not None:
        texts[RUN_TABLE] = _table(description.runs)
    with described_folder(folder, texts) as staging_folder:
        table = (folder if description.runs is None else staging_folder) / RUN_TABLE
        rows = read_runs(folder, Experiment(scenario=scenario_name, runs=str(table.relative_to(folder))), scenario)
        laboratory = Laboratory.checked(scenario, mappings, motion_capture, lambda arm: {"key": arm})
        first = next((row for row in rows if row.hit), rows[0])
        remarks = read_run(with_tracker_frame(laboratory, rows, map), first).remarks
    written = [workspace.name(folder / name) for name in new]
    return written, tuple(f"{first.name}: {remark}" for remark in remarks)


def _mapping_files(scenario: Scenario) -> dict[str, str]:
    """Name of the mapping file of every arm."""
    if len(scenario.robots) == 1:
        return dict.fromkeys(scenario.robots, MAPPING_FILE)
    return {arm: f"mapping_{arm}.yaml" for arm in scenario.robots}


def _mapping_of(workspace: Workspace, description: Description, scenario: Scenario, arm: str, file: Path) -> Mapping:
    """The mapping of one arm; the object's pose is with the first.

    Raises:
        InputError: The arm is not described, a signal is missing, or something breaks the schema.
    """
    where = f"arms.{arm}."
    if arm not in description.arms:
        raise InputError(f"scenario {scenario.name!r} has this arm: say where its signals are", key=where[:-1])
    arm_description = description.arms[arm]
    for needed in REQUIRED:
        if needed not in arm_description.signals:
            raise InputError(
                "this signal is needed", key=f"{where if len(scenario.robots) > 1 else ''}signals.{needed}"
            )
    signals: dict[SignalName, SignalSource] = dict(arm_description.signals.items())
    if description.object_pose is not None and arm == next(iter(scenario.robots)):
        signals[OBJECT_POSE] = _for_all_objects(description.object_pose, scenario)
    robot = _robot(workspace, description.scenario, scenario, arm)
    return _mapping(robot, arm_description, signals, file)


def _mapping(
    robot: str, request: PreviewRequest | ArmDescription, signals: dict[SignalName, SignalSource], file: Path
) -> Mapping:
    """A mapping; a chosen signal stands in for required ones that are not chosen yet.

    Raises:
        InputError: It breaks its schema.
    """
    first_name, first = next(iter(signals.items()))
    units = first.units if len(first.units) > 1 else first.units * len(request.joints)
    stand_ins = {
        name: first.model_copy(
            update={"unit": tuple(si_unit(QUANTITY[name], unit, QUANTITY[first_name]) for unit in units)}
        )
        for name in REQUIRED
        if name not in signals
    }
    content = {
        "description": "recordings as described in the workbench",
        "robot": robot,
        "joints": list(request.joints),
        "command_includes_gravity": request.command_includes_gravity,
        "time": request.time.model_dump(exclude_defaults=True),
        "table": request.table.model_dump(exclude_defaults=True),
        "signals": {
            name: source.model_dump(exclude_defaults=True) for name, source in {**signals, **stand_ins}.items()
        },
    }
    return validate(Mapping, content, file)


def _seen_from(folder: Path, mapping: Mapping) -> dict[str, Any]:
    """Content of a mapping file in a folder, with the file of a robot as it is seen from there."""
    content = mapping.model_dump(mode="json", exclude_defaults=True)
    robot = mapping.robot
    return content | {"robot": os.path.relpath(robot, folder) if robot.endswith((".yaml", ".yml")) else robot}


def _yaml(content: dict[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False)


def _for_all_objects(source: SignalSource, scenario: Scenario) -> SignalSource:
    """A topic that has the name of an object in it stands for the topics of all objects."""
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
