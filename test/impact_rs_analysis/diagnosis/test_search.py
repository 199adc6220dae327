# SPDX-License-Identifier: Apache-2.0
"""The search on a world with a closed form: what is planted is found, what is not there is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_world import EFFECTS, TIPPING, AnalyticSource, BeforeTheHit, correlated
from scipy.stats import binom

from impact_rs_analysis.diagnosis.candidate import Candidate, Problem, bounded, linearise
from impact_rs_analysis.diagnosis.fit import Evidence, Fit, _broyden, evaluate_at, look_elsewhere, refine
from impact_rs_analysis.diagnosis.search import Search, adjusted, tied
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANT

pytestmark = pytest.mark.usefixtures("few_draws")
FREE = (0, 1)  # clusters in which nothing is hit, where there are any
CONTACT = ("straight", "bent", "payload")


def searched(source: AnalyticSource, only: tuple[str, ...] = CONTACT) -> Search:
    return Search.screened([EFFECTS[name] for name in only], Evidence.of(source))


def test_nothing_is_found_where_nothing_is_hidden() -> None:
    """At a false-discovery rate of 1 %, 30 campaigns raise three false alarms once in 300 tries."""
    alarms = sum(searched(AnalyticSource(seed, correlation=correlated())).choose() is not None for seed in range(30))
    assert alarms <= binom.ppf(0.997, 30, SIGNIFICANT)


@pytest.mark.parametrize(
    ("name", "values"), [("straight", (0.8,)), ("straight", (30.0,)), ("bent", (2.0,)), ("bent", (9.0,))]
)
def test_a_hidden_effect_is_named_and_estimated_however_strong_it_is(name: str, values: tuple[float, ...]) -> None:
    for seed in range(3):
        search = searched(AnalyticSource(seed, ((name, values),)))
        chosen = search.choose()
        assert chosen is not None and chosen.candidate.names == (name,)
        assert chosen.estimate[0] == pytest.approx(values[0], abs=0.15)
        before = search.evidence.reference.lack_of_fit([item.mean for item in search.evidence.clusters])
        after = chosen.lack_of_fit()
        assert before is not None and after is not None and before < SIGNIFICANT < after


def test_a_shape_that_moves_nothing_while_the_effect_is_off_is_found_all_the_same() -> None:
    """The lever of a payload moves nothing while the payload has no mass."""
    chosen = searched(AnalyticSource(3, (("payload", (4.0, -1.5)),))).choose()
    assert chosen is not None and chosen.candidate.names == ("payload",)
    np.testing.assert_allclose(chosen.estimate, (4.0, -1.5), atol=0.15)


def test_two_hidden_effects_are_both_named() -> None:
    chosen = searched(AnalyticSource(4, (("straight", (3.0,)), ("bent", (5.0,))))).choose()
    assert chosen is not None and set(chosen.candidate.names) == {"straight", "bent"}


def test_of_two_explanations_that_are_alike_the_one_with_fewer_parameters_is_chosen_and_the_other_ties() -> None:
    search = searched(AnalyticSource(5, (("straight", (5.0,)),)), ("straight", "twin_of_straight", "bent"))
    chosen = search.choose()
    assert chosen is not None and chosen.candidate.names == ("straight",)
    rivals = {rival.name: rival for rival in search.rivals(chosen)}
    assert rivals["twin_of_straight"].tied and rivals["twin_of_straight"].instead_of == "straight"
    assert rivals["twin_of_straight"].fit.estimate[0] == pytest.approx(10.0, abs=0.4)
    assert "bent" not in rivals or not rivals["bent"].tied


def test_a_rival_is_fitted_in_the_place_of_the_other_beside_all_else_that_was_found() -> None:
    """Alone the twin would have to explain the bent effect as well; in the other's place it has its own value."""
    truth = (("straight", (5.0,)), ("bent", (6.0,)))
    search = searched(AnalyticSource(6, truth), ("straight", "twin_of_straight", "bent"))
    chosen = search.choose()
    assert chosen is not None and set(chosen.candidate.names) == {"straight", "bent"}
    rival = next(rival for rival in search.rivals(chosen) if rival.name == "twin_of_straight")
    assert rival.instead_of == "straight" and set(rival.fit.candidate.names) == {"bent", "twin_of_straight"}
    part = rival.fit.candidate.part("twin_of_straight")
    assert rival.fit.estimate[part][0] == pytest.approx(10.0, abs=0.4)


def test_what_no_effect_explains_leaves_a_lack_of_fit() -> None:
    search = searched(AnalyticSource(6, (("outside", (5.0,)),)))
    chosen = search.choose()
    rest = [item.mean for item in search.evidence.clusters] if chosen is None else chosen.rest
    left = search.evidence.reference.lack_of_fit(rest)
    assert left is not None and left < SIGNIFICANT


def test_95_percent_intervals_hold_the_truth_95_times_in_100() -> None:
    """Counted over 200 campaigns; the bounds are what chance allows a true share of 93 to 98 percent."""
    count, inside = 200, 0
    for seed in range(count):
        source = AnalyticSource(seed, (("straight", (2.0,)),), correlation=correlated())
        evidence = Evidence.of(source)
        candidate = linearise(Candidate.of((EFFECTS["straight"],), source), source.clusters, range(6), source)
        assert candidate is not None
        fitted = Fit.of(candidate, evidence)
        inside += abs(fitted.estimate[0] - 2.0) <= fitted.half_widths[0]
    assert binom.ppf(0.005, count, 0.93) <= inside <= binom.ppf(0.995, count, 0.985)


def test_intervals_are_wider_by_what_the_simulator_is_known_to_be_off_by_and_hold_the_truth_then() -> None:
    count, inside = 100, 0
    for seed in range(count):
        source = AnalyticSource(seed, (("straight", (2.0,)),), discrepancy=1.0, simulator=seed)
        candidate = linearise(Candidate.of((EFFECTS["straight"],), source), source.clusters, range(6), source)
        assert candidate is not None
        fitted = Fit.of(candidate, Evidence.of(source))
        inside += abs(fitted.estimate[0] - 2.0) <= fitted.half_widths[0]
    assert binom.ppf(0.005, count, 0.93) <= inside


def test_of_a_delay_nobody_knows_more_than_how_far_the_clocks_may_be_off() -> None:
    source = AnalyticSource(3, (("inverse", (0.7,)),))
    evidence = Evidence.of(source)
    start = linearise(Candidate.of((EFFECTS["inverse"],), source), evidence.clusters, evidence.numbers, source)
    assert start is not None
    late = replace(start, scalars=tuple(replace(scalar, unit="s") for scalar in start.scalars))
    alone = Fit.of(late, evidence).half_widths
    source.clock = 0.4  # of commands
    both, without_time = Fit.of(late, evidence).half_widths, Fit.of(start, evidence).half_widths
    np.testing.assert_allclose(both**2 - alone**2, (0.95 * 0.4 / late.scale) ** 2)
    np.testing.assert_array_equal(without_time, alone)


def test_an_interval_knows_what_a_clock_that_is_off_does_to_all_conditions_alike() -> None:
    source = AnalyticSource(3, (("straight", (2.0,)),))
    evidence = Evidence.of(source)
    start = linearise(Candidate.of((EFFECTS["straight"],), source), evidence.clusters, evidence.numbers, source)
    assert start is not None
    alone = Fit.of(start, evidence).half_widths
    clock = np.full(start.point.size, 0.3)  # parameter scales that it looks like
    late = tuple(
        replace(item, late=jacobian @ clock) for item, jacobian in zip(evidence.clusters, start.jacobians, strict=True)
    )
    both = Fit.of(start, replace(evidence, clusters=late)).half_widths
    np.testing.assert_allclose(np.sqrt(both**2 - alone**2), 1.96 * clock, rtol=1e-3)


def test_an_update_of_the_sensitivities_gives_the_step_just_made_exactly() -> None:
    source = AnalyticSource(7, (("bent", (9.0,)),))
    search = searched(source, ("bent",))
    before = search.singles["bent"]
    after = evaluate_at(before, np.array([4.0]), search.evidence)
    assert after is not None
    updated = _broyden(before, after)
    for jacobian, here, there in zip(updated.jacobians, before.offsets, after.offsets, strict=True):
        np.testing.assert_allclose(jacobian @ np.array([4.0]), there - here, rtol=1e-12)


def test_leaving_a_cluster_out_uses_all_others_and_the_guard_takes_its_neighbours_along() -> None:
    source = AnalyticSource(8, (("straight", (2.0,)),))
    candidate = searched(source).singles["straight"]
    guard = [tuple(n for n in (c - 1, c + 1) if 0 <= n < 6) for c in range(6)]
    for neighbours in (None, guard):
        problem = Problem(candidate, source.clusters, neighbours)
        for number in range(6):
            out = {number, *(() if neighbours is None else neighbours[number])}
            kept = [index for index in range(6) if index not in out]
            direct = Problem(candidate.only(kept), [source.clusters[index] for index in kept]).solve()
            np.testing.assert_allclose(problem.left_out[number], direct, rtol=1e-9)


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    """Clusters that say the same amount: the estimate is their mean, its standard error s / sqrt(c) (Tukey 1958)."""
    source = AnalyticSource(12)
    ones = tuple(np.ones((item.sigma.size, 1)) for item in source.clusters)
    problem = Problem(replace(searched(source).singles["straight"], jacobians=ones), source.clusters)
    means = np.array([item.mean.mean() for item in source.clusters])
    assert problem.solve()[0] == pytest.approx(means.mean(), rel=1e-5)
    assert problem.jackknife()[0] == pytest.approx(means.std(ddof=1) / np.sqrt(6), rel=1e-4)


def test_errors_of_a_change_are_those_of_the_residuals_it_leaves() -> None:
    source = AnalyticSource(9, (("of_joints", tuple(range(7))),))
    problem = Problem(searched(source, ("of_joints",)).singles["of_joints"], source.clusters)
    change = problem.solve()
    direct = [np.mean(np.square(rest)) for rest in problem.rest(change)]
    np.testing.assert_allclose(problem.errors(change), direct, rtol=1e-9)


def test_bounds_hold_and_the_optimum_obeys_the_conditions_of_kuhn_and_tucker() -> None:
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


def test_a_bound_of_physics_is_not_passed() -> None:
    search = searched(AnalyticSource(10, (("one_sided", (-3.0,)),)), ("one_sided",))
    fitted = refine(search.singles["one_sided"], search.evidence)
    assert fitted.estimate[0] == pytest.approx(0.0, abs=1e-12)


def test_most_effects_of_the_joints_that_are_absent_are_not_tried_in_contact() -> None:
    ruled_out = 0
    for seed in range(10):
        source = AnalyticSource(seed, free=FREE)
        search = searched(source, ("bent", "of_joints"))
        tried = {number for number, added in source.asked if added and added[0][0] == "of_joints"}
        assert tried == (set(FREE) if search.ruled_out else set(range(6)))
        assert set(search.p_values(None)) == {"bent", "of_joints"}
        ruled_out += bool(search.ruled_out)
    assert ruled_out >= 6


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_an_effect_of_the_joints_is_found_beside_one_of_the_contact(size: float) -> None:
    values = tuple(size * (-1.0) ** joint for joint in range(7))
    search = searched(AnalyticSource(2, (("of_joints", values), ("bent", (5.0,))), free=FREE), ("bent", "of_joints"))
    assert not search.ruled_out
    chosen = search.choose()
    assert chosen is not None and set(chosen.candidate.names) == {"bent", "of_joints"}


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_where_one_effect_explains_free_motion_others_of_the_joints_are_not_tried_in_contact(size: float) -> None:
    values = tuple(size * (-1.0) ** joint for joint in range(7))
    source = AnalyticSource(2, (("of_joints", values),), free=FREE)
    search = searched(source, ("of_joints", "of_motors", "bent"))
    assert search.ruled_out == {"of_motors"}
    assert {number for number, added in source.asked if added and added[0][0] == "of_motors"} == set(FREE)
    chosen = search.choose()
    assert chosen is not None and chosen.candidate.names == ("of_joints",)


@pytest.mark.parametrize("rate", [0.15, 6.0, 20.0])
def test_a_shape_far_from_its_start_is_found_in_the_motion_before_a_hit(rate: float) -> None:
    """A rate up to twenty times its start, which no linear step leads to; the hit is asked from the place found."""
    source = BeforeTheHit(1, (("fading", (12.0, rate)),))
    search = searched(source, ("bent", "fading"))
    asked = [values[1] for _, added in source.asked for name, values in added if name == "fading"]
    assert any(value == pytest.approx(rate, rel=0.2) for value in asked)
    chosen = search.choose()
    assert chosen is not None and chosen.candidate.names == ("fading",)
    np.testing.assert_allclose(chosen.estimate, (12.0, rate), rtol=0.15)


@pytest.mark.parametrize(("force", "friction", "fade"), [(10.0, 15.0, 3.0), (20.0, 8.0, 0.3), (40.0, 8.0, 1.0)])
def test_dry_friction_that_fades_is_found_beside_the_force_that_drives_against_it(
    force: float, friction: float, fade: float
) -> None:
    """By itself friction explains the motion of what nobody drives; where it begins there leads nowhere."""
    source = BeforeTheHit(1, (("straight", (force,)), ("dry", (friction, fade))))
    chosen = searched(source, ("straight", "dry", "bent")).choose()
    assert chosen is not None and chosen.candidate.names == ("straight", "dry")
    np.testing.assert_allclose(chosen.estimate, (force, friction, fade), rtol=0.1)


def test_motion_before_a_hit_rules_out_as_well_and_the_hit_is_not_asked() -> None:
    """No cluster is without a hit; what is told of the effect all the same is how little of it can be there."""
    ruled_out = 0
    for seed in range(8):
        source = BeforeTheHit(seed)
        search = searched(source, ("bent", "of_joints"))
        asked = any(name == "of_joints" for _, added in source.asked for name, _ in added)
        assert asked != ("of_joints" in search.ruled_out)
        ruled_out += "of_joints" in search.ruled_out
        if search.ruled_out:
            for jacobian in search.singles["of_joints"].jacobians:
                assert np.all(jacobian[~np.array(source.before)] == 0.0) and np.any(jacobian[source.before])
    assert ruled_out >= 6


def test_what_is_there_before_a_hit_is_found_in_all_that_was_measured() -> None:
    values = tuple(0.6 * (-1.0) ** joint for joint in range(7))
    search = searched(BeforeTheHit(2, (("of_joints", values),)), ("bent", "of_joints"))
    assert not search.ruled_out
    chosen = search.choose()
    assert chosen is not None and chosen.candidate.names == ("of_joints",)
    np.testing.assert_allclose(chosen.estimate, values, atol=0.3)


def test_beside_an_effect_that_looks_much_like_it_p_of_nothing_is_still_uniform() -> None:
    """Half of what the second moves is the first's; counted over 150 nulls, bounds of chance in 1 of 10,000 runs."""
    draws, found = 150, []
    for seed in range(draws):
        source = AnalyticSource(seed, (("straight", (3.0,)),), correlation=correlated())
        search = searched(source, ("straight", "one_sided"))
        chosen = Fit.of(search.singles["straight"], search.evidence)
        own = search.singles["one_sided"]
        alike = tuple(a + 2.0 * b for a, b in zip(own.jacobians, chosen.candidate.jacobians, strict=True))
        joined = search.evidence.problem(chosen.candidate.beside(replace(own, jacobians=alike)))
        found.append(joined.p_value(chosen.left.reference, slice(1, 2)))
    for level in (0.05, 0.3):
        low, high = binom.ppf([5e-5, 1 - 5e-5], draws, level)
        assert low <= np.count_nonzero(np.array(found) < level) <= high


def test_p_is_adjusted_for_every_effect_that_was_looked_at() -> None:
    """Benjamini and Hochberg by hand: sorted p times n over rank, made monotone from the largest down."""
    raw = {"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.5}
    found = adjusted(raw)
    assert found["a"] == pytest.approx(0.04)
    assert found["c"] == pytest.approx(min(0.03 * 4 / 2, 0.04 * 4 / 3))
    assert found["b"] == pytest.approx(0.04 * 4 / 3)
    assert found["d"] == pytest.approx(0.5)


def test_a_fit_ties_with_itself_and_not_with_one_that_is_twice_as_wrong() -> None:
    source = AnalyticSource(11, (("straight", (6.0,)), ("bent", (6.0,))))
    search = searched(source)
    both = search.choose()
    assert both is not None
    assert tied(both, both)
    assert not tied(both, Fit.of(search.singles["bent"], search.evidence))


@pytest.mark.parametrize("first", [3.0, 45.0])
def test_a_second_effect_is_found_however_large_the_first_one_is(first: float) -> None:
    """What is left counts by itself and not as a share: 1.5 times the noise beside 45 times is one part in 900."""
    chosen = searched(AnalyticSource(4, (("straight", (first,)), ("bent", (1.5,))))).choose()
    assert chosen is not None
    assert set(chosen.candidate.names) == {"straight", "bent"}


@pytest.mark.parametrize("hidden", [0.3, 0.416, 0.7, 2.5])
def test_what_goes_with_the_inverse_of_a_parameter_is_fitted_in_few_steps(hidden: float) -> None:
    """From 1 a straight step leads far beyond; the way back knows how the features bend on that step."""
    source = AnalyticSource(3, (("inverse", (hidden,)),))
    evidence = Evidence.of(source)
    start = linearise(Candidate.of((EFFECTS["inverse"],), source), evidence.clusters, evidence.numbers, source)
    assert start is not None
    fitted = refine(start, evidence, steps=2)
    assert fitted.estimate[0] == pytest.approx(hidden, rel=0.01)


@pytest.mark.parametrize("height", [-9.0, 12.0])
def test_what_changes_only_beyond_some_value_is_looked_for_on_both_sides(height: float) -> None:
    source = AnalyticSource(3, (("tipping", (2.0, height)),))
    evidence = Evidence.of(source)
    start = linearise(Candidate.of((TIPPING,), source), evidence.clusters, evidence.numbers, source)
    assert start is not None
    stuck = refine(start, evidence)
    assert abs(stuck.estimate[1] - height) > 3.0
    np.testing.assert_allclose(look_elsewhere(stuck).estimate, (2.0, height), atol=0.3)
    found = Search.screened([TIPPING, EFFECTS["straight"]], evidence).choose()
    assert found is not None
    np.testing.assert_allclose(found.estimate, (2.0, height), atol=0.3)


def test_a_fit_that_fits_looks_nowhere_else() -> None:
    source = AnalyticSource(3, (("tipping", (2.0, 0.0)),))
    evidence = Evidence.of(source)
    start = linearise(Candidate.of((TIPPING,), source), evidence.clusters, evidence.numbers, source)
    assert start is not None
    fitted = refine(start, evidence)
    source.asked.clear()
    assert look_elsewhere(fitted) is fitted
    assert not source.asked
