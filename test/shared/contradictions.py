# SPDX-License-Identifier: Apache-2.0
"""Contradictions between what a diagnosis says in words and what its tables say."""

from __future__ import annotations

import re

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, explained
from impact_rs_analysis.diagnosis.verdict import AT_BOUND, CONFIRMED, NONE, NOTHING, SMALL, TOO_FEW, Kind
from impact_rs_analysis.evidence.cluster import TIMES

FALL = re.compile(r"([-+.0-9e]+) → ([-+.0-9e]+)")
SIGNIFICANT = 0.01


def contradictions(document: DiagnosisDocument) -> list[str]:
    """What is contradictory, in words; empty: nothing."""
    if document.verdict == TOO_FEW:
        return []
    found = [text for effect in document.effects for text in _of_effect(effect, document)]
    return found + _of_errors(document) + _of_names(document)


def _of_errors(document: DiagnosisDocument) -> list[str]:
    text, found = document.summary, []
    for before, after in FALL.findall(text):
        if not float(after) < float(before):
            found.append(f"falls from {before} to {after}")
    change = document.held_out_change_ci95
    named = document.named and document.verdict not in (NOTHING, SMALL)
    if named and document.error_unit == TIMES and not document.held_out_error_after < document.held_out_error_before:
        found.append(f"{document.verdict} is named, and the error does not fall")
    if named and document.error_unit != TIMES and change is not None and not change[1] < 0.0:
        found.append(f"{document.verdict} is named, and the error may change by {change[1]:.3g}")
    share = min(explained(document.held_out_error_before, document.held_out_error_after, document.noise_floor), 1.0)
    said = re.search(r"(\d+) % of the error beyond noise", text)
    if said and abs(float(said[1]) - 100.0 * share) > 0.51:
        found.append(f"{said[0]}, and the errors say {100 * share:.1f}")
    if document.verdict.kind is Kind.PARTLY and share < 0.495:
        found.append(f"PARTLY explains {100 * share:.0f} %")
    if document.verdict == NONE and document.named and share > 0.505:
        found.append(f"NONE-EXPLAINS, and {document.named} explain {100 * share:.0f} %")
    if "nothing missing in model" in text and not document.noise_floor:
        found.append("nothing missing, and the noise is not known")
    limits = all(rest.value <= max(rest.floor, 1e-12) for rest in document.unexplained.where)
    if "All residuals are below" in text and not limits:
        found.append("a residual is above its relevance limit")
    return found


def _of_names(document: DiagnosisDocument) -> list[str]:
    text, verdict, found = document.summary, document.verdict, []
    if verdict == NOTHING and document.named:
        found.append(f"nothing is missing, and {document.named} is named")
    if verdict not in (NOTHING, NONE, SMALL) and not document.named:
        found.append(f"{verdict}, and no effect is named")
    if any(name not in text for name in document.named):
        found.append(f"{document.named}: a named effect is not in the summary")
    by_name = {effect.name: effect for effect in document.effects}
    if any(name not in by_name for name in document.named):
        found.append("a named effect has no row")
    if "no effect in the library explains why" in text:
        for effect in document.effects:
            if _lowers(effect) and effect.name not in text:
                found.append(f"no effect explains it, and {effect.name} lowers the error with p = {effect.p_value:g}")
    if "lacks" in text and document.faults and verdict != NONE:
        found.append(f"{document.faults} of the measurement, and the model lacks something")
    tied = [name for group in document.confusable for name in group[1:] if not document.is_of_measurement(name)]
    if "No physical effect is missing" in text and (document.missing or tied or verdict.kind is Kind.PARTLY):
        found.append(f"of the physics nothing is missing, and {document.missing or tied} may be")
    if bool(document.faults) and verdict != NONE and not text.startswith("The measurement: "):
        found.append(f"{document.faults} of the measurement are not said first")
    if document.named and verdict != SMALL:
        for group in document.confusable:
            if not all(name in text for name in group):
                found.append(f"{group} cannot be distinguished, and the summary does not say so")
    return found


def _of_effect(effect: EffectDocument, document: DiagnosisDocument) -> list[str]:
    found, text = [], document.summary
    own = effect.parameters.values()
    named = effect.name in document.named
    bound = effect.verdict == AT_BOUND or any(estimate.at_bound for estimate in own)
    if named and bound and document.verdict != SMALL and "AT-BOUND" not in text:
        found.append(f"{effect.name} is at a bound, and the summary does not say so")
    sure = effect.verdict == CONFIRMED or (named and effect.verdict.kind is Kind.CONFUSABLE)
    if sure and not any(estimate.excludes_nominal for estimate in own):
        found.append(f"{effect.name} is {effect.verdict}, and its interval holds the nominal value")
    if effect.verdict == CONFIRMED and not named:
        found.append(f"{effect.name} is CONFIRMED and not named")
    for name, estimate in effect.parameters.items():
        if estimate.verdict == CONFIRMED and not estimate.excludes_nominal:
            found.append(f"{name} is CONFIRMED, and its interval holds the nominal value")
        if not estimate.interval[0] <= estimate.estimate <= estimate.interval[1]:
            found.append(f"{name} is outside its interval")
    others, after = effect.held_out_error_others, effect.held_out_error_after
    if effect.verdict == CONFIRMED and others is not None and after is not None and not after < others:
        found.append(f"{effect.name} is CONFIRMED, and the error goes from {others:g} to {after:g}")
    if _lowers(effect) and not named and not effect.reason and not effect.rivals:
        found.append(f"{effect.name} lowers the error with p = {effect.p_value:g}; neither named nor a reason given")
    return found


def _lowers(effect: EffectDocument) -> bool:
    """Whether an effect is significant and lowers the error."""
    before, after = effect.held_out_error_before, effect.held_out_error_after
    significant = effect.p_value is not None and effect.p_value < SIGNIFICANT
    return significant and before is not None and after is not None and after < before
