# SPDX-License-Identifier: Apache-2.0
"""What the trials that are left can decide at best."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from impact_rs_analysis.investigation.promise import (
    RATIO,
    WORTHWHILE,
    Probability,
    likelier_is_right,
    promise,
    told_apart,
)
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


@pytest.mark.parametrize("root", [1.0, 2.0, 2.5, 4.0])
def test_a_likelihood_ratio_beyond_twenty_is_as_probable_as_stated(root: float) -> None:
    """One normal value, whose mean two explanations dispute: another hurdle leaves the band of 5 standard errors."""
    values = np.random.default_rng(0).standard_normal(200_000) + root
    ratios = (np.square(values) - np.square(values - root)) / 2.0
    share = np.mean(np.abs(ratios) > np.log(RATIO))
    assert told_apart(root, 0) == pytest.approx(share, abs=5.0 * np.sqrt(0.25 / values.size))


@pytest.mark.parametrize("freedom", [3, 6])
def test_half_the_decisions_are_made_at_the_same_distance_whatever_the_freedom(freedom: int) -> None:
    """Where the hurdle equals half the distance, Student's distribution and the normal one are equal: 50 %."""
    root = np.sqrt(2.0 * np.log(RATIO))
    assert told_apart(root, freedom) == pytest.approx(WORTHWHILE, abs=0.06)
    assert likelier_is_right(root, 0) == pytest.approx(0.89, abs=0.005)


@pytest.mark.parametrize("freedom", [0, 2, 9])
@pytest.mark.parametrize("stated", [likelier_is_right, told_apart])
def test_all_trials_left_promise_what_the_plan_does_and_more_with_every_further_one(
    freedom: int, stated: Probability
) -> None:
    """Whichever of the two probabilities a plan states; a distance that does not grow with the trials is noticed."""
    root = 3.0
    plan = plan_for(0.5, stated(root, freedom), freedom=freedom)
    promised = [promise(plan, plan.trials + further, stated) for further in range(20)]
    assert promised[0] == pytest.approx(told_apart(root, freedom))
    assert all(more > less for less, more in itertools.pairwise(promised))
    more = freedom and freedom + 12
    assert promised[12] == pytest.approx(told_apart(2.0 * root, more))  # four times the trials


def test_a_plan_that_states_certainty_or_nothing_has_a_promise() -> None:
    """And one for no rivals is always worth its trials."""
    assert promise(plan_for(1.0, freedom=3), 8) > 0.99
    assert promise(plan_for(0.5), 60) == 0.0
    assert promise(plan_for(0.5).model_copy(update={"aim": "effects"}), 4) == 1.0
