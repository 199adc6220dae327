"""The next best experiment: where two explanations would predict the most different things."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.search import Fit, Search
from impact_rs_analysis.evidence.rollouts import Rollout
from impact_rs_analysis.evidence.runs import Condition, Runs
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

COMPANION = "excite"


def next_experiment(
    search: Search,
    chosen: Fit | None,
    rivals: dict[str, list[Fit]],
    confusable: list[tuple[str, ...]],
    runs: Runs,
) -> dict[str, Any] | None:
    """What to measure to split the first tie; None when there is none.

    Expected information is the squared distance of the two predictions in units of the pure error: twice the expected
    log likelihood ratio of one more trial.
    """
    if chosen is None or not confusable:
        return None
    first, second = confusable[0][0], confusable[0][1]
    rival = next(fit for fit in rivals[first] if fit.candidate.effects[-1].name == second)
    best: tuple[float, Condition] | None = None
    for condition in _possible(runs):
        pair = search.store(
            [Rollout(condition, search.model, tuple(fit.candidate.split(fit.estimate))) for fit in (chosen, rival)],
            "next experiment",
        )
        if pair[0] is None or pair[1] is None:
            continue
        sigma = _sigma(search, condition)
        gain = float(np.sum(np.square((pair[0] - pair[1]) / sigma)))
        if best is None or gain > best[0]:
            best = (gain, condition)
    if best is None:
        return None
    gain, condition = best
    measured = condition in runs.conditions
    return {
        "splits": [first, second],
        "scenario": condition.scenario,
        "object": condition.object,
        "case": condition.case,
        "expected_information": gain,
        "already_measured": measured,
        "advice": (
            f"measure {condition.label} {'more often' if measured else ''}".strip()
            + f": {first} and {second} differ most there"
        ),
    }


def _possible(runs: Runs) -> list[Condition]:
    """Every condition of the measured scenarios, and of the free-motion companion."""
    specs = {condition.scenario: condition.spec for condition in runs.conditions}
    if COMPANION not in specs:
        with suppress(InputError):
            scenario = load_scenario(COMPANION)
            specs[COMPANION] = TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    return [
        Condition(replace(spec, object=thing, case=case, scale=1.0))
        for spec in specs.values()
        for thing in spec.scenario.objects
        for case in spec.scenario.cases
    ]


def _sigma(search: Search, condition: Condition) -> np.ndarray:
    count = len(condition.features)
    for item in search.evidence:
        if item.sigma.size == count:
            return item.sigma
    return np.array([feature.floor for feature in condition.features])
