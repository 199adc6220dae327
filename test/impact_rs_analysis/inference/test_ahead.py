# SPDX-License-Identifier: Apache-2.0
"""The probability that two explanations will be distinguished, against two that are planted."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.inference.ahead import probability, promised
from impact_rs_analysis.inference.student import DECISIVE_LIKELIHOOD_RATIO, log_density

DRAWS = 20_000


@pytest.mark.parametrize("freedom", [1, 3, 6, 30])
@pytest.mark.parametrize("distance", [1.0, 3.0, 5.0])
def test_two_planted_explanations_are_distinguished_as_often_as_said(distance: float, freedom: int) -> None:
    """Student's log ratio, with a noise that so few repeats estimate, beyond 20 to either side.

    Kills the chance that the likelier one is right (96 % in the place of 81 % at distance 5 and 3 degrees of freedom),
    a noise that is taken as known (97 %), a single side, and another factor.
    """
    rng = np.random.default_rng(freedom)
    first = rng.random(DRAWS) < 0.5  # which one is true
    measured = np.where(first, 0.5, -0.5) * distance + rng.standard_normal(DRAWS)
    noise = np.sqrt(rng.chisquare(freedom, DRAWS) / freedom)
    squares = [np.square((measured - side * distance) / noise) for side in (0.5, -0.5)]
    densities = [np.array([log_density(one, 0.0, 1, freedom) for one in own]) for own in squares]
    distinguished = float(np.mean(np.abs(densities[0] - densities[1]) > np.log(DECISIVE_LIKELIHOOD_RATIO)))
    assert float(probability(np.array(distance**2), freedom)) == pytest.approx(distinguished, abs=0.012)


@pytest.mark.parametrize(("freedom", "stated"), [(3, [0.41, 0.65, 0.81, 0.91]), (6, [0.54, 0.78, 0.91, 0.97])])
def test_differences_of_three_to_six_standard_errors_are_decided_as_the_manual_states(
    freedom: int, stated: list[float]
) -> None:
    """``docs/design.md``; kills another factor than 20."""
    assert probability(np.array([9.0, 16.0, 25.0, 36.0]), freedom) == pytest.approx(stated, abs=0.006)


def test_with_a_known_noise_the_log_ratio_is_normal_with_mean_half_the_squared_distance() -> None:
    gain = np.array([1.0, 9.0, 25.0])
    ratio = gain / 2.0 + np.sqrt(gain) * np.random.default_rng(0).standard_normal((200_000, 1))
    assert probability(gain) == pytest.approx(
        np.mean(np.abs(ratio) > np.log(DECISIVE_LIKELIHOOD_RATIO), axis=0), abs=4e-3
    )
    assert probability(gain, 1e5) == pytest.approx(probability(gain), abs=1e-4)


@pytest.mark.parametrize("freedom", [1, 3, 12, 300, np.inf])
def test_a_larger_distance_is_never_decided_less_often(freedom: float) -> None:
    found = probability(np.concatenate((np.linspace(0.0, 50.0, 500), np.geomspace(50.0, 1e9, 100))), freedom)
    assert found[0] == 0.0 and found[-1] == pytest.approx(1.0)
    assert np.all(np.diff(found) > -1e-12)


def test_without_a_repeat_nothing_is_decided() -> None:
    assert probability(np.array([4.0, 900.0]), 0.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("freedom", [1.0, 4.0])
def test_what_further_trials_promise_is_the_probability_of_the_larger_distance(freedom: float) -> None:
    now = float(probability(np.array(6.0), freedom))
    assert promised(now, freedom, 1.0, 0.0) == pytest.approx(now)
    assert promised(now, freedom, 3.0, 2.0) == pytest.approx(float(probability(np.array(18.0), freedom + 2.0)))
    assert [promised(end, freedom, 3.0, 2.0) for end in (0.0, 1.0)] == [0.0, 1.0]
