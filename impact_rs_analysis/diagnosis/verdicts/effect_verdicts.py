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


def effect_documents(found: Findings, known: dict[str, Effect]) -> list[EffectDocument]:
    """Documents of all effects: chosen ones, then the others by leave-one-out error, then those not measured."""
    search = found.search
    fits = {name: _fitted(found, name) for name in dict.fromkeys([*found.names, *search.screening.singles])}
    ends = _ends(found, fits)
    chosen = [_chosen_document(found, known[name], ends[name]) for name in found.names]
    others = [_other_document(found, known[name], fits[name], ends[name]) for name in fits if name not in found.names]
    others.sort(key=lambda report: report.held_out_error_after or 0.0)
    reports = [*chosen, *others]
    for name in sorted(search.screening.unmeasured):
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


def _chosen_document(found: Findings, effect: Effect, ends: Ends) -> EffectDocument:
    chosen = found.chosen
    assert chosen is not None
    name = effect.name
    part = chosen.candidate.part(name)
    rivals = found.shown(found.tied_with(name))
    shapes = chosen.candidate.shapes[part]
    bound, shape = chosen.held_at_bound[part][~shapes], chosen.held_at_bound[part][shapes]
    places = any(scalar.joint is not None or scalar.arm for scalar in chosen.candidate.scalars[part])
    parameters = _estimates(found, chosen, name, ends)
    amplitudes = [scalar.name for scalar in chosen.candidate.scalars[part] if not scalar.shape]
    if np.all(bound) or (np.any(bound) and not places) or np.any(shape):
        verdict, reason = AT_BOUND, "the best value lies at a bound: another effect may be missing"
    elif not any(parameters[key].excludes_nominal for key in amplitudes):
        verdict, reason = UNIDENTIFIABLE, SIZE_UNKNOWN
    elif small := _small(chosen, name):
        verdict, reason = SMALL, small
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "other effects predict unseen data as well"
    elif rivals := _alike_at_joints([one.verdict for one in parameters.values()]):
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, rivals)
        reason = "at no joint it predicts unseen data better than these"
    else:
        verdict, reason = CONFIRMED, "predicts unseen data, and no other effect does as well"
    searched = () if found.hold_out is None else found.hold_out.found
    return _document(
        found,
        effect,
        chosen,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=parameters,
        held_out_error_before=_error(found, None),
        held_out_error_others=_error_without(found, name),
        sizes=tuple(sizes_of(chosen, name)),
        chosen_in_folds=sum(name in names for names in searched) if searched else None,
    )


def _as_rival(found: Findings, name: str) -> Rival | None:
    """The rival by which an unchosen effect is reported: the best tied one, or else the best; None: it is no rival."""
    own = [rival for rival in found.rivals if rival.name == name]
    tied = [rival for rival in own if rival.tied]
    return min(tied or own, key=lambda rival: rival.fit.score, default=None)


def _fitted(found: Findings, name: str) -> Fit:
    """The reported fit of an effect: with the other chosen ones, in place of its chosen rival, or else beside them."""
    if found.chosen is not None and name in found.names:
        return found.chosen
    best = _as_rival(found, name)
    return found.search.screening.linear_fit_with(found.chosen, name) if best is None else best.fit


def _other_document(found: Findings, effect: Effect, fitted: Fit, ends: Ends) -> EffectDocument:
    """Document of an unchosen effect."""
    search, evidence, name = found.search, found.evidence, effect.name
    best = _as_rival(found, name)
    part = fitted.candidate.part(name)
    rivals = found.shown(dict.fromkeys(one.instead_of for one in found.rivals if one.name == name and one.tied))
    if evidence.null.shortage is not None:
        verdict, reason = TOO_FEW, evidence.null.shortage
    elif evidence.source.impossible:
        verdict, reason = UNIDENTIFIABLE, "the measurements break a law that holds for every contact"
    elif np.all(undetermined(fitted)[part] | fitted.candidate.shapes[part]):
        verdict, reason = UNIDENTIFIABLE, "the data do not determine it: its interval is too wide"
    elif rivals:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(rivals)))
        reason = "predicts unseen data as well in place of the chosen effect"
    elif found.adjusted.get(name, 1.0) < SIGNIFICANCE_LEVEL and best is None:
        verdict, reason = NO_IMPROVEMENT, "significant, but it hardly lowers the held-out error"
        if not excludes_nominal(fitted, name):
            reason = "significant, but its interval contains the nominal value"
        elif small := _small(fitted, name):
            verdict, reason = SMALL, small
    else:
        verdict, reason = NO_IMPROVEMENT, ""
        if name in search.screening.ruled_out:
            reason = "free motion shows no sign of it, so it was not fitted in contact"
    before = _error(found, found.chosen)
    return _document(
        found,
        effect,
        fitted,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        parameters=_estimates(found, fitted, name, ends),
        held_out_error_before=before,
        held_out_error_others=before if best is None else _error_without(found, best.instead_of),
        sizes=tuple(sizes_of(fitted, name)) if verdict != NO_IMPROVEMENT else (),
    )


def _small(fitted: Fit, name: str) -> str:
    """Largest change by an effect that changes no signal beyond its relevance limit; empty: it changes some."""
    sizes = sizes_of(fitted, name)
    if not sizes or exceeds_relevance_limit(fitted, fitted.candidate.part(name)):
        return ""
    largest = sizes[0]
    return f"at most {largest.value:.2g} {largest.unit} of the {largest.signal}; relevance limit {largest.floor:.2g}"


def _document(found: Findings, effect: Effect, fitted: Fit, **own: Any) -> EffectDocument:
    """Document of an effect with what chosen and other effects have in common."""
    name = effect.name
    return EffectDocument(
        name=effect.shown_name,
        sentence=effect.sentence,
        held_out_error_after=_error(found, fitted),
        held_out_error_alone=_error(found, found.chosen if found.names == (name,) else found.search.alone(name)),
        p_value=reported_p(found.adjusted.get(name, 1.0)),
        p_value_alone=reported_p(found.p_values.get(name, 1.0)),
        **own,
    )


def _error(found: Findings, fitted: Fit | None) -> float:
    """Leave-one-out error of a fit, or of the model (None)."""
    return residual_size(found.evidence, found.search.leave_one_out_residuals(fitted))


def _error_without(found: Findings, name: str) -> float | None:
    """Leave-one-out error of the chosen effects but one; None if they cannot be simulated."""
    assert found.chosen is not None
    if found.names == (name,):
        return _error(found, None)
    fitted = found.search.without(found.chosen, name)
    return None if fitted is None else _error(found, fitted)


def _estimates(found: Findings, fitted: Fit, name: str, ends: Ends) -> dict[str, EstimateDocument]:
    """Estimates of one effect with intervals, clipped to the bounds of the parameters."""
    candidate = fitted.candidate
    part = candidate.part(name)
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
        result[scalar.name] = EstimateDocument.of(
            scalar,
            value,
            (low, high),
            verdict=verdict,
            p_value=p,
            error_before=before,
            error_after=after,
            range=(float(candidate.lower[index]), float(candidate.upper[index])),
            at_bound=bool(fitted.held_at_bound[index]),
        )
    return result


def _ends(found: Findings, fits: Mapping[str, Fit]) -> dict[str, Ends]:
    """Ends of the 95 % intervals of every effect; simulated where its signals may be nonlinear, all at once."""
    source = found.search.source
    parts = {name: fitted.candidate.part(name) for name, fitted in fits.items()}
    simulated = [
        name
        for name, fitted in fits.items()
        if fitted is found.chosen
        or (source.of_motion and source.repeated and not _seen_in_free_motion(fitted, parts[name]))
    ]
    wanted = [(fits[name], range(parts[name].start, parts[name].stop)) for name in simulated]
    ends = dict(zip(simulated, intervals_of(wanted), strict=True))
    return {name: ends[name] if name in ends else _linear_ends(fitted, parts[name]) for name, fitted in fits.items()}


def _linear_ends(fitted: Fit, part: slice) -> Ends:
    """Ends of the 95 % intervals of one effect by its sensitivities."""
    candidate, half = fitted.with_room, fitted.half_widths * fitted.candidate.scale
    low, high = fitted.estimate - half, fitted.estimate + half
    return np.maximum(low, candidate.lower)[part], np.minimum(high, candidate.upper)[part]


def _seen_in_free_motion(fitted: Fit, part: slice) -> bool:
    """Whether free motion, which is nearly linear in every parameter, depends on an effect."""
    if fitted.evidence.free_motion_part is None:
        return not any(item.contact for item in fitted.evidence.clusters)
    free = fitted.evidence.linearised_in_free_motion(fitted.candidate).jacobians
    return any(np.any(jacobian[:, part]) for jacobian in free)


def undetermined(fitted: Fit) -> NDArray[np.bool_]:
    """Mask of the parameters that are not identifiable, ``(p,)``: wide intervals that contain the nominal value.

    Parameter scales follow the size of the robot. A drive that is large beside a light arm has wide intervals on that
    scale and is determined all the same, if its interval excludes nominal.
    """
    return np.asarray((fitted.half_widths > MAX_HALF_WIDTH) & (fitted.half_widths >= np.abs(fitted.away)))


def _joint(found: Findings, fitted: Fit, index: int) -> tuple[DiagnosisVerdict, float, float | None, float | None]:
    """Verdict and p-value of one joint's parameter given all others; its leave-one-out error without and with."""
    candidate, evidence = fitted.candidate, fitted.evidence
    scalar = candidate.scalars[index]
    joint = f"joint{(scalar.joint or 0) + 1}"
    without = Fit.of(candidate.fixed(index), evidence)
    if evidence.null.by_blocks:
        p = fitted.problem.p_by_interval(fitted.change, evidence.null, index)
    else:
        p = fitted.problem.p_value(without.left.null, [index])
    rest, rest_without = fitted.problem.leave_one_out_residuals, without.problem.leave_one_out_residuals
    changed = changed_features(candidate)
    if not _of_joint(evidence, rest, scalar.arm, joint, changed).size:  # nothing of the joint was measured
        return UNIDENTIFIABLE, 1.0, None, None
    rivals = []
    for name, other in found.search.joint_alternatives(candidate, index):
        either = changed_features(candidate, other)
        theirs = evidence.problem(other).leave_one_out_residuals
        errors, of_rival = (_of_joint(evidence, values, scalar.arm, joint, either) for values in (rest, theirs))
        if tied_errors(errors, of_rival, 1e-12):
            rivals.append(name)
    if undetermined(fitted)[index]:
        verdict = UNIDENTIFIABLE
    elif fitted.held_at_bound[index]:
        verdict = AT_BOUND
    elif p >= SIGNIFICANCE_LEVEL:
        verdict = NO_IMPROVEMENT
    else:
        verdict = DiagnosisVerdict(Kind.CONFUSABLE, tuple(sorted(found.shown(rivals)))) if rivals else CONFIRMED
    if evidence.source.repeated:
        return verdict, reported_p(p), None, None
    in_units = [
        [values * item.sigma for item, values in zip(evidence.clusters, each, strict=True)]
        for each in (rest_without, rest)
    ]
    before, after = (
        math.sqrt(float(_of_joint(evidence, each, scalar.arm, joint, changed).mean())) for each in in_units
    )
    return verdict, reported_p(p), before, after


def _of_joint(
    evidence: Evidence, rest: Sequence[Array], arm: str, joint: str, among: Sequence[NDArray[np.bool_]]
) -> Array:
    """Mean square residual of one joint by cluster that measures it, ``(c,)`` [-]; ``arm`` empty: all arms."""
    picked = []
    for item, values, mask in zip(evidence.clusters, rest, among, strict=True):
        own = np.array([f.index.rsplit(".", 1)[-1] == joint and (not arm or f.arm in ("", arm)) for f in item.features])
        own &= mask
        if np.any(own):
            picked.append(float(np.mean(np.square(values[own]))))
    return np.array(picked)


def _alike_at_joints(verdicts: Sequence[DiagnosisVerdict | None]) -> tuple[str, ...]:
    """Rivals of an effect by the verdicts on its joints: common to all joints, or else of any.

    Empty if a joint is confirmed, or no joint has a rival: an effect is as certain as the most certain of its joints.
    """
    sets = [set(one.names) for one in verdicts if one is not None and one.kind is Kind.CONFUSABLE]
    if CONFIRMED in verdicts or not sets:
        return ()
    return tuple(sorted(set.intersection(*sets) or set.union(*sets)))
