# SPDX-License-Identifier: Apache-2.0
"""Summary of a diagnosis in words."""

from __future__ import annotations

from impact_rs_analysis.diagnosis.document import NONE, NOTHING, PARTLY, SMALL, TOO_FEW, DiagnosisDocument, ViewDocument
from impact_rs_analysis.evidence.cluster import TIMES


def summary_of(document: DiagnosisDocument) -> str:
    """Verdict, held-out error and largest residual in two to four sentences, and one for every other view."""
    parts = [view for view in document.views if not view.option]
    turned = [view for view in document.views if view.option and set(view.named) != set(document.named)]
    sentences = [_verdict(document), *(_part(view, document) for view in parts)]
    return " ".join([*sentences, *(_turn(view) for view in turned)])


def _part(view: ViewDocument, document: DiagnosisDocument) -> str:
    """Verdict on a part of the signals."""
    unit = _unit(document)
    before, after = f"{view.held_out_error_before:.3g}", f"{view.held_out_error_after:.3g}"
    what = f"The {view.name} alone"
    if view.verdict == NOTHING:
        found = "nothing missing" if document.noise_floor else "no effect improves the prediction"
        return f"{what}: {found} ({before} {unit})."
    if not view.named:
        why = "beyond noise, but too small to matter" if view.verdict == SMALL else "no effect explains them"
        return f"{what}: {why} ({before} {unit})."
    small = ", too small to matter" if view.verdict == SMALL else ""
    rest = ", and more is missing" if view.verdict.startswith((PARTLY, NONE)) else ""
    return f"{what}: {' and '.join(view.named)}{small}{rest} ({before} → {after} {unit})."


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


def _turn(view: ViewDocument) -> str:
    """That the verdict depends on a setting."""
    return f"The verdict turns on which points touch: with {view.name} it is {view.verdict} ({view.option})."


def _unit(document: DiagnosisDocument) -> str:
    return "× repeatability" if document.error_unit == TIMES else document.error_unit


def _verdict(document: DiagnosisDocument) -> str:
    """Verdict, held-out error and largest residual."""
    name, verdict = document.model.name, document.verdict
    unit = _unit(document)
    before, after = document.held_out_error_before, document.held_out_error_after
    noise = document.noise_floor if document.error_unit != TIMES else 0.0
    noise_text = f" (noise alone: {noise:.3g})" if noise else ""
    fall = f"Held-out error: {before:.3g} → {after:.3g} {unit}{noise_text}. {_bounds(document)}".strip()
    named = " and ".join(document.named)
    runs = f"{document.runs.trials} {document.source}"
    if verdict == TOO_FEW:
        return f"These {runs} cannot decide what model '{name}' lacks. Needed: {document.design.shortage}."
    if verdict == NOTHING:
        return f"These {runs} show nothing missing in model '{name}'. Held-out error: {before:.3g} {unit}{noise_text}."
    if verdict == SMALL:
        what = named or "A residual beyond noise"
        return f"{what} is present, but too small to matter: {_small(document)}. Model '{name}' needs no change."
    rest = _rest(document)
    if verdict == NONE:
        if document.named:
            return f"No effect in the library explains these {runs}; {named} explains a small part. {fall} {rest}"
        return (
            f"Model '{name}' does not predict these {runs}, and no effect in the library explains why. Held-out error: "
            f"{before:.3g} {unit}{noise_text}. {rest}"
        )
    if verdict.startswith(PARTLY):
        share = 100.0 * (1.0 - (document.unexplained.share_of_excess or 0.0))
        return (
            f"Model '{name}' lacks {named}, which explains {share:.0f} % of the error beyond noise, and at least one "
            f"more effect. {fall} {rest}"
        )
    text = f"Model '{name}' lacks {named}. {fall}"
    for group in document.confusable:
        text += f" These data cannot distinguish {group[0]} from {', '.join(group[1:])}."
    return f"{text} {rest}".strip()


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
