# SPDX-License-Identifier: Apache-2.0
"""Impacts and motion of balls, cylinders and rods obey closed forms, in the map and in the twin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from twin_scene import AGAINST_Y, PAD, PERIOD, RAIL_MASS, TOWARDS_Y, rail, resting, run, scene

from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy
from impact_rs_sim.impact_map.problem import EnergyGain, ImpactResult
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array, EndEffector
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.shapes import CAPSULE, CYLINDER, SPHERE, ConvexShape

G, MASS, R = 9.81, 0.8, 0.06  # m/s^2, kg, m
FAR = {"rail": rail(np.array([0.0, 9.0, 0.0]), AGAINST_Y)}  # out of reach


def item(shape: ConvexShape, height: float = 2.0 * R, mass: float = MASS, **values: Array) -> ObjectPhysics:
    """A homogeneous body of radius R, up to ``values``."""
    size = np.array([2.0 * R, 2.0 * R, height])
    whole: dict[str, Array] = {"inertia": shape.moments(mass, size), "com_offset": np.zeros(3)}
    return ObjectPhysics(mass, size, **(whole | values), shape=shape)


def free(object_: ObjectPhysics, restitution: float = 0.0, friction: float = 0.0, **changes: Any) -> Physics:
    """An object alone over a support at z = 0."""
    values: dict[str, Any] = {
        "support_height": 0.0,
        "support_friction": friction,
        "restitution": restitution,
        "object": object_,
    }
    return scene(changes.pop("arms", {}), **(values | changes))


def impact(physics: Physics, object_: BodyState, arms: dict[str, ArmState] | None = None) -> ImpactResult:
    problem = ImpactProblem(
        physics,
        arms or {},
        object_,
        {name: np.zeros(1) for name in physics.arms},
        physics.restitution,
        restitution_law=physics.restitution_law,
    )
    result = compute_impact_map(problem)
    assert result.residual.largest < 1e-9
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-9)
    return result


@pytest.mark.parametrize("share", [0.4, 2.0 / 3.0])
@pytest.mark.parametrize("friction", [0.05, 2.0])
def test_a_ball_with_spin_bounces_off_a_table(share: float, friction: float) -> None:
    """Along the table it sticks, where mu is large, with u_t^+ = 0, else mu (1 + e) v_n slows it (Garwin 1969)."""
    e, v, spin = 0.7, np.array([1.2, -0.3, -1.5]), np.array([4.0, 9.0, -3.0])
    ball = item(SPHERE, inertia=np.full(3, share * MASS * R * R))
    found = impact(free(ball, e, friction), BodyState(np.array([0.0, 0.0, R]), np.eye(3), np.array([*v, *spin])))
    lever = np.array([0.0, 0.0, -R])
    slip = (v + np.cross(spin, lever)) * [1.0, 1.0, 0.0]
    stuck = -slip / (1.0 + 1.0 / share)  # change of v along the table
    slid = -friction * (1.0 + e) * 1.5 * slip / np.linalg.norm(slip)
    change = stuck if np.linalg.norm(stuck) < np.linalg.norm(slid) else slid
    np.testing.assert_allclose(found.object_twist[:3], [*(v + change)[:2], 1.5 * e], atol=1e-9)
    np.testing.assert_allclose(found.object_twist[3:], spin + np.cross(lever, change) / (share * R * R), atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 0.02])
@pytest.mark.parametrize("friction", [0.0, 0.1, 5.0])
def test_a_rail_hits_a_ball_with_its_pad(offset: float, friction: float) -> None:
    """The pad meets the ball where it is foremost, wherever it is on the pad; across, the ball's spin has 2/7 in it."""
    hand = rail(np.array([0.0, R, 0.0]), AGAINST_Y)
    physics = scene({"rail": hand}, object=item(SPHERE), pad_friction=friction)
    spin = np.array([0.0, 0.0, 5.0])
    thing = BodyState(np.array([offset, 0.0, 0.0]), np.eye(3), np.array([0.0, 0.0, 0.0, *spin]))
    found = impact(physics, thing, {"rail": ArmState(np.zeros(1), np.ones(1))})
    (contact,) = found.contacts
    np.testing.assert_allclose(contact.position, [offset, R, 0.0], atol=1e-12)
    passed = RAIL_MASS * MASS / (RAIL_MASS + MASS)  # N s, of a plastic impact at 1 m/s
    np.testing.assert_allclose(contact.impulse[1], -passed, rtol=1e-9)
    along = min(2.0 / 7.0 * MASS * R * spin[2], friction * passed)  # against the sliding of the surface, along -x
    np.testing.assert_allclose(contact.impulse[0], along, atol=1e-9)
    np.testing.assert_allclose(found.object_twist[5], spin[2] - along * R / (0.4 * MASS * R * R), atol=1e-9)


@pytest.mark.parametrize("elastic", [0.0, 1.0])
def test_a_ball_on_a_rail_hits_another_off_its_centre_as_in_billiards(elastic: float) -> None:
    """J = (1 + e) v n_y / (1/m + n_y^2/M) along the line of centres; kills a tool that hits with its bounding box."""
    offset, tool = 0.05, 0.04  # m
    across = np.sqrt((R + tool) ** 2 - offset**2)  # from centre to centre along the rail
    hand = rail(np.array([offset, across - tool, 0.0]), AGAINST_Y, pad_damping=0.0)
    ball = EndEffector(0.1, np.zeros(3), 1e-4 * np.eye(3), 0.0, 0.0, (2.0 * tool,) * 3, shape=SPHERE)
    physics = scene({"rail": replace(hand, end_effector=ball)}, object=item(SPHERE), restitution=elastic)
    found = impact(physics, resting(), {"rail": ArmState(np.zeros(1), np.array([0.5]))})
    (contact,) = found.contacts
    normal = np.array([-offset, -across, 0.0]) / (R + tool)
    np.testing.assert_allclose(contact.normal, normal, atol=1e-9)
    passed = (1.0 + elastic) * 0.5 * -normal[1] / (1.0 / MASS + normal[1] ** 2 / RAIL_MASS)
    np.testing.assert_allclose(contact.impulse, passed * normal, atol=1e-9)
    np.testing.assert_allclose(found.object_twist, [*(passed / MASS * normal), 0.0, 0.0, 0.0], atol=1e-9)
    if elastic:  # the undamped pad of the twin gives back what it takes; its normal turns a little while it is pressed
        result = run(physics, [0.5], resting(), 0.03)
        np.testing.assert_allclose(result.twists[-1], found.object_twist, atol=0.01)


def test_newtons_cradle_of_two_pads_and_a_ball_has_one_simultaneous_answer() -> None:
    """A rail, a ball and a rail that touch: Newton's law for all contacts at once, not one collision after another.

    With e = 1 both contacts part with what they came, 1 and 0 m/s: the masses m, m, m of a cradle leave with -1/3, 2/3
    and 2/3 of the speed; a cradle of steel balls, whose collisions follow each other, with 0, 0 and 1.
    """
    arms = {
        "left": rail(np.array([0.0, -R, 0.0]), TOWARDS_Y, mass=MASS),
        "right": rail(np.array([0.0, R, 0.0]), AGAINST_Y, mass=MASS),
    }
    state = {"left": ArmState(np.zeros(1), np.ones(1)), "right": ArmState(np.zeros(1), np.zeros(1))}
    found = impact(scene(arms, object=item(SPHERE), restitution=1.0), resting(), state)
    np.testing.assert_allclose(found.joint_velocity["left"], -1.0 / 3.0, atol=1e-9)
    np.testing.assert_allclose(found.object_twist[1], 2.0 / 3.0, atol=1e-9)
    np.testing.assert_allclose(found.joint_velocity["right"], -2.0 / 3.0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.3, 0.8, 1.2])
def test_a_thin_rod_hits_a_plane_with_its_end(angle: float) -> None:
    """Routh 1877: without friction J = (1 + e) v_n / (1/m + l^2 cos^2 / I), l from the middle to that of its end."""
    e, half, radius, mass = 0.6, 0.3, 0.005, 1.5
    size, inertia = np.array([2.0 * radius, 2.0 * radius, 2.0 * (half + radius)]), np.array([0.045, 0.045, 1e-4])
    rod = ObjectPhysics(mass, size, inertia, np.zeros(3), CAPSULE)
    rotation = pin.utils.rotate("y", np.pi / 2.0 + angle)  # its z points down by `angle` along x
    height = half * np.sin(angle) + radius
    state = BodyState(np.array([0.0, 0.0, height]), rotation, np.array([0.3, 0.0, -2.0, 0.0, 0.7, 0.0]))
    found = impact(free(rod, e), state)
    (contact,) = found.contacts
    lever = half * np.cos(angle)
    np.testing.assert_allclose(contact.position, [lever, 0.0, 0.0], atol=1e-12)
    approach = -2.0 - 0.7 * lever
    expected = -(1.0 + e) * approach / (1.0 / mass + lever**2 / inertia[1])
    np.testing.assert_allclose(contact.impulse, [0.0, 0.0, expected], atol=1e-9)
    np.testing.assert_allclose(found.object_twist[4], 0.7 - lever * expected / inertia[1], atol=1e-9)


def test_a_rod_on_its_edge_may_gain_energy_by_newtons_law_and_never_by_poissons() -> None:
    """Kane and Levinson 1985: friction and restitution of velocities; the map refuses what nature does not do."""
    half, radius = 0.3, 0.005
    size, inertia = np.array([2.0 * radius, 2.0 * radius, 2.0 * (half + radius)]), np.array([0.02, 0.02, 1e-4])
    rod = ObjectPhysics(1.0, size, inertia, np.zeros(3), CAPSULE)
    refused = 0
    for angle in (0.2, 0.4, 0.6, 0.8):
        for slip in (-0.5, -0.2, 0.2, 0.5):
            state = BodyState(
                np.array([0.0, 0.0, half * np.sin(angle) + radius]),
                pin.utils.rotate("y", np.pi / 2.0 + angle),
                np.array([slip, 0.0, -1.0, 0.0, 0.0, 0.0]),
            )
            physics = free(rod, 1.0, 0.9)
            try:
                impact(physics, state)
            except EnergyGain:
                refused += 1
            impact(replace(physics, restitution_law="poisson"), state)
    assert refused > 0


def test_a_can_pushed_at_the_height_of_its_middle_goes_on_standing() -> None:
    """Without friction two points of its wall carry the impulse, and its base none: a central plastic impact."""
    hand = rail(np.array([0.0, R, 0.1]), AGAINST_Y)
    can = item(CYLINDER, 0.2)
    physics = scene({"rail": hand}, object=can, support_height=0.0, support_friction=0.0)
    found = impact(physics, resting(position=np.array([0.0, 0.0, 0.1])), {"rail": ArmState(np.zeros(1), np.ones(1))})
    on_wall = [contact for contact in found.contacts if contact.body_b == "rail"]
    assert len(on_wall) == 2 and len(found.contacts) == 10
    np.testing.assert_allclose(
        [contact.position for contact in on_wall], [[0.0, R, 0.05], [0.0, R, 0.15]], atol=1e-9
    )  # the line ends with the pad
    assert PAD[1] == 0.1
    speed = RAIL_MASS / (RAIL_MASS + MASS)
    np.testing.assert_allclose(found.object_twist, [0.0, -speed, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


def test_a_ball_that_slides_rolls_with_five_sevenths_of_its_speed() -> None:
    """After 2 v_0 / (7 mu g), whatever its mass (Coriolis 1835)."""
    friction, speed = 0.3, 0.7
    physics = free(item(SPHERE), 0.0, friction, gravity=np.array([0.0, 0.0, -G]), arms=FAR)
    state = resting(position=np.array([0.0, 0.0, R]), twist=np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]))
    begins = 2.0 * speed / (7.0 * friction * G)
    result = run(physics, [0.0], state, 2.0 * begins)
    half = round(0.5 * begins / PERIOD)
    assert result.twists[half, 0] == pytest.approx(speed - friction * G * half * PERIOD, rel=1e-3)
    np.testing.assert_allclose(result.twists[-1, :3], [5.0 / 7.0 * speed, 0.0, 0.0], atol=1e-3)
    assert result.twists[-1, 4] == pytest.approx(5.0 / 7.0 * speed / R, rel=2e-3)


@pytest.mark.parametrize(("lean", "falls"), [(0.95, False), (1.05, True)])
def test_a_bottle_tips_where_its_centre_of_mass_is_beyond_its_base(lean: float, falls: bool) -> None:
    """Its critical lean is atan(R / h) with h the height of its centre of mass; kills a rim of fixed points alone."""
    low = -0.03
    bottle = item(CYLINDER, 0.3, com_offset=np.array([0.0, 0.0, low]))
    angle = lean * np.arctan(R / (0.15 + low))
    height = 0.15 * np.cos(angle) + R * np.sin(angle)
    way = np.array([np.cos(0.4), np.sin(0.4), 0.0])  # between two of the points of a flat base
    rotation = pin.exp3(angle * np.cross([0.0, 0.0, 1.0], way))
    physics = free(bottle, 0.0, 0.8, gravity=np.array([0.0, 0.0, -G]), arms=FAR)
    result = run(physics, [0.0], resting(position=np.array([0.0, 0.0, height]), rotation=rotation), 0.25)
    w, x, y = result.poses[-1, 6], result.poses[-1, 3], result.poses[-1, 4]
    after = np.arccos(1.0 - 2.0 * (x * x + y * y))
    assert abs(w) <= 1.0 and (after > angle) == falls


@pytest.mark.parametrize("shape", [SPHERE, CYLINDER], ids=lambda shape: shape.kind)
def test_twin_and_map_agree_on_a_push_with_the_restitution_of_the_pad(shape: ConvexShape) -> None:
    """A ball loads a quarter of a pad, a wall half of it; kills a restitution that takes the whole face."""
    height = 2.0 * R if shape.kind == "sphere" else 0.16
    hand = rail(np.array([0.0, R, height / 2.0]), AGAINST_Y, pad_damping=800.0, pad_mobility=1.0 / RAIL_MASS)
    thing = item(shape, height)
    physics = scene({"rail": hand}, object=thing, support_height=0.0, restitution=hand.pad_restitution(thing))
    state = resting(position=np.array([0.0, 0.0, height / 2.0]))
    expected = impact(replace(physics, support_friction=0.0), state, {"rail": ArmState(np.zeros(1), np.array([0.5]))})
    result = run(physics, [0.5], state, 0.02)
    assert result.arms["rail"].velocity[-1, 0] == pytest.approx(expected.joint_velocity["rail"][0], rel=2e-3)
    np.testing.assert_allclose(result.twists[-1, :3], expected.object_twist[:3], atol=2e-3)
