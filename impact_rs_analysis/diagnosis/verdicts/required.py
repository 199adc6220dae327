# SPDX-License-Identifier: Apache-2.0
"""Required effects of a diagnosis: effects without which replays miss the object.

A recorded impact that is absent from the replay of a model refutes the model, whatever its other residuals. The effect
that makes all replays hit (:attr:`.Source.required`) is therefore named before the effects of the search. It is
confusable with other such effects whose residuals are as small. It is not required if an effect of another kind makes
all replays hit with smaller residuals: a filter of the velocities shows an impact late and at another position.
"""

from __future__ import annotations

from collections.abc import Sequence

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument, tied_with_best
from impact_rs_analysis.diagnosis.search.budget import Budget
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, IMPOSSIBLE, TOO_FEW, DiagnosisVerdict, Kind
from impact_rs_analysis.diagnosis.verdicts.measurement import with_readings
from impact_rs_analysis.evidence.source import RequiredEffect, Source
from impact_rs_sim.effects import Effect


def with_likelier_model(source: Source, effects: Sequence[Effect], budget: Budget) -> Source:
    """The source without its required effect, if another single effect makes all replays hit and fits better.

    Args:
        source: The measurements.
        effects: Effects to consider.
        budget: Processor time of the comparison.
    """
    without_required, rivals = source.without_required, {effect.item.name for effect in source.required}
    if without_required is None:
        return source
    evidence = Evidence.of(without_required, budget=budget)
    if evidence.null.shortage is not None:
        return source
    best = Search([effect for effect in effects if effect.name not in rivals], evidence).first()
    size = None if best is None else source.size_by_declared_model(best.candidate.effects_at(best.estimate))
    return without_required if size is not None and size < source.required[0].size else source


def with_required(document: DiagnosisDocument, source: Source) -> DiagnosisDocument:
    """The diagnosis with the required effect named first.

    Args:
        document: Diagnosis of the source; its model has the required effect.
        source: The measurements.
    """
    if not source.required or document.verdict in (TOO_FEW, IMPOSSIBLE):
        return document
    best, *others = source.required
    name = source.known_effects[best.item.name].shown_name
    rivals = tuple(other.item.name for other in others if tied_with_best(other.size, best.size))
    named = () if document.verdict.kind is Kind.SMALL else document.named
    kind = Kind.PARTLY if document.verdict.leaves_residuals else Kind.NAMED
    effect = _document(best, rivals, source)
    return document.model_copy(
        update={
            "verdict": DiagnosisVerdict(kind, (name, *named)),
            "named": (name, *named),
            "required": (name,),
            "effects": (*with_readings([effect], source.known_effects), *document.effects),
            "confusable": (*([(name, *rivals)] if rivals else []), *document.confusable),
        }
    )


def _document(required: RequiredEffect, rivals: tuple[str, ...], source: Source) -> EffectDocument:
    """The verdict on a required effect, with its estimate from the impacts."""
    effect = source.known_effects[required.item.name]
    values = required.item.parameters
    parameters = {
        scalar.name: EstimateDocument.of(scalar, values[scalar.name].estimate, values[scalar.name].ci95)
        for scalar in effect.scalars(source.joints)
    }
    return EffectDocument(
        name=effect.shown_name,
        sentence=effect.sentence,
        verdict=DiagnosisVerdict(Kind.CONFUSABLE, rivals) if rivals else CONFIRMED,
        reason=f"the replays of {required.missed} of {required.impacts} impacts hit nothing without it",
        rivals=rivals,
        parameters=parameters,
        held_out_error_before=None,
        held_out_error_after=None,
        p_value=None,
    )
