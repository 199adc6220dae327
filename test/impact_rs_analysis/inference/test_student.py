# SPDX-License-Identifier: Apache-2.0
"""Log likelihood ratios with an estimated scale, against SciPy's Student distribution and simulated measurements."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from impact_rs_analysis.inference.belief import Belief, Observation
from impact_rs_analysis.inference.student import log_density, log_ratio, log_ratios, squares


def test_the_density_is_that_of_students_distribution() -> None:
    """Up to what does not depend on the numbers."""
    root = np.random.default_rng(0).standard_normal((3, 3))
    shape, freedom = root @ root.T, 5.0
    said = scipy.stats.multivariate_t(np.zeros(3), shape, df=freedom)
    points = np.random.default_rng(1).standard_normal((2, 3))
    squares_of, volume = [float(x @ np.linalg.solve(shape, x)) for x in points], float(np.linalg.slogdet(shape)[1])
    found = [log_density(square, volume, 3, freedom) for square in squares_of]
    assert found[1] - found[0] == pytest.approx(said.logpdf(points[1]) - said.logpdf(points[0]))


@pytest.mark.parametrize("freedom", [3.0, 20.0])
def test_the_ratio_is_that_of_the_densities_of_the_score_with_and_without_a_change(freedom: float) -> None:
    """eta ~ N(0, W^2): the estimate I^-1 S has the covariance I^-1 without, and I^-1 + W^2 with it."""
    root = np.random.default_rng(2).standard_normal((2, 2))
    information, score, width = root @ root.T, np.array([1.5, -2.0]), 3.0
    inverse = np.linalg.inv(information)
    without, with_ = (
        scipy.stats.multivariate_t(np.zeros(2), shape, df=freedom).logpdf(inverse @ score)
        for shape in (inverse, inverse + width**2 * np.eye(2))
    )
    (found,) = log_ratios(information[None], score[None], width, freedom)
    assert found == pytest.approx(with_ - without)


@pytest.mark.parametrize("freedom", [3, 10])
def test_the_mean_ratio_is_one_where_nothing_has_changed(freedom: int) -> None:
    """In units of an estimated noise the score is Student's t; kills an exponent or a determinant that is off."""
    rng, count = np.random.default_rng(3), 200_000
    score = rng.standard_normal(count) / np.sqrt(rng.chisquare(freedom, count) / freedom)
    ratios = np.exp(log_ratios(np.ones((count, 1, 1)), score[:, None], 0.5, freedom))
    assert ratios.mean() == pytest.approx(1.0, abs=0.005)


def test_a_parameter_without_information_changes_nothing() -> None:
    """Its determinant is one, and it is no degree of freedom."""
    alone = log_ratios(np.array([[[4.0]]]), np.array([[3.0]]), 3.0, 6.0)
    both = log_ratios(np.diag([4.0, 0.0])[None], np.array([[3.0, 0.0]]), 3.0, 6.0)
    assert both == pytest.approx(alone)
    assert [float(one[0]) for one in squares(np.diag([4.0, 0.0])[None], np.array([[3.0, 0.0]]))] == pytest.approx(
        [2.25, 2.25 / 5.0, np.log(5.0), 1]
    )


def test_what_is_explained_in_full_is_a_ratio_without_a_rest() -> None:
    """T_1 = 0; what is worse than nothing explains nothing."""
    assert log_ratio(6.0, 1.0, 2, 4.0) == pytest.approx(3.0 * np.log(1.0 + 6.0 / 4.0) - 0.5)
    assert log_ratio(-1.0, 1.0, 2, 4.0) == pytest.approx(-0.5)


def test_the_ratio_of_a_belief_is_that_of_the_evidence_of_all_observations() -> None:
    """log N(r; 0, V + W^2 J J^T) - log N(r; 0, V), V = 1 + P P^T, of a known noise; the amplitudes are fitted."""
    rng, width = np.random.default_rng(5), 2.0
    observations = [
        Observation(rng.standard_normal(3), rng.standard_normal((3, 2)), rng.standard_normal((3, 1)), group)
        for group in "aab"
    ]
    belief = Belief.of((0, 1), np.full(2, np.inf))
    for one in observations:
        belief.add(one)
    information, score = belief.of_parameters()
    (found,) = log_ratios(information[None], score[None], width, 1e7)
    patterns = np.zeros((9, 2))
    for number, one in enumerate(observations):
        patterns[3 * number : 3 * number + 3, ["a", "b"].index(one.group)] = one.patterns[:, 0]
    without = np.eye(9) + patterns @ patterns.T
    jacobian = np.vstack([one.jacobian for one in observations])
    residual = np.concatenate([one.residual for one in observations])
    with_ = without + width**2 * jacobian @ jacobian.T
    expected = [scipy.stats.multivariate_normal(np.zeros(9), shape).logpdf(residual) for shape in (with_, without)]
    assert found == pytest.approx(expected[0] - expected[1], rel=1e-4)
