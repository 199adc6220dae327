# SPDX-License-Identifier: Apache-2.0
"""The meta-analysis against closed forms and against what it promises in simulation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from impact_rs_analysis.sharing.meta_analysis import pool, residual, within_groups


def test_equal_errors_give_the_mean_and_students_interval() -> None:
    """With equal s the weights are equal whatever tau is: mean, and t of k - 1 times s / sqrt(k) of the values."""
    values = [1.0, 1.8, 0.9, 1.1, 1.35]
    pooled = pool(values, [0.2] * 5)
    half = scipy.stats.t.ppf(0.975, 4) * np.std(values, ddof=1) / np.sqrt(5)
    assert pooled.mean == pytest.approx(np.mean(values))
    assert (pooled.low, pooled.high) == pytest.approx((np.mean(values) - half, np.mean(values) + half))


def test_studies_that_agree_better_than_their_errors_have_the_interval_of_their_errors() -> None:
    """Half width of DerSimonian and Laird: 1.96 s / sqrt(k)."""
    half = scipy.stats.norm.ppf(0.975) * 0.5 / np.sqrt(4)
    for values in ([2.0] * 4, [1.99, 2.01, 2.0, 2.0]):
        pooled = pool(values, [0.5] * 4)
        assert (pooled.low, pooled.high) == pytest.approx((2.0 - half, 2.0 + half))


def test_deviation_between_studies_is_that_of_the_moments() -> None:
    """With equal s: tau^2 = variance of the values - s^2, and 0 where it is less."""
    values = [0.0, 1.0, 2.0, 5.0]
    assert pool(values, [0.5] * 4).tau == pytest.approx(np.sqrt(np.var(values, ddof=1) - 0.25))
    assert pool([1.0, 1.1, 0.9], [0.5] * 3).tau == 0.0


def test_a_precise_study_counts_more() -> None:
    assert pool([1.0, 2.0], [0.1, 10.0]).mean == pytest.approx(1.0, abs=0.01)


def test_residual_of_a_study_is_from_the_mean_of_the_others() -> None:
    """Three others at 0 with s = 1: r = 6 / sqrt(1 + 1/3), and half of it where all scatter twice as much."""
    assert residual(6.0, 1.0, [0.0] * 3, [1.0] * 3) == pytest.approx(6.0 / np.sqrt(4.0 / 3.0))
    assert residual(6.0, 1.0, [0.0] * 3, [1.0] * 3, 4.0) == pytest.approx(3.0 / np.sqrt(4.0 / 3.0))


def test_residual_is_small_where_the_others_differ_as_much() -> None:
    assert abs(residual(6.0, 1.0, [0.0, 5.0, -5.0], [1.0] * 3)) < 1.5


def test_heterogeneity_within_groups_ignores_differences_between_them() -> None:
    q, freedom = within_groups([0.0, 0.0, 9.0, 9.0], [1.0] * 4, ["a", "a", "b", "b"])
    assert (q, freedom) == (pytest.approx(0.0), 2)


@pytest.mark.parametrize(("tau", "count"), [(0.0, 5), (1.0, 5), (0.0, 10), (0.5, 3)])
def test_interval_covers_the_truth_as_often_as_it_says_or_a_little_more(tau: float, count: int) -> None:
    """A scatter that is small by chance does not count: 95 % without it, 99 % for three studies that are alike."""
    rng, hits, runs = np.random.default_rng(1), 0, 2000
    for _ in range(runs):
        errors = rng.uniform(0.5, 1.5, count)
        pooled = pool(3.0 + tau * rng.standard_normal(count) + errors * rng.standard_normal(count), errors)
        hits += pooled.low <= 3.0 <= pooled.high
    assert 0.935 <= hits / runs <= (0.995 if count < 5 else 0.985)
