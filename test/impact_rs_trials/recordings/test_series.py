# SPDX-License-Identifier: Apache-2.0
"""Rows of tables as people have them: blank cells, joints with rows of their own, values that are held, torn lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refusal

from impact_rs_trials.recordings.mapping import TableLayout
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.table_columns import read_columns

TIME = 0.01 * np.arange(500)  # s
VALUES = np.sin(2.0 * TIME[:, None] + np.arange(3))
CURVATURE = 4.0  # of the values, 1/s^2


def series(time: np.ndarray = TIME, values: np.ndarray = VALUES) -> Series:
    return Series("column 'q_1' (position)", time, values)


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.3))
def test_blank_cells_are_interpolated_in_their_column(seed: int, share: float) -> None:
    """Linear interpolation is off by h^2 / 8 times the curvature. Kills a fill from another column or row."""
    blank = np.random.default_rng(seed).random(VALUES.shape) < share
    found = series(values=np.where(blank, np.nan, VALUES)).sampled().filled()
    rows = np.searchsorted(TIME, found.time)
    np.testing.assert_array_equal(TIME[rows], found.time)
    limit = CURVATURE * (5 * 0.01) ** 2 / 8.0
    np.testing.assert_allclose(found.values, VALUES[rows], atol=limit)
    measured = ~blank[rows]
    np.testing.assert_array_equal(found.values[measured], VALUES[rows][measured])
    assert f"{100.0 * blank[~blank.all(axis=1)].mean():.3g} % of the cells are blank" in found.remarks[0]


def test_joints_with_rows_of_their_own_are_put_on_those_of_the_first() -> None:
    """As in an export of one topic a joint. Kills rows in which no joint was measured, and joints of other moments."""
    time = np.add.outer(TIME, (0.0, 0.003, 0.006)).ravel()
    own = np.tile(np.eye(3, dtype=bool), (TIME.size, 1))
    found = series(time, np.where(own, np.sin(2.0 * time[:, None] + np.arange(3)), np.nan)).sampled().filled()
    np.testing.assert_allclose(found.time, TIME[1:], atol=1e-12)  # the first has no second joint before it
    np.testing.assert_allclose(found.values, VALUES[1:], atol=CURVATURE * 0.01**2 / 8.0)


def test_a_joint_that_is_away_for_long_leaves_a_gap() -> None:
    """Kills a straight line over half a second."""
    away = (TIME > 2.0) & (TIME < 2.5)
    values = VALUES.copy()
    values[away, 1] = np.nan
    found = series(values=values).sampled().filled()
    assert np.max(np.diff(found.time)) == pytest.approx(0.5) and found.time.size == TIME.size - away.sum()


@pytest.mark.parametrize("repeats", [2, 5])
def test_values_that_are_held_are_taken_once(repeats: int) -> None:
    """A signal of 100 Hz in a table of 500 Hz; at rest it is sampled on. Kills a gap where the arm stands still."""
    values = VALUES.copy()
    values[200:320] = values[200]  # rest
    time = np.add.outer(TIME, 0.01 / repeats * np.arange(repeats)).ravel()
    found = series(time, np.repeat(values, repeats, axis=0)).without_held()
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(found.values, values)
    share = f"{100.0 * (1.0 - 1.0 / repeats):.3g} % of the rows repeat the values of the row before"
    assert f"{share}, held for {repeats} rows: sampled at 100 Hz" in found.remarks[0]


@pytest.mark.parametrize("step", [0.0, 1e-3, 2e-2])
def test_an_encoder_with_coarse_steps_is_not_held(step: float) -> None:
    """Values stay as long as the joint is slow, for very different numbers of rows. Kills a median alone."""
    values = VALUES[:, :1] if step == 0.0 else step * np.round(VALUES[:, :1] / step)
    own = series(values=values)
    assert own.without_held() is own


def test_torn_lines_are_left_out_and_counted_but_not_a_tenth_of_a_table(tmp_path: Path) -> None:
    """Kills a line that ends early and whose cells are read as those of the next."""
    lines = ["t,a,b", *(f"{row},{2 * row},{3 * row}" for row in range(200))]
    torn = [line[:2] if number in (50, 120) else line for number, line in enumerate(lines)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(torn) + "\n")
    found = read_columns(path, TableLayout())
    assert len(found.cells["a"]) == 198 and found.cells["b"][49] == str(3 * 50) and found.lines[49] == 52
    assert "2 of 200 lines are torn (1 %), the first in line 51" in found.remarks[0]
    path.write_text("\n".join([lines[0], *(line + ",0" for line in lines[1:])]))
    assert "line 2: 4 numbers, expected 3 as in line 1" in refusal(read_columns, path, TableLayout())
