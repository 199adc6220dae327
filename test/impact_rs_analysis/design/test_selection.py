# SPDX-License-Identifier: Apache-2.0
"""The choice of trials within a budget."""

import itertools
from collections.abc import Mapping

import numpy as np
import pytest

from impact_rs_analysis.design.discrimination import Discrimination
from impact_rs_analysis.design.forecast import ForecastTrial
from impact_rs_analysis.design.selection import MIN_REPEATS, Counts, chosen, most_informative
from impact_rs_analysis.diagnosis.thresholds import MIN_CLUSTERS, MIN_DEGREES_OF_FREEDOM
from impact_rs_sim.errors import InputError
from impact_rs_trials.experiment_plan import Method

from .made_up_trials import estimated_pair, trial

SPEEDS = ("at_0250", "at_0300", "at_0500", "at_0700", "at_0900")


def differing_at(speed: str, measured: int = 0) -> list[ForecastTrial]:
    """Trials at five speeds; the explanations differ at one of them only."""
    return [
        trial(name, [[0.5 * (name == speed), 0.0], [0.0, 0.0]], repeats=measured if number < 3 else 0)
        for number, name in enumerate(SPEEDS)
    ]


def random_trials(seed: int) -> list[ForecastTrial]:
    rng = np.random.default_rng(seed)
    return [
        trial(name, 0.5 * rng.normal(size=(2, 3)), [0.3 * rng.normal(size=(1, 3)) for _ in range(2)]) for name in SPEEDS
    ]


def choice(trials: list[ForecastTrial], budget: int, method: Method = "design", seed: int = 0) -> Counts:
    parameters = len(trials[0].spreads[0])
    return chosen(method, Discrimination(estimated_pair(parameters), trials), trials, budget, seed)


def utility(counts: Discrimination, picked: Mapping[str, int]) -> float:
    """With the least repeats that such a plan can have, as they are chosen."""
    return counts.utility(counts.total(picked), sum(picked.values()) // MIN_REPEATS)


def test_one_trial_is_no_plan_of_new_conditions() -> None:
    """Kills a division by no place; the plan of nothing is refused by its caller."""
    assert choice(differing_at(SPEEDS[0], measured=3), 1, "fixed") == {}


@pytest.mark.parametrize("speed", SPEEDS)
def test_where_the_rivals_differ_at_one_speed_that_speed_is_chosen(speed: str) -> None:
    measured = differing_at(speed, measured=3)
    assert list(choice(measured, 6)) == [speed]
    first = choice(differing_at(speed), 10)
    assert next(iter(first)) == speed and first[speed] == max(first.values())


@pytest.mark.parametrize(("new", "names"), [(0.6, ["at_0900"]), (0.3, ["at_0250"])])
def test_between_rivals_a_condition_that_was_not_measured_is_worth_more_than_a_repeat(
    new: float, names: list[str]
) -> None:
    """At 0.5 a repeat gains more per trial; the diagnosis compares rivals from condition to condition."""
    difference = {"at_0250": 0.5, "at_0900": new}
    trials = [
        trial(name, [[difference.get(name, 0.0), 0.0], [0.0, 0.0]], repeats=3 if number < 3 else 0)
        for number, name in enumerate(SPEEDS)
    ]
    assert list(choice(trials, 2)) == names


def test_the_order_in_which_trials_are_listed_does_not_matter() -> None:
    trials = random_trials(3)
    plans = {tuple(choice(list(order), 9).items()) for order in itertools.permutations(trials, len(trials))}
    assert len(plans) == 1


@pytest.mark.parametrize("seed", range(4))
def test_more_budget_never_distinguishes_less(seed: int) -> None:
    trials = random_trials(seed)
    counts = Discrimination(estimated_pair(1), trials)
    found = [utility(counts, choice(trials, budget)) for budget in range(6, 14)]
    assert found == sorted(found)


@pytest.mark.parametrize("seed", range(6))
def test_the_design_is_never_worse_than_chance(seed: int) -> None:
    trials = random_trials(seed)
    counts = Discrimination(estimated_pair(1), trials)
    best = utility(counts, choice(trials, 8))
    by_chance = [utility(counts, choice(trials, 8, "random", draw)) for draw in range(20)]
    assert best >= max(by_chance) - 5e-3
    assert best > np.mean(by_chance)


@pytest.mark.parametrize("method", ["design", "random", "fixed"])
def test_a_first_campaign_can_be_diagnosed(method: Method) -> None:
    for budget in (6, 7, 11):
        found = choice(random_trials(1), budget, method)
        assert sum(found.values()) == budget
        assert len(found) >= MIN_CLUSTERS
        assert sum(found.values()) - len(found) >= MIN_DEGREES_OF_FREEDOM
        assert min(found.values()) >= MIN_REPEATS


def test_conditions_and_repeats_are_what_the_diagnosis_needs() -> None:
    assert MIN_CLUSTERS * (MIN_REPEATS - 1) >= MIN_DEGREES_OF_FREEDOM


def test_a_budget_too_small_for_a_diagnosis_is_refused_with_the_least_one() -> None:
    with pytest.raises(InputError, match="at least 6"):
        choice(random_trials(0), 5)
    assert sum(choice(differing_at("at_0250", measured=3), 1).values()) == 1


def test_a_random_choice_depends_on_its_seed_alone() -> None:
    trials = random_trials(2)
    assert choice(trials, 9, "random", 4) == choice(trials[::-1], 9, "random", 4)
    assert len({tuple(choice(trials, 9, "random", seed).items()) for seed in range(8)}) > 1


def test_the_single_most_informative_trial_is_where_the_rivals_differ() -> None:
    trials = differing_at("at_0700", measured=3)
    best = most_informative(Discrimination(estimated_pair(), trials), trials)
    assert best is not None
    assert best[0].name == "at_0700"
    assert best[1] == pytest.approx(0.5**2)
