# SPDX-License-Identifier: Apache-2.0
"""A tool anywhere on the flange: map, twin, Bullet and URDF have it in one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, rail, resting, run, scene

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.bullet_world import mass_matrices
from impact_rs_sim.plant.twin_mechanics import TwinMechanics
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, Scene
from impact_rs_sim.shapes import SPHERE

OFFSET, TILT, YAW = (0.03, -0.05), (0.4, -0.3), 0.7
KEY = "robots.arm.end_effector"
SIDEWAYS = load_scenario("push").with_settings({f"{KEY}.mount_offset": list(OFFSET), f"{KEY}.mount_tilt": list(TILT)})


def test_a_tool_is_placed_by_its_numbers() -> None:
    """E on the flange is [x, y, length] with roll, pitch, yaw; kills a tilt after the yaw."""
    robot = SIDEWAYS.robots["arm"]
    effector = replace(robot.end_effector.build(), mount_yaw=YAW)
    facts = robot.robot_facts
    model = RobotModel(facts, effector, robot.base.placement)
    bare = RobotModel(
        facts, replace(effector, length=0.0, mount_yaw=0.0, mount_offset=(0.0, 0.0), mount_tilt=(0.0, 0.0))
    )
    q = np.array(robot.impact.joint_guess)
    mount = bare.placement(q).actInv(model.placement(q))
    np.testing.assert_allclose(mount.translation, [*OFFSET, effector.length], atol=1e-12)
    turned = pin.utils.rotate("z", YAW) @ pin.utils.rotate("y", TILT[1]) @ pin.utils.rotate("x", TILT[0])
    np.testing.assert_allclose(mount.rotation, turned, atol=1e-12)


def test_bullet_and_the_rigid_body_model_have_one_mass_matrix() -> None:
    robot = SIDEWAYS.robots["arm"]
    effector, facts = robot.end_effector.build(), robot.robot_facts
    heavy = replace(effector, mass=3.0, inertia=np.diag([0.01, 0.02, 0.015]))
    positions = np.random.default_rng(1).uniform(-1.0, 1.0, (5, facts.joint_count))
    model = RobotModel(facts, heavy)
    expected = np.array([model.mass_matrix(q) for q in positions])
    np.testing.assert_allclose(mass_matrices(facts, heavy, positions), expected, atol=1e-6)


def test_the_scene_has_the_pad_where_it_hits_and_both_plants_agree() -> None:
    """Square to the object although the flange is not; kills a twin that has the pad on the flange axis."""
    whole = Scene.resolve(SIDEWAYS, "juice", "case_1")
    place = whole.models["arm"].placement(whole.arms["arm"].position)
    np.testing.assert_allclose(place.rotation[:, 2], [0.0, -1.0, 0.0], atol=1e-6)
    found = compute_impact_map(ImpactProblem.at_nominal_impact(whole))
    assert len([one for one in found.contacts if one.body_b == "arm"]) == 4
    state = whole.arms["arm"]
    start = ArmState(state.position - 0.004 * state.velocity, state.velocity)
    torque = whole.models["arm"].gravity_torque(start.position)
    ends = []
    for plant in (BulletMechanics, TwinMechanics):
        mechanics = plant.load(whole.physics, PERIOD)
        mechanics.start({"arm": start}, {"arm": DriveStart(torque, np.zeros(7))}, whole.object)
        for tick in range(40):
            mechanics.step({"arm": torque}, 4, 1e-3 * tick)
        ends.append(np.append(mechanics.arm("arm").velocity, mechanics.object_state().twist))
        mechanics.close()
    assert abs(ends[0][8]) > 0.2  # it was hit
    np.testing.assert_allclose(*ends, atol=0.03)


@pytest.mark.parametrize("tilt", [0.2, -0.5])
@pytest.mark.parametrize("shift", [0.0, 0.02])
def test_a_rail_with_a_tilted_pad_pushes_a_ball_aside(tilt: float, shift: float) -> None:
    """J = v n_y / (1 / m + n_y^2 / M) along the normal of the pad, without friction; twice that by an elastic pad."""
    radius, mass = 0.05, BOX_MASS
    hand = rail(np.zeros(3), AGAINST_Y)
    tool = replace(hand.end_effector, mount_tilt=(tilt, 0.0), mount_offset=(shift, 0.0))
    ball = ObjectPhysics(mass, np.full(3, 2.0 * radius), np.full(3, 0.4 * mass * radius**2), np.zeros(3), SPHERE)
    physics: Physics = scene({"rail": replace(hand, end_effector=tool)}, object=ball)
    face = physics.robot_model("rail").placement(np.zeros(1))
    normal = face.rotation[:, 2]
    np.testing.assert_allclose(normal, AGAINST_Y @ pin.utils.rotate("x", tilt)[:, 2], atol=1e-12)
    thing = resting(position=face.translation + radius * normal)
    along = float(normal @ AGAINST_Y[:, 2])
    found = compute_impact_map(
        ImpactProblem(physics, {"rail": ArmState(np.zeros(1), np.ones(1))}, thing, {"rail": np.zeros(1)})
    )
    impulse = along / (1.0 / mass + along**2 / RAIL_MASS) * normal
    np.testing.assert_allclose(found.object_twist[:3], impulse / mass, atol=1e-9)
    result = run(physics, [1.0], thing, 0.03)
    np.testing.assert_allclose(result.twists[-1, :3], 2.0 * impulse / mass, atol=0.01)
