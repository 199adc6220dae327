# SPDX-License-Identifier: Apache-2.0
"""All bodies as one system: inertias, Jacobians and energy against finite differences and sums over point masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from impact_map_cases import ENGINES, MODEL, SCENE, nominal, one_point, with_velocity
from trials import scene_of

from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy
from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.laws import System, build_system, point_maps
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scene import BodyState

COM = np.array([0.03, -0.02, 0.04])
TWIST = np.array([0.2, -0.3, 0.1, 1.0, -2.0, 0.5])
TURN = pin.rpy.rpyToMatrix(0.4, -0.3, 0.8)


def turned(com: np.ndarray = COM) -> ImpactProblem:
    """The nominal problem with an object off its centre, turned and in motion."""
    problem = nominal("rotor")
    thing = problem.physics.object
    physics = replace(problem.physics, object=ObjectPhysics(thing.mass, thing.size, thing.inertia, com))
    return replace(problem, physics=physics, object=BodyState(problem.object.position, TURN, TWIST))


def masses(thing: ObjectPhysics) -> tuple[np.ndarray, np.ndarray]:
    """Point masses with the object's mass and moments: places ``(6, 3)`` from its centre of mass, masses ``(6,)``."""
    x, y, z = thing.inertia
    spread = np.sqrt(np.array([y + z - x, x + z - y, x + y - z]) / 2.0 / (thing.mass / 3.0))
    places = np.array([sign * spread[axis] * np.eye(3)[axis] for axis in range(3) for sign in (-1.0, 1.0)])
    return places, np.full(6, thing.mass / 6.0)


def test_the_object_has_energy_and_momentum_of_its_point_masses() -> None:
    problem = turned()
    thing = problem.physics.object
    places, weights = masses(thing)
    places = (places + COM) @ TURN.T  # from the geometric centre, in axes of A
    velocities = TWIST[:3] + np.cross(TWIST[3:], places)
    system = build_system(problem, SCENE.models)
    inertia = system.inertia[system.columns["object"], system.columns["object"]]
    momentum = weights @ velocities
    spin = np.sum(np.cross(places, weights[:, None] * velocities), axis=0)
    np.testing.assert_allclose(inertia @ TWIST, np.concatenate((momentum, spin)), atol=1e-12)
    arm = problem.arms["arm"].velocity
    motors = MODEL.mass_matrix(problem.arms["arm"].position) + np.diag(problem.motor_inertia["arm"])
    of_object = 0.5 * weights @ np.sum(velocities**2, axis=1)
    assert kinetic_energy(problem) == pytest.approx(of_object + 0.5 * arm @ motors @ arm)


def test_energy_after_the_impact_is_that_of_the_answer() -> None:
    problem = nominal()
    answer = compute_impact_map(problem, "exact")
    state = problem.arms["arm"]
    motors = MODEL.mass_matrix(state.position) + np.diag(problem.motor_inertia["arm"])
    dq, twist, thing = answer.joint_velocity["arm"], answer.object_twist, problem.physics.object
    expected = 0.5 * dq @ motors @ dq + 0.5 * thing.mass * twist[:3] @ twist[:3] + 0.5 * thing.inertia @ twist[3:] ** 2
    assert kinetic_energy(problem, answer) == pytest.approx(expected)
    assert kinetic_energy(problem, answer) < kinetic_energy(problem)


def test_motor_inertia_stands_on_the_diagonal_of_its_arm_alone() -> None:
    problem = turned()
    system = build_system(problem, SCENE.models)
    difference = system.inertia - system.link_inertia
    where = system.columns["arm"]
    np.testing.assert_allclose(difference[where, where], np.diag(SCENE.physics.arms["arm"].motor_inertia_rotor))
    difference[where, where] = 0.0
    np.testing.assert_array_equal(difference, 0.0)
    np.testing.assert_allclose(system.link_inertia[where, where], MODEL.mass_matrix(problem.arms["arm"].position))


def test_every_arm_and_the_object_have_columns_of_their_own() -> None:
    scene = scene_of("grab", "juice", "case_1")
    problem = ImpactProblem.at_nominal_impact(scene)
    system = build_system(problem, scene.models)
    joints, twists, object_twist = system.split(system.velocity)
    for name, state in scene.arms.items():
        np.testing.assert_array_equal(joints[name], state.velocity)
        np.testing.assert_allclose(twists[name], scene.models[name].jacobian(state.position) @ state.velocity)
        others = [system.columns[other] for other in system.columns if other != name]
        for columns in others:
            assert not np.any(system.inertia[system.columns[name], columns])
    np.testing.assert_array_equal(object_twist, scene.object.twist)


def contact(partner: str, position: np.ndarray, gap: float = 0.0) -> ContactPoint:
    return ContactPoint(partner, position, np.array([0.0, -1.0, 0.0]), gap, 0.5)


def relative(system: System, problem: ImpactProblem, point: ContactPoint) -> np.ndarray:
    """Velocity of the object's point relative to its partner's, by moving both a little."""
    step = 1e-7
    body = problem.object
    local = body.rotation.T @ (point.position - body.position)
    moved = body.position + step * body.twist[:3] + pin.exp3(step * body.twist[3:]) @ body.rotation @ local
    of_object = (moved - point.position) / step
    if point.partner == "support":
        return of_object
    state = problem.arms["arm"]
    local = MODEL.placement(state.position).actInv(point.partner_position)
    moved = MODEL.placement(state.position + step * state.velocity).act(local)
    return of_object - (moved - point.partner_position) / step


@pytest.mark.parametrize("partner", ["arm", "support"])
@pytest.mark.parametrize("gap", [0.0, 5e-4])
def test_the_contact_jacobian_gives_the_relative_velocity(partner: str, gap: float) -> None:
    rng = np.random.default_rng(4)
    problem = with_velocity(turned(), rng.uniform(-0.5, 0.5, 7))
    system = build_system(problem, SCENE.models)
    points = [
        contact(partner, problem.object.position + shift, gap) for shift in (np.zeros(3), np.array([0.05, 0.08, -0.06]))
    ]
    rows = (system.jacobian(points) @ system.velocity).reshape(-1, 3)
    for row, point in zip(rows, points, strict=True):
        np.testing.assert_allclose(row, relative(system, problem, point), atol=1e-5)


def test_a_point_of_a_turning_body_moves_with_the_cross_product() -> None:
    levers = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3))
    np.testing.assert_allclose(point_maps(levers) @ TWIST, TWIST[:3] + np.cross(TWIST[3:], levers), atol=1e-14)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_hit_turns_an_object_about_its_centre_of_mass_wherever_that_is(engine: str, side: float) -> None:
    """One frictionless point: L = (1 + e) v_n / (1/m_arm + 1/m + (r x n)^T I^-1 (r x n)), r from the centre of mass."""
    thing = SCENE.physics.object
    shifted = ObjectPhysics(thing.mass, thing.size, thing.inertia, side * np.array([0.06, 0.02, -0.03]))
    problem = one_point(pad_friction=0.0, object=shifted)
    state, body = problem.arms["arm"], problem.object
    result = compute_impact_map(problem, engine)
    (point,) = result.contacts
    offset = body.rotation @ shifted.com_offset
    spin = np.cross(point.position - body.position - offset, point.normal)
    moments = body.rotation @ np.diag(thing.inertia) @ body.rotation.T
    lever = np.cross(point.position - MODEL.placement(state.position).translation, point.normal)
    row = np.concatenate((point.normal, lever)) @ MODEL.jacobian(state.position)
    inertia = MODEL.mass_matrix(state.position) + np.diag(problem.motor_inertia["arm"])
    mobility = row @ np.linalg.solve(inertia, row) + 1.0 / thing.mass + spin @ np.linalg.solve(moments, spin)
    impulse = row @ state.velocity / mobility
    turning = np.linalg.solve(moments, spin) * impulse
    np.testing.assert_allclose(result.object_twist[3:], turning, atol=1e-5)
    np.testing.assert_allclose(
        result.object_twist[:3], impulse / thing.mass * point.normal - np.cross(turning, offset), atol=2e-6
    )
