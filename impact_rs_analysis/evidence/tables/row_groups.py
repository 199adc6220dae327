# SPDX-License-Identifier: Apache-2.0
"""Rows of a table of impacts in clusters: conditions with their repeats, or blocks of neighbouring rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS, MIN_DEGREES_OF_FREEDOM
from impact_rs_analysis.evidence.source import MAX_NUMBERS_AS_LEVELS
from impact_rs_sim.effects.depending import level_name
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable

BLOCKS = 24  # at most: of 24 blocks a fold leaves 18 for the search, and the test needs 12
MIN_ROWS_OF_HALF = 2  # rows of a condition on either side of the median of a number


@dataclass(frozen=True)
class RowGroup:
    """Rows of one cluster.

    Attributes:
        name: Name of the cluster.
        unit: Clusters of one unit are held out together.
        rows: Positions in the table.
    """

    name: str
    unit: str
    rows: tuple[int, ...]


def conditions(table: ImpactTable) -> list[RowGroup] | None:
    """Conditions with their repeats, or their parts under equal circumstances; None with too few repeats.

    Args:
        table: The table.
    """
    named = {row.condition for row in table.rows}
    grouped: dict[str, list[int]] = {}
    for number, row in enumerate(table.rows):
        name = f"row {row.number}"
        if row.condition:
            name = ", ".join(filter(None, (row.object_name, row.condition)))
        elif name in named:  # a condition may be called "row 4"
            name = f"{name} without a condition"
        grouped.setdefault(name, []).append(number)
    parts = [
        RowGroup(", ".join([name, *labels]), name, tuple(rows))
        for name, whole in grouped.items()
        for labels, rows in _by_circumstances(table, whole)
    ]
    freedom = sum(len(part.rows) - 1 for part in parts)
    if len(grouped) < MIN_CLUSTERS or freedom < MIN_DEGREES_OF_FREEDOM:
        return None
    return parts


def _by_circumstances(table: ImpactTable, whole: list[int]) -> list[tuple[list[str], list[int]]]:
    """Rows of a condition by levels of all covariates, and by halves of numbers; each part with its labels."""
    parts: list[tuple[list[str], list[int]]] = [([], whole)]
    for name in table.covariates:
        split = []
        for labels, rows in parts:
            by_label = by_circumstance(table, name, rows)
            many = len({row.circumstances[name] for row in table.rows}) > MAX_NUMBERS_AS_LEVELS
            halves = many and isinstance(table.rows[rows[0]].circumstances[name], float)
            # Rows are split into halves of a number only if both halves have repeats.
            if len(by_label) == 1 or (halves and min(map(len, by_label.values())) < MIN_ROWS_OF_HALF):
                split.append((labels, rows))
            else:
                split += [([*labels, label], part) for label, part in by_label.items()]
        parts = split
    return parts


def by_circumstance(table: ImpactTable, name: str, rows: Sequence[int]) -> dict[str, list[int]]:
    """Rows by level of a covariate, or by the halves of a number about its median.

    Args:
        table: The table.
        name: The covariate.
        rows: Positions of the rows.

    Returns:
        Positions by level or half, in words.
    """
    values, unit = [table.rows[row].circumstances[name] for row in rows], table.covariates[name]
    numbers = [value for value in values if isinstance(value, float)]
    many = len({row.circumstances[name] for row in table.rows}) > MAX_NUMBERS_AS_LEVELS
    middle = float(np.median(numbers)) if numbers and many else None
    rows_by_label: dict[str, list[int]] = {}
    for row, value in zip(rows, values, strict=True):
        label = level_name(value)
        if isinstance(value, float) and middle is not None:
            label = f"{'up to' if value <= middle else 'above'} {middle:.4g}"
        rows_by_label.setdefault(f"{name} {label} {unit if numbers else ''}".strip(), []).append(row)
    return rows_by_label


def blocks(table: ImpactTable, most: int = BLOCKS) -> list[RowGroup]:
    """Blocks of neighbouring rows of about equal length, within one unit.

    Args:
        table: The table.
        most: Number of blocks, at most.
    """
    count = len(table.rows)
    pieces = min(count, most)
    edges = np.arange(pieces + 1) * count // pieces
    groups = []
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        name = f"row {low + 1}" if high - low == 1 else f"rows {low + 1} to {high}"
        groups.append(RowGroup(name, str(table.path), tuple(range(low, high))))
    return groups


def evenly(rows: Sequence[int], most: int) -> set[int]:
    """At most ``most`` of the rows, evenly spaced."""
    if len(rows) <= most:
        return set(rows)
    return {rows[index] for index in np.linspace(0, len(rows) - 1, most).round().astype(int)}
