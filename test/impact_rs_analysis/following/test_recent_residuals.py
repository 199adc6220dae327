# SPDX-License-Identifier: Apache-2.0
"""What recent hits leave predicts the next one where it lasts, and nothing is made of noise."""

from __future__ import annotations

import json

import numpy as np
import pytest

from impact_rs_analysis.following.recent_residuals import RecentResiduals
from impact_rs_sim.robots.robot import Array


def errors(residuals: Array, weights: Array | None = None) -> tuple[float, float]:
    """Root mean square of residuals, corrected and as they are, from the tenth on."""
    recent, left = RecentResiduals(), []
    for residual, weight in zip(residuals, np.ones(len(residuals)) if weights is None else weights, strict=True):
        left.append(residual - recent.expected("a", residual.size))
        recent.update("a", residual, weight)
    return tuple(float(np.sqrt(np.mean(np.square(one[10:])))) for one in (np.array(left), residuals))  # type: ignore[return-value]


@pytest.mark.parametrize("seed", range(5))
def test_without_drift_hardly_anything_is_corrected(seed: int) -> None:
    corrected, plain = errors(np.random.default_rng(seed).standard_normal((300, 3)))
    assert corrected == pytest.approx(plain, rel=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_a_misfit_that_stays_leaves_little_more_than_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corrected, plain = errors(np.array([2.0, -1.0, 0.5]) + rng.standard_normal((100, 3)))
    assert plain > 1.5 and corrected < 1.12


@pytest.mark.parametrize("seed", range(5))
def test_a_random_walk_is_followed_nearly_as_well_as_with_the_best_gain(seed: int) -> None:
    """Muth 1960: steps of q beside noise of 1 are predicted best with g = q (sqrt(1 + q² / 4) - q / 2)."""
    rng, q = np.random.default_rng(seed), 0.3
    residuals = np.cumsum(q * rng.standard_normal((400, 2)), axis=0) + rng.standard_normal((400, 2))
    gain, mean, left = q * (np.sqrt(1.0 + q**2 / 4.0) - q / 2.0), np.zeros(2), []
    for residual in residuals:
        left.append(residual - mean)
        mean = mean + gain * (residual - mean)
    best = float(np.sqrt(np.mean(np.square(left[10:]))))
    corrected, plain = errors(residuals)
    assert corrected < 1.05 * best < plain


def test_groups_are_apart_and_an_odd_hit_moves_nothing_far() -> None:
    recent = RecentResiduals()
    for _ in range(20):
        recent.update("a", np.array([2.0]), 1.0)
    assert recent.expected("a", 1) == pytest.approx([2.0], abs=0.1)
    assert recent.expected("b", 1) == [0.0]
    recent.update("a", np.array([50.0]), 0.01)
    assert recent.expected("a", 1) == pytest.approx([2.0], abs=0.3)


def test_what_is_saved_goes_on_as_before() -> None:
    rng, one = np.random.default_rng(1), RecentResiduals()
    for residual in 1.0 + rng.standard_normal((30, 2)):
        one.update("a", residual, 1.0)
    other = RecentResiduals.restored(json.loads(json.dumps(one.saved())))
    for residual in 1.0 + rng.standard_normal((10, 2)):
        np.testing.assert_array_equal(one.expected("a", 2), other.expected("a", 2))
        one.update("a", residual, 1.0)
        other.update("a", residual, 1.0)
