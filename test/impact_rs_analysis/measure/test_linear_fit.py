# SPDX-License-Identifier: Apache-2.0
"""The zero crossing: a known truth is recovered, and the interval covers it as often as it says."""

import numpy as np
import pytest
from scipy.stats import t as student

from impact_rs_analysis.measure.linear_fit import FitError, fit_zero_crossing

VELOCITY = -0.55 * np.repeat([0.8, 0.9, 1.0, 1.1, 1.2], 5)  # m/s, of 25 trials
SLOPE = 1.1

Line = tuple[np.ndarray, np.ndarray]


def line(truth: float, noise: float, rng: np.random.Generator, velocity: np.ndarray = VELOCITY) -> Line:
    """Velocities, and net feedback whose zero crossing is ``truth`` [m/s]."""
    return velocity, SLOPE * (velocity - truth) + noise * rng.standard_normal(velocity.size)


def interval_of(truth: float, noise: float, seed: int) -> tuple[float, float]:
    found = fit_zero_crossing(*line(truth, noise, np.random.default_rng(seed))).interval
    assert found is not None
    return found


def test_a_line_without_noise_gives_the_truth() -> None:
    fit = fit_zero_crossing(*line(-0.534, 0.0, np.random.default_rng(0)))
    assert fit.estimate == pytest.approx(-0.534, abs=1e-12)
    assert fit.slope == pytest.approx(SLOPE)
    assert fit.r_squared == pytest.approx(1.0)
    assert fit.interval == pytest.approx((-0.534, -0.534), abs=1e-9)


@pytest.mark.parametrize(
    ("truth", "noise", "trials", "confidence", "count"),
    [
        (-0.534, 0.005, 25, 0.95, 4000), (-0.534, 0.04, 25, 0.95, 4000), (-0.70, 0.01, 25, 0.95, 4000),
        (-0.53, 0.002, 3, 0.95, 4000),
        (-0.70, 0.02, 25, 0.5, 2000), (-0.70, 0.02, 25, 0.8, 2000), (-0.70, 0.02, 25, 0.99, 2000),
    ],
)  # fmt: skip
def test_the_interval_covers_the_truth_as_often_as_it_says(
    truth: float, noise: float, trials: int, confidence: float, count: int
) -> None:
    """Within four standard deviations of the count."""
    rng, hits = np.random.default_rng(7), 0
    velocity = VELOCITY if trials == 25 else np.array([-0.44, -0.55, -0.66])
    for _ in range(count):
        interval = fit_zero_crossing(*line(truth, noise, rng, velocity), confidence).interval
        hits += interval is None or interval[0] <= truth <= interval[1]
    assert hits / count == pytest.approx(confidence, abs=4.0 * np.sqrt(confidence * (1.0 - confidence) / count))


def test_the_interval_misses_the_truth_on_either_side_equally_often() -> None:
    """Fieller's regions are those of a two-sided test with equal tails."""
    rng = np.random.default_rng(12)
    ends = np.array([fit_zero_crossing(*line(-0.75, 0.02, rng)).interval for _ in range(4000)])
    below, above = np.count_nonzero(ends[:, 1] < -0.75), np.count_nonzero(ends[:, 0] > -0.75)
    # Four standard deviations of the difference of two counts of 100 each are 57.
    assert abs(below - above) < 57
    assert below + above == pytest.approx(200, abs=57)


def test_the_interval_is_wider_away_from_the_data() -> None:
    assert np.diff(interval_of(-0.9, 0.01, 1)) > np.diff(interval_of(-0.55, 0.01, 1))


def test_away_from_the_data_the_interval_reaches_farther_outwards() -> None:
    """Fieller's interval is not symmetric about the estimate: a flatter line crosses zero ever farther out."""
    fit = fit_zero_crossing(*line(-0.9, 0.03, np.random.default_rng(5)))
    assert fit.interval is not None
    low, high = fit.interval
    assert fit.estimate - low > 1.05 * (high - fit.estimate)


def test_noise_alone_bounds_nothing() -> None:
    noise = np.random.default_rng(5).standard_normal(VELOCITY.size)
    assert fit_zero_crossing(VELOCITY, 0.01 * noise).interval is None


@pytest.mark.parametrize(
    ("velocity", "message"),
    [([], "0 trials"), ([0.5], "1 trial "), ([0.5, 0.6], "2 trials"), ([0.5, 0.5, 0.5], "1 post-impact velocity")],
)
def test_too_few_trials_say_what_is_missing(velocity: list[float], message: str) -> None:
    with pytest.raises(FitError, match=message):
        fit_zero_crossing(np.array(velocity), np.arange(len(velocity), dtype=float))


@pytest.mark.parametrize("level", [0.1, 1.1])
@pytest.mark.parametrize("velocity", [[0.4, 0.5, 0.6], [0.13, 0.27, 0.31, 0.55], [0.31, 0.47, 0.59, 0.71, 0.83]])
def test_a_level_line_has_no_zero_crossing(level: float, velocity: list[float]) -> None:
    """In floating point its slope is some 1e-16, of either sign."""
    with pytest.raises(FitError, match="does not depend"):
        fit_zero_crossing(np.array(velocity), np.full(len(velocity), level))


@pytest.mark.parametrize("truth", [-0.55, -0.534, -0.70, -0.9])
@pytest.mark.parametrize(("noise", "count"), [(0.002, 25), (0.03, 25), (0.01, 5)])
@pytest.mark.parametrize("confidence", [0.95, 0.68])
def test_both_ends_of_the_interval_solve_fiellers_equation(
    truth: float, noise: float, count: int, confidence: float
) -> None:
    """(a + b x)^2 = t^2 var(a + b x) at both ends, with the covariance of a and b from least squares."""
    velocity, net = line(truth, noise, np.random.default_rng(3), np.resize(VELOCITY[::5], count))
    fit = fit_zero_crossing(velocity, net, confidence)
    design = np.column_stack((np.ones(count), velocity))
    (intercept, slope), (squares,), _, _ = np.linalg.lstsq(design, net, rcond=None)
    covariance = squares / (count - 2) * np.linalg.inv(design.T @ design)
    quantile = student.ppf(0.5 + confidence / 2.0, count - 2)

    def sides(x: float) -> tuple[float, float]:
        row = np.array([1.0, x])
        return (intercept + slope * x) ** 2, quantile**2 * row @ covariance @ row

    assert fit.interval is not None
    low, high = fit.interval
    assert low < fit.estimate < high
    for end in fit.interval:
        left, right = sides(end)
        assert left == pytest.approx(right, rel=1e-6)
    for x, inside in ((low - 1e-6, False), (low + 1e-6, True), (high - 1e-6, True), (high + 1e-6, False)):
        left, right = sides(x)
        assert (left < right) == inside


def test_for_a_steep_line_the_interval_is_that_of_the_delta_method() -> None:
    """x0 +- t s / (|b| sqrt(n)): the limit of a slope that is known exactly, at the mean of the velocities."""
    noise = np.random.default_rng(4).standard_normal(VELOCITY.size)
    design = np.column_stack((np.ones(VELOCITY.size), VELOCITY))
    noise -= design @ np.linalg.lstsq(design, noise, rcond=None)[0]  # the line itself stays where it is
    fit = fit_zero_crossing(VELOCITY, SLOPE * (VELOCITY + 0.55) + 1e-4 * noise)
    half = student.ppf(0.975, 23) * fit.scatter / (SLOPE * 5.0)
    assert fit.estimate == pytest.approx(-0.55, abs=1e-12)
    assert fit.interval == pytest.approx((-0.55 - half, -0.55 + half), rel=1e-6)


def test_the_scatter_is_that_of_the_trials_and_the_fit_is_least_squares() -> None:
    rng, variances = np.random.default_rng(13), []
    for _ in range(500):
        velocity, net = line(-0.534, 0.02, rng)
        fit = fit_zero_crossing(velocity, net)
        slope, intercept = np.polyfit(velocity, net, 1)
        assert (fit.slope, fit.intercept) == pytest.approx((slope, intercept), abs=1e-9)
        assert fit.r_squared == pytest.approx(np.corrcoef(velocity, net)[0, 1] ** 2)
        np.testing.assert_allclose(fit.at(velocity), intercept + slope * velocity, atol=1e-9)
        variances.append(fit.scatter**2)
    # With n - 2 in the denominator the variance has no bias; 500 of them with 23 degrees of freedom each.
    assert np.mean(variances) == pytest.approx(0.02**2, rel=4.0 * np.sqrt(2.0 / 23.0 / 500.0))
