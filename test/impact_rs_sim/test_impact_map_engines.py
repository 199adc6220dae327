# SPDX-License-Identifier: Apache-2.0
"""The two engines against each other, the border of the impact map, and the random problems they are held against."""

from __future__ import annotations

import numpy as np
import pytest
from impact_map_cases import MODEL, PUSH, ante_speed, disagreement, nominal
from mixed_grab import MIXED
from random_impacts import random_problem

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import (
    BulletEngine,
    ExactEngine,
    ImpactMapError,
    ImpactProblem,
    check_problem,
    compute_impact_map,
)
from impact_rs_sim.impact_map.contacts import contact_pairs, find_contacts
from impact_rs_sim.impact_map.uniqueness import uniqueness_of

# ---- engines --------------------------------------------------------------------------------------------------------


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


# ---- random problems: feasible, at a contact, with bodies that can be -----------------------------------------------


@pytest.fixture(scope="module")
def problems() -> list[ImpactProblem]:
    return [random_problem(PUSH, np.random.default_rng(seed)) for seed in range(40)]


def test_every_problem_has_an_answer_and_a_contact_of_the_pad(problems: list[ImpactProblem]) -> None:
    for problem in problems:
        check_problem(problem)
        state = problem.arms["arm"]
        found = contact_pairs(problem.physics, problem.object, {"arm": MODEL.placement(state.position)})
        partners = {contact.partner for contact in find_contacts(problem.physics, found)}
        assert "arm" in partners


def test_objects_are_bodies_with_their_centre_of_mass_inside(problems: list[ImpactProblem]) -> None:
    for problem in problems:
        thing = problem.physics.object
        smallest, middle, largest = np.sort(thing.inertia)
        assert 0.0 < largest <= smallest + middle
        assert np.all(np.abs(thing.com_offset) < thing.size / 2.0)


def test_the_pad_moves_towards_the_object(problems: list[ImpactProblem]) -> None:
    for problem in problems:
        state = problem.arms["arm"]
        place = MODEL.placement(state.position)
        assert (MODEL.jacobian(state.position)[:3] @ state.velocity) @ place.rotation[:, 2] > 0.1


def test_random_problems_cover_restitution_and_motor_inertia(
    problems: list[ImpactProblem],
) -> None:
    inelastic = np.mean([problem.restitution == 0.0 for problem in problems])
    assert inelastic == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(40.0))
    physics = PUSH.robots["arm"].drive
    known = (np.zeros(7), np.array(physics.motor_inertia_reduced), np.array(physics.motor_inertia_rotor))
    kinds = [
        next((index for index, each in enumerate(known) if np.array_equal(problem.motor_inertia["arm"], each)), 3)
        for problem in problems
    ]
    assert set(kinds) == {0, 1, 2, 3}


def test_a_given_restitution_is_kept_and_the_seed_decides_the_rest() -> None:
    one, again = (random_problem(PUSH, np.random.default_rng(3), 0.4) for _ in range(2))
    assert one.restitution == again.restitution == 0.4
    np.testing.assert_array_equal(one.arms["arm"].velocity, again.arms["arm"].velocity)
    np.testing.assert_array_equal(one.object.position, again.object.position)


def test_six_joints_have_no_motion_beside_that_of_the_end_effector() -> None:
    """The rotation that is drawn is at most 0.3 rad/s about every axis; what it would add cannot be self-motion."""
    case = MIXED.cases["case_1"]
    alone = {"right": MIXED.robots["right"]}
    ur5e = MIXED.model_copy(
        update={
            "robots": alone,
            "cases": {"case_1": case.model_copy(update={"robots": {"right": case.robots["right"]}})},
        }
    )
    for seed in range(5):
        problem = random_problem(ur5e, np.random.default_rng(seed))
        state = problem.arms["right"]
        twist = problem.physics.robot_model("right").jacobian(state.position) @ state.velocity
        assert np.abs(twist[3:]).max() <= 0.3 + 1e-9
