# SPDX-License-Identifier: Apache-2.0
"""Files of a recording for an import: columns, candidates, clock and the raw numbers of streams."""

from __future__ import annotations

import re
from collections.abc import Mapping as AbstractMapping
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_trials.recordings.file_units import UNITS
from impact_rs_trials.recordings.importing.candidates import (
    SignalCandidate,
    candidates_of,
    joints_of,
    parts_of,
    single_candidates,
    vector_width,
)
from impact_rs_trials.recordings.importing.file_groups import OBJECT, FileGroups
from impact_rs_trials.recordings.importing.import_checks import MIN_CHECKED_SAMPLES, usable_rows
from impact_rs_trials.recordings.importing.import_texts import Notes, flow
from impact_rs_trials.recordings.importing.joint_search import JointSearch
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.importing.table_layout import NoTable, find_layout
from impact_rs_trials.recordings.mapping import IN_A_PLANE, NO_ROBOT, Mapping, SignalSource, TableLayout
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.bag_file import read_topics
from impact_rs_trials.recordings.readers.clock_steps import without_steps_back
from impact_rs_trials.recordings.readers.guesses import (
    FRAME,
    Guess,
    clock_of,
    numbers_of,
    other_units,
    steps_back,
    strange_stamp,
)
from impact_rs_trials.recordings.readers.inner_runs import RUN, run_column_of, run_groups_of, runs_of
from impact_rs_trials.recordings.readers.run_finder import ARRAY_SUFFIXES, BAG_SUFFIXES, is_bag_folder
from impact_rs_trials.recordings.readers.series import Names
from impact_rs_trials.recordings.readers.sources import open_file
from impact_rs_trials.recordings.readers.table_columns import read_columns, read_rows
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.relations import DECISIVE_LOG_ODDS

MAX_SHOWN_GROUPS = 3  # in a message
QUATERNION = (("x", "y", "z", "w"), ("w", "x", "y", "z"))
RAW_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m"}


@dataclass
class RecordedFile:
    """One kind of file, represented by its first file (or the first run in it) and its contents."""

    pattern: str
    path: Path
    layout: TableLayout
    columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]
    candidates: list[SignalCandidate]
    clock: Guess | None
    streams: list[JointStream] = field(default_factory=list)
    run: str = ""
    run_column: str | None = None
    on_log: bool = False  # times are the log times of a bag

    @property
    def names(self) -> Names:
        """Values of the placeholders of a mapping."""
        return Names(run=self.run or "*")

    @property
    def clock_columns(self) -> tuple[str, ...]:
        """Columns of the timestamps."""
        value = () if self.clock is None else self.clock.value
        return (value,) if isinstance(value, str) else tuple(value)

    @property
    def stamps(self) -> str:
        """Location and unit of the timestamps, for messages."""
        return "the messages" if self.clock is None else f"{flow(self.clock.value)} [{self.clock.further['unit']}]"

    @property
    def is_bag(self) -> bool:
        """Whether it is a bag, whose messages have timestamps."""
        return is_bag_folder(self.path) or suffix_of(self.path) in BAG_SUFFIXES

    @property
    def is_array_file(self) -> bool:
        """Whether it holds arrays by name."""
        return suffix_of(self.path) in ARRAY_SUFFIXES

    def clock_keys(self, rate: float | None) -> dict[str, Any]:
        """Section ``time`` of a mapping."""
        if rate is not None:
            frames = {} if self.is_array_file else frames_in(self.columns)
            return {**frames, "rate": rate}
        if not self.columns:
            return {"stamp": "log"} if self.on_log else {}
        if self.clock is None:
            if (step_back := steps_back(self.columns)) is not None:
                evidence = f"{step_back}; sort the rows by time, or cut the recording there into several"
                raise InputError(evidence, file=self.path)
            if (strange_cell := strange_stamp(self.columns)) is not None:
                raise InputError(
                    f"no column holds time stamps: {strange_cell}, expected seconds or another unit in numbers, or "
                    "dates as 2026-11-25 12:00:00.5; rewrite this column",
                    file=self.path,
                )
            raise InputError(
                "no column holds time stamps: none increases at a rate of 1 Hz to 100 kHz; --rate says the sampling "
                "rate of files without stamps",
                file=self.path,
            )
        where = "array" if self.is_array_file else "column"
        return {where: self.clock.value, **self.clock.further}

    def raw_mapping(
        self, robot: str, joints: tuple[str, ...], rate: float | None, source: AbstractMapping[str, Any] | None = None
    ) -> Mapping:
        """A mapping with which a reader returns the numbers of the file unchanged."""
        signals: dict[str, Any] = {name: {"unit": unit, **(source or {})} for name, unit in RAW_UNITS.items()}
        if robot == NO_ROBOT:
            parts = {"object_position": {"unit": "m"}, "object_quaternion": {"unit": "-"}}
            signals = parts if source is None else {"object_pose": {"unit": "m", **source}}
        return Mapping.model_validate(
            {"description": "raw", "robot": robot, "joints": joints, "time": self.clock_keys(rate),
             "table": self.layout.model_dump(), "run_column": self.run_column, "signals": signals}
        )  # fmt: skip

    def own_layout(self, main: RecordedFile) -> dict[str, Any]:
        """Layout and timestamps of the file that differ from those of the main file."""
        differing: dict[str, Any] = {}
        if self is not main:
            if self.layout != main.layout:
                differing["table"] = self.layout.model_dump(exclude_defaults=True)
            if self.clock is not None and main.clock is not None:
                differing |= self._own_time(self.clock, main.clock)
        return differing

    def _own_time(self, clock: Guess, main: Guess) -> dict[str, Any]:
        """Keys of a signal for timestamps that differ from those of the main file."""
        if clock.further.get("steps") != main.further.get("steps"):
            raise InputError(
                f"its time {flow(clock.value)} and the time of the joints are not both time stamps or both times since "
                "the previous row, expected one kind in all files of a run; add a column of time stamps",
                file=self.path,
            )
        differing: dict[str, Any] = {}
        if clock.value != main.value:
            differing["time_array" if self.is_array_file else "time_column"] = clock.value
        if clock.further["unit"] != main.further["unit"]:
            differing["time_unit"] = clock.further["unit"]
        return differing


@dataclass(frozen=True)
class ImportedFiles:
    """Files that are described together, with their common rate and notes.

    Attributes:
        files: One file of each kind.
        groups: Files by kind and run.
        rate: Sampling rate of files without timestamps [Hz]; None: they have timestamps.
        notes: Findings, appended to.
    """

    files: Sequence[RecordedFile]
    groups: FileGroups
    rate: float | None
    notes: Notes


def open_recorded(pattern: str, path: Path, several_files: bool, notes: Notes) -> RecordedFile:
    """A file with its contents; with several runs in it, the first.

    Args:
        pattern: Its kind among the files of a run; empty: a run is one file.
        path: The file.
        several_files: Whether a run has several files.
        notes: Findings, appended to.

    Raises:
        InputError: It cannot be read.
    """
    if is_bag_folder(path) or suffix_of(path) in BAG_SUFFIXES:
        return RecordedFile(pattern, path, TableLayout(), {}, candidates_of(path), None)
    if suffix_of(path) in ARRAY_SUFFIXES:
        return _of_arrays(pattern, path, several_files, notes)
    layout_guess = find_layout(path)
    layout = layout_guess.value
    if layout_guess.evidence:
        notes.add(f"table ({path.name})", flow(layout.model_dump(exclude_defaults=True)), layout_guess.evidence)
    columns = read_columns(path, layout).cells
    run, column = "", None if several_files else run_column_of(columns)
    if column is not None:
        run = runs_of(columns[column])[0]
        notes.add("run_column", column, "holds the run of every row")
        columns = read_rows(path, layout, column, run).cells
    recorded = RecordedFile(pattern, path, layout, columns, candidates_of(path, layout), clock_of(columns))
    return replace(recorded, run=run, run_column=column)


def _of_arrays(pattern: str, path: Path, several_files: bool, notes: Notes) -> RecordedFile:
    """A file of arrays; if its groups are runs, the arrays of the first run, with ``{run}`` in their names."""
    columns, candidates = ArrayFile.arrays_of(path), candidates_of(path)
    groups, run = run_groups_of(columns), ""
    if groups is not None:
        listed = ", ".join(f"{groups.before}{name}" for name in groups.names[:MAX_SHOWN_GROUPS])
        if groups.recorded and not several_files:
            run = groups.names[0]
            columns = {label: values for name, values in columns.items() if (label := groups.with_placeholder(name))}
            relabelled = [(candidate, groups.with_placeholder(candidate.source["array"])) for candidate in candidates]
            candidates = [
                replace(candidate, source={"array": label}, label=label) for candidate, label in relabelled if label
            ]
            notes.add("{run}", listed, f"{len(groups.names)} groups hold the same arrays: each is a run")
        else:
            notes.remarks.append(
                f"{path.name}: groups {listed} hold arrays of the same names, and one group is described; if they are "
                f"runs, write {RUN} for the name of the group into every array and time.array of the mapping, and "
                "FILE/GROUP as bag into runs.csv"
            )
    return RecordedFile(pattern, path, TableLayout(), columns, candidates, clock_of(columns), run=run)


def column_names(path: Path) -> frozenset[str]:
    """Names of the columns of a table, the arrays of a file or the fields of a bag; empty: it has none.

    Raises:
        InputError: The file cannot be read.
    """
    if is_bag_folder(path) or suffix_of(path) in BAG_SUFFIXES:
        return frozenset(candidate.label for candidate in candidates_of(path))
    if suffix_of(path) in ARRAY_SUFFIXES:
        return frozenset(ArrayFile.shapes_of(path))
    try:
        layout = find_layout(path).value
    except NoTable:
        return frozenset()
    return frozenset(read_columns(path, layout).cells) if layout.header != 0 else frozenset()


def read_streams(recorded: RecordedFile, robot: str, count: int, rate: float | None) -> dict[str, str]:
    """Read the raw numbers of all candidates that are as wide as the robot has joints; reasons of refusals by label."""
    refused: dict[str, str] = {}
    _add_windows(recorded, count)
    if count == 1 and recorded.layout.header != 0:
        key = "array" if recorded.is_array_file else "column"
        columns = {name: values for name, values in recorded.columns.items() if name not in recorded.clock_columns}
        recorded.candidates += single_candidates(columns, key)
    recorded.candidates += [part for candidate in recorded.candidates for part in parts_of(candidate, count)]
    shared = None
    if recorded.is_bag:
        read_topics(recorded.path, {candidate.source["topic"] for candidate in recorded.candidates})
    else:
        numbered = tuple(f"joint{number}" for number in range(1, count + 1))
        shared = open_file(recorded.path, recorded.raw_mapping(robot, numbered, rate), recorded.names, ())
    for candidate in recorded.candidates:
        if candidate.pose or (candidate.width != count and len(candidate.joints) < count):
            continue
        source = SignalSource(unit="rad", **candidate.source)
        mapping = recorded.raw_mapping(robot, joints_of(candidate.joints, "", False, count), rate, candidate.source)
        if not candidate.stamped:
            mapping = mapping.model_copy(update={"time": mapping.time.model_copy(update={"stamp": "log"})})
        try:
            opened = shared or open_file(recorded.path, mapping, recorded.names, ("position",))
            series = opened.series("position", source)
        except InputError as error:
            refused[candidate.label] = str(error)
            continue
        series = without_steps_back({"position": series.filled()})[0]["position"].without_held()
        rows = usable_rows(series)
        if rows.size > MIN_CHECKED_SAMPLES:
            series = replace(series, time=series.time[rows], values=series.values[rows])
            recorded.streams.append(JointStream(recorded.pattern, candidate, series))
        else:
            refused[candidate.label] = (
                f"{rows.size} of {series.time.size} samples have numbers and a later stamp than all before, "
                f"more than {MIN_CHECKED_SAMPLES} are needed; stamps were taken from {recorded.stamps}; the key time "
                "of a mapping names other stamps, or a rate"
            )
    _put_on_stamps(recorded)
    return refused


def settle_clock(recorded: RecordedFile, model: RobotModel) -> None:
    """Choose an ambiguous unit of time by the likelihood of positions and velocities."""
    clock = recorded.clock
    if clock is None or clock.sure or "steps" in clock.further:
        return
    assumed, stamps = UNITS["time"][clock.further["unit"]], numbers_of(recorded.columns[clock.value])
    choices = []
    for unit in (clock.further["unit"], *other_units(clock, stamps)):
        scale = UNITS["time"][unit] / assumed
        streams = [
            replace(stream, series=replace(stream.series, time=scale * stream.series.time))
            for stream in recorded.streams
        ]
        if motions := JointSearch(streams, model).motions():
            choices.append((motions[0].motion_log_posterior, unit, streams, motions[0]))
    if not choices:
        return
    choices.sort(key=lambda entry: entry[0], reverse=True)
    _, unit, streams, motion = choices[0]
    assert motion.velocity is not None
    rate = 1.0 / float(np.median(np.diff(motion.time)))
    position, velocity = motion.position.stream.label, motion.velocity.stream.label
    evidence = f"increases; in {unit}, {rate:.4g} Hz, {velocity} is the derivative of {position}"
    margin = choices[0][0] - choices[1][0] if len(choices) > 1 else np.inf
    evidence += "" if margin > DECISIVE_LOG_ODDS else f"; next: {choices[1][1]}, log odds {margin:.2g}"
    recorded.clock = replace(clock, evidence=evidence, sure=bool(margin > DECISIVE_LOG_ODDS), further={"unit": unit})
    recorded.streams = streams


def _put_on_stamps(recorded: RecordedFile) -> None:
    """Put signals without timestamps on the clock of the signals with timestamps, as the reader does."""
    stamped = [stream.series for stream in recorded.streams if stream.candidate.stamped]
    shifts = [float(np.median(series.log - series.time)) for series in stamped if series.log is not None]
    if shifts:
        recorded.streams = [
            stream
            if stream.candidate.stamped
            else replace(stream, series=replace(stream.series, time=stream.series.time - shifts[0]))
            for stream in recorded.streams
        ]


def _add_windows(recorded: RecordedFile, count: int) -> None:
    """Add windows of neighbouring unnamed columns; or all named columns of a file with a single signal."""
    names = [name for name, cells in recorded.columns.items() if vector_width(cells) == 1]
    numeric = [name for name in names if name not in recorded.clock_columns]
    if not names or any(candidate.source.get("columns") for candidate in recorded.candidates):
        return
    if recorded.layout.header != 0 and suffix_of(recorded.path) != ".npy":
        if (
            len(numeric) == count
            and not axes_of(numeric)[1]
            and not any(candidate.width == count for candidate in recorded.candidates)
        ):
            label = f"{numeric[0]} … {numeric[-1]}"
            recorded.candidates.append(SignalCandidate(label, {"columns": numeric}, False, "", count))
        return
    recorded.candidates[:] = [
        candidate for candidate in recorded.candidates if "columns" not in candidate.source and candidate.width == 1
    ]
    for start in range(len(numeric) - count + 1):
        window = numeric[start : start + count]
        recorded.candidates.append(
            SignalCandidate(f"{window[0]} … {window[-1]}", {"columns": window}, False, "", count)
        )


def frames_in(columns: AbstractMapping[str, Any]) -> dict[str, Any]:
    """Keys of a clock: a column of frame numbers of a camera, which may have gaps; empty: there is no such column."""
    for name, cells in columns.items():
        if FRAME.search(name):
            try:
                steps = np.diff(np.asarray(cells, dtype=float))
            except (ValueError, TypeError):
                continue
            if steps.size and np.all(steps > 0.0):
                return {"column": name, "unit": "frames"}
    return {}


def axes_of(names: Sequence[str]) -> tuple[list[list[str]], list[list[str]], list[list[str]]]:
    """Columns of positions (x, y, z), quaternions and positions in a plane, grouped by the name without letter."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for match in re.finditer(r"(?i)(?<![a-z])q?([xyzw])(?![a-z])|([xyzw])$", name):
            letter = (match[1] or match[2]).lower()
            groups.setdefault((name[: match.start()], name[match.end() :]), {}).setdefault(
                ("q" if match[0].lower().startswith("q") else "") + letter, name
            )
    positions, quaternions, planes = [], [], []
    for columns in groups.values():
        plain = {letter: columns[letter] for letter in columns if not letter.startswith("q")}
        quaternion = {letter[-1]: columns[letter] for letter in columns if letter.startswith("q")}
        if set(plain) == set("xyzw"):
            quaternion = plain
        elif set("xyz") <= set(plain):
            positions.append([plain[axis] for axis in AXES])
        elif len(plain) == IN_A_PLANE and "w" not in plain:
            planes.append([plain[axis] for axis in AXES if axis in plain])
        if set(quaternion) == set("xyzw"):
            first = min(quaternion, key=lambda letter: list(names).index(quaternion[letter]))
            quaternions.append([quaternion[letter] for letter in QUATERNION[first == "w"]])
    return positions, quaternions, planes


def source_in(recorded: RecordedFile, source: AbstractMapping[str, Any], groups: FileGroups) -> dict[str, Any]:
    """Source of a signal, with its file if a run has several."""
    return {**source, **({"file": recorded.pattern} if groups.several_files else {})}


def refuse_several(recorded: RecordedFile, groups: FileGroups, contents: str, owner: str) -> None:
    """Refuse files that differ in a word unless they hold objects that a robot hits."""
    if OBJECT in recorded.pattern:
        objects = ", ".join(sorted(set(groups.objects.values())))
        evidence = f"files {recorded.pattern} hold {contents}, of {objects}: import the runs of each {owner} separately"
        raise InputError(evidence, file=recorded.path)
