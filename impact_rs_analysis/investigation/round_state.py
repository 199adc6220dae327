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
    added,
    laws_added,
    laws_found,
    measured,
    models_made,
    searches_in_vain,
)
from impact_rs_analysis.investigation.settings import Settings


@dataclass(frozen=True)
class RoundState:
    """State after a round, as far as the policy depends on it.

    Attributes:
        here: The round.
        found: The diagnosis that is decided on: of the round's model, or of the first model where that one fails.
        budget: Trials at most.
        left: Trials that are left.
        models: Number of models that were made.
        added: Effects that the newest model has beyond the first one.
        laws_added: Those of them that are laws beyond the library.
        stands: Whether a model with effects lacks nothing, with a usable trial that was measured after it was made.
        holds: Whether the model of ``found`` lacks nothing.
        holds_twice: Whether the same was so a round earlier, and a trial measured since is usable.
        look: Effects that would be significant if tested alone, and become so by more trials; empty: none is left.
        unexplained: Whether something remains that no effect and no law explains.
        laws: Laws that the last successful discovery found, and what is tied with them.
        in_vain: Number of discoveries that found no law.
        further: Effects that the newest model lacks, and with which it is extended.
        renewed: Whether all trials explain the first model by the effects of the newest one, which predicted the new
            ones.
        unsure: Effects or laws that are named and not confirmed.
    """

    here: Round
    found: DiagnosisDocument
    budget: int
    left: int
    models: int
    added: frozenset[str]
    laws_added: tuple[str, ...]
    stands: bool
    holds: bool
    holds_twice: bool
    look: tuple[str, ...]
    unexplained: bool
    laws: tuple[str, ...]
    in_vain: int
    further: tuple[str, ...]
    renewed: bool
    unsure: tuple[str, ...]

    @classmethod
    def of(cls, settings: Settings, rounds: Sequence[Round], budget: int) -> RoundState:
        """The state after some rounds, the last one complete but for its decision.

        Args:
            settings: Settings of the investigation.
            rounds: All rounds.
            budget: Trials at most.
        """
        here, before = rounds[-1], rounds[-2] if len(rounds) > 1 else None
        found, left = here.basis, budget - measured(rounds)
        assert found is not None and here.diagnosis is not None
        beside_laws, present = here.laws is None, frozenset(added(rounds))
        same = here.again is not None and set(here.again.named) == present
        return cls(
            here=here,
            found=found,
            budget=budget,
            left=left,
            models=models_made(rounds),
            added=present,
            laws_added=laws_added(rounds),
            stands=stands(settings, here),
            holds=here.basis_holds,
            holds_twice=here.basis_holds and here.tried and before is not None and before.basis_holds,
            look=_worth_a_look(before, found) if left > 0 else (),
            unexplained=beside_laws and (here.discovery is not None or found.verdict.leaves_residuals),
            laws=laws_found(rounds),
            in_vain=searches_in_vain(rounds),
            further=_further(rounds) if beside_laws and same else (),
            renewed=beside_laws and same and _confirmed(found) and _left_no_error(here, found),
            unsure=_unsure(here.laws or found),
        )

    @property
    def source(self) -> str:
        """File of the round with the estimates of what is named."""
        if self.here.laws is not None:
            return "discovery.json"
        return "diagnosis.json" if self.here.again is None else "again.json"

    @property
    def named(self) -> DiagnosisDocument:
        """The diagnosis whose effects or laws are added: with laws, where a discovery found some."""
        return self.here.laws or self.found


def stands(settings: Settings, here: Round) -> bool:
    """Whether a model with effects has stood the trial."""
    return here.model != settings.model and here.tried and here.model_holds


def p_alone(document: DiagnosisDocument | None, name: str) -> float:
    """p-value of an effect as if it were tested alone."""
    effect = None if document is None else document.effect(name)
    return 1.0 if effect is None or effect.p_value_alone is None else effect.p_value_alone


def _worth_a_look(before: Round | None, found: DiagnosisDocument) -> tuple[str, ...]:
    """Effects of which more trials are measured before an end, as long as these make them more significant."""
    looked, earlier = ((), None) if before is None else (before.shown, before.basis)
    return tuple(
        name
        for name in (found.nominally_significant if found.verdict == NOTHING else ())
        if name not in looked or p_alone(found, name) < p_alone(earlier, name)
    )


def _unsure(document: DiagnosisDocument) -> tuple[str, ...]:
    """Named but unconfirmed effects of a diagnosis."""
    named = filter(None, map(document.effect, document.named))
    return tuple(effect.name for effect in named if effect.verdict != CONFIRMED)


def _confirmed(document: DiagnosisDocument) -> bool:
    """Whether it has every effect that it names, and all are confirmed."""
    return not _unsure(document) and None not in map(document.effect, document.named)


def _left_no_error(here: Round, found: DiagnosisDocument) -> bool:
    """Whether the model predicted the new trials as a right one does, and new estimates leave no more than noise.

    An apparent missing effect is then the estimation error of the model, which had fewer trials: a systematic error
    that some effect partly explains.
    """
    p_value = None if here.prediction_error is None else here.prediction_error.p_value
    return p_value is not None and p_value >= SIGNIFICANCE_LEVEL and found.held_out_error_after <= found.noise_floor


def _further(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Effects that the newest model lacks for certain, beside what all trials say of the first model.

    The model before lacked them as well or perhaps, or the newest trials were measured to show them. A small effect
    beside a large one lowers the error of the first model by too little to be named there.
    """
    before, here = rounds[-2], rounds[-1]
    if before.diagnosis is None or here.diagnosis is None or not _confirmed(here.diagnosis):
        return ()
    now, known = set(here.diagnosis.named), {*before.diagnosis.named, *before.diagnosis.suspected, *before.shown}
    return here.diagnosis.named if now <= known - added(rounds) else ()
