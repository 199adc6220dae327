"""Diagnosis: compare, search, and say what can be said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import t as student

from impact_rs_analysis.diagnosis.search import LEAST_EXCESS, LEAST_GAIN, MOST_EFFECTS, SIGNIFICANT, Fit, Search
from impact_rs_analysis.evidence.clusters import ConditionEvidence, gather, rescale
from impact_rs_analysis.evidence.rollouts import Added, Progress, RolloutStore, residuals
from impact_rs_analysis.evidence.runs import Runs
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_trials.workers import Map

UNSEEN = 20.0  # parameter scales; an interval wider than this says nothing
TIE = 0.05  # difference in log error below which two explanations are the same


@dataclass(frozen=True)
class ParameterEstimate:
    """One estimated number."""

    name: str
    estimate: float
    low: float
    high: float
    unit: str
    nominal: float
    meaning: str


@dataclass(frozen=True)
class EffectReport:
    """What the diagnosis says of one effect.

    Attributes:
        name: Effect.
        sentence: What it is.
        verdict: CONFIRMED, CONFUSABLE-WITH{...}, NOT-IDENTIFIABLE, NO-IMPROVEMENT or AT-BOUND.
        parameters: Estimates with 95 % intervals.
        before: Held-out error without it, in multiples of the scale of repetition.
        after: Held-out error with it.
        p_value: Adjusted for looking at all effects.
    """

    name: str
    sentence: str
    verdict: str
    parameters: tuple[ParameterEstimate, ...]
    before: float
    after: float
    p_value: float


@dataclass(frozen=True)
class Diagnosis:
    """The answer.

    Attributes:
        verdict: NOTHING-MISSING, NONE-EXPLAINS, or the confirmed effects joined by ``+``.
        effects: Reports, best first.
        confusable: Sets of effects that the data cannot tell apart.
        noise: Held-out error that pure error alone would give.
        before: Held-out error of the model.
        after: Held-out error with the chosen effects.
        lack_of_fit_before: p of the model's residuals being pure error.
        lack_of_fit_after: The same with the chosen effects.
        unexplained: Where the largest remaining differences sit.
        identifiability: Singular values and correlations of the chosen fit.
        next_experiment: What would split a tie, or None.
        remarks: What a reader should know.
    """

    verdict: str
    effects: tuple[EffectReport, ...]
    confusable: tuple[tuple[str, ...], ...]
    noise: float
    before: float
    after: float
    lack_of_fit_before: float
    lack_of_fit_after: float
    unexplained: dict[str, Any]
    identifiability: dict[str, Any]
    next_experiment: dict[str, Any] | None
    remarks: tuple[str, ...] = field(default=())


def diagnose(
    runs: Runs,
    model: Model,
    map_tasks: Map,
    progress: Progress | None = None,
    only: list[str] | None = None,
) -> Diagnosis:
    """Find out which effects are missing in a model.

    Args:
        runs: Measurements.
        model: What we believe so far; effects it has are not tried again.
        map_tasks: Parallel map.
        progress: Called with (what, done, total).
        only: Names of the effects to consider; None: all.

    Raises:
        InputError: Too few conditions or repeats to hold one out.
    """
    if len(runs.conditions) < 3:
        raise InputError(
            f"{len(runs.conditions)} condition(s) measured ({', '.join(c.label for c in runs.conditions)}): "
            "at least 3 are needed to hold one out; `impact-rs compare` still shows where the model fails",
            file=runs.directory,
        )
    store = RolloutStore(map_tasks, progress)
    evidence = gather(runs, residuals(runs, model, store))
    known = model.known_effects
    present = {item.name for item in model.effects}
    effects = [known[name] for name in known if name not in present and (only is None or name in only)]

    def measure_again(added: Added) -> list[ConditionEvidence] | None:
        try:
            return rescale(runs, residuals(runs, model, store, added), evidence)
        except InputError:
            return None

    search = Search(effects, model, evidence, store, measure_again)
    chosen, rivals = choose(search)
    return _report(search, known, chosen, rivals, runs)


def choose(search: Search) -> tuple[Fit | None, dict[str, list[Fit]]]:
    """Forward selection with pairs; returns the chosen fit and, per chosen effect, its refined rivals."""
    chosen: Fit | None = None
    rivals: dict[str, list[Fit]] = {}
    errors = search.before
    for _ in range(MOST_EFFECTS):
        p_values = search.p_values if chosen is None else search.p_values_given(chosen)
        excess = search.excess(errors)
        needed = max(LEAST_GAIN * excess, LEAST_EXCESS)
        shortlist = search.shortlist(chosen)
        if excess <= 2.0 * LEAST_EXCESS or chosen is not None:
            # What is small is linear: a proposal that gains nothing there will not gain by being fitted properly.
            shortlist = [entry for entry in shortlist if excess - search.excess(entry.held_out) > 0.5 * needed]
        if not shortlist:
            break
        proposals = search.proposals(shortlist)
        best = proposals[0]
        newest = best.candidate.effects[-1].name
        significant = p_values.get(newest, 1.0) < SIGNIFICANT
        gains = excess - search.excess(best.held_out) > needed
        if not (significant and gains):
            break
        chosen = search.measure_again(best)
        rivals[newest] = [chosen, *(_measured(search, best, rival, chosen) for rival in proposals[1:])]
        errors = chosen.held_out
        if search.lack_of_fit_of(chosen) > SIGNIFICANT:
            break
    if chosen is not None and len(chosen.candidate.effects) >= 2:
        chosen = _try_pairs(search, chosen)
    return chosen, rivals


def _try_pairs(search: Search, chosen: Fit) -> Fit:
    """A pair found together may beat one found step by step."""
    for candidate in search.best_pairs():
        if set(candidate.names) <= set(chosen.candidate.names):
            continue
        pair = search.refine(candidate)
        if pair.score < 0.9 * chosen.score:
            chosen = search.measure_again(pair)
    return chosen


def _measured(search: Search, best: Fit, rival: Fit, chosen: Fit) -> Fit:
    """A rival that looks as good is checked trial by trial, too; one that is worse stays so."""
    return search.measure_again(rival) if _tied(search, best, rival) or _tied(search, chosen, rival) else rival


def _tied(search: Search, best: Fit, rival: Fit) -> bool:
    """Whether a rival predicts unseen conditions as well: mean log ratio of errors within two standard errors of 0.

    Conditions that neither of them changes say nothing about it.
    """
    floor = search.noise / 2.0
    ratio = np.log((rival.held_out + floor) / (best.held_out + floor))
    moved = np.abs(best.held_out - search.before) + np.abs(rival.held_out - search.before) > LEAST_EXCESS / 10.0
    ratio = ratio[moved] if np.any(moved) else ratio
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size)) if ratio.size > 1 else math.inf
    return float(ratio.mean()) < max(TIE, min(2.0 * spread, 0.25))


def _report(
    search: Search, known: dict[str, Effect], chosen: Fit | None, rivals: dict[str, list[Fit]], runs: Runs
) -> Diagnosis:
    before = search.before
    names = chosen.candidate.names if chosen is not None else ()
    confusable: list[tuple[str, ...]] = []
    for name in names:
        assert chosen is not None
        tied = [
            rival.candidate.effects[-1].name
            for rival in rivals.get(name, [])[1:]
            if rival.candidate.effects[-1].name not in names and _tied(search, rivals[name][0], rival)
        ]
        if tied:
            confusable.append((name, *tied))
    reports = []
    for name in names:
        assert chosen is not None
        group = next((set(group) - {name} for group in confusable if group[0] == name), set())
        reports.append(_effect_report(search, known[name], chosen, name, group))
    rest = sorted((name for name in search.fits if name not in names), key=lambda name: search.fits[name].score)
    partners = {other: group for group in confusable for other in group[1:]}
    for name in rest:
        group = set(partners.get(name, ())) - {name}
        reports.append(_unchosen_report(search, known[name], search.fits[name], group))
    after = before if chosen is None else chosen.held_out
    lack_before, lack_after = search.lack_of_fit, search.lack_of_fit_of(chosen)
    remaining = search.excess(after) / max(search.excess(before), 1e-12)
    if chosen is None:
        excess = search.excess(before)
        verdict = "NONE-EXPLAINS" if lack_before < SIGNIFICANT and excess > 2.0 * LEAST_EXCESS else "NOTHING-MISSING"
    elif lack_after < SIGNIFICANT and search.excess(after) > 2.0 * LEAST_EXCESS and remaining > 0.1:
        verdict = "NONE-EXPLAINS"
    else:
        verdict = "+".join(names)
    remarks = _remarks(search, chosen, verdict, remaining)
    from impact_rs_analysis.diagnosis.experiment import next_experiment

    return Diagnosis(
        verdict=verdict,
        effects=tuple(reports),
        confusable=tuple(confusable),
        noise=_root(search.noise),
        before=_root(before),
        after=_root(after),
        lack_of_fit_before=lack_before,
        lack_of_fit_after=lack_after,
        unexplained=_unexplained(search.evidence, chosen),
        identifiability=_identifiability(chosen),
        next_experiment=next_experiment(search, chosen, rivals, confusable, runs),
        remarks=tuple(remarks),
    )


def _root(errors: Array) -> float:
    return float(math.sqrt(errors.mean()))


def _estimates(fitted: Fit, name: str) -> tuple[ParameterEstimate, ...]:
    """Estimates of one effect; intervals from the sandwich covariance and the pure error's degrees of freedom."""
    candidate = fitted.candidate
    width = student.ppf(0.975, max(fitted.equations.freedom, 1))
    spread = fitted.equations.spread() * candidate.scale * width
    estimate = fitted.estimate
    result, start = [], 0
    for effect in candidate.effects:
        scalars = effect.scalars(7)
        if effect.name == name:
            for scalar, value, half in zip(
                scalars, estimate[start : start + len(scalars)], spread[start : start + len(scalars)], strict=True
            ):
                result.append(
                    ParameterEstimate(
                        scalar.name,
                        float(value),
                        float(value - half),
                        float(value + half),
                        scalar.unit,
                        scalar.nominal,
                        scalar.meaning,
                    )
                )
        start += len(scalars)
    return tuple(result)


def _widths(fitted: Fit, name: str) -> Array:
    """Half widths of the intervals of one effect in parameter scales."""
    scale = {scalar.name: scalar.scale for effect in fitted.candidate.effects for scalar in effect.scalars(7)}
    return np.array([(p.high - p.low) / 2.0 / scale[p.name] for p in _estimates(fitted, name)])


def _at_bound(fitted: Fit, name: str) -> bool:
    """Whether an estimate stops at a bound that is not its nominal value."""
    bounds = {scalar.name: scalar for effect in fitted.candidate.effects for scalar in effect.scalars(7)}
    return any(
        abs(p.estimate - bound) < 1e-6 * bounds[p.name].scale and abs(bound - p.nominal) > 1e-9
        for p in _estimates(fitted, name)
        for bound in (bounds[p.name].lower, bounds[p.name].upper)
        if p.name not in ("com_x", "com_y", "com_z", "stribeck_velocity")
    )


def _effect_report(search: Search, effect: Effect, chosen: Fit, name: str, group: set[str]) -> EffectReport:
    verdict = "CONFIRMED"
    if group:
        verdict = f"CONFUSABLE-WITH{{{', '.join(sorted(group))}}}"
    if _at_bound(chosen, name):
        verdict = "AT-BOUND"
    if np.all(_widths(chosen, name) > UNSEEN):
        verdict = "NOT-IDENTIFIABLE"
    return EffectReport(
        name,
        effect.sentence,
        verdict,
        _estimates(chosen, name),
        _root(search.before),
        _root(chosen.held_out),
        search.p_values[name],
    )


def _unchosen_report(search: Search, effect: Effect, fitted: Fit, group: set[str]) -> EffectReport:
    verdict = "NO-IMPROVEMENT"
    if np.all(_widths(fitted, effect.name) > UNSEEN):
        verdict = "NOT-IDENTIFIABLE"
    if group:
        verdict = f"CONFUSABLE-WITH{{{', '.join(sorted(group))}}}"
    return EffectReport(
        effect.name,
        effect.sentence,
        verdict,
        _estimates(fitted, effect.name),
        _root(search.before),
        _root(fitted.held_out),
        search.p_values[effect.name],
    )


def _remarks(search: Search, chosen: Fit | None, verdict: str, remaining: float) -> list[str]:
    remarks = []
    if chosen is not None and verdict == "NONE-EXPLAINS":
        remarks.append(
            f"{', '.join(chosen.candidate.names)} helps, but {100.0 * remaining:.0f} % of the excess error stays: "
            "something else is missing, too"
        )
    if not any(not item.condition.plan.expects_impact for item in search.evidence):
        remarks.append(
            "no free motion there and back was measured: friction, torque offset and torque gain look alike in a push"
        )
    if search.ruled_out:
        names = ", ".join(sorted(search.ruled_out))
        remarks.append(f"free motion rules them out, so they were not tried in contact: {names}")
    single = [item.condition.label for item in search.evidence if item.count < 2]
    if single:
        remarks.append(f"not repeated, so without pure error of their own: {', '.join(single)}")
    return remarks


def _unexplained(evidence: list[ConditionEvidence], chosen: Fit | None, count: int = 10) -> dict[str, Any]:
    """Where the largest remaining differences sit: phase x signal x index, mean square over conditions and bins."""
    cells: dict[tuple[str, str, str], list[float]] = {}
    for number, item in enumerate(evidence):
        rest = item.mean
        if chosen is not None:
            rest = chosen.equations.targets[number] - chosen.candidate.jacobians[number] @ chosen.change
        for feature, value in zip(item.condition.features, rest, strict=True):
            cells.setdefault((feature.phase, feature.signal, feature.index), []).append(float(value))
    total = sum(float(np.sum(np.square(values))) for values in cells.values())
    ranked = sorted(cells.items(), key=lambda entry: -float(np.sum(np.square(entry[1]))))[:count]
    return {
        "where": [
            {
                "phase": phase,
                "signal": signal,
                "index": index,
                "share": float(np.sum(np.square(values))) / max(total, 1e-300),
                "times_noise": float(math.sqrt(np.mean(np.square(values)))),
            }
            for (phase, signal, index), values in ranked
        ]
    }


def _identifiability(chosen: Fit | None) -> dict[str, Any]:
    if chosen is None:
        return {}
    stacked = np.vstack(chosen.candidate.jacobians)
    singular = np.linalg.svd(stacked, compute_uv=False)
    covariance = chosen.equations.covariance()
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(spread, spread)
    names = [scalar.name for scalar in chosen.candidate.scalars]
    pairs = [
        {"first": names[i], "second": names[j], "correlation": float(correlation[i, j])}
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > 0.8
    ]
    return {
        "singular_values": singular.tolist(),
        "condition_number": float(singular[0] / max(singular[-1], 1e-300)),
        "correlated": pairs,
    }
