# SPDX-License-Identifier: Apache-2.0
"""What the trials that are left can decide at best."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from impact_rs_analysis.inference.ahead import probability
from impact_rs_analysis.investigation.promise import MIN_WORTHWHILE_PROBABILITY, best_decision_probability
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, PlannedPair


def plan_for(*after: float, freedom: int = 0, trials: int = 4) -> ExperimentPlan:
    """A plan that decides between rivals with these probabilities."""
    one = PlannedTrials(object="parcel", case="case_1", trials=trials)
    return ExperimentPlan(
        model="nominal",
        model_digest="",
        aim="rivals",
        method="fixed",
        budget=trials,
        freedom=freedom,
        pairs=tuple(PlannedPair(first="a", second="b", before=0.5, after=value) for value in after),
        campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(one,)),),
    )


def distinguished(root: float, freedom: int) -> float:
    """What a plan states of a distance; freedom 0: the scatter is known."""
    return float(probability(np.array(root**2), freedom or np.inf))


def test_half_the_decisions_are_made_where_the_mean_log_ratio_is_that_of_twenty() -> None:
    assert distinguished(np.sqrt(2.0 * np.log(20.0)), 0) == pytest.approx(MIN_WORTHWHILE_PROBABILITY, abs=0.01)


@pytest.mark.parametrize("freedom", [0, 2, 9])
def test_all_trials_left_promise_what_the_plan_does_and_more_with_every_further_one(freedom: int) -> None:
    """A distance that does not grow with the trials is noticed."""
    root = 1.5
    plan = plan_for(0.0, distinguished(root, freedom), freedom=freedom)
    promised = [best_decision_probability(plan, plan.trials + further) for further in range(20)]
    assert promised[0] == pytest.approx(distinguished(root, freedom))
    assert all(more > less for less, more in itertools.pairwise(promised))
    assert promised[12] == pytest.approx(distinguished(2.0 * root, freedom and freedom + 12))  # four times the trials


def test_a_plan_that_states_certainty_or_nothing_has_a_promise() -> None:
    """And one for no rivals is always worth its trials."""
    assert best_decision_probability(plan_for(1.0, freedom=3), 8) > 0.99
    assert best_decision_probability(plan_for(0.0), 60) == 0.0
    assert best_decision_probability(plan_for(0.0).model_copy(update={"aim": "effects"}), 4) == 1.0
