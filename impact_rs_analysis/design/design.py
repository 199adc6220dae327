# SPDX-License-Identifier: Apache-2.0
"""Experiment design: from a model and a budget to a plan of trials with its expected information."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from impact_rs_analysis.design.discrimination import Discrimination
from impact_rs_analysis.design.explanations import Decision, which_effect
from impact_rs_analysis.design.forecast import Forecast, ForecastTrial, forecast_of
from impact_rs_analysis.design.possible_trials import NO_ENVELOPE, Envelope, PossibleTrial, possible_trials
from impact_rs_analysis.design.selection import MIN_REPEATS, Counts, chosen, missing_conditions
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.replays.replay_cache import Progress, ReplayCache
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.inference.belief import Belief
from impact_rs_sim.effects.base import SINGLE_IMPACT
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, Method, PlannedCampaign, PlannedPair
from impact_rs_trials.workers import Map

MIN_DISTINGUISHED_PROBABILITY = 0.95  # of a pair that counts as distinguished
MIN_SEEN_CHANGE = 1e-3  # in scaled features: a noticeable effect that changes less is not seen
MAX_LISTED_PAIRS = 20  # in a plan, least certain first
MAX_NAMED_PAIRS = 3  # in a sentence

Decide = Callable[[Source], Decision]


def missing_effect(names: Sequence[str] = (), whether_any: bool = False) -> Decide:
    """The decision which effect is missing, among the effects that a model lacks and that trials show.

    Args:
        names: Effects to consider; empty: the library and the formulas of the model.
        whether_any: Decide whether any effect is missing, no matter which.
    """

    def decide(source: Source) -> Decision:
        present = {item.name for item in source.model.effects}
        possible = [
            effect.in_proportion(source.proportion)
            for name, effect in source.known_effects.items()
            if name not in present
            and (not names or name in names)
            and source.offers(effect)
            and effect.phases != SINGLE_IMPACT
        ]
        return which_effect(possible, source.joints, source.worlds, whether_any)

    return decide


WHICH_EFFECT = missing_effect()


def design(
    model: Model,
    scenarios: Sequence[str],
    budget: int,
    map_tasks: Map,
    decide: Decide = WHICH_EFFECT,
    runs: Runs | None = None,
    method: Method = "design",
    envelope: Envelope = NO_ENVELOPE,
    seed: int = 0,
    progress: Progress | None = None,
) -> ExperimentPlan:
    """The most informative trials for the coming decision.

    Args:
        model: Model that predicts them.
        scenarios: Names or paths of scenarios that the cell can run.
        budget: Largest number of trials.
        map_tasks: Parallel map.
        decide: Decision to be made, from a source with the model and all physics.
        runs: Trials measured so far, for their scatter and information.
        method: How trials are chosen.
        envelope: Envelope of the cell.
        seed: Seed of the planned trials, and of a random choice. Another plan for the same folder needs another seed.
        progress: Called with (what, done, total).

    Raises:
        InputError: No such scenario, too small a budget, no trial within the limits, or nothing to decide.
    """
    missing_conditions(budget, 0 if runs is None else len(runs.conditions))  # refused before minutes of simulation
    trials = possible_trials(scenarios, envelope)
    forecast = forecast_of(model, trials, ReplayCache(map_tasks, progress), envelope, runs, seed)
    return planned(forecast, decide(forecast.source), budget, method, seed)


def planned(
    forecast: Forecast, decision: Decision, budget: int, method: Method = "design", seed: int = 0
) -> ExperimentPlan:
    """A plan from simulated trials; arguments and errors as :func:`design`."""
    model = forecast.source.model
    trials = forecast.under(decision)
    can_run = [trial for trial in trials if trial.trial is not None]
    if not can_run:
        raise InputError("no possible trial has an impact under every explanation")
    unseen = _unseen(decision, trials)
    seen_pairs = tuple(pair for pair in decision.pairs if not unseen & set(pair))
    decision = replace(decision, pairs=seen_pairs or decision.pairs)
    counts = Discrimination(decision, trials)
    picked = chosen(method, counts, can_run, budget, seed)
    if not picked:
        raise InputError(
            f"no trial fits: a new condition needs {MIN_REPEATS} trials, and no measured one can be planned again",
            key="--budget",
            value=budget,
        )
    before = counts.total(counts.counted)
    after = counts.total(counts.with_more(picked))
    freedom_before, freedom_after = counts.freedom({}), counts.freedom(picked)
    pairs = _pairs(decision, counts.probabilities(before, freedom_before), counts.probabilities(after, freedom_after))
    words = {name: _buys(counts, decision, after, picked, name) for name in picked}
    names = [decision.explanations[number].name for number in sorted(unseen)]
    return ExperimentPlan(
        model=model.name,
        model_digest=model.containing(()).digest,  # without formulas that explanations alone use
        aim=decision.aim,
        method=method,
        budget=budget,
        seed=seed,
        freedom=int(freedom_after),
        summary=_summary(decision, pairs, picked, counts.information(after) if decision.aim == "parameters" else 0.0)
        + (f"; no possible trial shows {', '.join(names)}" if names else ""),
        pairs=tuple(pairs[:MAX_LISTED_PAIRS]),
        campaigns=_campaigns({trial.name: trial for trial in can_run}, picked, words),
    )


def _unseen(decision: Decision, trials: Sequence[ForecastTrial]) -> set[int]:
    """Indices of explanations without estimates that change no feature of any trial, for example a drift over weeks."""
    return {
        number
        for number, explanation in enumerate(decision.explanations)
        if explanation.varied
        and not explanation.estimated
        and max(float(np.max(np.abs(trial.spreads[number]))) for trial in trials) < MIN_SEEN_CHANGE
    }


def _pairs(decision: Decision, before: Array, after: Array) -> list[PlannedPair]:
    """Pairs with the probability that the next diagnosis distinguishes them, least certain first."""
    rows = [
        PlannedPair(
            first=decision.explanations[i].name,
            second=decision.explanations[j].name,
            before=float(f"{was:.4g}"),  # small ones, too: the report extrapolates from them to all trials
            after=float(f"{now:.4g}"),
        )
        for (i, j), was, now in zip(decision.pairs, before, after, strict=True)
    ]
    return sorted(rows, key=lambda pair: pair.after)


def _campaigns(trials: dict[str, ForecastTrial], picked: Counts, words: dict[str, str]) -> tuple[PlannedCampaign, ...]:
    """The chosen trials by variant of a scenario, each with the cases that it uses."""
    groups: dict[str, list[tuple[PossibleTrial, str]]] = {}
    for name in picked:
        trial = trials[name].trial
        assert trial is not None
        groups.setdefault(trial.spec.scenario.name, []).append((trial, name))
    campaigns = []
    for folder, conditions in groups.items():
        first = conditions[0][0]
        settings: dict[str, Any] = dict(first.settings)
        for trial, _ in conditions:
            if trial.new_case is not None:
                settings[f"cases.{trial.spec.case}"] = trial.new_case.model_dump(mode="json")
        campaigns.append(
            PlannedCampaign(
                folder=folder,
                scenario=first.scenario,
                settings=settings,
                conditions=tuple(
                    PlannedTrials(
                        object=trial.spec.object,
                        case=trial.spec.case,
                        scale=trial.spec.scale,
                        trials=picked[name],
                        what=trial.what,
                        buys=words[name],
                    )
                    for trial, name in conditions
                ),
            )
        )
    return tuple(campaigns)


def _buys(counts: Discrimination, decision: Decision, total: Belief, picked: Counts, name: str) -> str:
    """Marginal gain of the trials of one condition, given all others of the plan."""
    before, repeats = counts.counted.get(name, 0), picked[name]
    without = counts.added(total, name, before + repeats, before)
    trial = counts.trial(name)
    times = f"{repeats} x {name if trial is None else trial.what}"
    if decision.aim == "parameters":
        gained = counts.information(total) - counts.information(without)
        return f"{times} add {gained:.2g} nat of information on the parameters"
    other_picks = {condition: repeats for condition, repeats in picked.items() if condition != name}
    now = counts.probabilities(total, counts.freedom(picked))
    less = counts.probabilities(without, counts.freedom(other_picks))
    best = int(np.argmax(now - less))
    i, j = decision.pairs[best]
    first, second = decision.explanations[i].name, decision.explanations[j].name
    return f"{times} distinguish {first} from {second} with {_percent(now[best])}, without them {_percent(less[best])}"


def _summary(decision: Decision, pairs: Sequence[PlannedPair], picked: Counts, information: float) -> str:
    """Expected information of the plan in a sentence."""
    trials = f"{sum(picked.values())} trials of {len(picked)} condition{'s' if len(picked) > 1 else ''}"
    if decision.aim == "parameters":
        return f"{trials}: {information:.2g} nat of information on the parameters of {decision.explanations[0].name}"
    sure = [pair for pair in pairs if pair.after >= MIN_DISTINGUISHED_PROBABILITY]
    open_pairs = [pair for pair in pairs if pair.after < MIN_DISTINGUISHED_PROBABILITY]
    if len(pairs) <= MAX_NAMED_PAIRS:
        message = "; ".join(f"{pair.first} from {pair.second} with {_percent(pair.after)}" for pair in pairs)
        return f"{trials} distinguish {message}"
    listed = ", ".join(
        f"{pair.first} from {pair.second} ({_percent(pair.after)})" for pair in open_pairs[:MAX_NAMED_PAIRS]
    )
    uncertain = f"; least certain: {listed}" if listed else ""
    return (
        f"{trials} distinguish {len(sure)} of {len(pairs)} pairs of explanations "
        f"with {MIN_DISTINGUISHED_PROBABILITY:.0%} or more{uncertain}"
    )


def _percent(value: float) -> str:
    """A probability in percent, never rounded to certainty."""
    return f"{min(100.0 * value, 99.9):.3g} %"
