# SPDX-License-Identifier: Apache-2.0
"""Verdicts on every effect and on the whole, from fits, null distributions and the hold-out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.document import (
    EffectDocument,
    EstimateDocument,
    RestDocument,
    explained,
)
from impact_rs_analysis.diagnosis.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.hold_out import HoldOut
from impact_rs_analysis.diagnosis.relevance import matters, sizes_of
from impact_rs_analysis.diagnosis.search import Rival, Search, tied_errors
from impact_rs_analysis.diagnosis.thresholds import (
    LEAST_GAIN_OF_JOINT,
    LEAST_P,
    MOST,
    PLAINLY_BEYOND,
    SIGNIFICANT,
    UNSEEN,
)
from impact_rs_analysis.diagnosis.verdict import (
    AT_BOUND,
    CONFIRMED,
    IMPOSSIBLE,
    NO_IMPROVEMENT,
    NONE,
    NOTHING,
    SMALL,
    TOO_FEW,
    UNIDENTIFIABLE,
    DiagnosisVerdict,
    Kind,
)
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.levels import expected_of
from impact_rs_sim.effects import Effect
from impact_rs_sim.robot import Array

MOST_RESTS = 10
NO_SIZE = "predicts unseen data, but its interval holds the value at which it does nothing: more conditions decide"

NOT_MEASURED = {
    "motor side": "no motor-side signal was measured",
    "actuation": "no commanded torque was measured",
    "contact": "no contact was measured",
    "object": "no object was measured",
}


@dataclass(frozen=True)
class Findings:
    """Input of the verdicts.

    Attributes:
        search: Of all clusters.
        chosen: The accepted fit; None if no effect was accepted.
        rivals: Alternatives to the chosen effects.
        hold_out: Held-out errors; None with too few clusters.
        p_values: By effect, each as if it were tested alone: of unchosen ones given the chosen, of chosen ones given
            the other chosen.
        suspected: Effects that lower the error of all data, and the held-out error by less than its interval.
        within_discrepancy: Effects that lower an error of impacts that is within the discrepancy of the rigid map.
        unsupported: Which effects of all data the hold-out does not support, and why; empty: none.
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
        """p-values adjusted for testing all effects."""
        return self.search.adjusted(self.p_values)

    @property
    def names(self) -> tuple[str, ...]:
        """Chosen effects."""
        return () if self.chosen is None else self.chosen.candidate.names

    @property
    def unexplained(self) -> list[Array]:
        """Mean residuals with the chosen effects, ``(F,)`` per cluster [-]."""
        return [item.mean for item in self.evidence.clusters] if self.chosen is None else self.chosen.rest

    @property
    def held_out_sizes(self) -> tuple[float, float]:
        """Held-out error of the model, and with the effects that searches without the held-out part find."""
        return _held_out_sizes(self.search, self.hold_out)

    def shown(self, names: Iterable[str]) -> tuple[str, ...]:
        """Names of effects as documents have them."""
        return shown_names(self.search, names)

    def tied_with(self, name: str) -> tuple[str, ...]:
        """Effects that predict as well in place of a chosen one."""
        tied = [rival.name for rival in self.rivals if rival.instead_of == name and rival.tied]
        if self.hold_out is not None:
            without = [names for names in self.hold_out.found if name not in names]
            if len(without) > len(self.hold_out.found) / 2.0:
                tied += [other for names in without for other in names if other not in self.names]
        return tuple(dict.fromkeys(tied))


def shown_names(search: Search, names: Iterable[str]) -> tuple[str, ...]:
    """Names of effects of a search as documents have them."""
    return tuple(search.source.known_effects[name].shown_name for name in names)


def residual_size(evidence: Evidence, rest: Sequence[Array]) -> float:
    """Size of residuals in reports: multiples of repeatability [-], or rms in the unit of the source.

    Args:
        evidence: The clusters.
        rest: Mean residual of each, ``(F,)`` [-].
    """
    if evidence.source.repeated:
        return evidence.size(np.array([float(np.mean(np.square(values))) for values in rest]))
    weight = evidence.source.residual_weight
    weighted = [values * weight(item) for item, values in zip(evidence.clusters, rest, strict=True)]
    return float(np.sqrt(np.mean(np.square(np.concatenate(weighted)))))


def noise_size(evidence: Evidence) -> float:
    """Value of :func:`residual_size` when only noise remains."""
    if evidence.source.repeated:
        return 1.0
    return residual_size(evidence, [item.pure for item in evidence.clusters])


def exceeds_noise(evidence: Evidence, rest: Sequence[Array]) -> bool:
    """Whether residuals without repeats are larger than noise and calibrations make them, in some signal.

    A torque of 50 N m whose scale is uncertain by 1 % leaves 0.5 N m that no effect has to explain. Where the noise is
    not known (0), nothing can be shown to exceed it.

    Args:
        evidence: The clusters.
        rest: Mean residual of each, ``(F,)`` [-].
    """
    exact = [np.zeros_like(item.sigma) for item in evidence.clusters]
    moved = [
        none if item.calibrations is None else np.sum(np.square(item.calibrations), axis=0)
        for item, none in zip(evidence.clusters, exact, strict=True)
    ]
    for own in evidence.signals:
        squares, noise, unsure = (
            np.mean(np.concatenate([values[mask] for values, mask in zip(rows, own, strict=True)]))
            for rows in ([np.square(row) for row in rest], [item.expected_squares for item in evidence.clusters], moved)
        )
        if noise > 0.0 and squares > PLAINLY_BEYOND**2 * (noise + unsure):
            return True
    return False


def residual_unit(evidence: Evidence) -> str:
    """Unit of :func:`residual_size`."""
    return TIMES if evidence.source.repeated else evidence.source.residual_unit


def clip_p(value: float) -> float:
    """A p-value, not below ``LEAST_P``: the tails of the noise are not known further out."""
    return max(value, LEAST_P)


def undetermined(fitted: Fit) -> NDArray[np.bool_]:
    """Which parameters the data do not determine, ``(p,)``: wide intervals that hold the nominal value.

    What is wide is measured by the size of the robot. A drive that is large beside a light arm has wide intervals on
    that scale, which nevertheless say how large it is.
    """
    away = np.abs(fitted.estimate - fitted.candidate.nominal) / fitted.candidate.scale
    return np.asarray((fitted.half_widths > UNSEEN) & (fitted.half_widths >= away))


def certain(fitted: Fit, name: str) -> bool:
    """Whether the 95 % interval of some parameter of an effect excludes its nominal value."""
    candidate = fitted.candidate
    distance = np.abs(fitted.estimate - candidate.nominal) / candidate.scale
    own = np.array([not scalar.shape for scalar in candidate.scalars])
    return bool(np.any(((distance > fitted.half_widths) & own)[candidate.part(name)]))


def without_the_doubtful(search: Search, chosen: Fit) -> Fit | None:
    """The chosen effects without those that are neither relevant nor certain; None if none remains."""
    for name in chosen.candidate.names:
        if matters(chosen, name) or certain(chosen, name):
            continue
        if len(chosen.candidate.names) == 1:
            return None
        others = search.without(chosen, name)
        if others is not None:
            return without_the_doubtful(search, others)
    return chosen


def supported_by_hold_out(search: Search, chosen: Fit, held: HoldOut) -> Fit | None:
    """The chosen effects that the nested hold-out supports; None if it supports none.

    Searches that have not seen a fold must predict it better than the model does. Where the noise is known from
    repeats, the p-value of the effects has said what chance does, and the sign of the change decides: its interval
    would ask for twice the effect, as the squared error falls by 2 r d - d^2 with the mean d^2 and the deviation 2 d.
    Without repeats no p-value is sure, and the 95 % interval has to exclude 0. What cannot be simulated in a fold is
    not supported. Without repeats those effects remain that most searches of folds find or put another one in place
    of, and what is too small to matter needs no support, for it hardly changes a prediction.
    """
    if held.failed:
        return None
    repeated = search.evidence.source.repeated
    if not repeated and not any(matters(chosen, name) for name in chosen.candidate.names):
        return chosen
    change = change_interval([item.mean for item in search.evidence.clusters], held.rest, search.evidence)
    if not (lowers(search, held) if repeated else change is not None and change[1] < 0.0):
        return None
    for name in () if repeated else chosen.candidate.names:
        if not held.found or 2 * sum(_found_or_replaced(name, f, chosen) for f in held.found) > len(held.found):
            continue
        others = search.without(chosen, name) if len(chosen.candidate.names) > 1 else None
        return None if others is None else supported_by_hold_out(search, others, held)
    return chosen


def _found_or_replaced(name: str, found: Sequence[str], chosen: Fit) -> bool:
    """Whether a search of the hold-out finds an effect, or another one that the search of all data has not."""
    return name in found or any(other not in chosen.candidate.names for other in found)


def unsupported_words(search: Search, suspected: Sequence[str], held: HoldOut) -> str:
    """Why effects that explain all data are not named."""
    before, after = _held_out_sizes(search, held)
    found = sum(any(name in names for name in suspected) for names in held.found)
    what = " and ".join(shown_names(search, suspected))
    if held.failed:
        return f"not named, because {what} cannot be simulated in a condition that was held out"
    lower, it = ("lowers", "it") if len(suspected) == 1 else ("lower", "them")
    folds = f"searches without the data that they predict find {it} in {found} of {len(held.found)} folds, and "
    return (
        f"not named, because the hold-out does not support it: {what} {lower} the error in all data, but "
        f"{folds if held.found else ''}the held-out error goes from {before:.3g} to {after:.3g}"
    )


def lowers(search: Search, held: HoldOut) -> bool:
    """Whether searches that have not seen a fold predict it better than the model does, however little."""
    before, after = _held_out_sizes(search, held)
    return after < before


def within_discrepancy(search: Search) -> tuple[str, ...]:
    """The effect that predicts unseen impacts best, if it more than halves the squared error; empty: none does.

    Where a search names nothing although one does, the discrepancy of the rigid map is as large as what it explains.
    """
    if search.evidence.source.of_motion or not search.evidence.source.discrepancy_document.used:
        return ()
    scores = {name: search.alone(name).score for name in search.singles}
    best = min(scores, key=lambda name: scores[name], default="")
    before = float(np.mean([np.mean(np.square(item.mean)) for item in search.evidence.clusters]))
    return (best,) if best and scores[best] < (1.0 - MOST) * before else ()


def _held_out_sizes(search: Search, held: HoldOut | None) -> tuple[float, float]:
    """Held-out error of the model, and with what searches without the held-out part find."""
    evidence = search.evidence
    before = [item.mean for item in evidence.clusters]
    after = before if held is None else held.rest
    return residual_size(evidence, before), residual_size(evidence, after)


def rests_of(evidence: Evidence, rest: Sequence[Array]) -> list[RestDocument]:
    """Remaining residuals by phase, signal and index, sorted by their share; multiples are those of a comparison."""
    by_limit = evidence.source.kind == "trials" and evidence.source.noise_size() is None
    squares: dict[tuple[str, str, str], list[tuple[float, float, float, float]]] = {}
    facts: dict[tuple[str, str, str], tuple[str, float]] = {}
    for item, values in zip(evidence.clusters, rest, strict=True):
        expected, times = item.expected_squares, values / expected_of(item, by_limit)
        for feature, value, noise, sigma, own in zip(item.features, values, expected, item.sigma, times, strict=True):
            squares.setdefault(feature.group, []).append((float(value**2), float(noise), float(sigma), float(own)))
            facts[feature.group] = (feature.unit, feature.relevance_limit)
    total = sum(row[0] for rows in squares.values() for row in rows)
    found = []
    for (phase, signal, index), rows in squares.items():
        table = np.array(rows)
        excess = float(np.mean((table[:, 0] - table[:, 1]) * table[:, 2] ** 2))
        unit, limit = facts[phase, signal, index]
        found.append(
            RestDocument(
                phase=phase,
                signal=signal,
                index=index,
                value=math.sqrt(max(excess, 0.0)),
                unit=unit,
                floor=limit,
                share=float(table[:, 0].sum()) / max(total, 1e-300),
                times_noise=float(np.sqrt(np.mean(np.square(table[:, 3])))),
            )
        )
    return sorted(found, key=lambda entry: -entry.share)


@dataclass(frozen=True)
class Headline:
    """The overall verdict.

    Attributes:
        verdict: On the model.
        share: Share of the squared held-out error beyond noise that remains.
        before: p-value of the model's residuals being noise; None without repeats or stated noise.
        after: The same of the remaining residuals.
    """

    verdict: DiagnosisVerdict
    share: float
    before: float | None
    after: float | None


def headline(found: Findings) -> Headline:
    """The overall verdict."""
    evidence, chosen = found.evidence, found.chosen
    before = evidence.lack_of_fit
    after = before if chosen is None else chosen.lack_of_fit()
    share = 1.0 - explained(*found.held_out_sizes, noise_size(evidence))
    if evidence.null.shortage is not None:
        return Headline(TOO_FEW, share, before, after)
    if evidence.source.impossible:
        return Headline(IMPOSSIBLE, share, before, after)
    stated = _stated(evidence)
    if stated:
        fitted = 0 if chosen is None else chosen.change.size
        before = beyond_stated_noise(evidence, [item.mean for item in evidence.clusters])
        after = beyond_stated_noise(evidence, found.unexplained, fitted)
    elif not evidence.source.repeated:
        more = exceeds_noise(evidence, found.unexplained)
        if chosen is None:
            return Headline(NONE if more else NOTHING, share, before, after)
        if more:
            return Headline(_partly(found, share), share, before, after)
        return Headline(DiagnosisVerdict(Kind.NAMED, found.shown(found.names)), share, before, after)
    stays = after is not None and after < SIGNIFICANT
    rests = rests_of(evidence, found.unexplained)
    large = any(rest.value > rest.floor for rest in rests if not stated or (rest.signal, rest.index) in stated)
    if chosen is None:
        # An effect may be significant alone; if the residuals are noise, it does not explain a deficit of the model.
        verdict = NONE if stays and large else SMALL if stays else NOTHING
    elif stays and large:
        verdict = _partly(found, share)
    elif not any(matters(chosen, name) for name in found.names):
        verdict = SMALL
    else:
        verdict = DiagnosisVerdict(Kind.NAMED, found.shown(found.names))
    return Headline(verdict, share, before, after)


def _stated(evidence: Evidence) -> set[tuple[str, str]]:
    """Signals of a table without repeats whose noise is stated, each with its axis or joint."""
    if evidence.source.repeated or evidence.source.of_motion:
        return set()
    pairs = ((f, pure) for item in evidence.clusters for f, pure in zip(item.features, item.pure, strict=True))
    return {(feature.signal, feature.index) for feature, pure in pairs if pure > 0.0}


def beyond_stated_noise(evidence: Evidence, rest: Sequence[Array], fitted: int = 0) -> float:
    """p-value of residuals being stated noise and discrepancy: chi-square of every signal, and of all together.

    With the noise p_i and the discrepancy d_i of a residual r_i the statistic is T = sum r_i^2 / (p_i^2 + d_i^2), and
    a_i = p_i^2 / (p_i^2 + d_i^2). Noise is independent; discrepancies may all be one and the same amplitude. So T has
    the mean N and at most the variance 2 (sum a_i^2 + (sum 1 - a_i)^2), and is compared with the scaled chi-square of
    that mean and variance (Satterthwaite 1946, Biometrics Bulletin 2): without discrepancy that of N degrees of
    freedom. The smallest p counts, times the number of tests (Bonferroni).

    Args:
        evidence: The clusters of a table.
        rest: Mean residual of each, ``(F,)`` [-].
        fitted: Number of fitted parameters, which take as many degrees of freedom, from every signal its share.
    """
    signals: list[tuple[str, str]] = []
    squares, shares = [], []
    for item, values in zip(evidence.clusters, rest, strict=True):
        known = item.pure > 0.0
        expected = item.expected_squares[known]
        signals += [(f.signal, f.index) for f, own in zip(item.features, known, strict=True) if own]
        squares.append(np.square(values[known]) / expected)
        shares.append(np.square(item.pure[known]) / item.count / expected)
    statistic, share = np.concatenate(squares), np.concatenate(shares)
    left = max(1.0 - fitted / statistic.size, 1.0 / statistic.size)
    p_values = []
    for own in (np.ones(statistic.size, dtype=bool), *(np.array([s == one for s in signals]) for one in set(signals))):
        mean = left * np.count_nonzero(own)
        spread = 2.0 * (left * np.sum(np.square(share[own])) + np.sum(1.0 - share[own]) ** 2)
        p_values.append(float(scipy.stats.chi2.sf(2.0 * mean * statistic[own].sum() / spread, 2.0 * mean**2 / spread)))
    return min(1.0, len(p_values) * min(p_values))


def _partly(found: Findings, share: float) -> DiagnosisVerdict:
    """The verdict if residuals exceed noise with the chosen effects, by the share of the excess that remains."""
    return DiagnosisVerdict(Kind.PARTLY, found.shown(found.names)) if share < 1.0 - MOST else NONE


def effect_documents(found: Findings, known: dict[str, Effect]) -> list[EffectDocument]:
    """Documents of all effects: chosen ones, then the others by their error, then those not measured."""
    search = found.search
    reports = [_chosen_document(found, known[name]) for name in found.names]
    others = []
    for name in search.singles:
        if name not in found.names:
            others.append(_other_document(found, known[name]))
    others.sort(key=lambda report: report.held_out_error_after or 0.0)
    reports += others
    for name in sorted(search.unmeasured):
        effect = known[name]
        why = NOT_MEASURED.get(effect.acts_on, "no measured signal depends on it")
        reports.append(
            EffectDocument(
                name=effect.shown_name,
                sentence=effect.sentence,
                verdict=UNIDENTIFIABLE,
                reason=f"not measured: {why}",
                measured=False,
                parameters={},
                held_out_error_before=None,
                held_out_error_after=None,
                p_value=None,
            )
        )
    return reports


def _chosen_document(found: Findings, effect: Effect) -> EffectDocument:
    chosen, evidence = found.chosen, found.evidence
    assert chosen is not None
    name = effect.name
    part = chosen.candidate.part(name)
    rivals = found.shown(found.tied_with(name))
    own = np.array([not scalar.shape for scalar in chosen.candidate.scalars[part]])
    bound, shape = chosen.held_at_bound[part][own], chosen.held_at_bound[part][~own]
    places = any(scalar.joint is not None or scalar.arm for scalar in chosen.candidate.scalars[part])
    if evidence.null.shortage is not None:
        verdict, reason = TOO_FEW, evidence.null.shortage
    elif np.all(undetermined(chosen)[part][own]):
        verdict, reason = UNIDENTIFIABLE, "the data do not determine it: its interval is too wide"
    elif np.all(bound) or (np.any(bound) and not places) or np.any(shape):
        verdict, reason = AT_BOUND, "the best value lies at a bound: another effect may be missing"
    elif not matters(chosen, name):
        size = sizes_of(chosen, name)[0]
        verdict = SMALL
        reason = f"at most {size.value:.2g} {size.unit} of the {size.signal}; relevance limit {size.floor:.2g}"
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "other effects predict unseen data as well"
    else:
        verdict, reason = CONFIRMED, "predicts unseen data, and no other effect does as well"
    parameters = _estimates(found, chosen, name)
    if verdict == CONFIRMED and (alike := _alike_at_joints([one.verdict for one in parameters.values()])):
        rivals = alike
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, alike)
        reason = "at no joint it predicts unseen data better than these"
    if verdict == CONFIRMED or rivals:
        shapes = {scalar.name for scalar in chosen.candidate.scalars[part] if scalar.shape}
        if not any(parameters[key].excludes_nominal for key in parameters.keys() - shapes):
            verdict, reason = UNIDENTIFIABLE, NO_SIZE
    before = residual_size(evidence, [item.mean for item in evidence.clusters])
    folds = None if found.hold_out is None else sum(name in names for names in found.hold_out.found)
    return EffectDocument(
        name=effect.shown_name,
        sentence=effect.sentence,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=parameters,
        held_out_error_before=before,
        held_out_error_after=residual_size(chosen.evidence, chosen.problem.left_out_rest),
        held_out_error_alone=_error_alone(found, name),
        held_out_error_others=_error_without(found, name),
        p_value=clip_p(found.adjusted[name]),
        p_value_alone=clip_p(found.p_values[name]),
        sizes=tuple(sizes_of(chosen, name)),
        chosen_in_folds=folds,
    )


def _other_document(found: Findings, effect: Effect) -> EffectDocument:
    """Document of an effect that was not chosen: in place of its chosen rival, or else added to the chosen ones."""
    search, evidence, name = found.search, found.evidence, effect.name
    own = [rival for rival in found.rivals if rival.name == name]
    tied = [rival for rival in own if rival.tied]
    best = min(tied or own, key=lambda rival: rival.fit.score, default=None)
    fitted = search.beside(found.chosen, name) if best is None else best.fit
    part = fitted.candidate.part(name)
    shown = np.array([not scalar.shape for scalar in fitted.candidate.scalars[part]])
    p = found.adjusted.get(name, 1.0)
    rivals = found.shown(dict.fromkeys(rival.instead_of for rival in tied))
    if evidence.null.shortage is not None:
        verdict, reason = TOO_FEW, evidence.null.shortage
    elif evidence.source.impossible:
        verdict, reason = UNIDENTIFIABLE, "the measurements break a law that holds for every contact"
    elif np.all(undetermined(fitted)[part][shown]):
        verdict, reason = UNIDENTIFIABLE, "the data do not determine it: its interval is too wide"
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "predicts unseen data as well in place of the chosen effect"
    elif p < SIGNIFICANT and best is None:
        size = sizes_of(fitted, name)
        verdict, reason = NO_IMPROVEMENT, "significant, but it hardly lowers the held-out error"
        if not certain(fitted, name):
            reason = "significant, but its interval contains the nominal value"
        elif size and all(entry.value <= entry.floor for entry in size):
            verdict = SMALL
            reason = f"at most {size[0].value:.2g} {size[0].unit} of the {size[0].signal}"
    else:
        verdict, reason = NO_IMPROVEMENT, ""
        if name in search.ruled_out:
            reason = "ruled out by free motion, and not tried in contact"
    base = [item.mean for item in evidence.clusters] if found.chosen is None else found.chosen.problem.left_out_rest
    return EffectDocument(
        name=effect.shown_name,
        sentence=effect.sentence,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=_estimates(found, fitted, name),
        held_out_error_before=residual_size(evidence, base),
        held_out_error_after=residual_size(fitted.evidence, fitted.problem.left_out_rest),
        held_out_error_alone=_error_alone(found, name),
        held_out_error_others=residual_size(evidence, base) if best is None else _error_without(found, best.instead_of),
        p_value=clip_p(p),
        p_value_alone=clip_p(found.p_values.get(name, 1.0)),
        sizes=tuple(sizes_of(fitted, name)) if verdict != NO_IMPROVEMENT else (),
    )


def _error_alone(found: Findings, name: str) -> float:
    """Held-out error with one effect alone."""
    fitted = found.chosen if found.chosen is not None and found.names == (name,) else found.search.alone(name)
    return residual_size(fitted.evidence, fitted.problem.left_out_rest)


def _error_without(found: Findings, name: str) -> float | None:
    """Held-out error with the chosen effects but one; None if they cannot be simulated."""
    assert found.chosen is not None
    if found.names == (name,):
        return residual_size(found.evidence, [item.mean for item in found.evidence.clusters])
    fitted = found.search.without(found.chosen, name)
    return None if fitted is None else residual_size(fitted.evidence, fitted.problem.left_out_rest)


def _ends(found: Findings, fitted: Fit, part: slice) -> tuple[Array, Array]:
    """Ends of the 95 % intervals of one effect, ``(k,)`` each; simulated where its signals may bend."""
    if fitted is found.chosen:
        return fitted.interval[0][part], fitted.interval[1][part]
    source = found.search.source
    if source.of_motion and source.repeated and not _seen_before_contact(fitted, part):
        return fitted.interval_of(range(part.start, part.stop))
    candidate, half = fitted.with_room, fitted.half_widths * fitted.candidate.scale
    low, high = fitted.estimate - half, fitted.estimate + half
    return np.maximum(low, candidate.lower)[part], np.minimum(high, candidate.upper)[part]


def _seen_before_contact(fitted: Fit, part: slice) -> bool:
    """Whether free motion, which is almost linear in every parameter, depends on an effect."""
    if fitted.evidence.before_contact is None:
        return False
    free = fitted.evidence.seen_before_contact(fitted.candidate).jacobians
    return any(np.any(jacobian[:, part]) for jacobian in free)


def _estimates(found: Findings, fitted: Fit, name: str) -> dict[str, EstimateDocument]:
    """Estimates of one effect with intervals, clipped to the bounds of the parameters."""
    candidate = fitted.candidate
    part = candidate.part(name)
    ends = _ends(found, fitted, part)
    result = {}
    for index in range(part.start, part.stop):
        scalar = candidate.scalars[index]
        value = round(float(fitted.estimate[index]) / scalar.scale, 9) * scalar.scale  # no rounding error at bounds
        low, high = (float(end[index - part.start]) for end in ends)
        verdict = p = before = after = None
        if scalar.joint is not None and name in found.names and fitted is found.chosen:
            verdict, p, before, after = _joint(found, fitted, index)
        low, high = min(low, value), max(high, value)
        if verdict is not None and verdict.kind in (Kind.CONFIRMED, Kind.CONFUSABLE) and low <= scalar.nominal <= high:
            verdict = UNIDENTIFIABLE
        result[scalar.name] = EstimateDocument(
            estimate=value,
            ci95=(low, high),
            unit=scalar.unit,
            meaning=scalar.meaning,
            joint=None if scalar.joint is None else f"joint{scalar.joint + 1}",
            arm=scalar.arm or None,
            verdict=verdict,
            p_value=p,
            error_before=before,
            error_after=after,
            nominal=scalar.nominal,
            scale=None if scalar.shape else scalar.scale,
            range=(float(candidate.lower[index]), float(candidate.upper[index])),
            at_bound=bool(fitted.held_at_bound[index]),
        )
    return result


def _alike_at_joints(verdicts: Sequence[DiagnosisVerdict | None]) -> tuple[str, ...]:
    """What an effect is confusable with by the verdicts on its joints; empty: some joint is sure, or none says it.

    An effect is no surer than the surest of its joints. What all of them allow explains all of them.
    """
    sets = [set(one.names) for one in verdicts if one is not None and one.kind is Kind.CONFUSABLE]
    if CONFIRMED in verdicts or not sets:
        return ()
    return tuple(sorted(set.intersection(*sets) or set.union(*sets)))


def _joint(found: Findings, fitted: Fit, index: int) -> tuple[DiagnosisVerdict, float, float | None, float | None]:
    """Verdict and p-value of one joint's parameter given all others; the joint's held-out error without and with it."""
    candidate, evidence = fitted.candidate, fitted.evidence
    scalar = candidate.scalars[index]
    joint = f"joint{(scalar.joint or 0) + 1}"
    seen = any(np.any(jacobian[:, index]) for jacobian in candidate.jacobians)
    without = evidence.problem(candidate.fixed(index))
    left = without.rest(without.solve())
    shifts = [item.mean - rest for item, rest in zip(evidence.clusters, left, strict=True)]
    if evidence.null.by_blocks:
        p = fitted.problem.p_by_interval(fitted.change, evidence.null, index)
    else:
        p = fitted.problem.p_value(evidence.shifted(shifts).null, [index])
    rest, rest_without = fitted.problem.left_out_rest, without.left_out_rest
    own, own_without = (_of_joint(evidence, values, scalar.arm, joint) for values in (rest, rest_without))
    if not own.size:  # nothing of the joint was measured
        return UNIDENTIFIABLE, 1.0, None, None
    error, error_without = float(own.mean()), float(own_without.mean())
    rivals = [
        name
        for name, other in found.search.joint_alternatives(candidate, index)
        if tied_errors(own, _of_joint(evidence, evidence.problem(other).left_out_rest, scalar.arm, joint), 1e-12)
    ]
    if undetermined(fitted)[index]:
        verdict = UNIDENTIFIABLE
    elif fitted.held_at_bound[index]:
        verdict = AT_BOUND
    elif p >= SIGNIFICANT or error > (1.0 - LEAST_GAIN_OF_JOINT) * error_without or not seen:
        verdict = NO_IMPROVEMENT
    else:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(found.shown(rivals)))) if rivals else CONFIRMED
    if evidence.source.repeated:
        return verdict, clip_p(p), None, None
    item = evidence.clusters[0]
    sigma = next(float(s) for f, s in zip(item.features, item.sigma, strict=True) if f.index == joint)
    return verdict, clip_p(p), sigma * math.sqrt(error_without), sigma * math.sqrt(error)


def _of_joint(evidence: Evidence, rest: Sequence[Array], arm: str, joint: str) -> Array:
    """Mean square residual of one joint's signals by cluster that has any, ``(c,)`` [-]; ``arm`` empty: of all arms."""
    picked = []
    for item, values in zip(evidence.clusters, rest, strict=True):
        own = np.array([f.index.rsplit(".", 1)[-1] == joint and (not arm or f.arm in ("", arm)) for f in item.features])
        if np.any(own):
            picked.append(float(np.mean(np.square(values[own]))))
    return np.array(picked)


def change_interval(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float] | None:
    """95 % interval of the change of the held-out size; None with too few clusters.

    With repeats it is that of their scatter (:func:`_by_repeats`), without them that of the ratio's scatter over the
    clusters (:func:`_by_clusters`).

    Args:
        before: Mean residuals without, ``(F,)`` per cluster [-].
        after: Mean residuals with the effects found, ``(F,)`` per cluster [-].
        evidence: The clusters.
    """
    if len(before) < 2:
        return None
    known = evidence.source.repeated and evidence.null.freedom > 0
    return (_by_repeats if known else _by_clusters)(before, after, evidence)


def _by_repeats(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float]:
    """Interval of a change of the held-out size, from the noise of the held-out residuals.

    A prediction d_c of cluster c does not depend on that cluster's noise e_c, so the squares fall by

        |r_c|^2 - |r_c - d_c|^2 = 2 r_c d_c - |d_c|^2,    with variance 4 d_c cov(e_c) d_c

    where cov(e_c) is the scatter of repeats, pooled over the layout. The model discrepancy is no part of it: a better
    prediction is better, whether the model or its simulator was wrong. Which of them it was is asked by the p-value.
    """
    variance = 0.0
    for item, first, second in zip(evidence.clusters, before, after, strict=True):
        moved = (first - second) / first.size
        like = [other for other in evidence.clusters if other.layout == item.layout]
        freedom = sum(other.count - 1 for other in like)
        scatter = sum(float(np.sum(np.square((other.residuals - other.mean) @ moved))) for other in like)
        variance += 4.0 * scatter / max(freedom, 1) / item.count
    scale = float(evidence.expected.sum())
    sizes = [residual_size(evidence, rest) for rest in (before, after)]
    half = float(scipy.stats.t.ppf(0.975, evidence.null.freedom)) * math.sqrt(variance) / scale
    ends = [math.sqrt(max(sizes[1] ** 2 + side * half, 0.0)) - sizes[0] for side in (-1.0, 1.0)]
    return ends[0], ends[1]


def _by_clusters(before: Sequence[Array], after: Sequence[Array], evidence: Evidence) -> tuple[float, float]:
    """Interval of a change of the held-out size, from the scatter of its ratio over the clusters (jackknife).

    The logarithm of the ratio is about normal: an effect lowers a large error and a small one by a similar share.
    """
    count = len(before)

    def ratio(kept: Sequence[int]) -> float:
        part = evidence.only(kept)
        sizes = [residual_size(part, [rest[n] for n in kept]) for rest in (before, after)]
        return math.log(max(sizes[1], 1e-12) / max(sizes[0], 1e-12))

    whole = ratio(range(count))
    alone = np.array([ratio([n for n in range(count) if n != left]) for left in range(count)])
    spread = math.sqrt((count - 1) / count * float(np.sum(np.square(alone - alone.mean()))))
    half = float(scipy.stats.t.ppf(0.975, count - 1)) * spread
    size = residual_size(evidence, before)
    return size * math.expm1(whole - half), size * math.expm1(whole + half)
