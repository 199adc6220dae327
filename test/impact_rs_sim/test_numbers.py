# SPDX-License-Identifier: Apache-2.0
"""Numbers: how estimates are written, seeds, rotations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_sim.numbers import estimate_in_line, estimate_text, rounded_interval, speed_text
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.seeds import seed_of

# ---- estimates with intervals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ((1.08973, (1.08925, 1.09021)), "1.08973 [1.08925, 1.09021]"),
        ((0.35487, (0.3524, 0.3573)), "0.3549 [0.3524, 0.3573]"),
        ((1203.4, (1100.0, 1310.0)), "1203 [1100, 1310]"),
        ((0.912, (-0.1, 1.9)), "0.9 [-0.1, 1.9]"),
        ((2.5e-7, (2e-7, 3e-7)), "2.5e-07 [2e-07, 3e-07]"),
        ((0.123456, None), "0.123"),
        ((1.0902, (1.0901, 1.0903)), "1.09020 [1.09010, 1.09030]"),
        ((1234567.0, (1234467.0, 1234667.0)), "1.23457e+06 [1.23447e+06, 1.23467e+06]"),
        ((4e-20, (3.99e-20, 4.01e-20)), "4e-20 [3.99e-20, 4.01e-20]"),
        ((0.0, (0.0, 0.0)), "0 [0, 0]"),
        ((1.223477010931884, (1.2234770109318838, 1.2234770109318842)), "1.22 [1.22, 1.22]"),
    ],
)
def test_an_estimate_is_told_with_two_digits_of_its_half_width(value, told):
    assert estimate_in_line(*value) == told


@given(st.floats(-1e5, 1e5), st.floats(1e-6, 1e3))
def test_an_interval_that_is_told_is_as_wide_as_it_is(value, half):
    _, low, high = estimate_text(value, (value - half, value + half))
    if max(abs(value - half), abs(value + half)) >= 1e-4:
        assert math.isclose(float(high) - float(low), 2.0 * half, rel_tol=0.11)


@given(st.floats(-1e9, 1e9), st.floats(1e-6, 1e3))
def test_the_ends_of_an_interval_are_never_rounded_into_one(value, half):
    _, low, high = estimate_text(value, (value - half, value + half))
    assert float(low) < float(high)


@pytest.mark.parametrize(
    ("speed", "half", "told"),
    [(0.5521, 0.0021, ["0.552", "0.002"]), (0.55213, 0.00042, ["0.5521", "0.0004"]), (0.5521, None, ["0.552"]),
     (0.5521, 0.0, ["0.552", "0.000"]), (0.5521, 0.11, ["0.552", "0.110"])],
)  # fmt: skip
def test_half_an_interval_of_a_speed_is_never_rounded_to_nothing(speed, half, told):
    assert list(speed_text(speed, half)) == told


def test_decimals_are_written_where_there_is_no_exponent():
    assert estimate_text(0.5, (0.4, 0.6), least=4) == ("0.5000", "0.4000", "0.6000")
    assert estimate_text(0.5, (0.49999, 0.50001), least=4) == ("0.500000", "0.499990", "0.500010")
    assert estimate_text(0.0, (0.0, 0.0), least=4) == ("0.0000",) * 3


# ---- seeds ----------------------------------------------------------------------------------------------------------


def test_a_seed_is_the_same_whenever_and_wherever_it_is_asked_for() -> None:
    """Recorded campaigns are run again from these: they must never change."""
    assert seed_of(0, "cat_food__case_2__s1.000__r0") == 11574260439316600728
    assert seed_of(1, "cat_food__case_2__s1.000__r0") != seed_of(0, "cat_food__case_2__s1.000__r0")


def test_no_two_of_many_tasks_share_a_seed() -> None:
    names = [f"{thing}__case_{case}__r{repeat}" for thing in "abc" for case in range(30) for repeat in range(50)]
    assert len({seed_of(seed, name) for seed in range(3) for name in names}) == 3 * len(names)


# ---- rotations ------------------------------------------------------------------------------------------------------

PAGE = 4096  # bytes


@given(st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3))
def test_a_quaternion_is_the_rotation_it_was_made_from(turn: list[float]) -> None:
    rotation = pin.exp3(np.array(turn))
    quaternion = quaternion_of(rotation)
    assert quaternion @ quaternion == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(pin.Quaternion(quaternion).matrix(), rotation, atol=1e-12)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux")
def test_making_quaternions_keeps_no_memory() -> None:
    """A trial makes a thousand of them; what each kept would add up over a campaign."""
    rotation = pin.exp3(np.array([0.1, 0.2, 0.3]))

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE

    for _ in range(1000):
        quaternion_of(rotation)
    before, calls = resident(), 50_000
    for _ in range(calls):
        quaternion_of(rotation)
    assert resident() - before < 10 * calls  # bytes


@pytest.mark.parametrize(
    ("ends", "written"),
    [
        ((0.018012345678901234, 0.022098765432101234), (0.01801, 0.0221)),
        ((-0.10000000000000001, 1000.0049), (-1.0, 1001.0)),
        ((12.00000001, 12.00000002), (12.00000001, 12.00000002)),
        ((1.5, 1.5), (1.5, 1.5)),
        ((-math.inf, 2.0), (-math.inf, 2.0)),
        (None, None),
    ],
)
def test_an_interval_of_a_file_has_three_digits_of_its_half_width(
    ends: tuple[float, float] | None, written: tuple[float, float] | None
) -> None:
    """Kills an interval that rounding makes narrower, and 16 digits."""
    assert rounded_interval(ends) == written
