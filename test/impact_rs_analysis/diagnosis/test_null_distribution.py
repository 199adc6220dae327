# SPDX-License-Identifier: Apache-2.0
"""What is due to chance, held against textbook distributions."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from analytic_world import FEATURES, AnalyticSource, assert_uniform, correlated, means_of
from scipy.stats import binom, norm
from scipy.stats import t as student

from impact_rs_analysis.diagnosis.search.candidate import Problem
from impact_rs_analysis.diagnosis.search.null_distribution import (
    RotationNull,
    SignFlipNull,
    monte_carlo_p_value,
    westfall_young_p_value,
)
from impact_rs_analysis.diagnosis.thresholds import MIN_DEGREES_OF_FREEDOM
from impact_rs_analysis.evidence.cluster import (
    DISCREPANCY_QUANTILE_RATIO,
    SHARED_DISCREPANCY_SHARE,
    Feature,
    pooled_error,
)

DRAWS = 999
NULLS = 100  # of noise alone: if half of them lay below 5 %, or none below 30 %, it would show
SLOW = pytest.mark.slow
WHITE = AnalyticSource(0).clusters[0]


def sensitivity(seed: int, clusters: int, parameters: int, alike: bool = False) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    if alike:
        return [rng.standard_normal((FEATURES, parameters))] * clusters
    return [rng.standard_normal((FEATURES, parameters)) for _ in range(clusters)]


def information(reference, jacobians):
    return sum(item.count * j.T @ j for item, j in zip(reference.clusters, jacobians, strict=True))


def p_of(reference, jacobians) -> float:
    return reference.p_value(jacobians)


def lack_of_fit(reference) -> float:
    return reference.lack_of_fit(means_of(reference.clusters))


def shifted(clusters, jacobians, sizes) -> RotationNull:
    """The reference of clusters whose residuals are shifted along a sensitivity, by a size of each."""
    return RotationNull(
        [
            replace(item, residuals=item.residuals + size * jacobian[:, 0])
            for item, jacobian, size in zip(clusters, jacobians, sizes, strict=True)
        ]
    )


@pytest.mark.parametrize("repeats", [4, 5, 9])
def test_of_one_feature_in_one_condition_p_is_that_of_students_t(repeats: int) -> None:
    for seed in range(5):
        rows = np.random.default_rng(seed).standard_normal((repeats, 1))
        reference = RotationNull([of_signals(rows, ["alone"])])
        t = rows.mean() / (rows.std(ddof=1) / np.sqrt(repeats))
        expected = 2.0 * student.sf(abs(t), repeats - 1)
        assert p_of(reference, [np.ones((1, 1))]) == pytest.approx(expected, abs=4.0 * np.sqrt(0.25 / DRAWS))


@pytest.mark.parametrize(
    ("design", "parameters", "nulls"),
    [
        ((2, 2, 2), 1, NULLS),
        ((5, 2, 3, 2), 3, NULLS),
        *(pytest.param((count,) * 6, 7, 300, marks=SLOW) for count in (2, 3)),
    ],
)
def test_p_is_uniform_under_the_null_for_few_and_correlated_features(
    design: tuple[int, ...], parameters: int, nulls: int
) -> None:
    jacobians = sensitivity(1, len(design), parameters)
    sources = (AnalyticSource(seed, design=design, correlation=correlated()) for seed in range(nulls))
    references = [RotationNull(source.clusters) for source in sources]
    assert_uniform([p_of(reference, jacobians) for reference in references])
    assert_uniform([lack_of_fit(reference) for reference in references])


def scaled_by_their_repeats(clusters, jacobians):
    """Clusters and sensitivities with the pure error that the repeats give in place of the true one."""
    found = pooled_error([item.residuals for item in clusters])
    scale = np.sqrt(found**2 + 1.0 - np.square(clusters[0].pure_error))
    items = [
        replace(
            item,
            residuals=item.residuals / scale,
            sigma=item.sigma * scale,
            pure_error=found / scale,
            discrepancy=item.discrepancy / scale,
        )
        for item in clusters
    ]
    return RotationNull(items), [jacobian / scale[:, None] for jacobian in jacobians]


@pytest.mark.parametrize(("design", "parameters"), [((2, 2, 2), 1), ((2,) * 6, 7)])
def test_p_is_uniform_where_few_repeats_give_the_scale(design: tuple[int, ...], parameters: int) -> None:
    """As in a diagnosis. With the scale of the measurement in every rotation a third of the nulls lies below 1 %."""
    jacobians, levels = sensitivity(1, len(design), parameters), (0.01, 0.05, 0.3)
    sources = (AnalyticSource(seed, design=design, correlation=correlated()) for seed in range(NULLS))
    scaled = [scaled_by_their_repeats(source.clusters, jacobians) for source in sources]
    assert_uniform([p_of(reference, own) for reference, own in scaled], levels)
    assert_uniform([lack_of_fit(reference) for reference, _ in scaled], levels)


def test_p_is_uniform_beside_parameters_that_were_fitted() -> None:
    """Rotations of what a fit leaves are held against the fit of both: seven parameters are fitted to pure noise."""
    p_values, fitted, tested = [], sensitivity(1, 6, 7), sensitivity(2, 6, 2)
    for seed in range(NULLS):
        clusters = AnalyticSource(seed, design=(2,) * 6, correlation=correlated()).clusters
        change = np.linalg.lstsq(np.vstack(fitted), np.concatenate(means_of(clusters)), rcond=None)[0]
        left = [replace(c, residuals=c.residuals - j @ change) for c, j in zip(clusters, fitted, strict=True)]
        p_values.append(RotationNull(left).p_value(tested, fitted))
    assert_uniform(p_values)


def test_p_is_uniform_beside_fitted_parameters_where_the_relevance_limit_gives_the_scale() -> None:
    """Six rows of one feature, two of them fitted. Kills rotations of what a fit leaves: p < 5 % in 16 %."""
    p_values, sensitivities = [], np.random.default_rng(0).standard_normal((3, 1, 3))
    features = (Feature("push", "velocity", "x", 0, "m/s", 20.0),)
    sigma = np.sqrt(1.0 + 10.0**2)  # noise 1, half the relevance limit 10
    fitted, tested = list(sensitivities[:, :, :2]), list(sensitivities[:, :, 2:])
    for seed in range(3 * NULLS):
        rows = np.random.default_rng(seed).standard_normal((3, 2, 1))
        columns = np.vstack(fitted)
        rows -= (columns @ np.linalg.lstsq(columns, rows.mean(axis=1).ravel(), rcond=None)[0])[:, None, None]
        clusters = [
            replace(
                WHITE, residuals=own / sigma, name=str(number), features=features, sigma=np.full(1, sigma),
                pure_error=np.full(1, 1.0 / sigma), discrepancy=np.zeros(1),
            )
            for number, own in enumerate(rows)
        ]  # fmt: skip
        scaled = [[one / sigma for one in each] for each in (tested, fitted)]
        p_values.append(RotationNull(clusters).p_value(*scaled))
    for level, most in ((0.05, 0.09), (0.01, 0.03)):
        assert np.mean(np.array(p_values) < level) < most
    assert 0.35 < np.mean(p_values) < 0.65


def test_conditions_without_repeats_have_the_noise_of_the_others() -> None:
    """One condition of four runs and nine of one. Kills: these add information and no noise."""
    jacobians = sensitivity(1, 10, 1)
    found = []
    for seed in range(NULLS):
        reference = RotationNull(AnalyticSource(seed, design=(4,) + (1,) * 9).clusters)
        inverse = np.linalg.inv(information(reference, jacobians))
        found.append(reference.covariance(jacobians, means_of(reference.clusters), inverse) / inverse)
    assert np.mean(found) == pytest.approx(np.square(WHITE.pure_error[0]), rel=0.15)


def test_what_was_fitted_cannot_be_found_again() -> None:
    jacobians = sensitivity(3, 6, 2)
    reference = shifted(AnalyticSource(3).clusters, jacobians, [3.0] * 6)
    assert reference.p_value([j[:, :1] for j in jacobians]) < 0.01
    assert reference.p_value([j[:, :1] for j in jacobians], jacobians) == 1.0


def test_a_large_misfit_of_one_feature_is_seen() -> None:
    """Its own size does not hide it: it raises the variance of rotations, and not that of its contrasts."""
    clusters = AnalyticSource(0, design=(3,) * 6).clusters
    only = 30.0 * (np.arange(FEATURES) == 3)
    reference = RotationNull([replace(item, residuals=item.residuals + only) for item in clusters])
    assert lack_of_fit(reference) < 0.01
    assert p_of(reference, [np.ones((FEATURES, 1))] * 6) < 0.01


def test_heavy_tails_raise_no_alarm() -> None:
    """Student's t with 3 degrees of freedom, direction by direction: no more alarms than with normal noise."""
    jacobians, p_values = sensitivity(1, 4, 1), []
    for seed in range(NULLS):
        noise = np.random.default_rng(seed).standard_t(3, (4, 3, FEATURES)) @ correlated()
        clusters = [replace(WHITE, residuals=rows, name=str(number)) for number, rows in enumerate(noise)]
        reference, own = scaled_by_their_repeats(clusters, jacobians)
        p_values.append((p_of(reference, own), lack_of_fit(reference)))
    for level in (0.01, 0.05):
        assert np.all(np.sum(np.array(p_values) < level, axis=0) <= binom.ppf(1.0 - 5e-5, NULLS, level))


def test_a_reference_with_too_few_repeats_decides_nothing() -> None:
    reference = RotationNull(AnalyticSource(0, design=(2, 2, 1)).clusters)
    assert reference.freedom == 2 < MIN_DEGREES_OF_FREEDOM
    assert reference.shortage is not None and "1 more repeat" in reference.shortage
    assert p_of(reference, sensitivity(0, 3, 1)) == 1.0
    assert lack_of_fit(reference) is None


def test_a_shift_that_all_repeats_share_is_seen() -> None:
    jacobians = sensitivity(3, 6, 1)
    reference = shifted(AnalyticSource(3).clusters, jacobians, [1.0] * 6)
    assert p_of(reference, jacobians) <= 1.0 / (1.0 + DRAWS)


def test_a_known_simulator_error_raises_no_alarm() -> None:
    """False alarms at 5 %: without the discrepancy nearly always, with it at most about as often as stated."""
    draws, jacobians = 60, sensitivity(5, 6, 1, alike=True)
    blind, aware = 0, 0
    for seed in range(draws):
        source = AnalyticSource(seed, discrepancy=0.7, simulator=seed)
        known = RotationNull(source.clusters)
        unknown = RotationNull([replace(item, discrepancy=0.0 * item.discrepancy) for item in source.clusters])
        aware += p_of(known, jacobians) < 0.05
        blind += lack_of_fit(unknown) < 0.05
        assert lack_of_fit(known) > 0.001
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
        pure_error=1.0 / sigma,
        discrepancy=np.sqrt(1.0 - 1.0 / sigma**2),
        patterns=patterns / sigma,
    )


def test_a_simulator_that_is_off_as_much_as_is_known_is_seldom_significant() -> None:
    """Twice the noise, in part alike in five conditions of four runs. Kills: the variance of one run; not shared."""
    p_values, lacks = [], []
    for seed in range(NULLS):
        rng, clusters = (
            np.random.default_rng([9, seed]),
            AnalyticSource(seed, design=(4,) * 5, discrepancy=2.0).clusters,
        )
        alike = np.sqrt(SHARED_DISCREPANCY_SHARE) * rng.standard_normal(FEATURES)
        own = np.sqrt(1.0 - SHARED_DISCREPANCY_SHARE) * rng.standard_normal((5, FEATURES))
        off = DISCREPANCY_QUANTILE_RATIO * (alike + own)
        reference = RotationNull(
            [replace(c, residuals=c.residuals + c.discrepancy * row) for c, row in zip(clusters, off, strict=True)]
        )
        p_values.append(p_of(reference, sensitivity(seed, 5, 2, alike=True)))
        lacks.append(lack_of_fit(reference))
    for found in np.array((p_values, lacks)):
        assert np.count_nonzero(found < 0.05) <= binom.ppf(1 - 1e-3, NULLS, 0.05)
        assert np.count_nonzero(found < 0.5) >= 0.1 * NULLS  # scaled by the variance of few runs, it is conservative


def test_a_calibration_that_is_off_within_its_uncertainty_is_no_effect() -> None:
    """A clock that the conditions of two layouts share. Kills: left out; one amplitude for each layout."""
    moved = [2.0 * own[:, 0] for own in sensitivity(4, 5, 1)]

    def off_by(size: float, seed: int) -> RotationNull:
        return RotationNull(
            [
                replace(item, residuals=item.residuals + size * row, calibrations=row[None])
                for item, row in zip(in_two_layouts(seed, (2,) * 5), moved, strict=True)
            ]
        )

    p_values, lacks = [], []
    for seed in range(NULLS):
        reference = off_by(np.random.default_rng([12, seed]).standard_normal(), seed)
        p_values.append(p_of(reference, [row[:, None] for row in moved]))
        lacks.append(lack_of_fit(reference))
    for found in np.array((p_values, lacks)):
        assert np.count_nonzero(found < 0.05) <= binom.ppf(1 - 1e-3, NULLS, 0.05)
        assert np.count_nonzero(found < 0.5) >= 0.25 * NULLS
    assert p_of(off_by(6.0, 0), [row[:, None] for row in moved]) < 0.01


def test_a_calibration_explains_no_more_than_three_standard_deviations() -> None:
    """A clock that is off by six deviations, in few runs, is a delay. Kills: it explains any amplitude."""
    moved = [20.0 * own for own in sensitivity(4, 3, 1)]

    def off_by(size: float, seed: int) -> float:
        clusters = AnalyticSource(seed, design=(2, 2, 2)).clusters
        off = [
            replace(item, residuals=item.residuals + size * row[:, 0], calibrations=row.T)
            for item, row in zip(clusters, moved, strict=True)
        ]
        return p_of(RotationNull(off), moved)

    assert np.max([off_by(6.0, seed) for seed in range(10)]) < 0.005
    assert np.median([off_by(1.7, seed) for seed in range(10)]) > 0.05


def test_what_shows_in_one_signal_of_many_is_seen() -> None:
    """One of ten signals is off by half a standard deviation: all squares together hide it, its own do not."""
    shift = np.where(np.arange(240) < 24, 0.5, 0.0)
    signals = [f"signal {number // 24}" for number in range(240)]
    found: dict[str, list[float | None]] = {"by signal": [], "all at once": []}
    for seed in range(10):
        noise = np.random.default_rng(seed).standard_normal((6, 3, 240))
        for way, names in (("by signal", signals), ("all at once", [""] * 240)):
            reference = RotationNull([of_signals(rows + shift, names) for rows in noise])
            found[way].append(lack_of_fit(reference))
    assert np.median(found["by signal"]) < 0.03
    assert np.median(found["all at once"]) > 0.05


def test_a_difference_is_seen_across_simulator_error_and_not_along_it() -> None:
    """One pattern, twice the noise, and a difference as large: along it, or at right angles to it."""
    rng = np.random.default_rng(0)
    pattern, across = 2.0 * np.linalg.qr(rng.standard_normal((400, 2)))[0].T * np.sqrt(400.0)
    noise = rng.standard_normal((6, 3, 400))
    p = {}
    for name, shift in (("along", pattern), ("across", across)):
        reference = RotationNull([of_signals(rows + shift, ["all"] * 400, pattern[None]) for rows in noise])
        p[name] = lack_of_fit(reference)
    assert p["along"] > 0.2
    assert p["across"] < 0.01


def test_features_without_a_discrepancy_differ_between_conditions() -> None:
    """Conditions share amplitudes feature by feature. Kills: features without a discrepancy have no amplitude."""
    noise = np.random.default_rng(0).standard_normal((3, 3, 60))
    clusters = [of_signals(rows, ["all"] * 60, np.full((1, 60), 0.3)) for rows in noise]
    without = [np.where(np.arange(60) % 7 == number, 0.0, item.discrepancy) for number, item in enumerate(clusters, 3)]
    for kept in (None, clusters[0].patterns):  # simulators differ along no pattern, or along some
        here = [replace(item, discrepancy=own, patterns=kept) for item, own in zip(clusters, without, strict=True)]
        assert 0.01 < lack_of_fit(RotationNull(here)) <= 1.0
    own = here[1].unshared_discrepancy
    assert np.flatnonzero(np.all(own[1:] == 0.0, axis=1)).tolist() == list(range(4, 60, 7))


@pytest.mark.parametrize("size", [0.0, 2.0])
def test_with_three_contrasts_a_discrepancy_hides_no_misfit_of_every_feature(size: float) -> None:
    """Off by what six patterns and no pattern explain; beside that, by twice the noise in all features or not at all.

    Kills: draws whose one scale is as uncertain as three contrasts make that of one feature; a discrepancy beside the
    patterns that is left out of the rotations.
    """
    patterns = np.random.default_rng(0).standard_normal((6, 200)) * 0.5 / np.sqrt(6.0)
    p = []
    for seed in range(20):
        rng = np.random.default_rng([1, seed])
        off = np.sqrt(2.0 / 3.0) * rng.standard_normal(6) @ patterns + 0.5 / np.sqrt(3.0) * rng.standard_normal(200)
        rows = off + size * rng.standard_normal((3, 1, 200)) + rng.standard_normal((3, 2, 200))
        p.append(lack_of_fit(RotationNull([of_signals(own, ["all"] * 200, patterns) for own in rows])))
    assert sum(one < 0.01 for one in p) >= 19 if size else sum(one < 0.05 for one in p) <= 3


def test_the_smallest_of_several_p_counts_all_that_were_looked_at() -> None:
    """Of one statistic it is its own p; of k independent ones about k times the smallest; copies cost nothing."""
    null = np.random.default_rng(0).standard_normal((4000, 5)) ** 2
    own = monte_carlo_p_value(8.0, null[:, 0])
    assert westfall_young_p_value(np.array([8.0]), null[:, :1]) == pytest.approx(own)
    assert westfall_young_p_value(np.full(3, 8.0), null[:, [0, 0, 0]]) == pytest.approx(own)
    together = westfall_young_p_value(np.array([8.0, 0.1, 0.1, 0.1, 0.1]), null)
    assert together == pytest.approx(1.0 - (1.0 - own) ** 5, rel=0.2)
    silent = westfall_young_p_value(np.array([8.0, 0.0]), np.column_stack((null[:, 0], np.zeros(4000))))
    assert silent == pytest.approx(own)


def test_blocks_flip_their_signs_and_the_null_is_uniform() -> None:
    jacobians = sensitivity(7, 24, 3)
    sources = (AnalyticSource(seed, design=(1,) * 24, repeated=False) for seed in range(NULLS))
    assert_uniform([p_of(SignFlipNull(source.clusters), jacobians) for source in sources])


@pytest.mark.parametrize("seed", range(3))
def test_p_of_blocks_is_the_share_of_all_patterns_of_signs(seed: int) -> None:
    """All 4096 patterns by brute force; three parameters. Kills: scores summed over parameters, not over blocks."""
    blocks = AnalyticSource(seed, design=(1,) * 12, repeated=False).clusters
    jacobians = sensitivity(7, 12, 3)
    scores = np.array([j.T @ item.mean for item, j in zip(blocks, jacobians, strict=True)])
    inverse = np.linalg.inv(sum(j.T @ j for j in jacobians))
    signs = np.array(list(itertools.product((1.0, -1.0), repeat=12)))
    null = np.einsum("ni,ij,nj->n", signs @ scores, inverse, signs @ scores)
    exact = np.mean(null >= null[0] - 1e-9)
    assert p_of(SignFlipNull(blocks), jacobians) == pytest.approx(exact, abs=0.05)  # three errors of 999 drawn ones


def test_covariance_of_repeats_is_that_of_a_weighted_mean() -> None:
    """One parameter that shifts every feature alike: the estimate is the mean over repeats, its variance s^2 / n."""
    source = AnalyticSource(11, design=(400,))
    reference, ones = RotationNull(source.clusters), [np.ones((FEATURES, 1))]
    inverse = np.linalg.inv(information(reference, ones))
    found = reference.covariance(ones, [], inverse)[0, 0]
    means = source.clusters[0].residuals.mean(axis=1)
    assert found == pytest.approx(means.var(ddof=1) / 400, rel=1e-9)


def test_intervals_take_the_quantile_of_the_estimator_that_made_them() -> None:
    def half_width(*errors: float, by_blocks: bool = False) -> float:
        """Of errors by noise, jackknife and simulators, with 12 degrees of freedom of the noise and 6 clusters."""
        problem: Any = SimpleNamespace(
            _standard_errors=lambda change, null: tuple(
                np.array([part]) for part in (*errors, 2.0 if by_blocks else 12.0)
            ),
            candidate=SimpleNamespace(jacobians=[np.ones(1)] * 6),
        )
        null: Any = SimpleNamespace(by_blocks=by_blocks)
        return float(Problem.half_widths(problem, np.zeros(1), null)[0])

    assert half_width(1.0, 0.0, 0.0) == pytest.approx(student.ppf(0.975, 12))
    assert half_width(0.0, 1.0, 0.0) == pytest.approx(student.ppf(0.975, 5))
    assert half_width(0.0, 1.0, 0.0, by_blocks=True) == pytest.approx(student.ppf(0.975, 2))
    assert half_width(0.0, 0.0, 1.0) == pytest.approx(norm.ppf(0.975))
    assert half_width(1.0, 1.0, 1.0) == pytest.approx(np.hypot(student.ppf(0.975, 5), norm.ppf(0.975)))


def test_rarity_counts_the_observation_itself() -> None:
    assert monte_carlo_p_value(5.0, np.arange(9.0)) == pytest.approx(5.0 / 10.0)
    assert monte_carlo_p_value(100.0, np.arange(9.0)) == pytest.approx(1.0 / 10.0)


def test_an_effect_is_seen_although_conditions_disagree_about_its_size() -> None:
    """It is held against the scatter of repeats, not against all that differs: the disagreement is no noise."""
    jacobians, sizes = sensitivity(21, 6, 1), [2.0 + 6.0 * (-1.0) ** number for number in range(6)]
    reference = shifted(AnalyticSource(21, design=(2,) * 6).clusters, jacobians, sizes)
    assert p_of(reference, jacobians) < 0.01


def test_the_freedom_of_every_parameter_is_that_of_the_repeats() -> None:
    reference = RotationNull(AnalyticSource(0, design=(2, 3, 2)).clusters)
    assert reference.freedom == 4
    assert reference.freedoms([], np.eye(2)).tolist() == [4.0, 4.0]


def test_p_is_uniform_where_conditions_are_of_two_layouts() -> None:
    """What the layouts say is added, in the observation as in the null."""
    jacobians = sensitivity(2, 6, 2)
    effects, fits = [], []
    for seed in range(NULLS):
        clusters = AnalyticSource(seed, design=(2, 3) * 3, correlation=correlated()).clusters
        reference = RotationNull([replace(item, layout=f"{n % 2}") for n, item in enumerate(clusters)])
        effects.append(reference.p_value(jacobians))
        fits.append(lack_of_fit(reference))
    assert_uniform(effects, (0.05, 0.3, 0.7))
    assert_uniform(fits, (0.05, 0.3, 0.7))


def test_an_effect_in_one_of_two_layouts_is_seen() -> None:
    jacobians = sensitivity(4, 4, 1)
    for shifted in (0, 1):
        clusters = AnalyticSource(4, design=(3,) * 4).clusters
        reference = RotationNull(
            [
                replace(item, layout=f"{n % 2}", residuals=item.residuals + 2.0 * (n % 2 == shifted) * own[:, 0])
                for n, (item, own) in enumerate(zip(clusters, jacobians, strict=True))
            ]
        )
        assert reference.p_value(jacobians) < 0.01


def in_two_layouts(seed: int, design: tuple[int, ...], **options) -> list:
    """Clusters of which the last has a layout of its own."""
    clusters = AnalyticSource(seed, design=design, **options).clusters
    return [replace(item, layout="free" if item is clusters[-1] else "hit") for item in clusters]


@pytest.mark.parametrize("repeats", [1, 2])
def test_p_is_uniform_where_a_layout_has_hardly_any_repeats(repeats: int) -> None:
    jacobians, levels = sensitivity(1, 4, 2), (0.01, 0.05, 0.3)
    sources = (in_two_layouts(seed, (2, 2, 2, repeats), correlation=correlated()) for seed in range(NULLS))
    scaled = [scaled_by_their_repeats(clusters, jacobians) for clusters in sources]
    assert_uniform([p_of(reference, own) for reference, own in scaled], levels)
    assert_uniform([lack_of_fit(reference) for reference, _ in scaled], levels)


def test_a_condition_of_another_layout_does_not_hide_what_all_show() -> None:
    """By itself a layout with two repeats has Student's t with one degree of freedom."""
    jacobians = sensitivity(4, 5, 1)
    for seed in range(4):
        reference = shifted(in_two_layouts(seed, (2,) * 5, discrepancy=0.3), jacobians, [5.0] * 5)
        assert p_of(reference, jacobians) < 2e-5
        assert lack_of_fit(reference) < 0.005


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_layout_with_hardly_any_repeats_raises_no_alarm_of_simulator_error(repeats: int) -> None:
    jacobians, low = sensitivity(1, 4, 2), np.zeros(2)
    for seed in range(NULLS):
        options = {"correlation": correlated(), "discrepancy": 0.5, "simulator": seed}
        clusters = in_two_layouts(seed, (2, 2, 2, repeats), **options)
        reference, own = scaled_by_their_repeats(clusters, jacobians)
        low += np.array([p_of(reference, own), lack_of_fit(reference)]) < 0.05
    assert np.all(low <= binom.ppf(0.9999, NULLS, 0.05)), low


def test_covariance_adds_up_over_conditions() -> None:
    """The mean over all repeats has the variance sum n_c s_c^2 / n^2, where one repeat has the pooled s^2."""
    source = AnalyticSource(12, design=(5, 1, 2, 3))
    reference, ones = RotationNull(source.clusters), [np.ones((FEATURES, 1))] * 4
    found = reference.covariance(ones, [], np.linalg.inv(information(reference, ones)))[0, 0]
    means = [item.residuals.mean(axis=1) for item in source.clusters if item.count > 1]
    pooled = sum((own.size - 1) * own.var(ddof=1) for own in means) / 7.0
    assert found == pytest.approx((sum(own.size * own.var(ddof=1) for own in means) + pooled) / 11.0**2, rel=1e-9)
