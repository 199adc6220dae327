# SPDX-License-Identifier: Apache-2.0
"""State variables of the policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, NOTHING
from impact_rs_analysis.investigation.rounds import (
    Round,
    added_effects,
    laws_added,
    laws_found,
    model_count,
    planned_trials,
    vain_discoveries,
)
from impact_rs_analysis.investigation.settings import Settings


@dataclass(frozen=True)
class RoundState:
    """State after a round, as far as the policy depends on it.

    Attributes:
        round: The round.
        diagnosis: Diagnosis for the decision: of the round's model, or of the first model if the round's model fails.
        budget: Largest number of trials.
        remaining: Number of remaining trials.
        models: Number of models so far.
        added: Effects that the newest model has beyond the first one.
        laws_added: Added effects that are laws beyond the library.
        validated: Whether the round's model has effects and lacks nothing, in trials that include newer ones.
        holds: Whether the model of ``diagnosis`` lacks nothing.
        holds_twice: Whether it lacked nothing a round earlier as well, and a newer trial is usable.
        to_show: Effects that would be significant if tested alone, and that the next trials shall show or exclude.
        unexplained: Whether something remains that no effect and no law explains.
        laws: Laws of the last successful discovery, and the laws tied with them.
        vain_discoveries: Number of discoveries that found no law.
        extension: Effects that the newest model lacks and that extend it.
        reestimated: Whether the newest model predicted the new trials, and a diagnosis of the first model with all
            trials names the same effects.
        unconfirmed: Named effects or laws that are not confirmed.
    """

    round: Round
    diagnosis: DiagnosisDocument
    budget: int
    remaining: int
    models: int
    added: frozenset[str]
    laws_added: tuple[str, ...]
    validated: bool
    holds: bool
    holds_twice: bool
    to_show: tuple[str, ...]
    unexplained: bool
    laws: tuple[str, ...]
    vain_discoveries: int
    extension: tuple[str, ...]
    reestimated: bool
    unconfirmed: tuple[str, ...]

    @classmethod
    def of(cls, settings: Settings, rounds: Sequence[Round], budget: int) -> RoundState:
        """The state after some rounds, the last one complete but for its decision.

        Args:
            settings: Settings of the investigation.
            rounds: All rounds.
            budget: Trials at most.
        """
        round_, before = rounds[-1], rounds[-2] if len(rounds) > 1 else None
        diagnosis, remaining = round_.basis, budget - planned_trials(rounds)
        assert diagnosis is not None and round_.diagnosis is not None
        no_laws, present_effects = round_.laws is None, frozenset(added_effects(rounds))
        same_effects = round_.again is not None and set(round_.again.named) == present_effects
        return cls(
            round=round_,
            diagnosis=diagnosis,
            budget=budget,
            remaining=remaining,
            models=model_count(rounds),
            added=present_effects,
            laws_added=laws_added(rounds),
            validated=validated(settings, round_),
            holds=round_.basis_holds,
            holds_twice=round_.basis_holds and round_.tried and before is not None and before.basis_holds,
            to_show=_effects_to_show(before, diagnosis) if remaining > 0 else (),
            unexplained=no_laws and (round_.discovery is not None or diagnosis.verdict.leaves_residuals),
            laws=laws_found(rounds),
            vain_discoveries=vain_discoveries(rounds),
            extension=_extension(rounds) if no_laws and same_effects else (),
            reestimated=no_laws
            and same_effects
            and _confirmed(diagnosis)
            and _new_estimates_suffice(round_, diagnosis),
            unconfirmed=_unconfirmed(round_.laws or diagnosis),
        )

    @property
    def source(self) -> str:
        """File of the round with the estimates of the named effects."""
        if self.round.laws is not None:
            return "discovery.json"
        return "diagnosis.json" if self.round.again is None else "again.json"

    @property
    def named(self) -> DiagnosisDocument:
        """The diagnosis whose effects or laws are added; with laws if a discovery found some."""
        return self.round.laws or self.diagnosis


def validated(settings: Settings, round_: Round) -> bool:
    """Whether the model of a round has effects, lacks nothing, and was tested on newer trials."""
    return round_.model != settings.model and round_.tried and round_.model_holds


def p_alone(document: DiagnosisDocument | None, name: str) -> float:
    """p-value of an effect tested alone, without a correction for multiple tests; 1 if not known."""
    effect = None if document is None else document.effect(name)
    return 1.0 if effect is None or effect.p_value_alone is None else effect.p_value_alone


def _effects_to_show(before: Round | None, diagnosis: DiagnosisDocument) -> tuple[str, ...]:
    """Nominally significant effects to show or exclude before an end, as long as more trials lower their p-value."""
    already_shown, earlier = ((), None) if before is None else (before.shown, before.basis)
    return tuple(
        name
        for name in (diagnosis.nominally_significant if diagnosis.verdict == NOTHING else ())
        if name not in already_shown or p_alone(diagnosis, name) < p_alone(earlier, name)
    )


def _unconfirmed(document: DiagnosisDocument) -> tuple[str, ...]:
    """Named but unconfirmed effects of a diagnosis."""
    named = filter(None, map(document.effect, document.named))
    return tuple(effect.name for effect in named if effect.verdict != CONFIRMED)


def _confirmed(document: DiagnosisDocument) -> bool:
    """Whether a diagnosis has all effects that it names, and confirms them."""
    return not _unconfirmed(document) and None not in map(document.effect, document.named)


def _new_estimates_suffice(round_: Round, diagnosis: DiagnosisDocument) -> bool:
    """Whether the error in new trials is consistent with a right model, and new estimates leave no more than noise.

    An apparent missing effect is then the estimation error of the model, which had fewer trials: a systematic error
    that some effect explains in part.
    """
    p_value = None if round_.prediction_error is None else round_.prediction_error.p_value
    return (
        p_value is not None
        and p_value >= SIGNIFICANCE_LEVEL
        and diagnosis.held_out_error_after <= diagnosis.noise_floor
    )


def _extension(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Confirmed missing effects of the newest model that the diagnosis of the first model does not name.

    The round before named or suspected them as well, or the newest trials were measured to show them. Next to a large
    effect, a small one lowers the error of the first model by too little to be named there.
    """
    before, round_ = rounds[-2], rounds[-1]
    if before.diagnosis is None or round_.diagnosis is None or not _confirmed(round_.diagnosis):
        return ()
    named, suspected_before = (
        set(round_.diagnosis.named),
        {*before.diagnosis.named, *before.diagnosis.suspected, *before.shown},
    )
    return round_.diagnosis.named if named <= suspected_before - added_effects(rounds) else ()
