# SPDX-License-Identifier: Apache-2.0
"""Clocks that differ by a constant: a planted offset is found from the motion, or refused where motion has none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal

from impact_rs_trials.recordings.clock_offset import offset_between, start_of_motion
from impact_rs_trials.recordings.series import Series

DAY = 86400.0  # s
FILE = Path("run.csv")


def swing(time: np.ndarray) -> np.ndarray:
    """Two joints that speed up as they swing, so that no part of the motion is like another."""
    return np.column_stack((np.sin(2.0 * time + 0.15 * time**2), np.cos(1.3 * time + 0.2 * time**2)))


def streams(offset: float, noise: float = 0.0, seed: int = 1) -> tuple[Series, Series]:
    """Positions at 200 Hz, and what another clock says of them at 90 Hz, from 1.5 s later on."""
    rng = np.random.default_rng(seed)
    one, other = np.arange(0.0, 8.0, 0.005), np.arange(1.5, 7.0, 1.0 / 90.0)
    measured = -3.0 * swing(other) + 0.4 + noise * rng.standard_normal((other.size, 2))
    return Series("q", one, swing(one)), Series("dq", other + offset, measured)


@pytest.mark.parametrize("offset", [0.0, 0.0123, -2.7, DAY])
def test_a_planted_offset_is_found_whatever_factor_and_zero(offset: float) -> None:
    found, _ = offset_between(*streams(offset), FILE, "signals.velocity.clock")
    assert found == pytest.approx(-offset, abs=2e-4)


def test_the_standard_error_is_that_of_repeated_recordings() -> None:
    found = np.array([offset_between(*streams(0.3, 0.3, seed), FILE, "k") for seed in range(40)])
    scatter, said = float(np.std(found[:, 0])), float(np.mean(found[:, 1]))
    assert 0.5 < scatter / said < 2.0


def test_a_motion_that_repeats_itself_determines_no_offset() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    series = Series("q", time, np.sin(2.0 * np.pi * time)[:, None])
    said = refusal(offset_between, series, replace(series, time=time + 0.2), FILE, "signals.velocity.clock")
    assert "signals.velocity.clock = 'own'" in said
    assert "does not determine" in said


def test_rest_determines_no_offset() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 4.0, 0.005)
    one, other = (Series("q", time, 1e-3 * rng.standard_normal((time.size, 2))) for _ in range(2))
    assert "does not determine" in refusal(offset_between, one, other, FILE, "k")


@pytest.mark.parametrize(("rate", "noise"), [(120.0, 1e-4), (240.0, 3e-4)])
def test_an_object_starts_when_it_is_hit(rate: float, noise: float) -> None:
    """Pushed to 0.8 m/s at t = 1.2345 s, it slides with friction 0.3."""
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time = rng.uniform(0.0, 1.0 / rate) + np.arange(0.0, 1.4, 1.0 / rate)
        after = np.maximum(time - 1.2345, 0.0)
        way = 0.8 * after - 0.5 * 0.3 * 9.81 * after**2
        place = np.outer(way, [0.6, 0.8, 0.0]) + noise * rng.standard_normal((time.size, 3))
        found, error = start_of_motion(Series("pose", time, place), FILE, "k")
        errors.append((found - 1.2345) / error)
        assert found == pytest.approx(1.2345, abs=0.5 / rate)
    assert np.sqrt(np.mean(np.square(errors))) < 2.5


def test_an_object_that_never_rests_determines_no_offset() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    said = refusal(start_of_motion, Series("pose", time, np.outer(time, [1.0, 0.0, 0.0])), FILE, "k")
    assert "does not rest at first" in said
