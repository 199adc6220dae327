# SPDX-License-Identifier: Apache-2.0
"""The end of the sequence of impacts: closed forms, conservation, limits, and which contacts last."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from impact_map_cases import MODEL, PUSH, SCENE, disagreement, grab, nominal, one_point, with_velocity
from random_impacts import random_problem

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import (
    ImpactProblem,
    ImpactResult,
    compute_impact_map,
    kinetic_energy,
    predict_impact,
    settle,
)
from impact_rs_sim.impact_map.contacts import SUPPORT, ContactPoint
from impact_rs_sim.impact_map.laws import System, build_system
from impact_rs_sim.impact_map.settled import close_contacts
from impact_rs_sim.scene import BodyState

X, Y, Z = np.eye(3)
TOLERANCE = 2e-6  # m/s, rad/s or N s, beside 1: that of the solver
FIXED = 1e6  # kg, kg m^2: nothing moves it


def bodies(
    pad_mass: float, mass: float, inertia: tuple[float, float, float], pad_twist: list[float], twist: list[float]
) -> System:
    """A free body as the only arm, with frame E at the origin, and an object its centre 0.1 m beyond it along y."""
    spatial = np.zeros((12, 12))
    spatial[:3, :3] = pad_mass * np.eye(3)
    spatial[3:6, 3:6] = pad_mass * np.eye(3)
    spatial[6:9, 6:9] = mass * np.eye(3)
    spatial[9:, 9:] = np.diag(inertia)
    return System(
        columns={"arm": slice(0, 6), "object": slice(6, 12)},
        inertia=spatial,
        link_inertia=spatial,
        velocity=np.array([*pad_twist, *twist], dtype=float),
        end_effector_position={"arm": np.zeros(3)},
        end_effector_jacobian={"arm": np.eye(6)},
        object_position=0.1 * Y,
    )


def face(friction: float, half: float = 0.05, name: str = "arm") -> list[ContactPoint]:
    """Corners of a square face in the plane y = 0, whose normal into the object is y."""
    corners = [(half, half), (half, -half), (-half, -half), (-half, half)]
    return [ContactPoint(name, np.array([x, 0.0, z]), Y, 0.0, friction) for x, z in corners]


def momentum(system: System, velocity: np.ndarray) -> np.ndarray:
    """Linear momentum and angular momentum about the origin of A of :func:`bodies`, ``(6,)`` [kg m/s, kg m^2/s]."""
    of_pad, of_object = np.split(system.inertia @ velocity, 2)
    return np.concatenate(
        (of_pad[:3] + of_object[:3], of_pad[3:] + of_object[3:] + np.cross(system.object_position, of_object[:3]))
    )


def test_two_masses_that_meet_head_on_go_on_with_their_common_momentum() -> None:
    system = bodies(2.0, 3.0, (1.0, 1.0, 1.0), [0, 0.5, 0, 0, 0, 0], [0, -0.1, 0, 0, 0, 0])
    found = close_contacts(system, {"arm": face(0.5)}, [])
    common = (2.0 * 0.5 - 3.0 * 0.1) / 5.0
    np.testing.assert_allclose(found.velocity, np.tile([0, common, 0, 0, 0, 0], 2), atol=TOLERANCE)
    np.testing.assert_allclose(np.sum(found.impulses, axis=0), 3.0 * (common + 0.1) * Y, atol=TOLERANCE)
    np.testing.assert_allclose(found.impulses, np.tile(np.sum(found.impulses, axis=0) / 4.0, (4, 1)), atol=TOLERANCE)


def test_two_bodies_that_stick_keep_their_momentum_and_have_one_twist() -> None:
    system = bodies(2.0, 1.5, (0.01, 0.02, 0.015), [0.1, 0.9, -0.05, 0.2, -0.1, 0.3], [0.05, -0.4, 0.02, -0.3, 0.1, 0])
    found = close_contacts(system, {"arm": face(5.0)}, [])
    assert found.lasting == ("arm",)
    np.testing.assert_allclose(momentum(system, found.velocity), momentum(system, system.velocity), atol=TOLERANCE)
    pad, thing = np.split(found.velocity, 2)
    np.testing.assert_allclose(pad[3:], thing[3:], atol=TOLERANCE)
    np.testing.assert_allclose(thing[:3], pad[:3] + np.cross(pad[3:], 0.1 * Y), atol=TOLERANCE)


def test_a_rod_that_an_edge_stops_turns_about_it() -> None:
    # A uniform rod along x comes down on a fixed edge under its end: w = m v l/2 / (m l^2 / 3) = 3 v / (2 l).
    length, mass, speed = 0.4, 1.3, 0.7
    inertia = mass * length**2 / 12.0
    system = bodies(FIXED, mass, (1e-3, inertia, inertia), [0] * 6, [0, -speed, 0, 0, 0, 0])
    system = replace(system, object_position=np.array([length / 2.0, 0.0, 0.0]))
    edge = [ContactPoint("arm", z * Z, Y, 0.0, 1.0) for z in (0.01, -0.01)]
    found = close_contacts(system, {"arm": edge}, [])
    np.testing.assert_allclose(found.velocity[9:], -1.5 * speed / length * Z, atol=TOLERANCE)
    np.testing.assert_allclose(np.sum(found.impulses, axis=0), mass * speed / 4.0 * Y, atol=TOLERANCE)


def test_a_rod_gripped_at_its_end_gives_all_momentum_to_the_grip() -> None:
    length, mass, speed = 0.4, 1.3, 0.7
    inertia = mass * length**2 / 12.0
    system = bodies(FIXED, mass, (1e-3, inertia, inertia), [0] * 6, [0, -speed, 0, 0, 0, 0])
    system = replace(system, object_position=np.array([length / 2.0, 0.0, 0.0]))
    points = face(1.0, 0.01)
    found = close_contacts(system, {"arm": points}, [])
    np.testing.assert_allclose(found.velocity, 0.0, atol=TOLERANCE)
    grip = sum(np.cross(point.position, impulse) for point, impulse in zip(points, found.impulses, strict=True))
    np.testing.assert_allclose(np.sum(found.impulses, axis=0), mass * speed * Y, atol=TOLERANCE)
    np.testing.assert_allclose(grip, mass * speed * length / 2.0 * Z, atol=TOLERANCE)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4])
def test_a_sliding_face_hands_on_friction_by_its_pressure(friction: float) -> None:
    system = bodies(FIXED, 1.3, (0.01, 0.01, 0.01), [0.6, 0.5, -0.8, 0, 0, 0], [0] * 6)
    found = close_contacts(system, {"arm": face(friction)}, [])
    # It would take twice the pressure to hold it.
    np.testing.assert_allclose(found.velocity[6:9], [0.6 * friction * 0.5, 0.5, -0.8 * friction * 0.5], atol=TOLERANCE)
    np.testing.assert_allclose(found.velocity[9:], 0.0, atol=TOLERANCE)


@pytest.mark.parametrize("friction", [0.9, 0.99, 1.01, 1.5])
def test_a_face_sticks_from_the_friction_on_that_holds_it(friction: float) -> None:
    system = bodies(FIXED, 1.3, (0.1, 0.1, 0.1), [0.5, 0.5, 0, 0, 0, 0], [0] * 6)
    system = replace(system, object_position=np.zeros(3))  # no lever: the tangential impulse turns nothing
    found = close_contacts(system, {"arm": face(friction)}, [])
    np.testing.assert_allclose(found.velocity[6:], [0.5 * min(friction, 1.0), 0.5, 0, 0, 0, 0], atol=TOLERANCE)


def test_a_face_resists_turning_by_friction_at_its_corners() -> None:
    spin, moment, friction = 3.0, 0.02, 0.1
    system = bodies(FIXED, 1.3, (1.0, moment, 1.0), [0, 0.5, 0, 0, spin, 0], [0] * 6)
    found = close_contacts(system, {"arm": face(friction)}, [])
    handed_on = friction * 1.3 * 0.5 * np.hypot(0.05, 0.05) / moment
    np.testing.assert_allclose(found.velocity[6:], [0, 0.5, 0, 0, handed_on, 0], atol=TOLERANCE)


def test_a_pad_that_moves_off_does_not_pull_the_object_along() -> None:
    system = bodies(2.0, 3.0, (1.0, 1.0, 1.0), [0, -0.5, 0, 0, 0, 0], [0] * 6)
    found = close_contacts(system, {"arm": face(0.5)}, [])
    assert found.lasting == ()
    np.testing.assert_allclose(found.velocity, system.velocity, atol=TOLERANCE)
    np.testing.assert_allclose(found.impulses, 0.0, atol=TOLERANCE)


def test_a_pad_that_turns_off_its_face_is_not_kept_on_it() -> None:
    system = bodies(2.0, 3.0, (1.0, 1.0, 1.0), [0, -0.5, 0, 0.3, 0, 0.4], [0] * 6)
    found = close_contacts(system, {"arm": face(0.5)}, [])
    np.testing.assert_allclose(found.velocity, system.velocity, atol=TOLERANCE)
    np.testing.assert_allclose(found.impulses, 0.0, atol=TOLERANCE)


def test_more_points_on_a_face_share_the_same_impulse() -> None:
    system = bodies(2.0, 1.5, (0.01, 0.02, 0.015), [0.1, 0.9, -0.05, 0.2, -0.1, 0.3], [0.05, -0.4, 0.02, -0.3, 0.1, 0])
    few = close_contacts(system, {"arm": face(5.0)}, [])
    many = close_contacts(system, {"arm": [*face(5.0), *face(5.0), *face(5.0, 0.02)]}, [])
    np.testing.assert_allclose(many.velocity, few.velocity, atol=TOLERANCE)
    np.testing.assert_allclose(np.sum(many.impulses, axis=0), np.sum(few.impulses, axis=0), atol=TOLERANCE)
    np.testing.assert_allclose(many.impulses[:4], many.impulses[4:8], atol=TOLERANCE)  # least norm has no favourites


def of_result(problem: ImpactProblem, result: ImpactResult) -> np.ndarray:
    """u^+ as one vector."""
    return np.concatenate([*(result.joint_velocity[name] for name in problem.arms), result.object_twist])


def relative_twist(problem: ImpactProblem, result: ImpactResult, name: str) -> np.ndarray:
    """Twist of the object relative to a pad, at E in E[A], ``(6,)``."""
    position = problem.physics.robot_model(name).placement(problem.arms[name].position).translation
    lever = position - problem.object.position
    twist = result.object_twist
    at_pad = np.concatenate((twist[:3] + np.cross(twist[3:], lever), twist[3:]))
    return np.asarray(at_pad - result.end_effector_twist[name])


@pytest.mark.parametrize("motor_inertia", ["zero", "reduced", "rotor"])
def test_where_the_first_impact_has_closed_the_faces_it_is_the_end(motor_inertia: str) -> None:
    problem = nominal(motor_inertia)
    first, settled = compute_impact_map(problem, "exact"), settle(problem)
    assert np.max(np.abs(relative_twist(problem, first, "arm"))) < 1e-6
    assert disagreement(first, settled) < 2e-6


def test_pads_that_grab_move_on_the_box_at_first_and_not_in_the_end() -> None:
    problem = grab()
    first, settled = compute_impact_map(problem, "exact"), settle(problem)
    for name in problem.arms:
        assert np.max(np.abs(relative_twist(problem, first, name))) > 0.02
        np.testing.assert_allclose(relative_twist(problem, settled, name), 0.0, atol=TOLERANCE)


def test_the_end_is_the_nearest_motion_in_kinetic_energy() -> None:
    problem = grab()
    system = build_system(problem, problem.physics.robot_models())
    found = of_result(problem, settle(problem))
    rows = []
    for name in problem.arms:  # six velocity components of each pad, in place of its points
        lever = system.end_effector_position[name] - system.object_position
        of_object = np.eye(6)
        of_object[:3, 3:] = -pin.skew(lever)
        row = np.zeros((6, system.velocity.size))
        row[:, system.columns["object"]] = of_object
        row[:, system.columns[name]] = -system.end_effector_jacobian[name]
        rows.append(row)
    ties = np.vstack(rows)
    response = np.linalg.solve(system.inertia, ties.T)
    nearest = system.velocity - response @ np.linalg.solve(ties @ response, ties @ system.velocity)
    np.testing.assert_allclose(found, nearest, atol=TOLERANCE)

    def distance(velocity: np.ndarray) -> float:
        jump = velocity - system.velocity
        return float(jump @ system.inertia @ jump)

    rng = np.random.default_rng(0)
    allowed = np.eye(system.velocity.size) - np.linalg.pinv(ties) @ ties
    for _ in range(20):
        other = nearest + allowed @ rng.normal(size=found.size) * 0.1
        np.testing.assert_allclose(ties @ other, 0.0, atol=1e-10)
        assert distance(other) > distance(nearest)


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_energy_never_rises_and_impulses_explain_every_velocity(seed: int) -> None:
    problem = random_problem(PUSH, np.random.default_rng(seed))
    result = settle(problem)
    before = kinetic_energy(problem)
    assert kinetic_energy(problem, result) <= before * (1.0 + 1e-6)
    thing, body = problem.physics.object, problem.object
    offset = body.rotation @ thing.com_offset
    total = sum((contact.impulse for contact in result.contacts), np.zeros(3))
    com_velocity = result.object_twist[:3] + np.cross(result.object_twist[3:], offset)
    np.testing.assert_allclose(thing.mass * com_velocity, total, atol=1e-6)
    state = problem.arms["arm"]
    model = problem.physics.robot_model("arm")
    wrench = np.zeros(6)
    for contact in result.contacts:
        if contact.body_b != SUPPORT:
            lever = contact.position - model.placement(state.position).translation
            wrench -= np.concatenate((contact.impulse, np.cross(lever, contact.impulse)))
    inertia = model.mass_matrix(state.position) + np.diag(problem.motor_inertia["arm"])
    jump = result.joint_velocity["arm"] - state.velocity
    np.testing.assert_allclose(inertia @ jump, model.jacobian(state.position).T @ wrench, atol=1e-6)


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6), speed=st.floats(0.0, 1.0))
def test_energy_never_rises_between_two_arms(seed: int, speed: float) -> None:
    rng = np.random.default_rng(seed)
    problem = grab(pad_friction=rng.uniform(0.0, 1.0))
    arms = {
        name: replace(state, velocity=state.velocity + speed * 0.3 * rng.normal(size=state.velocity.size))
        for name, state in problem.arms.items()
    }
    problem = replace(problem, arms=arms)
    result = settle(problem)
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-6)
    assert result.residual.largest < 1e-5


def test_much_motor_inertia_goes_on_and_takes_the_object_along() -> None:
    problem = replace(nominal(support_height=None), motor_inertia={"arm": np.full(7, 1e7)})
    result = settle(problem)
    state, motion = problem.arms["arm"], MODEL.jacobian(problem.arms["arm"].position)
    twist = motion @ state.velocity
    lever = problem.object.position - MODEL.placement(state.position).translation
    np.testing.assert_allclose(result.joint_velocity["arm"], state.velocity, atol=1e-6)
    np.testing.assert_allclose(result.object_twist[:3], twist[:3] + np.cross(twist[3:], lever), atol=1e-6)
    np.testing.assert_allclose(result.object_twist[3:], twist[3:], atol=1e-6)


def test_restitution_ends_before_the_contact_closes() -> None:
    for problem in (nominal(), grab()):
        slack, springy = settle(problem), settle(replace(problem, restitution=0.8))
        np.testing.assert_array_equal(slack.object_twist, springy.object_twist)


def test_a_pad_that_arrives_tilted_aligns() -> None:
    tilted = one_point(pad_friction=1.0)
    first, settled = compute_impact_map(tilted, "exact"), settle(tilted)
    assert len(first.contacts) == 1
    assert len(settled.contacts) == 4
    assert np.max(np.abs(relative_twist(tilted, first, "arm")[3:])) > 0.1
    np.testing.assert_allclose(settled.object_twist[3:], settled.end_effector_twist["arm"][3:], atol=1e-5)


def test_a_corner_is_a_ball_joint() -> None:
    system = bodies(2.0, 1.5, (0.01, 0.02, 0.015), [0, 0.9, 0, 0, 0, 0], [0] * 6)
    (corner, *_) = face(5.0)
    found = close_contacts(system, {"arm": [corner]}, [])
    pad, thing = np.split(found.velocity, 2)
    lever = corner.position - system.object_position
    at_corner = thing[:3] + np.cross(thing[3:], lever)
    np.testing.assert_allclose(at_corner, pad[:3] + np.cross(pad[3:], corner.position), atol=TOLERANCE)
    assert np.linalg.norm(thing[3:] - pad[3:]) > 1.0


def test_the_support_is_not_entered_while_pads_align() -> None:
    problem = nominal()
    velocity = problem.arms["arm"].velocity
    down = np.linalg.pinv(MODEL.jacobian(problem.arms["arm"].position)) @ np.array([0, 0, -0.3, 0, 0, 0])
    problem = with_velocity(problem, velocity + down)
    result = settle(problem)
    twist, body, half = result.object_twist, problem.object, problem.physics.object.size / 2.0
    for x in (-1, 1):
        for y in (-1, 1):
            corner = half * np.array([x, y, -1])
            assert (twist[:3] + np.cross(twist[3:], corner))[2] > -1e-6
    pressed = sum(contact.impulse for contact in result.contacts if contact.body_b == SUPPORT)
    assert pressed[2] > 0.1
    assert np.hypot(*pressed[:2]) <= problem.physics.support_friction * pressed[2] + 1e-6
    assert body.position[2] > 0.0


def test_without_contact_nothing_happens() -> None:
    problem = nominal()
    away = BodyState(problem.object.position - np.array([0.0, 0.01, -0.01]), np.eye(3), np.zeros(6))
    result = settle(replace(problem, object=away))
    assert result.contacts == ()
    np.testing.assert_allclose(result.joint_velocity["arm"], problem.arms["arm"].velocity, atol=1e-14)
    np.testing.assert_array_equal(result.object_twist, np.zeros(6))


def test_the_contact_is_chosen_by_name() -> None:
    problem = grab()
    first, settled = predict_impact(problem, engine="exact"), predict_impact(problem, "settled")
    np.testing.assert_array_equal(first.object_twist, compute_impact_map(problem, "exact").object_twist)
    np.testing.assert_array_equal(settled.object_twist, settle(problem).object_twist)
    assert disagreement(first, settled) > 1e-3
    with pytest.raises(InputError, match="no contact 'last'; known: first, settled"):
        predict_impact(problem, "last")


def test_the_push_scene_is_the_papers() -> None:
    assert -settle(ImpactProblem.at_nominal_impact(SCENE)).end_effector_twist["arm"][1] == pytest.approx(0.55, abs=0.01)


def test_an_engine_that_does_not_exist_is_refused_for_the_settled_contact_too() -> None:
    """Kills: the name of the engine is checked only where an engine is used."""
    with pytest.raises(InputError, match="no impact-map engine 'nonsense'; known engines: exact, bullet"):
        predict_impact(nominal(), "settled", "nonsense")
    assert predict_impact(nominal(), "settled", "pinocchio").engine == "exact"
