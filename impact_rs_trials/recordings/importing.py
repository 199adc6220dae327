# SPDX-License-Identifier: Apache-2.0
"""From raw files to a mapping and an experiment file: every guess is written with what shows it.

Files are grouped into runs by their names (:mod:`file_groups`), tables are found in texts (:mod:`table_layout`), what
may be a signal is listed by names and widths (:mod:`candidates`), and numbers decide which it is (:mod:`guesses`).
Values that nothing shows are marked as assumed. Signals are read by the readers of the analysis, so what is guessed is
what is used.
"""

from __future__ import annotations

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
from impact_rs_trials.recordings.bag_file import read_topics
from impact_rs_trials.recordings.candidates import (
    MOST_BESIDE,
    PART_OF_ARM,
    SignalCandidate,
    candidates_of,
    joints_of,
    parts_of,
    single_candidates,
    vector_width,
    width_of,
)
from impact_rs_trials.recordings.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.file_groups import OBJECT, RUN_TABLE, FileGroups, group_files, recordings_in
from impact_rs_trials.recordings.guesses import (
    STAMP,
    Guess,
    are_derivatives,
    at_rest,
    clock_of,
    other_units,
    pose_of,
    quaternion_order,
    steps_back,
    unit_of_length,
)
from impact_rs_trials.recordings.hypotheses import DECISIVE, Choice, Hypothesis
from impact_rs_trials.recordings.import_checks import (
    FEWEST_SAMPLES,
    MOVED,
    clocks_of,
    doubt_of,
    doubts_of_hit,
    object_moves,
    usable_rows,
)
from impact_rs_trials.recordings.import_texts import (
    ARM,
    BODY,
    FoundRun,
    Line,
    PossibleReading,
    flow,
    mapping_text,
    runs_text,
)
from impact_rs_trials.recordings.inner_runs import RUN, run_column_of, run_groups_of, runs_of
from impact_rs_trials.recordings.joint_search import Alternative, Assignment, JointSearch, Reading
from impact_rs_trials.recordings.mapping import (
    NO_ROBOT,
    UNITS,
    Mapping,
    MountedEndEffector,
    SignalName,
    SignalSource,
    TableLayout,
)
from impact_rs_trials.recordings.moving_objects import moving_objects
from impact_rs_trials.recordings.read_once import files_read_once
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.series import Names
from impact_rs_trials.recordings.sources import (
    ARRAY_SUFFIXES,
    BAG_SUFFIXES,
    is_bag_folder,
    open_file,
    read_series,
    runs_inside,
)
from impact_rs_trials.recordings.streams import Stream
from impact_rs_trials.recordings.table_columns import read_columns, read_rows
from impact_rs_trials.recordings.table_layout import find_layout
from impact_rs_trials.recordings.torque_readings import (
    WHOLE_TORQUE,
    MotionTorque,
    leaves_little,
    order_of_joints,
)
from impact_rs_trials.recordings.transforms import are_transforms

MOST_SHOWN = 3  # signals of a kind in a message
MOST_POSES = 10
OF_THE_ROBOT = re.compile(r"eef|(^|_)ee(_|$)|tcp|tool|flange|hand", re.IGNORECASE)
OF_A_POSE = re.compile(
    r"pos(ition)?|place|trans(lation)?|rot(ation)?|quat(ernion)?|ori(entation)?|[pqrtwxyz]|xyz|xyzw|wxyz"
)
MOST_RUNS = 5  # whose clocks are looked at
AXES = ("x", "y", "z")
QUATERNION = (("x", "y", "z", "w"), ("w", "x", "y", "z"))
MOST_COMPARED = 10  # runs beside the first
NEAR = 0.5  # of the measured torque, rms, within which a torque that was asked for lies
PLAINLY = 2.0  # by which it is nearer with the arm's weight than without it, or the other way round
NO_HEADER = "its messages have no header: times at which the bag received them"
RAW_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m"}


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
        readings: By signal of the joints what it may be, what is taken first.
    """

    folder: Path
    texts: dict[str, str]
    lines: tuple[Line, ...]
    remarks: tuple[str, ...]
    hits: int
    runs: int
    readings: AbstractMapping[str, tuple[PossibleReading, ...]] = field(default_factory=dict)


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
    """One kind of file: its first one, with what it holds; of several runs inside of it the first."""

    pattern: str
    path: Path
    layout: TableLayout
    columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]
    candidates: list[SignalCandidate]
    clock: Guess | None
    streams: list[Stream] = field(default_factory=list)
    run: str = ""
    run_column: str | None = None
    on_log: bool = False  # times are those at which a bag received its messages

    @property
    def names(self) -> Names:
        """What the placeholders of a mapping stand for."""
        return Names(run=self.run or "*")

    @property
    def clock_columns(self) -> tuple[str, ...]:
        """Columns of the stamps."""
        value = () if self.clock is None else self.clock.value
        return (value,) if isinstance(value, str) else tuple(value)

    @property
    def stamps(self) -> str:
        """Where they are, for messages."""
        return "the messages" if self.clock is None else f"{flow(self.clock.value)} [{self.clock.further['unit']}]"

    @property
    def is_bag(self) -> bool:
        """Whether it is a bag, whose messages have stamps."""
        return is_bag_folder(self.path) or self.path.suffix in BAG_SUFFIXES


def _check_width(found: Assignment, part: _Part, robot: str, count: int) -> None:
    """Refuse a few joints of a wider arm: columns without names, beside which others are derivatives as well."""
    series = found.position.stream.series
    free = [name for name, cells in part.columns.items() if np.ndim(cells) == 1 and vector_width(cells) == 1]
    free = [name for name in free if name not in part.clock_columns]
    if found.velocity is None or not free or series.time.size != len(part.columns[free[0]]):
        return
    first, other = (_first_of(free, one.stream.candidate) for one in (found.position, found.velocity))
    if first is None or other is None or found.velocity.stream.file != part.pattern:
        return
    apart = other - first
    own, within = range(first, first + count), range(max(0, -apart), len(free) - max(0, apart))
    around = [n for n in range(first - abs(apart) + 1, first + abs(apart)) if n in within and n not in own]
    if not around:
        return
    values, raw = (
        np.column_stack([np.asarray(part.columns[free[n + shift]], dtype=float) for n in around])
        for shift in (0, apart)
    )
    shown = are_derivatives(series.time, values, raw)
    block = [*own, *(n for n, derivative in zip(around, shown, strict=True) if derivative)]
    if len(block) > count + MOST_BESIDE:
        blocks = " and ".join(f"{free[min(block) + shift]} … {free[max(block) + shift]}" for shift in (0, apart))
        raise InputError(
            f"columns {blocks} hold positions and velocities of {len(block)} joints, and {robot} has {count}: another "
            "--robot, or a mapping by hand that says which columns are its own (docs/your_data.md)",
            file=part.path,
        )


def draft_import(paths: Sequence[Path], output: Path, wishes: Wishes) -> ImportDraft:
    """Describe recordings.

    Args:
        paths: Files, bags, or folders of them.
        output: Folder of the description, from which paths of a robot are seen.
        wishes: What the user knows.

    Raises:
        InputError: They cannot be read, or something is missing that nothing shows; the message says what to add.
    """
    with files_read_once():
        return _Importer(group_files(recordings_in(paths)), output, wishes).draft()


class _Importer:
    """Collects guesses."""

    def __init__(self, groups: FileGroups, output: Path, wishes: Wishes) -> None:
        self._groups, self._output, self._wishes = groups, output, wishes
        self._lines: list[Line] = []
        self._remarks: list[str] = []
        self._refused: dict[str, str] = {}
        self._readings: dict[str, tuple[PossibleReading, ...]] = {}
        self._order_shown = "columns hold the joints from base to tip"
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
        if facts is None and pose_part is not None:
            self._refuse_several(pose_part, "objects without a robot", "object")
        clock = self._time(part if facts is not None else pose_part or part)
        content: dict[str, Any] = {
            "description": f"{self._groups.folder.name or 'recordings'}, as impact-rs import found it",
            "robot": robot if not robot.endswith((".yaml", ".yml")) else os.path.relpath(robot, self._output),
            **own,
            **({"time": clock} if clock else {}),
        }
        main = part if facts is not None else pose_part or part
        if main.layout != TableLayout():
            content["table"] = main.layout.model_dump(exclude_defaults=True)
        if main.run_column is not None:
            content["run_column"] = main.run_column
        content["signals"] = signals
        mapping = validate(Mapping, content | {"robot": robot}, self._output / "mapping.yaml")
        rows = self._runs(mapping)
        if facts is not None and self._clock_of_object(mapping, rows, signals):
            mapping = validate(Mapping, content | {"robot": robot}, self._output / "mapping.yaml")
        texts = {"mapping.yaml": mapping_text(content, self._lines), "runs.csv": runs_text(rows, facts is None)}
        hits = sum(row.hit for row in rows)
        if hits or facts is None or self._wishes.scenario is not None:
            texts["experiment.yaml"] = self._experiment(facts, robot)
        self._try(mapping, rows)
        if facts is not None:
            self._compare_runs(mapping, rows, facts)
        remarks = tuple(dict.fromkeys(self._remarks))
        return ImportDraft(self._groups.folder, texts, tuple(self._lines), remarks, hits, len(rows), self._readings)

    def _part(self, pattern: str, path: Path) -> _Part:
        layout = TableLayout()
        if is_bag_folder(path) or path.suffix in BAG_SUFFIXES:
            return _Part(pattern, path, layout, {}, candidates_of(path), None)
        if path.suffix in ARRAY_SUFFIXES:
            return self._part_of_arrays(pattern, path)
        if path.suffix not in (".parquet", ".npy"):
            found = find_layout(path)
            layout = found.layout
            self._lines.append(
                Line(f"table ({path.name})", flow(layout.model_dump(exclude_defaults=True)), found.evidence)
            )
        columns = read_columns(path, layout).cells
        run, column = "", None if self._groups.spread else run_column_of(columns)
        if column is not None:
            run = runs_of(columns[column])[0]
            self._say("run_column", column, "says of every row which of several runs it belongs to")
            columns = read_rows(path, layout, column, run).cells
        part = _Part(pattern, path, layout, columns, candidates_of(path, layout), clock_of(columns))
        return replace(part, run=run, run_column=column)

    def _part_of_arrays(self, pattern: str, path: Path) -> _Part:
        """A file of arrays; where groups of it are runs, those of the first, with ``{run}`` in their names."""
        columns, candidates = ArrayFile.arrays_of(path), candidates_of(path)
        groups, run = run_groups_of(columns), ""
        if groups is not None:
            listed = ", ".join(f"{groups.before}{name}" for name in groups.names[:MOST_SHOWN])
            if groups.recorded and not self._groups.spread:
                run = groups.names[0]
                columns = {new: own for name, own in columns.items() if (new := groups.with_placeholder(name))}
                named = [(one, groups.with_placeholder(one.source["array"])) for one in candidates]
                candidates = [replace(one, source={"array": new}, label=new) for one, new in named if new]
                self._say("{run}", listed, f"{len(groups.names)} groups hold the same arrays: each is a run")
            else:
                self._remarks.append(
                    f"{path.name}: groups {listed} hold arrays of the same names, and one of them is described; where "
                    f"they are runs, {RUN} in place of their name in every array and time.array of the mapping takes "
                    "all of them, with FILE/GROUP as bag in runs.csv"
                )
        return _Part(pattern, path, TableLayout(), columns, candidates, clock_of(columns), run=run)

    # ---- robot and joints -------------------------------------------------------------------------------------------

    def _robot(self) -> str:
        if self._wishes.robot is not None:
            self._say("robot", self._wishes.robot, "given with --robot")
            return self._wishes.robot
        known = sorted(path.stem for path in (config_directory() / "robots").glob("*.yaml"))
        texts = [text for part in self._parts for text in (part.path.parent.name, part.path.stem)]
        texts += [text for part in self._parts for one in part.candidates for text in (one.label, *one.joints)]
        words = set().union(*map(_runs_of_words, texts))
        named = [name for name in known if {name.replace("_", ""), name.partition("_")[2].replace("_", "")} & words]
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
        model = RobotModel(facts, MountedEndEffector().build(), pin.SE3.Identity())
        for part in self._parts:
            self._read(part, robot, facts.joint_count)
            self._settle_clock(part, model)
        search = JointSearch([stream for part in self._parts for stream in part.streams], model)
        found = self._assignment(search, robot)
        if (order := self._order(found, model)) is not None:
            search = JointSearch([stream.in_order(order) for stream in search.streams], model)
            found = self._assignment(search, robot)
        part = self._part_of(found.position.stream)
        _check_width(found, part, robot, facts.joint_count)
        self._check_torques(found, search, robot)
        self._remarks += [
            f"{label} is left out, for the reader refuses it: {why}" for label, why in self._refused.items()
        ]
        self._refuse_several(part, "joints", "robot")
        signals = {"position": self._joint_signal(found.position, "position", part, found.alternatives["position"])}
        if found.velocity is None:
            self._say(
                "signals.velocity", "none", "no signal is the derivative of the positions: velocities are made of them"
            )
        else:
            signals["velocity"] = self._joint_signal(found.velocity, "velocity", part, found.alternatives["velocity"])
        part.on_log = not found.position.stream.candidate.stamped
        own = {"joints": list(self._joints(found.position.stream.candidate, facts.joint_count))}
        own |= self._torque(found.torques, found.alternatives["torque"], facts, robot, signals, part)
        own |= self._commands(found, search, model, signals, part, "torque_constant" in own)
        return part, own, signals

    def _part_of(self, stream: Stream) -> _Part:
        """The file of a stream."""
        return next(part for part in self._parts if part.pattern == stream.file)

    def _assignment(self, search: JointSearch, robot: str) -> Assignment:
        """The likeliest assignment of streams to the roles of the joints."""
        facts = search.model.facts
        self._check_motion([place for place in search.places if place.by_name > 0.0], facts)
        motions = search.motions()
        if not motions and self._wishes.rate is not None:
            self._check_rate(self._wishes.rate, search)
        if not motions and not any(stream.log_prior("velocity") > 0.0 for stream in search.streams):
            motions = search.without_velocity()
        if not motions:
            raise self._nothing(search.streams, robot, facts.joint_count)
        found = search.best(motions)
        self._check_motion([found.position], facts)
        return found

    def _check_torques(self, found: Assignment, search: JointSearch, robot: str) -> None:
        """Refuse a recording without a torque that a mapping could take."""
        path = self._part_of(found.position.stream).path
        if not found.torques and found.weightless:
            label, why = next(iter(found.weightless.items()))
            raise InputError(f"{label} {why}. {WHOLE_TORQUE}", file=path, key="signals.torque")
        if not found.torques:
            copies = [f"{label} {copied}" for label, copied in found.copies.items()]
            repeated = f" ({'; '.join(copies)})" if copies else ""
            seen = "; ".join(stream.label for stream in search.streams)
            raise InputError(
                f"nothing goes with the torque that weight and inertia of {robot} take in this motion, and a mapping "
                f"needs torques or currents; signals as wide as its joints: {seen}{repeated}. Another --robot, or a "
                "mapping by hand (docs/your_data.md)",
                file=path,
            )

    def _order(self, found: Assignment, model: RobotModel) -> tuple[int, ...] | None:
        """Order in which columns without names go with the torque of the arm; None: as they stand."""
        one = found.position.stream
        if one.is_cut or one.candidate.joints or PART_OF_ARM.search(one.candidate.label):
            return None
        time, q, dq = found.time, found.position.values, found.speeds
        for torque in found.torques[:MOST_SHOWN]:
            constant, raw = torque.best.further.get("torque_constant"), torque.stream.series.at(time)
            if constant is not None and leaves_little(MotionTorque.of(time, q, dq, raw * np.array(constant), model)):
                continue  # currents; else a torque in a wrong order, of which no unit fits
            units = [torque.best.unit] if isinstance(torque.best.unit, str) else torque.best.unit
            factor = np.array([UNITS["torque"][unit] for unit in units])
            if (ordered := order_of_joints(MotionTorque.of(time, q, dq, factor * raw, model))) is not None:
                order, self._order_shown = ordered
                return order
        return None

    def _check_motion(self, places: Sequence[Reading], facts: RobotFacts) -> None:
        """Refuse an arm that does not move, of which noise would be taken for velocity and torque."""
        found = [at_rest(one.stream.series.time, one.values, facts) for one in places]
        if found and None not in found:
            stream = places[0].stream
            raise InputError(f"{stream.label}: {found[0]}", file=self._part_of(stream).path)

    def _refuse_several(self, part: _Part, what: str, whose: str) -> None:
        """Files that differ in a word are of objects that a robot hits, and of nothing else."""
        if OBJECT in part.pattern:
            named = ", ".join(sorted(set(self._groups.objects.values())))
            said = f"files {part.pattern} hold {what}, of {named}: import the runs of each {whose} by themselves"
            raise InputError(said, file=part.path)

    def _nothing(self, every: Sequence[Stream], robot: str, count: int) -> InputError:
        """What is said where no signal is the motion of the joints."""
        said = f"no signal of {_joints_of(count)} can be read"
        if every:
            said = (
                f"no two signals of {_joints_of(count)} are positions within the limits of {robot} and their "
                f"derivative; signals as wide as that: {'; '.join(one.label for one in every)}"
            )
        others = [
            one.label for part in self._parts for one in part.candidates if not one.pose and one.width not in (1, count)
        ]
        said += f"; signals of other widths: {', '.join(others[:MOST_SHOWN])}" if others else ""
        said += "".join(f"; the reader refuses {why}" for why in self._refusals())
        backwards = [back for part in self._parts if (back := steps_back(part.columns)) is not None]
        said += "".join(f"; {back}, so another clock was taken" for back in backwards)
        remedy = "Another --robot, or a mapping by hand" if every else "A mapping by hand"
        return InputError(f"{said}. {remedy} (docs/your_data.md)", file=self._parts[0].path)

    def _refusals(self) -> list[str]:
        """Signals that the reader refuses, with its reason."""
        by_reason: dict[str, list[str]] = {}
        for label, why in self._refused.items():
            by_reason.setdefault(why, []).append(label)
        return [f"{', '.join(labels[:MOST_SHOWN])}: {why}" for why, labels in by_reason.items()]

    def _check_rate(self, rate: float, search: JointSearch) -> None:
        """Refuse a sampling rate at which a velocity would be that of another one."""
        for place, other, factor in search.velocities_at_other_rates():
            real = rate * factor
            raise InputError(
                f"{other.label} is {factor:.3g} times the derivative of {place.label} in all joints, which is a "
                f"velocity in rad/s at {real:.4g} Hz, in deg/s at {real * np.pi / 180.0:.4g} Hz",
                key="--rate",
                value=f"{rate:g}",
            )

    def _torque(
        self, found: Sequence[Reading], listed: Sequence[Alternative], facts: RobotFacts, robot: str,
        signals: dict[str, dict[str, Any]], part: _Part,
    ) -> dict[str, Any]:  # fmt: skip
        """The torque of the joints, which is added to the signals; keys of the mapping that go with it."""
        best, *others = found
        free = [other for other in others if not (part.is_bag and other.stream.candidate.guess == "command")]
        computed = (
            "follows the model of the arm without any friction of its gears: a controller or a simulation computed it"
        )
        self._remarks += [
            f"{other.stream.label} is left out: it {computed}" for other in free if other.computed and not best.computed
        ]
        if best.computed:
            self._remarks.append(
                f"{best.stream.label} {computed}, so nothing that the model lacks, as a load, can show in it. Take the "
                "measured torque or the motor currents"
            )
        alike = "; ".join(other.stream.label for other in free if other.computed == best.computed)
        constant = best.best.further.get("torque_constant")
        signals["torque"] = self._joint_signal(best, "torque", part, listed, alike)
        at_motor = constant is not None or not facts.joint_torque_loop
        said = "currents are those of motors" if constant is not None else f"joint_torque_loop of {robot} is "
        said += "" if constant is not None else str(facts.joint_torque_loop).lower()
        self._say("torque_measured_at", "motor" if at_motor else "link", said, sure=constant is not None)
        own: dict[str, Any] = {"torque_measured_at": "motor" if at_motor else "link"}
        if constant is not None:
            self._say(
                "torque_constant", flow(constant), "by the weight in this recording; take those of a data sheet", False
            )
            own["torque_constant"] = constant
        return own

    def _commands(
        self, found: Assignment, search: JointSearch, model: RobotModel, signals: dict[str, dict[str, Any]],
        part: _Part, currents: bool,
    ) -> dict[str, Any]:  # fmt: skip
        """The commanded torque of a bag, which is added to the signals; keys of the mapping that go with it."""
        taken = [one.stream for one in (found.position, found.velocity, found.torques[0]) if one is not None]
        free = [one for one in search.streams if not any(one.stands_apart(other) for other in taken)]
        asked = [one for one in free if one.candidate.guess == "command" and self._part_of(one).is_bag]
        copied = [one for one in asked if one.label in found.copies]
        self._remarks += [f"{one.label} is left out: it {found.copies[one.label]}" for one in copied]
        commands = [one for one in asked if one not in copied]
        if commands and currents:
            why = "nothing but currents was measured beside it"
            self._remarks += [f"{one.label} is left out: {why}" for one in commands]
            return {}
        return self._command(found, commands, model, signals, part) if commands else {}

    def _command(
        self, found: Assignment, asked: Sequence[Stream], model: RobotModel,
        signals: dict[str, dict[str, Any]], part: _Part,
    ) -> dict[str, Any]:  # fmt: skip
        """The torque that was asked for, which is added to the signals, by how near it is to the measured one."""
        time, q = found.time, found.position.values
        series = found.torques[0].stream.series
        torque = replace(series, values=found.torques[0].values).at(time)
        weight = np.array([model.gravity_torque(row) for row in q])
        size = max(float(np.sqrt(np.mean(np.square(torque)))), 1e-12)

        def apart(one: Stream, missing: Array | float) -> float:
            """How far from the measured torque, over that torque, rms."""
            return float(np.sqrt(np.mean(np.square(one.series.at(time) + missing - torque)))) / size

        tried = [(apart(one, 0.0), apart(one, weight), one) for one in asked]
        taken = min(tried, key=lambda one: min(one[:2]))
        for alone, lifted, one in tried:
            if one is not taken[2] or min(alone, lifted) > NEAR:
                far = f"{100.0 * min(alone, lifted):.0f} % of the measured torque away from it"
                self._remarks.append(f"{one.label} is left out: by its name it was asked for, and it is {far}")
        alone, lifted, one = taken
        if min(alone, lifted) > NEAR:
            return {}
        included, both = alone <= lifted, f"{100.0 * alone:.0f} % of the measured torque away from it as it is"
        said = f"{both}, {100.0 * lifted:.0f} % with the arm's weight added (rms)"
        command = Reading(one, Choice(Hypothesis("torque", "N m", said, 0.0), None, np.inf))
        signals["command"] = self._joint_signal(command, "command", part)
        sure = max(alone, lifted) > PLAINLY * min(alone, lifted)
        said = f"it is nearer to the measured torque {'as it is' if included else 'with the weight of the arm added'}"
        self._say("command_includes_gravity", str(included).lower(), said, sure)
        return {"command_includes_gravity": included}

    def _joint_signal(
        self, one: Reading, name: str, main: _Part, others: Sequence[Alternative] = (), alike: str = ""
    ) -> dict[str, Any]:
        """Section of a signal of the joints, which is said, with the layout of its file where that is another one.

        Args:
            one: The stream with its unit.
            name: The signal.
            main: File of the positions.
            others: What the signal may be, what is taken first.
            alike: Streams that fit the role as well, of which names do not say more.
        """
        part, candidate, best = self._part_of(one.stream), one.stream.candidate, one.best
        shown = "by its numbers; see unit"
        if one.stream.is_cut:
            shown += "; what stands beside the joints is left out, as a gripper"
            self._remarks.append(f"signals.{name}: of {candidate.label} numbers are taken for the joints")
        rival = next((other for other in others if other.stream is not one.stream), None)
        margin = np.inf if rival is None else others[0].log_posterior - rival.log_posterior
        if rival is not None and margin < DECISIVE:
            shown += f"; next: {rival.stream.label}, log odds {margin:.2g}"
        shown += "" if candidate.stamped else f"; {NO_HEADER}"
        self._say(f"signals.{name}", candidate.label, shown, not one.stream.is_cut and bool(margin > DECISIVE))
        said = one.choice.evidence + (f"; so do {alike}: take the one that was measured" if alike else "")
        sure = one.choice.sure and not alike and not one.computed and best.role != "current"
        self._say(f"signals.{name}.unit", flow(best.unit), said, sure)
        self._remarks += best.remarks
        self._readings[name] = tuple(
            PossibleReading(
                other.stream.label, dict(other.stream.candidate.source), other.hypothesis.unit,
                float(others[0].log_posterior - other.log_posterior), other.hypothesis.evidence,
            )
            for other in others
        )  # fmt: skip
        further = {key: value for key, value in best.further.items() if key == "factor"}
        source = {**self._source(part, dict(candidate.source)), "unit": best.unit, **further}
        return source | self._own_layout(part, main, True)

    def _joints(self, one: SignalCandidate, count: int) -> tuple[str, ...]:
        joints = joints_of(one.joints, "", False, count)
        if one.joints:
            self._say("joints", flow(list(joints)), "the recording names them")
        else:
            self._say("joints", flow(list(joints)), self._order_shown, sure=False)
        return joints

    def _read(self, part: _Part, robot: str, count: int) -> None:
        """Raw numbers of all candidates that are as wide as the robot has joints."""
        self._windows(part, count)
        if count == 1 and part.layout.header != 0:
            key = "array" if part.path.suffix in ARRAY_SUFFIXES else "column"
            columns = {name: own for name, own in part.columns.items() if name not in part.clock_columns}
            part.candidates += single_candidates(columns, key)
        part.candidates += [own for one in part.candidates for own in parts_of(one, count)]
        numbered = tuple(f"joint{number}" for number in range(1, count + 1))
        shared = None if part.is_bag else open_file(part.path, self._raw_mapping(part, robot, numbered), part.names, ())
        if part.is_bag:
            read_topics(part.path, {one.source["topic"] for one in part.candidates})
        for one in part.candidates:
            if one.pose or (one.width != count and len(one.joints) < count):
                continue
            source = SignalSource(unit="rad", **one.source)
            named = self._raw_mapping(part, robot, joints_of(one.joints, "", False, count), one.source)
            if not one.stamped:
                named = named.model_copy(update={"time": named.time.model_copy(update={"stamp": "log"})})
            try:
                series = (shared or open_file(part.path, named, part.names, ("position",))).series("position", source)
            except InputError as error:
                self._refused[one.label] = str(error)
                continue
            rows = usable_rows(series)
            if rows.size > FEWEST_SAMPLES:
                kept = replace(series, time=series.time[rows], values=series.values[rows])
                part.streams.append(Stream(part.pattern, one, kept))
            else:
                self._refused[one.label] = (
                    f"{rows.size} of {series.time.size} samples have numbers and a later stamp than all before, "
                    f"more than {FEWEST_SAMPLES} are needed; stamps were taken from {part.stamps}, the key time of a "
                    "mapping names others, or a rate"
                )
        self._put_on_stamps(part)

    def _put_on_stamps(self, part: _Part) -> None:
        """Put signals without stamps on the clock of the others, as the reader does."""
        stamped = [one.series for one in part.streams if one.candidate.stamped]
        shifts = [float(np.median(one.log - one.time)) for one in stamped if one.log is not None]
        if shifts:
            part.streams = [
                one
                if one.candidate.stamped
                else replace(one, series=replace(one.series, time=one.series.time - shifts[0]))
                for one in part.streams
            ]

    def _settle_clock(self, part: _Part, model: RobotModel) -> None:
        """Give stamps whose unit nothing else shows the one in which positions and velocities are the likeliest."""
        clock = part.clock
        if clock is None or clock.sure or self._wishes.rate is not None:
            return
        assumed, stamps = UNITS["time"][clock.further["unit"]], np.asarray(part.columns[clock.value], dtype=float)
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
        said = f"increases; in {unit}, {rate:.4g} Hz, {speed} is the derivative of {place}"
        margin = tried[0][0] - tried[1][0] if len(tried) > 1 else np.inf
        said += "" if margin > DECISIVE else f"; next: {tried[1][1]}, log odds {margin:.2g}"
        part.clock = replace(clock, evidence=said, sure=bool(margin > DECISIVE), further={"unit": unit})
        part.streams = streams

    def _windows(self, part: _Part, count: int) -> None:
        """Neighbouring columns without names; columns with names of a file that has but one signal."""
        names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
        numeric = [name for name in names if name not in part.clock_columns]
        if not names or any(one.source.get("columns") for one in part.candidates):
            return
        if part.layout.header != 0 and part.path.suffix != ".npy":
            if (
                len(numeric) == count
                and not _axes(numeric)[1]
                and not any(one.width == count for one in part.candidates)
            ):
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
             "table": part.layout.model_dump(), "run_column": part.run_column, "signals": signals}
        )  # fmt: skip

    def _source(self, part: _Part, source: dict[str, Any]) -> dict[str, Any]:
        """With the file that it lies in, its own layout and stamps."""
        if self._groups.spread:
            source["file"] = part.pattern
        return source

    # ---- object -----------------------------------------------------------------------------------------------------

    def _object(self, joints: _Part, with_robot: bool, signals: dict[str, dict[str, Any]]) -> _Part | None:
        """Pose of an object, if there is one; it is added to the signals."""
        for part in sorted(self._parts, key=lambda one: one is joints and with_robot):
            for place, quaternion, named in self._poses(part, with_robot):
                found = self._pose_sections(part, place, quaternion, named)
                if found is None:
                    continue
                if with_robot and self._groups.spread:
                    self._choose_objects(part, found)
                self._say_other_poses(part, place)
                if part is not joints or not with_robot:
                    for section in found.values():
                        section |= self._own_layout(part, joints, with_robot)
                signals |= found
                return part
        return None if with_robot else self._ball(signals)

    def _say_other_poses(self, part: _Part, taken: dict[str, Any]) -> None:
        """Arrays and topics that may be poses as well, of which none is taken."""
        others = [one.label for one in part.candidates if one.pose and one.source != taken]
        if others:
            self._remarks.append(
                f"{part.path.name} holds other poses, of which none is taken: {', '.join(others[:MOST_POSES])}"
                + (f" and {len(others) - MOST_POSES} more" if len(others) > MOST_POSES else "")
            )

    def _choose_objects(self, part: _Part, sections: dict[str, dict[str, Any]]) -> None:
        """Where every run has a file of each of several objects, take that of the object which moves in the run."""
        sources = {name: SignalSource.model_validate(section) for name, section in sections.items()}
        mapping = self._raw_mapping(part, NO_ROBOT, ()).model_copy(update={"signals": sources})
        found = moving_objects(self._groups, part.pattern, mapping)
        if found is None:
            return
        self._groups = found.groups
        for section in sections.values():
            section["file"] = found.pattern
        self._say(f"{OBJECT} of {found.pattern}", flow(list(found.objects)), "in every run the object that moves most")

    def _ball(self, signals: dict[str, dict[str, Any]]) -> _Part | None:
        """Places of an object whose turn was not tracked, added to the signals; a ball may be one."""
        for part in self._parts:
            names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
            for columns in _axes(names)[0]:
                file = open_file(part.path, self._raw_mapping(part, NO_ROBOT, ()), part.names, ("object_position",))
                place = file.series("object_position", SignalSource(unit="m", columns=tuple(columns))).values
                length = unit_of_length(place)
                self._say("signals.object_position", ", ".join(columns), length.evidence)
                self._remarks.append(
                    "no column is its turn: only of a ball that is enough, with the spin that it had (body.spin)"
                )
                signals["object_position"] = {**self._source(part, {"columns": columns}), "unit": length.value}
                return part
        return None

    def _poses(self, part: _Part, with_robot: bool) -> list[tuple[dict[str, Any], dict[str, Any] | None, bool]]:
        """Sources of a pose: of seven numbers alone, or of position and quaternion, and whether names pair these."""
        whole = [(one.source, None, True) for one in part.candidates if one.pose or one.width == 7 and not with_robot]
        vectors = {name: vector_width(cells) for name, cells in part.columns.items()}
        sources = {name: {"column": name} for name in vectors}
        for name, column in part.columns.items():  # arrays of an array file are no columns
            if isinstance(column, np.ndarray) and column.ndim == 2:
                vectors[name], sources[name] = width_of(column.shape), {"array": name}
        names = [name for name in vectors if not (with_robot and OF_THE_ROBOT.search(name))]
        groups = _axes(names)
        places = [sources[name] for name in names if vectors[name] == 3] + [{"columns": own} for own in groups[0]]
        turns = [sources[name] for name in names if vectors[name] == 4] + [{"columns": own} for own in groups[1]]
        return [*whole, *_paired(places, turns)]

    def _pose_sections(
        self, part: _Part, place: dict[str, Any], quaternion: dict[str, Any] | None, named: bool
    ) -> dict[str, dict[str, Any]] | None:
        source = place if quaternion is None else None
        file = open_file(part.path, self._raw_mapping(part, NO_ROBOT, (), source), part.names, ("object_pose",))

        def numbers(name: SignalName, source: dict[str, Any]) -> Array | None:
            unit = "-" if name == "object_quaternion" else "m"
            try:
                return file.series(name, SignalSource.model_validate({"unit": unit, **source})).values
            except InputError:
                return None

        label = place.get("column") or place.get("array") or place.get("topic") or ", ".join(place.get("columns", ()))
        if quaternion is None:
            pose = numbers("object_pose", place)
            matrices = are_transforms(np.shape(part.columns.get(place.get("array", ""), ())))
            guess = None if pose is None else pose_of(pose)
            if guess is None or pose is None:
                return None
            if matrices:
                length = unit_of_length(pose)
                guess = Guess(length.value, length.evidence)
            said = "holds homogeneous matrices" if matrices else "holds a place and a unit quaternion"
            self._say("signals.object_pose", label, said)
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
        turned_label = quaternion.get("column") or quaternion.get("array") or ", ".join(names or ())
        by_order = (
            "" if named else f"; taken for the position of the body that {turned_label} turns, by their order alone"
        )
        self._say("signals.object_position", label, f"{length.evidence}{by_order}", named)
        self._say("signals.object_quaternion", order.value, order.evidence, order.sure and named)
        return {
            "object_position": {**self._source(part, dict(place)), "unit": length.value},
            "object_quaternion": {**self._source(part, dict(quaternion)), "unit": "-", **further},
        }

    def _own_layout(self, part: _Part, joints: _Part, with_robot: bool) -> dict[str, Any]:
        """Layout and stamps of a file that are not those of the joints."""
        own: dict[str, Any] = {}
        if with_robot and part is not joints:
            if part.layout != joints.layout:
                own["table"] = part.layout.model_dump(exclude_defaults=True)
            if part.clock is not None and joints.clock is not None and part.clock.value != joints.clock.value:
                own["time_array" if part.path.suffix in ARRAY_SUFFIXES else "time_column"] = part.clock.value
        return own

    # ---- clock ------------------------------------------------------------------------------------------------------

    def _clock_keys(self, part: _Part) -> dict[str, Any]:
        """Section ``time`` of a part."""
        if self._wishes.rate is not None:
            return {"rate": self._wishes.rate}
        if not part.columns:
            return {"stamp": "log"} if part.on_log else {}
        if part.clock is None:
            if (back := steps_back(part.columns)) is not None:
                said = f"{back}; sort the rows by time, or cut the recording there into several"
                raise InputError(said, file=part.path)
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
        elif part.on_log:
            self._say("time", flow(keys), f"of the positions: {NO_HEADER}")
        elif part.clock is not None:
            self._say("time", flow(keys), part.clock.evidence, part.clock.sure)
            self._remarks += part.clock.remarks
            if not any(STAMP.search(name) for name in part.clock_columns) and (back := steps_back(part.columns)):
                self._remarks.append(f"{back}; {flow(part.clock.value)} is taken for the clock in its place")
            if part.clock.remarks and not self._wishes.dedupe:
                self._remarks.append("repeated stamps are refused; --dedupe keeps the first sample of each")
        if self._wishes.dedupe:
            keys["repeated"] = "keep_first"
            self._say("time.repeated", "keep_first", "given with --dedupe")
        return keys

    # ---- runs -------------------------------------------------------------------------------------------------------

    def _runs(self, mapping: Mapping) -> list[FoundRun]:
        """Every run that the reader takes; the others are said."""
        groups = self._groups
        has_object = any(name.startswith("object") for name in mapping.signals)
        needed = {source.file for source in mapping.signals.values() if source.file is not None}
        objects = groups.objects if any(OBJECT in file for file in needed) else {}
        rows, missing = [], []
        for run, session in self._named_runs(mapping):
            lacking = needed & {kind for kind, files in groups.kinds.items() if groups.spread and run not in files}
            if lacking:
                missing.append(f"{run} ({', '.join(sorted(lacking))})")
                continue
            row = FoundRun(run, objects.get(run, ""), session)
            try:
                moves = has_object and object_moves(groups.folder / run, mapping, row.names)
            except InputError as error:
                self._remarks.append(f"{run} is left out, for the reader refuses it: {error}")
                continue
            rows.append(replace(row, hit=moves or mapping.robot == NO_ROBOT))
        if missing:
            self._remarks.append(f"left out, for a file is missing: {'; '.join(missing)}")
        if not rows:
            raise InputError(f"no run has all of its files: {'; '.join(missing)}", file=groups.folder)
        self._say_unread(needed)
        if (groups.folder / RUN_TABLE).is_file():
            self._remarks.append(
                f"{groups.folder / RUN_TABLE} says what each run is, and is used before the one made here"
            )
        if groups.sessions:
            self._say(
                "session in runs.csv", flow(list(dict.fromkeys(groups.sessions.values()))),
                "the folders that runs lie in; impacts makes a column of it, for --covariates session",
            )  # fmt: skip
        if has_object and mapping.robot != NO_ROBOT and any(row.hit for row in rows):
            self._say("kind in runs.csv", "hit", f"the object moves by more than {1e3 * MOVED:g} mm")
            rows = self._with_objects(rows)
        return rows

    def _named_runs(self, mapping: Mapping) -> Iterator[tuple[str, str]]:
        """All runs, also those inside of files, and their sessions."""
        for run in self._groups.runs:
            session = self._groups.sessions.get(run, "")
            if not mapping.holds_runs or self._groups.spread:
                yield run, session
                continue
            try:
                inside = runs_inside(self._groups.folder / run, mapping)
            except InputError as error:
                self._remarks.append(f"{run} is left out, for the reader refuses it: {error}")
                continue
            yield from ((str(path.relative_to(self._groups.folder)), session) for path in inside)

    def _say_unread(self, needed: set[str]) -> None:
        """Files that hold no signal of the mapping."""
        unread = [kind for kind in self._groups.kinds if self._groups.spread and kind not in needed]
        names = [*unread, *(str(path.relative_to(self._groups.folder)) for path in self._groups.left_out)]
        if names:
            self._remarks.append(f"not read, for the mapping takes no signal from them: {', '.join(names)}")

    def _with_objects(self, rows: list[FoundRun]) -> list[FoundRun]:
        """Rows with the object that was hit."""
        objects = [] if self._wishes.scenario is None else list(load_scenario(self._wishes.scenario).objects)
        if named := list(dict.fromkeys(row.object for row in rows if row.object)):
            self._say("object in runs.csv", flow(named), "the names of the files say which")
            if objects and not set(named) <= set(objects):
                self._remarks.append(
                    f"files call the objects {', '.join(named)}, {self._wishes.scenario} has {', '.join(objects)}: "
                    "the objects of the scenario need the names that stand in the files"
                )
            return rows
        path = [str(self._groups.folder / row.run) for row in rows]
        inside = [next((name for name in objects if name in one), "") for one in path]
        usual = (objects or ["OBJECT"])[0]
        rows = [replace(row, object=one or usual) for row, one in zip(rows, inside, strict=True)]
        if len(objects) != 1:
            self._say("object in runs.csv", flow([row.object for row in rows][:3]), "say which object was hit", False)
        return rows

    def _clock_of_object(self, mapping: Mapping, rows: Sequence[FoundRun], signals: dict[str, dict[str, Any]]) -> bool:
        """Give the object a clock of its own where it does not start to move when the arm hits; whether it was so."""
        names = [name for name in OBJECT_SIGNALS if name in signals]
        hits = [row for row in rows if row.hit][:MOST_RUNS]
        seen = [clocks_of(self._groups.folder / row.run, mapping, row.names) for row in hits] if names else []
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
            return ARM.format(scenario="scenario.yaml   # to be made, see docs/scenarios.md")
        if scenario.endswith((".yaml", ".yml")):
            scenario = os.path.relpath(scenario, self._output)
        return ARM.format(scenario=flow(scenario))

    def _try(self, mapping: Mapping, rows: Sequence[FoundRun]) -> None:
        """What the reader says of the first run."""
        row = next((row for row in rows if row.hit), rows[0])
        path = self._groups.folder / row.run
        try:
            if mapping.robot == NO_ROBOT or row.hit:
                wanted: list[SignalName] = list(mapping.signals)
                read = read_series(path, mapping, wanted, wanted, row.names)
                self._remarks += [remark for one in read.values() for remark in one.remarks]
                if mapping.robot != NO_ROBOT:
                    self._remarks += doubts_of_hit(read, mapping)
            else:
                target = path if path.exists() or path.parent.is_file() else path.parent
                self._remarks += [remark for run in read_recordings(target, mapping)[:1] for remark in run.remarks]
        except InputError as error:
            self._remarks.append(f"the reader refuses {row.run} as it is described: {error}")

    def _compare_runs(self, mapping: Mapping, rows: Sequence[FoundRun], facts: RobotFacts) -> None:
        """Units and signs of other runs than the first, which the description was made of."""
        first, *others = rows
        numbers = np.unique(np.linspace(0, len(others) - 1, min(MOST_COMPARED, len(others))).astype(int))
        model = RobotModel(facts, MountedEndEffector().build(), pin.SE3.Identity())
        apart = 0
        for row in (others[number] for number in numbers):
            try:
                doubt = doubt_of(self._groups.folder / row.run, mapping, row.names, model)
            except InputError as error:
                doubt = f"the reader refuses it: {error}"
            if doubt is not None:
                apart += 1
                self._remarks.append(
                    f"{row.run} is not as {first.run}, of which the description was made: {doubt}; describe it by "
                    "itself, or take it out of runs.csv"
                )
        if others and not apart:
            said = (
                f"units and signs of {first.run} hold in {len(numbers)} other{'s' if len(numbers) > 1 else ''} as well"
            )
            self._say("runs", f"{len(numbers)} of {len(others)} others", said)

    def _say(self, key: str, value: str, evidence: str, sure: bool = True) -> None:
        self._lines.append(Line(key, value, evidence, sure))


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


def _first_of(names: Sequence[str], candidate: SignalCandidate) -> int | None:
    """Number of the first of a signal's columns, where these stand side by side; None: they do not."""
    own = candidate.source.get("columns") or []
    first = names.index(own[0]) if own and own[0] in names else None
    return first if first is not None and list(names[first : first + len(own)]) == list(own) else None


def _runs_of_words(text: str) -> set[str]:
    """Words of a text, and up to three neighbours joined: ``xarm 6`` and ``xarm_6`` hold ``xarm6``."""
    words = re.findall(r"[a-z0-9]+", text.lower())
    return {"".join(words[first : first + count]) for first in range(len(words)) for count in (1, 2, 3)}


def _joints_of(count: int) -> str:
    return f"{count} joint{'s' if count > 1 else ''}"


def _paired(
    places: Sequence[dict[str, Any]], turns: Sequence[dict[str, Any]]
) -> Iterator[tuple[dict[str, Any], dict[str, Any], bool]]:
    """Positions and quaternions of one body: those whose names agree, then the others by their order; which it was."""
    free = list(turns)
    left = []
    for place in places:
        own = next((turn for turn in free if _body_of(turn) == _body_of(place)), None)
        if own is None:
            left.append(place)
        else:
            free.remove(own)
            yield place, own, True
    alone = len(places) == len(turns) == 1
    yield from ((place, turn, alone) for place, turn in zip(left, free, strict=False))


def _body_of(source: dict[str, Any]) -> tuple[str, ...]:
    """What a name says besides that it is a position or a quaternion: which body."""
    columns = source.get("columns") or [source.get("column") or source.get("array") or ""]
    words = [re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", name) for name in columns]
    common = [word.lower() for word in words[0] if all(word in other for other in words)]
    return tuple(word for word in common if not OF_A_POSE.fullmatch(word))
