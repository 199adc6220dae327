# SPDX-License-Identifier: Apache-2.0
"""The zero crossing: a known truth is recovered, and the interval covers it as often as it says."""

import numpy as np
import pytest
from scipy.stats import t as student

from impact_rs_analysis.measure.fit import FitError, fit_zero_crossing

SCALES = np.repeat([0.8, 0.9, 1.0, 1.1, 1.2], 5)


def synthetic(truth: float, slope: float, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Net feedback of 25 trials whose zero crossing is ``truth`` [m/s]."""
    velocity = -0.55 * SCALES
    return velocity, slope * (velocity - truth) + noise * rng.standard_normal(velocity.size)


def test_a_line_without_noise_gives_the_truth() -> None:
    velocity, net = synthetic(-0.534, 1.1, 0.0, np.random.default_rng(0))
    fit = fit_zero_crossing(velocity, net)
    assert fit.estimate == pytest.approx(-0.534, abs=1e-12)
    assert fit.slope == pytest.approx(1.1)
    assert fit.r_squared == pytest.approx(1.0)
    assert fit.interval == pytest.approx((-0.534, -0.534), abs=1e-9)


@pytest.mark.parametrize(("truth", "noise"), [(-0.534, 0.005), (-0.534, 0.04), (-0.70, 0.01)])
def test_the_interval_covers_the_truth_95_times_in_100(truth: float, noise: float) -> None:
    rng = np.random.default_rng(7)
    trials, hits = 4000, 0
    for _ in range(trials):
        interval = fit_zero_crossing(*synthetic(truth, 1.1, noise, rng)).interval
        hits += interval is None or interval[0] <= truth <= interval[1]
    # Four standard deviations of a count of 4000 at 95 % are 1.4 %.
    assert hits / trials == pytest.approx(0.95, abs=0.014)


def test_coverage_holds_for_three_trials() -> None:
    rng = np.random.default_rng(3)
    velocity = np.array([-0.44, -0.55, -0.66])
    hits = 0
    for _ in range(4000):
        interval = fit_zero_crossing(velocity, 1.1 * (velocity + 0.53) + 0.002 * rng.standard_normal(3)).interval
        hits += interval is None or interval[0] <= -0.53 <= interval[1]
    assert hits / 4000 == pytest.approx(0.95, abs=0.014)


def test_the_interval_is_wider_away_from_the_data() -> None:
    rng = np.random.default_rng(1)
    inside = fit_zero_crossing(*synthetic(-0.55, 1.1, 0.01, rng)).interval
    outside = fit_zero_crossing(*synthetic(-0.9, 1.1, 0.01, rng)).interval
    assert inside is not None
    assert outside is not None
    assert np.diff(outside) > np.diff(inside)


def test_noise_alone_bounds_nothing() -> None:
    rng = np.random.default_rng(5)
    fit = fit_zero_crossing(-0.55 * SCALES, 0.01 * rng.standard_normal(SCALES.size))
    assert fit.interval is None


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


def line(seed: int, truth: float, noise: float, count: int = 25) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    velocity = -0.55 * np.resize(SCALES[::5], count)
    return velocity, 1.1 * (velocity - truth) + noise * rng.standard_normal(count)


@pytest.mark.parametrize("truth", [-0.55, -0.534, -0.70, -0.9])
@pytest.mark.parametrize(("noise", "count"), [(0.002, 25), (0.03, 25), (0.01, 5)])
@pytest.mark.parametrize("confidence", [0.95, 0.68])
def test_both_ends_of_the_interval_solve_fiellers_equation(
    truth: float, noise: float, count: int, confidence: float
) -> None:
    """(a + b x)^2 = t^2 var(a + b x) at both ends, with the covariance of a and b from least squares."""
    velocity, net = line(3, truth, noise, count)
    fit = fit_zero_crossing(velocity, net, confidence)
    design = np.column_stack((np.ones(count), velocity))
    (intercept, slope), (squares,), _, _ = np.linalg.lstsq(design, net, rcond=None)
    covariance = squares / (count - 2) * np.linalg.inv(design.T @ design)
    quantile = student.ppf(0.5 + confidence / 2.0, count - 2)
    assert fit.interval is not None
    for end in fit.interval:
        row = np.array([1.0, end])
        assert (intercept + slope * end) ** 2 == pytest.approx(quantile**2 * row @ covariance @ row, rel=1e-6)
    low, high = fit.interval
    assert low < fit.estimate < high
    for x, inside in ((low - 1e-6, False), (low + 1e-6, True), (high - 1e-6, True), (high + 1e-6, False)):
        row = np.array([1.0, x])
        assert ((intercept + slope * x) ** 2 < quantile**2 * row @ covariance @ row) == inside


def test_for_a_steep_line_through_the_middle_the_interval_is_the_symmetric_one_of_the_delta_method() -> None:
    """x0 +- t s / (|b| sqrt(n)): the limit of a slope that is known exactly, at the mean of the velocities."""
    velocity, _ = line(0, -0.55, 0.0)
    noise = np.random.default_rng(4).standard_normal(velocity.size)
    design = np.column_stack((np.ones(velocity.size), velocity))
    noise -= design @ np.linalg.lstsq(design, noise, rcond=None)[0]  # the line itself stays where it is
    fit = fit_zero_crossing(velocity, 1.1 * (velocity + 0.55) + 1e-4 * noise)
    assert fit.interval is not None
    half = student.ppf(0.975, 23) * fit.scatter / (1.1 * 5.0)
    assert fit.estimate == pytest.approx(-0.55, abs=1e-12)
    assert np.array(fit.interval) == pytest.approx([-0.55 - half, -0.55 + half], rel=1e-6)


def test_away_from_the_data_the_interval_reaches_farther_outwards_than_inwards() -> None:
    """Fieller's interval is not symmetric about the estimate: a flatter line crosses zero ever farther out."""
    outside = fit_zero_crossing(*line(5, -0.9, 0.03))
    assert outside.interval is not None
    low, high = outside.interval
    assert outside.estimate - low > 1.05 * (high - outside.estimate)


@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.99])
def test_the_interval_covers_as_often_as_it_is_asked_to(confidence: float) -> None:
    rng = np.random.default_rng(11)
    trials, hits = 2000, 0
    for _ in range(trials):
        velocity, net = synthetic(-0.7, 1.1, 0.02, rng)
        interval = fit_zero_crossing(velocity, net, confidence).interval
        hits += interval is None or interval[0] <= -0.7 <= interval[1]
    assert hits / trials == pytest.approx(confidence, abs=4.0 * np.sqrt(confidence * (1.0 - confidence) / trials))


def test_the_interval_misses_the_truth_on_either_side_equally_often() -> None:
    """Fieller's regions are those of a two-sided test with equal tails."""
    rng = np.random.default_rng(12)
    below = above = 0
    for _ in range(4000):
        interval = fit_zero_crossing(*synthetic(-0.75, 1.1, 0.02, rng)).interval
        assert interval is not None
        below += interval[1] < -0.75
        above += interval[0] > -0.75
    # Four standard deviations of the difference of two counts of 100 each are 57.
    assert abs(below - above) < 57
    assert below + above == pytest.approx(200, abs=57)


def test_the_scatter_is_that_of_the_trials_and_the_fit_is_least_squares() -> None:
    rng = np.random.default_rng(13)
    scatters = []
    for _ in range(500):
        velocity, net = synthetic(-0.534, 1.1, 0.02, rng)
        fit = fit_zero_crossing(velocity, net)
        slope, intercept = np.polyfit(velocity, net, 1)
        assert (fit.slope, fit.intercept) == pytest.approx((slope, intercept), abs=1e-9)
        assert fit.r_squared == pytest.approx(np.corrcoef(velocity, net)[0, 1] ** 2)
        np.testing.assert_allclose(fit.at(velocity), intercept + slope * velocity, atol=1e-9)
        scatters.append(fit.scatter**2)
    # With n - 2 in the denominator the variance has no bias; 500 of them with 23 degrees of freedom each.
    assert np.mean(scatters) == pytest.approx(0.02**2, rel=4.0 * np.sqrt(2.0 / 23.0 / 500.0))
