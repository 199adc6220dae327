# SPDX-License-Identifier: Apache-2.0
"""The compiled call and the terms of :mod:`impact_rs_sim.impact_map.laws` in Python are one impact map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import MODEL, PUSH, grab, nominal, one_point
from random_impacts import random_problem

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ExactEngine, ImpactProblem
from impact_rs_sim.impact_map.contacts import find_contacts
from impact_rs_sim.impact_map.laws import (
    COMPLIANCE,
    ContactTerms,
    System,
    build_system,
    delassus,
    linearise,
    solve_contacts,
    yielding_velocity,
)
from impact_rs_sim.impact_map.problem import check_problem
from impact_rs_sim.impact_map.solve import SOLVED, STATES, CompiledMap


def problems() -> list[ImpactProblem]:
    """Impacts of all kinds: random ones, two arms, restitution, a centre of mass aside, a single point."""
    some = [random_problem(PUSH, np.random.default_rng([11, seed])) for seed in range(12)]
    return [*some, grab(), grab(pad_friction=2.0), replace(nominal(), restitution=0.4), one_point()]


def terms_of(problem: ImpactProblem) -> tuple[System, ContactTerms]:
    models = problem.physics.robot_models()
    found = check_problem(problem, models)
    system = build_system(problem, models)
    return system, ContactTerms.of(system, find_contacts(problem.physics, found), problem.restitution)


def test_one_pass_over_the_chain_gives_what_three_give() -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(MODEL.position_min, MODEL.position_max, (5, MODEL.joint_count)):
        inertia, jacobian, place = (np.array(part) for part in MODEL.at_impact(q))
        np.testing.assert_allclose(np.triu(inertia), np.triu(MODEL.mass_matrix(q)), atol=1e-13)
        np.testing.assert_allclose(jacobian, MODEL.jacobian(q), atol=1e-13)
        np.testing.assert_allclose(place, MODEL.placement(q).homogeneous, atol=1e-13)


def test_one_call_and_the_terms_in_python_give_the_same_answer() -> None:
    for problem in problems():
        at_once = ExactEngine(problem.physics).solve(problem)
        system, terms = terms_of(problem)
        after = terms.before + terms.response @ solve_contacts(terms)[0].ravel()
        joints, twists, object_twist = system.split(after)
        for name in problem.arms:
            np.testing.assert_allclose(at_once.joint_velocity[name], joints[name], atol=1e-9)
            np.testing.assert_allclose(at_once.end_effector_twist[name], twists[name], atol=1e-9)
        np.testing.assert_allclose(at_once.object_twist, object_twist, atol=1e-9)
        assert len(at_once.contacts) == len(terms.contacts)
        for one, other in zip(at_once.contacts, terms.contacts, strict=True):
            assert (one.body_a, one.body_b) == ("object", other.partner)
            np.testing.assert_array_equal(one.position, other.position)
            np.testing.assert_array_equal(one.normal, other.normal)
            assert one.gap == other.gap
        found = CompiledMap(problem.physics, problem.physics.robot_models()).solve(problem)
        impulses = found.impulse
        velocity = system.velocity + terms.response @ impulses.ravel()
        np.testing.assert_allclose(found.velocity[0], velocity, atol=1e-12)
        judged = terms.residual(impulses, velocity)
        np.testing.assert_allclose(found.residual[0], list(vars(judged).values()), atol=1e-12)
        assert found.energy[0, 0] == pytest.approx(system.kinetic_energy, rel=1e-12)
        change = velocity @ system.inertia @ velocity - system.velocity @ system.inertia @ system.velocity
        assert found.energy[0, 1] == pytest.approx(0.5 * change, abs=1e-10)
        assert judged.largest <= 1e-10
        linear = linearise(terms, impulses, yielding_velocity(terms, delassus(terms), impulses))
        told = [STATES[state] for state in found.state]
        # What an answer is told as is where Newton's method ended, before the compliance was taken out.
        yielded = COMPLIANCE * terms.mobility * np.abs(impulses).max(initial=0.0)
        at_a_kink = linear.margin < 1e-9 + 2.0 * yielded
        assert all(one == other or kink for one, other, kink in zip(told, linear.state, at_a_kink, strict=True))


def test_points_that_are_given_are_those_that_are_taken() -> None:
    problem = grab()
    _, terms = terms_of(problem)
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    found = compiled.solve(problem)
    again = compiled.solve(problem, terms.contacts)
    np.testing.assert_allclose(again.velocity, found.velocity, atol=1e-13)
    fewer = compiled.solve(problem, terms.contacts[:3])
    assert len(fewer.impulse) == 3


def test_many_points_solved_through_velocities_agree_with_impulses() -> None:
    problem = nominal()
    engine = ExactEngine(problem.physics)
    found = check_problem(problem, engine.models)
    pad = [point for point in find_contacts(problem.physics, found) if point.partner == "arm"]
    first, second, third, fourth = (point.position for point in pad)
    shares = np.linspace(0.0, 1.0, 5)
    grid = [
        replace(pad[0], position=(1 - v) * ((1 - u) * first + u * second) + v * ((1 - u) * fourth + u * third))
        for u in shares
        for v in shares
    ]
    system = build_system(problem, engine.models)
    terms = ContactTerms.of(system, grid, 0.0)
    impulses, solved, _ = terms.kernel.solve(COMPLIANCE)  # which knows no more than the Delassus operator
    assert solved
    answer = CompiledMap(problem.physics, engine.models).solve(problem, grid)
    assert answer is not None
    assert answer.status[0] == SOLVED
    np.testing.assert_allclose(answer.velocity[0], system.velocity + terms.response @ impulses.ravel(), atol=1e-12)
    np.testing.assert_allclose(answer.impulse, impulses, atol=1e-6)  # twenty of which nothing depends on
    assert answer.residual.max() <= 1e-12


@pytest.mark.parametrize(
    "changed",
    [
        lambda problem: replace(problem, restitution_law="poisson"),
        lambda problem: replace(problem, restitution=1.5),
        lambda problem: replace(problem, arms={}),
        lambda problem: replace(problem, motor_inertia={"arm": np.full(7, -1e-3)}),
        lambda problem: replace(problem, motor_inertia={"arm": np.full(7, np.nan)}),
        lambda problem: replace(problem, motor_inertia={"arm": np.ones(6)}),
        lambda problem: replace(problem, object=replace(problem.object, rotation=2.0 * np.eye(3))),
        lambda problem: replace(problem, object=replace(problem.object, rotation=-np.eye(3))),
        lambda problem: replace(problem, object=replace(problem.object, twist=np.full(6, np.inf))),
        lambda problem: replace(
            problem, object=replace(problem.object, position=problem.object.position + [0.0, 0.01, 0.0])
        ),
        lambda problem: replace(problem, arms={"arm": replace(problem.arms["arm"], velocity=np.full(7, 3.0))}),
        lambda problem: replace(problem, arms={"arm": replace(problem.arms["arm"], position=np.full(7, 9.0))}),
    ],
)
def test_the_compiled_call_refuses_invalid_data(changed) -> None:
    problem = nominal()
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    assert compiled.solve(problem).status[0] == SOLVED
    found = compiled.solve(changed(problem))
    assert found is None or (found.status[0] != SOLVED and np.all(np.isnan(found.velocity)))


def test_a_measured_state_may_be_beyond_the_limits() -> None:
    problem = nominal()
    fast = replace(problem, arms={"arm": replace(problem.arms["arm"], velocity=np.full(7, 3.0))}, measured=True)
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    assert compiled.solve(fast).status[0] == SOLVED


def test_an_object_that_cannot_be_is_refused() -> None:
    physics = replace(nominal().physics, pad_friction=-1.0)
    with pytest.raises(InputError, match="friction"):
        CompiledMap(physics, physics.robot_models())
