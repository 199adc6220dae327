# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says, in words."""

from __future__ import annotations

from impact_rs_analysis.diagnosis.document import NONE, NOTHING, PARTLY, SMALL, TOO_FEW, DiagnosisDocument
from impact_rs_analysis.evidence.cluster import TIMES


def summary_of(document: DiagnosisDocument) -> str:
    """Two to four sentences for a reader who sees nothing else."""
    name, verdict = document.model.name, document.verdict
    unit = "times what repetition alone gives" if document.error_unit == TIMES else document.error_unit
    before, after = document.held_out_error_before, document.held_out_error_after
    fall = f"The error on data that no search has seen falls from {before:.3g} to {after:.3g} {unit}"
    noise = document.noise_floor if document.error_unit != TIMES else 0.0
    fall += f" (noise alone gives {noise:.3g})." if noise else "."
    named = " and ".join(document.named)
    runs = f"{document.runs.trials} {document.source}"
    if verdict == TOO_FEW:
        return f"These {runs} cannot decide what model '{name}' lacks. Needed: {document.design.shortage}."
    if verdict == NOTHING:
        return (
            f"Nothing is missing in model '{name}' that these {runs} could show: its error is {before:.3g} {unit}"
            f"{f', noise alone gives {noise:.3g}.' if noise else '.'}"
        )
    if verdict == SMALL:
        what = named or "A difference"
        return f"{what} is there, but too small to matter: {_small(document)}. Model '{name}' may stay as it is."
    rest = _rest(document)
    if verdict == NONE:
        if document.named:
            return f"Nothing in the library explains these {runs}. {named} helps a little. {fall} {rest}"
        return (
            f"Model '{name}' fails, and nothing in the library explains why: its error is {before:.3g} {unit}, and no "
            f"effect lowers it on unseen data. {rest}"
        )
    if verdict.startswith(PARTLY):
        share = 100.0 * (1.0 - (document.unexplained.share_of_excess or 0.0))
        return f"Model '{name}' lacks {named}, which explains {share:.0f} %, and something else. {fall} {rest}"
    text = f"Model '{name}' lacks {named}. {fall}"
    for group in document.confusable:
        text += f" These data cannot tell {group[0]} from {', '.join(group[1:])}."
    return f"{text} {rest}".strip()


def _small(document: DiagnosisDocument) -> str:
    """How much at most, in units."""
    sizes = [size for effect in document.effects if effect.name in document.named for size in effect.sizes[:1]]
    if sizes:
        return ", ".join(
            f"at most {size.value:.2g} {size.unit} of the {size.signal} (nobody cares below {size.floor:.2g})"
            for size in sizes
        )
    rest = max(document.unexplained.where, key=lambda entry: entry.value / (entry.floor or 1.0), default=None)
    return "" if rest is None else f"{rest.value:.2g} {rest.unit} of the {rest.signal} {rest.index}"


def _rest(document: DiagnosisDocument) -> str:
    """What is left, in the units of the signals."""
    rests = [entry for entry in document.unexplained.where if entry.value > max(entry.floor, 1e-12)]
    if document.error_unit != TIMES and document.joints:
        worst = max(document.joints, key=lambda joint: joint.after, default=None)
        return "" if worst is None else f"Left is at most {worst.after:.2g} {worst.unit}, in {worst.joint}."
    if not rests:
        return "What is left is below what matters in every signal."
    shown = "; ".join(f"{e.value:.2g} {e.unit} of the {e.signal} {e.index} ({e.phase})" for e in rests[:2])
    return f"Left is mostly {shown}."
