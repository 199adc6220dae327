# SPDX-License-Identifier: Apache-2.0
"""Choice of trials within a budget: greedy, random, or the cases of the scenarios as they stand.

Greedy: the next choice is the one with the largest gain of utility per trial. A condition that was not measured costs
two trials at first, because without a repeat it has no scatter of its own. The first conditions of a campaign are
distinct, because a diagnosis holds conditions out. Between rivals a diagnosis compares errors by condition, and repeats
add no condition: a new condition is taken if it gains at least half as much as the best repeat. More budget never
informs less.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from impact_rs_analysis.design.discrimination import Discrimination
from impact_rs_analysis.design.forecast import ForecastTrial
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS
from impact_rs_sim.errors import InputError
from impact_rs_trials.experiment_plan import Method

MIN_REPEATS = 2  # of a new condition: a single trial has no scatter
NEW_CONDITION_GAIN_SHARE = 0.5  # of the gain of the best repeat, from which a new condition is taken between rivals

Counts = dict[str, int]


def chosen(
    method: Method, counts: Discrimination, trials: Sequence[ForecastTrial], budget: int, seed: int = 0
) -> Counts:
    """Further repeats by condition, in the order of the choice.

    Args:
        method: How they are chosen.
        counts: Information of the trials.
        trials: Trials that can be planned.
        budget: Largest number.
        seed: Seed of a random choice.

    Raises:
        InputError: The budget is too small for a diagnosis, or too few conditions can be planned.
    """
    missing = missing_conditions(budget, len(counts.measured))
    if len(trials) < max(missing, 1):
        raise InputError(
            f"{len(trials)} condition(s) can be planned within the limits, at least {max(missing, 1)} are needed; name "
            "further scenarios, or raise a limit"
        )
    by_name = sorted(trials, key=lambda trial: trial.name)
    if method == "random":
        return _random(by_name, counts.measured, budget, missing, np.random.default_rng(seed))
    if method == "fixed":
        return _fixed(by_name, counts.measured, budget)
    return _greedy(by_name, counts, budget, missing)


def missing_conditions(budget: int, measured: int) -> int:
    """Number of new conditions that a plan must have.

    Args:
        budget: Largest number of trials.
        measured: Number of conditions measured so far.

    Raises:
        InputError: The budget is too small for them.
    """
    missing = max(MIN_CLUSTERS - measured, 0)
    least = max(MIN_REPEATS * missing, 1)
    if budget < least:
        raise InputError(
            f"{budget} trial(s) are too few: "
            f"a diagnosis needs {MIN_CLUSTERS} conditions with {MIN_REPEATS} trials each, "
            f"{missing} of them to come; expected at least {least}, or --runs with earlier trials",
            key="--budget",
        )
    return missing


def _greedy(trials: Sequence[ForecastTrial], counts: Discrimination, budget: int, missing: int) -> Counts:
    """Repeats by condition, each choice with the largest gain of utility per trial."""
    names = [trial.name for trial in trials]
    measured = counts.measured
    picked: Counts = {}
    total = counts.total(counts.counted)
    freedom = counts.freedom({}) + budget // MIN_REPEATS  # at least so many, whichever trials are chosen
    utility = counts.utility(total, freedom)
    budget_left = budget
    while budget_left > 0:
        gains = []
        for name, cost in _options(names, measured, picked, budget_left, missing):
            before = counts.counted.get(name, 0) + picked.get(name, 0)
            gain = (counts.utility(counts.added(total, name, before, before + cost), freedom) - utility) / cost
            gains.append((gain, name, cost))
        if not gains:
            break
        gain, name, cost = _largest(gains)
        new = [option for option in gains if option[1] not in measured and option[1] not in picked]
        if counts.decision.aim == "rivals" and new and _largest(new)[0] >= NEW_CONDITION_GAIN_SHARE * gain:
            _, name, cost = _largest(new)
        picked[name] = picked.get(name, 0) + cost
        budget_left -= cost
        total = counts.total(counts.with_more(picked))
        utility = counts.utility(total, freedom)
    return picked


def _largest(gains: Sequence[tuple[float, str, int]]) -> tuple[float, str, int]:
    """The first choice with the largest gain, up to rounding."""
    most = max(gain for gain, _, _ in gains)
    return next(option for option in gains if option[0] >= most - 1e-9 * abs(most))


def _options(
    names: Sequence[str], measured: Mapping[str, int], picked: Mapping[str, int], budget_left: int, missing: int
) -> Iterator[tuple[str, int]]:
    """Conditions that may be chosen next, with their number of trials."""
    new = sum(name not in measured for name in picked)
    for name in names:
        repeated = name in measured or name in picked
        if new < missing and repeated:
            continue
        cost = 1 if repeated else MIN_REPEATS
        if cost <= budget_left:
            yield name, cost


def _random(
    trials: Sequence[ForecastTrial], measured: Mapping[str, int], budget: int, missing: int, rng: np.random.Generator
) -> Counts:
    names = [trial.name for trial in trials]
    picked: Counts = {}
    budget_left = budget
    while options := list(_options(names, measured, picked, budget_left, missing)):
        name, cost = options[rng.integers(len(options))]
        picked[name] = picked.get(name, 0) + cost
        budget_left -= cost
    return picked


def _fixed(trials: Sequence[ForecastTrial], measured: Mapping[str, int], budget: int) -> Counts:
    """Cases as the scenario files have them, in equal shares; with too few trials for all, spread over them."""
    of_files = [trial for trial in trials if trial.trial is not None and trial.trial.of_file] or list(trials)
    least = 1 if all(trial.name in measured for trial in of_files) else MIN_REPEATS
    many = min(len(of_files), budget // least)
    if not many:
        return {}
    indices = np.unique(np.linspace(0, len(of_files) - 1, many).round().astype(int))
    share, more = divmod(budget, len(indices))
    return {of_files[index].name: share + (number < more) for number, index in enumerate(indices)}


def most_informative(counts: Discrimination, trials: Sequence[ForecastTrial]) -> tuple[ForecastTrial, float] | None:
    """The single further trial with the largest gain in squared distance between two estimated explanations.

    Args:
        counts: Information of the trials about the only pair of a decision.
        trials: Trials to choose from.

    Returns:
        The trial and its gain [-]; None without trials.
    """
    before = counts.total(counts.counted)
    gain_before = counts.gains(before)[0][0][0]

    def gain(trial: ForecastTrial) -> float:
        repeats = counts.counted.get(trial.name, 0)
        return float(counts.gains(counts.added(before, trial.name, repeats, repeats + 1))[0][0][0] - gain_before)

    candidates = [(trial, gain(trial)) for trial in sorted(trials, key=lambda trial: trial.name)]
    return max(candidates, key=lambda candidate: candidate[1], default=None)
