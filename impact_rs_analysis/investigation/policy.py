# SPDX-License-Identifier: Apache-2.0
"""Policy after a round: an ordered list of rules; the first applicable one decides.

The manual (``docs/investigation.md``) has the same list in the same order, under the same names. A decision to measure
or to add becomes an end without a verdict if no trials are left.
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

MAX_VAIN_DISCOVERIES = 2  # that find no law; each takes minutes

Groups = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class PolicyRule:
    """One rule.

    Attributes:
        name: As in the manual.
        applies: Whether it decides, if no rule before it does.
        decision: Its decision.
    """

    name: str
    applies: Callable[[RoundState], bool]
    decision: Callable[[RoundState], RoundDecision]


def decide(settings: Settings, rounds: Sequence[Round], budget: int) -> RoundDecision:
    """Decision after the last of some rounds.

    Args:
        settings: Settings of the investigation.
        rounds: All rounds, the last one complete but for its decision.
        budget: Trials at most.
    """
    state = RoundState.of(settings, rounds, budget)
    return rule_for(state).decision(state)


def rule_for(state: RoundState) -> PolicyRule:
    """The first rule that applies."""
    return next(rule for rule in POLICY if rule.applies(state))


def _look(state: RoundState) -> RoundDecision:
    found = [f"{name} (p = {p_alone(state.found, name):.2g})" for name in state.look]
    begin = f"{state.here.model} holds." if state.stands else state.found.summary
    reason = f"Tested alone, {' and '.join(found)} would be significant: trials that show it or exclude it."
    return _measure(state, f"{begin} {reason}", show=state.look)


def _explained(state: RoundState) -> RoundDecision:
    reason = f"{_predicts(state.here)}, and lacks nothing in all {state.found.runs.trials}: {state.found.summary}"
    return _end(state, LAW if state.laws_added else EXPLAINED, reason)


def _too_few(state: RoundState) -> RoundDecision:
    return _measure(state, f"Too few repeats for a verdict: {state.found.design.shortage}.")


def _nothing_once(state: RoundState) -> RoundDecision:
    return _measure(state, f"{state.found.summary} New trials have to confirm it.")


def _nothing_twice(state: RoundState) -> RoundDecision:
    return _end(state, MISSES_NOTHING, f"{state.found.summary} New trials do not change it.")


def _suspected(state: RoundState) -> RoundDecision:
    names = state.found.suspected
    return _measure(state, f"{' and '.join(names)} lowers the error, but not surely on unseen conditions.", (names,))


def _loud(state: RoundState) -> RoundDecision:
    assert state.here.p_of_basis is not None
    return _measure(
        state,
        f"Nothing stands out, but a right model would hardly have an error of {state.found.held_out_error_before:.3g} "
        f"({p_in_words(state.here.p_of_basis)}): too few repeats to say what it is.",
    )


def _unexplained(state: RoundState) -> RoundDecision:
    found, discovery = state.found, state.here.discovery
    part = f"{' and '.join(found.named)} explains a part" if found.named else "No effect of the library explains it"
    reason = f"{part}: {found.summary}"
    possible = state.laws or (*found.named, *found.suspected)
    tied = (possible,) if possible else ()
    if discovery is None:
        return _measure(state, reason, tied)
    reason += f" {discovery.verdict}: {discovery.summary}"
    if state.in_vain < MAX_VAIN_DISCOVERIES:
        return _measure(state, reason, tied)
    return _undecided(state, f"{reason} And {state.in_vain} discoveries have found no law.", tied)


def _extended(state: RoundState) -> RoundDecision:
    assert state.here.diagnosis is not None
    names, summary = state.further, state.here.diagnosis.summary
    reason = f"Beside what {state.here.model} has, {' and '.join(names)} is named again: {summary}"
    return _add(state, names, "diagnosis.json", reason, state.here.model)


def _renewed(state: RoundState) -> RoundDecision:
    files = _files(state, state.found.named)
    reason = (
        f"{_predicts(state.here)}. By all {state.found.runs.trials} trials the first model lacks the same: "
        f"{state.found.summary} The estimates of {files[-1]} are from all of them."
    )
    made = {"add": state.found.named, "models": files, "source": "again.json"}
    return _end(state, EXPLAINED, reason).model_copy(update=made)


def _named(state: RoundState) -> RoundDecision:
    reason = _summary(state)
    return _add(state, state.named.named, state.source, reason)


def _tied(state: RoundState) -> RoundDecision:
    document = state.named
    unsure = filter(None, map(document.effect, state.unsure))
    reason = "; ".join(f"{effect.name} is {effect.verdict}" for effect in unsure)
    alone = tuple((name,) for name in document.named if not any(name in group for group in document.confusable))
    return _measure(state, f"{reason}. {_summary(state)}", (*document.confusable, *alone))


POLICY = (
    PolicyRule("A look before the end", lambda s: bool(s.look) and (s.stands or s.holds_twice), _look),
    PolicyRule("A model that holds", lambda s: s.stands, _explained),
    PolicyRule("Too few repeats", lambda s: s.found.verdict == TOO_FEW, _too_few),
    PolicyRule("Nothing missing, twice", lambda s: s.holds_twice, _nothing_twice),
    PolicyRule("Nothing missing, once", lambda s: s.holds, _nothing_once),
    PolicyRule("A suspicion", lambda s: s.found.verdict == NOTHING and bool(s.found.suspected), _suspected),
    PolicyRule("An error beyond noise", lambda s: s.found.verdict == NOTHING, _loud),
    PolicyRule("An unexplained residual", lambda s: s.unexplained, _unexplained),
    PolicyRule("A small effect beside a large one", lambda s: bool(s.further), _extended),
    PolicyRule("Estimates that were off", lambda s: s.renewed, _renewed),
    PolicyRule("A tie", lambda s: bool(s.unsure), _tied),
    PolicyRule("Confirmed effects", lambda s: True, _named),
)
"""The first one that applies decides."""


def _measure(state: RoundState, reason: str, tied: Groups = (), show: tuple[str, ...] = ()) -> RoundDecision:
    """Measure, or end where the budget is spent."""
    if state.left > 0:
        return RoundDecision(action="measure", reason=reason, tied=tied, show=show, budget=state.budget)
    return _undecided(state, f"{reason} And the budget of {state.budget} trials is spent.", tied, spent=True)


def _add(state: RoundState, names: Sequence[str], source: str, reason: str, base: str = "") -> RoundDecision:
    """Add effects to the first model, or to ``base``; an end where no trial is left to try the new model on."""
    files = _files(state, names)
    made = {"reason": reason, "add": tuple(names), "models": files, "source": source, "base": base}
    if state.left <= 0:
        reason = f"{reason} No trial is left to try {files[-1]} on: the budget of {state.budget} trials is spent."
        tied = tuple((name,) for name in (*sorted(state.added if base else ()), *names))
        return _undecided(state, reason, tied, spent=True).model_copy(update={**made, "reason": reason})
    tried = "It is tried on new trials."
    if not base and set(names) == state.added:
        tried = "The estimates are renewed with all trials. They are tried on new ones."
    return RoundDecision(action="add", budget=state.budget, **{**made, "reason": f"{reason} {tried}"})


def _undecided(state: RoundState, reason: str, tied: Groups, spent: bool = False) -> RoundDecision:
    """The end without an answer."""
    return RoundDecision(
        action="end", verdict=UNDECIDED, reason=reason, tied=tied, spent=spent, budget=state.budget
    )  # fmt: skip


def _end(state: RoundState, verdict: str, reason: str) -> RoundDecision:
    """The end with an answer, and with what the trials would hardly show."""
    effects = ", ".join(filter(None, [shown_unnamed(state.found), not_excluded(state.found)]))
    open_still = f" Not excluded at a noticeable size: {effects}." if effects else ""
    return RoundDecision(
        action="end",
        verdict=verdict,
        reason=f"{reason}{open_still}",
        not_excluded=tuple(state.found.not_excluded),
        budget=state.budget,
    )


def _files(state: RoundState, names: Sequence[str]) -> tuple[str, ...]:
    """Files of new models, one for each effect."""
    return tuple(f"model_{number}.yaml" for number, _ in enumerate(names, start=2 + state.models))


def _summary(state: RoundState) -> str:
    """Named effects in words, with the formulas of laws."""
    discovery, laws = state.here.discovery, state.here.laws
    if discovery is None or laws is None:
        return state.found.summary
    own = [law for law in discovery.laws if law.name in laws.named]
    texts = [f"{law.place} = {law.formula}." for law in own]
    return " ".join([discovery.summary, *texts, *(law.tie for law in own if law.tie)])


def _predicts(here: Round) -> str:
    """How well the newest model predicts the newest trials."""
    found = here.prediction_error
    assert found is not None
    return (
        f"{here.model} predicts the {found.trials} trials that were measured after it was made with an error of "
        f"{found.error:.3g} {found.unit}"
    )
