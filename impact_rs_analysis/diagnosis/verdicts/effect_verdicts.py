# SPDX-License-Identifier: Apache-2.0
"""Verdicts on effects and on their joints, with estimates, errors and sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.document import EffectDocument, EstimateDocument
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.intervals import intervals_of
from impact_rs_analysis.diagnosis.search.model_comparison import Rival, changed_features, tied_errors
from impact_rs_analysis.diagnosis.search.relevance import exceeds_relevance_limit, sizes_of
from impact_rs_analysis.diagnosis.thresholds import MAX_HALF_WIDTH, SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import (
    AT_BOUND,
    CONFIRMED,
    NO_IMPROVEMENT,
    SMALL,
    TOO_FEW,
    UNIDENTIFIABLE,
    DiagnosisVerdict,
    Kind,
)
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings, excludes_nominal, reported_p
from impact_rs_analysis.diagnosis.verdicts.residuals import residual_size
from impact_rs_sim.effects import Effect
from impact_rs_sim.robots.robot import Array

SIZE_UNKNOWN = "predicts unseen data, but its interval holds the value at which it does nothing: more conditions decide"

Ends = tuple[Array, Array]  # of intervals, (k,) each in the units of an effect's k parameters

NOT_MEASURED = {
    "motor side": "no motor-side signal was measured",
    "actuation": "no commanded torque was measured",
    "contact": "no contact was measured",
    "object": "no object was measured",
    "neighbour": "nothing stands beside the object (neighbours of a scenario)",
}


def effect_documents(findings: Findings, effects_by_name: dict[str, Effect]) -> list[EffectDocument]:
    """Documents of all effects: chosen, then others by leave-one-out error, then effects that were not measured."""
    search = findings.search
    fits = {name: _fitted(findings, name) for name in dict.fromkeys([*findings.names, *search.screening.singles])}
    ends = _ends(findings, fits)
    chosen = [_chosen_document(findings, effects_by_name[name], ends[name]) for name in findings.names]
    others = [
        _other_document(findings, effects_by_name[name], fits[name], ends[name])
        for name in fits
        if name not in findings.names
    ]
    others.sort(key=lambda report: report.held_out_error_after or 0.0)
    reports = [*chosen, *others]
    for name in sorted(search.screening.unmeasured):
        effect = effects_by_name[name]
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


def _chosen_document(findings: Findings, effect: Effect, ends: Ends) -> EffectDocument:
    chosen = findings.chosen
    assert chosen is not None
    name = effect.name
    part = chosen.candidate.part(name)
    rivals = findings.shown(findings.tied_with(name))
    shapes = chosen.candidate.shapes[part]
    amplitudes_at_bound, shapes_at_bound = chosen.pushed_to_bound[part][~shapes], chosen.pushed_to_bound[part][shapes]
    by_joint_or_arm = any(scalar.joint is not None or scalar.arm for scalar in chosen.candidate.scalars[part])
    parameters = _estimates(findings, chosen, name, ends)
    amplitudes = [scalar.name for scalar in chosen.candidate.scalars[part] if not scalar.shape]
    if np.all(amplitudes_at_bound) or (np.any(amplitudes_at_bound) and not by_joint_or_arm) or np.any(shapes_at_bound):
        verdict, reason = AT_BOUND, "the best value lies at a bound: another effect may be missing"
    elif not any(parameters[key].excludes_nominal for key in amplitudes):
        verdict, reason = UNIDENTIFIABLE, SIZE_UNKNOWN
    elif small := _small(chosen, name):
        verdict, reason = SMALL, small
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "other effects predict unseen data as well"
    elif rivals := _alike_at_joints([estimate.verdict for estimate in parameters.values()]):
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, rivals)
        reason = "at no joint it predicts unseen data better than these"
    else:
        verdict, reason = CONFIRMED, "predicts unseen data, and no other effect does as well"
    searched = () if findings.hold_out is None else findings.hold_out.selected
    return _document(
        findings,
        effect,
        chosen,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=parameters,
        held_out_error_before=_error(findings, None),
        held_out_error_others=_error_without(findings, name),
        sizes=tuple(sizes_of(chosen, name)),
        chosen_in_folds=sum(name in names for names in searched) if searched else None,
    )


def _as_rival(findings: Findings, name: str) -> Rival | None:
    """The rival to report for an unchosen effect: the best tied fit, or else the best fit; None: it is no rival."""
    fits = [rival for rival in findings.rivals if rival.name == name]
    tied = [rival for rival in fits if rival.tied]
    return min(tied or fits, key=lambda rival: rival.fit.score, default=None)


def _fitted(findings: Findings, name: str) -> Fit:
    """The reported fit of an effect: chosen, in place of its chosen rival, or in addition to the chosen effects."""
    if findings.chosen is not None and name in findings.names:
        return findings.chosen
    best = _as_rival(findings, name)
    return findings.search.screening.linear_fit_with(findings.chosen, name) if best is None else best.fit


def _other_document(findings: Findings, effect: Effect, fitted: Fit, ends: Ends) -> EffectDocument:
    """Document of an unchosen effect."""
    search, evidence, name = findings.search, findings.evidence, effect.name
    best = _as_rival(findings, name)
    part = fitted.candidate.part(name)
    rivals = findings.shown(
        dict.fromkeys(rival.instead_of for rival in findings.rivals if rival.name == name and rival.tied)
    )
    if evidence.null.shortage is not None:
        verdict, reason = TOO_FEW, evidence.null.shortage
    elif evidence.source.impossible:
        verdict, reason = UNIDENTIFIABLE, "the measurements break a law that holds for every contact"
    elif np.all(undetermined(fitted)[part] | fitted.candidate.shapes[part]):
        verdict, reason = UNIDENTIFIABLE, "the data do not determine it: its interval is too wide"
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "predicts unseen data as well in place of the chosen effect"
    elif findings.adjusted.get(name, 1.0) < SIGNIFICANCE_LEVEL and best is None:
        verdict, reason = NO_IMPROVEMENT, "significant, but it hardly lowers the held-out error"
        if not excludes_nominal(fitted, name):
            reason = "significant, but its interval contains the nominal value"
        elif small := _small(fitted, name):
            verdict, reason = SMALL, small
    else:
        verdict, reason = NO_IMPROVEMENT, ""
        if name in search.screening.ruled_out:
            reason = "free motion shows no sign of it, so it was not fitted in contact"
    before = _error(findings, findings.chosen)
    return _document(
        findings,
        effect,
        fitted,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=_estimates(findings, fitted, name, ends),
        held_out_error_before=before,
        held_out_error_others=before if best is None else _error_without(findings, best.instead_of),
        sizes=tuple(sizes_of(fitted, name)) if verdict != NO_IMPROVEMENT else (),
    )


def _small(fitted: Fit, name: str) -> str:
    """Largest change by an effect that changes no signal beyond its relevance limit, in words; else empty."""
    sizes = sizes_of(fitted, name)
    if not sizes or exceeds_relevance_limit(fitted, fitted.candidate.part(name)):
        return ""
    largest = sizes[0]
    return f"at most {largest.value:.2g} {largest.unit} of the {largest.signal}; relevance limit {largest.floor:.2g}"


def _document(findings: Findings, effect: Effect, fitted: Fit, **fields: Any) -> EffectDocument:
    """Document of an effect, with the fields that chosen and other effects have in common."""
    name = effect.name
    return EffectDocument(
        name=effect.shown_name,
        sentence=effect.sentence,
        held_out_error_after=_error(findings, fitted),
        held_out_error_alone=_error(
            findings, findings.chosen if findings.names == (name,) else findings.search.fit_alone(name)
        ),
        p_value=reported_p(findings.adjusted.get(name, 1.0)),
        p_value_alone=reported_p(findings.p_values.get(name, 1.0)),
        **fields,
    )


def _error(findings: Findings, fitted: Fit | None) -> float:
    """Leave-one-out error of a fit, or of the model (None)."""
    return residual_size(findings.evidence, findings.search.leave_one_out_residuals(fitted))


def _error_without(findings: Findings, name: str) -> float | None:
    """Leave-one-out error of the chosen effects except one; None if they cannot be simulated."""
    assert findings.chosen is not None
    if findings.names == (name,):
        return _error(findings, None)
    fitted = findings.search.without(findings.chosen, name)
    return None if fitted is None else _error(findings, fitted)


def _estimates(findings: Findings, fitted: Fit, name: str, ends: Ends) -> dict[str, EstimateDocument]:
    """Estimates of one effect with intervals, clipped to the bounds of the parameters."""
    candidate = fitted.candidate
    part = candidate.part(name)
    result = {}
    for index in range(part.start, part.stop):
        scalar = candidate.scalars[index]
        value = round(float(fitted.estimate[index]) / scalar.scale, 9) * scalar.scale  # no rounding error at bounds
        low, high = (float(end[index - part.start]) for end in ends)
        verdict = p_value = before = after = None
        if scalar.joint is not None and name in findings.names and fitted is findings.chosen:
            verdict, p_value, before, after = _joint(findings, fitted, index)
        low, high = min(low, value), max(high, value)
        if verdict is not None and verdict.kind in (Kind.CONFIRMED, Kind.CONFUSABLE) and low <= scalar.nominal <= high:
            verdict = UNIDENTIFIABLE
        result[scalar.name] = EstimateDocument.of(
            scalar,
            value,
            (low, high),
            verdict=verdict,
            p_value=p_value,
            error_before=before,
            error_after=after,
            range=(float(candidate.lower[index]), float(candidate.upper[index])),
            at_bound=bool(fitted.pushed_to_bound[index]),
        )
    return result


def _ends(findings: Findings, fits: Mapping[str, Fit]) -> dict[str, Ends]:
    """Ends of the 95 % intervals of every effect, simulated in one batch if signals may be nonlinear."""
    source = findings.search.source
    parts = {name: fitted.candidate.part(name) for name, fitted in fits.items()}
    simulated = [
        name
        for name, fitted in fits.items()
        if fitted is findings.chosen
        or (source.of_motion and source.repeated and not _seen_in_free_motion(fitted, parts[name]))
    ]
    requests = [(fits[name], range(parts[name].start, parts[name].stop)) for name in simulated]
    ends = dict(zip(simulated, intervals_of(requests), strict=True))
    return {name: ends[name] if name in ends else _linear_ends(fitted, parts[name]) for name, fitted in fits.items()}


def _linear_ends(fitted: Fit, part: slice) -> Ends:
    """Ends of the 95 % intervals of one effect by the linear model."""
    candidate, half = fitted.widened_to_intervals, fitted.half_widths * fitted.candidate.scale
    low, high = fitted.estimate - half, fitted.estimate + half
    return np.maximum(low, candidate.lower)[part], np.minimum(high, candidate.upper)[part]


def _seen_in_free_motion(fitted: Fit, part: slice) -> bool:
    """Whether free motion, which is nearly linear in every parameter, depends on an effect."""
    if fitted.evidence.free_motion_part is None:
        return not any(item.contact for item in fitted.evidence.clusters)
    jacobians = fitted.evidence.linearised_in_free_motion(fitted.candidate).jacobians
    return any(np.any(jacobian[:, part]) for jacobian in jacobians)


def undetermined(fitted: Fit) -> NDArray[np.bool_]:
    """Mask of the parameters that are not identifiable, ``(p,)``: wide intervals that contain the nominal value.

    Parameter scales follow the size of the robot. The large drive of a light arm has intervals that are wide on this
    scale; it is still determined if its interval excludes nominal.
    """
    return np.asarray(
        (fitted.half_widths > MAX_HALF_WIDTH) & (fitted.half_widths >= np.abs(fitted.distance_from_nominal))
    )


def _joint(findings: Findings, fitted: Fit, index: int) -> tuple[DiagnosisVerdict, float, float | None, float | None]:
    """Verdict and p-value of one joint's parameter given all others; its leave-one-out error without and with it."""
    candidate, evidence = fitted.candidate, fitted.evidence
    scalar = candidate.scalars[index]
    joint = f"joint{(scalar.joint or 0) + 1}"
    fit_without = Fit.of(candidate.fixed(index), evidence)
    if evidence.null.by_blocks:
        p = fitted.problem.t_test_p_value(fitted.change, evidence.null, index)
    else:
        p = fitted.problem.p_value(fit_without.residual_evidence.null, [index])
    residuals, residuals_without = fitted.problem.leave_one_out_residuals, fit_without.problem.leave_one_out_residuals
    changed = changed_features(candidate)
    if not _of_joint(evidence, residuals, scalar.arm, joint, changed).size:  # nothing of the joint was measured
        return UNIDENTIFIABLE, 1.0, None, None
    rivals = []
    for name, alternative in findings.search.joint_alternatives(fitted, index):
        changed_by_either = changed_features(candidate, alternative)
        rival_residuals = evidence.problem(alternative).leave_one_out_residuals
        errors, of_rival = (
            _of_joint(evidence, values, scalar.arm, joint, changed_by_either) for values in (residuals, rival_residuals)
        )
        if tied_errors(errors, of_rival, 1e-12):
            rivals.append(name)
    if undetermined(fitted)[index]:
        verdict = UNIDENTIFIABLE
    elif fitted.pushed_to_bound[index]:
        verdict = AT_BOUND
    elif p >= SIGNIFICANCE_LEVEL:
        verdict = NO_IMPROVEMENT
    else:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(findings.shown(rivals)))) if rivals else CONFIRMED
    if evidence.source.repeated:
        return verdict, reported_p(p), None, None
    in_units = [
        [values * item.sigma for item, values in zip(evidence.clusters, scaled, strict=True)]
        for scaled in (residuals_without, residuals)
    ]
    before, after = (
        math.sqrt(float(_of_joint(evidence, scaled, scalar.arm, joint, changed).mean())) for scaled in in_units
    )
    return verdict, reported_p(p), before, after


def _of_joint(
    evidence: Evidence, residuals: Sequence[Array], arm: str, joint: str, masks: Sequence[NDArray[np.bool_]]
) -> Array:
    """Mean square residual of one joint in each cluster that measures it, ``(c,)`` [-]; ``arm`` empty: all arms."""
    mean_squares = []
    for item, values, mask in zip(evidence.clusters, residuals, masks, strict=True):
        of_joint = np.array(
            [f.index.rsplit(".", 1)[-1] == joint and (not arm or f.arm in ("", arm)) for f in item.features]
        )
        of_joint &= mask
        if np.any(of_joint):
            mean_squares.append(float(np.mean(np.square(values[of_joint]))))
    return np.array(mean_squares)


def _alike_at_joints(verdicts: Sequence[DiagnosisVerdict | None]) -> tuple[str, ...]:
    """Rivals of an effect by the verdicts on its joints: rivals at all joints, or else at any joint.

    Empty if a joint is confirmed or no joint has a rival: an effect is as certain as its most certain joint.
    """
    sets = [set(verdict.names) for verdict in verdicts if verdict is not None and verdict.kind is Kind.CONFUSABLE]
    if CONFIRMED in verdicts or not sets:
        return ()
    return tuple(sorted(set.intersection(*sets) or set.union(*sets)))
