# SPDX-License-Identifier: Apache-2.0
"""End of an investigation (``ending.json``), and its score against a known truth."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from pydantic import Field

from impact_rs_analysis.diagnosis.verdict import NOTHING
from impact_rs_analysis.investigation.rounds import Round, added_effects, laws_added, newest_model, planned_trials
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.schema import Schema, load_mapping, validate
from impact_rs_trials.blind import KINDS

ENDING_FILE = "ending.json"
EXPLAINED, LAW, MISSES_NOTHING, UNDECIDED = "EXPLAINED", "LAW-HOLDS", str(NOTHING), "UNDECIDED"


class Ending(Schema):
    """How an investigation ended (``ending.json``)."""

    verdict: str = Field(description="EXPLAINED, LAW-HOLDS, NOTHING-MISSING or UNDECIDED")
    summary: str = Field(description="the end in words")
    model: str = Field(description="file of the last model")
    effects: tuple[str, ...] = Field((), description="effects that it has beyond the first model")
    laws: tuple[str, ...] = Field((), description="which of these effects are laws beyond the library")
    candidates: tuple[str, ...] = Field((), description="effects and laws that may be missing where it is undecided")
    not_excluded: tuple[str, ...] = Field(
        (), description="effects that could be there at a noticeable size, and that the trials would hardly show"
    )
    trials: int = Field(description="trials that were measured")
    rounds: int = Field(description="rounds")

    @property
    def certain(self) -> bool:
        """Whether it is a definite verdict: an effect is missing, or nothing is."""
        return self.verdict != UNDECIDED


def read_ending(directory: Path) -> Ending:
    """How an investigation ended.

    Raises:
        InputError: It has not ended.
    """
    path = directory / ENDING_FILE
    if not path.exists():
        raise InputError(f"this investigation has not ended: there is no {ENDING_FILE}", file=directory)
    return validate(Ending, load_mapping(path), path)


def ending_of(settings: Settings, rounds: Sequence[Round]) -> Ending:
    """The end of an investigation, from its last decision."""
    last = rounds[-1].decision
    assert last is not None and last.action == "end"
    certain = last.verdict in (EXPLAINED, LAW)
    names = tuple(sorted(added_effects(rounds))) if certain else ()
    candidates = tuple(dict.fromkeys(name for group in last.tied for name in group))
    opening = {
        EXPLAINED: f"Missing: {' and '.join(names)}.",
        LAW: f"Missing, by a law that holds: {' and '.join(names)}.",
        MISSES_NOTHING: "Nothing is missing.",
        UNDECIDED: "I cannot tell what is missing" + (f"; possible: {', '.join(candidates)}." if candidates else "."),
    }[last.verdict]
    return Ending(
        verdict=last.verdict,
        summary=f"{opening} {last.reason}{_of_the_laboratory(names)}",
        model=newest_model(settings, rounds) if certain else settings.model,
        effects=names,
        laws=laws_added(rounds) if certain else (),
        candidates=candidates,
        not_excluded=last.not_excluded,
        trials=planned_trials(rounds),
        rounds=len(rounds),
    )


def _of_the_laboratory(names: Sequence[str]) -> str:
    """Remark on the effects of a model that are faults of the readings."""
    faults = [name for name in names if name in library() and library()[name].of_measurement]
    if not faults:
        return ""
    return (
        f" Of these {' and '.join(faults)} {'is a fault' if len(faults) == 1 else 'are faults'} of this laboratory's "
        "readings: for another laboratory move it from the model to a calibration.yaml next to the trials."
    )


def judged(ending: Ending, kind: str, hidden: Sequence[str], laws: Collection[str] | None = None) -> tuple[bool, bool]:
    """Whether an end is right, and whether it is certainly wrong.

    A right end is one of these: all hidden effects and no other; undecided, with all hidden effects among the
    candidates; NOTHING-MISSING, if nothing is hidden. For a cause outside the library: a law for it that holds and no
    other effect; undecided, with such a law among the candidates or without candidates. An undecided end is never
    certainly wrong, nor an end that misses only hidden effects which it lists as not excluded.

    Args:
        ending: The end.
        kind: Kind of the hidden cause, one of ``KINDS``.
        hidden: Hidden effects of the library, or the cause outside it.
        laws: Names of the laws that are right for a cause outside the library; None: of every law.
    """
    assert kind in KINDS
    named = set(ending.effects if ending.certain else ending.candidates)
    if kind == "outside":
        true = named - set(library()) if laws is None else named & set(laws)
        right = (ending.verdict == LAW and named == true) if ending.certain else (bool(true) or not named)
    elif not ending.certain:
        right = bool(hidden) and set(hidden) <= named
    else:
        right = named == set(hidden) and (ending.verdict == MISSES_NOTHING) == (not hidden)
    missed = set(hidden) - named
    open_still = kind != "outside" and named <= set(hidden) and missed <= set(ending.not_excluded)
    return right, ending.certain and not right and not open_still
