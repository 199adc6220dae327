# SPDX-License-Identifier: Apache-2.0
"""Doors and drawers in motion, in the twin and in Bullet: closed forms, balances and limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, TOWARDS_Y, rail, resting, run, scene

from impact_rs_sim import _kernel
from impact_rs_sim.damping_of_restitution import restitution_of
from impact_rs_sim.physics import ArmPhysics, Neighbour, ObjectPhysics, Physics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState
from impact_rs_sim.shapes import SPHERE
from impact_rs_sim.twin import Result, box_starts, kernel_twin

FACE = float(SIZE[1]) / 2.0  # m, from the middle of the door to the face that is hit
INERTIA = np.array([0.004, 0.005, 0.006])  # kg m^2
SPEED, STIFFNESS = 0.05, 2e5  # m/s and N/m; slow, so that a door hardly turns while it is hit
Z, UPWARDS = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 9.81])


def hinged(axis: Array, point: Array, offset: Array | float = 0.0) -> ObjectPhysics:
    """A body of 1 kg on a hinge through a point [m] in its own axes; ``offset`` of its centre of mass [m]."""
    guide = np.concatenate((np.cross(point, axis), axis))
    return ObjectPhysics(BOX_MASS, SIZE, INERTIA, np.zeros(3) + offset, freedom=guide[:, None])


def drawer(axis: Array) -> ObjectPhysics:
    """The same body on a slide."""
    return ObjectPhysics(BOX_MASS, SIZE, INERTIA, np.zeros(3), freedom=np.append(axis, np.zeros(3))[:, None])


def ball_on_rail(start: Array, axes: Array = AGAINST_Y, **values: Any) -> ArmPhysics:
    """The rail of the other scenes with a ball for a pad."""
    arm = rail(start, axes, **values)
    return replace(arm, end_effector=replace(arm.end_effector, pad_size=(0.04, 0.04, 0.04), shape=SPHERE))


def in_twin(physics: Physics, start: BodyState, steps: int, period: float) -> Array:
    """Pose and twist of an object without arms at every step, ``(k, 13)``."""
    twin = _kernel.TwinRun(kernel_twin(physics, period, False, 1), [], box_starts(physics, start))
    return np.array([twin.step(number * period, 1, []) for number in range(steps)])


def in_bullet(physics: Physics, start: BodyState, steps: int, period: float) -> Array:
    """The same in Bullet."""
    world = BulletWorld.load(
        physics, time_step=period, gravity=True, compliant_pads=True, iterations=60, residual_threshold=1e-9
    )
    world.set_object(start)
    found = []
    for _ in range(steps):
        world.step()
        state = world.object_state()
        found.append([*state.position, *pin.Quaternion(state.rotation).coeffs(), *state.twist])
    world.close()
    return np.array(found)


Simulator = Callable[[Physics, BodyState, int, float], Array]
SIMULATORS = pytest.mark.parametrize("simulator", [in_twin, in_bullet])


@pytest.mark.parametrize("damping", [0.0, 1000.0])
@pytest.mark.parametrize(("hinge", "lever"), [(-0.09, 0.04), (-0.09, 0.15), (0.05, -0.12)])
@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_a_hit_turns_a_door_by_impulse_times_lever_over_its_moment_about_the_hinge(
    damping: float, hinge: float, lever: float, turn: float
) -> None:
    """I_h omega = r L, L = (1 + e) v / (1/m + r^2 / I_h), e of spring and damper with the mass 1 / (1/m + r^2 / I_h).

    Kills I in place of I_h, a door that moves as a free one, a lever from its middle, and a guide that is not turned.
    """
    point, turned = np.array([hinge, 0.02, 0.0]), pin.exp3(np.array([0.3 * turn, turn, -0.5 * turn]))
    door = hinged(Z, point)
    place = np.array([point[0] + lever, FACE, 0.0])
    physics = scene({"rail": ball_on_rail(turned @ place, turned @ AGAINST_Y, pad_damping=damping)}, object=door)
    found = run(physics, [SPEED], resting(rotation=turned), duration=0.04)
    about_hinge = INERTIA[2] + BOX_MASS * float(point @ point)
    assert door.guided_inertia == pytest.approx(about_hinge)
    reduced = 1.0 / (1.0 / RAIL_MASS + lever**2 / about_hinge)
    e = restitution_of(0.25 * damping / (2.0 * math.sqrt(0.25 * STIFFNESS * reduced)))
    impulse = (1.0 + e) * SPEED * reduced
    omega = -lever * impulse / about_hinge  # about z, of an impulse along -y
    np.testing.assert_allclose(found.twists[-1, 3:], turned @ [0.0, 0.0, omega], atol=0.01 * abs(omega))
    assert found.arms["rail"].velocity[-1, 0] == pytest.approx(SPEED - impulse / RAIL_MASS, abs=0.01 * SPEED)


def test_a_door_hit_on_the_line_of_its_hinge_is_a_wall() -> None:
    """Kills an impulse of the bearing that is forgotten."""
    wall = ObjectPhysics(math.inf, SIZE, np.full(3, math.inf), np.zeros(3))
    door, stop = (
        run(scene({"rail": ball_on_rail(np.array([0.03, FACE, 0.0]))}, object=own), [SPEED], resting(), 0.04)
        for own in (hinged(Z, np.array([0.03, 0.0, 0.0])), wall)
    )
    assert np.abs(door.twists).max() < 1e-9
    assert door.arms["rail"].velocity[-1, 0] == pytest.approx(stop.arms["rail"].velocity[-1, 0], abs=1e-3 * SPEED)


def test_a_drawer_takes_a_hit_as_a_free_mass_does_along_its_line() -> None:
    """Kills a slide that turns, and one with the inertia of a hinge."""
    free = ObjectPhysics(BOX_MASS, SIZE, INERTIA, np.zeros(3))
    one, other = (
        run(
            scene({"rail": rail(np.array([0.0, FACE, 0.0]), AGAINST_Y, pad_damping=200.0)}, object=own),
            [SPEED],
            resting(),
            0.06,
        )
        for own in (drawer(np.array([0.0, 1.0, 0.0])), free)
    )
    np.testing.assert_allclose(one.twists, other.twists, atol=1e-8)
    np.testing.assert_allclose(one.poses, other.poses, atol=1e-9)


def test_a_drawer_hit_off_its_middle_takes_the_part_of_the_impulse_along_its_slide() -> None:
    """m v+ = s . L with a smooth ball; its bearing takes the moment and the rest. Kills a free body's mass there."""
    along = np.array([math.sin(0.6), math.cos(0.6), 0.0])
    physics = scene({"rail": ball_on_rail(np.array([0.06, FACE, 0.0]))}, object=drawer(along))
    found = run(physics, [SPEED], resting(), 0.03)
    share = along[1]
    reduced = 1.0 / (1.0 / RAIL_MASS + share**2 / BOX_MASS)
    expected = -2.0 * SPEED * reduced * share / BOX_MASS
    np.testing.assert_allclose(found.twists[-1], [*(expected * along), 0.0, 0.0, 0.0], atol=0.01 * abs(expected))


def test_two_hits_from_both_sides_leave_a_door_where_it_is() -> None:
    """Equal moments about the hinge from two partners; kills a second partner whose row is lost."""
    door = hinged(Z, np.array([-0.09, 0.0, 0.0]))
    arms = {
        "near": ball_on_rail(np.array([-0.03, FACE, 0.0]), AGAINST_Y, mass=2.0),
        "far": ball_on_rail(np.array([-0.03, -FACE, 0.0]), TOWARDS_Y, mass=2.0),
    }
    found = run(scene(arms, object=door), [SPEED, SPEED], resting(), 0.03)
    assert np.abs(found.twists).max() < 1e-9
    for name in arms:
        assert found.arms[name].velocity[-1, 0] == pytest.approx(-SPEED, abs=0.01 * SPEED)


def swinging(period: float, refinement: int, friction: float = 0.4) -> Result:
    """A rigid-ended push with friction of a door whose ball slides along it while it opens."""
    door = hinged(Z, np.array([-0.09, 0.0, 0.0]), offset=np.array([0.01, -0.005, 0.0]))
    physics = scene(
        {"rail": ball_on_rail(np.array([0.05, FACE, 0.0]), pad_damping=500.0)}, object=door, pad_friction=friction
    )
    return run(physics, [SPEED], resting(), 0.08, force=8.0, period=period, refinement=refinement)


def test_a_push_with_friction_converges_with_the_step_and_gains_no_energy() -> None:
    """Half the step, about half the error; the work of the force is the kinetic energy and what is lost."""
    runs = [swinging(PERIOD / 2**k, 1) for k in (0, 1, 2, 5)]
    ends = np.array([[*own.twists[-1], own.arms["rail"].velocity[-1, 0]] for own in runs])
    errors = np.linalg.norm(ends[:3] - ends[3], axis=1)
    assert errors[1] < 0.7 * errors[0] and errors[2] < 0.7 * errors[1] and errors[0] < 0.02
    fine = runs[-1]
    door = hinged(Z, np.array([-0.09, 0.0, 0.0]), offset=np.array([0.01, -0.005, 0.0]))
    kinetic = 0.5 * (door.guided_inertia * fine.twists[:, 5] ** 2 + RAIL_MASS * fine.arms["rail"].velocity[:, 0] ** 2)
    gained = kinetic - kinetic[0] - 8.0 * fine.arms["rail"].position[:, 0]
    assert gained.max() < 2e-4 * kinetic[0] and gained[-1] < -0.05 * kinetic[0]


@SIMULATORS
@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_a_guided_body_without_loads_keeps_its_velocity_and_its_hinge(simulator: Simulator, kind: str) -> None:
    """2 s; kills the damping that Bullet gives links, its default joint motor, and a hinge that drifts."""
    axis = np.array([0.6, 0.0, 0.8])
    point, turned = np.array([0.1, -0.05, 0.02]), pin.exp3(np.array([0.5, -1.0, 0.2]))
    body = hinged(axis, point, offset=np.array([0.02, 0.01, -0.01])) if kind == "hinge" else drawer(axis)
    guide = body.freedom_at(turned)
    assert guide is not None
    start = resting(position=np.array([0.3, 0.2, 0.5]), rotation=turned, twist=1.7 * guide[:, 0])
    steps = round(2.0 / PERIOD)
    rows = simulator(scene({}, object=body), start, steps, PERIOD)
    if kind == "slide":
        np.testing.assert_allclose(rows[-1, :3], start.position + 3.4 * turned @ axis, atol=1e-10)
        np.testing.assert_allclose(rows[:, 7:], np.tile(start.twist, (steps, 1)), atol=1e-12)
        return
    np.testing.assert_allclose(rows[:, 10:], np.tile(1.7 * turned @ axis, (steps, 1)), atol=1e-11)
    for row in rows[::400]:
        rotation = pin.Quaternion(row[3:7]).matrix()
        np.testing.assert_allclose(row[:3] + rotation @ point, start.position + turned @ point, atol=1e-13)
        np.testing.assert_allclose(row[7:10], np.cross(row[10:], -rotation @ point), atol=1e-12)
    np.testing.assert_allclose(rotation, turned @ pin.exp3(1.7 * PERIOD * (steps - 400 + 1) * axis), atol=1e-10)


@SIMULATORS
def test_a_flap_swings_with_the_period_of_a_compound_pendulum(simulator: Simulator) -> None:
    """2 pi sqrt(I_h / (m g l)) (Huygens 1673), l to the centre of mass. Kills I for I_h, and l to the middle."""
    point, offset = np.array([0.0, 0.0, 0.08]), np.array([0.0, 0.0, -0.03])
    flap = hinged(np.array([1.0, 0.0, 0.0]), point, offset)
    turned = pin.exp3(np.array([1e-3, 0.0, 0.0]))
    start = resting(position=point - turned @ point, rotation=turned)
    expected = 2.0 * math.pi * math.sqrt((INERTIA[0] + BOX_MASS * 0.11**2) / (BOX_MASS * 9.81 * 0.11))
    rows = simulator(scene({}, object=flap, gravity=-UPWARDS), start, round(2.6 * expected / PERIOD), PERIOD)
    speed = rows[:, 10]
    turns = np.flatnonzero(np.diff(np.signbit(speed)))
    assert len(turns) >= 4
    times = turns + speed[turns] / (speed[turns] - speed[turns + 1])
    assert 2.0 * np.mean(np.diff(times)) * PERIOD == pytest.approx(expected, rel=1e-5)


SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_a_body_on_any_hinge_swings_alike_in_both_simulators_and_as_its_equation_says(seed: int) -> None:
    """I_h z'' = S^T (m g) by an integrator of another kind; starts with a twist of which the bearing stops a part.

    Kills Bullet's own inertia of a link, a guide at the middle in place of the centre of mass, and a twist that is
    taken as it comes.
    """
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    point, offset = rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.03, 0.03, 3)
    slides = rng.random() < 0.3
    body = drawer(axis) if slides else hinged(axis, point, offset)
    if slides:
        offset = np.zeros(3)
    gravity = rng.uniform(-10.0, 10.0, 3)
    turned = pin.exp3(rng.standard_normal(3))
    start = BodyState(rng.standard_normal(3), turned, rng.uniform(-1.0, 1.0, 6))
    assert body.guide is not None
    guide = body.guide
    mass = pin.Inertia(BOX_MASS, offset, np.diag(INERTIA)).matrix()
    own_twist = np.concatenate((turned.T @ start.twist[:3], turned.T @ start.twist[3:]))
    inertia = float(guide @ mass @ guide)
    speed = float(guide @ mass @ own_twist) / inertia
    assert body.guided_speed(turned, start.twist) == pytest.approx(speed)

    def pose(travel: float) -> pin.SE3:
        return pin.SE3(turned, start.position) * pin.exp6(travel * guide)

    def acceleration(travel: float) -> float:
        place = pose(travel)
        falls = place.rotation @ (guide[:3] + np.cross(guide[3:], offset))
        return float(BOX_MASS * gravity @ falls) / inertia

    duration, period = 0.5, 2e-4
    exact = scipy.integrate.solve_ivp(
        lambda _, y: [y[1], acceleration(y[0])], (0.0, duration), [0.0, speed], rtol=1e-10, atol=1e-12
    ).y[:, -1]
    physics = scene({}, object=body, gravity=gravity)
    twin, bullet = (simulator(physics, start, round(duration / period), period) for simulator in (in_twin, in_bullet))
    np.testing.assert_allclose(twin[:, :3], bullet[:, :3], atol=1e-9)
    np.testing.assert_allclose(twin[:, 7:], bullet[:, 7:], atol=1e-7)
    place = pose(exact[0])
    np.testing.assert_allclose(twin[-1, :3], place.translation, atol=5e-3)
    expected = place.rotation @ (guide[:3] * exact[1]), place.rotation @ (guide[3:] * exact[1])
    np.testing.assert_allclose(twin[-1, 7:], np.concatenate(expected), atol=0.05)


def test_a_swing_converges_to_its_equation_with_the_step() -> None:
    """A fall from the horizontal, 0.4 s, in steps of 1, 1/2 and 1/4 of a millisecond: half the step, half the error."""
    point = np.array([0.0, 0.0, 0.08])
    flap = hinged(np.array([1.0, 0.0, 0.0]), point)
    turned = pin.exp3(np.array([1.5, 0.0, 0.0]))
    inertia = INERTIA[0] + BOX_MASS * 0.08**2
    exact = scipy.integrate.solve_ivp(
        lambda _, y: [y[1], -BOX_MASS * 9.81 * 0.08 * math.sin(y[0]) / inertia], (0.0, 0.4), [1.5, 0.0], rtol=1e-11
    ).y[0, -1]
    errors = []
    for period in (1e-3, 5e-4, 2.5e-4):
        rows = in_twin(scene({}, object=flap, gravity=-UPWARDS), resting(rotation=turned), round(0.4 / period), period)
        x, w = rows[-1, 3], rows[-1, 6]
        errors.append(abs(2.0 * math.atan2(x, w) - exact))
    assert errors[0] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2) and errors[1] / errors[2] == pytest.approx(2.0, abs=0.2)


def test_bullet_has_the_friction_of_a_door_in_its_partner() -> None:
    """It multiplies both; kills a call that Bullet ignores, after which the door has Bullet's own 0.5."""
    physics = scene(
        {"rail": ball_on_rail(np.array([0.03, FACE, 0.0]))}, object=hinged(Z, np.zeros(3)), pad_friction=0.3
    )
    world = BulletWorld.load(
        physics, time_step=PERIOD, gravity=False, compliant_pads=True, iterations=60, residual_threshold=1e-9
    )
    frictions = [
        world.client.getDynamicsInfo(world.object, 0)[1],
        world.client.getDynamicsInfo(world.arms["rail"], 1)[1],
    ]
    world.close()
    assert frictions == pytest.approx([1.0, 0.3])


def test_bullet_moves_a_door_by_a_force_as_its_mobility_says() -> None:
    """S (S^T M S)^-1 S^T at the centre of mass; kills a force on the base, and the mobility of a free body."""
    body = hinged(np.array([0.6, 0.0, 0.8]), np.array([0.1, -0.05, 0.02]), np.array([0.02, 0.01, -0.01]))
    start = resting(rotation=pin.exp3(np.array([0.5, -1.0, 0.2])))
    world = BulletWorld.load(
        scene({}, object=body),
        time_step=PERIOD,
        gravity=True,
        compliant_pads=True,
        iterations=60,
        residual_threshold=1e-9,
    )
    world.set_object(start)
    side, force, moment = world._object_side(), np.array([3.0, -2.0, 5.0]), np.array([0.1, 0.3, -0.2])
    world.push(None, side.position, force, moment)
    world.step()
    expected = PERIOD * side.mobility @ np.concatenate((force, moment))
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(world._object_side().twist, expected, atol=1e-6 * np.abs(expected).max())
    world.close()


def test_a_door_has_no_neighbours_in_the_twin() -> None:
    door = hinged(Z, np.array([-0.09, 0.0, 0.0]))
    beside = Neighbour("other", door, np.array([0.0, -0.3, 0.0]), np.eye(3))
    with pytest.raises(ValueError, match="one on a hinge or slide has no neighbours"):
        kernel_twin(scene({}, object=door, neighbours=(beside,)), PERIOD, False, 1)
