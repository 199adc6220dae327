# SPDX-License-Identifier: Apache-2.0
"""Weights of the samples for means of slopes, without the matrix of the filter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_analysis.evidence.replays.features import _before_slope, _slope


@given(st.integers(3, 90), st.sampled_from([5e-4, 1e-3, 2e-3, 1.0 / 240.0]), st.integers(0, 99))
def test_weighted_slopes_are_weighted_samples(count: int, period: float, seed: int) -> None:
    """Adjoint identity w (S x) = (w S) x. Kills: kernel not reversed, an end shifted by a sample, ends left out."""
    rng = np.random.default_rng(seed)
    time = period * np.arange(count)
    weights, signal = rng.standard_normal((2, count)), rng.standard_normal((count, 3))
    slopes = _slope(time, signal[None])[0]
    found = _before_slope(time, weights) @ signal
    np.testing.assert_allclose(found, weights @ slopes, rtol=0.0, atol=1e-12 * count / period)


def test_slope_of_a_parabola_is_exact_up_to_the_ends() -> None:
    time = 1e-3 * np.arange(200)
    weights = np.eye(200)
    found = _before_slope(time, weights) @ (2.0 * time + 30.0 * time**2)
    assert found == pytest.approx(2.0 + 60.0 * time, rel=1e-9)
