# SPDX-License-Identifier: Apache-2.0
"""Following hits, for the command line and for a node: source of hits, state file, and full diagnoses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from impact_rs_analysis.application.measurements import MeasurementOptions, read_table
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.following.documents import HitDocument
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import BagHitSource, HitSource, TableHitSource
from impact_rs_analysis.following.state import restore_state, save_state
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.impacts.impact_table import SUFFIXES

SAVE_INTERVAL_HITS = 10  # hits between two saved states, while more hits are waiting


def hits_options(runs: Path | None, impacts: Path | None = None, **further: Any) -> MeasurementOptions:
    """Options of the source of hits.

    Args:
        runs: Folder of trials, or a table of impacts; None: ``impacts`` names the table.
        impacts: Table of impacts; None: trials.
        further: Other options.
    """
    if impacts is None and runs is not None and Path(runs).suffix in SUFFIXES:
        runs, impacts = None, runs
    return MeasurementOptions(runs=runs, impacts=impacts, **further)


def hit_source_of(hits: MeasurementOptions, model: Model) -> HitSource:
    """Source of hits.

    Args:
        hits: Their source.
        model: Nominal model, with the faults of the readings.

    Raises:
        InputError: Options exclude each other, or there is no such scenario.
    """
    tolerance = hits.contact_tolerance
    if hits.impacts is None:
        if hits.scenario is not None or tolerance is not None:
            option = "--scenario" if hits.scenario is not None else "--contact-tolerance"
            raise InputError(f"{option} goes with --impacts only: trials contain their scenario")
        return BagHitSource(hits.data.absolute(), model, ReplayCache(map), NO_DISCREPANCY if hits.exact else None)
    if tolerance is not None and not tolerance >= 0.0:
        raise InputError("expected a distance >= 0 m", key="--contact-tolerance", value=tolerance)
    return TableHitSource(lambda: read_table(hits), model, NO_MAP_DISCREPANCY if hits.exact else None)


class DiagnosisOfHits(Protocol):
    """Full diagnoses of the hits since a given hit, one at a time."""

    def file(self, since: str) -> Path:
        """The file of a diagnosis."""
        ...

    def start(self, since: str) -> None:
        """Start a diagnosis; a running one is stopped."""
        ...

    def stop(self) -> None:
        """Stop the running diagnosis."""
        ...


class FollowedHits:
    """A follower of hits with its state file, and a full diagnosis after every change.

    Args:
        hits: Source of hits.
        follower: Follows them; without hits so far.
        state: State file; None: not saved.
        diagnosis: Makes full diagnoses; None: without diagnoses.
    """

    def __init__(
        self, hits: MeasurementOptions, follower: Follower, state: Path | None, diagnosis: DiagnosisOfHits | None
    ) -> None:
        self.hits, self.follower, self._state, self._diagnosis = hits, follower, state, diagnosis
        self._due = False
        self._handled_count = 0

    def restore(self) -> int:
        """Restore the state file; returns the number of earlier hits.

        Raises:
            InputError: The file does not belong to this model and these hits.
        """
        if self._state is None or not self._state.exists():
            return 0
        count = restore_state(self.follower, self._state)
        changed, diagnosis = self.follower.changed, self._diagnosis
        self._due = changed is not None and diagnosis is not None and not diagnosis.file(changed.since).exists()
        return count

    def arrived(self) -> Iterator[HitDocument]:
        """Results of the hits since the last call. The state is saved after every tenth, and after the last.

        Raises:
            InputError: They cannot be read, or the state cannot be written.
        """
        for document in self.follower.arrived(self._handled):
            if document.change is not None and self._diagnosis is not None:
                self._diagnosis.stop()  # its hits are from before and after the change
                self._due = True
            yield document

    def save(self) -> None:
        """Write the state file.

        Raises:
            InputError: It cannot be written.
        """
        if self._state is not None:
            save_state(self.follower, self._state)

    def diagnose(self) -> str:
        """Start the diagnosis of the last change once there are enough hits; returns a message.

        Raises:
            InputError: No process can be started.
        """
        changed = self.follower.changed
        if self._diagnosis is None or changed is None or not self._due or not changed.diagnosable:
            return ""
        self._diagnosis.start(changed.since)
        self._due = False
        return f"full diagnosis of the {len(changed.conditions)} hits since {changed.since} has begun"

    def _handled(self) -> None:
        self._handled_count += 1
        if self._handled_count % SAVE_INTERVAL_HITS == 0 or not self.follower.hit_source.waiting:
            self.save()


def diagnose_options(hits: MeasurementOptions, model: str, effects: Sequence[str] | None = None) -> dict[str, Any]:
    """Options of ``impact-rs diagnose`` for the measurements of a follower, a model and named effects."""
    return {
        "runs": hits.runs,
        "impacts": hits.impacts,
        "scenario": hits.scenario,
        "model": model,
        "contact_tolerance": hits.contact_tolerance,
        "no_discrepancy": hits.exact,
        "calibration": hits.calibration,
        "effects": effects,
    }


def folder_of_diagnoses(folder: Path | None, state: Path | None) -> Path:
    """Folder of full diagnoses: ``folder``, or the folder of the state file, or the working directory."""
    if folder is not None:
        return folder
    return Path() if state is None else state.parent
