# SPDX-License-Identifier: Apache-2.0
"""Several objects that hit each other: closed forms, conservation laws, and one object as if it were alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, rail, resting, run, scene

from impact_rs_control.plan import plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy
from impact_rs_sim.impact_map.contacts import find_contacts
from impact_rs_sim.impact_map.laws import ContactTerms, build_system, solve_contacts
from impact_rs_sim.impact_map.problem import ImpactResult, check_problem
from impact_rs_sim.physics import Neighbour, ObjectPhysics, Physics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.shapes import SPHERE, ConvexShape, hull_of

R = 0.05  # m, radius of the balls
BALL = ObjectPhysics(0.8, np.full(3, 2.0 * R), np.full(3, 0.4 * 0.8 * R * R), np.zeros(3), SPHERE)
SECOND = 0.6  # kg, box behind
BEHIND = ObjectPhysics(SECOND, SIZE, SECOND / BOX_MASS * scene({}).object.inertia, np.zeros(3))
ROW = Neighbour("behind", BEHIND, np.array([0.0, -float(SIZE[1]), 0.0]), np.eye(3))  # touches, along -y
HAND = {"rail": rail(np.array([0.0, float(SIZE[1]) / 2.0, 0.0]), AGAINST_Y)}
FAR = {"rail": rail(np.array([0.0, 9.0, 0.0]), AGAINST_Y)}


def balls(speeds: list[float], gaps: list[float], restitution: float) -> ImpactResult:
    """Result of equal balls in a row along x, with gaps between them [m]."""
    places = np.cumsum([0.0, *(2.0 * R + gap for gap in gaps)])
    states = [
        BodyState(np.array([place, 0.0, 0.0]), np.eye(3), np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]))
        for place, speed in zip(places, speeds, strict=True)
    ]
    others = tuple(Neighbour(f"ball_{n}", BALL, np.zeros(3), np.eye(3)) for n in range(1, len(states)))
    physics = replace(scene({}, object=BALL), neighbours=others)
    problem = ImpactProblem(physics, {}, states[0], {}, restitution, neighbours=tuple(states[1:]))
    found = compute_impact_map(problem)
    assert found.residual.largest < 1e-9
    assert kinetic_energy(problem, found) <= kinetic_energy(problem) * (1.0 + 1e-9)
    return found


def along_x(found: ImpactResult) -> list[float]:
    return [float(twist[0]) for twist in found.twists.values()]


def test_a_cradle_of_balls_that_touch_has_the_simultaneous_answer_and_one_with_gaps_the_sequential() -> None:
    """Newton's law at all contacts at once gives -1/3, 2/3, 2/3; two balls at a time 0, 0, 1."""
    np.testing.assert_allclose(along_x(balls([1.0, 0.0, 0.0], [0.0, 0.0], 1.0)), [-1 / 3, 2 / 3, 2 / 3], atol=1e-9)
    first = along_x(balls([1.0, 0.0, 0.0], [0.0, 0.01], 1.0))
    np.testing.assert_allclose(first, [0.0, 1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(along_x(balls(first, [0.01, 0.0], 1.0)), [0.0, 0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_one_ball_hits_another_off_its_centre_with_friction(restitution: float) -> None:
    """J_n = (1 + e) m v_n / 2, J_t = min(mu J_n, m v_t / 7) (two equal solid balls); kills a reaction without spin."""
    angle, speed, friction = 0.5, 1.2, 0.08
    normal = np.array([np.cos(angle), np.sin(angle), 0.0])
    other = Neighbour("other", BALL, np.zeros(3), np.eye(3))
    physics = replace(scene({}, object=BALL), neighbours=(other,), object_friction=friction)
    states = [
        BodyState(np.zeros(3), np.eye(3), np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])),
        BodyState(2.0 * R * normal, np.eye(3), np.zeros(6)),
    ]
    found = compute_impact_map(ImpactProblem(physics, {}, states[0], {}, restitution, neighbours=(states[1],)))
    along, across = speed * np.cos(angle), speed * np.sin(angle)
    pressed = (1.0 + restitution) * BALL.mass * along / 2.0
    rubbed = min(friction * pressed, BALL.mass * across / 7.0)
    sliding = np.array([np.sin(angle), -np.cos(angle), 0.0])  # of the first ball against the other
    impulse = pressed * normal + rubbed * sliding
    (contact,) = found.contacts
    assert (contact.body_a, contact.body_b) == ("other", "object")
    np.testing.assert_allclose(contact.impulse, impulse, atol=1e-9)
    np.testing.assert_allclose(found.neighbour_twists["other"][:3], impulse / BALL.mass, atol=1e-9)
    spin = np.cross(R * normal, rubbed * sliding)
    np.testing.assert_allclose(found.object_twist[3:], -spin / BALL.inertia[0], atol=1e-9)
    np.testing.assert_allclose(found.neighbour_twists["other"][3:], -spin / BALL.inertia[0], atol=1e-9)


@pytest.mark.parametrize("restitution", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("slope", [0.2, 0.6])
def test_a_ball_that_falls_on_a_wedge_drives_it_aside(slope: float, restitution: float) -> None:
    """J = (1 + e) V cos a / (1/m + sin^2 a / M), smooth; kills a wedge that sinks or turns, and one that is a box."""
    reach, mass, speed = 0.1, 1.5, 2.0  # m, half of its base; kg; m/s
    height, normal = 1.5 * reach * np.tan(slope), np.array([np.sin(slope), 0.0, np.cos(slope)])
    ends = ((-1.0, -1.0), (1.0, -1.0), (-0.5, 1.0))  # of the profile, in half extents: it descends along x
    half = np.array([reach, reach, height / 2.0])
    corners = tuple((x * half[0], y * half[1], z * half[2]) for x, z in ends for y in (-1.0, 1.0))
    offset = np.array([-reach / 6.0, 0.0, -height / 6.0])
    wedge = ObjectPhysics(mass, 2.0 * half, np.full(3, mass * reach**2 / 3.0), offset, hull_of(corners))
    ball = Neighbour("ball", BALL, np.zeros(3), np.eye(3))
    physics = scene({}, object=wedge, neighbours=(ball,), support_height=0.0, support_friction=0.0)
    middle = np.array([0.0, 0.0, height / 2.0])
    face = np.array([0.0, 0.0, 2.0 / 3.0 * height])  # where the ball meets it
    falls = BodyState(face + R * normal, np.eye(3), np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0]))
    start = BodyState(middle, np.eye(3), np.zeros(6))
    found = compute_impact_map(ImpactProblem(physics, {}, start, {}, restitution, neighbours=(falls,)))
    impulse = (1.0 + restitution) * speed * np.cos(slope) / (1.0 / BALL.mass + np.sin(slope) ** 2 / mass)
    np.testing.assert_allclose(found.object_twist, [-impulse * np.sin(slope) / mass, 0, 0, 0, 0, 0], atol=1e-9)
    after = impulse / BALL.mass * normal - [0.0, 0.0, speed]
    np.testing.assert_allclose(found.neighbour_twists["ball"], [*after, 0.0, 0.0, 0.0], atol=1e-9)


def test_a_rail_that_hits_two_boxes_in_a_row_hits_one_of_their_mass() -> None:
    """v = M v_0 / (M + m_1 + m_2), and m_2 v passes between them; the undamped pad of the twin gives twice that."""
    physics = replace(scene(HAND), neighbours=(ROW,))
    state = {"rail": ArmState(np.zeros(1), np.ones(1))}
    found = compute_impact_map(ImpactProblem(physics, state, resting(), {"rail": np.zeros(1)}))
    speed = RAIL_MASS / (RAIL_MASS + BOX_MASS + SECOND)
    for twist in found.twists.values():
        np.testing.assert_allclose(twist, [0.0, -speed, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    between = np.sum([one.impulse for one in found.contacts if one.body_b == "object"], axis=0)
    np.testing.assert_allclose(between, [0.0, -SECOND * speed, 0.0], atol=1e-9)
    result = run(physics, [1.0], resting(), 0.05)
    np.testing.assert_allclose(result.twists[-1], [0.0, -2.0 * speed, 0.0, 0.0, 0.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(result.neighbours["behind"][1][-1], result.twists[-1], atol=1e-3)


def momentum(body: ObjectPhysics, pose: Array, twist: Array) -> Array:
    """Linear and angular momentum about the origin, ``(6,)``."""
    rotation = pin.Quaternion(pose[3:]).matrix()
    lever = rotation @ body.com_offset
    linear = body.mass * (twist[:3] + np.cross(twist[3:], lever))
    spin = rotation @ (body.inertia * (rotation.T @ twist[3:]))
    return np.concatenate((linear, np.cross(pose[:3] + lever, linear) + spin))


def energy(body: ObjectPhysics, pose: Array, twist: Array) -> float:
    """Kinetic energy [J]."""
    rotation = pin.Quaternion(pose[3:]).matrix()
    speed = twist[:3] + np.cross(twist[3:], rotation @ body.com_offset)
    return float(0.5 * (body.mass * speed @ speed + body.inertia @ np.square(rotation.T @ twist[3:])))


@pytest.mark.parametrize("seed", range(4))
def test_two_boxes_that_meet_in_flight_keep_their_momentum(seed: int) -> None:
    """To rounding, linear and angular, and no energy is gained; kills a reaction at the wrong centre of mass."""
    rng = np.random.default_rng(seed)
    turned = pin.exp3(0.4 * rng.normal(size=3))
    other = replace(BEHIND, com_offset=np.array([0.02, -0.01, 0.015]))
    place = Neighbour("behind", other, np.array([0.03, -0.28, 0.02]), turned)
    physics = replace(scene(FAR), neighbours=(place,), object_friction=0.4)
    start = resting(twist=np.array([0.1, -1.5, 0.0, *rng.normal(size=3)]))
    result = run(physics, [0.0], start, 0.3)
    poses, twists = result.neighbours["behind"]
    own = physics.object
    assert np.linalg.norm(twists[-1]) > 0.1  # it was hit
    first, last = (
        momentum(own, result.poses[k], result.twists[k]) + momentum(other, poses[k], twists[k]) for k in (0, -1)
    )
    np.testing.assert_allclose(last[:3], first[:3], atol=1e-9)
    np.testing.assert_allclose(last[3:], first[3:], atol=1e-3)  # of second order in the step
    before, after = (
        energy(own, result.poses[k], result.twists[k]) + energy(other, poses[k], twists[k]) for k in (0, -1)
    )
    assert after < before * (1.0 + 1e-6)


def test_a_box_sleeps_until_another_one_reaches_it() -> None:
    """Along a table; kills a sleeping neighbour that is passed through, and one that moves before it is touched."""
    gap, height = 0.01, float(SIZE[2]) / 2.0
    place = replace(ROW, position=ROW.position - [0.0, gap, 0.0])
    ground = {"support_height": 0.0, "gravity": np.array([0.0, 0.0, -9.81])}
    physics = replace(scene(FAR, **ground), neighbours=(place,))
    start = resting(position=np.array([0.0, 0.0, height]), twist=np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0]))
    result = run(physics, [0.0], start, 0.05)
    reached = int(np.argmax(result.poses[:, 1] <= -gap))
    _, twists = result.neighbours["behind"]
    np.testing.assert_array_equal(twists[: reached - 4], 0.0)
    before = result.twists[reached - 4, 1]
    together = BOX_MASS * before / (BOX_MASS + SECOND)
    np.testing.assert_allclose([result.twists[reached + 4, 1], twists[reached + 4, 1]], together, atol=0.02)


def test_an_object_whose_neighbour_is_out_of_reach_moves_as_if_it_were_alone() -> None:
    """In the twin to the bit; in the map, whose points share one solver, to rounding."""
    alone = scene(HAND, support_height=-0.08, gravity=np.array([0.0, 0.0, -9.81]), pad_friction=0.4)
    both = replace(alone, neighbours=(replace(ROW, position=np.array([0.0, -0.9, 0.0])),), object_friction=0.4)
    state, motor = {"rail": ArmState(np.zeros(1), np.ones(1))}, {"rail": np.zeros(1)}
    first, second = (compute_impact_map(ImpactProblem(one, state, resting(), motor)) for one in (alone, both))
    np.testing.assert_allclose(first.object_twist, second.object_twist, atol=1e-9)
    np.testing.assert_allclose(first.joint_velocity["rail"], second.joint_velocity["rail"], atol=1e-9)
    first_run, second_run = (run(one, [1.0], resting(), 0.05) for one in (alone, both))
    np.testing.assert_array_equal(first_run.poses, second_run.poses)
    np.testing.assert_array_equal(first_run.arms["rail"].velocity, second_run.arms["rail"].velocity)


def tower(rng: np.random.Generator) -> ImpactProblem:
    """A box on a table, and one that comes down beside and on it."""
    kinds = [ConvexShape("box"), SPHERE]
    bodies = []
    for shape in (kinds[int(rng.integers(2))], ConvexShape("box")):
        size = np.full(3, rng.uniform(0.06, 0.12))
        bodies.append(
            ObjectPhysics(float(rng.uniform(0.4, 2.0)), size, rng.uniform(1e-3, 2e-3) * np.ones(3), np.zeros(3), shape)
        )
    low, high = bodies[1].size[2] / 2.0, bodies[1].size[2] + bodies[0].size[2] / 2.0
    falls = BodyState(
        np.array([*rng.uniform(-0.03, 0.03, 2), high]), np.eye(3), rng.normal(size=6) - [0, 0, 2, 0, 0, 0]
    )
    stands = BodyState(np.array([0.0, 0.0, low]), np.eye(3), np.zeros(6))
    physics = replace(
        scene({}, object=bodies[0], support_height=0.0, support_friction=0.3),
        neighbours=(Neighbour("low", bodies[1], np.zeros(3), np.eye(3)),),
        object_friction=0.5,
    )
    return ImpactProblem(physics, {}, falls, {}, 0.2, neighbours=(stands,))


def test_the_compiled_terms_of_two_objects_are_those_of_their_jacobians() -> None:
    """20 towers of two: u^+ by H^-1 J_c^T of dense matrices; kills a Delassus operator without coupling."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        problem = tower(rng)
        found = compute_impact_map(problem)
        contacts = find_contacts(problem.physics, check_problem(problem, {}))
        terms = ContactTerms.of(build_system(problem, {}), contacts, problem.restitution)
        impulses, _ = solve_contacts(terms)
        expected = terms.before + terms.response @ impulses.ravel()
        np.testing.assert_allclose(np.concatenate(list(found.twists.values())), expected, atol=1e-7)
        assert {one.body_b for one in found.contacts} == {"object", "support"}


@pytest.mark.parametrize("between", [0.1, 0.9])
def test_friction_between_objects_leaves_that_of_the_support_in_bullet(between: float) -> None:
    """Both boxes slow down by mu g, whatever they have between them: Bullet multiplies coefficients."""
    friction = 0.3
    ground = {"support_height": 0.0, "support_friction": friction, "gravity": np.array([0.0, 0.0, -9.81])}
    place = replace(ROW, position=np.array([0.0, -0.5, 0.0]))
    physics: Physics = replace(scene(FAR, **ground), neighbours=(place,), object_friction=between)
    world = BulletWorld.load(
        physics, time_step=PERIOD, gravity=True, compliant_pads=True, iterations=60, residual_threshold=1e-9
    )
    world.set_object(resting(position=np.array([0.0, 0.0, float(SIZE[2]) / 2.0])))
    for body in world.objects:
        world.client.resetBaseVelocity(body, [0.0, 1.0, 0.0], [0.0] * 3)
    for _ in range(200):
        world.step()
    speeds = [world.client.getBaseVelocity(body)[0][1] for body in world.objects]
    world.close()
    np.testing.assert_allclose(speeds, 1.0 - friction * 9.81 * 200 * PERIOD, atol=5e-3)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"neighbours.behind.fixed": True, "neighbours.behind.mass": None}, "behind"),
        ({"neighbours.behind.direction": [0.5, 0.5]}, "direction"),
        (
            {"neighbours.arm": {"label": "a", "mass": 1.0, "size": [0.1, 0.1, 0.1], "direction": [1.0, 0.0]}},
            "neighbours.arm",
        ),
    ],
)
def test_neighbours_that_cannot_be_are_refused_by_key(settings: dict[str, object], key: str) -> None:
    with pytest.raises(InputError, match=key):
        load_scenario("push_two_boxes").with_settings(settings)


def test_restitution_between_objects_is_refused_in_a_trial_and_the_engine_bullet_with_two() -> None:
    scenario = load_scenario("push_two_boxes")
    scene_ = Scene.resolve(scenario, "box", "case_1")
    with pytest.raises(InputError, match="engine"):
        compute_impact_map(ImpactProblem.at_nominal_impact(scene_), engine="bullet")
    bouncing = Scene.resolve(scenario.with_settings({"contact.restitution": 0.3}), "box", "case_1")
    with pytest.raises(InputError) as refused:
        plan_trial(bouncing)
    assert refused.value.key == "contact.restitution"


def test_neighbours_stand_in_a_row_with_their_gaps() -> None:
    """By the reach of both along the direction, and each on the support."""
    settings = {
        "neighbours.behind.gap": 0.02,
        "neighbours.third": {
            "label": "c",
            "mass": 1.0,
            "shape": "cylinder",
            "size": [0.1, 0.1, 0.2],
            "direction": [1.0, 0.0],
        },
    }
    shifts = load_scenario("push_two_boxes").with_settings(settings).neighbour_shifts("box")
    np.testing.assert_allclose(shifts[0], [0.0, -(0.06 + 0.02 + 0.05), 0.07 - 0.08], atol=1e-12)
    np.testing.assert_allclose(shifts[1], [0.07 + 0.05, -0.13, 0.1 - 0.08], atol=1e-12)
