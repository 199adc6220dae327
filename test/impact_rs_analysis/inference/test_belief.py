# SPDX-License-Identifier: Apache-2.0
"""A belief against the textbook: conditional normal distributions of the stacked observations."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.inference.belief import Belief, Observation, fitted_out
from impact_rs_sim.robots.robot import Array

FIRST, SECOND = slice(3, 6), slice(6, 9)
DRIFT = 0.003


def observation(seed: int, group: str, weight: float = 1.0) -> Observation:
    """Four features that depend on five parameters and two patterns."""
    rng = np.random.default_rng(seed)
    return Observation(rng.standard_normal(4), rng.standard_normal((4, 5)), rng.standard_normal((4, 2)), group, weight)


def believed(parameters: tuple[int, ...], deviations: Array, *observations: Observation) -> Belief:
    belief = Belief.of(parameters, deviations)
    for one in observations:
        belief.add(one)
    return belief


SEVERAL = [observation(0, "a"), observation(1, "b", 0.3), observation(2, "a"), observation(3, "b")]
WIDTHS = np.array([0.5, 2.0, 1.0])


def stacked(observations: list[Observation], parameters: tuple[int, ...]) -> tuple[Array, Array]:
    """H of all observations, with two columns for each group, and their residuals; weights divide the noise."""
    groups = sorted({one.group for one in observations})
    rows = []
    for one in observations:
        patterns = np.zeros((4, 2 * len(groups)))
        patterns[:, 2 * groups.index(one.group) : 2 * groups.index(one.group) + 2] = one.patterns
        rows.append(np.sqrt(one.weight) * np.hstack((one.jacobian[:, list(parameters)], patterns)))
    return np.vstack(rows), np.concatenate([np.sqrt(one.weight) * one.residual for one in observations])


def test_mean_covariance_and_prediction_are_those_of_a_conditional_normal_distribution() -> None:
    """Kalman gain in covariance form; kills a lost prior, weights, groups that share what they should not."""
    parameters, new = (0, 3, 4), observation(9, "a")
    rows, residuals = stacked(SEVERAL, parameters)
    prior = np.diag([*np.square(WIDTHS), 1.0, 1.0, 1.0, 1.0])
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + np.eye(len(rows)))
    mean, covariance = gain @ residuals, prior - gain @ rows @ prior
    belief = believed(parameters, WIDTHS, *SEVERAL)
    np.testing.assert_allclose(belief.mean, mean, atol=1e-10)
    np.testing.assert_allclose(belief.covariance, covariance[:3, :3], atol=1e-10)
    observed = np.hstack((new.jacobian[:, list(parameters)], new.patterns, np.zeros((4, 2))))
    rest, blur = belief.predictive(new)
    np.testing.assert_allclose(rest, new.residual - observed @ mean, atol=1e-10)
    np.testing.assert_allclose(blur, np.eye(4) + observed @ covariance @ observed.T, atol=1e-10)
    np.testing.assert_allclose(belief.residual_of(new), rest, atol=1e-12)


def test_what_is_left_out_is_subtracted() -> None:
    """Hold-out: as if it had never been seen, in any order."""
    belief = believed((1, 2, 4), WIDTHS, *SEVERAL)
    whole = belief.mean
    belief.add(SEVERAL[1], -1.0)
    assert np.max(np.abs(belief.mean - whole)) > 0.01
    other = believed((1, 2, 4), WIDTHS, SEVERAL[3], SEVERAL[2], SEVERAL[0])
    np.testing.assert_allclose(belief.mean[:3], other.mean[:3], atol=1e-10)
    np.testing.assert_allclose(belief.covariance, other.covariance, atol=1e-10)


def test_a_group_that_was_not_seen_has_its_prior_and_predicting_it_changes_nothing() -> None:
    belief, new = believed((0, 1, 2), WIDTHS, *SEVERAL), observation(7, "c")
    size = len(belief.vector)
    rest, blur = belief.predictive(new)
    assert len(belief.vector) == size and "c" not in belief.groups
    belief.columns(new)
    np.testing.assert_allclose(belief.predictive(new)[1], blur, atol=1e-12)
    np.testing.assert_allclose(belief.predictive(new)[0], rest, atol=1e-12)


def test_the_information_of_parameters_is_the_inverse_of_their_covariance() -> None:
    """Schur complement; kills one that keeps what the amplitudes explain."""
    belief = believed((0, 1, 2), WIDTHS, *SEVERAL)
    information, score = belief.of_parameters()
    np.testing.assert_allclose(information, np.linalg.inv(belief.covariance), atol=1e-10)
    np.testing.assert_allclose(np.linalg.solve(information, score), belief.mean[:3], atol=1e-10)
    free = believed((0, 1, 2), np.full(3, np.inf), *SEVERAL)
    np.testing.assert_allclose(free.of_parameters()[0] + np.diag(1 / WIDTHS**2), information, atol=1e-10)
    np.testing.assert_allclose(free.of_parameters()[1], score, atol=1e-10)


def test_fitted_columns_with_a_prior_blur_as_much_as_it_allows() -> None:
    """x^T V^-1 x with V = 1 + w^2 S S^T (Woodbury)."""
    rng, width = np.random.default_rng(4), 3.0
    rows = rng.standard_normal((6, 4))
    left = fitted_out(rows.T @ rows, [2, 3], width)
    blur = np.eye(6) + width**2 * rows[:, 2:] @ rows[:, 2:].T
    np.testing.assert_allclose(left[:2, :2], rows[:, :2].T @ np.linalg.solve(blur, rows[:, :2]), atol=1e-10)


def test_fresh_parameters_are_forgotten_and_all_else_is_kept() -> None:
    """Two parameters become three, one of them anew; kills a wrong order of columns, and what is not forgotten."""
    belief = believed((0, 3), WIDTHS[:2], *SEVERAL)
    whole = np.linalg.inv(belief.information)
    other = belief.with_parameters((3, 1, 0), (1, 3), np.array([2.0, -1.0]), 10.0)
    covariance, mean = np.linalg.inv(other.information), other.mean
    assert other.parameters == (3, 1, 0) and other.groups == {"a": slice(3, 5), "b": slice(5, 7)}
    stay, place = [0, 2, 3, 4, 5], [2, 3, 4, 5, 6]
    np.testing.assert_allclose(covariance[np.ix_(place, place)], whole[np.ix_(stay, stay)], atol=1e-10)
    np.testing.assert_allclose(mean[place], belief.mean[stay], atol=1e-10)
    np.testing.assert_allclose(mean[:2], [-1.0, 2.0], atol=1e-10)
    np.testing.assert_allclose(covariance[:2, :2], 100.0 * np.eye(2), atol=1e-8)
    np.testing.assert_allclose(covariance[:2, 2:], 0.0, atol=1e-10)


# ---- Amplitudes of the model discrepancy that wander, held against the covariance form of a Gauss-Markov process


def of(covariance: Array, mean: Array) -> Belief:
    """Three parameters and two groups of three amplitudes."""
    information = np.linalg.inv(covariance)
    return Belief((0, 1, 2), information, information @ mean, {"first": FIRST, "second": SECOND})


def state_of(belief: Belief) -> tuple[Array, Array]:
    covariance = np.linalg.inv(belief.information)
    return covariance, covariance @ belief.vector


def test_amplitudes_of_one_group_wander_and_all_else_stays() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((9, 9))
    covariance, mean = root @ root.T + np.eye(9), rng.standard_normal(9)
    belief = of(covariance, mean)
    belief.drift("first", DRIFT)
    shrink, fresh = np.eye(9), np.zeros((9, 9))
    shrink[FIRST, FIRST] *= np.sqrt(1.0 - DRIFT)
    fresh[FIRST, FIRST] = DRIFT * np.eye(3)
    moved, centre = state_of(belief)
    np.testing.assert_allclose(moved, shrink @ covariance @ shrink.T + fresh, atol=1e-9)
    np.testing.assert_allclose(centre, shrink @ mean, atol=1e-9)


def test_what_nothing_is_known_of_keeps_its_prior() -> None:
    belief = of(np.eye(9), np.zeros(9))
    for _ in range(1000):
        belief.drift("second", DRIFT)
    np.testing.assert_allclose(state_of(belief)[0], np.eye(9), atol=1e-6)


@pytest.mark.parametrize("hits", [1, 100, 1000])
def test_what_was_known_fades_with_the_hits_since(hits: int) -> None:
    belief = of(1e-4 * np.eye(9), np.ones(9))
    for _ in range(hits):
        belief.drift("first", DRIFT)
    covariance, mean = state_of(belief)
    kept = (1.0 - DRIFT) ** hits
    assert covariance[3, 3] == pytest.approx(1.0 - kept * (1.0 - 1e-4))
    assert mean[3] == pytest.approx(np.sqrt(kept))
    assert covariance[0, 0] == pytest.approx(1e-4) and mean[0] == pytest.approx(1.0)
