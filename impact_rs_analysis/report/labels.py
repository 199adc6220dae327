# SPDX-License-Identifier: Apache-2.0
"""Names of phases, places and verdicts in reports."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from impact_rs_analysis.diagnosis.verdict import CONFIRMED, NO_IMPROVEMENT, TOO_FEW, UNIDENTIFIABLE, DiagnosisVerdict

if TYPE_CHECKING:
    from impact_rs_analysis.evidence.levels import Cell, JumpLevel, SignalLevel

PHASES = {"free": "Free motion", "impact": "Impact (first 80 ms)", "push": "Push"}
LEVELS = {
    "jump": "Velocity jump",
    "free_motion": "Free motion",
    "trial": "Whole trial",
    "recording": "Torque balance",
    "impacts": "Velocities just after the impact",
}
NO_OBJECT = ("", "none")
REPEATABILITY = "repeatability"
RELEVANCE_LIMIT = "the relevance limit"  # without repeats
SPREAD = "the root mean square of all, by kinetic energy"  # of impacts without repeats and without known noise
NOISE = "the noise of the signal"  # of a recorded torque or an impact


class Tag(StrEnum):
    """Colour class of a verdict."""

    GOOD = "good"
    MAYBE = "maybe"
    NO = "no"


def tag_of(verdict: DiagnosisVerdict) -> Tag:
    """Colour of the verdict on an effect or on one of its joints."""
    if verdict == CONFIRMED:
        return Tag.GOOD
    return Tag.NO if verdict in (NO_IMPROVEMENT, UNIDENTIFIABLE, TOO_FEW) else Tag.MAYBE


def phase_text(phase: str) -> str:
    """A phase of the motion."""
    return PHASES.get(phase, phase.capitalize())


def signal_text(row: SignalLevel) -> str:
    """Phase and signal, after the arm if there are several arms."""
    text = f"{phase_text(row.phase)}: {row.signal}"
    return f"{row.arm}, {text[:1].lower()}{text[1:]}" if row.arm else text


def location_text(entry: Cell | JumpLevel, scenario: bool = False) -> str:
    """Object and case of an entry, with the scenario if ``scenario``."""
    parts = [entry.scenario] if scenario else []
    if entry.object not in NO_OBJECT:
        parts.append(entry.object)
    if entry.case:
        parts.append(entry.case)
    return ", ".join(parts)
