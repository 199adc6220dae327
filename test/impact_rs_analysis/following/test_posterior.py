# SPDX-License-Identifier: Apache-2.0
"""Amplitudes of the model discrepancy that wander, held against the covariance form of a Gauss-Markov process."""

from __future__ import annotations

import json

import numpy as np
import pytest

from impact_rs_analysis.following.posterior import DRIFT, Posterior
from impact_rs_analysis.following.recent_residuals import RecentResiduals
from impact_rs_sim.robot import Array

FIRST, SECOND = slice(3, 6), slice(6, 9)


def of(covariance: np.ndarray, mean: np.ndarray) -> Posterior:
    """Three parameters and two groups of three amplitudes."""
    information = np.linalg.inv(covariance)
    return Posterior((0, 1, 2), information, information @ mean, {"first": FIRST, "second": SECOND})


def state_of(posterior: Posterior) -> tuple[np.ndarray, np.ndarray]:
    covariance = np.linalg.inv(posterior.information)
    return covariance, covariance @ posterior.vector


def test_amplitudes_of_one_group_wander_and_all_else_stays() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((9, 9))
    covariance, mean = root @ root.T + np.eye(9), rng.standard_normal(9)
    posterior = of(covariance, mean)
    posterior.drift("first")
    shrink, fresh = np.eye(9), np.zeros((9, 9))
    shrink[FIRST, FIRST] *= np.sqrt(1.0 - DRIFT)
    fresh[FIRST, FIRST] = DRIFT * np.eye(3)
    moved, centre = state_of(posterior)
    np.testing.assert_allclose(moved, shrink @ covariance @ shrink.T + fresh, atol=1e-9)
    np.testing.assert_allclose(centre, shrink @ mean, atol=1e-9)


def test_what_nothing_is_known_of_keeps_its_prior() -> None:
    posterior = of(np.eye(9), np.zeros(9))
    for _ in range(1000):
        posterior.drift("second")
    np.testing.assert_allclose(state_of(posterior)[0], np.eye(9), atol=1e-6)


@pytest.mark.parametrize("hits", [1, 100, 1000])
def test_what_was_known_fades_with_the_hits_since(hits: int) -> None:
    posterior = of(1e-4 * np.eye(9), np.ones(9))
    for _ in range(hits):
        posterior.drift("first")
    covariance, mean = state_of(posterior)
    kept = (1.0 - DRIFT) ** hits
    assert covariance[3, 3] == pytest.approx(1.0 - kept * (1.0 - 1e-4))
    assert mean[3] == pytest.approx(np.sqrt(kept))
    assert covariance[0, 0] == pytest.approx(1e-4) and mean[0] == pytest.approx(1.0)


# ---- What recent hits leave predicts the next one where it lasts, and nothing is made of noise


def errors(residuals: Array, weights: Array | None = None) -> tuple[float, float]:
    """Root mean square of residuals, corrected and as they are, from the tenth on."""
    recent, left = RecentResiduals(), []
    for residual, weight in zip(residuals, np.ones(len(residuals)) if weights is None else weights, strict=True):
        left.append(residual - recent.expected("a", residual.size))
        recent.take("a", residual, weight)
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
        recent.take("a", np.array([2.0]), 1.0)
    assert recent.expected("a", 1) == pytest.approx([2.0], abs=0.1)
    assert recent.expected("b", 1) == [0.0]
    recent.take("a", np.array([50.0]), 0.01)
    assert recent.expected("a", 1) == pytest.approx([2.0], abs=0.3)


def test_what_is_saved_goes_on_as_before() -> None:
    rng, one = np.random.default_rng(1), RecentResiduals()
    for residual in 1.0 + rng.standard_normal((30, 2)):
        one.take("a", residual, 1.0)
    other = RecentResiduals.restored(json.loads(json.dumps(one.saved())))
    for residual in 1.0 + rng.standard_normal((10, 2)):
        np.testing.assert_array_equal(one.expected("a", 2), other.expected("a", 2))
        one.take("a", residual, 1.0)
        other.take("a", residual, 1.0)
