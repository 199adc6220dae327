# SPDX-License-Identifier: Apache-2.0
"""The systematic band: planted shifts come back, and add in squares by their sign."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.analyze import Analysis, analyze_campaign
from impact_rs_analysis.measure.net_feedback import TrialFeedback, net_feedback
from impact_rs_analysis.measure.sensitivity import Sensitivity, Shift, sensitivity_of
from impact_rs_analysis.measure.table import result_table
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.varied_settings import folder_name

SLOPE = 0.7


@pytest.fixture(scope="module")
def trials(push_campaign: Path) -> list[TrialFeedback]:
    return [net_feedback(TrialBag.open(path)) for path in sorted(push_campaign.glob("cat_food*"))]


def on_a_line(trials: list[TrialFeedback], crossing: float) -> list[TrialFeedback]:
    """The trials with feedback that vanishes at a velocity, steady over the window: the sooner it ends, the less."""
    made = []
    for trial in trials:
        info = trial.info
        net = SLOPE * (info.reference_post_velocity - crossing)
        feedback = np.full_like(trial.time, net / (info.window_end - info.window_start))
        made.append(replace(trial, feedback=feedback, net=net))
    return made


def test_a_planted_shift_is_found_whatever_the_slope(trials: list[TrialFeedback]) -> None:
    base, moved = on_a_line(trials, -0.5), on_a_line(trials, -0.51)
    found = sensitivity_of(base, {("clamp_force", 2.0): moved})
    assert found.of("push", "cat_food")["clamp_force"][2.0] == pytest.approx(2.0)
    assert not found.missing


def test_another_end_of_the_window_changes_no_crossing_of_steady_feedback(trials: list[TrialFeedback]) -> None:
    found = sensitivity_of(on_a_line(trials, -0.5), {("clamp_force", 2.0): on_a_line(trials, -0.5)})
    window = found.of("push", "cat_food")["window"]
    assert len(window) == 2
    assert list(window.values()) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_feedback_after_the_window_counts_only_in_the_longer_one(trials: list[TrialFeedback]) -> None:
    late = []
    for trial in on_a_line(trials, -0.5):
        feedback = trial.feedback + np.where(trial.time >= trial.info.window_end, 0.1, 0.0)
        late.append(replace(trial, feedback=feedback))
    found = sensitivity_of(late, {("clamp_force", 2.0): on_a_line(trials, -0.5)}).of("push", "cat_food")["window"]
    shorter, longer = (found[factor] for factor in sorted(found))
    assert shorter == pytest.approx(0.0, abs=1e-9)
    assert longer > 0.5  # %; feedback that is too high is as if the reference were, and -0.5 m/s goes faster


def test_shifts_of_one_sign_add_in_squares_one_per_setting() -> None:
    shifts = (("a", 0.5, -3.0), ("a", 2.0, -1.0), ("b", 0.5, -4.0), ("b", 2.0, 0.5), ("c", 2.0, 1.2))
    found = Sensitivity(tuple(Shift("grab", "juice", *shift) for shift in shifts))
    assert found.band("grab", "juice") == pytest.approx((-5.0, 1.3))
    assert found.band("grab", "parcel") is None


def test_trials_without_a_partner_are_named_and_move_nothing(trials: list[TrialFeedback]) -> None:
    strangers = [replace(trial, info=replace(trial.info, seed=trial.info.seed + 1)) for trial in trials]
    found = sensitivity_of(trials, {("clamp_force", 2.0): strangers})
    assert not found.shifts
    assert found.missing == (("clamping force × 2", "no trial with impact to compare with"),)
    two = sensitivity_of(trials, {("clamp_force", 2.0): trials[:2]})
    assert "clamping force × 2, cat_food" in dict(two.missing)


def test_analyze_finds_the_varied_campaigns_and_gives_the_band(
    push_campaign: Path, push_analysis: Analysis, tmp_path: Path
) -> None:
    for target in (tmp_path / "push", tmp_path / "push" / folder_name("pad_stiffness", 2.0)):
        target.mkdir(parents=True)
        for path in push_campaign.iterdir():
            (target / path.name).symlink_to(path)
    analysis = analyze_campaign(tmp_path / "push")
    assert push_analysis.sets[0].estimate == analysis.sets[0].estimate
    plain = push_analysis.to_json()
    assert (plain["sets"][0]["systematic_percent"], plain["sensitivity"]) == (None, [])
    shifts = {(shift.setting, shift.factor): shift.percent for shift in analysis.sensitivity.shifts}
    assert shifts["pad_stiffness", 2.0] == pytest.approx(0.0, abs=1e-12)  # the very same trials
    low, high = analysis.to_json()["sets"][0]["systematic_percent"]
    assert low <= 0.0 <= high
    assert result_table(analysis)[0].systematic == (low, high)
