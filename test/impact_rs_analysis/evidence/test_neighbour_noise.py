# SPDX-License-Identifier: Apache-2.0
"""Noise from neighbouring states: that of the measurement, and never less."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ball_impacts import NOISE, Racket, ball_table

from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.neighbour_noise import nearest_neighbour_noise
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))


def states(rows: int = 800) -> np.ndarray:
    """States with a coordinate that does not vary."""
    varied = np.random.default_rng(0).uniform(-1.0, 1.0, (rows, 3)) * [1.0, 100.0, 0.01]
    return np.hstack((varied, np.full((rows, 1), 7.0)))


@pytest.mark.parametrize("slope", [0.0, 50.0])
def test_a_linear_residual_leaves_the_noise(slope: float) -> None:
    rng, state = np.random.default_rng(1), states()
    noise = rng.standard_normal((len(state), 2)) * [0.1, 3.0]
    found = nearest_neighbour_noise(state, slope * state[:, :1] + noise)
    np.testing.assert_allclose(found, [0.1, 3.0], rtol=0.08)


def test_a_residual_that_bends_gives_too_much_and_never_too_little() -> None:
    rng, state = np.random.default_rng(2), states()
    bent = np.sin(6.0 * state[:, :1]) + 0.1 * rng.standard_normal((len(state), 1))
    found = nearest_neighbour_noise(state, bent)
    assert found is not None
    assert 0.1 < found[0] < 0.7 * bent.std()


def test_with_few_rows_nothing_is_said() -> None:
    assert nearest_neighbour_noise(states(40), np.ones((40, 1))) is None


def test_balls_show_their_noise_although_the_model_is_wrong(tmp_path: Path) -> None:
    racket = Racket(lambda v: 0.53, 0.212)
    path = ball_table(tmp_path / "balls.csv", racket, rows=300, stated=False, friction=0.3, restitution=0.0)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    found = source.scatter_of_neighbours(source.measured - source.predicted)
    truth = np.sqrt(3.0 * NOISE[0] ** 2 + 3.0 * NOISE[1] ** 2 * 2.0 / 3.0 * 0.02**2)
    assert found == pytest.approx(truth, rel=0.08)
    assert any(f"impacts of neighbouring states scatter by {found:.3g} m/s" in text for text in source.remarks)


def test_rows_that_are_all_alike_are_repeats() -> None:
    """Drops of one height, with rounding in the states. Kills a search for neighbours among no coordinates."""
    rng = np.random.default_rng(0)
    same = np.full((40, 2), -2.0) * (1.0 + 1e-16 * rng.integers(-2, 3, (40, 2)))
    found = nearest_neighbour_noise(same, rng.normal(0.0, 0.1, (40, 1)))
    assert found == pytest.approx([0.1], rel=0.25)
    assert nearest_neighbour_noise(same[:5], np.zeros((5, 1))) is None
