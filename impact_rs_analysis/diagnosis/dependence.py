# SPDX-License-Identifier: Apache-2.0
"""Covariates: whether the parameters of an effect depend on a circumstance of the measurement.

Every effect is tried with every covariate, together with the selected effects. Forms of dependence are a value for each
level; for a number a value at its mean and a slope per standard deviation, or piecewise linear curves
(:mod:`impact_rs_sim.effects.depending`). Effects that were not selected with one value for all circumstances are tried
as well: their mean over the circumstances may be zero, or hidden in the scatter.

Pairs of an effect and a covariate are chosen by forward selection: the score test of the dependence is significant
(Benjamini-Hochberg over all pairs), the leave-one-out error falls by enough, and among ties the pair with the fewest
parameters is selected. A cross-validation repeats fit and selection without each fold. A dependence is accepted if the
interval of the change of the held-out error lies below 0 and more than half of the folds select it.

To the first search, variation with a covariate was scatter, which may have hidden some effects and imitated others. So
a second search runs over all effects, with dependent effects in place of their constant forms. A dependence that this
search replaces by another effect is dropped. If it selects neither, because the scatter of repeats contains the
variation with a number, the dependences stand with the effects of the first search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.effect_selection import ProgressCallback
from impact_rs_analysis.diagnosis.search.fit import (
    DIFFERENCE_STEP_SHARES,
    Evidence,
    Fit,
    gauss_newton,
    replay_and_refit,
)
from impact_rs_analysis.diagnosis.search.hold_out import Fold, folds_of, held_out_residuals
from impact_rs_analysis.diagnosis.search.model_comparison import simplest, tied
from impact_rs_analysis.diagnosis.search.null_distribution import benjamini_hochberg
from impact_rs_analysis.diagnosis.thresholds import (
    MIN_DISTINCT_NUMBERS,
    MIN_ROWS_OF_LEVEL,
    SHORTLIST_SIZE,
    SIGNIFICANCE_LEVEL,
)
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings, change_interval
from impact_rs_analysis.evidence.source import MAX_NUMBERS_AS_LEVELS, Covariate, Source
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.depending import Depending, Knots, Levels, Slope, Terms, level_name
from impact_rs_sim.robots.robot import Array

CURVE_KNOTS = (3, 5, 8)  # of a piecewise linear curve; chosen by cross-validation, the fewest among ties


@dataclass(frozen=True)
class Choice:
    """Result of the forward selection of dependences.

    Attributes:
        fit: Effects and dependences, fitted; None: there are none.
        pairs: Accepted pairs, in the order of selection.
        rivals: Tied pairs, by accepted pair.
        p_values: Adjusted p-values by pair: accepted pairs given earlier accepted ones, others given all accepted ones.
    """

    fit: Fit | None
    pairs: tuple[Depending, ...]
    rivals: Mapping[str, tuple[str, ...]]
    p_values: Mapping[str, float]


@dataclass(frozen=True)
class Dependences:
    """Dependences of effects on covariates.

    Attributes:
        source: The measurements, predicted with the pairs that the hold-out supports.
        tried: All pairs.
        choice: Selection in all data.
        pairs: Selected pairs that the cross-validation supports and the second search does not replace.
        fit: Effects with these pairs; None: there are none.
        before: Mean held-out residuals with the effects alone, ``(F,)`` per cluster [-]; empty: nothing was held out.
        after: Mean held-out residuals with the dependences, likewise.
        folds: Pairs that are selected without each fold.
        replaced: Pairs that the second search replaces by an effect.
    """

    source: Source
    tried: tuple[Depending, ...]
    choice: Choice
    pairs: tuple[Depending, ...] = ()
    fit: Fit | None = None
    before: tuple[Array, ...] = ()
    after: tuple[Array, ...] = ()
    folds: tuple[tuple[str, ...], ...] = ()
    replaced: tuple[str, ...] = ()

    def in_place_of(self, effects: Sequence[Effect]) -> list[Effect]:
        """Effects of the second search, with dependent effects in place of their constant forms."""
        return [next((pair for pair in self.pairs if pair.effect.name == effect.name), effect) for effect in effects]

    def confirmed_by(self, first: Findings, second: Findings) -> bool:
        """Whether the second search selects the dependences, or new effects in their place.

        Args:
            first: Result of the first search.
            second: Result of the second search.
        """
        pairs = {pair.name for pair in self.pairs}
        return pairs <= set(second.names) or bool(set(second.names) - pairs - set(first.names))

    def selected_by(self, chosen: Fit) -> Dependences:
        """The dependences that the second search selects, with its fit."""
        selected = tuple(pair for pair in self.pairs if pair.name in chosen.candidate.names)
        return replace(
            self, pairs=selected, fit=chosen, replaced=tuple(p.name for p in self.pairs if p not in selected)
        )


def terms_of(source: Source) -> dict[str, tuple[Terms, ...]]:
    """Forms of dependence on each covariate of a source, by name; empty: it does not vary enough.

    A level has a value of its own if the training data of every fold include it. A few distinct numbers may be levels,
    such as numbers of sessions.
    """
    folds = folds_of(source) if source.covariates else []
    return {item.name: _terms(item, folds) for item in source.covariates}


def _terms(covariate: Covariate, folds: Sequence[Fold]) -> tuple[Terms, ...]:
    """See :func:`terms_of`."""
    values = [value for rows in covariate.values for value in rows]
    different = dict.fromkeys(map(level_name, values))
    training = [[v for number in fold.training for v in covariate.values[number]] for fold in folds]
    terms: list[Terms] = []
    if covariate.numeric and len(set(values)) >= MIN_DISTINCT_NUMBERS:
        numbers = np.array(values, dtype=float)
        terms.append(Slope(float(numbers.mean()), float(numbers.std())))
        if len(different) > MAX_NUMBERS_AS_LEVELS:
            curves = dict.fromkeys(_curve(numbers, count) for count in CURVE_KNOTS)
            terms += [
                curve for curve in curves if _determined(curve, [np.array(rows, dtype=float) for rows in training])
            ]
    if not covariate.numeric or len(different) <= MAX_NUMBERS_AS_LEVELS:
        names_of = [[level_name(value) for value in rows] for rows in training]
        least = {name: min((rows.count(name) for rows in names_of), default=0) for name in different}
        names = tuple(name for name, rows in least.items() if rows >= MIN_ROWS_OF_LEVEL)
        terms += [Levels(names)] if len(names) > 1 else []
    return tuple(terms)


def _curve(numbers: Array, count: int) -> Knots:
    """A curve with knots at quantiles of the numbers of all rows."""
    knots = np.quantile(numbers, np.linspace(0.0, 1.0, count), method="nearest")
    return Knots(tuple(np.unique(knots).tolist()))


def _determined(curve: Knots, training: Sequence[Array]) -> bool:
    """Whether a curve has more knots than a line, and enough training rows of every fold nearest to each knot."""
    knots = np.array(curve.knots)
    nearest = [np.argmin(np.abs(rows[:, None] - knots), axis=1) for rows in training]
    least = min((int(np.bincount(indices, minlength=knots.size).min()) for indices in nearest), default=0)
    return knots.size >= MIN_DISTINCT_NUMBERS and least >= MIN_ROWS_OF_LEVEL


def dependences_of(
    findings: Findings, present: Sequence[Effect] = (), progress: ProgressCallback = lambda *_: None
) -> Dependences | None:
    """Find the effects that depend on a covariate; None: there is no pair to try.

    Args:
        findings: Result of the search with one value for all circumstances.
        present: Effects of the model, which may depend on a covariate as well.
        progress: Called with fitted effects and their leave-one-out error (:class:`Search`).
    """
    if not findings.evidence.source.covariates or findings.evidence.null.shortage is not None:
        return None
    if findings.evidence.source.impossible:
        return None
    source = findings.evidence.source.with_dependences(())
    chosen = () if findings.chosen is None else findings.chosen.candidate.effects
    others = [
        single.effects[0] for name, single in findings.search.screening.singles.items() if name not in findings.names
    ]
    pairs = tuple(
        Depending(effect, name, terms)
        for name, ways in terms_of(source).items()
        for effect in (*chosen, *others, *present)
        for terms in ways
    )
    if not pairs:
        return None
    evidence, start = Evidence.of(source), np.empty(0) if findings.chosen is None else findings.chosen.estimate
    choice = _choose(evidence, _fitted(chosen, start, evidence), pairs, progress)
    if not choice.pairs:
        return Dependences(source, pairs, choice)
    folds = folds_of(source)
    results = source.distribute(partial(_predicted, chosen, start, pairs, progress), folds, "hold-out of dependences")
    residuals = {
        number: pair_of_residuals
        for fold, (_, by_cluster) in zip(folds, results, strict=True)
        for number, pair_of_residuals in by_cluster.items()
    }
    before, after = zip(*(residuals[number] for number in range(len(source.clusters))), strict=True)
    names = tuple(selected for selected, _ in results)
    supported = change_interval(before, after, evidence)[1] < 0.0
    supported_pairs = tuple(
        pair for pair in choice.pairs if supported and _selected_in_most_folds(pair, pairs, choice, names)
    )
    fit = choice.fit
    if len(supported_pairs) < len(choice.pairs):
        fit = _fitted(chosen, start, evidence)
        for pair in supported_pairs:
            entry = _depending(evidence if fit is None else fit.evidence, fit, pair)
            fit = None if entry is None else replay_and_refit(gauss_newton(entry), at_optimum=True)
    return Dependences(
        source.with_dependences(supported_pairs), pairs, choice, supported_pairs, fit, before, after, names
    )


def forms_of(pair: Depending, pairs: Sequence[Depending]) -> set[str]:
    """Names of all forms of dependence of a pair's effect on its covariate."""
    return {other.name for other in pairs if (other.effect.name, other.covariate) == (pair.effect.name, pair.covariate)}


def _selected_in_most_folds(
    pair: Depending, pairs: Sequence[Depending], choice: Choice, selected_in_folds: Sequence[tuple[str, ...]]
) -> bool:
    """Whether more than half of the folds select a dependence, another form of it, or a rival."""
    accepted_names = forms_of(pair, pairs) | set(choice.rivals[pair.name])
    return 2 * sum(bool(accepted_names & set(names)) for names in selected_in_folds) > len(selected_in_folds)


def _predicted(
    effects: Sequence[Effect],
    start: Array,
    pairs: Sequence[Depending],
    progress: ProgressCallback,
    source: Source,
    fold: Fold,
) -> tuple[tuple[str, ...], dict[int, tuple[Array, Array]]]:
    """Pairs selected without a fold, and the mean residuals of the fold without and with these pairs."""
    evidence = Evidence.of(source, fold.training)
    fitted = _fitted(effects, start, evidence)
    choice = _choose(evidence, fitted, pairs, progress)
    residuals = [_held_out_residuals(fit, source, fold.held_out) for fit in (fitted, choice.fit)]
    return tuple(pair.name for pair in choice.pairs), {
        n: (without, with_pairs) for n, without, with_pairs in zip(fold.held_out, *residuals, strict=True)
    }


def _fitted(effects: Sequence[Effect], start: Array, evidence: Evidence) -> Fit | None:
    """Effects fitted to some clusters from a start; None: no effects, or they cannot be simulated."""
    if not effects:
        return None
    candidate = Candidate.of(tuple(effects), evidence.source, start)
    linearised = linearise(
        candidate, evidence.clusters, evidence.numbers, evidence.source, "dependences", DIFFERENCE_STEP_SHARES[-1]
    )
    return None if linearised is None else replay_and_refit(gauss_newton(Fit.of(linearised, evidence)), at_optimum=True)


def _held_out_residuals(fitted: Fit | None, source: Source, held_out: Sequence[int]) -> list[Array]:
    """Mean residuals of held-out clusters by a fit; by the model without a fit, or if it cannot be simulated."""
    means = [source.clusters[number].mean for number in held_out]
    if fitted is None:
        return means
    predicted = held_out_residuals(fitted.evidence.source, fitted.candidate.effects_at(fitted.estimate), held_out)
    return [mean if residual is None else residual for mean, residual in zip(means, predicted, strict=True)]


def _choose(evidence: Evidence, fitted: Fit | None, pairs: Sequence[Depending], progress: ProgressCallback) -> Choice:
    """Forward selection of pairs, given a fit; an effect depends on one covariate at most."""
    chosen: list[Depending] = []
    rivals: dict[str, tuple[str, ...]] = {}
    p_values: dict[str, float] = {}
    while True:
        dependent_names = {other.effect.name for other in chosen}
        available = [other for other in pairs if other.effect.name not in dependent_names]
        evidence = evidence if fitted is None else fitted.evidence
        proposals = {p.name: entry for p in available if (entry := _depending(evidence, fitted, p)) is not None}
        for entry in proposals.values():
            progress("+".join(entry.candidate.names), evidence.size(entry.leave_one_out_errors))
        p_values |= benjamini_hochberg(_p_values(evidence, fitted, proposals), len(pairs))
        before = evidence.means if fitted is None else fitted.problem.leave_one_out_residuals
        likely = [entry for name, entry in proposals.items() if p_values[name] < SIGNIFICANCE_LEVEL]
        refined = [gauss_newton(entry) for entry in sorted(likely, key=lambda entry: entry.score)[:SHORTLIST_SIZE]]
        refined = [
            entry
            for entry in refined
            if evidence.lowers_excess(before, entry.problem.leave_one_out_residuals, all_features=True)
        ]
        if not refined:
            return Choice(fitted, tuple(chosen), rivals, p_values)
        best = simplest(refined)
        (pair,) = (pair for pair in available if pair.name in best.candidate.names)
        others = [entry for entry in refined if entry is not best and entry.cost <= best.cost and tied(best, entry)]
        forms = forms_of(pair, pairs)
        rivals[pair.name] = tuple(
            p.name for p in available for entry in others if p.name in entry.candidate.names and p.name not in forms
        )
        chosen.append(pair)
        fitted = replay_and_refit(best, at_optimum=True)


def _depending(evidence: Evidence, fitted: Fit | None, pair: Depending) -> Fit | None:
    """Linear fit of an effect that depends on a covariate, given a fit; None if it cannot be simulated."""
    source, joints = evidence.source.with_dependences([pair]), evidence.source.joints
    parts = [] if fitted is None else [(effect, fitted.estimate[part]) for effect, part in fitted.candidate.parts]
    present = [effect.name for effect, _ in parts]
    if pair.effect.name in present:
        index = present.index(pair.effect.name)
        effect, values = parts[index]
        parts[index] = Depending(effect, pair.covariate, pair.terms), pair.at(values, joints)
        share = DIFFERENCE_STEP_SHARES[-1]
    else:
        parts.append((pair, pair.nominal(joints)))
        share = DIFFERENCE_STEP_SHARES[0]  # whole steps reach past stiction of contacts
    origin = () if fitted is None else fitted.candidate.origin
    start = Candidate.of(
        tuple(effect for effect, _ in parts), source, np.concatenate([values for _, values in parts]), origin
    )
    linearised = linearise(start, evidence.clusters, evidence.numbers, source, "dependences", share)
    return None if linearised is None else Fit.of(linearised, replace(evidence, source=source))


def _p_values(evidence: Evidence, fitted: Fit | None, proposals: Mapping[str, Fit]) -> dict[str, float]:
    """p-values of effects being independent of a covariate; of unfitted effects being absent."""
    names, tested = () if fitted is None else fitted.candidate.names, []
    for entry in proposals.values():
        pair, part = next(
            part_of_candidate for part_of_candidate in entry.candidate.parts if part_of_candidate[0].name not in names
        )
        assert isinstance(pair, Depending)
        amplitudes = sum(not scalar.shape for scalar in pair.effect.scalars(evidence.source.joints))
        # The change common to all circumstances is the effect itself: a nuisance parameter of a fitted effect.
        first = part.start + (amplitudes if pair.effect.name in names else 0)
        last = part.start + len(pair.terms.labels) * amplitudes
        tested.append([jacobian[:, first:last] for jacobian in entry.candidate.jacobians])
    null, nuisance = (
        (evidence.null, ()) if fitted is None else (fitted.residual_evidence.null, fitted.candidate.jacobians)
    )
    return dict(zip(proposals, null.p_values(tested, nuisance), strict=True))
