# SPDX-License-Identifier: Apache-2.0
"""From raw files to a mapping and an experiment file, in which every value has its evidence.

    file_groups       files into runs by their names
    recorded_files    layout, candidates, clock and raw numbers of each kind of file, read once (read_once)
    joint_search      the likeliest assignment of streams to the roles of the joints (hypotheses)
    joint_sections    sections of the mapping for the joints,
    object_sections   sections for the pose of an object, which does not move with the tip of the robot (flange_path)
    described_runs    the runs, read with the mapping, and contradictions to it

Values without evidence, or without a decisive margin to the next reading, are marked as assumed. Signals are read
by the readers of the analysis, so the mapping describes the numbers that the analysis uses.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping as AbstractMapping
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.schema import validate
from impact_rs_trials.file_names import EXPERIMENT_FILE, MAPPING_FILE, RUN_TABLE
from impact_rs_trials.recordings.importing.described_runs import DescribedRuns
from impact_rs_trials.recordings.importing.file_groups import FileGroups, group_files, whole_runs
from impact_rs_trials.recordings.importing.import_texts import (
    ARM,
    BODY,
    Line,
    Notes,
    PossibleReading,
    flow,
    mapping_text,
    runs_text,
)
from impact_rs_trials.recordings.importing.joint_sections import NO_HEADER, JointSections
from impact_rs_trials.recordings.importing.object_sections import ObjectSections, poses_in
from impact_rs_trials.recordings.importing.recorded_files import (
    ImportedFiles,
    RecordedFile,
    column_names,
    open_recorded,
    refuse_several,
)
from impact_rs_trials.recordings.importing.table_layout import NoTable
from impact_rs_trials.recordings.mapping import NO_ROBOT, Mapping, TableLayout
from impact_rs_trials.recordings.readers.guesses import STAMP, steps_back
from impact_rs_trials.recordings.readers.lerobot import INFO, data_set_of
from impact_rs_trials.recordings.readers.read_once import files_read_once
from impact_rs_trials.recordings.readers.run_finder import find_recordings

NOMINAL = (
    "{info}: a LeRobot data set. Timestamps are frame numbers over {fps:g} Hz, not times of measurement: velocities "
    "err by as much as the frames were irregular. It does not say the unit of its positions: some recorders write "
    "percent of the calibrated range of each joint in place of degrees"
)


WHOLE_RUNS = "{names} hold the same columns: each is taken for a run; import runs of another robot or body separately"
NOTHING_TRACKED = (
    "neither joints nor the pose of an object; expected columns of joints (--robot says which robot), or x, y, z and a "
    "quaternion; of a ball x, y, z, or two coordinates of which one falls freely, or a height in free fall. "
    "A table of impacts needs no import: impact-rs compare --impacts (columns: docs/files.md)"
)
ON_A_TABLE = (
    ". Neither of {columns} falls freely: of a body that slides or rolls on a table, as a puck or a billiard ball, "
    "write a table of impacts, with the states before and after and the normal of the wall (nx, ny, nz)"
)


@dataclass(frozen=True)
class ImportDraft:
    """Files that describe recordings.

    Attributes:
        folder: Folder to which the names of runs are relative.
        texts: Contents by file name.
        lines: Guessed keys with their evidence.
        remarks: Warnings to the user.
        hits: Number of runs with impacts.
        runs: Number of runs.
        readings: Possible readings by signal of the joints, the chosen reading first.
    """

    folder: Path
    texts: dict[str, str]
    lines: tuple[Line, ...]
    remarks: tuple[str, ...]
    hits: int
    runs: int
    readings: AbstractMapping[str, tuple[PossibleReading, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import: the user's knowledge about the files.

    Attributes:
        robot: Robot facts, by name or path; ``none``: an object alone; None: guess.
        scenario: Scenario of hits, by name or path; None: unknown.
        rate: Sampling rate of files without timestamps [Hz]; None: they have timestamps.
        dedupe: Whether the first of several samples with one timestamp is kept.
    """

    robot: str | None = None
    scenario: str | None = None
    rate: float | None = None
    dedupe: bool = False


def draft_import(paths: Sequence[Path], output: Path, options: ImportOptions) -> ImportDraft:
    """Describe recordings.

    Args:
        paths: Files, bags, or folders of them.
        output: Folder of the description, to which paths of a robot are relative.
        options: Options of the import.

    Raises:
        InputError: A file cannot be read, or a key without evidence was not given; the message names the remedy.
    """
    with files_read_once():
        files = [file for path in paths for file in find_recordings(path, notes=True)]
        return _Importer(group_files(files), output, options).draft()


class _Importer:
    """Describes the files of one import."""

    def __init__(self, groups: FileGroups, output: Path, options: ImportOptions) -> None:
        self._output, self._options = output, options
        self._notes = Notes()
        whole = whole_runs(groups, column_names, options.robot in (None, NO_ROBOT))
        if whole is not None:
            self._notes.remarks.append(WHOLE_RUNS.format(names=", ".join(whole.runs)))
        self._groups = whole or groups
        self._files = self._opened()

    def _opened(self) -> list[RecordedFile]:
        """A file of every kind; texts without numbers, such as event logs, are left out if other files have some."""
        opened: list[RecordedFile] = []
        empty: list[NoTable] = []
        for pattern, files in self._groups.kinds.items():
            try:
                opened.append(
                    open_recorded(pattern, next(iter(files.values())), self._groups.several_files, self._notes)
                )
            except NoTable as error:
                empty.append(error)
        if not opened:
            raise empty[0]
        self._notes.remarks += [f"left out: {error}" for error in empty]
        return opened

    def draft(self) -> ImportDraft:
        """The description of all files."""
        robot = self._robot()
        facts = None if robot == NO_ROBOT else load_facts(robot)
        signals: dict[str, dict[str, Any]] = {}
        joint_keys: dict[str, Any] = {}
        recorded = self._files[0]
        files = ImportedFiles(self._files, self._groups, self._options.rate, self._notes)
        joints = JointSections(files)
        if facts is not None:
            recorded, joint_keys, signals = joints.describe(robot, facts)
        tracked = ObjectSections(files, joints.flange)
        pose_file = tracked.describe(recorded, facts is not None, signals)
        if facts is None and pose_file is None:
            planes = "".join(ON_A_TABLE.format(columns=pair) for pair in tracked.not_falling)
            raise InputError(NOTHING_TRACKED + planes, file=self._files[0].path)
        if facts is None and pose_file is not None:
            refuse_several(pose_file, self._groups, "objects without a robot", "object")
        main = recorded if facts is not None else pose_file or recorded
        clock = self._time(main)
        content: dict[str, Any] = {
            "description": f"{self._groups.folder.name or 'recordings'}, as impact-rs import found it",
            "robot": robot if not robot.endswith((".yaml", ".yml")) else os.path.relpath(robot, self._output),
            **joint_keys,
            **({"time": clock} if clock else {}),
        }
        if main.layout != TableLayout():
            content["table"] = main.layout.model_dump(exclude_defaults=True)
        if main.run_column is not None:
            content["run_column"] = main.run_column
        content["signals"] = signals
        mapping = validate(Mapping, content | {"robot": robot}, self._output / MAPPING_FILE)
        runs = DescribedRuns(tracked.groups, self._options.scenario, self._notes)
        rows = runs.rows(mapping)
        if facts is not None and runs.clock_of_object(mapping, rows, signals):
            mapping = validate(Mapping, content | {"robot": robot}, self._output / MAPPING_FILE)
        lines = [replace(line, key=line.key.removesuffix(f" ({main.path.name})")) for line in self._notes.lines]
        texts = {MAPPING_FILE: mapping_text(content, lines), RUN_TABLE: runs_text(rows, facts is None)}
        hits = sum(row.hit for row in rows)
        if hits or facts is None or self._options.scenario is not None:
            texts[EXPERIMENT_FILE] = self._experiment(facts, robot)
        runs.check_first(mapping, rows)
        if facts is not None:
            runs.compare(mapping, rows, facts)
        remarks = tuple(dict.fromkeys(self._notes.remarks))
        return ImportDraft(
            self._groups.folder, texts, tuple(self._notes.lines), remarks, hits, len(rows), joints.readings
        )

    def _robot(self) -> str:
        if self._options.robot is not None:
            if Path(self._options.robot).suffix in (".urdf", ".xacro"):
                raise InputError(
                    "robot facts are needed: impact-rs robot import makes them of a URDF",
                    key="--robot",
                    value=self._options.robot,
                )
            self._notes.add("robot", self._options.robot, "given with --robot")
            return self._options.robot
        robots = sorted(path.stem for path in (config_directory() / "robots").glob("*.yaml"))
        texts = [text for recorded in self._files for text in (recorded.path.parent.name, recorded.path.stem)]
        texts += [
            text
            for recorded in self._files
            for candidate in recorded.candidates
            for text in (candidate.label, *candidate.joints)
        ]
        words = set().union(*map(_runs_of_words, texts))
        matches = [name for name in robots if {name.replace("_", ""), name.partition("_")[2].replace("_", "")} & words]
        if len(matches) == 1:
            self._notes.add(
                "robot", matches[0], "the files contain its name; assumed, give --robot to be sure", sure=False
            )
            return matches[0]
        widths = {
            candidate.width
            for recorded in self._files
            for candidate in recorded.candidates
            if not candidate.pose and candidate.guess
        }
        counts = {name: load_facts(name).joint_count for name in robots}
        if not widths & set(counts.values()) and any(poses_in(recorded, False) for recorded in self._files):
            self._notes.add(
                "robot", NO_ROBOT, "no signal is as wide as a robot has joints: an object alone", sure=False
            )
            return NO_ROBOT
        fitting = [name for name, count in counts.items() if count in widths] or robots
        raise InputError(
            f"--robot is needed: the files do not name the robot; known are {', '.join(fitting)}; impact-rs robot "
            "import makes another robot from its URDF; none stands for an object without a robot",
            file=self._files[0].path,
        )

    def _time(self, recorded: RecordedFile) -> dict[str, Any]:
        keys = recorded.clock_keys(self._options.rate)
        if self._options.rate is not None:
            self._notes.add("time.rate", f"{self._options.rate:g}", "given with --rate")
            if "column" in keys:
                self._notes.add("time.column", keys["column"], "frame numbers, with gaps where frames are missing")
        elif recorded.on_log:
            self._notes.add("time", flow(keys), f"of the positions: {NO_HEADER}")
        elif recorded.clock is not None:
            self._notes.add("time", flow(keys), recorded.clock.evidence, recorded.clock.sure)
            self._notes.remarks += recorded.clock.remarks
            if (data := data_set_of(recorded.path)) is not None and data.fps is not None:
                self._notes.remarks.append(NOMINAL.format(info=INFO, fps=data.fps))
            if not any(STAMP.search(name) for name in recorded.clock_columns) and (
                step_back := steps_back(recorded.columns)
            ):
                self._notes.remarks.append(f"{step_back}; {flow(recorded.clock.value)} is taken for the clock instead")
            if recorded.clock.remarks and not self._options.dedupe:
                self._notes.remarks.append("repeated stamps are refused; --dedupe keeps the first sample of each")
        if self._options.dedupe:
            keys["repeated"] = "keep_first"
            self._notes.add("time.repeated", "keep_first", "given with --dedupe")
        return keys

    def _experiment(self, facts: RobotFacts | None, robot: str) -> str:
        if facts is None:
            return BODY
        scenario = self._options.scenario
        if scenario is None:
            self._notes.remarks.append(
                f"{EXPERIMENT_FILE} names scenario.yaml, which is not there: impact-rs scenario new --robot {robot} -o "
                "scenario.yaml in the same folder, with masses and sizes of your objects and the position of the robot"
            )
            return ARM.format(scenario="scenario.yaml   # to be made, see docs/scenarios.md")
        if scenario.endswith((".yaml", ".yml")):
            scenario = os.path.relpath(scenario, self._output)
        return ARM.format(scenario=flow(scenario))


def _runs_of_words(text: str) -> set[str]:
    """Words of a text, and two or three neighbouring words joined: ``xarm 6`` and ``xarm_6`` hold ``xarm6``."""
    words = re.findall(r"[a-z0-9]+", text.lower())
    return {"".join(words[first : first + count]) for first in range(len(words)) for count in (1, 2, 3)}
