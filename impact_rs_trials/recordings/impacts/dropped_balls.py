# SPDX-License-Identifier: Apache-2.0
"""Velocities of balls that bounce straight up and down, from the heights or durations of their flights.

Without drag and horizontal motion a ball that falls from height h hits the plane with v = sqrt(2 g h); h is the height
of its lowest point. A ball that leaves the plane with v rises to v^2 / (2 g) and is back after t = 2 v / g:

    v = sqrt(2 g h) = g t / 2,    sigma_v = g sigma_h / v = g sigma_t / 2

A bounce with v_after = e v_before has the standard deviation sqrt(sigma_after^2 + e^2 sigma_before^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.impact_cells import FileColumn, ImpactCells
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup

ASSUMED_VALUES = {col.MASS: 1.0, col.RADIUS: 0.02}  # kg, m; a straight bounce does not depend on them
ASSUMED_MOTION = (
    "velocities follow from {}, without drag, of a ball that bounces straight and does not turn: friction and spin do "
    "not show"
)


def with_velocities(cells: ImpactCells) -> ImpactCells:
    """A table of heights or durations with columns of velocities; other tables stay.

    Raises:
        InputError: Velocities as well, two measures of one flight, or a number out of range.
    """
    measures = [column for column in (*col.FLIGHTS_BEFORE, *col.FLIGHTS_AFTER) if column in cells]
    if not measures:
        return cells
    before, after = (_only_measure(cells, columns) for columns in (col.FLIGHTS_BEFORE, col.FLIGHTS_AFTER))
    for column in (col.V_BEFORE, col.V_AFTER, col.W_BEFORE, col.V_NOISE, col.V_NOISE_AXES):
        if column in cells:
            message = f"columns {cells.header(measures[0])!r} and {cells.header(column)!r}: expected one of them"
            raise InputError(message, file=cells.path)
    if before is None:
        expected = " or ".join(repr(column.header) for column in col.FLIGHTS_BEFORE)
        raise InputError(f"column {cells.header(measures[0])!r} without {expected}", file=cells.path)
    speed_before, noise_before = _speeds(cells, before)
    added: dict[ColumnGroup, Sequence[Array | float]] = {
        col.V_BEFORE: (0.0, 0.0, -speed_before),
        col.W_BEFORE: (0.0, 0.0, 0.0),
    }
    if after is not None:
        speed_after, noise_after = _speeds(cells, after)
        added[col.V_AFTER] = (0.0, 0.0, speed_after)
        if np.isnan(noise_after).all() != np.isnan(noise_before).all():
            missing = next(column for column in (col.HEIGHT_NOISE, col.FLIGHT_NOISE) if column not in cells)
            raise InputError(
                f"column {missing.headers[0]!r} is missing; expected the noise of both measures, or of neither",
                file=cells.path,
            )
        if not np.isnan(noise_after + noise_before).any():
            added[col.V_NOISE_AXES] = (0.0, 0.0, np.hypot(noise_after, speed_after / speed_before * noise_before))
    added |= {column: (value,) for column, value in ASSUMED_VALUES.items() if column not in cells}
    columns, by_name = dict(cells.columns), dict(cells.by_name)
    for group, values in added.items():
        for name, header, value in zip(group.names, group.headers, values, strict=True):
            columns[header] = np.full(len(cells), value)
            by_name[name] = FileColumn(header, group.unit, 1.0, group.range)
    message = ASSUMED_MOTION.format(" and ".join(cells.header(column) for column in measures))
    return replace(cells, columns=columns, by_name=by_name, assumed=(message,))


def _only_measure(cells: ImpactCells, columns: tuple[ColumnGroup, ...]) -> ColumnGroup | None:
    """The column that measures a flight; None: the table has no such column."""
    present = [column for column in columns if column in cells]
    if len(present) > 1:
        names = " and ".join(repr(cells.header(column)) for column in present)
        raise InputError(f"columns {names}: expected one of them", file=cells.path)
    return present[0] if present else None


def _speeds(cells: ImpactCells, column: ColumnGroup) -> tuple[Array, Array]:
    """Speeds at the plane and their standard deviations, nan if unknown, ``(rows,)`` each [m/s]."""
    rows = range(len(cells))
    values = np.array([cells.value(row, column.first) for row in rows])
    timed = column.unit == col.FLIGHT_NOISE.unit
    noise_column = col.FLIGHT_NOISE if timed else col.HEIGHT_NOISE
    noise = np.array([cells.value_or(row, noise_column, np.nan) for row in rows])
    if timed:
        return 0.5 * GRAVITY_M_S2 * values, 0.5 * GRAVITY_M_S2 * noise
    speed = np.sqrt(2.0 * GRAVITY_M_S2 * values)
    min_speed = np.sqrt(GRAVITY_M_S2 * np.nan_to_num(noise)) + 1e-9  # of a height that its noise hides
    return speed, GRAVITY_M_S2 * noise / np.maximum(speed, min_speed)
