"""The measure: an integral of a held signal, and trials that must not enter a fit."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.net_feedback import held_integral, net_feedback
from impact_rs_trials.bags.reader import BagError, TrialBag


def test_the_integral_of_a_held_signal_is_exact() -> None:
    time = np.array([0.0, 0.1, 0.25, 0.4, 0.5])
    signal = np.array([1.0, 2.0, -1.0, 4.0, 8.0])
    course, total = held_integral(time, signal, 0.05, 0.45)
    assert total == pytest.approx(1.0 * 0.05 + 2.0 * 0.15 - 1.0 * 0.15 + 4.0 * 0.05)
    np.testing.assert_allclose(course, [0.0, 0.05, 0.35, 0.2, total])


def test_the_integral_stops_at_the_end_of_the_window() -> None:
    course, total = held_integral(np.linspace(0.0, 1.0, 11), np.ones(11), 0.2, 0.5)
    assert total == pytest.approx(0.3)
    assert course[-1] == pytest.approx(0.3)


def test_the_analysis_gets_what_the_controller_integrated(push_campaign: Path) -> None:
    for path in push_campaign.glob("cat_food__*"):
        bag = TrialBag(path)
        assert net_feedback(bag).net == pytest.approx(bag.controller("arm").net_feedback[-1, 1], abs=1e-12)


def test_a_trial_hits_near_the_nominal_time(push_campaign: Path) -> None:
    trial = net_feedback(TrialBag(push_campaign / "cat_food__case_2__s1.000__r0"))
    assert trial.impact
    assert trial.impact_times[0] == pytest.approx(trial.info.nominal_impact_time, abs=0.02)


def test_a_trial_without_detected_impact_is_flagged(push_campaign: Path, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(
        push_campaign / "cat_food__case_2__s1.000__r0", tmp_path / "bag", lambda topic: "impact_event" not in topic
    )
    assert not net_feedback(TrialBag(tmp_path / "bag")).impact


def test_a_bag_without_controller_states_is_refused(push_campaign: Path, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(
        push_campaign / "cat_food__case_2__s1.000__r0", tmp_path / "bag", lambda topic: "controller_state" not in topic
    )
    with pytest.raises(BagError, match="controller states"):
        net_feedback(TrialBag(tmp_path / "bag"))


def test_a_truncated_bag_is_refused(push_campaign: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(push_campaign / "cat_food__case_2__s1.000__r0", bag)
    file = next(bag.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(BagError):
        net_feedback(TrialBag(bag))
