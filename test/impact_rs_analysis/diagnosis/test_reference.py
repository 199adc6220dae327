# SPDX-License-Identifier: Apache-2.0
"""What is due to chance, held against textbook distributions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_world import FEATURES, AnalyticSource, correlated
from scipy.stats import binom, norm
from scipy.stats import t as student

from impact_rs_analysis.diagnosis.reference import (
    BlockReference,
    RotationReference,
    _contrasts,
    combined_half_width,
    rarity,
    smallest,
)
from impact_rs_analysis.diagnosis.thresholds import LEAST_FREEDOM

pytestmark = pytest.mark.usefixtures("few_draws")
DRAWS = 999
WHITE = AnalyticSource(0).clusters[0]


def sensitivity(seed: int, clusters: int, parameters: int, alike: bool = False) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    if alike:
        return [rng.standard_normal((FEATURES, parameters))] * clusters
    return [rng.standard_normal((FEATURES, parameters)) for _ in range(clusters)]


def information(reference, jacobians):
    return sum(item.count * j.T @ j for item, j in zip(reference.clusters, jacobians, strict=True))


def test_contrasts_are_orthonormal_and_the_first_one_is_the_mean() -> None:
    for count in range(1, 6):
        rows = _contrasts(count)
        np.testing.assert_allclose(rows @ rows.T, np.eye(count), atol=1e-14)
        np.testing.assert_allclose(rows[0], 1.0 / np.sqrt(count))


@pytest.mark.parametrize("repeats", [4, 5, 9])
def test_with_one_parameter_and_one_condition_p_is_that_of_students_t(repeats: int) -> None:
    for seed in range(5):
        source = AnalyticSource(seed, design=(repeats,), correlation=correlated())
        reference = RotationReference(source.clusters)
        jacobians = sensitivity(seed, 1, 1)
        scores = source.clusters[0].residuals @ jacobians[0][:, 0]
        t = scores.mean() / (scores.std(ddof=1) / np.sqrt(repeats))
        expected = 2.0 * student.sf(abs(t), repeats - 1)
        found = reference.p_value(jacobians, information(reference, jacobians))
        assert found == pytest.approx(expected, abs=4.0 * np.sqrt(0.25 / DRAWS))


@pytest.mark.parametrize(("design", "parameters"), [((2, 2, 2), 1), ((2,) * 6, 7), ((3,) * 6, 7), ((5, 2, 3, 2), 3)])
def test_under_the_null_p_is_uniform_however_few_the_repeats_and_however_correlated_the_features(
    design: tuple[int, ...], parameters: int
) -> None:
    """Counted over 300 draws; the bounds are what chance allows in 1 of 10,000 runs."""
    draws, jacobians = 300, sensitivity(1, len(design), parameters)
    effects, fits = [], []
    for seed in range(draws):
        reference = RotationReference(AnalyticSource(seed, design=design, correlation=correlated()).clusters)
        effects.append(reference.p_value(jacobians, information(reference, jacobians)))
        fits.append(reference.lack_of_fit([item.mean for item in reference.clusters]))
    for level in (0.05, 0.3):
        low, high = binom.ppf([5e-5, 1 - 5e-5], draws, level)
        assert low <= np.count_nonzero(np.array(effects) < level) <= high
        assert low <= np.count_nonzero(np.array(fits) < level) <= high


def test_a_reference_with_too_few_repeats_decides_nothing() -> None:
    reference = RotationReference(AnalyticSource(0, design=(2, 2, 1)).clusters)
    assert reference.freedom == 2 < LEAST_FREEDOM
    assert reference.shortage is not None and "1 more repeat" in reference.shortage
    jacobians = sensitivity(0, 3, 1)
    assert reference.p_value(jacobians, information(reference, jacobians)) == 1.0
    assert reference.lack_of_fit([item.mean for item in reference.clusters]) is None


def test_a_shift_that_all_repeats_share_is_seen_and_noise_of_its_size_is_not() -> None:
    jacobians = sensitivity(3, 6, 1)
    source = AnalyticSource(3)
    shifted = [
        replace(item, residuals=item.residuals + jacobian[:, 0])
        for item, jacobian in zip(source.clusters, jacobians, strict=True)
    ]
    reference = RotationReference(shifted)
    assert reference.p_value(jacobians, information(reference, jacobians)) == pytest.approx(1.0 / (1.0 + DRAWS))


def test_a_simulator_that_is_off_by_what_is_known_of_it_raises_no_alarm_and_one_that_is_right_does_not_either() -> None:
    """False alarms at 5 %: without the discrepancy nearly always, with it at most about as often as stated."""
    draws, jacobians = 60, sensitivity(5, 6, 1, alike=True)
    blind, aware = 0, 0
    for seed in range(draws):
        source = AnalyticSource(seed, discrepancy=0.7, simulator=seed)
        known = RotationReference(source.clusters)
        unknown = RotationReference([replace(item, discrepancy=0.0 * item.discrepancy) for item in source.clusters])
        aware += known.p_value(jacobians, information(known, jacobians)) < 0.05
        blind += unknown.lack_of_fit([item.mean for item in source.clusters]) < 0.05
        assert known.lack_of_fit([item.mean for item in source.clusters]) > 0.001
    assert aware <= binom.ppf(0.9999, draws, 0.05)
    assert blind == draws


def of_signals(rows, names, patterns=None):
    """A cluster with noise of one whose features belong to the named signals, one feature each."""
    count = len(names)
    patterns = np.zeros((0, count)) if patterns is None else patterns
    sigma = np.sqrt(1.0 + np.sum(np.square(patterns), axis=0))
    return replace(
        WHITE,
        features=tuple(replace(WHITE.features[0], signal=name, bin=number) for number, name in enumerate(names)),
        residuals=rows / sigma,
        sigma=sigma,
        pure=1.0 / sigma,
        discrepancy=np.sqrt(1.0 - 1.0 / sigma**2),
        patterns=patterns / sigma,
    )


def test_what_shows_in_one_signal_of_many_is_seen() -> None:
    """One of ten signals is off by half a standard deviation: all squares together hide it, its own do not."""
    shift = np.where(np.arange(240) < 24, 0.5, 0.0)
    signals = [f"signal {number // 24}" for number in range(240)]
    found: dict[str, list[float | None]] = {"by signal": [], "all at once": []}
    for seed in range(10):
        noise = np.random.default_rng(seed).standard_normal((6, 3, 240))
        for way, names in (("by signal", signals), ("all at once", [""] * 240)):
            reference = RotationReference([of_signals(rows + shift, names) for rows in noise])
            found[way].append(reference.lack_of_fit([item.mean for item in reference.clusters]))
    assert np.median(found["by signal"]) < 0.03
    assert np.median(found["all at once"]) > 0.05


def test_a_difference_across_what_simulators_differ_in_is_seen_and_one_along_it_is_not() -> None:
    """One pattern, twice the noise, and a difference as large: along it, or at right angles to it."""
    rng = np.random.default_rng(0)
    pattern, across = 2.0 * np.linalg.qr(rng.standard_normal((400, 2)))[0].T * np.sqrt(400.0)
    noise = rng.standard_normal((6, 3, 400))
    p = {}
    for name, shift in (("along", pattern), ("across", across)):
        reference = RotationReference([of_signals(rows + shift, ["all"] * 400, pattern[None]) for rows in noise])
        p[name] = reference.lack_of_fit([item.mean for item in reference.clusters])
    assert p["along"] > 0.2
    assert p["across"] < 0.01


def test_the_smallest_of_several_p_counts_all_that_were_looked_at() -> None:
    """Of one statistic it is its own p; of k independent ones about k times the smallest; copies cost nothing."""
    null = np.random.default_rng(0).standard_normal((4000, 5)) ** 2
    own = rarity(8.0, null[:, 0])
    assert smallest(np.array([8.0]), null[:, :1]) == pytest.approx(own)
    assert smallest(np.full(3, 8.0), null[:, [0, 0, 0]]) == pytest.approx(own)
    together = smallest(np.array([8.0, 0.1, 0.1, 0.1, 0.1]), null)
    assert together == pytest.approx(1.0 - (1.0 - own) ** 5, rel=0.2)
    silent = smallest(np.array([8.0, 0.0]), np.column_stack((null[:, 0], np.zeros(4000))))
    assert silent == pytest.approx(own)


def test_blocks_flip_their_signs_and_the_null_is_uniform() -> None:
    draws, jacobians = 300, sensitivity(7, 24, 3)
    found = []
    for seed in range(draws):
        reference = BlockReference(AnalyticSource(seed, design=(1,) * 24, repeated=False).clusters)
        found.append(reference.p_value(jacobians, information(reference, jacobians)))
    for level in (0.05, 0.3):
        low, high = binom.ppf([5e-5, 1 - 5e-5], draws, level)
        assert low <= np.count_nonzero(np.array(found) < level) <= high


def test_covariance_of_repeats_is_that_of_a_weighted_mean() -> None:
    """One parameter that shifts every feature alike: the estimate is the mean over repeats, its variance s^2 / n."""
    source = AnalyticSource(11, design=(400,))
    reference, ones = RotationReference(source.clusters), [np.ones((FEATURES, 1))]
    inverse = np.linalg.inv(information(reference, ones))
    found = reference.covariance(ones, np.zeros(1), inverse)[0, 0]
    means = source.clusters[0].residuals.mean(axis=1)
    assert found == pytest.approx(means.var(ddof=1) / 400, rel=1e-9)


def test_intervals_take_the_quantile_of_the_estimator_that_made_them() -> None:
    one, nothing = np.ones(1), np.zeros(1)
    from_noise = combined_half_width(one, float(student.ppf(0.975, 12)), nothing, 6, nothing)
    from_clusters = combined_half_width(nothing, 2.0, one, 6, nothing)
    from_simulators = combined_half_width(nothing, 2.0, nothing, 6, one)
    assert from_noise[0] == pytest.approx(student.ppf(0.975, 12))
    assert from_clusters[0] == pytest.approx(student.ppf(0.975, 5))
    assert from_simulators[0] == pytest.approx(norm.ppf(0.975))
    assert combined_half_width(one, 2.0, one, 6, one)[0] == pytest.approx(
        np.hypot(student.ppf(0.975, 5), norm.ppf(0.975))
    )


def test_rarity_counts_the_observation_itself() -> None:
    assert rarity(5.0, np.arange(9.0)) == pytest.approx(5.0 / 10.0)
    assert rarity(100.0, np.arange(9.0)) == pytest.approx(1.0 / 10.0)


def test_an_effect_is_seen_although_conditions_disagree_about_it_by_more_than_it_is_large() -> None:
    """It is held against the scatter of repeats, not against all that differs: the disagreement is no noise."""
    jacobians = sensitivity(21, 6, 1)
    source = AnalyticSource(21, design=(2,) * 6)
    shifted = [
        replace(item, residuals=item.residuals + (2.0 + 6.0 * (-1.0) ** number) * own[:, 0])
        for number, (item, own) in enumerate(zip(source.clusters, jacobians, strict=True))
    ]
    reference = RotationReference(shifted)
    assert reference.p_value(jacobians, information(reference, jacobians)) < 0.01


def test_the_quantile_is_that_of_student_with_the_degrees_of_freedom_of_the_repeats() -> None:
    reference = RotationReference(AnalyticSource(0, design=(2, 3, 2)).clusters)
    assert reference.freedom == 4
    assert reference.quantile() == pytest.approx(student.ppf(0.975, 4))
