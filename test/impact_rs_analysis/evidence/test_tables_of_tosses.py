# SPDX-License-Identifier: Apache-2.0
"""Tossed cubes with a weight off their middle: one verdict, whatever friction is assumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from corner_impacts import NOISE, toss_table
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

from .conftest import assert_intervals

NOMINAL = load_model(Path("nominal"))
LAWS = {"rolling_resistance": (0.0034,), "tangential_restitution": (0.8, 0.35)}
FRICTION, RESTITUTION, HEIGHT = 0.18, 0.27, 0.0068  # -, -, m; as found on the public tosses


@pytest.mark.parametrize("assumed", [0.0, 1.0])
def test_the_map_solves_a_corner_as_one_does_by_hand(tmp_path: Path, assumed: float) -> None:
    table = read_impact_table(toss_table(tmp_path / "tosses.csv", assumed, rows=40, noise=(0.0, 0.0)))
    source = ImpactTableSource(table, NOMINAL)
    truth = (
        ("restitution", (RESTITUTION,)),
        ("support_friction", (FRICTION - assumed,)),
        ("object_com_offset", (0.0, 0.0, HEIGHT)),
    )
    np.testing.assert_allclose(source.predicted_with(truth), source.measured, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("assumed", [0.0, 0.1, 1.0])  # none, less and more than there is
def test_the_friction_that_is_assumed_of_tosses_does_not_matter(tmp_path: Path, assumed: float) -> None:
    source = ImpactTableSource(read_impact_table(toss_table(tmp_path / "tosses.csv", assumed)), NOMINAL)
    document = diagnose(source, NOMINAL)
    assert set(document.named) == {"restitution", "support_friction", "object_com_offset"}
    assert document.noise_floor is not None
    assert document.held_out_error_after < 1.1 * document.noise_floor
    truth = {
        ("restitution", "restitution"): RESTITUTION,
        ("support_friction", "friction"): FRICTION - assumed,
        ("object_com_offset", "z"): HEIGHT,
    }
    assert_intervals(source, document, truth, np.repeat(NOISE, 3))


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "restitution"), [(1.0, 0.6), (0.0, 0.0)])
def test_five_laws_together_are_found_from_every_assumption(
    tmp_path: Path, friction: float, restitution: float
) -> None:
    """Weak laws are seen beside the strong ones alone, and share of slip and its fall hardly apart from each other."""
    truth = cube(FRICTION, RESTITUTION, (0.0, 0.0, HEIGHT))
    for name, values in LAWS.items():
        truth = library()[name].apply_vector(truth, np.array(values))
    rows = cube_rows(truth, 60)
    for row in rows:
        row[-2:] = [friction, restitution]
    table = read_impact_table(write_csv(tmp_path / "cubes.csv", CUBE_HEADER, rows))
    effects = ["restitution", "support_friction", "object_com_offset", *LAWS]
    document = diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, effects)
    assert set(document.named) == set(effects)
    for effect, parameter, true in (
        ("restitution", "restitution", RESTITUTION - restitution),
        ("support_friction", "friction", FRICTION - friction),
        ("object_com_offset", "z", HEIGHT),
        ("rolling_resistance", "arm", 0.0034),
        ("tangential_restitution", "restitution", 0.8),
        ("tangential_restitution", "fall", 0.35),
    ):
        found = document.effect(effect).parameters[parameter]
        half = (found.interval[1] - found.interval[0]) / 2.0
        assert found.estimate == pytest.approx(true, abs=2.0 * half), (effect, parameter)


def test_friction_that_hardly_any_impact_feels_at_the_assumed_value_is_found(tmp_path: Path) -> None:
    """Where mu = 1 is assumed, nearly all contacts are believed to stick; with 0.18 they slip."""
    path = toss_table(tmp_path / "tosses.csv", 1.0, rows=60, restitution=0.0, com=(0.0, 0.0, 0.0))
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction", "rolling_resistance"])
    assert document.named == ("support_friction",)
    found = document.effect("support_friction").parameters["friction"]
    assert found.estimate == pytest.approx(FRICTION - 1.0, abs=0.01)
