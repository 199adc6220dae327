# SPDX-License-Identifier: Apache-2.0
"""Noise of repeats: what whitens their mean, and covariances from few of them."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.inference.noise import Noise, deviations_of, repeats_of


@pytest.mark.parametrize("count", [1, 4])
def test_a_mean_of_repeats_is_white_once_it_is_whitened(count: int) -> None:
    """W (R / n + o) W^T = 1; kills limits that repeats average, and scatter that they do not."""
    rng = np.random.default_rng(0)
    root, own = rng.standard_normal((3, 3)), np.array([0.5, 0.1, 2.0])
    full, alone = Noise(root @ root.T, own), Noise(np.array([1.0, 4.0, 9.0]), own)
    for noise, repeats in ((full, full.repeats), (alone, np.diag(alone.repeats))):
        whiten = noise.whitening(count)
        np.testing.assert_allclose(whiten @ (repeats / count + np.diag(own)) @ whiten.T, np.eye(3), atol=1e-12)


def test_a_feature_that_never_moves_is_no_certainty() -> None:
    """It gets a billionth of the largest variance; kills a division by nothing."""
    for noise in (Noise(np.array([4.0, 0.0]), np.zeros(2)), Noise(np.diag([4.0, 0.0]), np.zeros(2))):
        np.testing.assert_allclose(noise.whitening(), np.diag([0.5, 1.0 / np.sqrt(4e-9)]))


def test_correlations_of_few_repeats_are_shrunk_and_those_of_many_kept() -> None:
    """Of eight independent features five repeats claim large correlations; five thousand find one that is planted."""
    rng = np.random.default_rng(1)
    few = repeats_of(rng.standard_normal((5, 8)), 5, np.zeros(8))
    spread = np.sqrt(np.diag(few))
    assert np.max(np.abs(few / np.outer(spread, spread) - np.eye(8))) < 0.35
    planted = np.array([[1.0, 0.8], [0.8, 4.0]])
    many = repeats_of(rng.multivariate_normal(np.zeros(2), planted, 5000), 5000, np.zeros(2))
    np.testing.assert_allclose(many, planted, rtol=0.1)


def test_scatter_is_no_less_than_what_a_measurement_states() -> None:
    assert np.diag(repeats_of(np.array([[1.0, 1.0], [-1.0, -1.0]]), 1, np.array([0.0, 9.0]))) == pytest.approx([2, 81])


def test_hits_that_repeat_nothing_teach_the_scatter_only_where_repeats_are_too_few() -> None:
    """Kills one repeated condition that silences all others, and differences of conditions beside enough repeats."""
    rows = [np.array([value]) for value in (1.0, 3.0, 10.0, 20.0, 30.0)]
    conditions = ["a", "a", "", "b", ""]
    deviations, freedom = deviations_of(rows, conditions)
    assert deviations.ravel() == pytest.approx([-1.0, 1.0]) and freedom == 1
    deviations, freedom = deviations_of(rows, conditions, least=2)
    assert deviations.ravel() == pytest.approx([-1.0, 1.0, -10.0, 0.0, 10.0]) and freedom == 3
    deviations, freedom = deviations_of(rows[:4], ["a", "", "b", "c"])
    assert deviations.ravel() == pytest.approx(np.array([1.0, 3.0, 10.0, 20.0]) - 8.5) and freedom == 3
