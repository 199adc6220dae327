# SPDX-License-Identifier: Apache-2.0
"""How numbers of a diagnosis are told."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_analysis.diagnosis.words import estimate_in_line, estimate_text


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ((1.08973, (1.08925, 1.09021)), "1.08973 [1.08925, 1.09021]"),
        ((0.35487, (0.3524, 0.3573)), "0.3549 [0.3524, 0.3573]"),
        ((1203.4, (1100.0, 1310.0)), "1203 [1100, 1310]"),
        ((0.912, (-0.1, 1.9)), "0.9 [-0.1, 1.9]"),
        ((2.5e-7, (2e-7, 3e-7)), "2.5e-07 [2e-07, 3e-07]"),
        ((0.123456, None), "0.123"),
    ],
)
def test_an_estimate_is_told_with_two_digits_of_its_half_width(value, told):
    assert estimate_in_line(*value) == told


@given(st.floats(-1e5, 1e5), st.floats(1e-6, 1e3))
def test_an_interval_that_is_told_is_as_wide_as_it_is(value, half):
    _, low, high = estimate_text(value, (value - half, value + half))
    if max(abs(value - half), abs(value + half)) >= 1e-4:
        assert math.isclose(float(high) - float(low), 2.0 * half, rel_tol=0.11)
