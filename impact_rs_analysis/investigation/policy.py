# SPDX-License-Identifier: Apache-2.0
"""Policy after a round: an ordered list of rules; the first applicable one decides.

The manual (``docs/investigation.md``) has the same list in the same order, under the same names. If no trials are left,
a decision to measure or to add becomes an undecided end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from impact_rs_analysis.diagnosis.verdict import NOTHING, TOO_FEW
from impact_rs_analysis.diagnosis.verdicts.words import not_excluded, shown_unnamed
from impact_rs_analysis.investigation.endings import EXPLAINED, LAW, MISSES_NOTHING, UNDECIDED
from impact_rs_analysis.investigation.error_test import p_in_words
from impact_rs_analysis.investigation.round_state import RoundState, p_alone
from impact_rs_analysis.investigation.rounds import Round, RoundDecision
from impact_rs_analysis.investigation.settings import Settings

MAX_VAIN_DISCOVERIES = 2  # without a law; each takes minutes

Groups = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class PolicyRule:
    """One rule.

    Attributes:
        name: Name in the manual.
        applies: Whether the rule applies; the first applicable rule decides.
        decision: Decision of the rule.
    """

    name: str
    applies: Callable[[RoundState], bool]
    decision: Callable[[RoundState], RoundDecision]


def decide(settings: Settings, rounds: Sequence[Round], budget: int) -> RoundDecision:
    """Decision after the last round.

    Args:
        settings: Settings of the investigation.
        rounds: All rounds, the last one complete but for its decision.
        budget: Largest number of trials.
    """
    state = RoundState.of(settings, rounds, budget)
    return rule_for(state).decision(state)


def rule_for(state: RoundState) -> PolicyRule:
    """The first rule that applies."""
    return next(rule for rule in POLICY if rule.applies(state))


def _look_before_end(state: RoundState) -> RoundDecision:
    p_values = [f"{name} (p = {p_alone(state.diagnosis, name):.2g})" for name in state.to_show]
    opening = f"{state.round.model} holds." if state.validated else state.diagnosis.summary
    reason = f"Tested alone, {' and '.join(p_values)} would be significant; the next trials shall show or exclude it."
    return _measure(state, f"{opening} {reason}", show=state.to_show)


def _explained(state: RoundState) -> RoundDecision:
    reason = (
        f"{_predicts(state.round)}, and lacks nothing in all {state.diagnosis.runs.trials}: {state.diagnosis.summary}"
    )
    return _end(state, LAW if state.laws_added else EXPLAINED, reason)


def _too_few(state: RoundState) -> RoundDecision:
    return _measure(state, f"Too few repeats for a verdict: {state.diagnosis.design.shortage}.")


def _nothing_once(state: RoundState) -> RoundDecision:
    return _measure(state, f"{state.diagnosis.summary} New trials have to confirm it.")


def _nothing_twice(state: RoundState) -> RoundDecision:
    return _end(state, MISSES_NOTHING, f"{state.diagnosis.summary} New trials do not change it.")


def _suspected(state: RoundState) -> RoundDecision:
    names = state.diagnosis.suspected
    return _measure(state, f"{' and '.join(names)} lowers the error, but not surely on unseen conditions.", (names,))


def _error_beyond_noise(state: RoundState) -> RoundDecision:
    assert state.round.p_of_basis is not None
    return _measure(
        state,
        "Nothing stands out, but a right model would hardly have an error of "
        f"{state.diagnosis.held_out_error_before:.3g} ({p_in_words(state.round.p_of_basis)}): "
        "too few repeats to say what it is.",
    )


def _unexplained(state: RoundState) -> RoundDecision:
    diagnosis, discovery = state.diagnosis, state.round.discovery
    opening = (
        f"{' and '.join(diagnosis.named)} explains a part"
        if diagnosis.named
        else "No effect of the library explains it"
    )
    reason = f"{opening}: {diagnosis.summary}"
    candidates = state.laws or (*diagnosis.named, *diagnosis.suspected)
    tied = (candidates,) if candidates else ()
    if discovery is None:
        return _measure(state, reason, tied)
    reason += f" {discovery.verdict}: {discovery.summary}"
    if state.vain_discoveries < MAX_VAIN_DISCOVERIES:
        return _measure(state, reason, tied)
    return _undecided(state, f"{reason} And {state.vain_discoveries} discoveries have found no law.", tied)


def _extended(state: RoundState) -> RoundDecision:
    assert state.round.diagnosis is not None
    names, summary = state.extension, state.round.diagnosis.summary
    reason = f"In addition to the effects of {state.round.model}, {' and '.join(names)} is named again: {summary}"
    return _add(state, names, "diagnosis.json", reason, state.round.model)


def _reestimated(state: RoundState) -> RoundDecision:
    files = _files(state, state.diagnosis.named)
    reason = (
        f"{_predicts(state.round)}. In all {state.diagnosis.runs.trials} trials the first model lacks these effects: "
        f"{state.diagnosis.summary} The estimates of {files[-1]} are from all of them."
    )
    update = {"add": state.diagnosis.named, "models": files, "source": "again.json"}
    return _end(state, EXPLAINED, reason).model_copy(update=update)


def _named(state: RoundState) -> RoundDecision:
    reason = _summary(state)
    return _add(state, state.named.named, state.source, reason)


def _tied(state: RoundState) -> RoundDecision:
    document = state.named
    unsure = filter(None, map(document.effect, state.unconfirmed))
    reason = "; ".join(f"{effect.name} is {effect.verdict}" for effect in unsure)
    alone = tuple((name,) for name in document.named if not any(name in group for group in document.confusable))
    return _measure(state, f"{reason}. {_summary(state)}", (*document.confusable, *alone))


POLICY = (
    PolicyRule("A look before the end", lambda s: bool(s.to_show) and (s.validated or s.holds_twice), _look_before_end),
    PolicyRule("A model that holds", lambda s: s.validated, _explained),
    PolicyRule("Too few repeats", lambda s: s.diagnosis.verdict == TOO_FEW, _too_few),
    PolicyRule("Nothing missing, twice", lambda s: s.holds_twice, _nothing_twice),
    PolicyRule("Nothing missing, once", lambda s: s.holds, _nothing_once),
    PolicyRule("A suspicion", lambda s: s.diagnosis.verdict == NOTHING and bool(s.diagnosis.suspected), _suspected),
    PolicyRule("An error beyond noise", lambda s: s.diagnosis.verdict == NOTHING, _error_beyond_noise),
    PolicyRule("An unexplained residual", lambda s: s.unexplained, _unexplained),
    PolicyRule("A small effect beside a large one", lambda s: bool(s.extension), _extended),
    PolicyRule("Estimates that were off", lambda s: s.reestimated, _reestimated),
    PolicyRule("A tie", lambda s: bool(s.unconfirmed), _tied),
    PolicyRule("Confirmed effects", lambda s: True, _named),
)
"""The first applicable rule decides."""


def _measure(state: RoundState, reason: str, tied: Groups = (), show: tuple[str, ...] = ()) -> RoundDecision:
    """Measure, or end if the budget is spent."""
    if state.remaining > 0:
        return RoundDecision(action="measure", reason=reason, tied=tied, show=show, budget=state.budget)
    return _undecided(state, f"{reason} And the budget of {state.budget} trials is spent.", tied, spent=True)


def _add(state: RoundState, names: Sequence[str], source: str, reason: str, base: str = "") -> RoundDecision:
    """Add effects to the first model, or to ``base``; an undecided end if no trial is left to test the new model."""
    files = _files(state, names)
    update = {"reason": reason, "add": tuple(names), "models": files, "source": source, "base": base}
    if state.remaining <= 0:
        reason = f"{reason} No trial is left to try {files[-1]} on: the budget of {state.budget} trials is spent."
        tied = tuple((name,) for name in (*sorted(state.added if base else ()), *names))
        return _undecided(state, reason, tied, spent=True).model_copy(update={**update, "reason": reason})
    next_step = "It is tried on new trials."
    if not base and set(names) == state.added:
        next_step = "The estimates are renewed with all trials. They are tried on new ones."
    return RoundDecision(action="add", budget=state.budget, **{**update, "reason": f"{reason} {next_step}"})


def _undecided(state: RoundState, reason: str, tied: Groups, spent: bool = False) -> RoundDecision:
    """An undecided end."""
    return RoundDecision(
        action="end", verdict=UNDECIDED, reason=reason, tied=tied, spent=spent, budget=state.budget
    )  # fmt: skip


def _end(state: RoundState, verdict: str, reason: str) -> RoundDecision:
    """An end with a verdict, and with the effects that the trials do not exclude."""
    effects = ", ".join(filter(None, [shown_unnamed(state.diagnosis), not_excluded(state.diagnosis)]))
    not_excluded_words = f" Not excluded at a noticeable size: {effects}." if effects else ""
    return RoundDecision(
        action="end",
        verdict=verdict,
        reason=f"{reason}{not_excluded_words}",
        not_excluded=tuple(state.diagnosis.not_excluded),
        budget=state.budget,
    )


def _files(state: RoundState, names: Sequence[str]) -> tuple[str, ...]:
    """Files of new models, one for each effect."""
    return tuple(f"model_{number}.yaml" for number, _ in enumerate(names, start=2 + state.models))


def _summary(state: RoundState) -> str:
    """Named effects in words, with the formulas of laws."""
    discovery, laws = state.round.discovery, state.round.laws
    if discovery is None or laws is None:
        return state.diagnosis.summary
    named_laws = [law for law in discovery.laws if law.name in laws.named]
    formulas = [f"{law.place} = {law.formula}." for law in named_laws]
    return " ".join([discovery.summary, *formulas, *(law.tie for law in named_laws if law.tie)])


def _predicts(round_: Round) -> str:
    """How well the newest model predicts the newest trials."""
    checked = round_.prediction_error
    assert checked is not None
    return (
        f"{round_.model} predicts the {checked.trials} trials that were measured after it was made with an error of "
        f"{checked.error:.3g} {checked.unit}"
    )
