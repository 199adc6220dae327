# SPDX-License-Identifier: Apache-2.0
"""Score of a diagnosis against the truth of a blind campaign."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import NONE, NOTHING, Kind
from impact_rs_analysis.evidence.replays.measured_runs import runs_digest
from impact_rs_sim.errors import InputError
from impact_rs_trials.blind import RUNS, TRUTH


@dataclass(frozen=True)
class Score:
    """Score of a diagnosis.

    Attributes:
        kind: Kind of the campaign.
        truth: Hidden effects; for ``outside`` the hidden cause outside the library.
        named: Effects that the diagnosis chose.
        correct: Whether the diagnosis is right, see :func:`held_against_truth`.
        by_own_name: Whether every hidden effect was named itself, not a rival.
        headline: Whether the headline is exactly the hidden effects, or the right verdict where there are none.
        intervals_cover: Whether all true parameters lie in their 95 % intervals, also of effects that were not named;
            None where no hidden effect was measured.
        covered: Number of true parameters inside their interval, and of all true parameters.
        also_named: Chosen effects that are neither hidden nor confusable with a hidden one.
    """

    kind: str
    truth: tuple[str, ...]
    named: tuple[str, ...]
    correct: bool
    by_own_name: bool
    headline: bool
    intervals_cover: bool | None
    covered: tuple[int, int]
    also_named: tuple[str, ...]


def score(directory: Path, document: DiagnosisDocument, source: Path) -> Score:
    """Compare a diagnosis of the runs of a blind campaign with its truth (:func:`held_against_truth`).

    Args:
        directory: Blind campaign.
        document: Diagnosis of its runs.
        source: File of the diagnosis, for error messages.

    Raises:
        InputError: No blind campaign, or a diagnosis of other runs.
    """
    result = held_against_truth(directory, document)
    if document.runs.digest != runs_digest(directory / RUNS):
        raise InputError(f"this is a diagnosis of other runs than those in {directory / RUNS}", file=source)
    return result


def truth_of(directory: Path) -> tuple[str, tuple[str, ...]]:
    """Kind of a blind campaign, and the hidden effects; for ``outside`` the hidden cause.

    Raises:
        InputError: No blind campaign.
    """
    kind, hidden, outside = _read_truth(directory)
    return kind, (outside,) if kind == "outside" else tuple(hidden)


def _read_truth(directory: Path) -> tuple[str, dict[str, Any], str]:
    path = directory / TRUTH
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
        hidden = {item["name"]: item["parameters"] for item in truth["effects"]}
        return str(truth["kind"]), hidden, str(truth.get("outside"))
    except OSError:
        raise InputError(f"no blind campaign: there is no {TRUTH}", file=directory) from None
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise InputError(f"not the truth of a blind campaign ({type(error).__name__}: {error})", file=path) from None


def held_against_truth(directory: Path, document: DiagnosisDocument) -> Score:
    """Compare a diagnosis of any files of a blind campaign with its truth.

    Correct verdicts: for ``single``, the hidden effect is named or confusable with a named one; for ``pair``, both are;
    for ``null``, NOTHING-MISSING; for ``outside``, NONE-EXPLAINS, or a named effect and remaining residuals.

    Args:
        directory: Blind campaign.
        document: Diagnosis of its runs, or of files made from them.

    Raises:
        InputError: No blind campaign.
    """
    kind, hidden, outside = _read_truth(directory)
    named = document.named
    groups = [set(group) for group in document.confusable]

    def confusable_with(name: str) -> set[str]:
        return {name}.union(*(group for group in groups if name in group))

    is_named = {name: name in named or any(name in confusable_with(chosen) for chosen in named) for name in hidden}
    correct = all(is_named.values())
    headline = document.verdict.kind is Kind.NAMED and set(document.verdict.names) == set(hidden)
    if kind == "null":
        correct = headline = document.verdict == NOTHING
    elif kind == "outside":
        p_value = document.lack_of_fit.after
        residuals_reported = document.verdict.kind is Kind.PARTLY or (
            bool(named) and p_value is not None and p_value < SIGNIFICANCE_LEVEL
        )
        correct = headline = document.verdict == NONE or residuals_reported
    covered = [
        estimate.interval[0] <= hidden[name][key]["value"] <= estimate.interval[1]
        for name in hidden
        if (effect := document.effect(name)) is not None
        for key, estimate in effect.parameters.items()
        if key in hidden[name]
    ]
    return Score(
        kind=kind,
        truth=(outside,) if kind == "outside" else tuple(hidden),
        named=named,
        correct=correct,
        by_own_name=bool(hidden) and all(name in named for name in hidden),
        headline=headline,
        intervals_cover=all(covered) if covered else None,
        covered=(sum(covered), len(covered)),
        also_named=tuple(name for name in named if not confusable_with(name) & set(hidden)),
    )
