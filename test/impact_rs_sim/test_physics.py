# SPDX-License-Identifier: Apache-2.0
"""Joint friction in closed form, and the nominal physics of a scenario."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, JointFriction, Load, LoadState, Physics
from impact_rs_sim.robot import SigmoidFriction
from impact_rs_sim.scenario import load_scenario

PUSH = load_scenario("push")
FRICTION = JointFriction(
    coulomb=np.array([0.5, 0.3]),
    viscous=np.array([0.2, 0.1]),
    stribeck=np.array([0.4, 0.6]),
    stribeck_velocity=np.array([0.1, 0.05]),
)


def test_far_from_rest_coulomb_and_viscous_friction_oppose_the_motion() -> None:
    for velocity in (2.0, -2.0):
        expected = -np.sign(velocity) * (FRICTION.coulomb + FRICTION.viscous * abs(velocity))
        np.testing.assert_allclose(FRICTION.torque(np.full(2, velocity)), expected, atol=1e-9)


def test_breakaway_excess_falls_to_1_over_e_at_the_stribeck_velocity() -> None:
    velocity = FRICTION.stribeck_velocity
    expected = FRICTION.coulomb + FRICTION.stribeck / np.e + FRICTION.viscous * velocity
    np.testing.assert_allclose(-FRICTION.torque(velocity), expected, rtol=1e-6)


def test_friction_vanishes_at_rest_and_is_full_soon_after() -> None:
    np.testing.assert_array_equal(FRICTION.torque(np.zeros(2)), 0.0)
    slow = FRICTION.torque(np.full(2, 4.0 * FRICTION.smoothing))
    full = FRICTION.coulomb + FRICTION.stribeck * np.exp(
        -np.square(4.0 * FRICTION.smoothing / FRICTION.stribeck_velocity)
    )
    np.testing.assert_allclose(-slow, full + FRICTION.viscous * 4.0 * FRICTION.smoothing, rtol=1e-3)


def test_identified_friction_is_the_published_sigmoid_against_the_motion() -> None:
    """Gaz et al. 2019: tau_f = a / (1 + exp(-b (dq + c))) - a / (1 + exp(-b c)); it vanishes at rest."""
    a, b, c = np.array([0.55, 0.87]), np.array([5.1, 9.1]), np.array([0.0395, 0.0258])
    friction = replace(JointFriction.none(2), sigmoid=SigmoidFriction(a=tuple(a), b=tuple(b), c=tuple(c)))
    np.testing.assert_allclose(friction.torque(np.zeros(2)), 0.0, atol=1e-15)
    rest = a / (1.0 + np.exp(-b * c))
    np.testing.assert_allclose(friction.torque(np.full(2, 50.0)), rest - a, rtol=1e-9)
    np.testing.assert_allclose(friction.torque(np.full(2, -50.0)), rest, rtol=1e-9)
    step = 1e-6
    slope = (friction.torque(np.full(2, step)) - friction.torque(np.full(2, -step))) / (2.0 * step)
    np.testing.assert_allclose(slope, -b * rest * (1.0 - rest / a), rtol=1e-6)


def test_no_friction_is_none_and_any_part_of_it_is_some() -> None:
    none = JointFriction.none(2)
    assert none.is_zero
    assert not np.any(none.torque(np.array([1.0, -3.0])))
    for name in ("coulomb", "viscous", "stribeck"):
        assert not replace(none, **{name: np.array([0.0, 0.1])}).is_zero
    sigmoid = SigmoidFriction(a=(0.1, 0.1), b=(5.0, 5.0), c=(0.0, 0.0))
    assert not replace(none, sigmoid=sigmoid).is_zero


def test_the_three_motor_inertias_are_those_of_the_scenario() -> None:
    arm = Physics.nominal(PUSH, "juice").arms["arm"]
    drive = PUSH.robots["arm"].drive
    expected = {"reduced": drive.motor_inertia_reduced, "rotor": drive.motor_inertia_rotor, "zero": np.zeros(7)}
    assert set(expected) == set(MOTOR_INERTIA_MODELS)
    for name, values in expected.items():
        np.testing.assert_array_equal(arm.motor_inertia(name), values)


def test_nominal_physics_takes_each_number_from_its_own_key() -> None:
    robot = PUSH.robots["arm"]
    pad = robot.end_effector.pad.model_copy(update={"stiffness": 1.2e5, "damping": 77.0})
    drive = robot.drive.model_copy(
        update={
            "stiffness": tuple(np.linspace(1e4, 2e4, 7)),
            "damping": tuple(np.linspace(1.0, 2.0, 7)),
            "actuation_delay": 0.002,
        }
    )
    end_effector = robot.end_effector.model_copy(update={"pad": pad})
    scenario = PUSH.model_copy(
        update={
            "robots": {"arm": robot.model_copy(update={"end_effector": end_effector, "drive": drive})},
            "contact": PUSH.contact.model_copy(update={"friction": 0.61, "restitution": 0.2}),
            "support": PUSH.support.model_copy(update={"friction": 0.17, "height": 0.3}),
        }
    )
    physics = Physics.nominal(scenario, "juice")
    arm = physics.arms["arm"]
    assert (physics.pad_friction, physics.restitution) == (0.61, 0.2)
    assert (physics.support_friction, physics.support_height) == (0.17, 0.3)
    assert (arm.pad_stiffness, arm.pad_damping, arm.actuation_delay) == (1.2e5, 77.0, 0.002)
    np.testing.assert_array_equal(arm.stiffness, drive.stiffness)
    np.testing.assert_array_equal(arm.damping, drive.damping)
    np.testing.assert_array_equal(arm.torque_gain, 1.0)
    np.testing.assert_array_equal(arm.torque_offset, 0.0)
    np.testing.assert_allclose(physics.gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(arm.impact_position, robot.impact.position)


def test_a_box_has_the_moments_of_a_homogeneous_one() -> None:
    """m / 12 (y^2 + z^2) about x, and so on; by summing over a grid of points."""
    thing = Physics.nominal(PUSH, "juice").object
    axes = [(np.arange(60) + 0.5) / 60.0 * size - size / 2.0 for size in thing.size]
    x, y, z = (values.ravel() for values in np.meshgrid(*axes, indexing="ij"))
    grid = [np.mean(y**2 + z**2), np.mean(x**2 + z**2), np.mean(x**2 + y**2)]
    np.testing.assert_allclose(thing.inertia, thing.mass * np.array(grid), rtol=1e-3)


@pytest.mark.parametrize("thing", PUSH.objects)
def test_every_object_has_its_own_mass(thing: str) -> None:
    assert Physics.nominal(PUSH, thing).object.mass == PUSH.objects[thing].mass


def test_the_robot_model_feels_the_gravity_of_its_physics() -> None:
    physics = Physics.nominal(PUSH, "juice")
    q = np.array(PUSH.robots["arm"].impact.joint_guess)
    level = physics.robot_model("arm").gravity_torque(q)
    assert np.abs(level).max() > 5.0
    upside_down = replace(physics, gravity=-physics.gravity).robot_model("arm")
    np.testing.assert_allclose(upside_down.gravity_torque(q), -level, atol=1e-9)
    none = replace(physics, gravity=np.zeros(3)).robot_model("arm")
    np.testing.assert_allclose(none.gravity_torque(q), 0.0, atol=1e-9)


def test_a_load_that_says_nothing_does_nothing() -> None:
    state = LoadState(0.0, np.zeros(7), np.zeros(7), np.zeros(3), np.zeros(3), np.zeros(3))
    assert (Load().motor_torque(state), Load().joint_torque(state), Load().end_effector_force(state)) == (None,) * 3
