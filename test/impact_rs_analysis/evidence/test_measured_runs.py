# SPDX-License-Identifier: Apache-2.0
"""Folders of trials, read for a diagnosis."""

from __future__ import annotations

from pathlib import Path

from impact_rs_analysis.evidence.measured_runs import read_runs
from impact_rs_trials.bags.reader import OF_THE_TWIN
from impact_rs_trials.campaign import make_manifest, run_one


def test_runs_that_the_twin_made_are_remarked_once(tmp_path: Path) -> None:
    for plant, scale in (("twin", 0.9), ("twin", 1.0), ("bullet", 1.1)):
        manifest = make_manifest("push", ["cat_food"], ["2"], [scale], trials=1, plant=plant)  # type: ignore[arg-type]
        run_one(tmp_path, manifest.trial(manifest.keys[0]))
    runs = read_runs(tmp_path, map)
    assert len(runs.runs) == 3 and runs.remarks == (OF_THE_TWIN,)
