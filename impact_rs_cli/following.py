# SPDX-License-Identifier: Apache-2.0
"""Where hits come from, by the words of a command line or the parameters of a node."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY
from impact_rs_analysis.evidence.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.following.hits import BagDoor, Door, TableDoor
from impact_rs_cli.parser import PROGRAM
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.model import Model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_table import SUFFIXES, read_impact_table


class HitsArguments(NamedTuple):
    """Where hits come from.

    Attributes:
        runs: Folder of trials, or a table of impacts; None: ``impacts`` names the table.
        impacts: Table of impacts; None: trials.
        scenario: Scenario of a table of arms; None: free bodies.
        model: File of the model.
        tolerance: Contact tolerance of a table [m]; None: as usual.
        exact: Whether to ignore the model discrepancy.
    """

    runs: Path | None
    impacts: Path | None = None
    scenario: str | None = None
    model: str = "nominal"
    tolerance: float | None = None
    exact: bool = False

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


def door_of(hits: HitsArguments, model: Model, progress: Callable[[int, int], None] = lambda *_: None) -> Door:
    """The door through which hits come.

    Args:
        hits: Where they come from.
        model: What is believed.
        progress: Called with (done, total) while bags are read.

    Raises:
        InputError: Options that do not go together, or there is no such scenario.
    """
    table = hits.table
    if table is None:
        if hits.scenario is not None or hits.tolerance is not None:
            option = "--scenario" if hits.scenario is not None else "--contact-tolerance"
            raise InputError(f"{option} goes with --impacts only: trials contain their scenario")
        store = ReplayCache(map)
        return BagDoor(hits.where.absolute(), model, store, NO_DISCREPANCY if hits.exact else None, progress)
    if hits.tolerance is not None and not hits.tolerance >= 0.0:
        raise InputError("expected a distance >= 0 m", key="--contact-tolerance", value=hits.tolerance)
    scenario = None if hits.scenario is None else load_scenario(hits.scenario)
    tolerance = GAP_TOLERANCE if hits.tolerance is None else hits.tolerance
    discrepancy = NO_MAP_DISCREPANCY if hits.exact else None
    return TableDoor(lambda: read_impact_table(table, scenario, tolerance=tolerance), model, discrepancy)


def diagnose_command(hits: HitsArguments) -> str:
    """The command of a full diagnosis of the same measurements."""
    words = [PROGRAM, "diagnose"]
    words += ["--impacts", str(hits.table)] if hits.table is not None else [str(hits.where)]
    if hits.scenario is not None:
        words += ["--scenario", hits.scenario]
    if hits.model != "nominal":
        words += ["--model", hits.model]
    return shlex.join([*words, "-o", "diagnosis.json"])
