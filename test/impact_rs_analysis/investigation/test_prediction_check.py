# SPDX-License-Identifier: Apache-2.0
"""A prediction against the trials that were measured after it, and these alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis.document import ModelIdentity
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.investigation.prediction_check import ImpactPrediction, Predictions, predicted, prediction_error
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.spec import TrialSpec

PARCEL = TrialSpec.of(load_scenario("push"), "parcel", "case_1")


@pytest.fixture(scope="module")
def source(hidden_campaign: Path) -> ReplaySource:
    """The nominal model against trials on a support that is rougher than it says."""
    return ReplaySource.of(read_runs(hidden_campaign, map), load_model("nominal"), ReplayCache(map))


def said(source: ReplaySource, *impacts: ImpactPrediction) -> Predictions:
    return Predictions(model=ModelIdentity(name="nominal", digest=source.model.digest), impacts=impacts)


def test_the_error_is_that_of_the_round_alone(source: ReplaySource, hidden_campaign: Path) -> None:
    """Friction of the support shows in pushes and not in free motion."""
    pushes = prediction_error(source, hidden_campaign / "push", said(source))
    free = prediction_error(source, hidden_campaign / "excite", said(source))
    assert (pushes.trials, free.trials) == (4, 2)
    assert pushes.unit == free.unit == "times repeatability"
    assert pushes.error is not None and free.error is not None
    assert free.error < 2.0 < 5.0 < pushes.error
    assert free.error < source.size() < pushes.error
    assert free.p_value is not None and pushes.p_value is not None
    assert pushes.p_value < 0.01 < free.p_value
    assert pushes.p_value_of_all == pushes.p_value_of_first == free.p_value_of_all < 0.01


def test_velocities_after_the_impact_are_measured_beside_what_was_predicted(
    source: ReplaySource, hidden_campaign: Path
) -> None:
    """The impact itself is that of the model, whatever was predicted: here an end effector that comes back."""
    truth = predicted(load_model("nominal"), PARCEL)
    wrong = truth.model_copy(update={"arm": 0.3})
    (found,) = prediction_error(source, hidden_campaign / "push", said(source, wrong)).impacts
    assert (found.condition, found.trials, found.predicted) == ("push/parcel/case_1", 2, wrong)
    assert found.arm == pytest.approx(truth.arm, abs=0.04)
    assert found.object == pytest.approx(truth.object, abs=0.04)


def test_the_folder_may_be_named_from_where_one_is(
    source: ReplaySource, hidden_campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hidden_campaign)
    assert prediction_error(source, Path("push"), said(source)).trials == 4


def test_a_round_without_a_usable_trial_has_no_error(source: ReplaySource, hidden_campaign: Path) -> None:
    found = prediction_error(source, hidden_campaign / "nothing", said(source, predicted(source.model, PARCEL)))
    assert (found.trials, found.error, found.impacts) == (0, None, ())
