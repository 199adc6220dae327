"""The zero crossing: a known truth is recovered, and the interval covers it as often as it says."""

import numpy as np
import pytest

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


def test_a_level_line_has_no_zero_crossing() -> None:
    with pytest.raises(FitError, match="does not depend"):
        fit_zero_crossing(np.array([0.4, 0.5, 0.6]), np.full(3, 0.1))
