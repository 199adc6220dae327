# SPDX-License-Identifier: Apache-2.0
"""The drive that is assumed for an arm is stable, as published where that is known, and does not swing in a loop."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_sim.assumed_drive import assumed_drive
from impact_rs_sim.drive_stability import spectral_radius
from impact_rs_sim.robot import RobotFacts, load_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario

UR5E, FR3, FER = (load_facts(name) for name in ("ur5e", "franka_fr3", "franka_fer"))
PERIOD = 2.5e-4


@pytest.mark.parametrize("facts", [FER, FR3, UR5E])
def test_assumed_drives_are_stable_and_as_published_where_that_is_known(facts: RobotFacts) -> None:
    effector = load_scenario("push").robots["arm"].end_effector.build()
    values = {name: np.array(row) for name, row in assumed_drive(facts, effector, PERIOD).items()}
    inertia = values.get("motor_inertia_reduced", values["motor_inertia_rotor"])
    model = RobotModel(facts, effector)
    inverse = np.linalg.inv(model.mass_matrix(0.3 * np.ones(facts.joint_count))) + np.diag(1.0 / inertia)
    assert spectral_radius(inverse, values["stiffness"], values["damping"], PERIOD) < 1.0
    assert ("motor_inertia_reduced" in values) == facts.joint_torque_loop
    published = facts.reflected_rotor_inertia_other_source_kg_m2
    if published is not None:
        np.testing.assert_allclose(values["motor_inertia_rotor"], published, rtol=5e-3)


@pytest.mark.parametrize("facts", [FR3, UR5E, load_facts("kuka_iiwa14")])
def test_link_velocity_feedback_leaves_an_assumed_drive_stable(facts: RobotFacts) -> None:
    """Eigenvalues of motor, spring and link with the feedback 40 / s of the controller through both inertias.

    B ddtheta = -(M + B) d dq - s,  M ddq = s,  s = K (theta - q) + D (dtheta - dq): the joint by itself, with the
    link that it has in the middle of its range.
    """
    model = RobotModel(facts, load_scenario("push").robots["arm"].end_effector.build())
    values = {name: np.array(row) for name, row in assumed_drive(facts, model.end_effector, PERIOD).items()}
    motors = values.get("motor_inertia_reduced", values["motor_inertia_rotor"])
    inertia = 1.0 / np.diag(np.linalg.inv(model.mass_matrix(0.5 * (model.position_min + model.position_max) + 0.3)))
    for joint in range(3):
        m, b, k, d = inertia[joint], motors[joint], values["stiffness"][joint], values["damping"][joint]
        system = np.array(
            [
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [-k / m, k / m, -d / m, d / m],
                [k / b, -k / b, d / b - (m + b) * 40.0 / b, -d / b],
            ]
        )
        assert np.linalg.eigvals(system).real.max() < 1e-6
