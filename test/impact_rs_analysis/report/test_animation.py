# SPDX-License-Identifier: Apache-2.0
"""Runs in 3D as data: samples where they are needed."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from scenes import PHYSICS, joints_track

from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.report.animation import MOST_ROWS, MOST_RUNS, ReplayPart, animation_data, shown_rows


def moving(time: np.ndarray, starts: tuple[int, ...] = (0,), impact: float | None = 0.5) -> Track:
    """Every joint is where the clock is."""
    joints = {name: np.tile(time, (own.facts.joint_count, 1)).T for name, own in PHYSICS.arms.items()}
    return joints_track(time, joints, starts=starts, impact=impact)


def times(run: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(run["time"]), dtype="<f4")


def test_every_sample_about_the_impact_is_kept_and_few_elsewhere() -> None:
    time = np.arange(1001) / 1000.0
    kept = time[shown_rows(moving(time), 0.001, 0.01)]
    assert np.diff(kept[(kept >= 0.48) & (kept <= 0.56)]) == pytest.approx(0.001)
    assert np.diff(kept[kept < 0.48]) == pytest.approx(0.01)
    assert (kept[0], kept[-1]) == (0.0, 1.0)


def test_both_ends_of_every_stretch_are_kept() -> None:
    time = np.concatenate((np.arange(105) / 1000.0, 0.3 + np.arange(105) / 1000.0))
    run = animation_data([moving(time, starts=(0, 105), impact=None)])["runs"][0]
    kept, second = times(run), run["starts"][1]
    assert kept[[0, second - 1, second, -1]] == pytest.approx([0.0, 0.104, 0.3, 0.404])
    assert (run["impact"], run["slow"]) == (None, None)


def test_numbers_are_float32_row_by_row() -> None:
    time = np.arange(3) / 100.0
    (run,) = animation_data([moving(time)])["runs"]
    joints = np.frombuffer(base64.b64decode(run["measured"]["joints"]), dtype="<f4").reshape(3, 13)
    assert joints[2] == pytest.approx(0.02)
    assert (run["measured"]["object"], run["measured"]["forces"], run["model"]) == (None, None, None)


def test_runs_of_one_scene_share_it() -> None:
    run = moving(np.arange(3) / 100.0)
    heavier = replace(run, physics=replace(PHYSICS, object=replace(PHYSICS.object, size=2.0 * PHYSICS.object.size)))
    data = animation_data([run, heavier, run])
    assert [entry["scene"] for entry in data["runs"]] == [0, 1, 0]
    assert len(data["scenes"]) == 2


def test_many_runs_have_fewer_samples_each() -> None:
    run = moving(np.arange(1001) / 1000.0)
    few, many = (len(animation_data(count * [run])["runs"][0]["time"]) for count in (MOST_RUNS, 2 * MOST_RUNS))
    assert many == pytest.approx(few / 2.0, rel=0.1)


def test_a_long_recording_has_no_more_samples_than_are_seen() -> None:
    run = animation_data([moving(np.arange(600_001) / 1000.0, impact=None)])["runs"][0]
    kept = times(run)
    assert MOST_ROWS <= kept.size <= MOST_ROWS + 2
    assert (kept[0], kept[-1]) == (0.0, 600.0)


def test_a_page_without_runs_has_no_part() -> None:
    assert ReplayPart.of([]) is None
    one = ReplayPart.of([moving(np.arange(3) / 100.0)])
    assert one is not None
    assert (one.choose, one.labels) == (False, ["run"])
