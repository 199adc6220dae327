# SPDX-License-Identifier: Apache-2.0
"""The two engines against each other, and the border of the impact map."""

from __future__ import annotations

import numpy as np
import pytest
from impact_map_cases import PUSH, ante_speed, disagreement, nominal

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import (
    BulletEngine,
    ExactEngine,
    ImpactMapError,
    compute_impact_map,
)
from impact_rs_sim.impact_map.sampling import random_problem
from impact_rs_sim.impact_map.uniqueness import uniqueness_of


@pytest.mark.parametrize("seed", range(30))
def test_engines_agree_within_half_a_percent_of_the_ante_impact_speed(seed: int) -> None:
    problem = random_problem(PUSH, np.random.default_rng(seed))
    several = uniqueness_of(problem)
    bullet, exact = (compute_impact_map(problem, engine) for engine in ("bullet", "exact"))
    # Where u^+ is not unique, engines may stop at different answers of the family.
    assert disagreement(bullet, exact) <= 0.005 * ante_speed(problem) + several.spread


@pytest.mark.parametrize("seed", range(30))
def test_pinocchio_obeys_the_laws_to_a_micrometre_per_second(seed: int) -> None:
    result = compute_impact_map(random_problem(PUSH, np.random.default_rng(seed)), "exact")
    assert result.residual.largest <= 1e-6


@pytest.mark.parametrize("motor", ["zero", "reduced", "rotor"])
def test_answers_of_one_engine_object_equal_those_of_a_fresh_one(motor: str) -> None:
    problem = nominal(motor)
    engine = BulletEngine(problem.physics)
    warm = [engine.solve(problem) for _ in range(2)][-1]
    engine.close()
    fresh = BulletEngine(problem.physics)
    cold = fresh.solve(problem)
    fresh.close()
    np.testing.assert_allclose(warm.joint_velocity["arm"], cold.joint_velocity["arm"], rtol=0, atol=1e-10)


def test_unknown_engine_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="exact, bullet"):
        compute_impact_map(nominal(), "agx")


@pytest.mark.parametrize("engine", [BulletEngine, ExactEngine])
def test_answer_that_breaks_a_law_is_an_error_that_names_it(
    engine: type[BulletEngine | ExactEngine], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "tolerance", 1e-18)
    problem = nominal()
    solver = engine(problem.physics)
    with pytest.raises(ImpactMapError, match="breaks (Newton|complementarity|Coulomb|momentum)"):
        solver.solve(problem)
    solver.close()
