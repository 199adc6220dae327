# SPDX-License-Identifier: Apache-2.0
"""The compiled map of one call and the map step by step in Python are one map; so are many questions at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import MODEL, PUSH, grab, nominal, one_point

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import Engine, ExactEngine, ImpactProblem
from impact_rs_sim.impact_map.batch import ImpactBatch, solve_batch
from impact_rs_sim.impact_map.cones import solve_cones, solve_contacts
from impact_rs_sim.impact_map.contacts import find_contacts
from impact_rs_sim.impact_map.exact import SOLVED, STATES, CompiledMap
from impact_rs_sim.impact_map.laws import (
    COMPLIANCE,
    ContactTerms,
    System,
    build_system,
    delassus,
    harden,
    linearise,
    newton,
    yielding_velocity,
)
from impact_rs_sim.impact_map.problem import check_problem
from impact_rs_sim.impact_map.sampling import random_problem
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.scene import ArmState

# ---- one call -------------------------------------------------------------------------------------------------------


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


def test_one_call_and_step_by_step_give_the_same_answer() -> None:
    for problem in problems():
        engine = ExactEngine(problem.physics)
        at_once, by_steps = engine._compiled_result(problem, 0.0), Engine.solve(engine, problem)
        assert at_once is not None
        for name in problem.arms:
            np.testing.assert_allclose(at_once.joint_velocity[name], by_steps.joint_velocity[name], atol=1e-9)
            np.testing.assert_allclose(at_once.end_effector_twist[name], by_steps.end_effector_twist[name], atol=1e-9)
        np.testing.assert_allclose(at_once.object_twist, by_steps.object_twist, atol=1e-9)
        assert len(at_once.contacts) == len(by_steps.contacts)
        for one, other in zip(at_once.contacts, by_steps.contacts, strict=True):
            assert (one.body_a, one.body_b) == (other.body_a, other.body_b)
            np.testing.assert_array_equal(one.position, other.position)
            np.testing.assert_array_equal(one.normal, other.normal)
            assert one.gap == other.gap
        system, terms = terms_of(problem)
        found = engine._compiled.answer(problem)
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


def test_answers_are_those_of_admm_and_newtons_method_where_there_is_one() -> None:
    compared = 0
    for problem in problems():
        _, terms = terms_of(problem)
        guess, converged = newton(terms, solve_cones(terms)[0])
        if not converged or not uniqueness_of(problem).relative <= 1e-7:
            continue
        change = terms.response @ (harden(terms, guess) - solve_contacts(terms)[0]).ravel()
        np.testing.assert_allclose(change, 0.0, atol=1e-9)
        compared += 1
    assert compared >= 3


def test_points_that_are_given_are_those_that_are_taken() -> None:
    problem = grab()
    _, terms = terms_of(problem)
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    found = compiled.answer(problem)
    again = compiled.answer(problem, terms.contacts)
    np.testing.assert_allclose(again.velocity, found.velocity, atol=1e-13)
    fewer = compiled.answer(problem, terms.contacts[:3])
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
    answer = CompiledMap(problem.physics, engine.models).answer(problem, grid)
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
        lambda problem: replace(problem, motor_inertia={"arm": -np.ones(7)}),
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
def test_what_is_out_of_the_ordinary_is_left_to_the_long_way(changed) -> None:
    problem = nominal()
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    assert compiled.answer(problem).status[0] == SOLVED
    found = compiled.answer(changed(problem))
    assert found is None or (found.status[0] != SOLVED and np.all(np.isnan(found.velocity)))


def test_a_measured_state_may_be_beyond_the_limits() -> None:
    problem = nominal()
    fast = replace(problem, arms={"arm": replace(problem.arms["arm"], velocity=np.full(7, 3.0))}, measured=True)
    compiled = CompiledMap(problem.physics, problem.physics.robot_models())
    assert compiled.answer(fast).status[0] == SOLVED


def test_an_object_that_cannot_be_is_refused() -> None:
    physics = replace(nominal().physics, pad_friction=-1.0)
    with pytest.raises(InputError, match="friction"):
        CompiledMap(physics, physics.robot_models())


# ---- many questions at once -----------------------------------------------------------------------------------------

COUNT = 6


def batch_about(problem, rng: np.random.Generator) -> ImpactBatch:
    """Velocities, configurations, motor inertia, restitution and friction that differ."""
    arms = {
        name: ArmState(
            state.position + 1e-5 * rng.standard_normal((COUNT, state.position.size)),
            state.velocity + 0.01 * rng.standard_normal((COUNT, state.position.size)),
        )
        for name, state in problem.arms.items()
    }
    motors = {name: values * rng.uniform(0.5, 1.5, (COUNT, 1)) for name, values in problem.motor_inertia.items()}
    restitution, friction = rng.uniform(0.0, 0.3, COUNT), rng.uniform(0.1, 0.9, COUNT)
    return ImpactBatch(problem.physics, arms, problem.object, motors, restitution, pad_friction=friction)


@pytest.mark.parametrize("case", [nominal, grab])
def test_every_row_is_the_answer_to_its_question(case) -> None:
    problem = case()
    batch = batch_about(problem, np.random.default_rng(5))
    found = solve_batch(batch)
    assert not found.refused
    for number in range(COUNT):
        asked = batch.problem(number)
        answer = ExactEngine(asked.physics).solve(asked)
        for name in problem.arms:
            np.testing.assert_array_equal(found.joint_velocity[name][number], answer.joint_velocity[name])
            np.testing.assert_array_equal(found.end_effector_twist[name][number], answer.end_effector_twist[name])
        np.testing.assert_array_equal(found.object_twist[number], answer.object_twist)
        assert found.residual[number] == answer.residual.largest
        assert found.contacts[number] == len(answer.contacts)


def test_what_does_not_differ_is_given_once() -> None:
    problem = nominal()
    scales = np.array([0.5, 1.0, 2.0])
    motors = {"arm": problem.motor_inertia["arm"] * scales[:, None]}
    found = solve_batch(ImpactBatch(problem.physics, problem.arms, problem.object, motors))
    speed = found.end_effector_twist["arm"][:, 1]
    assert speed.shape == (3,)
    assert np.all(np.diff(np.abs(speed)) > 0.0)  # a heavier arm loses less
    alone = solve_batch(ImpactBatch(problem.physics, problem.arms, problem.object, problem.motor_inertia))
    np.testing.assert_array_equal(alone.object_twist[0], found.object_twist[1])


def test_a_question_without_an_answer_costs_the_others_nothing() -> None:
    problem = nominal()
    batch = batch_about(problem, np.random.default_rng(6))
    batch.arms["arm"].velocity[2] = np.nan
    batch.restitution[4] = 1.5
    found = solve_batch(batch)
    assert set(found.refused) == {2, 4}
    assert "arms.arm.velocity" in found.refused[2]
    assert "restitution" in found.refused[4]
    lost = np.isnan(found.object_twist).all(axis=1)
    np.testing.assert_array_equal(lost, [False, False, True, False, True, False])
    assert np.isnan(found.residual[2]) and found.contacts[2] == 0


@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_a_motor_inertia_that_no_motor_has_is_refused(value: float) -> None:
    """A slightly negative one leaves M + B positive definite, so that only the check can notice."""
    batch = batch_about(nominal(), np.random.default_rng(8))
    batch.motor_inertia["arm"][3, 1] = value
    found = solve_batch(batch)
    assert set(found.refused) == {3}
    assert "motor_inertia.arm" in found.refused[3]
    assert np.isnan(found.object_twist[3]).all()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"restitution": np.zeros(4)}, "restitution"),
        ({"motor_inertia": {"arm": np.ones((6, 6))}}, r"motor_inertia\.arm"),
        ({"motor_inertia": {"other": np.ones(7)}}, "motor_inertia"),
    ],
)
def test_shapes_that_do_not_fit_are_told(changed, told: str) -> None:
    batch = replace(batch_about(nominal(), np.random.default_rng(7)), **changed)
    with pytest.raises(InputError, match=told):
        solve_batch(batch)
