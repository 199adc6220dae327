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
        """Where they are, for messages."""
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
            if (back := steps_back(self.columns)) is not None:
                evidence = f"{back}; sort the rows by time, or cut the recording there into several"
                raise InputError(evidence, file=self.path)
            if (strange := strange_stamp(self.columns)) is not None:
                raise InputError(
                    f"no column holds time stamps: {strange}, expected seconds or another unit in numbers, or dates as "
                    "2026-11-25 12:00:00.5; rewrite this column",
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
        """A mapping by which a reader gives numbers as the file has them."""
        signals: dict[str, Any] = {name: {"unit": unit, **(source or {})} for name, unit in RAW_UNITS.items()}
        if robot == NO_ROBOT:
            parts = {"object_position": {"unit": "m"}, "object_quaternion": {"unit": "-"}}
            signals = parts if source is None else {"object_pose": {"unit": "m", **source}}
        return Mapping.model_validate(
            {"description": "raw", "robot": robot, "joints": joints, "time": self.clock_keys(rate),
             "table": self.layout.model_dump(), "run_column": self.run_column, "signals": signals}
        )  # fmt: skip

    def own_layout(self, main: RecordedFile) -> dict[str, Any]:
        """Layout and timestamps of the file that differ from the main file's."""
        own: dict[str, Any] = {}
        if self is not main:
            if self.layout != main.layout:
                own["table"] = self.layout.model_dump(exclude_defaults=True)
            if self.clock is not None and main.clock is not None:
                own |= self._own_time(self.clock, main.clock)
        return own

    def _own_time(self, clock: Guess, main: Guess) -> dict[str, Any]:
        """Keys of a signal for timestamps that differ from the main file's."""
        if clock.further.get("steps") != main.further.get("steps"):
            raise InputError(
                f"its time {flow(clock.value)} and that of the joints are not both time stamps or both times since the "
                "row before, expected one kind in all files of a run; add a column of time stamps",
                file=self.path,
            )
        own = {} if clock.value == main.value else {f"time_{'array' if self.is_array_file else 'column'}": clock.value}
        return own | ({} if clock.further["unit"] == main.further["unit"] else {"time_unit": clock.further["unit"]})


@dataclass(frozen=True)
class ImportedFiles:
    """Files that are described together, with their common rate and notes.

    Attributes:
        parts: One file of each kind.
        groups: Files by kind and run.
        rate: Sampling rate of files without timestamps [Hz]; None: they have timestamps.
        notes: Findings, appended to.
    """

    parts: Sequence[RecordedFile]
    groups: FileGroups
    rate: float | None
    notes: Notes


def open_recorded(pattern: str, path: Path, spread: bool, notes: Notes) -> RecordedFile:
    """A file with its contents; with several runs in it, the first.

    Args:
        pattern: Its kind among the files of a run; empty: a run is one file.
        path: The file.
        spread: Whether a run lies in several files.
        notes: Findings, appended to.

    Raises:
        InputError: It cannot be read.
    """
    if is_bag_folder(path) or suffix_of(path) in BAG_SUFFIXES:
        return RecordedFile(pattern, path, TableLayout(), {}, candidates_of(path), None)
    if suffix_of(path) in ARRAY_SUFFIXES:
        return _of_arrays(pattern, path, spread, notes)
    found = find_layout(path)
    layout = found.value
    if found.evidence:
        notes.add(f"table ({path.name})", flow(layout.model_dump(exclude_defaults=True)), found.evidence)
    columns = read_columns(path, layout).cells
    run, column = "", None if spread else run_column_of(columns)
    if column is not None:
        run = runs_of(columns[column])[0]
        notes.add("run_column", column, "says of every row which of several runs it belongs to")
        columns = read_rows(path, layout, column, run).cells
    part = RecordedFile(pattern, path, layout, columns, candidates_of(path, layout), clock_of(columns))
    return replace(part, run=run, run_column=column)


def _of_arrays(pattern: str, path: Path, spread: bool, notes: Notes) -> RecordedFile:
    """A file of arrays; if its groups are runs, the arrays of the first, with ``{run}`` in their names."""
    columns, candidates = ArrayFile.arrays_of(path), candidates_of(path)
    groups, run = run_groups_of(columns), ""
    if groups is not None:
        listed = ", ".join(f"{groups.before}{name}" for name in groups.names[:MAX_SHOWN_GROUPS])
        if groups.recorded and not spread:
            run = groups.names[0]
            columns = {new: own for name, own in columns.items() if (new := groups.with_placeholder(name))}
            named = [(one, groups.with_placeholder(one.source["array"])) for one in candidates]
            candidates = [replace(one, source={"array": new}, label=new) for one, new in named if new]
            notes.add("{run}", listed, f"{len(groups.names)} groups hold the same arrays: each is a run")
        else:
            notes.remarks.append(
                f"{path.name}: groups {listed} hold arrays of the same names, and one of them is described; where "
                f"they are runs, {RUN} in place of their name in every array and time.array of the mapping takes "
                "all of them, with FILE/GROUP as bag in runs.csv"
            )
    return RecordedFile(pattern, path, TableLayout(), columns, candidates, clock_of(columns), run=run)


def column_names(path: Path) -> frozenset[str]:
    """Names of the columns of a table, the arrays of a file or the fields of a bag; empty: it has none.

    Raises:
        InputError: The file cannot be read.
    """
    if is_bag_folder(path) or suffix_of(path) in BAG_SUFFIXES:
        return frozenset(one.label for one in candidates_of(path))
    if suffix_of(path) in ARRAY_SUFFIXES:
        return frozenset(ArrayFile.shapes_of(path))
    try:
        layout = find_layout(path).value
    except NoTable:
        return frozenset()
    return frozenset(read_columns(path, layout).cells) if layout.header != 0 else frozenset()


def read_streams(part: RecordedFile, robot: str, count: int, rate: float | None) -> dict[str, str]:
    """Read the raw numbers of all candidates that are as wide as the robot has joints; why others are refused."""
    refused: dict[str, str] = {}
    _add_windows(part, count)
    if count == 1 and part.layout.header != 0:
        key = "array" if part.is_array_file else "column"
        columns = {name: own for name, own in part.columns.items() if name not in part.clock_columns}
        part.candidates += single_candidates(columns, key)
    part.candidates += [own for one in part.candidates for own in parts_of(one, count)]
    numbered = tuple(f"joint{number}" for number in range(1, count + 1))
    shared = None if part.is_bag else open_file(part.path, part.raw_mapping(robot, numbered, rate), part.names, ())
    if part.is_bag:
        read_topics(part.path, {one.source["topic"] for one in part.candidates})
    for one in part.candidates:
        if one.pose or (one.width != count and len(one.joints) < count):
            continue
        source = SignalSource(unit="rad", **one.source)
        named = part.raw_mapping(robot, joints_of(one.joints, "", False, count), rate, one.source)
        if not one.stamped:
            named = named.model_copy(update={"time": named.time.model_copy(update={"stamp": "log"})})
        try:
            series = (shared or open_file(part.path, named, part.names, ("position",))).series("position", source)
        except InputError as error:
            refused[one.label] = str(error)
            continue
        series = without_steps_back({"position": series.filled()})[0]["position"].without_held()
        rows = usable_rows(series)
        if rows.size > MIN_CHECKED_SAMPLES:
            kept = replace(series, time=series.time[rows], values=series.values[rows])
            part.streams.append(JointStream(part.pattern, one, kept))
        else:
            refused[one.label] = (
                f"{rows.size} of {series.time.size} samples have numbers and a later stamp than all before, "
                f"more than {MIN_CHECKED_SAMPLES} are needed; stamps were taken from {part.stamps}, the key time of a "
                "mapping names others, or a rate"
            )
    _put_on_stamps(part)
    return refused


def settle_clock(part: RecordedFile, model: RobotModel) -> None:
    """Choose an ambiguous unit of time by the likelihood of positions and velocities."""
    clock = part.clock
    if clock is None or clock.sure or "steps" in clock.further:
        return
    assumed, stamps = UNITS["time"][clock.further["unit"]], numbers_of(part.columns[clock.value])
    tried = []
    for unit in (clock.further["unit"], *other_units(clock, stamps)):
        scale = UNITS["time"][unit] / assumed
        streams = [replace(one, series=replace(one.series, time=scale * one.series.time)) for one in part.streams]
        if found := JointSearch(streams, model).motions():
            tried.append((found[0].motion_log_posterior, unit, streams, found[0]))
    if not tried:
        return
    tried.sort(key=lambda one: one[0], reverse=True)
    _, unit, streams, motion = tried[0]
    assert motion.velocity is not None
    rate = 1.0 / float(np.median(np.diff(motion.time)))
    place, speed = motion.position.stream.label, motion.velocity.stream.label
    evidence = f"increases; in {unit}, {rate:.4g} Hz, {speed} is the derivative of {place}"
    margin = tried[0][0] - tried[1][0] if len(tried) > 1 else np.inf
    evidence += "" if margin > DECISIVE_LOG_ODDS else f"; next: {tried[1][1]}, log odds {margin:.2g}"
    part.clock = replace(clock, evidence=evidence, sure=bool(margin > DECISIVE_LOG_ODDS), further={"unit": unit})
    part.streams = streams


def _put_on_stamps(part: RecordedFile) -> None:
    """Put signals without timestamps on the clock of the others, as the reader does."""
    stamped = [one.series for one in part.streams if one.candidate.stamped]
    shifts = [float(np.median(one.log - one.time)) for one in stamped if one.log is not None]
    if shifts:
        part.streams = [
            one if one.candidate.stamped else replace(one, series=replace(one.series, time=one.series.time - shifts[0]))
            for one in part.streams
        ]


def _add_windows(part: RecordedFile, count: int) -> None:
    """Neighbouring columns without names; columns with names of a file that has but one signal."""
    names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
    numeric = [name for name in names if name not in part.clock_columns]
    if not names or any(one.source.get("columns") for one in part.candidates):
        return
    if part.layout.header != 0 and suffix_of(part.path) != ".npy":
        if len(numeric) == count and not axes_of(numeric)[1] and not any(one.width == count for one in part.candidates):
            label = f"{numeric[0]} … {numeric[-1]}"
            part.candidates.append(SignalCandidate(label, {"columns": numeric}, False, "", count))
        return
    part.candidates[:] = [one for one in part.candidates if "columns" not in one.source and one.width == 1]
    for start in range(len(numeric) - count + 1):
        own = numeric[start : start + count]
        part.candidates.append(SignalCandidate(f"{own[0]} … {own[-1]}", {"columns": own}, False, "", count))


def frames_in(columns: AbstractMapping[str, Any]) -> dict[str, Any]:
    """Keys of a clock by a column of frame numbers of a camera, which may have gaps; empty: there is no such column."""
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
    """Columns of places (x, y, z), of quaternions and of places in a plane, by what stands around the letter."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for found in re.finditer(r"(?i)(?<![a-z])q?([xyzw])(?![a-z])|([xyzw])$", name):
            letter = (found[1] or found[2]).lower()
            groups.setdefault((name[: found.start()], name[found.end() :]), {}).setdefault(
                ("q" if found[0].lower().startswith("q") else "") + letter, name
            )
    places, turns, planes = [], [], []
    for own in groups.values():
        plain = {letter: own[letter] for letter in own if not letter.startswith("q")}
        quaternion = {letter[-1]: own[letter] for letter in own if letter.startswith("q")}
        if set(plain) == set("xyzw"):
            quaternion = plain
        elif set("xyz") <= set(plain):
            places.append([plain[axis] for axis in AXES])
        elif len(plain) == IN_A_PLANE and "w" not in plain:
            planes.append([plain[axis] for axis in AXES if axis in plain])
        if set(quaternion) == set("xyzw"):
            first = min(quaternion, key=lambda letter: list(names).index(quaternion[letter]))
            turns.append([quaternion[letter] for letter in QUATERNION[first == "w"]])
    return places, turns, planes


def source_in(part: RecordedFile, source: AbstractMapping[str, Any], groups: FileGroups) -> dict[str, Any]:
    """Where a signal is, with the file that it lies in."""
    return {**source, **({"file": part.pattern} if groups.spread else {})}


def refuse_several(part: RecordedFile, groups: FileGroups, what: str, whose: str) -> None:
    """Files that differ in a word are of objects that a robot hits, and of nothing else."""
    if OBJECT in part.pattern:
        named = ", ".join(sorted(set(groups.objects.values())))
        evidence = f"files {part.pattern} hold {what}, of {named}: import the runs of each {whose} by themselves"
        raise InputError(evidence, file=part.path)
