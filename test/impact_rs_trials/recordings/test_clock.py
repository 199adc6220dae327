# SPDX-License-Identifier: Apache-2.0
"""Time stamps: what is wrong is found, and what is nearly even is taken as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.clock import (
    check_jumps,
    check_stamps,
    even_grid,
    gaps,
    grid_from,
    seconds_of,
    tell_gaps,
)

BAG = Path("bag")


def test_stamps_of_a_wall_clock_are_on_an_even_grid_but_for_rounding() -> None:
    start = 1_763_500_000.0  # s, where floating-point numbers are 0.24 us apart
    stamps = (start + 1e-3 * np.arange(100_000)) - start
    grid = even_grid(stamps)
    assert grid.size == stamps.size  # the median step, 0.99993 ms, would give eight samples more
    np.testing.assert_allclose(grid, stamps, atol=1e-6)


def test_a_grid_goes_through_gaps_at_the_usual_distance() -> None:
    stamps = np.delete(1e-3 * np.arange(1000), range(300, 340))
    grid = even_grid(stamps)
    np.testing.assert_allclose(grid, 1e-3 * np.arange(1000), atol=1e-12)
    assert tell_gaps(gaps(stamps, 0.005), 0.0) == "0.041 s at t = 0.299 s"


def test_a_grid_is_that_of_the_piece_that_matters_carried_on() -> None:
    first, last = 1e-3 * np.arange(1000), 1.3004 + 1e-3 * np.arange(500)  # the clock has lost its beat in between
    stamps = np.concatenate((first, last))
    grid = grid_from(stamps, first)
    np.testing.assert_allclose(grid[:1000], first, atol=1e-12)
    assert grid[-1] == pytest.approx(1.799)
    np.testing.assert_allclose(grid_from(stamps, last)[-500:], last, atol=1e-9)
    assert grid_from(stamps, last)[0] == pytest.approx(0.0004)
    assert np.array_equal(grid_from(first, first), even_grid(first))


def test_nanoseconds_of_a_wall_clock_are_read_as_well_as_a_header() -> None:
    nanoseconds = 1_763_500_000 * 10**9 + np.arange(0, 50_000_000, 1_234_567)
    header = nanoseconds // 10**9 + 1e-9 * (nanoseconds % 10**9)
    assert np.array_equal(seconds_of(nanoseconds, 1e-9), header)
    assert not np.array_equal(1e-9 * nanoseconds, header)
    assert np.array_equal(seconds_of(np.array([1.5, 2.0]), 1e-3), [0.0015, 0.002])


def test_many_gaps_are_counted() -> None:
    assert tell_gaps(gaps(np.arange(8.0), 0.5), 0.0).endswith("1.000 s at t = 4.000 s and 2 more")


@pytest.mark.parametrize(
    ("stamps", "complaint"),
    [
        ([0.0, 1.0, 1.0, 1.0, 2.0], "stand still at t = 1.000 s, 2 of 5 repeat the one before: recorded twice"),
        ([0.0, 1.0, 0.5, 2.0], "run backwards by 0.5 s at t = 1.000 s: the clock was set"),
        ([0.0, np.nan, 2.0], "sample 1 has no finite time"),
    ],
)
def test_stamps_that_do_not_increase_are_refused_with_a_remedy(stamps: list[float], complaint: str) -> None:
    with pytest.raises(InputError, match="bag: /joint_states: ") as caught:
        check_stamps(BAG, "/joint_states", np.array(stamps))
    assert complaint in str(caught.value)


def test_a_clock_that_was_set_is_told_from_a_pause_by_the_log() -> None:
    time = 1e-3 * np.arange(100.0)
    jumped = np.where(time > 0.05, time + 0.7, time)
    with pytest.raises(InputError, match=r"jump by 0.701 s at t = 0.050 s, 0.001 s by the log: the clock was set"):
        check_jumps(BAG, "/mocap", jumped, time, 0.1, pauses=False)
    check_jumps(BAG, "/mocap", jumped, jumped, 0.1, pauses=False)  # the object was out of sight
    with pytest.raises(InputError, match="a jump of the clock, or a pause"):
        check_jumps(BAG, "/joint_states", jumped, None, 0.1, pauses=True)


def test_a_log_that_was_written_late_is_no_jump_of_the_stamps() -> None:
    time = 1e-3 * np.arange(100.0)
    check_jumps(BAG, "/joint_states", time, np.where(time > 0.05, time + 0.7, time), 0.1, pauses=True)
