# SPDX-License-Identifier: Apache-2.0
"""Residuals by place: the largest are those that are clear of noise and large enough to matter."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.evidence.cluster import Cluster, Feature
from impact_rs_analysis.evidence.levels import Cell, where_of, where_of_blocks
from impact_rs_analysis.report.plots import where_plots

DEFLECTION = Feature("free", "elastic deflection", "joint1", 0, "rad", 4e-6)
VELOCITY = Feature("free", "end-effector velocity", "y", 0, "m/s", 0.001)


def cluster(residuals: dict[Feature, float], noise: dict[Feature, float], repeats: int = 4) -> Cluster:
    """One condition with mean residuals and their repeatability, both in the unit."""
    features = tuple(residuals)
    sigma = np.array([max(noise[one], one.relevance_limit / 2.0) for one in features])
    pure = np.array([noise[one] for one in features]) / sigma
    rows = np.tile(np.array([residuals[one] for one in features]) / sigma, (repeats, 1))
    return Cluster("push", ("push", "box", "1"), "push", "push", True, features, rows, sigma, pure, 0.0 * pure)


@pytest.mark.parametrize("places", [where_of, where_of_blocks])
def test_a_deflection_that_no_robot_measures_is_behind_a_velocity_that_matters(places: type) -> None:
    """0.2 microradians, 400 times what a simulator repeats, beside 5 mm/s, which is 5 times the noise."""
    item = cluster({DEFLECTION: 2e-7, VELOCITY: 0.005}, {DEFLECTION: 1e-9, VELOCITY: 0.002})
    cells = {cell.signal: cell for cell in places([item])}
    deflection, velocity = cells[DEFLECTION.signal], cells[VELOCITY.signal]
    assert deflection.times_noise > 100.0 > 10.0 > velocity.times_noise
    assert deflection.size == pytest.approx(2e-7 / 4e-6) and not deflection.matters
    assert velocity.size == pytest.approx(0.005 / 0.001) and velocity.matters
    ((_, figure),) = where_plots(tuple(cells.values()), False, "the noise")
    assert list(figure.data[0].y) == ["end-effector velocity y"]
    assert figure.data[0].z[0][0] == pytest.approx(5.0)


def test_residuals_are_ordered_by_what_matters() -> None:
    item = cluster({DEFLECTION: 2e-7, VELOCITY: 0.005}, {DEFLECTION: 1e-9, VELOCITY: 0.002})
    assert [cell.signal for cell in where_of([item])] == [VELOCITY.signal, DEFLECTION.signal]


def test_above_noise_and_limit_the_larger_one_is_the_unit() -> None:
    item = cluster({VELOCITY: 0.04}, {VELOCITY: 0.008})  # noise of the mean of four: 4 mm/s
    (cell,) = where_of([item])
    assert cell.size == pytest.approx(10.0) == pytest.approx(cell.times_noise)


def test_a_file_of_an_earlier_version_is_coloured_alike() -> None:
    """It has no multiple of the larger one; its error and its relevance limit stand for it."""
    old = Cell(
        scenario="s", object="o", case="c", phase="free", signal="elastic deflection", index="joint1", error=2e-7,
        unit="rad", floor=4e-6, share=0.5, times_noise=400.0,
    )  # fmt: skip
    assert old.size == pytest.approx(0.05)
