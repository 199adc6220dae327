# SPDX-License-Identifier: Apache-2.0
"""Payload: a point mass on the end effector weighs, and it resists being turned."""

from dataclasses import replace

import numpy as np
import pytest
from bench import (
    ACROSS,
    FIRST_MOMENT,
    GRAVITY,
    LINK_COM,
    LINK_INERTIA,
    LINK_MASS,
    MASS_MATRIX,
    MOTOR_INERTIA,
    REACH,
    TOOL_MASS,
    bench,
    run,
    slope,
    switched_on,
)

from impact_rs_sim.effects import library

PAYLOAD = {"mass": 0.8, "com_x": 0.05, "com_y": -0.12, "com_z": 0.03}


@pytest.mark.parametrize("q", [0.0, 0.7, -1.9])
@pytest.mark.parametrize("sign", [1.0, -0.25])
def test_payload_raises_the_holding_torque_by_weight_times_lever(q, sign):
    """Across, link x is (cos q, 0, -sin q) and link y is (-sin q, 0, -cos q): height of the mass, and dV/dq."""
    values = {**PAYLOAD, "mass": sign * PAYLOAD["mass"]}
    physics = switched_on(bench(ACROSS), "end_effector_payload", **values)
    before = -FIRST_MOMENT * GRAVITY * np.cos(q)
    lever = -(REACH + values["com_x"]) * np.cos(q) + values["com_y"] * np.sin(q)
    found = physics.robot_model("arm").gravity_torque(np.array([q]))[0]
    assert found == pytest.approx(before + values["mass"] * GRAVITY * lever, rel=1e-9)


def test_payload_adds_the_inertia_of_a_point_mass_about_the_axis():
    physics = switched_on(bench(), "end_effector_payload", **PAYLOAD)
    added = PAYLOAD["mass"] * ((REACH + PAYLOAD["com_x"]) ** 2 + PAYLOAD["com_y"] ** 2)
    motion = run(physics, lambda time: 2.0)
    expected = 2.0 / (MASS_MATRIX + added + MOTOR_INERTIA)
    assert slope(motion.time, motion.velocity, 0.2, 0.39) == pytest.approx(expected, rel=0.005)


def test_payload_follows_the_parallel_axis_theorem_about_every_axis():
    """About the origin of E, inertia and first moment of the point mass add to those of the tool."""
    bare = bench()
    tool = replace(bare.arms["arm"].end_effector, com=np.array([0.01, 0.02, -0.03]))
    physics = replace(bare, arms={"arm": replace(bare.arms["arm"], end_effector=tool)})
    loaded = switched_on(physics, "end_effector_payload", **PAYLOAD).arms["arm"].end_effector
    place = np.array([PAYLOAD["com_x"], PAYLOAD["com_y"], PAYLOAD["com_z"]])

    def of_points(mass, at):
        cross = np.array([[0.0, -at[2], at[1]], [at[2], 0.0, -at[0]], [-at[1], at[0], 0.0]])
        return -mass * cross @ cross

    expected = tool.inertia + of_points(tool.mass, tool.com) + of_points(PAYLOAD["mass"], place)
    np.testing.assert_allclose(loaded.inertia + of_points(loaded.mass, loaded.com), expected, atol=1e-12)
    np.testing.assert_allclose(loaded.mass * loaded.com, tool.mass * tool.com + PAYLOAD["mass"] * place, atol=1e-12)


@pytest.mark.parametrize(("on_the_flange", "lowest"), [(TOOL_MASS, -0.45), (0.0, 0.0), (2.0, -0.5)])
def test_at_most_nine_tenths_of_the_flange_mass_can_be_taken_away(on_the_flange, lowest):
    physics = bench()
    arm = physics.arms["arm"]
    physics = replace(physics, arms={"arm": replace(arm, end_effector=replace(arm.end_effector, mass=on_the_flange))})
    lower, upper = library()["end_effector_payload"].bounds(physics)
    assert lower[0] == pytest.approx(lowest)
    np.testing.assert_array_equal(upper, [3.0, 0.2, 0.2, 0.2])
    np.testing.assert_array_equal(lower[1:], -0.2)


@pytest.mark.parametrize("q", [0.0, 0.7, -1.9])
def test_a_heavier_link_weighs_and_resists_in_proportion(q):
    model = switched_on(bench(ACROSS), "link_mass", scale_joint1=1.3).robot_model("arm")
    moment = FIRST_MOMENT + 0.3 * LINK_MASS * LINK_COM
    assert model.gravity_torque(np.array([q]))[0] == pytest.approx(-moment * GRAVITY * np.cos(q), rel=1e-9)
    added = 0.3 * (LINK_INERTIA + LINK_MASS * LINK_COM**2)
    assert model.mass_matrix(np.array([q]))[0, 0] == pytest.approx(MASS_MATRIX + added, rel=1e-9)


@pytest.mark.parametrize("q", [0.0, 0.7, -1.9])
def test_a_link_whose_centre_lies_elsewhere_turns_with_its_weight_there(q):
    x, y = 0.03, -0.02
    model = switched_on(bench(ACROSS), "link_com", com_x_joint1=x, com_y_joint1=y).robot_model("arm")
    lever = -(FIRST_MOMENT + LINK_MASS * x) * np.cos(q) + LINK_MASS * y * np.sin(q)
    assert model.gravity_torque(np.array([q]))[0] == pytest.approx(GRAVITY * lever, rel=1e-9)
    added = LINK_MASS * ((LINK_COM + x) ** 2 + y**2 - LINK_COM**2)
    assert model.mass_matrix(np.array([q]))[0, 0] == pytest.approx(MASS_MATRIX + added, rel=1e-9)


def test_a_link_s_moment_about_its_axis_adds_to_the_mass_matrix_and_weighs_nothing():
    model = switched_on(bench(ACROSS), "link_inertia", inertia_joint1=0.07).robot_model("arm")
    assert model.mass_matrix(np.array([0.4]))[0, 0] == pytest.approx(MASS_MATRIX + 0.07, rel=1e-9)
    assert model.gravity_torque(np.array([0.4]))[0] == pytest.approx(-FIRST_MOMENT * GRAVITY * np.cos(0.4), rel=1e-9)


def test_a_link_keeps_a_part_of_its_moment_and_its_centre_within_reach():
    lower, _ = library()["link_inertia"].bounds(bench())
    assert lower == pytest.approx([-0.99 * LINK_INERTIA])
    for parameter in library()["link_com"].parameters:
        assert parameter.widened() == parameter
