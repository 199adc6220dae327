# SPDX-License-Identifier: Apache-2.0
"""Result table as in the paper (tables comparison_push and comparison_grab), with the published numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.measure.analyze import Analysis, ExperimentSet
from impact_rs_sim.impact_map import CONTACTS
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS

MIN_SHOWN_DIFFERENCE_PERCENT = 0.005  # errors are shown in hundredths


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        label: Object and case, or the averaged sets.
        estimate: Experimental estimate [m/s]; None in the rows of averages.
        half_interval: Larger half of the 95 % interval [m/s]; None without an interval.
        systematic: Systematic band about the estimate, low then high [%]; None where no setting was varied.
        errors: Mismatch by motor-inertia model, first contact [%].
        settled: Mismatch by motor-inertia model, settled contact [%].
        paper_estimate: The paper's estimate [m/s]; None if the paper has no such row.
        paper_errors: The paper's mismatch by model [%]; None if the paper has no such row.
        signed: Whether the mismatches have a sign; absolute errors have none.
        tolerance: Mismatch up to which a prediction agrees with the estimate [%]; None: not known, or a row of
            averages.
    """

    label: str
    estimate: float | None
    half_interval: float | None
    systematic: tuple[float, float] | None
    errors: dict[str, float]
    settled: dict[str, float]
    paper_estimate: float | None
    paper_errors: dict[str, float] | None
    signed: bool = True
    tolerance: float | None = None

    def nearest(self, contact: str) -> str:
        """Motor-inertia model with the smallest mismatch for the ``first`` or the ``settled`` contact."""
        errors = self.of_contact(contact)
        return min(errors, key=lambda model: abs(errors[model]))

    def fits(self, contact: str) -> bool:
        """Whether the nearest prediction agrees with the estimate; true if the tolerance is not known."""
        return self.tolerance is None or abs(self.of_contact(contact)[self.nearest(contact)]) <= self.tolerance

    def of_contact(self, contact: str) -> dict[str, float]:
        """Mismatch by motor-inertia model for the ``first`` or the ``settled`` contact [%]."""
        return {"first": self.errors, "settled": self.settled}[contact]


def result_table(analysis: Analysis) -> list[Row]:
    """A row per set, then average error (bias) and absolute error (quality) of each scenario, and of all if several."""
    groups: dict[str, list[Row]] = {}
    for entry in analysis.sets:
        groups.setdefault(entry.scenario, []).append(_row(entry, analysis))
    if len(groups) == 1:
        (rows,) = groups.values()
        return [*rows, *_averages(rows, "")]
    table = []
    for scenario, rows in groups.items():
        table += [replace(row, label=f"{scenario}: {row.label}") for row in rows]
        table += _averages(rows, f"{scenario}: ")
    return [*table, *_averages([row for rows in groups.values() for row in rows], "All: ")] if table else []


def shown_contacts(rows: Sequence[Row]) -> tuple[str, ...]:
    """Contacts whose errors differ in the digits shown; after a flat hit both are the same."""
    differ = any(
        abs(row.errors[model] - row.settled[model]) >= MIN_SHOWN_DIFFERENCE_PERCENT
        for row in rows
        for model in row.errors
    )
    return CONTACTS if differ else CONTACTS[:1]


def _row(entry: ExperimentSet, analysis: Analysis) -> Row:
    paper = entry.published
    return Row(
        label=entry.label,
        estimate=entry.estimate,
        half_interval=None if entry.interval is None else max(abs(bound - entry.estimate) for bound in entry.interval),
        systematic=analysis.sensitivity.band(entry.scenario, entry.object),
        errors={model: entry.predictions[model].error for model in MOTOR_INERTIA_MODELS},
        settled={model: entry.predictions_settled[model].error for model in MOTOR_INERTIA_MODELS},
        paper_estimate=None if paper is None else paper.estimate,
        paper_errors=None if paper is None else paper.errors,
        tolerance=entry.tolerance,
    )


def _averages(rows: list[Row], prefix: str) -> list[Row]:
    errors, settled = [row.errors for row in rows], [row.settled for row in rows]
    published = [row.paper_errors for row in rows if row.paper_errors is not None]
    words = (("average error", False), ("absolute error", True))
    return [
        Row(
            f"{prefix}{label}" if prefix else label.capitalize(),
            None,
            None,
            None,
            _mean(errors, absolute),
            _mean(settled, absolute),
            None,
            _mean(published, absolute) if published else None,
            not absolute,
        )
        for label, absolute in words
    ]


def _mean(errors: list[dict[str, float]], absolute: bool) -> dict[str, float]:
    return {
        model: float(np.mean([abs(row[model]) if absolute else row[model] for row in errors]))
        for model in MOTOR_INERTIA_MODELS
    }
