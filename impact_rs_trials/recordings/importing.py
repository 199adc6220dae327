# SPDX-License-Identifier: Apache-2.0
"""From raw files to a mapping and an experiment file: every guess is written with what shows it.

Files are grouped into runs by their names (:mod:`file_groups`), tables are found in texts (:mod:`table_layout`), what
may be a signal is listed by names and widths (:mod:`candidates`), and numbers decide which it is (:mod:`guesses`).
Values that nothing shows are marked as assumed. Signals are read by the readers of the analysis, so what is guessed is
what is used.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as AbstractMapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import Array, RobotFacts, load_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.schema import validate
from impact_rs_trials.recordings.array_file import ArrayFile
from impact_rs_trials.recordings.candidates import SignalCandidate, candidates_of, guess_of, joints_of, vector_width
from impact_rs_trials.recordings.clock_offset import OBJECT, ClocksApart, clocks_apart
from impact_rs_trials.recordings.file_groups import FileGroups, group_files, recordings_in, run_name
from impact_rs_trials.recordings.guesses import (
    Guess,
    clock_of,
    pose_of,
    quaternion_order,
    times_derivative,
    torque_of,
    unit_of_length,
    unit_of_position,
    velocity_of,
)
from impact_rs_trials.recordings.joint_checks import doubts_of_arm
from impact_rs_trials.recordings.joint_jumps import SMALLEST, jumps_of
from impact_rs_trials.recordings.mapping import (
    NO_ROBOT,
    REQUIRED,
    Mapping,
    MountedEndEffector,
    SignalName,
    SignalSource,
    TableLayout,
)
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.series import Names, Series
from impact_rs_trials.recordings.sources import ARRAY_SUFFIXES, BAG_SUFFIXES, is_bag_folder, open_file, read_series
from impact_rs_trials.recordings.table_columns import read_columns
from impact_rs_trials.recordings.table_layout import find_layout
from impact_rs_trials.runs import ArmSignals

MOST_SAMPLES = 20_000  # that are looked at
FEWEST_SAMPLES = 20
NAMED = 0.3  # correlation that a name is worth
ASKED_FOR = re.compile(r"des|ref|target|goal|cmd|command|set_?point|(^|_)d(_|\d|$)|filt|err", re.IGNORECASE)
OF_THE_ROBOT = re.compile(r"eef|(^|_)ee(_|$)|tcp|tool|flange|hand", re.IGNORECASE)
MOST_RUNS = 5  # whose clocks are looked at
MOVED = 0.005  # m, from which an object was hit
AXES = ("x", "y", "z")
QUATERNION = (("x", "y", "z", "w"), ("w", "x", "y", "z"))
RAW_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m"}


@dataclass(frozen=True)
class Line:
    """A key that was guessed.

    Attributes:
        key: Dotted path of the key.
        value: Its value as the file has it.
        evidence: What shows it.
        sure: Whether something shows it; else it is assumed.
    """

    key: str
    value: str
    evidence: str
    sure: bool = True


@dataclass(frozen=True)
class ImportDraft:
    """Files that describe recordings.

    Attributes:
        folder: Folder that the runs are named from.
        texts: Contents by file name.
        lines: What was guessed.
        remarks: What the user should know besides.
        hits: How many runs hit something.
        runs: How many runs there are.
    """

    folder: Path
    texts: dict[str, str]
    lines: tuple[Line, ...]
    remarks: tuple[str, ...]
    hits: int
    runs: int


@dataclass(frozen=True)
class Wishes:
    """What the user knows.

    Attributes:
        robot: Robot facts, by name or path; ``none``: an object alone; None: guess.
        scenario: Scenario of hits, by name or path; None: unknown.
        rate: Sampling rate of files without stamps [Hz]; None: they have stamps.
        dedupe: Whether of samples with one stamp the first is kept.
    """

    robot: str | None = None
    scenario: str | None = None
    rate: float | None = None
    dedupe: bool = False


@dataclass
class _Part:
    """One kind of file: its first one, with what it holds."""

    pattern: str
    path: Path
    layout: TableLayout
    columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]
    candidates: list[SignalCandidate]
    clock: Guess | None
    series: dict[int, Series] = field(default_factory=dict)

    @property
    def is_bag(self) -> bool:
        """Whether it is a bag, whose messages have stamps."""
        return is_bag_folder(self.path) or self.path.suffix in BAG_SUFFIXES


@dataclass(frozen=True)
class _Found:
    """What may be a signal of the joints, in one of the files."""

    part: _Part
    number: int

    @property
    def candidate(self) -> SignalCandidate:
        """Where it is."""
        return self.part.candidates[self.number]

    @property
    def series(self) -> Series:
        """Its numbers as the file has them."""
        return self.part.series[self.number]

    @property
    def label(self) -> str:
        """Its name, with that of its file if a run has several."""
        return f"{self.part.pattern}: {self.candidate.label}" if self.part.pattern else self.candidate.label

    def overlaps(self, other: _Found) -> bool:
        """Whether both have a column in common."""
        if self.part is not other.part:
            return False
        columns = [set(one.candidate.source.get("columns") or ()) for one in (self, other)]
        return self.number == other.number or bool(columns[0] & columns[1])

    def named(self, signal: str) -> float:
        """What names of columns, or else of the file, are worth for a signal."""
        guess = self.candidate.guess or guess_of(self.part.pattern)
        worth = NAMED if guess == signal else -NAMED if guess else 0.0
        return worth - NAMED * bool(ASKED_FOR.search(self.label))


@dataclass(frozen=True)
class _Motion:
    """Positions of the joints, and their velocities where a signal is those."""

    position: _Found
    unit: Guess
    velocity: tuple[_Found, str, Guess] | None = None
    sure: float = 0.0

    @property
    def score(self) -> float:
        """How surely it is the motion of the joints."""
        return (
            self.sure + self.position.named("position") + (self.velocity[0].named("velocity") if self.velocity else 0.0)
        )

    @property
    def places(self) -> Array:
        """q, ``(k, n)`` [rad, m]."""
        return np.asarray(self.position.series.values * self.unit.further["factor_"])

    @property
    def speeds(self) -> Array:
        """dq, ``(k, n)`` [rad/s, m/s]."""
        if self.velocity is None:
            return replace(self.position.series, values=self.places).derivative().values
        found, _, guess = self.velocity
        factor = _si(guess, "velocity") * np.asarray(guess.further.get("factor", 1.0))
        return found.series.at(self.position.series.time) * factor


def _with_velocity(place: _Found, unit: Guess, every: Sequence[_Found], facts: RobotFacts) -> Iterator[_Motion]:
    """Motions whose velocity is a signal."""
    motion, time = _Motion(place, unit), place.series.time
    for other in every:
        if not other.overlaps(place):
            found = velocity_of(time, motion.places, other.series.at(time), facts)
            if found is not None:
                yield _Motion(place, unit, (other, "velocity", found[1]), found[0])


def _torques(motion: _Motion, every: Sequence[_Found], model: RobotModel) -> list[tuple[float, _Found, Guess]]:
    """Signals that go with the torque of a motion, or those whose names say so; how surely, and as what."""
    time, q, dq = motion.position.series.time, motion.places, motion.speeds
    taken = [motion.position, *([motion.velocity[0]] if motion.velocity else [])]
    free = [one for one in every if not any(one.overlaps(other) for other in taken)]
    found = []
    for one in free:
        if one.candidate.guess in ("torque", "command", ""):
            guess = torque_of(time, q, dq, one.series.at(time), model, one.candidate.label)
            if guess is not None:
                found.append((guess[0] + one.named("torque"), one, guess[1]))
    said = Guess("N m", "nothing but its name: the motion takes too little torque to show it", False)
    return found or [(0.0, one, said) for one in free if one.named("torque") > 0.0]


def draft_import(paths: Sequence[Path], output: Path, wishes: Wishes) -> ImportDraft:
    """Describe recordings.

    Args:
        paths: Files, bags, or folders of them.
        output: Folder of the description, from which paths of a robot are seen.
        wishes: What the user knows.

    Raises:
        InputError: They cannot be read, or something is missing that nothing shows; the message says what to add.
    """
    return _Importer(group_files(recordings_in(paths)), output, wishes).draft()


class _Importer:
    """Collects guesses."""

    def __init__(self, groups: FileGroups, output: Path, wishes: Wishes) -> None:
        self._groups, self._output, self._wishes = groups, output, wishes
        self._lines: list[Line] = []
        self._remarks: list[str] = []
        self._parts = [self._part(pattern, next(iter(files.values()))) for pattern, files in groups.kinds.items()]

    def draft(self) -> ImportDraft:
        """All files."""
        robot = self._robot()
        facts = None if robot == NO_ROBOT else load_facts(robot)
        signals: dict[str, dict[str, Any]] = {}
        own: dict[str, Any] = {}
        part = self._parts[0]
        if facts is not None:
            part, own, signals = self._joint_signals(robot, facts)
        pose_part = self._object(part, facts is not None, signals)
        if facts is None and pose_part is None:
            raise InputError(
                "neither joints nor the pose of an object; expected columns of joints (--robot says which robot), or "
                "x, y, z and a quaternion", file=self._parts[0].path,
            )  # fmt: skip
        clock = self._time(part if facts is not None else pose_part or part)
        content: dict[str, Any] = {
            "description": f"{self._groups.folder.name or 'recordings'}, as impact-rs import found it",
            "robot": robot if not robot.endswith((".yaml", ".yml")) else os.path.relpath(robot, self._output),
            **own,
            **({"time": clock} if clock else {}),
        }
        main = part if facts is not None else pose_part or part
        if main.layout != TableLayout():
            content["table"] = main.layout.model_dump(exclude_none=True)
        content["signals"] = signals
        mapping = validate(Mapping, content | {"robot": robot}, self._output / "mapping.yaml")
        rows = self._runs(mapping)
        if facts is not None and self._clock_of_object(mapping, rows, signals):
            mapping = validate(Mapping, content | {"robot": robot}, self._output / "mapping.yaml")
        texts = {"mapping.yaml": _yaml(content, self._lines, HEAD), "runs.csv": _table(rows)}
        hits = sum(kind == "hit" for _, _, kind in rows)
        if hits or facts is None or self._wishes.scenario is not None:
            texts["experiment.yaml"] = self._experiment(facts, robot)
        self._try(mapping, hits)
        remarks = tuple(dict.fromkeys(self._remarks))
        return ImportDraft(self._groups.folder, texts, tuple(self._lines), remarks, hits, len(rows))

    def _part(self, pattern: str, path: Path) -> _Part:
        layout = TableLayout()
        columns: AbstractMapping[str, Sequence[str] | NDArray[Any]] = {}
        if is_bag_folder(path) or path.suffix in BAG_SUFFIXES:
            return _Part(pattern, path, layout, columns, candidates_of(path), None)
        if path.suffix in ARRAY_SUFFIXES:
            columns = ArrayFile.arrays_of(path)
        else:
            if path.suffix not in (".parquet", ".npy"):
                found = find_layout(path)
                layout = found.layout
                self._lines.append(
                    Line(f"table ({path.name})", _flow(layout.model_dump(exclude_none=True)), found.evidence)
                )
            columns = read_columns(path, layout).cells
        return _Part(pattern, path, layout, columns, candidates_of(path, layout), clock_of(columns))

    # ---- robot and joints -------------------------------------------------------------------------------------------

    def _robot(self) -> str:
        if self._wishes.robot is not None:
            self._say("robot", self._wishes.robot, "given with --robot")
            return self._wishes.robot
        known = sorted(path.stem for path in (config_directory() / "robots").glob("*.yaml"))
        texts = [str(part.path) for part in self._parts]
        texts += [one.label + " ".join(one.joints) for part in self._parts for one in part.candidates]
        words = " ".join(texts).lower().replace("_", "").replace(" ", "")
        named = [name for name in known if name.replace("_", "").removeprefix("kuka").removeprefix("franka") in words]
        if len(named) == 1:
            self._say("robot", named[0], "its name stands in the files; assumed, give --robot to be sure", sure=False)
            return named[0]
        wide = {one.width for part in self._parts for one in part.candidates if not one.pose and one.guess}
        counts = {name: load_facts(name).joint_count for name in known}
        if not wide & set(counts.values()) and any(self._poses(part, False) for part in self._parts):
            self._say("robot", NO_ROBOT, "no signal is as wide as a robot has joints: an object alone", sure=False)
            return NO_ROBOT
        fitting = [name for name, count in counts.items() if count in wide] or known
        raise InputError(
            f"--robot is needed: the files do not say which robot this is; known are {', '.join(fitting)}, your own "
            "comes from a URDF (impact-rs robot import), and none stands for an object without a robot",
            file=self._parts[0].path,
        )

    def _joint_signals(self, robot: str, facts: RobotFacts) -> tuple[_Part, dict[str, Any], dict[str, dict[str, Any]]]:
        """Part of the positions, keys of the mapping beside its signals, and the signals."""
        for part in self._parts:
            self._read(part, robot, facts.joint_count)
        every = [_Found(part, number) for part in self._parts for number in part.series]
        seen = "; ".join(one.label for one in every) or "none"
        places = [
            (one, unit)
            for one in every
            if (unit := unit_of_position(one.series.values, facts, one.candidate.label)) is not None
            and np.ptp(one.series.values, axis=0).any()
        ]
        motions = [motion for place, unit in places for motion in _with_velocity(place, unit, every, facts)]
        moving = bool(motions)
        if not moving and self._wishes.rate is not None:
            self._check_rate(self._wishes.rate, places, every)
        if not moving and not any(one.named("velocity") > 0.0 for one in every):
            motions = [_Motion(*place) for place in places if place[0].named("position") >= 0.0]
        if not motions:
            raise InputError(
                f"no two signals of {facts.joint_count} joints are positions within the limits of {robot} and their "
                f"derivative; signals as wide as that: {seen}. Another --robot, or a mapping by hand "
                "(docs/your_data.md)",
                file=self._parts[0].path,
            )
        motions = [max(motions, key=lambda one: one.score)] if moving else motions
        model = RobotModel(facts, MountedEndEffector().build(), pin.SE3.Identity())
        tried = [(motion, _torques(motion, every, model)) for motion in motions]
        motion, torques = max(
            tried, key=lambda one: one[0].score + max((score for score, *_ in one[1]), default=-np.inf)
        )
        if not torques:
            raise InputError(
                f"nothing goes with the torque that weight and inertia of {robot} take in this motion; signals as wide "
                f"as its joints: {seen}. Another --robot, or a mapping by hand (docs/your_data.md)",
                file=motion.position.part.path,
            )
        part = motion.position.part
        signals = {"position": self._joint_signal(motion.position, "position", replace(motion.unit, further={}), part)}
        if motion.velocity is None:
            self._say(
                "signals.velocity", "none", "no signal is the derivative of the positions: velocities are made of them"
            )
        else:
            signals["velocity"] = self._joint_signal(*motion.velocity, part)
        own = {"joints": list(self._joints(part, motion.position.number, facts.joint_count))}
        return part, own | self._torque(torques, facts, robot, signals, part), signals

    def _check_rate(self, rate: float, places: Sequence[tuple[_Found, Guess]], every: Sequence[_Found]) -> None:
        """Refuse a sampling rate at which a velocity would be that of another one."""
        for place, unit in places:
            motion, time = _Motion(place, unit), place.series.time
            for other in every:
                factor = None if other.overlaps(place) else times_derivative(time, motion.places, other.series.at(time))
                if factor is not None and factor > 0.0:
                    real = rate * factor
                    raise InputError(
                        f"{other.label} is {factor:.3g} times the derivative of {place.label} in all joints, which is "
                        f"a velocity in rad/s at {real:.4g} Hz, in deg/s at {real * np.pi / 180.0:.4g} Hz",
                        key="--rate",
                        value=f"{rate:g}",
                    )

    def _torque(
        self, found: list[tuple[float, _Found, Guess]], facts: RobotFacts, robot: str,
        signals: dict[str, dict[str, Any]], part: _Part,
    ) -> dict[str, Any]:  # fmt: skip
        """The torque of the joints, which is added to the signals; keys of the mapping that go with it."""
        _, chosen, best = max(found, key=lambda one: one[0])
        others = [other.label for _, other, _ in found if not other.overlaps(chosen)]
        if others:
            said = f"{best.evidence}; so do {'; '.join(others)}: take the one that was measured"
            best = replace(best, evidence=said, sure=False)
        constant = best.further.get("torque_constant")
        further = {key: value for key, value in best.further.items() if key != "torque_constant"}
        signals["torque"] = self._joint_signal(chosen, "torque", replace(best, further=further), part)
        at_motor = constant is not None or not facts.joint_torque_loop
        said = "currents are those of motors" if constant is not None else f"joint_torque_loop of {robot} is "
        said += "" if constant is not None else str(facts.joint_torque_loop).lower()
        self._say("torque_measured_at", "motor" if at_motor else "link", said, sure=constant is not None)
        own: dict[str, Any] = {"torque_measured_at": "motor" if at_motor else "link"}
        if constant is not None:
            self._say(
                "torque_constant", _flow(constant), "by the weight in this recording; take those of a data sheet", False
            )
            own["torque_constant"] = constant
        return own

    def _joint_signal(self, one: _Found, name: str, guess: Guess, main: _Part) -> dict[str, Any]:
        """Section of a signal of the joints, with the layout of its file where that is not the one of the positions."""
        own = self._signal(one.part, one.number, name, guess)
        return own | self._own_layout(one.part, main, True)

    def _joints(self, part: _Part, position: int, count: int) -> tuple[str, ...]:
        one = part.candidates[position]
        joints = joints_of(one.joints, "", False, count)
        if one.joints:
            self._say("joints", _flow(list(joints)), "the recording names them")
        else:
            self._say("joints", _flow(list(joints)), "columns hold the joints from base to tip", sure=False)
        return joints

    def _read(self, part: _Part, robot: str, count: int) -> None:
        """Raw numbers of all candidates that are as wide as the robot has joints."""
        self._windows(part, count)
        numbered = tuple(f"joint{number}" for number in range(1, count + 1))
        shared = None if part.is_bag else open_file(part.path, self._raw_mapping(part, robot, numbered), Names(), ())
        for number, one in enumerate(part.candidates):
            if one.pose or (one.width != count and len(one.joints) < count):
                continue
            source = SignalSource(unit="rad", **one.source)
            named = self._raw_mapping(part, robot, joints_of(one.joints, "", False, count), one.source)
            try:
                series = (shared or open_file(part.path, named, Names(), ("position",))).series("position", source)
            except InputError:
                continue
            usable = np.isfinite(series.values).all(axis=1) & np.isfinite(series.time)
            usable &= np.diff(series.time, prepend=-np.inf) > 0.0
            rows = np.flatnonzero(usable)[:MOST_SAMPLES]
            if rows.size > FEWEST_SAMPLES:
                part.series[number] = replace(series, time=series.time[rows], values=series.values[rows])

    def _windows(self, part: _Part, count: int) -> None:
        """Neighbouring columns without names; columns with names of a file that has but one signal."""
        names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
        numeric = [name for name in names if part.clock is None or name != part.clock.value]
        if not names or any(one.source.get("columns") for one in part.candidates):
            return
        if part.layout.header != 0 and part.path.suffix != ".npy":
            if len(numeric) == count and not any(one.width == count for one in part.candidates):
                label = f"{numeric[0]} … {numeric[-1]}"
                part.candidates.append(SignalCandidate(label, {"columns": numeric}, False, "", count))
            return
        part.candidates[:] = [one for one in part.candidates if "columns" not in one.source and one.width == 1]
        for start in range(len(numeric) - count + 1):
            own = numeric[start : start + count]
            part.candidates.append(SignalCandidate(f"{own[0]} … {own[-1]}", {"columns": own}, False, "", count))

    def _raw_mapping(
        self, part: _Part, robot: str, joints: tuple[str, ...], source: AbstractMapping[str, Any] | None = None
    ) -> Mapping:
        """A mapping by which a reader gives numbers as the file has them."""
        signals: dict[str, Any] = {name: {"unit": unit, **(source or {})} for name, unit in RAW_UNITS.items()}
        if robot == NO_ROBOT:
            parts = {"object_position": {"unit": "m"}, "object_quaternion": {"unit": "-"}}
            signals = parts if source is None else {"object_pose": {"unit": "m", **source}}
        return Mapping.model_validate(
            {"description": "raw", "robot": robot, "joints": joints, "time": self._clock_keys(part),
             "table": part.layout.model_dump(), "signals": signals}
        )  # fmt: skip

    def _signal(self, part: _Part, number: int, name: str, guess: Guess) -> dict[str, Any]:
        """Section of a signal, which is said."""
        source = self._source(part, dict(part.candidates[number].source))
        self._say(f"signals.{name}", part.candidates[number].label, "by its numbers; see unit")
        self._say(f"signals.{name}.unit", _flow(guess.value), guess.evidence, guess.sure)
        self._remarks += guess.remarks
        return {**source, "unit": guess.value, **guess.further}

    def _source(self, part: _Part, source: dict[str, Any]) -> dict[str, Any]:
        """With the file that it lies in, its own layout and stamps."""
        if self._groups.spread:
            source["file"] = part.pattern
        return source

    # ---- object -----------------------------------------------------------------------------------------------------

    def _object(self, joints: _Part, with_robot: bool, signals: dict[str, dict[str, Any]]) -> _Part | None:
        """Pose of an object, if there is one; it is added to the signals."""
        for part in sorted(self._parts, key=lambda one: one is joints and with_robot):
            for place, quaternion in self._poses(part, with_robot):
                found = self._pose_sections(part, place, quaternion)
                if found is None:
                    continue
                if part is not joints or not with_robot:
                    for section in found.values():
                        section |= self._own_layout(part, joints, with_robot)
                signals |= found
                return part
        return None if with_robot else self._ball(signals)

    def _ball(self, signals: dict[str, dict[str, Any]]) -> _Part | None:
        """Places of an object whose turn was not tracked, added to the signals; a ball may be one."""
        for part in self._parts:
            names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
            for columns in _axes(names)[0]:
                file = open_file(part.path, self._raw_mapping(part, NO_ROBOT, ()), Names(), ("object_position",))
                place = file.series("object_position", SignalSource(unit="m", columns=tuple(columns))).values
                length = unit_of_length(place)
                self._say("signals.object_position", ", ".join(columns), length.evidence)
                self._remarks.append(
                    "no column is its turn: only of a ball that is enough, with the spin that it had (body.spin)"
                )
                signals["object_position"] = {**self._source(part, {"columns": columns}), "unit": length.value}
                return part
        return None

    def _poses(self, part: _Part, with_robot: bool) -> list[tuple[dict[str, Any], dict[str, Any] | None]]:
        """Sources of a pose: of seven numbers alone, or of place and quaternion."""
        whole = [(one.source, None) for one in part.candidates if one.pose or one.width == 7 and not with_robot]
        vectors = {name: vector_width(cells) for name, cells in part.columns.items()}
        sources = {name: {"column": name} for name in vectors}
        for name, column in part.columns.items():  # arrays of an array file are no columns
            if isinstance(column, np.ndarray) and column.ndim == 2:
                vectors[name], sources[name] = column.shape[1], {"array": name}
        names = [name for name in vectors if not (with_robot and OF_THE_ROBOT.search(name))]
        groups = _axes(names)
        places = [sources[name] for name in names if vectors[name] == 3] + [{"columns": own} for own in groups[0]]
        turns = [sources[name] for name in names if vectors[name] == 4] + [{"columns": own} for own in groups[1]]
        pairs: list[tuple[dict[str, Any], dict[str, Any] | None]] = list(whole)
        pairs += list(zip(places, turns, strict=False))
        return pairs

    def _pose_sections(
        self, part: _Part, place: dict[str, Any], quaternion: dict[str, Any] | None
    ) -> dict[str, dict[str, Any]] | None:
        source = place if quaternion is None else None
        file = open_file(part.path, self._raw_mapping(part, NO_ROBOT, (), source), Names(), ("object_pose",))

        def numbers(name: SignalName, source: dict[str, Any]) -> Array | None:
            unit = "-" if name == "object_quaternion" else "m"
            try:
                return file.series(name, SignalSource.model_validate({"unit": unit, **source})).values
            except InputError:
                return None

        label = place.get("column") or place.get("array") or place.get("topic") or ", ".join(place.get("columns", ()))
        if quaternion is None:
            pose = numbers("object_pose", place)
            guess = None if pose is None else pose_of(pose)
            if guess is None:
                return None
            self._say("signals.object_pose", label, "holds a place and a unit quaternion")
            self._say("signals.object_pose.unit", guess.value, guess.evidence, guess.sure)
            return {"object_pose": {**self._source(part, dict(place)), "unit": guess.value, **guess.further}}
        where, turned = numbers("object_position", place), numbers("object_quaternion", quaternion)
        order = None if turned is None else quaternion_order(turned)
        if where is None or order is None:
            return None
        length = unit_of_length(where)
        if names := quaternion.get("columns"):
            order = Guess("wxyz" if names[0].lower().endswith("w") else "xyzw", "the names of its columns")
        further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
        self._say("signals.object_position", label, length.evidence)
        self._say("signals.object_quaternion", order.value, order.evidence, order.sure)
        return {
            "object_position": {**self._source(part, dict(place)), "unit": length.value},
            "object_quaternion": {**self._source(part, dict(quaternion)), "unit": "-", **further},
        }

    def _own_layout(self, part: _Part, joints: _Part, with_robot: bool) -> dict[str, Any]:
        """Layout and stamps of a file that are not those of the joints."""
        own: dict[str, Any] = {}
        if with_robot and part is not joints:
            if part.layout != joints.layout:
                own["table"] = part.layout.model_dump(exclude_none=True)
            if part.clock is not None and joints.clock is not None and part.clock.value != joints.clock.value:
                own["time_array" if part.path.suffix in ARRAY_SUFFIXES else "time_column"] = part.clock.value
        return own

    # ---- clock ------------------------------------------------------------------------------------------------------

    def _clock_keys(self, part: _Part) -> dict[str, Any]:
        """Section ``time`` of a part."""
        if self._wishes.rate is not None:
            return {"rate": self._wishes.rate}
        if not part.columns:
            return {}
        if part.clock is None:
            raise InputError(
                "no column holds time stamps: none increases at a rate of 1 Hz to 100 kHz; --rate says the sampling "
                "rate of files without stamps",
                file=part.path,
            )
        where = "array" if part.path.suffix in ARRAY_SUFFIXES else "column"
        return {where: part.clock.value, **part.clock.further}

    def _time(self, part: _Part) -> dict[str, Any]:
        keys = self._clock_keys(part)
        if self._wishes.rate is not None:
            self._say("time.rate", f"{self._wishes.rate:g}", "given with --rate")
        elif part.clock is not None:
            self._say("time", _flow(keys), part.clock.evidence, part.clock.sure)
            self._remarks += part.clock.remarks
            if part.clock.remarks and not self._wishes.dedupe:
                self._remarks.append("repeated stamps are refused; --dedupe keeps the first sample of each")
        if self._wishes.dedupe:
            keys["repeated"] = "keep_first"
            self._say("time.repeated", "keep_first", "given with --dedupe")
        return keys

    # ---- runs -------------------------------------------------------------------------------------------------------

    def _runs(self, mapping: Mapping) -> list[tuple[str, str, str]]:
        """Name, object and kind of every run."""
        objects = [] if self._wishes.scenario is None else list(load_scenario(self._wishes.scenario).objects)
        has_object = any(name.startswith("object") for name in mapping.signals)
        rows, missing = [], []
        for run in self._groups.runs:
            path = self._groups.folder / run
            if self._groups.spread:
                lacking = [kind for kind, files in self._groups.kinds.items() if run not in files]
                needed = {source.file for source in mapping.signals.values() if source.file is not None}
                if needed & set(lacking):
                    missing.append(f"{run} ({', '.join(sorted(needed & set(lacking)))})")
                    continue
            moves = has_object and _object_moves(path, mapping)
            if mapping.robot == NO_ROBOT:
                rows.append((run, "body", "hit"))
            else:
                named = [name for name in objects if name in str(path)]
                name = (named or objects or ["OBJECT"])[0] if moves else "none"
                rows.append((run, name, "hit" if moves else "free motion"))
        if missing:
            self._remarks.append(f"left out, for a file is missing: {'; '.join(missing)}")
        if has_object and mapping.robot != NO_ROBOT and any(kind == "hit" for _, _, kind in rows):
            self._say("kind in runs.csv", "hit", f"the object moves by more than {1e3 * MOVED:g} mm")
            if len(objects) != 1:
                self._say("object in runs.csv", _flow([row[1] for row in rows][:3]), "say which object was hit", False)
        return rows

    def _clock_of_object(
        self, mapping: Mapping, rows: Sequence[tuple[str, str, str]], signals: dict[str, dict[str, Any]]
    ) -> bool:
        """Give the object a clock of its own where it does not start to move when the arm hits; whether it was so."""
        names = [name for name in OBJECT if name in signals]
        hits = [run for run, _, kind in rows if kind == "hit"][:MOST_RUNS]
        seen = [_clocks_of(self._groups.folder / run, mapping) for run in hits] if names else []
        apart = [one for one in seen if one is not None]
        if 2 * len(apart) <= len(seen):
            return False
        middle = sorted(apart, key=lambda one: one.offset)[len(apart) // 2]
        said = f"{middle.evidence}; so in {len(apart)} of {len(seen)} runs that were looked at"
        for name in names:
            signals[name]["clock"] = "own"
            self._say(f"signals.{name}.clock", "own", said)
        return True

    def _experiment(self, facts: RobotFacts | None, robot: str) -> str:
        if facts is None:
            return BODY
        scenario = self._wishes.scenario
        if scenario is None:
            self._remarks.append(
                f"experiment.yaml names scenario.yaml, which is not there: impact-rs scenario new --robot {robot} -o "
                "scenario.yaml in the same folder, with masses and sizes of your objects and the place of the robot"
            )
        elif scenario.endswith((".yaml", ".yml")):
            scenario = os.path.relpath(scenario, self._output)
        return ARM.format(scenario=scenario or "scenario.yaml   # to be made, see docs/scenarios.md")

    def _try(self, mapping: Mapping, hits: int) -> None:
        """What the reader says of the first run."""
        first = self._groups.folder / self._groups.runs[0]
        try:
            if mapping.robot == NO_ROBOT or hits:
                wanted: list[SignalName] = list(mapping.signals)
                read = read_series(first, mapping, wanted, wanted, Names(run=run_name(self._groups.runs[0])))
                self._remarks += [remark for one in read.values() for remark in one.remarks]
                if mapping.robot != NO_ROBOT:
                    self._remarks += _doubts(read, mapping)
            else:
                target = self._groups.folder if self._groups.spread else first
                self._remarks += [remark for run in read_recordings(target, mapping)[:1] for remark in run.remarks]
        except InputError as error:
            self._remarks.append(f"the reader refuses the first run as it is described: {error}")

    def _say(self, key: str, value: str, evidence: str, sure: bool = True) -> None:
        self._lines.append(Line(key, value, evidence, sure))


HEAD = """\
# Where these recordings keep their signals, as impact-rs import found it. Behind every value stands what shows it;
# ASSUMED: nothing shows it, look at it before you trust a verdict. All keys: docs/your_data.md
"""
ARM = """\
# Runs with impacts; impact-rs compare, diagnose and impacts read this file. All keys: docs/your_data.md
scenario: {scenario}
mapping: mapping.yaml
runs: runs.csv
# motion_capture: {{estimate: true}}   # if the tracker's world is not the scenario's
"""
BODY = """\
# An object without a robot hits a fixed plane; impact-rs impacts reads this file. Fill in what the body is [kg, m].
mapping: mapping.yaml
runs: runs.csv
body:
  # mass: 0.37
  # size: [0.1, 0.1, 0.1]     # of a box; or of a ball: radius: 0.02, shell: true if it is hollow
  # spin: [0, 0, 0]           # of a ball whose turn was not tracked, before it hits [rad/s]
  # place: {position: [0, 0, 0], rpy: [0, 0, 0]}   # its centre and axes in the tracked frame
plane: {height: 0.0, normal: [0, 0, 1]}   # ASSUMED: where the plane is in the tracker's world
"""


def _object_moves(path: Path, mapping: Mapping) -> bool:
    """Whether the object's place changes; a run that cannot be read moves nothing."""
    name: SignalName = "object_pose" if "object_pose" in mapping.signals else "object_position"
    try:
        read = read_series(path, mapping, [name], [name], Names(run=run_name(path.name)))[name]
    except InputError:
        return False
    seen = read.values[np.isfinite(read.values).all(axis=1), :3]
    return bool(len(seen)) and float(np.max(np.linalg.norm(seen - np.median(seen[:5], axis=0), axis=1))) > MOVED


def _doubts(read: AbstractMapping[SignalName, Series], mapping: Mapping) -> list[str]:
    """What looks wrong in the joints of a run that hits something."""
    time = read["position"].time
    signals = {name: read[name].at(time) for name in REQUIRED if name in read}
    if "velocity" not in signals:
        signals["velocity"] = read["position"].derivative().values
    arm = ArmSignals(signals["position"], signals["velocity"], signals["torque"])
    model = RobotModel(mapping.facts, mapping.end_effector.build(), pin.SE3.Identity())
    return doubts_of_arm(time, arm, mapping, model, contact=True)


def _clocks_of(path: Path, mapping: Mapping) -> ClocksApart | None:
    """What shows that joints and object of a run have two clocks; None: nothing, or it cannot be read."""
    wanted: list[SignalName] = ["position", *(name for name in OBJECT if name in mapping.signals)]
    try:
        read = read_series(path, mapping, wanted, wanted, Names(run=run_name(path.name)))
    except InputError:
        return None
    position, pose = read["position"], read["object_pose" if "object_pose" in read else "object_position"]
    kept = np.isfinite(pose.values).all(axis=1)
    pose = replace(pose, time=pose.time[kept], values=pose.values[kept])
    return clocks_apart(pose, position, list(jumps_of(position, SMALLEST)), path) if kept.any() else None


def _axes(names: Sequence[str]) -> tuple[list[list[str]], list[list[str]]]:
    """Columns of places (x, y, z) and of quaternions, by what stands before or behind the letter."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for found in re.finditer(r"(?i)(?<![a-z])q?([xyzw])(?![a-z])|([xyzw])$", name):
            letter = (found[1] or found[2]).lower()
            groups.setdefault((name[: found.start()], name[found.end() :]), {}).setdefault(
                ("q" if found[0].lower().startswith("q") else "") + letter, name
            )
    places, turns = [], []
    for own in groups.values():
        plain = {letter: own[letter] for letter in own if not letter.startswith("q")}
        quaternion = {letter[-1]: own[letter] for letter in own if letter.startswith("q")}
        if set(plain) == set("xyzw"):
            quaternion = plain
        elif set("xyz") <= set(plain):
            places.append([plain[axis] for axis in AXES])
        if set(quaternion) == set("xyzw"):
            first = min(quaternion, key=lambda letter: list(names).index(quaternion[letter]))
            turns.append([quaternion[letter] for letter in QUATERNION[first == "w"]])
    return places, turns


def _si(guess: Guess, quantity: str) -> Array:
    units = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3, "m/s": 1.0, "mm/s": 1e-3}
    return np.array([units[unit] for unit in ([guess.value] if isinstance(guess.value, str) else guess.value)])


def _flow(value: Any) -> str:
    """A value in one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_flow(one) for one in value) + "]"
    if isinstance(value, str):
        return (
            value
            if re.fullmatch(r"[A-Za-z_][\w/. ]*", value) and value not in ("y", "n", "yes", "no")
            else json.dumps(value)
        )
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _yaml(content: AbstractMapping[str, Any], lines: Sequence[Line], head: str) -> str:
    """A mapping file with what shows its values."""
    said: dict[str, str] = {}
    for line in lines:
        said[line.key] = line.evidence if line.sure else f"ASSUMED: {line.evidence}"
    text = [head.rstrip()]
    for key, value in content.items():
        if key == "signals":
            text.append("signals:")
            for name, section in value.items():
                text.append(f"  {name}:{_remark(said.get(f'signals.{name}'))}")
                for inner, one in section.items():
                    text.append(f"    {inner}: {_flow(one)}{_remark(said.get(f'signals.{name}.{inner}'))}")
        else:
            text.append(f"{key}: {_flow(value)}{_remark(said.get(key) or said.get(f'{key}.rate'))}")
    return "\n".join(text) + "\n"


def _remark(said: str | None) -> str:
    return "" if said is None else f"   # {' '.join(said.split())}"


def _table(rows: Sequence[tuple[str, str, str]]) -> str:
    return "\n".join(["bag,object,kind", *(",".join(row) for row in rows)]) + "\n"
