# SPDX-License-Identifier: Apache-2.0
"""The laws of an impact, held against both engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from impact_map_cases import ENGINES, MODEL, PUSH, SCENE, nominal, one_point, with_velocity
from random_impacts import random_problem

from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy
from impact_rs_sim.impact_map.contacts import contact_pairs, find_contacts
from impact_rs_sim.impact_map.laws import build_system
from impact_rs_sim.scene import BodyState, Scene

pytestmark = pytest.mark.parametrize("engine", ENGINES)
ARM = SCENE.physics.arms["arm"]
MOTORS = {
    "zero": np.zeros(7),
    "reduced": ARM.motor_inertia_reduced,
    "rotor": ARM.motor_inertia_rotor,
    "random": np.array([0.31, 0.02, 0.77, 0.10, 0.44, 0.005, 0.21]),
}
ONE_POINT = one_point(pad_friction=0.0)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("motor", MOTORS)
def test_one_frictionless_contact_follows_the_effective_masses(engine: str, motor: str, restitution: float) -> None:
    problem = replace(ONE_POINT, motor_inertia={"arm": MOTORS[motor]}, restitution=restitution)
    state, body, thing = problem.arms["arm"], problem.object, problem.physics.object
    result = compute_impact_map(problem, engine)
    (contact,) = result.contacts
    normal, point = contact.normal, contact.position
    # 1/m of the object at the point, and of the arm: n^T J (M + B)^-1 J^T n
    lever = np.cross(point - body.position, normal)
    inertia = body.rotation @ np.diag(thing.inertia) @ body.rotation.T
    of_object = 1.0 / thing.mass + lever @ np.linalg.solve(inertia, lever)
    jacobian = MODEL.jacobian(state.position)
    arm_lever = point - MODEL.placement(state.position).translation
    row = normal @ jacobian[:3] + np.cross(arm_lever, normal) @ jacobian[3:]
    mass = MODEL.mass_matrix(state.position) + np.diag(MOTORS[motor])
    of_arm = row @ np.linalg.solve(mass, row)
    impulse = (1.0 + restitution) * (row @ state.velocity) / (of_object + of_arm)
    expected = state.velocity - np.linalg.solve(mass, row) * impulse
    np.testing.assert_allclose(result.joint_velocity["arm"], expected, atol=2e-6)
    np.testing.assert_allclose(result.object_twist[:3], impulse / thing.mass * normal, atol=2e-6)
    np.testing.assert_allclose(contact.impulse, impulse * normal, atol=2e-6)


def test_separating_contact_gets_no_impulse(engine: str) -> None:
    problem = nominal()
    problem = with_velocity(problem, -problem.arms["arm"].velocity)
    result = compute_impact_map(problem, engine)
    np.testing.assert_allclose(result.joint_velocity["arm"], problem.arms["arm"].velocity, atol=1e-6)
    np.testing.assert_allclose([contact.impulse for contact in result.contacts], 0.0, atol=1e-6)


def test_without_contact_nothing_happens(engine: str) -> None:
    problem = nominal()
    away = BodyState(problem.object.position - np.array([0.0, 0.01, -0.01]), np.eye(3), np.zeros(6))
    result = compute_impact_map(replace(problem, object=away), engine)
    assert result.contacts == ()
    np.testing.assert_array_equal(result.joint_velocity["arm"], problem.arms["arm"].velocity)
    np.testing.assert_array_equal(result.object_twist, np.zeros(6))


@pytest.mark.parametrize("mass", [0.3, 1.3, 5.0])
def test_momentum_is_balanced_by_the_impulses(engine: str, mass: float) -> None:
    thing = SCENE.physics.object
    problem = nominal(object=replace(thing, mass=mass, inertia=thing.inertia * mass / thing.mass))
    result = compute_impact_map(problem, engine)
    total = sum(contact.impulse for contact in result.contacts)
    np.testing.assert_allclose(mass * result.object_twist[:3], total, atol=2e-4)


def test_paper_velocity_after_impact_is_met(engine: str) -> None:
    result = compute_impact_map(nominal("reduced"), engine)
    assert -result.end_effector_twist["arm"][1] == pytest.approx(0.55, abs=0.01)  # m/s, the paper has 0.544


def test_mirrored_scene_gives_the_mirrored_answer(engine: str) -> None:
    # A pad that hits the middle of the face without spinning it: mirror the object's offset, and its spin mirrors.
    answers = []
    for side in (1.0, -1.0):
        problem = nominal(pad_friction=0.0, support_height=None)
        problem = replace(problem, motor_inertia={"arm": np.full(7, 1e5)})
        body = problem.object
        moved = BodyState(body.position + np.array([side * 0.03, 0.0, 0.0]), body.rotation, np.zeros(6))
        answers.append(compute_impact_map(replace(problem, object=moved), engine).object_twist)
    np.testing.assert_allclose(answers[0], answers[1] * np.array([-1, 1, 1, 1, -1, -1]), atol=2e-4)


def test_redundant_contacts_do_not_spin_a_symmetric_scene(engine: str) -> None:
    problem = nominal(pad_friction=0.3)
    problem = replace(problem, motor_inertia={"arm": np.full(7, 1e5)})  # a pad that moves straight on
    twist = compute_impact_map(problem, engine).object_twist
    np.testing.assert_allclose(twist[[0, 2, 3, 4, 5]], 0.0, atol=2e-4)


def test_same_question_gets_the_same_answer(engine: str) -> None:
    first, other = nominal("rotor"), nominal("zero")
    before = compute_impact_map(first, engine)
    compute_impact_map(other, engine)
    after = compute_impact_map(first, engine)
    np.testing.assert_allclose(after.joint_velocity["arm"], before.joint_velocity["arm"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(after.object_twist, before.object_twist, rtol=0, atol=1e-10)


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6), restitution=st.floats(0.0, 1.0))
def test_frictionless_impact_never_adds_energy(engine: str, seed: int, restitution: float) -> None:
    problem = random_problem(PUSH, np.random.default_rng(seed), restitution)
    problem = replace(problem, physics=replace(problem.physics, pad_friction=0.0, support_friction=0.0))
    result = compute_impact_map(problem, engine)
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-3)


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_inelastic_impact_with_friction_never_adds_energy(engine: str, seed: int) -> None:
    problem = random_problem(PUSH, np.random.default_rng(seed), 0.0)
    result = compute_impact_map(problem, engine)
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-3)


def test_friction_stays_in_its_cone_and_normals_push(engine: str) -> None:
    result = compute_impact_map(nominal(), engine)
    for contact in result.contacts:
        friction = SCENE.physics.support_friction if contact.body_b == "support" else SCENE.physics.pad_friction
        pressing = float(contact.normal @ contact.impulse)
        assert pressing >= -1e-6
        assert np.linalg.norm(contact.impulse - pressing * contact.normal) <= friction * pressing + 1e-4


def test_faster_hit_scales_the_answer(engine: str) -> None:
    # The laws are homogeneous in the velocities.
    problem = ImpactProblem.at_nominal_impact(Scene.resolve(PUSH, "cat_food", "case_1"))
    slow = compute_impact_map(problem, engine)
    fast = compute_impact_map(with_velocity(problem, 1.4 * problem.arms["arm"].velocity), engine)
    np.testing.assert_allclose(fast.object_twist, 1.4 * slow.object_twist, atol=5e-4)


def test_jacobian_is_the_velocity_of_the_contact_points(engine: str) -> None:
    problem = nominal()
    placements = {"arm": MODEL.placement(problem.arms["arm"].position)}
    contacts = find_contacts(problem.physics, contact_pairs(problem.physics, problem.object, placements))
    system = build_system(problem, SCENE.models)
    rows = (system.jacobian(contacts) @ system.velocity).reshape(-1, 3)
    step = 1e-7
    moved = MODEL.placement(problem.arms["arm"].position + step * problem.arms["arm"].velocity)
    for contact, row in zip(contacts, rows, strict=True):
        if contact.partner == "arm":
            local = placements["arm"].actInv(contact.partner_position)
            velocity = (moved.act(local) - contact.partner_position) / step
            np.testing.assert_allclose(row, -velocity, atol=1e-5)


def test_two_arms_that_grab_from_both_sides_leave_the_object_at_rest(engine: str) -> None:
    problem = nominal()
    body = problem.object
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.zeros(3))
    centre = pin.SE3(np.eye(3), body.position * np.array([1.0, 1.0, 0.0]))
    other = replace(ARM, base=centre * turn * centre.inverse() * ARM.base)
    state, motor = problem.arms["arm"], problem.motor_inertia["arm"]
    result = compute_impact_map(
        replace(
            problem,
            physics=replace(problem.physics, arms={"left": ARM, "right": other}),
            arms={"left": state, "right": state},
            motor_inertia={"left": motor, "right": motor},
        ),
        engine,
    )
    assert sorted({contact.body_b for contact in result.contacts}) == ["left", "right", "support"]
    np.testing.assert_allclose(result.object_twist[[0, 1, 3, 4]], 0.0, atol=2e-3)
    np.testing.assert_allclose(result.end_effector_twist["left"][1], 0.0, atol=2e-3)
    np.testing.assert_allclose(result.end_effector_twist["right"][1], 0.0, atol=2e-3)
