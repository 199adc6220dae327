# SPDX-License-Identifier: Apache-2.0
"""How many answers a question has, which one is told, and the same by brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gauss_seidel import gauss_seidel
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from impact_map_cases import PUSH, nominal, one_point

from impact_rs_sim.impact_map.cones import solve_cones, solve_contacts
from impact_rs_sim.impact_map.laws import ContactTerms, newton
from impact_rs_sim.impact_map.perturbation import change
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.sampling import random_problem
from impact_rs_sim.impact_map.uniqueness import lawful_answers, spread_of, uniqueness_of

SEVERAL = 3  # seed of a random push whose u^+ is a family


def terms_of(problem: ImpactProblem) -> ContactTerms:
    """What an answer is found from."""
    return change(problem, {}).terms({"arm": problem.physics.robot_model("arm")})[1]


def velocity(terms: ContactTerms, impulses: np.ndarray) -> np.ndarray:
    """u^+ of impulses."""
    return np.asarray(terms.before + terms.response @ impulses.ravel())


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_one_contact_point_has_one_answer_and_brute_force_finds_it(friction: float) -> None:
    problem = one_point(pad_friction=friction)
    assert uniqueness_of(problem).spread == pytest.approx(0.0, abs=1e-9)
    terms = terms_of(problem)
    impulses, changes = gauss_seidel(terms, np.zeros((1, 1, 3)))
    assert changes[0] <= 1e-12
    np.testing.assert_allclose(velocity(terms, impulses[0]), velocity(terms, solve_contacts(terms)[0]), atol=1e-7)


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_brute_force_agrees_where_the_answer_is_unique(seed: int) -> None:
    # Without friction every answer has the same u^+, however the corners share the load.
    problem = random_problem(PUSH, np.random.default_rng(seed))
    problem = replace(problem, physics=replace(problem.physics, pad_friction=0.0, support_friction=0.0))
    assert uniqueness_of(problem).spread <= 1e-6
    terms = terms_of(problem)
    starts = np.random.default_rng(seed).random((3, len(terms.contacts), 1)) * terms.normals
    impulses, changes = gauss_seidel(terms, starts)
    assert np.max(changes) <= 1e-12
    for found in impulses:
        np.testing.assert_allclose(velocity(terms, found), velocity(terms, solve_contacts(terms)[0]), atol=1e-6)


def test_sliding_corners_leave_a_family_of_answers_that_brute_force_finds() -> None:
    problem = random_problem(PUSH, np.random.default_rng(SEVERAL))
    told = uniqueness_of(problem)
    assert not told.unique
    assert "not unique" in told.warning and "equal compliance" in told.warning
    models = {"arm": problem.physics.robot_model("arm")}
    system, terms = change(problem, {}).terms(models)
    loads = 0.1 * np.ones((4, len(terms.contacts), 1))
    loads[np.arange(4), np.arange(4) + 4] = 2.0  # most of it on one corner of the support
    impulses, _ = gauss_seidel(terms, loads * terms.normals, 3000)
    found = [velocity(terms, one) for one in impulses if terms.residual(one, velocity(terms, one)).largest <= 1e-6]
    theirs = spread_of(system, found)
    assert len(found) >= 2
    assert 0.2 * told.spread <= theirs.spread <= 1.05 * told.spread


def test_the_nominal_push_is_unique() -> None:
    told = uniqueness_of(nominal())
    assert told.unique and told.relative <= 1e-4
    assert told.warning == ""


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6), share=st.floats(0.2, 3.0))
def test_the_told_answer_does_not_depend_on_where_the_solver_starts(seed: int, share: float) -> None:
    terms = terms_of(random_problem(PUSH, np.random.default_rng(seed)))
    first, converged = newton(terms, solve_cones(terms)[0])
    weights = np.linspace(1.0, share, len(first))[:, None]
    second, again = newton(terms, weights * first)
    if converged and again:
        np.testing.assert_allclose(velocity(terms, second), velocity(terms, first), atol=1e-7)


def test_the_told_answer_has_the_least_norm_of_equivalent_impulses() -> None:
    # A frictionless box on four corners: u^+ is one, and its load is spread as evenly as it can be.
    problem = nominal()
    problem = replace(problem, physics=replace(problem.physics, pad_friction=0.0, support_friction=0.0))
    terms = terms_of(problem)
    told, _ = solve_contacts(terms)
    other, _ = solve_cones(terms)
    np.testing.assert_allclose(velocity(terms, told), velocity(terms, other), atol=1e-6)
    assert np.linalg.norm(told) <= np.linalg.norm(other) * (1.0 + 1e-6)
    pads = told[:4] @ terms.normals[0]
    shift = np.array([1.0, -1.0, 1.0, -1.0]) / 2.0  # what four corners can pass around among them
    assert abs(pads @ shift) <= 1e-5 * np.linalg.norm(pads)


def test_every_listed_answer_obeys_the_laws() -> None:
    terms = terms_of(random_problem(PUSH, np.random.default_rng(SEVERAL)))
    answers = lawful_answers(terms)
    assert len(answers) > 1
    for answer in answers:
        opening, _ = terms.split((terms.jacobian @ answer).reshape(-1, 3))
        assert np.min(opening + terms.rebound) >= -1e-6
