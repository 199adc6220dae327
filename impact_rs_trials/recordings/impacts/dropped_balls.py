# SPDX-License-Identifier: Apache-2.0
"""Velocities of balls that bounce straight up and down, from the heights or durations of their flights.

Without drag and horizontal motion a ball hits with the speed of its fall from the height h of its lowest point, and one
that leaves the plane with a speed v rises to v^2 / (2 g) and is back after t = 2 v / g:

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
from impact_rs_trials.recordings.impacts.impact_cells import FoundColumn, ImpactCells
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup

ASSUMED_VALUES = {col.MASS: 1.0, col.RADIUS: 0.02}  # kg, m; a straight bounce depends on neither
ASSUMED_MOTION = (
    "velocities follow from {}, without drag, of a ball that bounces straight and does not turn: friction and spin do "
    "not show"
)


def with_velocities(cells: ImpactCells) -> ImpactCells:
    """A table of heights or durations with columns of velocities; other tables stay.

    Raises:
        InputError: Velocities as well, two measures of one flight, or a number out of range.
    """
    given = [one for one in (*col.FLIGHTS_BEFORE, *col.FLIGHTS_AFTER) if one in cells]
    if not given:
        return cells
    before, after = (_one_of(cells, columns) for columns in (col.FLIGHTS_BEFORE, col.FLIGHTS_AFTER))
    for one in (col.V_BEFORE, col.V_AFTER, col.W_BEFORE, col.V_NOISE, col.V_NOISE_AXES):
        if one in cells:
            message = f"columns {cells.header(given[0])!r} and {cells.header(one)!r}: expected one of them"
            raise InputError(message, file=cells.path)
    if before is None:
        expected = " or ".join(repr(one.header) for one in col.FLIGHTS_BEFORE)
        raise InputError(f"column {cells.header(given[0])!r} without {expected}", file=cells.path)
    down, down_noise = _speeds(cells, before)
    added: dict[ColumnGroup, Sequence[Array | float]] = {
        col.V_BEFORE: (0.0, 0.0, -down),
        col.W_BEFORE: (0.0, 0.0, 0.0),
    }
    if after is not None:
        up, up_noise = _speeds(cells, after)
        added[col.V_AFTER] = (0.0, 0.0, up)
        if np.isnan(up_noise).all() != np.isnan(down_noise).all():
            missing = next(one for one in (col.HEIGHT_NOISE, col.FLIGHT_NOISE) if one not in cells)
            raise InputError(
                f"column {missing.headers[0]!r} is missing; expected the noise of both measures, or of neither",
                file=cells.path,
            )
        if not np.isnan(up_noise + down_noise).any():
            added[col.V_NOISE_AXES] = (0.0, 0.0, np.hypot(up_noise, up / down * down_noise))
    added |= {one: (value,) for one, value in ASSUMED_VALUES.items() if one not in cells}
    columns, found = dict(cells.columns), dict(cells.found)
    for group, values in added.items():
        for name, header, value in zip(group.names, group.headers, values, strict=True):
            columns[header] = np.full(len(cells), value)
            found[name] = FoundColumn(header, group.unit, 1.0, group.range)
    message = ASSUMED_MOTION.format(" and ".join(cells.header(one) for one in given))
    return replace(cells, columns=columns, found=found, assumed=(message,))


def _one_of(cells: ImpactCells, columns: tuple[ColumnGroup, ...]) -> ColumnGroup | None:
    """The measure of a flight that a table has; None: there is none."""
    found = [one for one in columns if one in cells]
    if len(found) > 1:
        names = " and ".join(repr(cells.header(one)) for one in found)
        raise InputError(f"columns {names}: expected one of them", file=cells.path)
    return found[0] if found else None


def _speeds(cells: ImpactCells, column: ColumnGroup) -> tuple[Array, Array]:
    """Speeds at the plane and their standard deviations, NaN where they are unknown, ``(rows,)`` each [m/s]."""
    rows = range(len(cells))
    values = np.array([cells.value(row, column.first) for row in rows])
    timed = column.unit == col.FLIGHT_NOISE.unit
    noise_of = col.FLIGHT_NOISE if timed else col.HEIGHT_NOISE
    noise = np.array([cells.value_or(row, noise_of, np.nan) for row in rows])
    if timed:
        return 0.5 * GRAVITY_M_S2 * values, 0.5 * GRAVITY_M_S2 * noise
    speed = np.sqrt(2.0 * GRAVITY_M_S2 * values)
    least = np.sqrt(GRAVITY_M_S2 * np.nan_to_num(noise)) + 1e-9  # of a height that its noise hides
    return speed, GRAVITY_M_S2 * noise / np.maximum(speed, least)
