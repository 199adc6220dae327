# SPDX-License-Identifier: Apache-2.0
"""Summary of a diagnosis in words."""

from __future__ import annotations

from collections.abc import Sequence

from impact_rs_analysis.diagnosis.document import (
    BudgetDocument,
    DependenceDocument,
    DiagnosisDocument,
    EstimateDocument,
    ViewDocument,
    explained,
    tied_with_best,
)
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import IMPOSSIBLE, NONE, NOTHING, SMALL, TOO_FEW, UNIDENTIFIABLE, Kind
from impact_rs_analysis.diagnosis.verdicts.measurement import measurement_of
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_sim.numbers import estimate_in_line

MAX_LEVELS_IN_SENTENCE = 6  # with more, a sentence has the lowest and the highest


def summary_of(document: DiagnosisDocument) -> str:
    """Verdict, held-out error and largest residual in two to four sentences, plus one per view."""
    parts = [view for view in document.views if not view.option]
    assumptions = [view for view in document.views if view.option and not view.of]
    other_verdicts = [view for view in assumptions if set(view.named) != set(document.named)]
    ranges = [_range(name, document) for name in dict.fromkeys(view.of for view in document.views if view.of)]
    sentences = [_verdict(document), *(_part(view, document) for view in parts)]
    return " ".join(
        [
            *sentences,
            *(_other_assumption(view, document) for view in other_verdicts),
            *ranges,
            *_circumstances(document),
        ]
    )


def not_tried(budget: BudgetDocument) -> str:
    """Steps left out because the processor time was spent; empty: nothing was left out."""
    if not budget.left_out:
        return ""
    steps = ", ".join(budget.left_out)
    if budget.stopped:
        return f"not tried, because the search was stopped: {steps}. The verdict is the best answer until then"
    spent = f"the processor time of {budget.limit:{'.0f' if (budget.limit or 0.0) >= 1000.0 else '.3g'}} s was spent"
    return f"not tried, because {spent}: {steps}. A larger --budget tries them"


def not_excluded(document: DiagnosisDocument) -> str:
    """Effects that may be present at a noticeable size, with the interval of one parameter; empty: no such effect."""
    return _intervals(document, beyond_nominal=False)


def shown_unnamed(document: DiagnosisDocument) -> str:
    """Effects that are not named although their interval excludes nominal; empty: no such effect."""
    return _intervals(document, beyond_nominal=True)


def _intervals(document: DiagnosisDocument, beyond_nominal: bool) -> str:
    """Unnamed effects of noticeable size, whose interval excludes nominal (``beyond_nominal``) or includes it."""
    clauses = []
    for name, parameter in document.not_excluded.items():
        effect = document.effect(name)
        assert effect is not None
        estimate = effect.parameters[parameter]
        if estimate.excludes_nominal == beyond_nominal:
            clauses.append(f"{name} ({parameter} {_span(estimate.interval, estimate.unit)})")
    return ", ".join(clauses)


def remaining(document: DiagnosisDocument) -> str:
    """Share of the error beyond noise that the effects leave; empty: not known.

    Held-out errors scatter about the noise, so the difference of their squares may be negative.
    """
    share = document.unexplained.share_of_excess
    if share is None:
        return ""
    if share < 0.005 or document.held_out_error_before <= document.noise_floor:
        return "Nothing is left beyond noise."
    if share >= 0.995:
        return "All of the error beyond noise remains."
    return f"{100.0 * share:.0f} % of the error beyond noise remains."


def _part(view: ViewDocument, document: DiagnosisDocument) -> str:
    """Verdict on a part of the signals."""
    unit = _unit(document)
    before = f"{view.held_out_error_before:.3g}"
    subject = f"The {view.name} alone"
    if view.verdict == NOTHING:
        finding = "nothing missing" if document.noise_floor else "no effect improves the prediction"
        return f"{subject}: {finding} ({before} {unit})."
    if not view.named:
        reason = "beyond noise, but too small to matter" if view.verdict == SMALL else "no effect explains them"
        return f"{subject}: {reason} ({before} {unit})."
    small = ", too small to matter" if view.verdict == SMALL else ""
    more_missing = ", and more is missing" if view.verdict.leaves_residuals else ""
    fall = _error_change(view.held_out_error_before, view.held_out_error_after)
    return f"{subject}: {' and '.join(view.named)}{small}{more_missing} ({fall} {unit})."


def _at_bounds(document: DiagnosisDocument) -> str:
    """Named effects with an estimate at a bound; empty: none."""
    sentences = []
    for effect in document.effects:
        at_bound = [
            f"{name} = {estimate.estimate:.3g}{'' if estimate.unit == '-' else f' {estimate.unit}'}"
            for name, estimate in effect.parameters.items()
            if estimate.at_bound
        ]
        if effect.name in document.named and at_bound:
            sentences.append(f"{effect.name} is AT-BOUND ({', '.join(at_bound)}): another effect may be missing.")
    return " ".join(sentences)


def _other_assumption(view: ViewDocument, document: DiagnosisDocument) -> str:
    """Verdict under another assumption, and whether it predicts unseen data better."""
    fall = f", {_error_change(view.held_out_error_before, view.held_out_error_after)}" if view.named else ""
    text = f"The verdict depends on an assumption: with {view.name} it is {view.verdict}{fall} ({view.option})."
    return f"{text}{_preferred(view, document, 'this assumption')}"


def _preferred(view: ViewDocument, document: DiagnosisDocument, name: str) -> str:
    """Sentence if a view predicts unseen data better than the diagnosis; else empty."""
    before, after = document.held_out_error_after, view.held_out_error_after
    if tied_with_best(before, after):
        return ""
    return f" The data prefer {name}: held-out error {_error_change(before, after)} {_unit(document)}."


def _range(name: str, document: DiagnosisDocument) -> str:
    """Whether the verdict depends on an uncertain quantity, over its range."""
    all_views = [view for view in document.views if view.of == name]
    views = [view for view in all_views if view.allowed]
    best = min(all_views, key=lambda view: view.held_out_error_after)
    if not views:
        return f"Every other value of {name} that was tried, {_ends(all_views)}, predicts unseen data worse."
    text = f"the range of {name} that the data allow, {_ends(views)}" if len(views) < len(all_views) else ""
    text = text or f"the whole range of {name}, {_ends(all_views)}"
    prefer = _preferred(best, document, best.name)
    if other_verdicts := [view for view in views if set(view.named) != set(document.named)]:
        alternatives = ", ".join(
            f"with {_span([view.value or 0.0], view.unit)} it is {view.verdict}" for view in other_verdicts
        )
        return f"The verdict turns on {name}: {alternatives}.{prefer}"
    named = [effect for effect in document.effects if effect.name in document.named]
    spans = []
    for effect in named:
        for key, estimate in effect.parameters.items():
            estimates = [view.parameters[effect.name] for view in views]
            if not all(key in parameters for parameters in estimates):  # it depends on circumstances
                continue
            values = [estimate.estimate, *(parameters[key].estimate for parameters in estimates)]
            label = effect.name if len(effect.parameters) == 1 else f"{effect.name}.{key}"
            spans.append(f"{label} {_span(values, estimate.unit)}")
    unchanged = "names stay" if len(named) > 1 else "name stays" if named else "verdict stays"
    return f"The {unchanged} over {text}{': ' if spans else ''}{', '.join(spans)}.{prefer}"


def _ends(views: Sequence[ViewDocument]) -> str:
    """First and last value of a range."""
    return _span([view.value for view in views if view.value is not None], views[0].unit)


def _span(values: Sequence[float], unit: str) -> str:
    """Smallest and largest value, with the unit."""
    digits = 4 if len(values) == 1 else 3
    ends = dict.fromkeys(f"{value:.{digits}g}" for value in (min(values), max(values)))
    return f"{' to '.join(ends)} {unit}".removesuffix(" -")


def _circumstances(document: DiagnosisDocument) -> list[str]:
    """Dependences on covariates, and covariates that are correlated."""
    accepted = [dependence for dependence in document.dependences if dependence.accepted]
    sentences = [_dependence(dependence, document) for dependence in accepted]
    if accepted and accepted[0].held_out_error_before is not None and accepted[0].held_out_error_after is not None:
        fall = _error_change(accepted[0].held_out_error_before, accepted[0].held_out_error_after)
        sentences[-1] += (
            f"{'. Together: held-out' if len(accepted) > 1 else '; held-out'} error {fall} {_unit(document)}"
        )
    sentences += [
        f"{dependence.effect} may depend on {dependence.covariate}: {dependence.reason}"
        for dependence in document.dependences
        if dependence.suspected
    ]
    if document.dependences and not sentences:
        tried = dict.fromkeys(dependence.covariate for dependence in document.dependences)
        ways = {
            covariate.name: f" ({', '.join(covariate.ways)})" for covariate in document.covariates if covariate.ways
        }
        sentences.append(f"No dependence was found on {' or '.join(name + ways.get(name, '') for name in tried)}")
    if insufficient := [
        covariate.name for covariate in document.covariates if not covariate.tried and not covariate.why_not
    ]:
        sentences.append(f"Measured under too few circumstances to be judged: {', '.join(insufficient)}")
    sentences += [f"Not judged: {covariate.why_not}" for covariate in document.covariates if covariate.why_not]
    for covariate in document.covariates:
        if covariate.goes_with and covariate.name in {other.covariate for other in accepted}:
            others = " and ".join(f"{name} (correlation {value:.2f})" for name, value in covariate.goes_with.items())
            sentences.append(
                f"{covariate.name} goes with {others}: a dependence on one may be a dependence on the other"
            )
    return [f"{text}." for text in sentences]


def _dependence(dependence: DependenceDocument, document: DiagnosisDocument) -> str:
    """How an effect depends on a covariate."""
    estimates = dependence.levels or dependence.curve
    several = len(dependence.at_mean or next(iter(estimates.values()))) > 1
    (covariate,) = (item for item in document.covariates if item.name == dependence.covariate)
    if dependence.levels:
        parts = [(name, _by_level(dependence, name)) for name in next(iter(dependence.levels.values()))]
    elif dependence.curve:
        parts = [
            (name, _along_curve(dependence, name, covariate.unit)) for name in next(iter(dependence.curve.values()))
        ]
    else:
        per = covariate.unit or covariate.name
        mean = f"{covariate.mean or 0.0:.4g} {covariate.unit}".strip()
        parts = [
            (
                name,
                f"{_estimate(estimate)} at the mean of {mean}, {_change(dependence.per_unit[name], per)}",
            )
            for name, estimate in dependence.at_mean.items()
        ]
    text = "; ".join(f"{name} {sentences}" if several else sentences for name, sentences in parts)
    small = ", which is too small to matter" if dependence.verdict == SMALL else ""
    rivals = f"; these data cannot distinguish that from {', '.join(dependence.rivals)}" if dependence.rivals else ""
    return f"{dependence.effect} depends on {dependence.covariate}{small}: {text}{rivals}"


def _by_level(dependence: DependenceDocument, parameter: str) -> str:
    """Estimates of a parameter by level; with many levels only the lowest and the highest."""
    values = {level: parameters[parameter] for level, parameters in dependence.levels.items()}
    ordered = sorted(values, key=lambda level: values[level].estimate)
    many = len(ordered) > MAX_LEVELS_IN_SENTENCE
    text = ", ".join(
        f"{_estimate(values[level])} in {level}" for level in ([ordered[0], ordered[-1]] if many else values)
    )
    return f"{text} (lowest and highest of {len(values)})" if many else text


def _along_curve(dependence: DependenceDocument, parameter: str, unit: str) -> str:
    """Estimates of a parameter at the knots of a curve."""
    text = ", ".join(f"{_estimate(parameters[parameter])} at {knot}" for knot, parameters in dependence.curve.items())
    return f"{text} {unit} (a curve, linear between these)".replace("  ", " ")


def _estimate(estimate: EstimateDocument) -> str:
    """An estimate with its interval and unit."""
    text = estimate_in_line(estimate.estimate, estimate.ci95)
    return text if estimate.unit == "-" else f"{text} {estimate.unit}"


def _change(estimate: EstimateDocument, per: str) -> str:
    """A change per unit of a number, with its sign."""
    unit = estimate.unit.removesuffix(f"/({per})").removesuffix(f"/{per}")
    text = f"{'+' if estimate.estimate > 0.0 else ''}{estimate_in_line(estimate.estimate, estimate.ci95)}"
    return f"{text} per {per}" if unit == "1" else f"{text} {unit} per {per}"


def _unit(document: DiagnosisDocument) -> str:
    return "× repeatability" if document.error_unit == TIMES else document.error_unit


def _verdict(document: DiagnosisDocument) -> str:
    """Verdict, held-out error and largest residual."""
    name, verdict, unit = document.model.name, document.verdict, _unit(document)
    before, after = document.held_out_error_before, document.held_out_error_after
    noise = document.noise_floor if document.error_unit != TIMES else 0.0
    noise_text = f" (noise alone: {noise:.3g})" if noise else ""
    label = f"Held-out error, with {' and '.join(document.required)}" if document.required else "Held-out error"
    error = f"{label}: {before:.3g} {unit}{noise_text}."
    named = " and ".join(document.named)
    runs = f"{document.runs.trials} {document.source}"
    suspicion = _suspected(document)
    if verdict == TOO_FEW:
        return f"These {runs} cannot decide what model '{name}' lacks. Needed: {document.design.shortage}."
    if verdict == IMPOSSIBLE:
        return f"These {runs} break a law of every impact, so no effect is named: {document.impossible}. {error}"
    if verdict == NOTHING:
        if suspicion:
            return f"These {runs} show nothing missing in model '{name}' for certain. {suspicion} {error}"
        if document.noise_floor:
            return f"These {runs} show nothing missing in model '{name}'. {error}"
        return (
            f"No effect in the library improves what model '{name}' predicts of these {runs}; how much of the error is "
            f"noise is not known. {error}"
        )
    measurement = measurement_of(document)
    if verdict == SMALL:
        subject = " and ".join(document.missing) or "A residual beyond noise"
        size = f"too small to matter: {_largest_change(document)}"
        text = f"{subject} is present, but {size}. Model '{name}' needs no change."
        if measurement and not document.missing:
            text = f"That is {size}. Neither calibration nor model needs a change."
        return " ".join(filter(None, [measurement, text]))
    residual = _largest_residuals(document)
    if not document.named:
        certainty = " for certain" if suspicion else ""
        text = f"Model '{name}' does not predict these {runs}, and no effect in the library explains why{certainty}."
        return " ".join(filter(None, [text, suspicion or _significant_but_unnamed(document), error, residual]))
    searched_names = [name for name in document.named if name not in document.required]
    fall = f"{label}: {_error_change(before, after)} {unit}{noise_text}." if searched_names else error
    caveats = " ".join(filter(None, [_at_bounds(document), _of_unknown_size(document), _confusable(document)]))
    text, s = f"Model '{name}' lacks {named}.", "s" if len(document.named) == 1 else ""
    explained_share = _share(min(max(explained(before, after, document.noise_floor), 0.0), 1.0))
    if verdict.kind is Kind.PARTLY:
        text = (
            f"Model '{name}' lacks {named}, which explain{s} {explained_share} of the error beyond noise, and at least "
            "one more effect."
        )
    if verdict == NONE:
        explains = f"{named} take{s} {explained_share} of the error beyond noise"
        text = f"No effect in the library explains these {runs}; {explains}."
    if measurement:
        text = _of_physics(document)
        if verdict.kind is Kind.PARTLY:
            subject = "That explains" if len(searched_names) == 1 else "Together they explain"
            explained_part = f"{subject} {explained_share} of the error beyond noise. " if searched_names else ""
            remainder = f"{explained_part}At least one more effect, of the measurement or of the physics, is there."
            text = " ".join(filter(None, [text, remainder]))
    fault_instead = "" if verdict == NONE else _possible_faults(document)
    return " ".join(filter(None, [measurement, _required(document), fault_instead, text, fall, caveats, residual]))


def _share(value: float) -> str:
    """A share of an error, at most "nearly all"."""
    return "nearly all" if value > 0.995 else f"{100.0 * value:.0f} %"


def _required(document: DiagnosisDocument) -> str:
    """Why a required effect is named; empty without one."""
    effects = [effect for name in document.required if (effect := document.effect(name)) is not None]
    return " ".join(f"{effect.name}: {effect.reason}." for effect in effects)


def _of_physics(document: DiagnosisDocument) -> str:
    """Missing physical effects in addition to named faults of the readings; empty: undecided."""
    if document.missing:
        be = "is" if len(document.missing) == 1 else "are"
        return f"{' and '.join(document.missing)} {be} missing in the physics."
    tied = [name for _, *rivals in document.confusable for name in rivals]
    if document.verdict.kind is Kind.PARTLY or not all(map(document.is_of_measurement, tied)):
        return ""
    return "No physical effect is missing."


def _possible_faults(document: DiagnosisDocument) -> str:
    """Sentence if a fault of a reading explains as much as a named effect of the physics; else empty."""
    sentences = [_distinguish(*group) for group in document.confusable if _joins_physics_and_fault(group, document)]
    return f"The measurement may be at fault. {' '.join(sentences)}" if sentences else ""


def _joins_physics_and_fault(group: Sequence[str], document: DiagnosisDocument) -> bool:
    """Whether a named effect of the physics has a fault of a reading among its rivals."""
    name, *rivals = group
    return name in document.missing and any(map(document.is_of_measurement, rivals))


def _distinguish(name: str, *rivals: str) -> str:
    return f"These data cannot distinguish {name} from {', '.join(rivals)}."


def _error_change(before: float, after: float) -> str:
    """Two errors, with three digits or as many as distinguish them."""
    for digits in range(3, 18):
        first, second = f"{before:.{digits}g}", f"{after:.{digits}g}"
        if first != second:
            break
    return f"{first} → {second}"


def _suspected(document: DiagnosisDocument) -> str:
    """Effects that may be missing, and the measurement that decides; empty: no effect is suspected."""
    if document.within_discrepancy:
        best = document.effect(document.within_discrepancy[0])
        assert best is not None
        fall = _error_change(best.held_out_error_before or 0.0, best.held_out_error_alone or 0.0)
        subject = _may_be_wrong([best.name], document)
        return (
            f"{subject}: with it the held-out error falls ({fall} {_unit(document)}), but by no more "
            "than the discrepancy of the rigid map. Measure it apart, or take the map as exact (--no-discrepancy)."
        )
    if not document.suspected:
        return ""
    it = "it" if len(document.suspected) == 1 else "them"
    return (
        f"{_may_be_wrong(document.suspected, document)}: with {it} the held-out error falls, but not beyond noise. "
        "More conditions decide."
    )


def _may_be_wrong(names: Sequence[str], document: DiagnosisDocument) -> str:
    """Clauses on effects that may be present, faults of the measurement first."""
    faults = [name for name in names if document.is_of_measurement(name)]
    others = [name for name in names if name not in faults]
    parts = [f"The measurement may be at fault ({', '.join(faults)})"] if faults else []
    return " and ".join([*parts, *([f"{' and '.join(others)} may be missing"] if others else [])])


def _significant_but_unnamed(document: DiagnosisDocument) -> str:
    """Significant effects that lower the error but are not named."""
    names = [
        effect.name
        for effect in document.effects
        if effect.p_value is not None and effect.p_value < SIGNIFICANCE_LEVEL and effect.lowers
    ]
    return f"Significant, but too little or not supported by the hold-out: {', '.join(names)}." if names else ""


def _of_unknown_size(document: DiagnosisDocument) -> str:
    """Named effects of unknown size."""
    names = [e.name for e in document.effects if e.name in document.named and e.verdict == UNIDENTIFIABLE]
    return f"The data do not say how large: {', '.join(names)}." if names else ""


def _confusable(document: DiagnosisDocument) -> str:
    """Effects that the data cannot distinguish."""
    return " ".join(
        _distinguish(*group) for group in document.confusable if not _joins_physics_and_fault(group, document)
    )


def _largest_change(document: DiagnosisDocument) -> str:
    """Largest change of a signal, with its unit."""
    sizes = [size for effect in document.effects if effect.name in document.named for size in effect.sizes[:1]]
    if sizes:
        return ", ".join(
            f"at most {size.value:.2g} {size.unit} of the {size.signal} (relevance limit {size.floor:.2g})"
            for size in sizes
        )
    residual = max(document.unexplained.where, key=lambda entry: entry.value / (entry.floor or 1.0), default=None)
    return "" if residual is None else f"{residual.value:.2g} {residual.unit} of the {residual.signal} {residual.index}"


def _largest_residuals(document: DiagnosisDocument) -> str:
    """Largest residuals, in the units of the signals; of recordings the signal that exceeds its noise most."""
    where = document.unexplained.where
    if document.error_unit != TIMES and document.joints:
        residuals = [
            (e.times_noise, e.value, e.unit, f"{e.signal} of {e.index}") for e in where if e.signal != "torque"
        ]
        residuals += [(j.after / j.noise, j.after, j.unit, f"torque of {j.joint}") for j in document.joints if j.noise]
        ratio, value, unit, name = max(residuals, default=(0.0, 0.0, "", ""))
        if ratio <= 1.0:
            return "No residual exceeds its noise." if residuals else ""
        return f"Largest residual: {value:.2g} {unit} in the {name}, {ratio:.2g} times its noise."
    relevant = [entry for entry in where if entry.value > max(entry.floor, 1e-12)]
    if not relevant:
        return "All residuals are below their relevance limits."
    sentences = "; ".join(f"{e.value:.2g} {e.unit} of the {e.signal} {e.index} ({e.phase})" for e in relevant[:2])
    return f"Largest residual{'s' if len(relevant) > 1 else ''}: {sentences}."
