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

MAX_LEVELS_IN_SENTENCE = 6  # in a sentence


def summary_of(document: DiagnosisDocument) -> str:
    """Verdict, held-out error and largest residual in two to four sentences, and one for every other view."""
    parts = [view for view in document.views if not view.option]
    assumptions = [view for view in document.views if view.option and not view.of]
    turned = [view for view in assumptions if set(view.named) != set(document.named)]
    ranges = [_range(name, document) for name in dict.fromkeys(view.of for view in document.views if view.of)]
    sentences = [_verdict(document), *(_part(view, document) for view in parts)]
    return " ".join([*sentences, *(_turn(view, document) for view in turned), *ranges, *_circumstances(document)])


def not_tried(budget: BudgetDocument) -> str:
    """Steps left out because the processor time was spent; empty: nothing was left out."""
    if not budget.left_out:
        return ""
    what = ", ".join(budget.left_out)
    if budget.stopped:
        return f"not tried, because the search was stopped: {what}. The verdict is the best answer until then"
    return (
        f"not tried, because the processor time of {budget.limit:.3g} s was spent: {what}. A larger --budget tries them"
    )


def not_excluded(document: DiagnosisDocument) -> str:
    """Effects that could be there at a noticeable size although nothing shows them, with the largest; empty: none."""
    return _intervals(document, beyond_nominal=False)


def shown_unnamed(document: DiagnosisDocument) -> str:
    """Effects that are not named although their interval excludes the value at which they do nothing; empty: none."""
    return _intervals(document, beyond_nominal=True)


def _intervals(document: DiagnosisDocument, beyond_nominal: bool) -> str:
    """Effects of noticeable size that are not named, whose interval excludes the nominal value or does not."""
    found = []
    for name, parameter in document.not_excluded.items():
        effect = document.effect(name)
        assert effect is not None
        own = effect.parameters[parameter]
        if own.excludes_nominal == beyond_nominal:
            found.append(f"{name} ({parameter} {_span(own.interval, own.unit)})")
    return ", ".join(found)


def remaining(document: DiagnosisDocument) -> str:
    """Share of the error beyond noise that the effects leave; empty: not known.

    Held-out errors scatter about the noise, so that the difference of their squares may be negative.
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
    what = f"The {view.name} alone"
    if view.verdict == NOTHING:
        found = "nothing missing" if document.noise_floor else "no effect improves the prediction"
        return f"{what}: {found} ({before} {unit})."
    if not view.named:
        why = "beyond noise, but too small to matter" if view.verdict == SMALL else "no effect explains them"
        return f"{what}: {why} ({before} {unit})."
    small = ", too small to matter" if view.verdict == SMALL else ""
    rest = ", and more is missing" if view.verdict.leaves_residuals else ""
    fall = _fall(view.held_out_error_before, view.held_out_error_after)
    return f"{what}: {' and '.join(view.named)}{small}{rest} ({fall} {unit})."


def _bounds(document: DiagnosisDocument) -> str:
    """Named effects with an estimate at a bound; empty: none."""
    found = []
    for effect in document.effects:
        ends = [
            f"{name} = {estimate.estimate:.3g}{'' if estimate.unit == '-' else f' {estimate.unit}'}"
            for name, estimate in effect.parameters.items()
            if estimate.at_bound
        ]
        if effect.name in document.named and ends:
            found.append(f"{effect.name} is AT-BOUND ({', '.join(ends)}): another effect may be missing.")
    return " ".join(found)


def _turn(view: ViewDocument, document: DiagnosisDocument) -> str:
    """Verdict under another assumption, and whether it predicts unseen data better."""
    fall = f", {_fall(view.held_out_error_before, view.held_out_error_after)}" if view.named else ""
    text = f"The verdict depends on an assumption: with {view.name} it is {view.verdict}{fall} ({view.option})."
    return f"{text}{_preferred(view, document, 'this assumption')}"


def _preferred(view: ViewDocument, document: DiagnosisDocument, name: str) -> str:
    """That a view predicts unseen data better than the diagnosis; empty: it does not."""
    before, after = document.held_out_error_after, view.held_out_error_after
    if tied_with_best(before, after):
        return ""
    return f" The data prefer {name}: held-out error {_fall(before, after)} {_unit(document)}."


def _range(name: str, document: DiagnosisDocument) -> str:
    """Whether the verdict turns on something that is not known well, over its range."""
    whole = [view for view in document.views if view.of == name]
    views = [view for view in whole if view.allowed]
    best = min(whole, key=lambda view: view.held_out_error_after)
    if not views:
        return f"Every other value of {name} that was tried, {_ends(whole)}, predicts unseen data worse."
    text = f"the range of {name} that the data allow, {_ends(views)}" if len(views) < len(whole) else ""
    text = text or f"the whole range of {name}, {_ends(whole)}"
    prefer = _preferred(best, document, best.name)
    if turned := [view for view in views if set(view.named) != set(document.named)]:
        others = ", ".join(f"with {_span([view.value or 0.0], view.unit)} it is {view.verdict}" for view in turned)
        return f"The verdict turns on {name}: {others}.{prefer}"
    named = [effect for effect in document.effects if effect.name in document.named]
    spans = []
    for effect in named:
        for key, own in effect.parameters.items():
            estimates = [view.parameters[effect.name] for view in views]
            if not all(key in every for every in estimates):  # it depends on circumstances
                continue
            values = [own.estimate, *(every[key].estimate for every in estimates)]
            label = effect.name if len(effect.parameters) == 1 else f"{effect.name}.{key}"
            spans.append(f"{label} {_span(values, own.unit)}")
    what = "names stay" if len(named) > 1 else "name stays" if named else "verdict stays"
    return f"The {what} over {text}{': ' if spans else ''}{', '.join(spans)}.{prefer}"


def _ends(views: Sequence[ViewDocument]) -> str:
    """First and last value of a range."""
    return _span([view.value for view in views if view.value is not None], views[0].unit)


def _span(values: Sequence[float], unit: str) -> str:
    """Smallest and largest of some values."""
    digits = 4 if len(values) == 1 else 3
    ends = dict.fromkeys(f"{value:.{digits}g}" for value in (min(values), max(values)))
    return f"{' to '.join(ends)} {unit}".removesuffix(" -")


def _circumstances(document: DiagnosisDocument) -> list[str]:
    """Dependences on covariates, and covariates that are correlated."""
    found = [one for one in document.dependences if one.found]
    sentences = [_dependence(one, document) for one in found]
    if found and found[0].held_out_error_before is not None and found[0].held_out_error_after is not None:
        fall = _fall(found[0].held_out_error_before, found[0].held_out_error_after)
        sentences[-1] += f"{'. Together: held-out' if len(found) > 1 else '; held-out'} error {fall} {_unit(document)}"
    sentences += [
        f"{one.effect} may depend on {one.covariate}: {one.reason}" for one in document.dependences if one.suspected
    ]
    if document.dependences and not sentences:
        tried = dict.fromkeys(one.covariate for one in document.dependences)
        ways = {one.name: f" ({', '.join(one.ways)})" for one in document.covariates if one.ways}
        sentences.append(f"No dependence was found on {' or '.join(name + ways.get(name, '') for name in tried)}")
    if still := [one.name for one in document.covariates if not one.tried and not one.why_not]:
        sentences.append(f"Measured under too few circumstances to be judged: {', '.join(still)}")
    sentences += [f"Not judged: {one.why_not}" for one in document.covariates if one.why_not]
    for one in document.covariates:
        if one.goes_with and one.name in {own.covariate for own in found}:
            others = " and ".join(f"{name} (correlation {value:.2f})" for name, value in one.goes_with.items())
            sentences.append(f"{one.name} goes with {others}: a dependence on one may be a dependence on the other")
    return [f"{text}." for text in sentences]


def _dependence(one: DependenceDocument, document: DiagnosisDocument) -> str:
    """How an effect depends on a covariate."""
    terms = one.levels or one.curve
    several = len(one.at_mean or next(iter(terms.values()))) > 1
    (covariate,) = (item for item in document.covariates if item.name == one.covariate)
    if one.levels:
        parts = [(name, _by_level(one, name)) for name in next(iter(one.levels.values()))]
    elif one.curve:
        parts = [(name, _along_curve(one, name, covariate.unit)) for name in next(iter(one.curve.values()))]
    else:
        mean = f"{covariate.mean or 0.0:.4g} {covariate.unit}".strip()
        parts = [
            (name, f"{_estimate(own)} at the mean of {mean}, {_change(one.per_unit[name])}")
            for name, own in one.at_mean.items()
        ]
    text = "; ".join(f"{name} {sentences}" if several else sentences for name, sentences in parts)
    small = ", which is too small to matter" if one.verdict == SMALL else ""
    rivals = f"; these data cannot distinguish that from {', '.join(one.rivals)}" if one.rivals else ""
    return f"{one.effect} depends on {one.covariate}{small}: {text}{rivals}"


def _by_level(one: DependenceDocument, parameter: str) -> str:
    """Estimates of a parameter by level; of many levels the lowest and the highest."""
    values = {level: parameters[parameter] for level, parameters in one.levels.items()}
    ordered = sorted(values, key=lambda level: values[level].estimate)
    many = len(ordered) > MAX_LEVELS_IN_SENTENCE
    text = ", ".join(
        f"{_estimate(values[level])} in {level}" for level in ([ordered[0], ordered[-1]] if many else values)
    )
    return f"{text} (lowest and highest of {len(values)})" if many else text


def _along_curve(one: DependenceDocument, parameter: str, unit: str) -> str:
    """Estimates of a parameter at the knots of a curve."""
    text = ", ".join(f"{_estimate(every[parameter])} at {knot}" for knot, every in one.curve.items())
    return f"{text} {unit} (a curve, linear between these)".replace("  ", " ")


def _estimate(own: EstimateDocument) -> str:
    """An estimate with its interval and unit."""
    text = estimate_in_line(own.estimate, own.ci95)
    return text if own.unit == "-" else f"{text} {own.unit}"


def _change(own: EstimateDocument) -> str:
    """A change per unit of a number, with its sign."""
    unit, _, per = own.unit.rpartition("/")
    text = f"{'+' if own.estimate > 0.0 else ''}{estimate_in_line(own.estimate, own.ci95)}"
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
    suspicion = _suspicion(document)
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
        what = " and ".join(document.missing) or "A residual beyond noise"
        text = f"{what} is present, but too small to matter: {_small(document)}. Model '{name}' needs no change."
        if measurement and not document.missing:
            text = f"That is too small to matter: {_small(document)}. Neither calibration nor model needs a change."
        return " ".join(filter(None, [measurement, text]))
    rest = _rest(document)
    if not document.named:
        sure = " for certain" if suspicion else ""
        text = f"Model '{name}' does not predict these {runs}, and no effect in the library explains why{sure}."
        return " ".join(filter(None, [text, suspicion or _lowering(document), error, rest]))
    found = [name for name in document.named if name not in document.required]
    fall = f"{label}: {_fall(before, after)} {unit}{noise_text}." if found else error
    caveats = " ".join(filter(None, [_bounds(document), _open(document), _confusable(document)]))
    text, one = f"Model '{name}' lacks {named}.", "s" if len(document.named) == 1 else ""
    share = _share(min(max(explained(before, after, document.noise_floor), 0.0), 1.0))
    if verdict.kind is Kind.PARTLY:
        text = (
            f"Model '{name}' lacks {named}, which explain{one} {share} of the error beyond noise, and at least "
            "one more effect."
        )
    if verdict == NONE:
        taken = f"{named} take{one} {share} of the error beyond noise"
        text = f"No effect in the library explains these {runs}; {taken}."
    if measurement:
        text = _of_physics(document)
        if verdict.kind is Kind.PARTLY:
            what = "That explains" if len(found) == 1 else "Together they explain"
            part = f"{what} {share} of the error beyond noise. " if found else ""
            more = f"{part}At least one more effect, of the measurement or of the physics, is there."
            text = " ".join(filter(None, [text, more]))
    instead = "" if verdict == NONE else _instead(document)
    return " ".join(filter(None, [measurement, _required(document), instead, text, fall, caveats, rest]))


def _share(value: float) -> str:
    """A share of an error that is not all of it."""
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
    tied = [name for _, *by in document.confusable for name in by]
    if document.verdict.kind is Kind.PARTLY or not all(map(document.is_of_measurement, tied)):
        return ""
    return "No physical effect is missing."


def _instead(document: DiagnosisDocument) -> str:
    """That a fault of a reading explains as much as a named effect of the physics; empty: no fault does."""
    found = [_distinguish(*group) for group in document.confusable if _of_both(group, document)]
    return f"The measurement may be at fault. {' '.join(found)}" if found else ""


def _of_both(group: Sequence[str], document: DiagnosisDocument) -> bool:
    """Whether a named effect of the physics has a fault of a reading among its rivals."""
    one, *by = group
    return one in document.missing and any(map(document.is_of_measurement, by))


def _distinguish(one: str, *by: str) -> str:
    return f"These data cannot distinguish {one} from {', '.join(by)}."


def _fall(before: float, after: float) -> str:
    """Two errors, with three digits or as many as make them differ."""
    for digits in range(3, 18):
        first, second = f"{before:.{digits}g}", f"{after:.{digits}g}"
        if first != second:
            break
    return f"{first} → {second}"


def _suspicion(document: DiagnosisDocument) -> str:
    """Effects that may be missing, and what it takes to know; empty: none."""
    if document.within_discrepancy:
        best = document.effect(document.within_discrepancy[0])
        assert best is not None
        fall = _fall(best.held_out_error_before or 0.0, best.held_out_error_alone or 0.0)
        what = _may_be_wrong([best.name], document)
        return (
            f"{what}: with it the held-out error falls ({fall} {_unit(document)}), but by no more "
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
    """That some effects may be there, those of the measurement first."""
    faults = [name for name in names if document.is_of_measurement(name)]
    others = [name for name in names if name not in faults]
    parts = [f"The measurement may be at fault ({', '.join(faults)})"] if faults else []
    return " and ".join([*parts, *([f"{' and '.join(others)} may be missing"] if others else [])])


def _lowering(document: DiagnosisDocument) -> str:
    """Effects that are significant and lower the error, but are not named."""
    found = [
        effect.name
        for effect in document.effects
        if effect.p_value is not None and effect.p_value < SIGNIFICANCE_LEVEL and effect.lowers
    ]
    return f"Significant, but too little or not supported by the hold-out: {', '.join(found)}." if found else ""


def _open(document: DiagnosisDocument) -> str:
    """Named effects of unknown size."""
    found = [e.name for e in document.effects if e.name in document.named and e.verdict == UNIDENTIFIABLE]
    return f"The data do not say how large: {', '.join(found)}." if found else ""


def _confusable(document: DiagnosisDocument) -> str:
    """Which effects cannot be distinguished."""
    return " ".join(_distinguish(*group) for group in document.confusable if not _of_both(group, document))


def _small(document: DiagnosisDocument) -> str:
    """Largest change of a signal, with its unit."""
    sizes = [size for effect in document.effects if effect.name in document.named for size in effect.sizes[:1]]
    if sizes:
        return ", ".join(
            f"at most {size.value:.2g} {size.unit} of the {size.signal} (relevance limit {size.floor:.2g})"
            for size in sizes
        )
    rest = max(document.unexplained.where, key=lambda entry: entry.value / (entry.floor or 1.0), default=None)
    return "" if rest is None else f"{rest.value:.2g} {rest.unit} of the {rest.signal} {rest.index}"


def _rest(document: DiagnosisDocument) -> str:
    """Largest residuals, in the units of the signals."""
    rests = [entry for entry in document.unexplained.where if entry.value > max(entry.floor, 1e-12)]
    if document.error_unit != TIMES and document.joints:
        worst = max(document.joints, key=lambda joint: joint.after, default=None)
        return "" if worst is None else f"Largest residual: {worst.after:.2g} {worst.unit}, in {worst.joint}."
    if not rests:
        return "All residuals are below their relevance limits."
    shown = "; ".join(f"{e.value:.2g} {e.unit} of the {e.signal} {e.index} ({e.phase})" for e in rests[:2])
    return f"Largest residual{'s' if len(rests) > 1 else ''}: {shown}."
