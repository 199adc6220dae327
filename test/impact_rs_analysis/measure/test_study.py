# SPDX-License-Identifier: Apache-2.0
"""A study is two campaigns in one table."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure import study
from impact_rs_analysis.measure.analyze import MAX_IMPACT_SPREAD_S, Analysis, analyze_campaign
from impact_rs_analysis.measure.study import analyze_study, study_manifests
from impact_rs_analysis.measure.table import result_table
from impact_rs_sim.errors import InputError
from impact_rs_trials.campaign import make_manifest, run_campaign


@pytest.fixture(scope="module")
def analysis(push_campaign: Path, made_once: Callable[[str, Callable[[Path], None]], Path]) -> Analysis:
    def run(folder: Path) -> None:
        shutil.copytree(push_campaign, folder / "push")
        manifest = make_manifest("grab", ["cat_food"], ["case_1"], [0.8, 1.0, 1.2], trials=1)
        assert [report.outcome for report in run_campaign(folder / "grab", manifest)] == ["OK"] * 3

    return analyze_study(made_once("study", run))


def test_the_whole_study_is_450_trials() -> None:
    assert sum(len(manifest.keys) for manifest in study_manifests().values()) == 450


def test_every_scenario_has_its_averages_and_all_have_one(analysis: Analysis) -> None:
    rows = {row.label: row for row in result_table(analysis)}
    assert list(rows) == [
        "push: Cat food: case 2", "push: average error", "push: absolute error",
        "grab: Cat food: case 1", "grab: average error", "grab: absolute error",
        "All: average error", "All: absolute error",
    ]  # fmt: skip
    both = [rows[f"{name}: absolute error"].errors["reduced"] for name in study.SCENARIOS]
    assert rows["All: absolute error"].errors["reduced"] == pytest.approx(np.mean(both))


def test_grab_is_measured_upward_as_the_mean_of_both_arms(analysis: Analysis) -> None:
    entry = next(entry for entry in analysis.sets if entry.scenario == "grab")
    assert entry.axis == "z"
    assert entry.estimate == pytest.approx(entry.predictions["reduced"].velocity, rel=0.1)
    assert [arm.name for arm in analysis.arms] == ["arm", *(arm.name for arm in entry.arms)]


def test_a_study_without_one_of_its_campaigns_says_which(push_campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(push_campaign, tmp_path / "push")
    with pytest.raises(InputError, match="no such folder") as caught:
        analyze_study(tmp_path)
    assert caught.value.file == str(tmp_path / "grab")
    assert analyze_campaign(tmp_path / "push").sets


def test_arms_that_hit_apart_are_flagged_with_the_time_between(analysis: Analysis) -> None:
    trial = next(entry for entry in analysis.sets if entry.scenario == "grab").trials[0]
    assert 0.0 <= trial.spread < MAX_IMPACT_SPREAD_S
    assert replace(trial, impact_times=(0.90, 0.97)).spread == pytest.approx(0.07)
    assert all(spread > MAX_IMPACT_SPREAD_S for _, spread in analysis.apart)
