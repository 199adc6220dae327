# SPDX-License-Identifier: Apache-2.0
"""Dependence: whether an effect that was found depends on a circumstance of the measurement (a covariate).

Every effect found is tried with every covariate: with a value for each level, or, of a number, with a value at its mean
and a change per standard deviation (:mod:`impact_rs_sim.effects.depending`). A pair is accepted as effects are: the
score test of what the covariate adds is significant after adjustment for all pairs (Benjamini and Hochberg), the error
on left-out clusters falls by enough, among equals the one with the fewest parameters is taken, and the rest is tried
again beside it. Then clusters are held out, the effects are fitted to the others alone, the choice of pairs is repeated
there, and both predict the held-out clusters. A dependence counts if the interval of the change of that error lies
below 0 and more than half of the folds find it.

What depends on a covariate was scatter to the search that found the effects, which hides some and lets others pass for
it. So all effects are searched once more, with the dependent ones in place of themselves; a dependence that this search
replaces by another effect is none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from impact_rs_analysis.diagnosis.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.fit import NEAR_STEPS, Evidence, Fit, measure_again, refine_again
from impact_rs_analysis.diagnosis.hold_out import Fold, folds_of
from impact_rs_analysis.diagnosis.search import SHORTLIST, Search, adjusted, tied
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANT, TIE
from impact_rs_analysis.diagnosis.verdicts import change_interval
from impact_rs_analysis.evidence.source import Covariate, Source
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.depending import Depending, Levels, Line
from impact_rs_sim.robot import Array

LEAST_ROWS_OF_LEVEL = 3  # beside every fold
LEAST_NUMBERS = 3  # different ones, for a line


@dataclass(frozen=True)
class Choice:
    """Dependences that a search accepts.

    Attributes:
        fit: The effects with them.
        pairs: What was accepted, in this order.
        rivals: By accepted pair, pairs that predict as well in its place.
        p_values: By pair, adjusted for all of them; of accepted ones beside those accepted before, of the others beside
            all that were accepted.
    """

    fit: Fit
    pairs: tuple[Depending, ...]
    rivals: Mapping[str, tuple[str, ...]]
    p_values: Mapping[str, float]


@dataclass(frozen=True)
class Dependences:
    """What depends on which covariate.

    Attributes:
        source: The measurements, predicted with all pairs.
        tried: All pairs.
        choice: What the search of all data accepts.
        pairs: Of these, those that the hold-out supports, and that a search beside all effects does not replace.
        fit: What that search finds; None: it was not made.
        before: Mean held-out residuals with the effects alone, ``(F,)`` per cluster [-]; empty: nothing was held out.
        after: The same with their dependences.
        folds: Pairs that the search of every fold accepts.
    """

    source: Source
    tried: tuple[Depending, ...]
    choice: Choice
    pairs: tuple[Depending, ...] = ()
    fit: Fit | None = None
    before: tuple[Array, ...] = ()
    after: tuple[Array, ...] = ()
    folds: tuple[tuple[str, ...], ...] = ()

    def in_place_of(self, effects: Sequence[Effect]) -> list[Effect]:
        """Effects to consider, those that depend on a covariate in place of themselves."""
        return [next((pair for pair in self.pairs if pair.effect.name == own.name), own) for own in effects]

    def beside(self, chosen: Fit | None) -> Dependences:
        """The dependences beside what a search finds with them."""
        names = () if chosen is None else chosen.candidate.names
        return replace(self, pairs=tuple(pair for pair in self.pairs if pair.name in names), fit=chosen)


def terms_of(covariate: Covariate, folds: Sequence[Fold]) -> Levels | Line | None:
    """How parameters may depend on a covariate; None: it does not vary enough.

    Args:
        covariate: The covariate.
        folds: Of a hold-out. A level has values of its own if it was measured beside every fold as well.
    """
    every = [value for rows in covariate.values for value in rows]
    if covariate.numeric:
        numbers = np.array(every, dtype=float)
        return Line(float(numbers.mean()), float(numbers.std())) if len(set(every)) >= LEAST_NUMBERS else None
    beside = [[value for number in fold.training for value in covariate.values[number]] for fold in folds]
    names = tuple(
        str(name)
        for name in dict.fromkeys(every)
        if beside and min(rows.count(name) for rows in beside) >= LEAST_ROWS_OF_LEVEL
    )
    return Levels(names) if len(names) > 1 else None


def dependences_of(chosen: Fit) -> Dependences | None:
    """Which of the chosen effects depend on which covariate of their source; None: there is nothing to try.

    Args:
        chosen: The effects that were found, fitted to all clusters.
    """
    source = chosen.evidence.source
    if not source.covariates:
        return None
    folds = folds_of(source.knowing(()))
    terms = {item.name: terms_of(item, folds) for item in source.covariates}
    effects = chosen.candidate.effects
    pairs = tuple(
        Depending(effect, name, own) for (name, own), effect in product(terms.items(), effects) if own is not None
    )
    if not pairs:
        return None
    source = source.knowing(pairs)
    choice = _choose(replace(chosen, evidence=replace(chosen.evidence, source=source)), pairs)
    if not choice.pairs:
        return Dependences(source, pairs, choice)
    results = source.spread(partial(_predicted, effects, pairs), folds, "hold-out of dependences")
    rest = {number: both for fold, (_, every) in zip(folds, results, strict=True) for number, both in every.items()}
    before, after = zip(*(rest[number] for number in range(len(source.clusters))), strict=True)
    found = tuple(names for names, _ in results)
    change = change_interval(before, after, chosen.evidence)
    supported = change is not None and change[1] < 0.0
    kept = tuple(one for one in choice.pairs if supported and _common(one.name, choice, found))
    return Dependences(source, pairs, choice, kept, None, before, after, found)


def _common(name: str, choice: Choice, found: Sequence[tuple[str, ...]]) -> bool:
    """Whether more than half of the folds find a pair, or one that predicts as well in its place."""
    alike = {name, *choice.rivals[name]}
    return 2 * sum(bool(alike & set(names)) for names in found) > len(found)


def _predicted(
    effects: Sequence[Effect], pairs: Sequence[Depending], source: Source, fold: Fold
) -> tuple[tuple[str, ...], dict[int, tuple[Array, Array]]]:
    """Pairs that the other clusters show, and the mean residuals of a fold with the effects, without and with them."""
    fitted = Search(effects, Evidence.of(source, fold.training)).fitted([effect.name for effect in effects])
    if fitted is None:
        return (), {number: (source.clusters[number].mean,) * 2 for number in fold.held}
    fitted = measure_again(fitted)
    choice = _choose(fitted, pairs)
    ends = [_rest(one, fold.held) for one in (fitted, choice.fit)]
    return tuple(one.name for one in choice.pairs), {n: (a, b) for n, a, b in zip(fold.held, *ends, strict=True)}


def _rest(fitted: Fit, held: Sequence[int]) -> list[Array]:
    """Mean residuals of clusters with a fit; with effects that cannot be simulated there, those of the model."""
    source, added = fitted.evidence.source, fitted.candidate.split(fitted.estimate)
    found = []
    for item in (source.clusters[number] for number in held):
        predicted = source.measure_again(added, [item])
        found.append(item.mean if predicted is None else predicted[0].mean)
    return found


def _choose(fitted: Fit, pairs: Sequence[Depending]) -> Choice:
    """Forward choice of pairs, beside a fit to a source that knows them; an effect depends on one covariate at most."""
    chosen: list[Depending] = []
    rivals: dict[str, tuple[str, ...]] = {}
    p_values: dict[str, float] = {}
    while True:
        free = [pair for pair in pairs if pair.effect.name in fitted.candidate.names]
        proposals = {pair.name: entry for pair in free if (entry := _depending(fitted, pair)) is not None}
        raw = {name: _p_value(fitted, entry) for name, entry in proposals.items()}
        p_values |= adjusted(raw, len(pairs))
        decidable, before = fitted.left.null.shortage is None, fitted.problem.left_out_rest
        likely = [
            entry
            for name, entry in proposals.items()
            if (p_values[name] < SIGNIFICANT or not decidable)
            and fitted.evidence.gains(before, entry.problem.left_out_rest, 0.5)
        ]
        refined = [refine_again(entry) for entry in sorted(likely, key=lambda entry: entry.score)[:SHORTLIST]]
        refined = [entry for entry in refined if fitted.evidence.gains(before, entry.problem.left_out_rest)]
        if not refined:
            return Choice(fitted, tuple(chosen), rivals, p_values)
        limit = min(entry.score for entry in refined) * math.exp(TIE)
        best = min((one for one in refined if one.score <= limit), key=lambda entry: (_cost(entry), entry.score))
        (own,) = (pair for pair in free if pair.name in best.candidate.names)
        others = [entry for entry in refined if entry is not best and tied(best, entry)]
        rivals[own.name] = tuple(p.name for p in free for entry in others if p.name in entry.candidate.names)
        chosen.append(own)
        fitted = measure_again(best, near=True)


def _depending(fitted: Fit, pair: Depending) -> Fit | None:
    """The linear fit in which an effect depends on a covariate; None where it cannot be simulated."""
    candidate, evidence = fitted.candidate, fitted.evidence
    joints = evidence.source.joints
    effects, points = [], []
    for effect, part in candidate.parts:
        own = effect.name == pair.effect.name
        effects.append(Depending(effect, pair.covariate, pair.terms) if own else effect)
        points.append(pair.at(fitted.estimate[part], joints) if own else fitted.estimate[part])
    start = Candidate.of(tuple(effects), evidence.source, np.concatenate(points), candidate.origin)
    there = linearise(start, evidence.clusters, evidence.numbers, evidence.source, "dependences", NEAR_STEPS[-1])
    return None if there is None else Fit.of(there, evidence)


def _p_value(fitted: Fit, entry: Fit) -> float:
    """p-value of the effect of a proposal not depending on its covariate, given all effects of the fit."""
    joints, names = entry.evidence.source.joints, fitted.candidate.names
    pair, part = next(one for one in entry.candidate.parts if one[0].name not in names)
    assert isinstance(pair, Depending)
    own = [jacobian[:, part] for jacobian in entry.candidate.jacobians]
    others = [np.delete(jacobian, part, axis=1) for jacobian in entry.candidate.jacobians]
    alike = np.array([pair.at(unit, joints) for unit in np.eye(len(pair.effect.scalars(joints)))]).T
    amplitudes = np.count_nonzero([not scalar.shape for scalar in pair.effect.scalars(joints)])
    beyond = slice(amplitudes, len(pair.terms.labels) * amplitudes)  # a change of all levels alike is one of the effect
    without = [np.hstack((other, jacobian @ alike)) for other, jacobian in zip(others, own, strict=True)]
    return fitted.left.null.p_value([jacobian[:, beyond] for jacobian in own], without)


def _cost(fitted: Fit) -> int:
    """Number of parameters of all effects, without shapes."""
    return sum(effect.complexity(fitted.evidence.source.joints) for effect in fitted.candidate.effects)
