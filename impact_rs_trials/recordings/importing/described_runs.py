# SPDX-License-Identifier: Apache-2.0
"""The runs that a mapping describes, their objects, and contradictions to the mapping."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.file_names import RUN_TABLE
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.importing.file_groups import OBJECT, FileGroups
from impact_rs_trials.recordings.importing.import_checks import (
    MIN_OBJECT_DISPLACEMENT_M,
    clocks_of,
    impact_warnings,
    mapping_warning,
    object_moves,
)
from impact_rs_trials.recordings.importing.import_texts import FoundRun, Notes, flow
from impact_rs_trials.recordings.mapping import NO_ROBOT, Mapping, MountedEndEffector, SignalName
from impact_rs_trials.recordings.readers.run_finder import find_runs
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.relations import evenly

MAX_RUNS_WITH_CLOCK = 5  # whose clocks are compared
MAX_RUNS_COMPARED = 10  # with the first


class DescribedRuns:
    """Runs in files, read with a mapping.

    Args:
        groups: Files by kind and run.
        scenario: Scenario of hits, by name or path; None: unknown.
        notes: Findings, appended to.
    """

    def __init__(self, groups: FileGroups, scenario: str | None, notes: Notes) -> None:
        self._groups, self._scenario, self._notes = groups, scenario, notes
        self._refused: list[InputError] = []

    def rows(self, mapping: Mapping) -> list[FoundRun]:
        """Every readable run; unreadable runs are noted."""
        groups = self._groups
        has_object = any(name.startswith("object") for name in mapping.signals)
        needed = {source.file for source in mapping.signals.values() if source.file is not None}
        objects = groups.objects if any(OBJECT in file for file in needed) else {}
        rows, incomplete = [], []
        for run, session in self._named_runs(mapping):
            absent = {kind for kind, files in groups.kinds.items() if groups.several_files and run not in files}
            if missing := needed & absent:
                incomplete.append(f"{run} ({', '.join(sorted(missing))})")
                continue
            row = FoundRun(run, objects.get(run, ""), session)
            try:
                moves = has_object and object_moves(groups.folder / run, mapping, row.names)
            except InputError as error:
                self._leave_out(run, error)
                continue
            rows.append(replace(row, hit=moves or mapping.robot == NO_ROBOT))
        if incomplete:
            self._notes.remarks.append(f"left out, because a file is missing: {'; '.join(incomplete)}")
        if not rows and self._refused:
            raise self._refused[0]
        if not rows:
            raise InputError(f"no run has all of its files: {'; '.join(incomplete)}", file=groups.folder)
        self._note_unread(needed)
        if (groups.folder / RUN_TABLE).is_file():
            self._notes.remarks.append(
                f"{groups.folder / RUN_TABLE} is a table of runs, and is used instead of the table of this import"
            )
        if groups.sessions:
            self._notes.add(
                "session in runs.csv", flow(list(dict.fromkeys(groups.sessions.values()))),
                "folders of the runs; impacts makes a column of them, for --covariates session",
            )  # fmt: skip
        if has_object and mapping.robot != NO_ROBOT and any(row.hit for row in rows):
            self._notes.add(
                "kind in runs.csv", "hit", f"the object moves by more than {1e3 * MIN_OBJECT_DISPLACEMENT_M:g} mm"
            )
            rows = self._with_objects(rows)
        return rows

    def _named_runs(self, mapping: Mapping) -> Iterator[tuple[str, str]]:
        """All runs, also those inside of files, and their sessions."""
        for run in self._groups.runs:
            session = self._groups.sessions.get(run, "")
            if not mapping.holds_runs or self._groups.several_files:
                yield run, session
                continue
            try:
                paths = find_runs(self._groups.folder / run, mapping)
            except InputError as error:
                self._leave_out(run, error)
                continue
            yield from ((str(path.relative_to(self._groups.folder)), session) for path in paths)

    def _leave_out(self, run: str, error: InputError) -> None:
        self._refused.append(error)
        self._notes.remarks.append(f"{run} is left out, because the reader refuses it: {error}")

    def _note_unread(self, needed: set[str]) -> None:
        """Note the files that hold no signal of the mapping."""
        unread = [kind for kind in self._groups.kinds if self._groups.several_files and kind not in needed]
        names = [*unread, *(str(path.relative_to(self._groups.folder)) for path in self._groups.left_out)]
        if names:
            self._notes.remarks.append(f"not read, because the mapping takes no signal from them: {', '.join(names)}")

    def _with_objects(self, rows: list[FoundRun]) -> list[FoundRun]:
        """Rows with the object that was hit."""
        objects = [] if self._scenario is None else list(load_scenario(self._scenario).objects)
        if object_names := list(dict.fromkeys(row.object for row in rows if row.object)):
            self._notes.add("object in runs.csv", flow(object_names), "by the names of the files")
            if objects and not set(object_names) <= set(objects):
                self._notes.remarks.append(
                    f"files call the objects {', '.join(object_names)}, {self._scenario} has {', '.join(objects)}: "
                    "name the objects of the scenario as the files do"
                )
            return rows
        default_object = (objects or ["OBJECT"])[0]
        rows = [
            replace(row, object=_object_in(f"{self._groups.folder.name}/{row.run}", objects) or default_object)
            for row in rows
        ]
        if len(objects) != 1:
            self._notes.add(
                "object in runs.csv", flow([row.object for row in rows][:3]), "say which object was hit", False
            )
        return rows

    def clock_of_object(self, mapping: Mapping, rows: Sequence[FoundRun], signals: dict[str, dict[str, Any]]) -> bool:
        """Set ``clock: own`` for an object that does not start to move at the impact of the arm; whether it was set."""
        names = [name for name in OBJECT_SIGNALS if name in signals]
        hits = [row for row in rows if row.hit][:MAX_RUNS_WITH_CLOCK]
        compared = [clocks_of(self._groups.folder / row.run, mapping, row.names) for row in hits] if names else []
        differing = [clocks for clocks in compared if clocks is not None]
        if 2 * len(differing) <= len(compared):
            return False
        median = sorted(differing, key=lambda clocks: clocks.offset)[len(differing) // 2]
        evidence = f"{median.evidence}; so in {len(differing)} of {len(compared)} compared runs"
        for name in names:
            signals[name]["clock"] = "own"
            self._notes.add(f"signals.{name}.clock", "own", evidence)
        return True

    def check_first(self, mapping: Mapping, rows: Sequence[FoundRun]) -> None:
        """Note the reader's warnings about the first run."""
        row = next((row for row in rows if row.hit), rows[0])
        path = self._groups.folder / row.run
        try:
            if mapping.robot == NO_ROBOT or row.hit:
                wanted: list[SignalName] = list(mapping.signals)
                read = read_series(path, mapping, wanted, wanted, row.names)
                self._notes.remarks += [remark for series in read.values() for remark in series.remarks]
                if mapping.robot != NO_ROBOT:
                    self._notes.remarks += impact_warnings(read, mapping)
            else:
                target = path if path.exists() or path.parent.is_file() else path.parent
                self._notes.remarks += [
                    remark for run in read_recordings(target, mapping)[:1] for remark in run.remarks
                ]
        except InputError as error:
            self._notes.remarks.append(f"the reader refuses {row.run} with this mapping: {error}")

    def compare(self, mapping: Mapping, rows: Sequence[FoundRun], facts: RobotFacts) -> None:
        """Compare units and signs of further runs with the first run, from which the mapping was made."""
        first, *further = rows
        compared = evenly(len(further), MAX_RUNS_COMPARED)
        model = RobotModel(facts, MountedEndEffector().build())
        contradicting = 0
        for row in (further[index] for index in compared):
            try:
                warning = mapping_warning(self._groups.folder / row.run, mapping, row.names, model)
            except InputError as error:
                warning = f"the reader refuses it: {error}"
            if warning is not None:
                contradicting += 1
                self._notes.remarks.append(
                    f"{row.run} differs from {first.run}, from which the mapping was made: {warning}; import it "
                    "separately, or take it out of runs.csv"
                )
        if further and not contradicting:
            others = f"{len(compared)} other{'s' if len(compared) > 1 else ''}"
            evidence = f"units and signs of {first.run} hold in {others} as well"
            self._notes.add("runs", f"{len(compared)} of {len(further)} others", evidence)


def _object_in(run: str, objects: Sequence[str]) -> str:
    """Longest name of an object that consists of whole words of the path of a run; empty: none."""
    matches = [name for name in objects if re.search(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])", run)]
    return max(matches, key=len, default="")
