# SPDX-License-Identifier: Apache-2.0
"""Folders of trials, read for a diagnosis."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from impact_rs_analysis.evidence.measured_runs import read_runs
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import OF_THE_TWIN
from impact_rs_trials.campaign import make_manifest, run_one


def test_runs_that_the_twin_made_are_remarked_once(push_campaign: Path, tmp_path: Path) -> None:
    manifest = make_manifest("push", ["cat_food"], ["2"], [0.9], trials=1, plant="twin")
    run_one(tmp_path, manifest.trial(manifest.keys[0]))
    (made,), one = tmp_path.iterdir(), next(push_campaign.glob("cat_food*1.200*"))
    shutil.copytree(made, tmp_path / "again" / made.name)
    shutil.copytree(one, tmp_path / one.name)
    runs = read_runs(tmp_path, map)
    assert len(runs.runs) == 3 and runs.remarks == (OF_THE_TWIN,)


def test_runs_since_one_of_them_are_those_recorded_later_and_another_set_of_measurements(
    hidden_campaign: Path, tmp_path: Path
) -> None:
    """In the order in which they were recorded, not in that of their names."""
    folder = tmp_path / "runs"
    shutil.copytree(hidden_campaign, folder)
    order = [f"{name}__r{repeat}" for name in ("push/juice__case_1__s1.000", "push/parcel__case_1__s1.000")
             for repeat in (1, 0)]  # fmt: skip
    for number, name in enumerate(order):
        os.utime(folder / name, (1e9 + number, 1e9 + number))
    for name in ("excite/none__fast__s1.000__r0", "excite/none__fast__s1.000__r1"):
        os.utime(folder / name, (9e8, 9e8))
    runs = read_runs(folder, map)
    later = runs.since("push/juice__case_1__s1.000__r0")
    assert sorted(run.name for run in later.runs) == [
        "juice__case_1__s1.000__r0",
        "parcel__case_1__s1.000__r0",
        "parcel__case_1__s1.000__r1",
    ]
    assert later.remarks[-1] == "only runs since push/juice__case_1__s1.000__r0: 3 of 6"
    assert later.digest != runs.digest == runs.since("excite/none__fast__s1.000__r0").digest
    with pytest.raises(InputError, match="nothing was measured since then"):
        runs.since("2002-01-01")
