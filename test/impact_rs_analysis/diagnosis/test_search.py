# SPDX-License-Identifier: Apache-2.0
"""The search on a world with a closed form: what is planted is found, what is not there is not."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from analytic_world import (
    EFFECTS,
    FLOOR,
    MISPLACING,
    TIPPING,
    AnalyticSource,
    BeforeTheHit,
    assert_uniform,
    correlated,
    direction,
    effect,
    knowing,
    linearised,
    means_of,
    parameter,
)
from scipy.stats import binom, norm
from scipy.stats import t as student

from impact_rs_analysis.diagnosis.search import effect_selection as search_module
from impact_rs_analysis.diagnosis.search import fit
from impact_rs_analysis.diagnosis.search.candidate import Candidate, Problem, bounded, linearise
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import (
    Evidence,
    Fit,
    chord_method,
    evaluate_at,
    gauss_newton,
    nelder_mead,
    restart_from_afar,
)
from impact_rs_analysis.diagnosis.search.intervals import intervals_of
from impact_rs_analysis.diagnosis.search.model_comparison import encompasses, j_test_p_value, tied
from impact_rs_analysis.diagnosis.search.null_distribution import benjamini_hochberg
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.evidence.cluster import DISCREPANCY_QUANTILE_RATIO, SHARED_DISCREPANCY_SHARE, Added
from impact_rs_sim.robots.robot import Array

FREE = (0, 1)  # clusters in which nothing is hit, where there are any
CONTACT = ("straight", "bent", "payload")


def searched(source: AnalyticSource, *only: str) -> Search:
    return Search([EFFECTS[name] for name in only or CONTACT], Evidence.of(source))


def whole_interval(fitted: Fit) -> tuple[Array, Array]:
    """Ends of the intervals of all parameters."""
    [ends] = intervals_of([(fitted, range(fitted.candidate.point.size))])
    return ends


def chosen_of(search: Search, *names: str) -> Fit:
    """What the search chooses, which are these effects."""
    chosen = search.forward_selection()
    assert chosen is not None and set(chosen.candidate.names) == set(names)
    return chosen


def alternating(size: float) -> tuple[float, ...]:
    """Of every joint, with the other sign from joint to joint."""
    return tuple(size * (-1.0) ** joint for joint in range(7))


def test_nothing_is_found_where_nothing_is_hidden() -> None:
    """At a false-discovery rate of 1 %, 30 campaigns raise three false alarms once in 300 tries."""
    alarms = sum(
        searched(AnalyticSource(seed, correlation=correlated())).forward_selection() is not None for seed in range(30)
    )
    assert alarms <= binom.ppf(0.997, 30, SIGNIFICANCE_LEVEL)


@pytest.mark.parametrize(
    ("name", "values"), [("straight", (0.8,)), ("straight", (30.0,)), ("bent", (2.0,)), ("bent", (9.0,))]
)
def test_a_hidden_effect_is_named_and_estimated_however_strong_it_is(name: str, values: tuple[float, ...]) -> None:
    for seed in range(3):
        search = searched(AnalyticSource(seed, ((name, values),)))
        chosen = chosen_of(search, name)
        assert chosen.estimate[0] == pytest.approx(values[0], abs=0.15)
        before = search.evidence.null.lack_of_fit(means_of(search.evidence.clusters))
        after = chosen.lack_of_fit()
        assert before is not None and after is not None and before < SIGNIFICANCE_LEVEL < after


@pytest.mark.parametrize("beside", [(), ("straight",)])
def test_an_effect_that_does_something_else_than_its_first_step_has_a_small_p(beside: tuple[str, ...]) -> None:
    hidden = (*((name, (5.0,)) for name in beside), ("turning", (30.0,)))
    search = searched(AnalyticSource(1, hidden), *beside, "turning")
    there = [replace(search.screening.singles[name], point=np.array(values)) for name, values in hidden]
    point = functools.reduce(Candidate.joined_with, there)
    found = linearise(point, search.evidence.clusters, search.evidence.numbers, search.source)
    assert found is not None
    chosen = Fit.of(found, search.evidence)
    others = search.without(chosen, "turning") if beside else None
    assert search.screening.p_values_of(["turning"], others)["turning"] > 0.05
    assert search.p_value_of_chosen(chosen, "turning") < 1e-3


@pytest.mark.parametrize("beside", [(), ("straight",)])
def test_an_effect_whose_sensitivities_vanish_at_the_estimate_has_a_small_p(beside: tuple[str, ...]) -> None:
    """Kills sensitivities at the estimate alone: two ends of a diameter, where the tangent is orthogonal to the way."""
    hidden = (*((name, (5.0,)) for name in beside), ("circling", (np.pi,)))
    search = searched(AnalyticSource(2, hidden), *beside, "circling")
    there = [replace(search.screening.singles[name], point=np.array(values)) for name, values in hidden]
    point = functools.reduce(Candidate.joined_with, there)
    evidence = search.evidence
    found = linearise(point, evidence.clusters, evidence.numbers, search.source, central=True)
    assert found is not None
    assert search.p_value_of_chosen(Fit.of(found, evidence), "circling") < 1e-3


@pytest.mark.parametrize("name", ["bent", "circling"])
def test_the_p_value_of_a_fitted_effect_is_not_too_small_where_nothing_is_hidden(name: str) -> None:
    """Its sensitivities are those where the fit of the noise ended."""
    found = []
    for seed in range(100):
        search = searched(AnalyticSource(seed), name)
        fitted = gauss_newton(chord_method(search.screening.singles[name], search.evidence))
        found.append(search.p_value_of_chosen(fitted, name))
    for level in (0.05, 0.3):
        assert np.count_nonzero(np.array(found) < level) <= binom.ppf(1 - 1e-3, len(found), level)


def test_a_shape_that_moves_nothing_while_the_effect_is_off_is_found() -> None:
    """The lever of a payload moves nothing while the payload has no mass."""
    chosen = chosen_of(searched(AnalyticSource(3, (("payload", (4.0, -1.5)),))), "payload")
    np.testing.assert_allclose(chosen.estimate, (4.0, -1.5), atol=0.15)


def test_of_two_like_explanations_the_simpler_is_chosen_and_the_other_ties() -> None:
    search = searched(AnalyticSource(5, (("straight", (5.0,)),)), "straight", "twin_of_straight", "bent")
    rivals = {rival.name: rival for rival in search.rivals(chosen_of(search, "straight"))}
    assert rivals["twin_of_straight"].tied and rivals["twin_of_straight"].instead_of == "straight"
    assert rivals["twin_of_straight"].fit.estimate[0] == pytest.approx(10.0, abs=0.4)
    assert "bent" not in rivals or not rivals["bent"].tied


def test_a_rival_is_fitted_in_the_other_s_place_beside_all_else_found() -> None:
    """Alone the twin would have to explain the bent effect as well; in the other's place it has its own value."""
    truth = (("straight", (5.0,)), ("bent", (6.0,)))
    search = searched(AnalyticSource(6, truth), "straight", "twin_of_straight", "bent")
    rivals = {rival.name: rival for rival in search.rivals(chosen_of(search, "straight", "bent"))}
    rival = rivals["twin_of_straight"]
    assert rival.instead_of == "straight" and set(rival.fit.candidate.names) == {"bent", "twin_of_straight"}
    part = rival.fit.candidate.part("twin_of_straight")
    assert rival.fit.estimate[part][0] == pytest.approx(10.0, abs=0.4)


def test_what_no_effect_explains_leaves_a_lack_of_fit() -> None:
    search = searched(AnalyticSource(6, (("outside", (5.0,)),)))
    chosen = search.forward_selection()
    rest = means_of(search.evidence.clusters) if chosen is None else chosen.residuals
    left = search.evidence.null.lack_of_fit(rest)
    assert left is not None and left < SIGNIFICANCE_LEVEL


def of_scatters(*freedoms: int) -> tuple[float, float]:
    """Coverage and mean half width [standard errors] of the widest of intervals of 95 % from independent scatters.

    Args:
        freedoms: Degrees of freedom of each.
    """
    rng = np.random.default_rng(0)
    half = np.max([student.ppf(0.975, n) * np.sqrt(rng.chisquare(n, 100_000) / n) for n in freedoms], axis=0)
    return float(1.0 - 2.0 * norm.sf(half).mean()), float(half.mean())


def test_intervals_are_as_wide_as_the_larger_of_scatters_and_hold_the_truth_as_often() -> None:
    """Repeats have 12 degrees of freedom, six clusters 5: 98 % and not 95 %, for the larger one counts.

    The standard error of a slope along D_c in 3 repeats each is 1 / sqrt(3 sum D_c^2). Kills: a quantile or a width
    that is off by a fifth, either way.
    """
    sources = [AnalyticSource(seed, (("straight", (2.0,)),)) for seed in range(400)]
    fits = [Fit.of(*linearised(source, EFFECTS["straight"])) for source in sources]
    coverage, width = of_scatters(12, 5)
    assert 0.975 < coverage < 0.985
    inside = sum(low[0] <= 2.0 <= high[0] for low, high in map(whole_interval, fits))
    assert binom.ppf(0.001, 400, coverage) <= inside <= binom.ppf(0.999, 400, coverage) < 400
    error = 1.0 / np.sqrt(3.0 * sum(np.sum(np.square(direction(number, 0))) for number in range(6)))
    assert np.mean([fitted.half_widths[0] for fitted in fits]) == pytest.approx(width * error, rel=0.05)


def test_intervals_are_as_wide_where_noise_is_correlated() -> None:
    """With C' C its covariance and weights W the variance is sum |C W D_c|^2 / (3 (sum D_c' W D_c)^2)."""
    root, directions = correlated(), np.array([direction(number, 0) for number in range(6)])
    sources = [AnalyticSource(seed, (("straight", (2.0,)),), correlation=root) for seed in range(200)]
    fits = [Fit.of(*linearised(source, EFFECTS["straight"])) for source in sources]
    inside = sum(abs(fitted.estimate[0] - 2.0) <= fitted.half_widths[0] for fitted in fits)
    assert inside >= binom.ppf(0.005, 200, 0.95)
    weighted = directions / (np.sum(np.square(root), axis=0) + (FLOOR / 2.0) ** 2)
    error = np.linalg.norm(weighted @ root.T) / np.sqrt(3.0) / np.sum(weighted * directions)
    assert np.mean([fitted.half_widths[0] for fitted in fits]) == pytest.approx(of_scatters(12, 5)[1] * error, rel=0.1)


def test_intervals_allow_for_simulator_error_and_hold_the_truth_then() -> None:
    """An error of 1 in every feature, shared in part: 1.96 sqrt(s |sum D_c|^2 + (1 - s) sum D_c^2) / sum D_c^2.

    The clusters scatter by it, too: by 1 + 1/3 in place of the 1/3 of the noise. So it is counted twice.
    """
    truth, directions = (("straight", (2.0,)),), np.array([direction(number, 0) for number in range(6)])
    fits = [
        Fit.of(*linearised(AnalyticSource(seed, truth, discrepancy=1.0, simulator=seed), EFFECTS["straight"]))
        for seed in range(100)
    ]
    assert binom.ppf(0.005, 100, 0.95) <= sum(abs(one.estimate[0] - 2.0) <= one.half_widths[0] for one in fits)
    squares = np.sum(np.square(directions))
    alike = np.sum(np.square(directions.sum(axis=0)))
    scores = SHARED_DISCREPANCY_SHARE * alike + (1.0 - SHARED_DISCREPANCY_SHARE) * squares
    systematic = 1.96 * DISCREPANCY_QUANTILE_RATIO * np.sqrt(scores) / squares
    scatter = of_scatters(5)[1] * np.sqrt(4.0 / 3.0 / squares)
    assert np.mean([one.half_widths[0] for one in fits]) == pytest.approx(np.hypot(systematic, scatter), rel=0.1)


def test_the_interval_of_a_delay_is_no_narrower_than_the_clocks_may_be_off() -> None:
    source = AnalyticSource(3, (("inverse", (0.7,)),))
    start, evidence = linearised(source, EFFECTS["inverse"])
    late = replace(start, scalars=tuple(replace(scalar, unit="s") for scalar in start.scalars))
    alone = Fit.of(late, evidence).half_widths
    source.clock = 0.4  # of commands
    both, without_time = Fit.of(late, evidence).half_widths, Fit.of(start, evidence).half_widths
    np.testing.assert_allclose(both**2 - alone**2, (0.95 * 0.4 / late.scale) ** 2)
    np.testing.assert_array_equal(without_time, alone)


def test_an_interval_knows_what_a_calibration_does_to_all_conditions() -> None:
    start, evidence = linearised(AnalyticSource(3, (("straight", (2.0,)),)), EFFECTS["straight"])
    alone = Fit.of(start, evidence).half_widths
    clock = np.full(start.point.size, 0.3)  # parameter scales that it looks like
    both = Fit.of(start, with_calibration(evidence, start, clock, 3.0)).half_widths
    np.testing.assert_allclose(np.sqrt(both**2 - alone**2), 1.96 * clock, rtol=1e-3)
    itself = Fit.of(start, with_calibration(evidence, start, clock, 0.0)).half_widths
    np.testing.assert_array_equal(itself, alone)  # what an effect stands for is fitted


def with_calibration(evidence: Evidence, start: Candidate, looks_like: np.ndarray, aside: float) -> Evidence:
    """A calibration that looks like a change of the parameters, and changes ``aside`` besides what they do not."""
    every = np.vstack(start.jacobians)
    other = np.random.default_rng(1).standard_normal(len(every))
    other -= every @ np.linalg.lstsq(every, other, rcond=None)[0]
    rows = np.split(every @ looks_like + aside * other, len(evidence.clusters))
    clusters = (replace(item, calibrations=row[None, :]) for item, row in zip(evidence.clusters, rows, strict=True))
    return replace(evidence, clusters=tuple(clusters))


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("sizes_and_rate", (30.0, 20.0, 40.0, 25.0, 4.0)),  # a size with another rate explains half of it
        ("rippled", (9.0,)),  # the slope at a point has nothing to do with that of the valley
        ("bent", (9.0,)),
    ],
)
def test_a_fit_ends_no_worse_than_at_the_truth(name: str, truth: tuple[float, ...]) -> None:
    for seed in range(3):
        start, evidence = linearised(AnalyticSource(seed, ((name, truth),)), EFFECTS[name])
        fitted = gauss_newton(chord_method(start, evidence))
        there = evaluate_at(start, np.array(truth), evidence)
        assert there is not None
        at_truth = float(np.mean(evidence.problem(there).errors(np.zeros(len(truth)))))
        assert fitted.misfit < 1.02 * at_truth


def test_leaving_a_cluster_out_uses_all_others_but_its_guard() -> None:
    source = AnalyticSource(8, (("straight", (2.0,)),))
    candidate = searched(source).screening.singles["straight"]
    guard = [tuple(n for n in (c - 1, c + 1) if 0 <= n < 6) for c in range(6)]
    for neighbours in (None, guard):
        problem = Problem(candidate, source.clusters, neighbours)
        for number in range(6):
            out = {number, *(() if neighbours is None else neighbours[number])}
            kept = [index for index in range(6) if index not in out]
            direct = Problem(candidate.only(kept), [source.clusters[index] for index in kept]).solve()
            np.testing.assert_allclose(problem.leave_one_out_changes[number], direct, rtol=1e-9)


def test_a_scale_larger_than_the_noise_does_not_make_the_prior_strong() -> None:
    """Two parameters that act nearly alike, on residuals whose scale is 50 times their noise."""
    source = AnalyticSource(4, (("of_joints", (2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0)),))
    single = searched(source, "of_joints").screening.singles["of_joints"]
    shrunk = tuple(
        replace(item, residuals=item.residuals / 50.0, sigma=50.0 * item.sigma, pure_error=item.pure_error / 50.0)
        for item in source.clusters
    )

    def alike(jacobian: Array) -> Array:
        return np.column_stack((jacobian[:, 0], jacobian[:, 0] + 0.1 * jacobian[:, 1], jacobian[:, 2:]))

    fits = []
    for clusters, factor in ((source.clusters, 1.0), (shrunk, 50.0)):
        candidate = replace(single, jacobians=tuple(alike(jacobian) / factor for jacobian in single.jacobians))
        fits.append(Problem(candidate, clusters, noise_unknown=True).solve())
    np.testing.assert_allclose(fits[1][:2], fits[0][:2], atol=0.1)
    assert fits[0][1] == pytest.approx(30.0, abs=2.0)


@pytest.mark.parametrize(("sensitivity", "held"), [(1.0, True), (1e-4, False)])
def test_a_parameter_that_the_data_leave_open_is_not_held_at_a_bound(sensitivity: float, held: bool) -> None:
    source = AnalyticSource(4, (("straight", (80.0,)),))
    search = searched(source, "straight")
    single = search.screening.singles["straight"]
    faint = replace(single, jacobians=tuple(sensitivity * jacobian for jacobian in single.jacobians))
    fitted = Fit.of(faint, search.evidence)
    fitted = replace(fitted, change=(single.upper - single.point) / single.scale)
    assert fitted.at_bound.tolist() == [True]
    assert fitted.pushed_to_bound.tolist() == [held]


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    """Clusters that say the same amount: the estimate is their mean, its standard error s / sqrt(c) (Tukey 1958)."""
    source = AnalyticSource(12)
    ones = tuple(np.ones((item.sigma.size, 1)) for item in source.clusters)
    problem = Problem(replace(searched(source).screening.singles["straight"], jacobians=ones), source.clusters)
    means = np.array([item.mean.mean() for item in source.clusters])
    assert problem.solve()[0] == pytest.approx(means.mean(), rel=1e-5)
    assert problem.jackknife_standard_errors()[0] == pytest.approx(means.std(ddof=1) / np.sqrt(6), rel=1e-4)


def test_errors_of_a_change_are_those_of_the_residuals_it_leaves() -> None:
    source = AnalyticSource(9, (("of_joints", tuple(range(7))),))
    problem = Problem(searched(source, "of_joints").screening.singles["of_joints"], source.clusters)
    change = problem.solve()
    direct = [np.mean(np.square(rest)) for rest in problem.residuals_at(change)]
    np.testing.assert_allclose(problem.errors(change), direct, rtol=1e-9)


def test_the_error_that_accepts_a_step_is_the_one_that_the_step_makes_least() -> None:
    """Kills: a mean over conditions, in which one of twelve repeats counts as much as one of two."""
    source = AnalyticSource(4, (("straight", (1.0,)),), design=(2, 2, 2, 12))
    source.spoil(3, 2.0 * direction(3, 0))
    problem = Problem(searched(source, "straight").screening.singles["straight"], source.clusters)
    best = problem.solve()
    for off in (-0.05, 0.05):
        assert problem.error(best + off) > problem.error(best)
    squares = sum(c.count * float(r @ r) for c, r in zip(source.clusters, problem.residuals_at(best), strict=True))
    assert problem.error(best) == pytest.approx(squares / sum(c.residuals.size for c in source.clusters))


@pytest.mark.parametrize(("point", "step"), [(50.0, -3.0), (-50.0, 3.0)])
def test_a_point_outside_its_bounds_comes_back_by_the_trusted_step(point: float, step: float) -> None:
    source = AnalyticSource(9, (("of_joints", tuple(range(7))),))
    single = searched(source, "of_joints").screening.singles["of_joints"]
    away = replace(single, point=single.nominal + point * single.scale, lower=single.nominal - single.scale,
                   upper=single.nominal + single.scale)  # fmt: skip
    np.testing.assert_allclose(Problem(away, source.clusters).solve(radius=3.0), step)


def test_bounds_hold_and_the_optimum_obeys_kuhn_and_tucker() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        root = rng.standard_normal((6, 4))
        matrix, score = root.T @ root + 0.1 * np.eye(4), rng.standard_normal(4) * 3.0
        lower, upper = -rng.uniform(0.0, 0.5, 4), rng.uniform(0.0, 0.5, 4)
        change = bounded(matrix, score, lower, upper)
        slope = score - matrix @ change
        assert np.all(change >= lower - 1e-9) and np.all(change <= upper + 1e-9)
        inside = (change > lower + 1e-6) & (change < upper - 1e-6)
        np.testing.assert_allclose(slope[inside], 0.0, atol=1e-6)
        assert np.all(slope[change <= lower + 1e-6] <= 1e-6) and np.all(slope[change >= upper - 1e-6] >= -1e-6)


@pytest.mark.parametrize("size", [1, 3, 12])
def test_several_bounded_problems_end_where_each_of_them_does_alone(size: int) -> None:
    """Also ill-conditioned ones; beside an independent method (bounded-variable least squares of SciPy)."""
    rng = np.random.default_rng(size)
    roots = rng.standard_normal((40, size + 1, size)) * np.logspace(0, -2, size)
    matrices = np.swapaxes(roots, 1, 2) @ roots + 1e-6 * np.eye(size)
    scores = rng.standard_normal((40, size)) * 3.0
    lower, upper = -rng.uniform(0.0, 0.5, size), rng.uniform(0.0, 0.5, size)
    together = bounded(matrices, scores, lower, upper)
    for matrix, score, found in zip(matrices, scores, together, strict=True):
        np.testing.assert_allclose(bounded(matrix, score, lower, upper), found, atol=1e-12)
        root = np.linalg.cholesky(matrix).T
        target = np.linalg.solve(root.T, score)
        other = scipy.optimize.lsq_linear(root, target, bounds=(lower, upper), method="bvls", tol=1e-14).x

        def cost(point: np.ndarray, matrix: np.ndarray = matrix, score: np.ndarray = score) -> float:
            return float(0.5 * point @ matrix @ point - score @ point)

        assert cost(found) <= cost(other) + 1e-9


def test_a_bound_of_physics_is_not_passed() -> None:
    search = searched(AnalyticSource(10, (("one_sided", (-3.0,)),)), "one_sided")
    fitted = chord_method(search.screening.singles["one_sided"], search.evidence)
    assert fitted.estimate[0] == pytest.approx(0.0, abs=1e-12)
    assert whole_interval(fitted)[0][0] == 0.0


@pytest.mark.parametrize("hidden", [-170.0, 170.0, 700.0])
def test_a_fit_goes_on_beyond_the_range_of_a_parameter_that_is_not_one_of_physics(hidden: float) -> None:
    search = searched(AnalyticSource(10, (("straight", (hidden,)),)), "straight")
    fitted = chord_method(search.screening.singles["straight"], search.evidence)
    assert fitted.estimate[0] == pytest.approx(hidden, abs=0.5) and not fitted.at_bound.any()


def test_the_range_of_a_search_does_not_cut_an_interval_off() -> None:
    """Just below the end of the range it is as long to either side."""
    search = searched(AnalyticSource(10, (("straight", (49.95,)),)), "straight")
    fitted = chord_method(search.screening.singles["straight"], search.evidence)
    low, high = (float(end[0]) for end in whole_interval(fitted))
    assert fitted.estimate[0] < fitted.candidate.upper[0] == 50.0 < high
    assert high - fitted.estimate[0] == pytest.approx(fitted.estimate[0] - low, rel=1e-6)


@pytest.mark.parametrize("hidden", [3.0, 30.0])
def test_a_fit_whose_steps_get_short_looks_at_its_sensitivities_again(hidden: float) -> None:
    """A damping is an eighth as sensitive at 30 as at 0: steps by the latter end at three quarters of the way."""
    search = searched(AnalyticSource(10, (("saturated", (hidden,)),)), "saturated")
    fitted = chord_method(search.screening.singles["saturated"], search.evidence)
    assert fitted.estimate[0] == pytest.approx(hidden, rel=0.05)


def test_a_range_is_widened_four_times_and_then_said_to_be_reached() -> None:
    search = searched(AnalyticSource(10, (("straight", (5000.0,)),)), "straight")
    fitted = chord_method(search.screening.singles["straight"], search.evidence)
    assert fitted.estimate[0] == 16.0 * 50.0 and fitted.at_bound.all()


@pytest.mark.parametrize("hidden", [-12.0, 15.0])
def test_what_changes_nothing_near_its_nominal_value_is_seen_from_afar(hidden: float) -> None:
    """As a contact that sticks does until its friction is a fraction of what was assumed."""
    search = searched(AnalyticSource(4, (("sticking", (hidden,)),)), "sticking", "bent")
    assert not search.screening.unmeasured and search.screening.p_values(None)["sticking"] < SIGNIFICANCE_LEVEL
    found = search.forward_selection()
    assert found is not None and found.candidate.names == ("sticking",)
    assert found.estimate[0] == pytest.approx(hidden, abs=0.5)


def test_what_changes_nothing_anywhere_is_not_measured() -> None:
    nothing = effect("without_influence", (parameter("z"),))
    search = Search([nothing, EFFECTS["bent"]], Evidence.of(AnalyticSource(4)))
    assert search.screening.unmeasured == {"without_influence"}


@pytest.mark.parametrize("world", [functools.partial(AnalyticSource, free=FREE), BeforeTheHit])
def test_absent_effects_of_the_joints_are_ruled_out_by_free_motion(world: Callable[[int], AnalyticSource]) -> None:
    """At p = 0.1, nine of ten; each keeps its sensitivities, by which its size is bounded."""
    ruled_out = 0
    for seed in range(10):
        search = searched(world(seed), "bent", "of_joints")
        assert search.screening.ruled_out <= {"of_joints"}
        assert set(search.screening.p_values(None)) == {"bent", "of_joints"}
        ruled_out += bool(search.screening.ruled_out)
    assert ruled_out >= 6


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_an_effect_of_the_joints_is_found_beside_one_of_the_contact(size: float) -> None:
    truth = (("of_joints", alternating(size)), ("bent", (5.0,)))
    search = searched(AnalyticSource(2, truth, free=FREE), "bent", "of_joints")
    assert not search.screening.ruled_out
    chosen_of(search, "bent", "of_joints")


def test_a_fit_goes_where_free_motion_puts_a_parameter_that_misplaces_the_impact() -> None:
    """By sensitivities at nominal the contact asks for -2.3; what follows from there ends at a small minimum."""
    search = Search([MISPLACING], Evidence.of(BeforeTheHit(1, (("misplacing", (15.0,)),))))
    fitted = chord_method(search.screening.singles["misplacing"], search.evidence)
    assert fitted.estimate[0] == pytest.approx(15.0, abs=0.2)


def test_free_motion_asks_for_no_step_of_what_it_leaves_open() -> None:
    """Of seven joints one is off; by chance (5 % each) another one moves."""
    truth = (("of_joints", (0.0, 0.0, 30.0, 0.0, 0.0, 0.0, 0.0)),)
    search = searched(BeforeTheHit(2, truth), "of_joints")
    step = Fit.of(search.screening.singles["of_joints"], search.evidence).step_by_free_motion
    assert step[2] == pytest.approx(30.0, abs=1.5) and np.count_nonzero(step) <= 2
    search = searched(AnalyticSource(2, truth), "of_joints")
    assert not np.any(Fit.of(search.screening.singles["of_joints"], search.evidence).step_by_free_motion)


@pytest.mark.parametrize("rate", [0.15, 6.0, 20.0])
def test_a_shape_far_from_its_start_is_found(rate: float) -> None:
    """A rate up to twenty times its start, which no linear step leads to."""
    search = searched(BeforeTheHit(1, (("fading", (12.0, rate)),)), "bent", "fading")
    np.testing.assert_allclose(chosen_of(search, "fading").estimate, (12.0, rate), rtol=0.15)


@pytest.mark.parametrize(("force", "friction", "fade"), [(10.0, 15.0, 3.0), (20.0, 8.0, 0.3), (40.0, 8.0, 1.0)])
def test_fading_dry_friction_is_found_beside_the_force_against_it(force: float, friction: float, fade: float) -> None:
    """By itself friction explains motion without a drive; from there no step leads to the truth."""
    source = BeforeTheHit(1, (("straight", (force,)), ("dry", (friction, fade))))
    chosen = chosen_of(searched(source, "straight", "dry", "bent"), "straight", "dry")
    assert chosen.candidate.names == ("straight", "dry")
    np.testing.assert_allclose(chosen.estimate, (force, friction, fade), rtol=0.1)


def test_what_is_there_before_a_hit_is_found_in_all_that_was_measured() -> None:
    search = searched(BeforeTheHit(2, (("of_joints", alternating(0.6)),)), "bent", "of_joints")
    assert not search.screening.ruled_out
    np.testing.assert_allclose(chosen_of(search, "of_joints").estimate, alternating(0.6), atol=0.3)


def test_p_of_nothing_is_uniform_beside_an_effect_that_looks_like_it() -> None:
    """Half of what the second moves is the first's; counted over 150 nulls."""
    found = []
    for seed in range(150):
        source = AnalyticSource(seed, (("straight", (3.0,)),), correlation=correlated())
        search = searched(source, "straight", "one_sided")
        chosen = Fit.of(search.screening.singles["straight"], search.evidence)
        own = search.screening.singles["one_sided"]
        alike = tuple(a + 2.0 * b for a, b in zip(own.jacobians, chosen.candidate.jacobians, strict=True))
        joined = search.evidence.problem(chosen.candidate.joined_with(replace(own, jacobians=alike)))
        found.append(joined.p_value(chosen.residual_evidence.null, [1]))
    assert_uniform(found)


def test_p_is_adjusted_for_every_effect_that_was_looked_at() -> None:
    """Benjamini and Hochberg by hand: sorted p times n over rank, made monotone from the largest down."""
    raw = {"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.5}
    found = benjamini_hochberg(raw)
    assert found["a"] == pytest.approx(0.04)
    assert found["c"] == pytest.approx(min(0.03 * 4 / 2, 0.04 * 4 / 3))
    assert found["b"] == pytest.approx(0.04 * 4 / 3)
    assert found["d"] == pytest.approx(0.5)


def test_a_fit_ties_with_itself_and_not_with_one_that_is_twice_as_wrong() -> None:
    source = AnalyticSource(11, (("straight", (6.0,)), ("bent", (6.0,))))
    search = searched(source)
    both = chosen_of(search, "straight", "bent")
    assert tied(both, both)
    assert not tied(both, Fit.of(search.screening.singles["bent"], search.evidence))


ALIKE = [("bent", "nearly_bent"), ("nearly_bent", "bent")]


def test_an_effect_in_whose_place_another_predicts_far_better_is_replaced() -> None:
    """One that was chosen before the others were known, as Coulomb friction where Stribeck and viscous friction act."""
    planted = (("straight", (5.0,)), ("bent", (5.0,)))
    for seed in range(3):
        search = searched(AnalyticSource(seed, planted), "straight", "bent", "one_sided", "turning")
        wrong = search.fitted(("bent", "turning"))
        assert wrong is not None
        found, rivals = search.exchange(wrong)
        assert set(found.candidate.names) == {"straight", "bent"} and found.score < 0.5 * wrong.score
        assert not any(rival.fit.score < found.score for rival in rivals)


def test_an_effect_whose_linear_fit_predicts_badly_is_fitted_if_it_is_the_likeliest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Kills: a shortlist by the errors of linear fits alone."""
    monkeypatch.setattr(search_module, "SHORTLIST_SIZE", 1)
    for seed in range(3):
        search = searched(AnalyticSource(seed, (("levelling", (4.0,)),)), "levelling", "nearly_levelling")
        assert (
            search.screening.linear_fit_with(None, "nearly_levelling").score
            < search.screening.linear_fit_with(None, "levelling").score
        )
        monkeypatch.setattr(search.screening, "p_values", lambda _: {"levelling": 1e-6, "nearly_levelling": 1e-4})
        assert chosen_of(search, "levelling").estimate[0] == pytest.approx(4.0, abs=0.15)


def test_an_effect_that_another_one_makes_redundant_is_left_out() -> None:
    """Kills: the superfluous is kept."""
    search = searched(AnalyticSource(1, (("straight", (5.0,)),)))
    both = search.fitted(("straight", "bent"))
    assert both is not None
    assert search._backward_elimination(both).candidate.names == ("straight",)


@pytest.mark.parametrize(("size", "found"), [(0.12, ("straight",)), (0.4, ("straight", "bent"))])
def test_an_effect_is_added_where_it_lowers_the_error_by_a_tenth(size: float, found: tuple[str, ...]) -> None:
    """Both are significant beside a rest of 5: 7 % and 20 % of it. Kills: the gain is not asked."""
    truth = (("straight", (30.0,)), ("bent", (size,)), ("outside", (5.0,)))
    search = searched(AnalyticSource(1, truth), "straight", "bent")
    assert search.screening.p_values(search.fitted(("straight",)))["bent"] < SIGNIFICANCE_LEVEL
    chosen_of(search, *found)


@pytest.mark.parametrize(("p", "accepted"), [(0.0095, True), (0.0105, False)])
def test_an_effect_is_added_where_it_is_significant(p: float, accepted: bool) -> None:
    """It passes every other gate. Kills: p not asked."""
    truth = (("straight", (30.0,)), ("bent", (0.4,)), ("outside", (5.0,)))
    search = searched(AnalyticSource(1, truth), "straight", "bent")
    found = search._next(search.fitted(("straight",)), ["bent"], {"bent": p})
    assert (found is not None) == accepted


def test_what_is_below_the_relevance_limits_is_not_added_where_only_noise_is_left() -> None:
    """Twenty repeats see 0.08 of the noise. Kills: relevance is not asked."""
    search = searched(AnalyticSource(1, (("straight", (0.08,)),), (20,) * 6))
    assert not search.has_lack_of_fit and search.screening.p_values(None)["straight"] < SIGNIFICANCE_LEVEL
    assert search.forward_selection() is None


def test_an_effect_that_cannot_be_simulated_is_listed() -> None:
    """Kills an effect that is in no table and in no note, because one replay with it has no impact."""

    class Missing(AnalyticSource):
        def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
            found = super().predict(wanted, what)
            gone = [number == 2 and "bent" in dict(added) for number, added in wanted]
            return [None if lost else values for lost, values in zip(gone, found, strict=True)]

    screening = searched(Missing(1), "straight", "bent").screening
    assert screening.not_simulated == {"bent"} and set(screening.singles) == {"straight"}


def test_a_parameter_without_influence_stays_where_it_is() -> None:
    """As the friction of a contact that sticks. Kills: the prior alone takes it to where the contact slips."""
    single = replace(searched(AnalyticSource(3), "straight").screening.singles["straight"], point=np.array([4.0]))
    blind = replace(single, jacobians=tuple(np.zeros_like(jacobian) for jacobian in single.jacobians))
    problem = Problem(blind, AnalyticSource(3).clusters)
    assert problem.solve() == 0.0 and np.all(problem.leave_one_out_changes == 0.0)


def test_the_last_correction_of_a_fit_is_taken_where_a_simulation_confirms_it() -> None:
    """From 1 a straight step along 1 / x leads to where the error is larger. Kills: it is taken always."""
    bent, straight = (
        Fit.of(*linearised(AnalyticSource(3, ((name, (value,)),)), EFFECTS[name]))
        for name, value in (("inverse", 0.45), ("straight", 5.0))
    )
    assert fit._confirmed_by_simulation(straight) is straight
    assert bent.estimate[0] != 1.0 and fit._confirmed_by_simulation(bent).estimate[0] == 1.0


def test_an_error_below_what_noise_leaves_is_no_excess() -> None:
    evidence = Evidence.of(AnalyticSource(1))
    nothing = [np.zeros_like(item.sigma) for item in evidence.clusters]
    assert evidence.excess(nothing) == pytest.approx(0.0)


def test_an_effect_in_the_limit_in_which_it_is_a_simpler_one_is_no_rival_of_it() -> None:
    """What fades is constant at its lowest rate, and predicts as well. Kills: the limit is not asked."""
    search = searched(AnalyticSource(1, (("constant", (5.0,)),)), "constant", "fading")
    chosen = fit_alone(search, "constant")
    (rival,) = search.rivals(chosen, max_score_ratio=np.inf)  # fading as it starts is
    assert rival.name == "fading" and rival.fit.estimate[1] == pytest.approx(0.01)
    assert tied(chosen, rival.fit) and not rival.tied


def both_of(seed: int, truth: str, wrong: str, discrepancy: float = 0.0) -> tuple[Fit, Fit]:
    """Fits of the true effect and of a wrong one, each alone."""
    search = searched(AnalyticSource(seed, ((truth, (6.0,)),), (2,) * 5, discrepancy=discrepancy), truth, wrong)
    return fit_alone(search, truth), fit_alone(search, wrong)


def fit_alone(search: Search, name: str) -> Fit:
    return gauss_newton(chord_method(search.screening.singles[name], search.evidence))


@pytest.mark.parametrize(("truth", "wrong"), ALIKE)
def test_repeats_decide_between_effects_whose_errors_are_hardly_different(truth: str, wrong: str) -> None:
    """The right one encompasses the other in nearly all of 40 campaigns, the wrong one in none."""
    fits = [both_of(seed, truth, wrong) for seed in range(40)]
    assert np.mean([tied(right, other) for right, other in fits]) > 0.5
    assert np.mean([encompasses(right, truth, other, wrong) for right, other in fits]) > 0.8
    assert not any(encompasses(other, wrong, right, truth) for right, other in fits)


def test_a_rival_that_repeats_exclude_is_none_although_it_predicts_as_well() -> None:
    """Kills: a rival is tied by its error alone."""
    found = []
    for seed in range(8):
        search = searched(AnalyticSource(seed, (("bent", (6.0,)),), (2,) * 5), "bent", "nearly_bent")
        chosen = fit_alone(search, "bent")
        found += [(tied(chosen, rival.fit), rival.tied) for rival in search.rivals(chosen, max_score_ratio=np.inf)]
    alike, rivals = np.mean(found, axis=0)
    assert alike > 0.5 and rivals < 0.3


@pytest.mark.parametrize(("truth", "wrong"), [("bent", "nearly_bent"), ("straight", "more_than_straight")])
def test_a_wrong_effect_is_as_seldom_significant_beside_the_right_one_as_stated(truth: str, wrong: str) -> None:
    """Also one with five parameters more, whose predictions differ by the noise alone."""
    fits = [both_of(seed, truth, wrong) for seed in range(100)]
    found = np.array([j_test_p_value(other, wrong, right) for right, other in fits])
    for level in (0.05, 0.3):
        assert np.count_nonzero(found < level) <= binom.ppf(1 - 1e-3, len(found), level)


def test_of_two_effects_that_explain_a_part_each_none_encompasses_the_other() -> None:
    search = searched(AnalyticSource(3, (("straight", (0.8,)), ("bent", (0.8,))), (2,) * 5), "straight", "bent")
    straight, bent = fit_alone(search, "straight"), fit_alone(search, "bent")
    assert j_test_p_value(straight, "straight", bent) < SIGNIFICANCE_LEVEL
    assert j_test_p_value(bent, "bent", straight) < SIGNIFICANCE_LEVEL
    assert not encompasses(straight, "straight", bent, "bent") and not encompasses(bent, "bent", straight, "straight")


def test_a_difference_within_simulator_error_decides_nothing() -> None:
    """In all of them without it."""
    fits = [both_of(seed, "bent", "nearly_bent", discrepancy=4.0) for seed in range(20)]
    assert np.mean([encompasses(right, "bent", other, "nearly_bent") for right, other in fits]) <= 0.1


@pytest.mark.parametrize("first", [3.0, 45.0])
def test_a_second_effect_is_found_however_large_the_first_one_is(first: float) -> None:
    """What is left counts by itself and not as a share: 1.5 times the noise beside 45 times is one part in 900."""
    chosen_of(searched(AnalyticSource(4, (("straight", (first,)), ("bent", (1.5,))))), "straight", "bent")


@pytest.mark.parametrize("hidden", [0.3, 0.416, 0.7, 2.5])
def test_what_goes_with_the_inverse_of_a_parameter_is_fitted(hidden: float) -> None:
    """As deflection goes with stiffness: from 1 a straight step leads far beyond, or not nearly far enough."""
    start, evidence = linearised(AnalyticSource(3, (("inverse", (hidden,)),)), EFFECTS["inverse"])
    fitted = gauss_newton(chord_method(start, evidence))
    assert fitted.estimate[0] == pytest.approx(hidden, rel=0.01)


@pytest.mark.parametrize("height", [-9.0, 12.0])
def test_what_changes_only_beyond_some_value_is_looked_for_on_both_sides(height: float) -> None:
    start, evidence = linearised(AnalyticSource(3, (("tipping", (2.0, height)),)), TIPPING)
    stuck = chord_method(start, evidence)
    assert abs(stuck.estimate[1] - height) > 3.0
    np.testing.assert_allclose(restart_from_afar(stuck).estimate, (2.0, height), atol=0.3)
    found = Search([TIPPING, EFFECTS["straight"]], evidence).forward_selection()
    assert found is not None
    np.testing.assert_allclose(found.estimate, (2.0, height), atol=0.3)


def test_a_fit_that_fits_looks_nowhere_else() -> None:
    source = AnalyticSource(3, (("tipping", (2.0, 0.0)),))
    fitted = chord_method(*linearised(source, TIPPING))
    source.asked.clear()
    assert restart_from_afar(fitted) is fitted
    assert not source.asked


def test_a_valley_whose_start_has_no_answer_any_more_keeps_its_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the point that was solved, by rounding, an impact may have no answer; SciPy refuses to begin there."""
    one = np.ones(1)
    candidate = SimpleNamespace(lower=-one, upper=one, scale=one, point=0.0 * one)
    fitted = SimpleNamespace(candidate=candidate, evidence=SimpleNamespace(clusters=[SimpleNamespace(sigma=one)]))
    monkeypatch.setattr(fit, "evaluate_at", lambda *_: None)
    assert fit._valley_minimum(fitted) is fitted  # type: ignore[arg-type, comparison-overlap]


def test_a_fit_leaves_a_small_minimum_that_slips_have_made() -> None:
    truth = (5.9, -3.4, 1.7)
    source = AnalyticSource(9, (("stick_slip", truth),))
    evidence = Evidence.of(source)
    start = Search([EFFECTS["stick_slip"]], evidence).screening.singles["stick_slip"]
    stuck = gauss_newton(chord_method(start, evidence))
    assert stuck.exceeds_noise and np.any(np.abs(stuck.estimate - truth) > 0.2)
    free = nelder_mead(stuck)
    assert not free.exceeds_noise and np.all(np.abs(free.estimate - truth) < 0.1)
    found = Search([EFFECTS["stick_slip"]], evidence).forward_selection()
    assert found is not None and np.all(np.abs(found.estimate - truth) < 0.1)


def test_a_fit_begins_at_the_estimates_of_an_earlier_model_where_it_is_stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the simplex, which would find out as well; what the earlier model does not have is no start."""
    truth = np.array((5.9, -3.4, 1.7))
    evidence = Evidence.of(AnalyticSource(9, (("stick_slip", tuple(truth)),)))
    monkeypatch.setattr("impact_rs_analysis.diagnosis.search.effect_selection.nelder_mead", lambda fitted: fitted)
    start = Search([EFFECTS["stick_slip"]], evidence).screening.singles["stick_slip"]
    stuck = gauss_newton(chord_method(start, evidence))
    near = tuple((truth + 0.05).tolist())
    for name, free in (("stick_slip", True), ("straight", False)):
        found = Search([EFFECTS["stick_slip"]], evidence, earlier=((name, near),))._out_of_local_minima(stuck)
        assert bool(np.all(np.abs(found.estimate - truth) < 0.1)) == free


def test_central_differences_over_whole_steps_have_no_bias_of_curvature() -> None:
    """20 tanh(b / 6) d1 + 0.05 b^2 d2. Kills a central difference over one step in the place of two."""
    source = AnalyticSource(0, (("bent", (6.0,)),))
    start, evidence = linearised(source, EFFECTS["bent"])
    point = replace(start, point=np.array([6.0]))
    exact = np.concatenate(
        [
            (20.0 / 6.0 / np.cosh(1.0) ** 2 * direction(n, 1) + 0.6 * direction(n, 2)) / item.sigma
            for n, item in enumerate(evidence.clusters)
        ]
    )
    far = []
    for central in (False, True):
        found = linearise(point, evidence.clusters, evidence.numbers, source, central=central)
        assert found is not None
        far.append(float(np.linalg.norm(np.concatenate(found.jacobians)[:, 0] - exact)))
    assert far[1] < 0.1 * far[0]


def test_a_descent_that_stalls_between_ripples_goes_on_as_a_simplex(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes over a step say nothing of the valley there. Kills a final fit that stays where its descent stalls."""
    source = AnalyticSource(4, (("stick_slip", (9.0, -6.0, 4.0)),))
    errors = []
    for simplex in (lambda fitted: fitted, nelder_mead):
        monkeypatch.setattr(search_module, "nelder_mead", simplex)
        found = Search([EFFECTS["stick_slip"]], Evidence.of(source)).forward_selection()
        assert found is not None
        errors.append(found.misfit)
    assert errors[1] < 0.99 * errors[0]


@pytest.mark.parametrize("size", [5.0, 8.0])
def test_the_likeliest_effect_is_fitted_although_its_linear_fit_predicts_worse(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a pad far off its place, next to a tracked point. Kills a first shortlist by linear fits alone."""
    monkeypatch.setattr(search_module, "SHORTLIST_SIZE", 1)
    monkeypatch.setattr(search_module, "MAX_EFFECTS", 1)  # else a second effect replaces the first
    names = ("levelling", "nearly_levelling")
    source = knowing(AnalyticSource(3, (("levelling", (size,)),)), *(EFFECTS[name] for name in names))
    search = Search([EFFECTS[name] for name in names], Evidence.of(source))
    assert (
        search.screening.linear_fit_with(None, "levelling").score
        > search.screening.linear_fit_with(None, "nearly_levelling").score
    )
    chosen = search.forward_selection()
    assert chosen is not None and chosen.candidate.names == ("levelling",)
    assert chosen.estimate[0] == pytest.approx(size, abs=0.2)


def test_one_effect_takes_the_place_of_two_that_imitate_it() -> None:
    """As a payload in the place of two torque offsets. Kills an exchange that swaps one effect and keeps the other."""
    names = ("straight", "askew", "straight_and_askew")
    source = knowing(AnalyticSource(3, (("straight_and_askew", (6.0,)),)), *(EFFECTS[name] for name in names))
    search = Search([EFFECTS[name] for name in names], Evidence.of(source))
    two = search.fitted(("straight", "askew"))
    assert two is not None
    chosen, _ = search.exchange(two)
    assert chosen.candidate.names == ("straight_and_askew",)
    assert chosen.estimate[0] == pytest.approx(6.0, abs=0.3)


FADING_QUICKLY = (("constant", (5.0,)), ("straight", (4.0,)), ("fading", (3.0, 10.0)))


def with_shapes_of_fading(*chosen: str) -> tuple[Search, Fit]:
    """A search with the grid points of the fading effect, and the linear fit of some other effects."""
    search = searched(AnalyticSource(1, FADING_QUICKLY), "constant", "straight", "fading")
    search.screening.find_shapes(["fading"])
    fitted = functools.reduce(search.screening.linear_fit_with, chosen, None)
    assert fitted is not None
    return search, fitted


def test_the_start_of_a_shape_is_the_best_beside_the_chosen_effects() -> None:
    """Alone the fading effect imitates the constant one. Kills: one start of a shape, the best alone, for all steps."""
    search, constant = with_shapes_of_fading("constant")
    assert search.screening.linear_fit_with(None, "fading").candidate.point[1] < 1.0
    beside = search.screening.linear_fit_with(constant, "fading").candidate
    assert beside.names == ("constant", "fading") and beside.point[2] == 10.0


def test_the_start_of_a_shape_is_the_best_in_the_place_of_a_chosen_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: a rival that starts at the shape that is the best alone."""
    search, chosen = with_shapes_of_fading("constant", "straight")
    monkeypatch.setattr(search_module, "gauss_newton", lambda fitted: fitted)
    monkeypatch.setattr(search, "_refined", lambda start, evidence, _: Fit.of(start, evidence))
    [rival] = [rival for rival in search.rivals(chosen, max_score_ratio=np.inf) if rival.instead_of == "straight"]
    assert rival.fit.candidate.names == ("constant", "fading") and rival.fit.candidate.point[2] == 10.0


def test_effects_fitted_together_start_at_the_best_shape_beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: starts of a joint fit that are the best alone."""
    search, _ = with_shapes_of_fading("constant")
    starts = []
    monkeypatch.setattr(search, "_refined", lambda start, evidence: starts.append(start) or Fit.of(start, evidence))
    search.fitted(("constant", "fading"))
    assert starts[0].point[2] == 10.0
