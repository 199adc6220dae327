# SPDX-License-Identifier: Apache-2.0
"""Arms on ceilings and walls, and gravity in any direction: both simulators of the plant and Pinocchio agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.twin_mechanics import TwinMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.robot_spec import Base
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene

PUSH = load_scenario("push")
PERIOD, PERIODS = 0.00025, 200
MOUNTS = {"ceiling": {"roll": np.pi}, "wall": {"pitch": np.pi / 2.0, "yaw": 0.4}, "slope": {"roll": 0.5, "pitch": -0.3}}


def moved(mechanics: type, physics: Physics, q: Array) -> tuple[Array, Array]:
    """Joint velocities of the arm and position of the object after 50 ms without torque."""
    plant = mechanics.load(physics, PERIOD)
    start = BodyState(np.array([0.0, 3.0, 2.0]), np.eye(3), np.zeros(6))
    plant.start({"arm": ArmState(q, np.zeros(7))}, {"arm": DriveStart(np.zeros(7), np.zeros(7))}, start)
    plant.step({"arm": np.zeros(7)}, PERIODS, 0.0)
    found = plant.arm("arm").velocity.copy(), plant.object_state().position.copy()
    plant.close()
    return found


@pytest.mark.parametrize("mount", MOUNTS)
def test_an_arm_on_a_ceiling_or_wall_falls_alike_in_both_simulators(mount: str) -> None:
    """Kills a base that keeps its yaw alone, in the scenario or in one of them."""
    arm = PUSH.robots["arm"]
    base = Base(position=(0.1, 0.2, 1.5), **MOUNTS[mount])
    scenario = PUSH.model_copy(update={"robots": {"arm": arm.model_copy(update={"base": base})}})
    physics = replace(Physics.nominal(scenario, "parcel"), support_height=None)
    turns = [
        pin.utils.rotate(axis, getattr(base, name)) for axis, name in zip("zyx", ("yaw", "pitch", "roll"), strict=True)
    ]
    np.testing.assert_allclose(physics.arms["arm"].base.rotation, turns[0] @ turns[1] @ turns[2], atol=1e-12)
    q = np.array(arm.impact.joint_guess)
    (bullet, _), (twin, _) = (moved(mechanics, physics, q) for mechanics in (BulletMechanics, TwinMechanics))
    assert np.abs(twin).max() > 0.05
    np.testing.assert_allclose(bullet, twin, atol=0.02 * np.abs(twin).max())


def test_gravity_of_a_hanging_arm_is_that_of_a_standing_one_turned_round() -> None:
    q = np.array(PUSH.robots["arm"].impact.joint_guess)
    standing = Physics.nominal(PUSH, "parcel")
    turn = pin.rpy.rpyToMatrix(0.5, -0.3, 0.2)
    leaning = replace(standing, arms={"arm": replace(standing.arms["arm"], base=pin.SE3(turn, np.zeros(3)))})
    turned = replace(standing, gravity=turn.T @ standing.gravity)
    bias = [one.robot_model("arm").gravity_torque(q) for one in (leaning, turned)]
    np.testing.assert_allclose(bias[0], bias[1], atol=1e-10)


def test_gravity_of_a_scenario_acts_on_arm_and_object() -> None:
    """On a table that is tilted about x, and in weightlessness."""
    tilted = PUSH.with_settings({"gravity": [0.0, 3.0, -9.0]})
    physics = replace(Physics.nominal(tilted, "parcel"), support_height=None)
    q = np.array(PUSH.robots["arm"].impact.joint_guess)
    for mechanics in (BulletMechanics, TwinMechanics):
        _, position = moved(mechanics, physics, q)
        fall = 0.5 * np.array([0.0, 3.0, -9.0]) * (PERIOD * PERIODS) ** 2
        np.testing.assert_allclose(position - [0.0, 3.0, 2.0], fall, rtol=0.01, atol=1e-9)
    floating = replace(Physics.nominal(PUSH.with_settings({"gravity": [0.0, 0.0, 0.0]}), "parcel"), support_height=None)
    np.testing.assert_allclose(moved(TwinMechanics, floating, q)[1], [0.0, 3.0, 2.0], atol=1e-12)


def test_files_without_the_new_keys_are_written_without_them() -> None:
    """Kills a default that is written: digests of recorded scenarios would change."""
    written = PUSH.model_dump(mode="json")
    assert "gravity" not in written and "shape" not in written["objects"]["parcel"]
    assert set(written["robots"]["arm"]["base"]) == {"position", "yaw"}
    assert "shape" not in written["robots"]["arm"]["end_effector"]["pad"]
    assert Scenario.model_validate(written).digest == PUSH.digest


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("objects.parcel.shape", "sphere", "a sphere is round"),
        ("objects.parcel.shape", "bag", "box"),
        ("objects.parcel.inertia", [0.01, 0.01, 0.1], "no rigid body has these moments"),
        ("robots.arm.end_effector.pad.shape", "sphere", "three equal extents"),
    ],
)
def test_a_body_that_cannot_be_is_refused_with_a_sentence(key: str, value: object, told: str) -> None:
    with pytest.raises(InputError, match=told):
        PUSH.with_settings({key: value})


def test_a_cylinder_that_lies_is_met_at_its_wall_or_its_end() -> None:
    """Across the push its radius, along it half its length; kills a support function in axes of the world."""
    can = {"objects.can.size": [0.16, 0.16, 0.3], "support.height": 0.405}
    pad = load_scenario("push_bottle").robots["arm"].impact_placement.translation
    for rpy, reach in (((0.0, np.pi / 2.0, 0.0), 0.08), ((np.pi / 2.0, 0.0, 0.0), 0.15)):
        scenario = load_scenario("push_bottle").with_settings(can | {"objects.can.rpy": list(rpy)})
        thing = Scene.resolve(scenario, "can", "case_1")
        np.testing.assert_allclose(thing.object.position, [pad[0], pad[1] - reach, 0.405 + 0.08], atol=1e-12)
        result = compute_impact_map(ImpactProblem.at_nominal_impact(thing))
        assert {contact.body_b for contact in result.contacts} == {"arm", "support"}
        below = [contact for contact in result.contacts if contact.body_b == "support"]
        assert len(below) == 2  # a line on the table
