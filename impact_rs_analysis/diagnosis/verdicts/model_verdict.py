# SPDX-License-Identifier: Apache-2.0
"""Findings of a search, effects supported by the hold-out, and the verdict on the model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.document import LackOfFit, explained
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut
from impact_rs_analysis.diagnosis.search.model_comparison import Rival
from impact_rs_analysis.diagnosis.search.relevance import exceeds_relevance_limit
from impact_rs_analysis.diagnosis.thresholds import MIN_EXPLAINED_SHARE, MIN_REPORTED_P, SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import IMPOSSIBLE, NONE, NOTHING, SMALL, TOO_FEW, DiagnosisVerdict, Kind
from impact_rs_analysis.diagnosis.verdicts.residuals import (
    beyond_stated_noise,
    exceeds_noise,
    noise_size,
    residual_size,
    residuals_by_signal,
    stated_signals,
)
from impact_rs_sim.effects.link import LINK_EFFECTS
from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class Findings:
    """Input of the verdicts.

    Attributes:
        search: Search over all clusters.
        chosen: The accepted fit; None if no effect was accepted.
        rivals: Alternatives to the chosen effects.
        hold_out: Held-out errors; None with too few clusters.
        p_values: Unadjusted p-values by effect: unchosen effects given the chosen ones, chosen effects given the other
            chosen ones.
        suspected: Without repeats, effects that lower the held-out error by less than its interval.
        within_discrepancy: Effects that lower an error of impacts that is within the discrepancy of the rigid map.
        unsupported: Why effects selected in all data are not named, in words; empty: the hold-out supports all.
    """

    search: Search
    chosen: Fit | None
    rivals: tuple[Rival, ...]
    hold_out: HoldOut | None
    p_values: dict[str, float]
    suspected: tuple[str, ...] = ()
    within_discrepancy: tuple[str, ...] = ()
    unsupported: str = ""

    @property
    def evidence(self) -> Evidence:
        """Residuals of the model."""
        return self.search.evidence

    @cached_property
    def adjusted(self) -> dict[str, float]:
        """Benjamini-Hochberg adjusted p-values of all effects."""
        return self.search.screening.adjusted(self.p_values)

    @property
    def names(self) -> tuple[str, ...]:
        """Chosen effects."""
        return () if self.chosen is None else self.chosen.candidate.names

    @property
    def unexplained(self) -> list[Array]:
        """Mean residuals with the chosen effects, ``(F,)`` per cluster [-]."""
        return self.evidence.means if self.chosen is None else self.chosen.residuals

    @property
    def held_out_sizes(self) -> tuple[float, float]:
        """Held-out error of the model, and of the nested cross-validation."""
        return _held_out_sizes(self.search, self.hold_out)

    @property
    def remaining_share(self) -> float:
        """Share of the squared held-out error beyond noise that remains [-]."""
        return 1.0 - explained(*self.held_out_sizes, noise_size(self.evidence))

    def shown(self, names: Iterable[str]) -> tuple[str, ...]:
        """Names of effects as shown in documents."""
        return shown_names(self.search, names)

    def tied_with(self, name: str) -> tuple[str, ...]:
        """Effects tied with a chosen one: rivals, or all errors of the links together."""
        names = [rival.name for rival in self.rivals if rival.instead_of == name and rival.tied]
        if self.chosen is not None and self.search.explained_by_links(self.chosen, name):
            names += [effect.name for effect in LINK_EFFECTS if effect.name not in self.names]
        return tuple(dict.fromkeys(names))


def shown_names(search: Search, names: Iterable[str]) -> tuple[str, ...]:
    """Names of effects of a search as shown in documents."""
    return tuple(search.source.known_effects[name].shown_name for name in names)


def reported_p(value: float) -> float:
    """A p-value, bounded below by ``MIN_REPORTED_P``: the far tails of the noise are unknown."""
    return max(value, MIN_REPORTED_P)


def excludes_nominal(fitted: Fit, name: str) -> bool:
    """Whether the 95 % interval of some parameter of an effect excludes its nominal value."""
    distance, candidate = np.abs(fitted.distance_from_nominal), fitted.candidate
    return bool(np.any(((distance > fitted.half_widths) & ~candidate.shapes)[candidate.part(name)]))


def without_uncertain_effects(search: Search, chosen: Fit) -> Fit | None:
    """The chosen effects that exceed a relevance limit or whose interval excludes nominal; None: no such effect."""
    for name in chosen.candidate.names:
        if exceeds_relevance_limit(chosen, chosen.candidate.part(name)) or excludes_nominal(chosen, name):
            continue
        if len(chosen.candidate.names) == 1:
            return None
        others = search.without(chosen, name)
        if others is not None:
            return without_uncertain_effects(search, others)
    return chosen


def supported_by_hold_out(search: Search, chosen: Fit, hold_out: HoldOut) -> Fit | None:
    """The chosen effects that the nested hold-out supports; None if it supports no effect.

    Searches without a fold must predict it better than the model does. With repeats, p-values of the effects already
    account for chance, and the sign of the change decides. Its interval would require twice the effect: the squared
    error falls by 2 r d - d^2, with mean d^2 and standard deviation 2 d. Without repeats p-values are less reliable:
    the 95 % interval must exclude 0, and an effect must be selected, or replaced by another one, in most folds. Effects
    that cannot be simulated in a fold are not supported.
    """
    if hold_out.failed:
        return None
    repeated = search.evidence.source.repeated
    change = change_interval(search.evidence.means, hold_out.residuals, search.evidence)
    if not (lowers_held_out_error(search, hold_out) if repeated else change[1] < 0.0):
        return None
    names, supported = chosen.candidate.names, chosen
    for name in () if repeated else names:
        folds = [_selected_or_replaced(name, selected, names) for selected in hold_out.selected]
        if not folds or 2 * sum(folds) > len(folds):
            continue
        others = search.without(supported, name) if len(supported.candidate.names) > 1 else None
        if others is None:
            return None
        supported = others
    return supported


def _selected_or_replaced(name: str, selected: Sequence[str], chosen: Sequence[str]) -> bool:
    """Whether the search of a fold selects an effect, or an effect that the search of all data does not select."""
    return name in selected or any(other not in chosen for other in selected)


def unsupported_words(search: Search, suspected: Sequence[str], hold_out: HoldOut) -> str:
    """Why effects selected in all data are not named, in words."""
    before, after = _held_out_sizes(search, hold_out)
    count, folds = sum(any(name in names for name in suspected) for names in hold_out.selected), len(hold_out.selected)
    effects = " and ".join(shown_names(search, suspected))
    if hold_out.failed:
        return f"not named, because {effects} cannot be simulated in a condition that was held out"
    lower, it = ("lowers", "it") if len(suspected) == 1 else ("lower", "them")
    searches = f"searches without the data that they predict find {it} in {count} of {folds} folds, and "
    return (
        f"not named, because the hold-out does not support it: {effects} {lower} the error in all data, but "
        f"{searches if folds else ''}the held-out error goes from {before:.3g} to {after:.3g}"
    )


def lowers_held_out_error(search: Search, hold_out: HoldOut) -> bool:
    """Whether the nested cross-validation has a lower error than the model."""
    before, after = _held_out_sizes(search, hold_out)
    return after < before


def within_discrepancy(search: Search) -> tuple[str, ...]:
    """The effect with the lowest leave-one-out error of impacts, if it more than halves the error; else empty.

    If the search still names nothing, the change by this effect is within the discrepancy of the rigid map.
    """
    if search.evidence.source.of_motion or not search.evidence.source.discrepancy_document.used:
        return ()
    scores = {name: search.fit_alone(name).score for name in search.screening.singles}
    best = min(scores, key=lambda name: scores[name], default="")
    before = float(np.mean([np.mean(np.square(item.mean)) for item in search.evidence.clusters]))
    return (best,) if best and scores[best] < (1.0 - MIN_EXPLAINED_SHARE) * before else ()


def _held_out_sizes(search: Search, hold_out: HoldOut | None) -> tuple[float, float]:
    """Held-out error of the model, and of the nested cross-validation."""
    evidence = search.evidence
    before = residual_size(evidence, evidence.means)
    return before, before if hold_out is None else residual_size(evidence, hold_out.residuals)


def headline(findings: Findings) -> tuple[DiagnosisVerdict, LackOfFit]:
    """The verdict on the model, and the p-values of lack of fit before and after the chosen effects."""
    evidence, chosen = findings.evidence, findings.chosen
    before = evidence.lack_of_fit
    after = before if chosen is None else chosen.lack_of_fit()
    if evidence.null.shortage is not None:
        verdict = TOO_FEW
    elif evidence.source.impossible:
        verdict = IMPOSSIBLE
    else:
        signals = stated_signals(evidence)
        if signals:
            before = beyond_stated_noise(evidence, evidence.means)
            after = beyond_stated_noise(evidence, findings.unexplained, 0 if chosen is None else chosen.change.size)
        verdict = _on_model(findings, signals, after)
    first, last = (None if p is None else reported_p(p) for p in (before, after))
    return verdict, LackOfFit(before=first, after=last)


def _on_model(findings: Findings, stated: set[tuple[str, str]], p_value: float | None) -> DiagnosisVerdict:
    """The verdict on a model, by the residuals after the chosen effects.

    Args:
        findings: Result of the search.
        stated: Signals of a table without repeats whose noise is stated.
        p_value: Lack of fit of the remaining residuals.
    """
    evidence, chosen = findings.evidence, findings.chosen
    tested = evidence.source.repeated or bool(stated)
    significant = p_value is not None and p_value < SIGNIFICANCE_LEVEL
    if tested:
        residuals = residuals_by_signal(evidence, findings.unexplained)
        unexplained = significant and any(
            residual.value > residual.floor
            for residual in residuals
            if not stated or (residual.signal, residual.index) in stated
        )
    else:
        unexplained = exceeds_noise(evidence, findings.unexplained)
    if chosen is None:
        # Without lack of fit a significant effect corrects no deficit of the model.
        return NONE if unexplained else SMALL if tested and significant else NOTHING
    if unexplained:
        return (
            DiagnosisVerdict(Kind.PARTLY, findings.shown(findings.names))
            if findings.remaining_share < 1.0 - MIN_EXPLAINED_SHARE
            else NONE
        )
    if tested and not any(exceeds_relevance_limit(chosen, part) for _, part in chosen.candidate.parts):
        return SMALL
    return DiagnosisVerdict(Kind.NAMED, findings.shown(findings.names))


def change_interval(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float]:
    """95 % interval of the change of the held-out error.

    By the scatter of repeats (:func:`_by_repeats`), or without repeats by a jackknife over the clusters
    (:func:`_by_clusters`).

    Args:
        before: Mean residuals of the model, ``(F,)`` per cluster [-].
        after: Mean residuals with the effects, ``(F,)`` per cluster [-].
        evidence: The clusters.
    """
    return (_by_repeats if evidence.source.repeated else _by_clusters)(before, after, evidence)


def _by_repeats(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float]:
    """95 % interval of a change of the held-out error, by the noise of the held-out residuals.

    A prediction d_c of cluster c does not depend on that cluster's noise e_c, so the squares fall by

        |r_c|^2 - |r_c - d_c|^2 = 2 r_c d_c - |d_c|^2,    with variance 4 d_c cov(e_c) d_c

    where cov(e_c) is the scatter of repeats, pooled over the layout. Model discrepancy is ignored: a prediction may be
    better because the model was wrong or because its simulator was. The p-value distinguishes the two.
    """
    variance = 0.0
    for item, first, second in zip(evidence.clusters, before, after, strict=True):
        difference = (first - second) / first.size
        same_layout = [other for other in evidence.clusters if other.layout == item.layout]
        freedom = sum(other.count - 1 for other in same_layout)
        scatter = sum(float(np.sum(np.square((other.residuals - other.mean) @ difference))) for other in same_layout)
        variance += 4.0 * scatter / max(freedom, 1) / item.count
    scale = float(evidence.expected.sum()) or float(
        len(before)
    )  # 1 per cluster for repeats without scatter, as in the sizes
    sizes = [residual_size(evidence, residuals) for residuals in (before, after)]
    half = float(scipy.stats.t.ppf(0.975, evidence.null.freedom)) * math.sqrt(variance) / scale
    ends = [math.sqrt(max(sizes[1] ** 2 + side * half, 0.0)) - sizes[0] for side in (-1.0, 1.0)]
    return ends[0], ends[1]


def _by_clusters(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float]:
    """95 % interval of a change of the held-out error, by a jackknife of its log ratio over the clusters.

    The log ratio is about normal, because an effect lowers large and small errors by similar shares.
    """
    count = len(before)

    def log_ratio_of(numbers: Sequence[int]) -> float:
        part = evidence.only(numbers)
        sizes = [residual_size(part, [residuals[n] for n in numbers]) for residuals in (before, after)]
        return math.log(max(sizes[1], 1e-12) / max(sizes[0], 1e-12))

    log_ratio = log_ratio_of(range(count))
    replicates = np.array([log_ratio_of([n for n in range(count) if n != excluded]) for excluded in range(count)])
    standard_error = math.sqrt((count - 1) / count * float(np.sum(np.square(replicates - replicates.mean()))))
    half = float(scipy.stats.t.ppf(0.975, count - 1)) * standard_error
    size = residual_size(evidence, before)
    return size * math.expm1(log_ratio - half), size * math.expm1(log_ratio + half)
