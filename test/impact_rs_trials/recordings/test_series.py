# SPDX-License-Identifier: Apache-2.0
"""A derivative by differences is that of the motion, whatever the sampling; an encoder's steps are smoothed."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_trials.recordings.series import BASELINE, Series


@pytest.mark.parametrize("rate", [50.0, 1000.0, 5000.0])
def test_the_derivative_of_a_sine_is_its_cosine(rate: float) -> None:
    """Up to sinc(2 f h) of central differences over 2 h, and one-sided at the ends."""
    time = np.arange(0.0, 2.0, 1.0 / rate)
    series = Series("column q", time, np.sin(2.0 * np.pi * time)[:, None])
    half = max(1.0 / rate, BASELINE / 2.0)
    inner = slice(int(half * rate) + 1, -int(half * rate) - 1)
    exact = 2.0 * np.pi * np.cos(2.0 * np.pi * time) * np.sinc(2.0 * half)
    np.testing.assert_allclose(series.derivative().values[inner, 0], exact[inner], atol=1e-9)
    assert np.abs(series.derivative().values[:, 0] - exact).max() < 2.0 * np.pi * 2.0 * np.pi * half


def test_uneven_stamps_and_a_straight_line_give_its_slope() -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.5e-3, 2e-3, 400))
    np.testing.assert_allclose(Series("q", time, 0.7 * time[:, None] - 2.0).derivative().values, 0.7, rtol=1e-9)


def test_the_steps_of_an_encoder_are_divided_by_the_baseline_and_not_by_the_period() -> None:
    time = np.arange(0.0, 1.0, 1e-4)
    steps = np.round(0.3 * time / 1e-4) * 1e-4  # 0.1 mrad at 10 kHz: 1 rad/s from sample to sample
    speed = Series("q", time, steps[:, None]).derivative().values
    assert np.abs(speed - 0.3)[10:-10].max() < 1.01 * 1e-4 / BASELINE
    assert np.abs(speed - 0.3).max() < 2.02 * 1e-4 / BASELINE  # one-sided at the ends
