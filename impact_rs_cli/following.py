# SPDX-License-Identifier: Apache-2.0
"""Sources of hits, by the options of a command line or the parameters of a node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from impact_rs_analysis.evidence.calibration import LaboratoryCalibration, calibration_of
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY
from impact_rs_analysis.evidence.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import BagHitSource, HitSource, TableHitSource
from impact_rs_analysis.following.lessons import HitDocument
from impact_rs_analysis.following.state import restore_state, save_state
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.model import Model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_table import SUFFIXES, read_impact_table

SAVE_INTERVAL_HITS = 10  # instants of hits that are there already, between two saved states


class HitsArguments(NamedTuple):
    """Where hits come from.

    Attributes:
        runs: Folder of trials, or a table of impacts; None: ``impacts`` names the table.
        impacts: Table of impacts; None: trials.
        scenario: Scenario of a table of arms; None: free bodies.
        model: File of the model.
        tolerance: Contact tolerance of a table [m]; None: as usual.
        exact: Whether to ignore the model discrepancy.
        calibration: LaboratoryCalibration of the readings; None: the one beside the hits, if there is one.
    """

    runs: Path | None
    impacts: Path | None = None
    scenario: str | None = None
    model: str = "nominal"
    tolerance: float | None = None
    exact: bool = False
    calibration: Path | None = None

    @property
    def table(self) -> Path | None:
        """The table; None: trials."""
        if self.impacts is not None:
            return Path(self.impacts)
        return Path(self.runs) if self.runs is not None and Path(self.runs).suffix in SUFFIXES else None

    @property
    def where(self) -> Path:
        """Folder or table."""
        path = self.table or self.runs
        assert path is not None
        return Path(path)


def calibration_of_hits(hits: HitsArguments) -> LaboratoryCalibration:
    """The calibration of the readings of hits.

    Raises:
        InputError: It cannot be read, or has an effect of the physics.
    """
    return calibration_of(hits.where, hits.calibration)


def hit_source_of(hits: HitsArguments, model: Model) -> HitSource:
    """Source of hits.

    Args:
        hits: Their source.
        model: Nominal model, with the faults of the readings.

    Raises:
        InputError: Options that do not go together, or there is no such scenario.
    """
    table = hits.table
    if table is None:
        if hits.scenario is not None or hits.tolerance is not None:
            option = "--scenario" if hits.scenario is not None else "--contact-tolerance"
            raise InputError(f"{option} goes with --impacts only: trials contain their scenario")
        store = ReplayCache(map)
        return BagHitSource(hits.where.absolute(), model, store, NO_DISCREPANCY if hits.exact else None)
    if hits.tolerance is not None and not hits.tolerance >= 0.0:
        raise InputError("expected a distance >= 0 m", key="--contact-tolerance", value=hits.tolerance)
    scenario = None if hits.scenario is None else load_scenario(hits.scenario)
    tolerance = GAP_TOLERANCE if hits.tolerance is None else hits.tolerance
    discrepancy = NO_MAP_DISCREPANCY if hits.exact else None
    return TableHitSource(lambda: read_impact_table(table, scenario, tolerance=tolerance), model, discrepancy)


class FollowedHits:
    """A follower of hits with its state file, and the full diagnosis that a change calls for.

    Args:
        hits: Source of hits.
        follower: Follows them; without hits so far.
        state: State file; None: not saved.
        diagnosis: Makes full diagnoses; None: without diagnoses.
    """

    def __init__(
        self, hits: HitsArguments, follower: Follower, state: Path | None, diagnosis: FullDiagnosis | None
    ) -> None:
        self.hits, self.follower, self._state, self._diagnosis = hits, follower, state, diagnosis
        self._due = False
        self._taken = 0

    def restore(self) -> int:
        """Restore the state file; returns the number of earlier hits.

        Raises:
            InputError: It is no state file of this model and these hits.
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
                self._diagnosis.stop()  # its hits are no longer alike
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
        self._taken += 1
        if self._taken % SAVE_INTERVAL_HITS == 0 or not self.follower.hit_source.waiting:
            self.save()


def diagnose_options(hits: HitsArguments, effects: Sequence[str] | None = None) -> dict[str, Any]:
    """Options of ``impact-rs diagnose`` for the same measurements and, if given, effects."""
    return {
        "runs": hits.where if hits.table is None else None,
        "impacts": hits.table,
        "scenario": hits.scenario,
        "model": hits.model,
        "contact_tolerance": hits.tolerance,
        "no_discrepancy": hits.exact,
        "calibration": hits.calibration,
        "effects": effects,
    }


def folder_of_diagnoses(given: Path | None, state: Path | None) -> Path:
    """Folder of full diagnoses: the given one, else the state file's, else the working directory."""
    if given is not None:
        return given
    return Path() if state is None else state.parent
