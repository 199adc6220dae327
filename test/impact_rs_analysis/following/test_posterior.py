# SPDX-License-Identifier: Apache-2.0
"""Amplitudes of the model discrepancy that wander, held against the covariance form of a Gauss-Markov process."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.following.posterior import DRIFT, Posterior

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
