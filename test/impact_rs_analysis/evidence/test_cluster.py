# SPDX-License-Identifier: Apache-2.0
"""Scales of the evidence: pure error, and the size on which 1 is what repetition alone gives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from mixed_grab import MIXED

from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.cluster import Cluster, Feature, pooled_error, size_of
from impact_rs_analysis.evidence.levels import Cell, where_of, where_of_blocks
from impact_rs_analysis.evidence.source import Source, with_per_arm_parameters
from impact_rs_analysis.report.plots import residual_maps
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario

FEATURES = tuple(Feature("impact", "velocity", "x", number, "m/s", 0.01) for number in range(50))


def cluster(residuals: np.ndarray, pure_error: float = 1.0, discrepancy: float = 0.0, unit: str = "0") -> Cluster:
    count = residuals.shape[1]
    return Cluster(
        unit, ("a", "b", "c"), "hit", unit, True, FEATURES[:count], residuals, np.ones(count),
        np.full(count, pure_error), np.full(count, discrepancy),
    )  # fmt: skip


def test_the_pure_error_is_unbiased_however_few_the_repeats() -> None:
    """Two repeats have one degree of freedom each: the mean square over many pairs is the true variance."""
    rng = np.random.default_rng(0)
    rows = [2.0 * rng.standard_normal((2, 4000)) + 100.0 * k for k in range(3)]
    found = pooled_error(rows)
    assert found is not None
    assert np.mean(np.square(found)) == pytest.approx(4.0, rel=0.05)


def test_without_repeats_there_is_no_pure_error() -> None:
    assert pooled_error([np.ones((1, 3)), np.zeros((1, 3))]) is None


@pytest.mark.parametrize("repeats", [1, 2, 5])
def test_the_size_of_pure_repetition_is_one_for_any_number_of_repeats(repeats: int) -> None:
    rng = np.random.default_rng(repeats)
    items = [cluster(rng.standard_normal((repeats, 50))) for _ in range(200)]
    assert size_of([i.error for i in items], [i.expected for i in items]) == pytest.approx(1.0, abs=0.02)


def test_a_known_discrepancy_is_expected_and_repeats_do_not_lower_it() -> None:
    item = cluster(np.zeros((100, 3)), pure_error=1.0, discrepancy=2.0)
    assert item.expected == pytest.approx(1.0 / 100.0 + 4.0)


def test_a_size_without_any_noise_is_the_residual_itself() -> None:
    item = cluster(np.full((1, 3), 3.0), pure_error=0.0)
    assert size_of([item.error], [item.expected]) == pytest.approx(3.0)


def test_only_neighbours_on_the_same_recording_guard_a_stretch() -> None:
    class Stretches:
        repeated = False

    items = tuple(cluster(np.zeros((1, 3)), unit="first" if n < 3 else "second") for n in range(6))
    evidence = Evidence(Stretches(), tuple(range(6)), items)  # type: ignore[arg-type]
    assert evidence.neighbours == ((1,), (0, 2), (1,), (4,), (3, 5), (4,))
    assert evidence.only([0, 2, 3, 4]).neighbours == ((), (), (3,), (2,))


def test_arms_share_their_parameters_where_they_are_of_one_kind() -> None:
    nominal, mixed = load_model("nominal"), Physics.nominal(MIXED, "parcel")
    alike = Physics.nominal(load_scenario("grab"), "parcel")
    assert with_per_arm_parameters(nominal, [mixed]).arms == {"left": 7, "right": 6}
    assert with_per_arm_parameters(nominal, [alike]) is nominal
    assert with_per_arm_parameters(nominal, [alike], each_arm=True).arms == {"left": 7, "right": 7}
    # Two scenes with an arm of another kind each: their names distinguish them.
    one, other = (replace(mixed, arms={name: arm}) for name, arm in mixed.arms.items())
    assert with_per_arm_parameters(nominal, [one, other]).arms == {"left": 7, "right": 6}
    known = nominal.model_copy(update={"arms": {"left": 7}})
    assert with_per_arm_parameters(known, [mixed]) is known


def test_one_name_for_two_robots_is_refused_where_parameters_go_by_names() -> None:
    nominal, mixed = load_model("nominal"), Physics.nominal(MIXED, "parcel")
    one, other = (replace(mixed, arms={"arm": arm}) for arm in mixed.arms.values())
    assert with_per_arm_parameters(nominal, [one, other]) is nominal
    with pytest.raises(InputError, match="arm 'arm' is another robot in another scenario"):
        with_per_arm_parameters(nominal, [one, other], each_arm=True)
    source = cast(Source, SimpleNamespace(model=nominal, physics=one, worlds=[one, other]))
    with pytest.raises(InputError, match="arms arm with 6 joints, arm with 7 joints: .* a different name for each"):
        Source.joints.fget(source)  # type: ignore[attr-defined]


# ---- Residuals by place: the largest are those that are clear of noise and large enough to matter


DEFLECTION = Feature("free", "elastic deflection", "joint1", 0, "rad", 4e-6)
VELOCITY = Feature("free", "end-effector velocity", "y", 0, "m/s", 0.001)


def condition(residuals: dict[Feature, float], noise: dict[Feature, float], repeats: int = 4) -> Cluster:
    """One condition with mean residuals and their repeatability, both in the unit."""
    features = tuple(residuals)
    sigma = np.array([max(noise[one], one.relevance_limit / 2.0) for one in features])
    pure = np.array([noise[one] for one in features]) / sigma
    rows = np.tile(np.array([residuals[one] for one in features]) / sigma, (repeats, 1))
    return Cluster("push", ("push", "box", "1"), "push", "push", True, features, rows, sigma, pure, 0.0 * pure)


@pytest.mark.parametrize("places", [where_of, where_of_blocks])
def test_a_deflection_that_no_robot_measures_is_behind_a_velocity_that_matters(places: type) -> None:
    """0.2 microradians, 400 times what a simulator repeats, beside 5 mm/s, which is 5 times the noise."""
    item = condition({DEFLECTION: 2e-7, VELOCITY: 0.005}, {DEFLECTION: 1e-9, VELOCITY: 0.002})
    cells = {cell.signal: cell for cell in places([item])}
    deflection, velocity = cells[DEFLECTION.signal], cells[VELOCITY.signal]
    assert deflection.times_noise > 100.0 > 10.0 > velocity.times_noise
    assert deflection.size == pytest.approx(2e-7 / 4e-6) and not deflection.matters
    assert velocity.size == pytest.approx(0.005 / 0.001) and velocity.matters
    ((_, figure),) = residual_maps(tuple(cells.values()), False, "the noise")
    assert list(figure.data[0].y) == ["end-effector velocity y"]
    assert figure.data[0].z[0][0] == pytest.approx(5.0)


def test_residuals_are_ordered_by_what_matters() -> None:
    item = condition({DEFLECTION: 2e-7, VELOCITY: 0.005}, {DEFLECTION: 1e-9, VELOCITY: 0.002})
    assert [cell.signal for cell in where_of([item])] == [VELOCITY.signal, DEFLECTION.signal]


def test_above_noise_and_limit_the_larger_one_is_the_unit() -> None:
    item = condition({VELOCITY: 0.04}, {VELOCITY: 0.008})  # noise of the mean of four: 4 mm/s
    (cell,) = where_of([item])
    assert cell.size == pytest.approx(10.0) == pytest.approx(cell.times_noise)


def test_a_file_of_an_earlier_version_is_coloured_alike() -> None:
    """It has no multiple of the larger one; its error and its relevance limit stand for it."""
    old = Cell(
        scenario="s", object="o", case="c", phase="free", signal="elastic deflection", index="joint1", error=2e-7,
        unit="rad", floor=4e-6, share=0.5, times_noise=400.0,
    )  # fmt: skip
    assert old.size == pytest.approx(0.05)
