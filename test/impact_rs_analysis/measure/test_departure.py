# SPDX-License-Identifier: Apache-2.0
"""An object that flies off the pad after the hit is reported with its distance, speed and restitution."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import yaml

from impact_rs_analysis.measure.analyze import Analysis, analyze_campaign
from impact_rs_analysis.measure.departure import (
    SEPARATION_WINDOW_S,
    Departure,
    _distances,
    departures,
    object_departures,
)
from impact_rs_analysis.report.analysis import write_analysis_report
from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import ControllerColumns, PoseColumns, TrialBag
from impact_rs_trials.bags.topics import OBJECT_POSE, TRUTH_OBJECT_POSE
from impact_rs_trials.campaign import make_manifest, run_campaign

SHORT = {"nominal_impact": 0.45, "approach": 0.4, "overrun": 0.1, "stop": 0.15, "push": 0.25, "slide": 0.1}  # s


@pytest.fixture(scope="module")
def bouncy(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """Three short trials of a light box on a pad without damping: a spring, which throws it back."""

    def run(directory: Path) -> None:
        scenario = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text())
        scenario["robots"]["arm"]["end_effector"]["pad"]["damping"] = 0.0
        scenario["timing"] |= SHORT | {"window_after": 0.25, "duration": 0.8}
        (directory / "spring.yaml").write_text(yaml.safe_dump(scenario | {"name": "spring"}))
        manifest = make_manifest(str(directory / "spring.yaml"), ["parcel"], ["case_2"], [0.8, 1.0, 1.2], trials=1)
        assert [report.outcome for report in run_campaign(directory / "trials", manifest)] == ["OK"] * 3

    return made_once("bouncy_campaign", run) / "trials"


def departure_of(path: Path) -> Departure:
    bag = TrialBag.open(path)
    (found,) = departures(bag, {"arm": bag.controller("arm")})
    return found


def test_an_object_thrown_off_leaves_with_the_speed_of_its_true_pose(bouncy: Path) -> None:
    for path in bouncy.glob("parcel__*"):
        bag = TrialBag.open(path)
        true, state, hit = bag.poses(TRUTH_OBJECT_POSE), bag.controller("arm"), bag.impact_time("arm")
        first = (true.time >= hit + SEPARATION_WINDOW_S[0]) & (true.time <= hit + SEPARATION_WINDOW_S[1])
        box = np.polyfit(true.time[first], true.position[first, 1], 1)[0]
        while_ = (state.time >= hit + SEPARATION_WINDOW_S[0]) & (state.time <= hit + SEPARATION_WINDOW_S[1])
        found = departure_of(path)
        assert found.speed == pytest.approx(np.mean(state.twist[while_, 1]) - box, rel=0.05)  # both move along -y
        assert found.speed > 0.3 and found.distance > 0.025
        assert found.restitution == pytest.approx(found.speed / 0.7, rel=0.01)  # case 2 comes with 0.7 m/s


def test_an_object_that_is_pushed_on_stays(push_campaign: Path, push_analysis: Analysis) -> None:
    for path in push_campaign.glob("cat_food__*"):
        assert departure_of(path).distance < 0.003
    assert push_analysis.departed == () and push_analysis.to_json()["object_left"] == []


def test_a_box_that_turns_on_the_pad_has_not_left_it() -> None:
    """About its edge on the pad by up to 0.2 rad, as a box that slides along it does: the middle goes away alone."""
    angle, half, count = np.linspace(0.0, 0.2, 20), np.array([0.1, 0.05, 0.05]), 20
    across = half[1] * np.cos(angle) + half[0] * np.sin(angle)  # of the middle from the pad, whose normal is y
    quaternion = np.column_stack([np.zeros((count, 2)), np.sin(angle / 2.0), np.cos(angle / 2.0)])
    pose = PoseColumns(angle, np.column_stack([np.zeros(count), 0.3 + across, np.zeros(count)]), quaternion)
    pad = SimpleNamespace(time=angle, position=np.tile([0.0, 0.3, 0.0], (count, 1)))
    spec = ObjectSpec(label="box", mass=1.0, size=tuple(2.0 * half))
    middle, distance = _distances(np.array([0.0, 1.0, 0.0]), spec, pose, cast(ControllerColumns, pad), hit=0.0)
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
    assert np.ptp(middle) > 0.015


@pytest.mark.parametrize("after_end", [0.03, -0.002, math.nan])
def test_a_hit_without_poses_before_the_net_feedback_ends_has_no_departure(after_end: float) -> None:
    """Kills: the largest of no distances, a ValueError by which a trial without impact was listed as a damaged bag."""
    scenario, window_end = load_scenario("push"), 1.5
    time = window_end + 5e-3 * np.arange(-50, 50) + 2.5e-3  # poses at 200 Hz, none in the last 2.5 ms before the end
    pose = PoseColumns(time, np.zeros((time.size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)))
    pad = SimpleNamespace(time=time, position=np.zeros((time.size, 3)), ante_velocity=np.ones((time.size, 3)))
    bag = SimpleNamespace(
        path=Path("made_up"), counts={OBJECT_POSE: time.size}, poses=lambda _: pose,
        impact_time=lambda _: window_end + after_end,
        info=SimpleNamespace(scenario_json=scenario.model_dump_json(), object="cat_food", window_end=window_end),
    )  # fmt: skip
    assert departures(cast(TrialBag, bag), {"arm": cast(ControllerColumns, pad)}) == ()


def test_analysis_terminal_and_report_say_it(bouncy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    analysis = analyze_campaign(bouncy)
    (left,) = analysis.departed
    assert (left.object, left.case, left.arm, left.trials, left.of) == ("parcel", "case_2", "arm", 3, 3)
    (entry,) = analysis.to_json()["object_left"]
    assert entry["distance_m"] > 0.025 and 0.5 < entry["restitution"] < 1.0
    assert "leaves the pad of arm in 3 of 3 trials" in write_analysis_report(analysis, tmp_path / "r")[0].read_text()
    main(["analyze", str(bouncy), "-o", str(tmp_path / "report")])
    said = " ".join(capsys.readouterr().err.split())
    assert "parcel case_2: the object leaves the pad of arm in 3 of 3 trials" in said
    assert "the prediction assumes lasting contact" in said


@pytest.mark.slow
def test_a_comparison_of_replayed_trials_says_it(bouncy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The twin replays the spring of the pad; the impact map beside it takes for granted that both go on together."""
    capsys.readouterr()
    assert main(["compare", str(bouncy), "--json"]) == 0
    remarks = json.loads(capsys.readouterr().out)["remarks"]
    (said,) = (remark for remark in remarks if "leaves the pad" in remark)
    assert "parcel case_2: the object leaves the pad of arm in 3 of 3 trials" in said


def test_a_prediction_with_restitution_is_reported_with_it() -> None:
    thrown = Departure("arm", 0.02, 0.2, 0.4, 0.0)
    found = list(object_departures({("push", "box", "case_1"): [(thrown,), (replace(thrown, distance=0.001),)]}))
    assert [(one.trials, one.of) for one in found] == [(1, 2)]
    (bouncing,) = object_departures({("push", "box", "case_1"): [(replace(thrown, predicted=0.3),)]})
    assert "as with a restitution of 0.40; the prediction assumes a restitution of 0.3." in bouncing.words
