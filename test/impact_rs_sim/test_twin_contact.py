# SPDX-License-Identifier: Apache-2.0
"""Contacts of the twin obey closed forms: restitution, momentum, energy, friction, tipping, shear and creep of pads."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from closed_forms import restitution_of
from twin_scene import (
    AGAINST_Y,
    BOX_MASS,
    PAD,
    PERIOD,
    RAIL_MASS,
    SIZE,
    TOWARDS_Y,
    rail,
    resting,
    run,
    scene,
)

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.twin import Result, TwinJob, simulate

REDUCED = RAIL_MASS * BOX_MASS / (RAIL_MASS + BOX_MASS)  # kg
STIFFNESS, SPEED, G = 2e5, 0.5, 9.81
FAR = rail(np.array([0.0, 5.0, 0.0]), AGAINST_Y)
ON_TABLE = partial(resting, position=np.array([0.0, 0.0, SIZE[2] / 2.0]))


def bounce(gap: float, period: float = PERIOD, damping: float = 0.0, **pad: Any) -> tuple[Physics, Result]:
    """The rail hits the free box after ``gap`` [m]."""
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + gap, 0.0]), AGAINST_Y, pad_damping=damping, **pad)
    physics = scene({"rail": mass})
    return physics, run(physics, [SPEED], resting(), 0.03, period=period)


def bounces(ratio: float, period: float = PERIOD) -> Array:
    """Restitution wherever in the step the contact begins."""
    damping = 2.0 * ratio * np.sqrt(STIFFNESS * REDUCED)
    found = []
    for gap in np.linspace(1e-3, 1e-3 + SPEED * period, 8, endpoint=False):
        _, result = bounce(gap, period, damping)
        found.append((result.twists[-1, 1] + result.arms["rail"].velocity[-1, 0]) / -SPEED)
    return np.array(found)


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.2, 0.5, 0.9, 1.5, 3.0, 10.0])
def test_a_mass_bounces_as_in_the_closed_form(ratio: float) -> None:
    """From 1 down to 0.002, at 4 kHz, to 0.002 of the speed before."""
    np.testing.assert_allclose(bounces(ratio), restitution_of(ratio), atol=2e-3)


def test_without_a_damper_no_energy_is_lost_or_made() -> None:
    np.testing.assert_allclose(bounces(0.0), 1.0, atol=1e-12)


def test_half_the_step_has_a_quarter_of_the_error() -> None:
    errors = [abs(np.mean(bounces(0.9, PERIOD / n)) - restitution_of(0.9)) for n in (1, 2, 4)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_a_stiff_pad_bounces_though_a_step_cannot_resolve_it() -> None:
    """Half a period of its oscillation is a third of a step."""
    _, result = bounce(1e-3, pad_stiffness=1e9)
    assert result.twists[-1, 1] + result.arms["rail"].velocity[-1, 0] == pytest.approx(-SPEED, rel=1e-9)


def test_a_rigid_pad_does_not_bounce() -> None:
    _, result = bounce(1e-3, pad_stiffness=None)
    shared = -SPEED * RAIL_MASS / (RAIL_MASS + BOX_MASS)
    assert result.twists[-1, 1] == pytest.approx(shared, rel=1e-4)
    assert -result.arms["rail"].velocity[-1, 0] == pytest.approx(shared, rel=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_a_step_on_a_rigid_pad_is_the_impact_map(seed: int) -> None:
    """What the judge of the impact map accepts, the twin's first step gives: it yields by 1e-4 of the speed."""
    rng = np.random.default_rng(seed)
    mass = rail(np.array([*(0.02 * rng.standard_normal(1)), SIZE[1] / 2.0, 0.02]), AGAINST_Y, pad_stiffness=None)
    physics = scene({"rail": mass}, pad_friction=0.3)
    box = resting(twist=np.array([0.2, 0.1, 0.2, 0.5, 0.5, 0.5]) * rng.standard_normal(6))
    result = run(physics, [SPEED], box, PERIOD)
    problem = ImpactProblem(physics, {"rail": ArmState(np.zeros(1), np.full(1, SPEED))}, box, {"rail": np.zeros(1)})
    wanted = compute_impact_map(problem)
    assert wanted.residual.largest < 1e-8 and len(wanted.contacts) == 4
    np.testing.assert_allclose(result.arms["rail"].velocity[-1], wanted.joint_velocity["rail"], atol=2e-4 * SPEED)
    np.testing.assert_allclose(result.twists[-1, :3], wanted.object_twist[:3], atol=2e-4)
    np.testing.assert_allclose(result.twists[-1, 3:], wanted.object_twist[3:], atol=2e-3)


@pytest.mark.parametrize("off", [0.0, 0.03, -0.05])
def test_edges_that_cross_hit_each_other_along_their_common_normal(off: float) -> None:
    """A pad turned by 45 degrees meets the upright edge of a cube turned by 45 degrees ``off`` [m] its middle."""
    side, ahead = 0.16, PAD[1] / 2.0 * np.sqrt(0.5)
    cube = ObjectPhysics(BOX_MASS, np.full(3, side), np.full(3, BOX_MASS * side**2 / 6.0), np.zeros(3))
    gap, edge = 0.02, side * np.sqrt(0.5)
    mass = rail(np.array([0.0, edge + ahead + gap, off]), AGAINST_Y, tilt=(np.pi / 4.0, 0.0), pad_stiffness=1e7)
    leading = mass.end_effector.pad_placement.rotation @ np.array([0.0, PAD[1] / 2.0, 0.0])
    mass = replace(mass, base=mass.base * pin.SE3(np.eye(3), np.array([0.0, -np.sign(leading[2]) * leading[1], 0.0])))
    start = resting(rotation=pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 4.0))
    result = run(scene({"rail": mass}, object=cube), [SPEED], start, 0.06)
    touched = PERIOD * int(np.argmax(np.abs(result.twists[:, 1]) > 0.0))
    assert touched == pytest.approx(gap / SPEED, abs=2.0 * PERIOD)
    impulse = 2.0 * SPEED / (1.0 / RAIL_MASS + 1.0 / BOX_MASS + off**2 / cube.inertia[0])
    assert result.arms["rail"].velocity[-1, 0] == pytest.approx(SPEED - impulse / RAIL_MASS, rel=2e-3)
    wanted = np.array([0.0, -impulse / BOX_MASS, 0.0, off * impulse / cube.inertia[0], 0.0, 0.0])
    np.testing.assert_allclose(result.twists[-1], wanted, rtol=5e-3, atol=2e-3)  # the edge turns while it presses


def motion(physics: Physics, result: Result) -> tuple[Array, Array]:
    """Momentum of rail and box along y, ``(k,)``, and kinetic energy, ``(k,)``."""
    speed, box = -result.arms["rail"].velocity[:, 0], physics.object
    axes = np.array([pin.Quaternion(pose[3:]).matrix() for pose in result.poses])
    own = np.einsum("kji,kj->ki", axes, result.twists[:, 3:])
    energy = 0.5 * RAIL_MASS * speed**2 + 0.5 * box.mass * np.sum(np.square(result.twists[:, :3]), axis=1)
    return RAIL_MASS * speed + box.mass * result.twists[:, 1], energy + 0.5 * np.square(own) @ box.inertia


def oblique(seed: int, friction: float) -> tuple[Physics, Result]:
    """A turned box that moves and spins is hit by a tilted pad off its middle."""
    rng = np.random.default_rng(seed)
    turn = pin.rpy.rpyToMatrix(*(0.05 * rng.standard_normal(3)))
    box = BodyState(0.02 * rng.standard_normal(3), turn, 0.3 * rng.standard_normal(6))
    tilt = tuple(0.04 * rng.standard_normal(2))
    mass = rail(np.array([0.03, SIZE[1] / 2.0 + 0.08, 0.02]), AGAINST_Y, pad_damping=100.0, tilt=tilt)
    physics = scene({"rail": mass}, pad_friction=friction)
    return physics, run(physics, [1.5], box, 0.1)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_an_oblique_hit_keeps_momentum_and_makes_no_energy(seed: int, friction: float) -> None:
    physics, result = oblique(seed, friction)
    momentum, energy = motion(physics, result)
    assert abs(momentum[-1] - momentum[0]) < 1e-12
    assert energy.max() <= energy[0] * (1.0 + 1e-6)
    assert energy[-1] < 0.999 * energy[0]


def test_a_box_that_tumbles_keeps_its_angular_momentum() -> None:
    physics = scene({"far": FAR})
    result = run(physics, [0.0], resting(twist=np.array([0.0, 0.0, 0.0, 3.0, -2.0, 5.0])), 0.2)
    turning = []
    for pose, twist in zip(result.poses[[0, -1]], result.twists[[0, -1]], strict=True):
        axes = pin.Quaternion(pose[3:]).matrix()
        turning.append(axes @ (physics.object.inertia * (axes.T @ twist[3:])))
    np.testing.assert_allclose(turning[1], turning[0], rtol=2e-3)


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_friction_opposes_the_sliding_velocity(yaw: float) -> None:
    """Along a diagonal of the box, to a thousandth of a degree, with Coulomb's size."""
    physics = scene({"far": FAR}, gravity=np.array([0.0, 0.0, -G]), support_height=0.0)
    before = np.array([0.3, 0.2])
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    start = ON_TABLE(twist=np.array([*before, 0, 0, 0, 0]), rotation=turn)
    result = run(physics, [0.0], start, 0.1)
    after = result.twists[-1, :2]
    assert np.linalg.norm(before) - np.linalg.norm(after) == pytest.approx(0.3 * G * 0.1, rel=1e-4)
    assert abs(before[0] * after[1] - before[1] * after[0]) < np.radians(1e-3) * np.linalg.norm(before) ** 2
    assert np.abs(result.twists[-1, 3:]).max() < 1e-5


def test_a_sliding_block_stops_where_its_energy_is_used_up() -> None:
    """v^2 / (2 mu g), less what the last velocity of every step takes off: h v / 2."""
    physics = scene({"far": FAR}, gravity=np.array([0.0, 0.0, -G]), support_height=0.0)
    result = run(physics, [0.0], ON_TABLE(twist=np.array([0.4, 0, 0, 0, 0, 0])), 0.2)
    closed = 0.4**2 / (2.0 * 0.3 * G) - 0.4 * PERIOD / 2.0
    assert result.poses[-1, 0] == pytest.approx(closed, abs=2e-7)
    assert np.abs(result.twists[-1]).max() < 1e-9


@pytest.mark.parametrize("rolling", [0.0, 0.008])
@pytest.mark.parametrize("excess", [-0.02, 0.02])
def test_a_box_tips_over_its_edge_beyond_the_angle_of_its_corner(rolling: float, excess: float) -> None:
    """tan of the tilt against half the width, and the lever of rolling resistance, over half the height."""
    limit = (SIZE[0] / 2.0 + rolling) / (SIZE[2] / 2.0)
    across = (limit + excess) / np.hypot(1.0, limit + excess)
    gravity = G * np.array([across, 0.0, -np.sqrt(1.0 - across**2)])
    physics = scene({"far": FAR}, gravity=gravity, support_height=0.0, support_friction=3.0, rolling_arm=rolling)
    result = run(physics, [0.0], ON_TABLE(twist=np.full(6, 1e-9)), 0.3)
    tilt = np.abs(result.poses[-1, 4])  # about y
    assert tilt > 0.01 if excess > 0.0 else tilt < 1e-5


def test_a_box_sleeps_until_it_is_touched() -> None:
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + 0.01, SIZE[2] / 2.0]), AGAINST_Y, pad_damping=800.0)
    physics = scene({"rail": mass}, gravity=np.array([0.0, 0.0, -G]), support_height=0.0)
    result = run(physics, [SPEED], ON_TABLE(), 0.04)
    touched = int(0.01 / SPEED / PERIOD)
    assert np.ptp(result.poses[: touched - 1], axis=0).max() == 0.0
    assert result.contact_steps < 0.6 * result.steps
    assert result.poses[-1, 1] < -1e-3


def test_two_pads_grab_a_box_and_hold_it_by_friction() -> None:
    """Mirror images: it stays in the middle, and does not fall while mu is large enough."""
    left = rail(np.array([0.0, -SIZE[1] / 2.0 - 0.002, 0.0]), TOWARDS_Y, pad_damping=2000.0)
    right = rail(np.array([0.0, SIZE[1] / 2.0 + 0.002, 0.0]), AGAINST_Y, pad_damping=2000.0)
    physics = scene({"left": left, "right": right}, pad_friction=0.5)
    holds = run(physics, [0.3, 0.3], resting(), 0.3, force=20.0)
    assert np.abs(holds.poses[-1, 1]) < 1e-9
    gravity = np.array([0.0, 0.0, -G])
    still = {"pad_friction": 0.5, "gravity": gravity}
    left, right = (
        replace(arm, base=pin.SE3(arm.base.rotation, arm.base.translation * [0, 1, 0])) for arm in (left, right)
    )
    for weight_over_friction, falls in ((0.9, False), (1.1, True)):
        force = BOX_MASS * G / (2.0 * 0.5 * weight_over_friction)
        result = run(scene({"left": left, "right": right}, **still), [0.0, 0.0], resting(), 0.2, force=force)
        fallen = result.poses[-1, 2] + 0.5 * G * 0.2**2  # of the whole way of a free fall, less that of a held one
        assert (result.poses[-1, 2] < -0.015) == falls, fallen


@pytest.mark.parametrize(("compliance", "creep"), [(15e-6, 0.0), (0.0, 1e-3), (15e-6, 1e-3)])
def test_a_pad_shears_by_c_f_and_creeps_at_c_f(compliance: float, creep: float) -> None:
    """A box on a pad that lies on a heavy rail, pulled along the face by a gravity that leans."""
    up, pull = np.eye(3), 2.0
    mass = rail(
        np.array([0.0, 0.0, -SIZE[2] / 2.0]),
        up,
        mass=1e7,
        pad_damping=2000.0,
        pad_shear_compliance=compliance,
        pad_creep=creep,
    )
    gravity = np.array([pull / BOX_MASS, 0.0, -G])
    physics = scene({"rail": mass}, gravity=gravity, pad_friction=0.9)
    result = run(physics, [0.0], resting(), 0.2, force=1e7 * G + BOX_MASS * G)
    assert result.twists[-1, 0] == pytest.approx(creep * pull, abs=2e-5)
    # Its middle: the sheared face, the way it crept, and the box that leans on a pad of finite stiffness.
    lean = pull * SIZE[2] / 2.0 / (STIFFNESS * (0.05**2)) * SIZE[2] / 2.0
    crept = creep * pull * 0.2
    assert result.poses[-1, 0] == pytest.approx(compliance * pull + crept + lean, rel=0.05, abs=2e-6)


@pytest.mark.parametrize("ratio", [0.05, 0.3])
def test_a_box_that_leaves_the_pad_flies_on_by_itself(ratio: float) -> None:
    """v = (1 + e) M V / (M + m) until the end, g t^2 / 2 down, ahead of the pad by e V times the time since contact."""
    damping, gap, duration = 2.0 * ratio * np.sqrt(STIFFNESS * REDUCED), 1e-3, 0.2
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + gap, 0.0]), AGAINST_Y, pad_damping=damping)
    physics = scene({"rail": mass}, gravity=np.array([0.0, 0.0, -G]))
    result = run(physics, [SPEED], resting(), duration)
    e = restitution_of(ratio)
    leaves = -(1.0 + e) * RAIL_MASS / (RAIL_MASS + BOX_MASS) * SPEED
    flying = result.twists[len(result.twists) // 4 :]
    np.testing.assert_allclose(flying[:, 1], leaves, rtol=3e-3)
    assert np.ptp(flying[:, 1]) < 1e-9  # nothing pushes or holds it any more
    assert result.poses[-1, 2] == pytest.approx(-0.5 * G * duration**2, rel=5e-3)
    ahead = -result.poses[-1, 1] - (result.arms["rail"].position[-1, 0] - gap)
    assert ahead == pytest.approx(e * SPEED * (duration - gap / SPEED), rel=0.05)


def test_a_step_whose_equations_are_singular_is_reported_and_leaves_numbers() -> None:
    """A pad of 1e290 N/m overflows, so that Newton's method has no step."""
    ticks, still = 40, np.zeros(1)
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + 1e-4, 0.0]), AGAINST_Y, pad_stiffness=1e290)
    job = TwinJob(
        scene({"rail": mass}),
        {"rail": ArmState(still, np.full(1, SPEED))},
        {"rail": DriveStart(still, still)},
        {"rail": still[None]},
        {"rail": np.zeros(ticks, dtype=np.int32)},
        np.arange(ticks + 1) * PERIOD,
        PERIOD,
        object=resting(),
        joint_torque=True,
    )
    (result,) = simulate([job])
    assert len(result.failed) > 0
    assert np.isfinite(result.twists).all() and np.isfinite(result.arms["rail"].velocity).all()
