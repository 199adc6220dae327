# SPDX-License-Identifier: Apache-2.0
"""The problem of an impact: what is checked, mass matrix and Jacobian of arm and object, and the judge of answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import random_impacts
from impact_map_cases import ENGINES, MODEL, PUSH, SCENE, nominal, one_point, with_velocity
from trials import scene_of

from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map import (
    ImpactProblem,
    Residual,
    check_problem,
    compute_impact_map,
    kinetic_energy,
)
from impact_rs_sim.impact_map.contacts import ContactPoint, contact_pairs
from impact_rs_sim.impact_map.laws import System, build_system, point_maps
from impact_rs_sim.impact_map.solve import ExactEngine, Solution
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scene import ArmState, BodyState

# ---- what is checked ------------------------------------------------------------------------------------------------

GOOD = nominal()
ARM = GOOD.arms["arm"]
BODY = GOOD.object


def _position(q: np.ndarray) -> ImpactProblem:
    return replace(GOOD, arms={"arm": ArmState(q, ARM.velocity)})


def _body(**changes: np.ndarray) -> ImpactProblem:
    return replace(GOOD, object=replace(BODY, **changes))


def _thing(**changes: object) -> ImpactProblem:
    return replace(GOOD, physics=replace(GOOD.physics, object=replace(GOOD.physics.object, **changes)))


def _motor(values: np.ndarray) -> ImpactProblem:
    return replace(GOOD, motor_inertia={"arm": values})


def _with(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = np.array(values, dtype=float)
    changed[index] = value
    return changed


REFUSED = {
    "non-finite position": (_position(_with(ARM.position, 2, np.nan)), "finite.*rad"),
    "short position": (_position(ARM.position[:6]), r"7 values \[rad\]"),
    "position beyond its limit": (_position(_with(ARM.position, 3, 1.0)), "joint 4.*limits.*rad"),
    "non-finite velocity": (with_velocity(GOOD, _with(ARM.velocity, 0, np.inf)), "finite.*rad/s"),
    "velocity beyond its limit": (with_velocity(GOOD, _with(ARM.velocity, 1, 5.0)), "joint 2.*rad/s"),
    "negative motor inertia": (_motor(_with(np.ones(7), 4, -0.1)), r"motor inertia >= 0 kg m\^2"),
    "short motor inertia": (_motor(np.ones(3)), "7 values"),
    "unknown arm": (replace(GOOD, motor_inertia={"left": np.ones(7)}), "one entry per arm"),
    "restitution above one": (replace(GOOD, restitution=1.2), "between 0 and 1"),
    "restitution not a number": (replace(GOOD, restitution=float("nan")), "between 0 and 1"),
    "negative mass": (_thing(mass=-1.0), "mass > 0 kg"),
    "zero inertia": (_thing(inertia=np.zeros(3)), r"> 0 kg m\^2"),
    "zero size": (_thing(size=np.array([0.1, 0.0, 0.1])), "> 0 m"),
    "negative friction": (nominal(pad_friction=-0.1), "friction coefficient >= 0"),
    "non-finite object position": (_body(position=np.array([0.0, np.nan, 0.0])), "finite.*m"),
    "non-finite twist": (_body(twist=np.full(6, np.nan)), "finite.*m/s"),
    "stretched rotation": (_body(rotation=1.1 * np.eye(3)), "rotation matrix"),
    "reflection": (_body(rotation=np.diag([1.0, 1.0, -1.0])), "rotation matrix"),
    "pad in the object": (_body(position=BODY.position + [0.0, 0.004, 0.0]), "penetrates 'arm' by 4 mm"),
    "object in the support": (_body(position=BODY.position - [0.0, 0.0, 0.003]), "penetrates 'support' by 3 mm"),
}


STATES = ("position beyond its limit", "velocity beyond its limit", "pad in the object", "object in the support")


@pytest.mark.parametrize("case", REFUSED)
def test_bad_question_is_refused(case: str) -> None:
    """A state that cannot be is told apart from numbers that mean nothing: a search samples on past the first alone."""
    problem, message = REFUSED[case]
    with pytest.raises(InputError, match=message) as caught:
        check_problem(problem)
    assert isinstance(caught.value, Infeasible) == (case in STATES)


def test_sampling_passes_over_impossible_states_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def check(problem: ImpactProblem) -> None:
        asked.append(problem)
        if len(asked) < 3:
            raise Infeasible("the pad is in the object")
        raise InputError("a mistake")

    monkeypatch.setattr(random_impacts, "check_problem", check)
    with pytest.raises(InputError, match="a mistake"):
        random_impacts.random_problem(PUSH, np.random.default_rng(0))
    assert len(asked) == 3


def test_a_warm_engine_refuses_it_in_the_same_words() -> None:
    engine = ExactEngine(GOOD.physics)
    for values in (ARM.position[:6], np.append(ARM.position, 0.0)):
        with pytest.raises(InputError, match=r"7 values \[rad\]"):
            engine.solve(_position(values))


def test_nominal_question_passes() -> None:
    check_problem(GOOD)


def test_unknown_motor_inertia_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="reduced, rotor, zero"):
        ImpactProblem.at_nominal_impact(SCENE, "none")


def test_touching_within_the_tolerance_passes() -> None:
    check_problem(replace(GOOD, object=BodyState(BODY.position + [0.0, 0.0005, 0.0], BODY.rotation, BODY.twist)))


@pytest.mark.parametrize("motor", ["reduced", "rotor", "zero"])
def test_the_nominal_problem_is_taken_from_the_scene(motor: str) -> None:
    scene = replace(SCENE, physics=replace(SCENE.physics, restitution=0.35))
    problem = ImpactProblem.at_nominal_impact(scene, motor)
    assert problem.restitution == 0.35
    np.testing.assert_array_equal(problem.motor_inertia["arm"], scene.physics.arms["arm"].motor_inertia(motor))
    np.testing.assert_array_equal(problem.arms["arm"].velocity, scene.arms["arm"].velocity)
    np.testing.assert_array_equal(problem.object.position, scene.object.position)


# ---- mass matrix, Jacobian and centre of mass -----------------------------------------------------------------------

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


# ---- residual: what is wrong with an answer -------------------------------------------------------------------------

SMALL = 1e-6  # m/s, what is left of a right answer


def answer_of(problem: ImpactProblem) -> Solution:
    engine = ExactEngine(problem.physics)
    placements = {name: engine.models[name].placement(state.position) for name, state in problem.arms.items()}
    system = build_system(problem, engine.models)
    return engine._solve(problem, system, contact_pairs(problem.physics, problem.object, placements))


def with_impulses(answer: Solution, impulses: np.ndarray) -> Residual:
    """Residual of other impulses, with the velocity that they lead to."""
    velocity = answer.terms.before + answer.terms.response @ impulses.ravel()
    return answer.terms.residual(impulses, velocity)


@pytest.fixture(scope="module")
def face() -> Solution:
    return answer_of(nominal())


@pytest.fixture(scope="module")
def point() -> Solution:
    """One corner, sliding: the arm moves across the face as well, and friction is low."""
    problem = one_point(pad_friction=0.1)
    state = problem.arms["arm"]
    jacobian = SCENE.models["arm"].jacobian(state.position)
    across = np.linalg.pinv(jacobian) @ np.array([0.5, 0.0, 0.2, 0.0, 0.0, 0.0])
    return answer_of(with_velocity(problem, state.velocity + across))


def test_a_right_answer_has_no_residual(face: Solution, point: Solution) -> None:
    for answer in (face, point):
        assert answer.terms.residual(answer.impulses, answer.velocity).largest < SMALL


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_too_little_impulse_leaves_a_velocity_of_penetration(point: Solution, share: float) -> None:
    """Without an impulse the points approach at -J_n u^-; each part of the impulse takes away its part."""
    approach = -point.terms.split((point.terms.jacobian @ point.terms.before).reshape(-1, 3))[0]
    found = with_impulses(point, share * point.impulses)
    assert found.penetration_velocity == pytest.approx((1.0 - share) * approach[0], rel=1e-3)
    assert found.momentum < SMALL
    assert found.worst[0].startswith("Newton")


@pytest.mark.parametrize("share", [1.1, 1.5])
def test_too_much_impulse_separates_a_point_that_carries_it(point: Solution, share: float) -> None:
    approach = -point.terms.split((point.terms.jacobian @ point.terms.before).reshape(-1, 3))[0]
    found = with_impulses(point, share * point.impulses)
    assert found.complementarity == pytest.approx((share - 1.0) * approach[0], rel=1e-3)
    assert found.penetration_velocity == 0.0


def test_a_contact_that_pulls_breaks_complementarity(point: Solution) -> None:
    found = with_impulses(point, -0.1 * point.impulses)
    assert found.complementarity > 0.01
    assert with_impulses(point, 0.0 * point.impulses).complementarity < SMALL


def test_friction_beyond_the_cone_is_found_out(point: Solution) -> None:
    pressing, friction = point.terms.split(point.impulses)
    outside = pressing[:, None] * point.terms.normals + 1.3 * friction
    assert with_impulses(point, outside).friction_cone > 1e-3


def test_a_sliding_point_without_its_friction_is_found_out(point: Solution) -> None:
    slides, _ = point.terms.sliding(point.impulses, point.velocity)
    assert slides.all()
    pressing, friction = point.terms.split(point.impulses)
    for share in (0.0, 0.7, -1.0):
        wrong = pressing[:, None] * point.terms.normals + share * friction
        assert with_impulses(point, wrong).friction_cone > 1e-3


def test_friction_that_does_not_oppose_the_sliding_velocity_is_found_out(point: Solution) -> None:
    """Turned by some degrees about the normal; the size stays on the cone."""
    pressing, friction = point.terms.split(point.impulses)
    normal = point.terms.normals[0]
    turned = friction[0] * np.cos(0.3) + np.cross(normal, friction[0]) * np.sin(0.3)
    wrong = pressing[:, None] * point.terms.normals + turned
    assert with_impulses(point, wrong).friction_cone > 1e-3


def test_a_point_that_sticks_needs_any_friction_inside_its_cone() -> None:
    rough = answer_of(one_point(pad_friction=1.0))
    slides, _ = rough.terms.sliding(rough.impulses, rough.velocity)
    assert not slides.any()
    assert rough.terms.residual(rough.impulses, rough.velocity).friction_cone < SMALL
    pressing, friction = rough.terms.split(rough.impulses)
    slipping = pressing[:, None] * rough.terms.normals + 0.5 * friction
    assert with_impulses(rough, slipping).friction_cone > 1e-3


def test_a_velocity_without_its_impulses_breaks_the_momentum_balance(face: Solution) -> None:
    for index in (0, face.velocity.size - 4):
        velocity = face.velocity.copy()
        velocity[index] += 0.03
        found = face.terms.residual(face.impulses, velocity)
        assert found.momentum == pytest.approx(0.03, rel=1e-6)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_restitution_asks_for_its_share_of_the_approach_back(restitution: float) -> None:
    """J_n u^+ = -e J_n u^- at a point that carries an impulse; with another e the answer is wrong by the difference."""
    problem = replace(one_point(pad_friction=0.0), restitution=restitution)
    answer = answer_of(problem)
    before, after = (
        answer.terms.split((answer.terms.jacobian @ velocity).reshape(-1, 3))[0]
        for velocity in (answer.terms.before, answer.velocity)
    )
    assert after[0] == pytest.approx(-restitution * before[0], abs=SMALL)
    other = answer_of(replace(problem, restitution=0.25)).terms
    found = other.residual(answer.impulses, answer.velocity)
    wrong = (restitution - 0.25) * -before[0]
    assert found.complementarity == pytest.approx(max(wrong, 0.0), abs=SMALL)
    assert found.penetration_velocity == pytest.approx(max(-wrong, 0.0), abs=SMALL)


def test_the_worst_law_is_named_and_nan_is_the_worst_of_all() -> None:
    laws = {
        "penetration_velocity": "Newton",
        "complementarity": "complem",
        "friction_cone": "Coulomb",
        "momentum": "mom",
    }
    for law, name in laws.items():
        residual = Residual(**{**dict.fromkeys(laws, 1e-3), law: 2e-3})
        assert residual.worst[0].startswith(name)
        assert residual.largest == 2e-3
        assert not Residual(**{**dict.fromkeys(laws, 1e-3), law: float("nan")}).largest <= 1.0
