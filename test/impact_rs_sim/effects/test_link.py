# SPDX-License-Identifier: Apache-2.0
"""Payload: a body on the end effector weighs, and it resists being turned; links keep being bodies."""

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

from impact_rs_sim.bodies import inertia_of, is_body, second_moments
from impact_rs_sim.effects import Parameter, library

PAYLOAD = {"mass": 0.8, "com_x": 0.05, "com_y": -0.12, "com_z": 0.03}


@pytest.mark.parametrize("q", [0.0, 0.7, -1.9])
@pytest.mark.parametrize(("added", "nearer"), [(0.8, 1.0), (-0.2, 0.2)])  # what is taken away was there
def test_payload_raises_the_holding_torque_by_weight_times_lever(q, added, nearer):
    """Across, link x is (cos q, 0, -sin q) and link y is (-sin q, 0, -cos q): height of the mass, and dV/dq."""
    values = {name: nearer * value for name, value in PAYLOAD.items()} | {"mass": added}
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


def test_payload_that_is_no_point_resists_being_turned_by_its_radius_of_gyration_as_well():
    values = {**PAYLOAD, "gyration": 0.07}
    bare, point, body = (
        physics.robot_model("arm").mass_matrix(np.zeros(1))[0, 0]
        for physics in (
            bench(),
            switched_on(bench(), "end_effector_payload", **PAYLOAD),
            switched_on(bench(), "end_effector_payload", **values),
        )
    )
    assert bare == pytest.approx(MASS_MATRIX)
    assert body - point == pytest.approx(PAYLOAD["mass"] * 0.07**2, rel=1e-9)


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


@pytest.mark.parametrize(("on_the_flange", "lowest"), [(TOOL_MASS, -0.8), (0.0, -0.3), (2.0, -2.0)])
def test_no_more_can_be_taken_away_than_link_and_flange_weigh_and_no_payload_is_longer_than_the_arm(
    on_the_flange, lowest
):
    """The bench has one link, from its joint to the flange; the range of a search is 0.2 m at first."""
    arm = bench().arms["arm"]
    facts = arm.facts.model_copy(update={"links": (arm.facts.links[0].model_copy(update={"mass": 0.3}),)})
    arm = replace(arm, facts=facts, end_effector=replace(arm.end_effector, mass=on_the_flange))
    physics = replace(bench(), arms={"arm": arm})
    payload = library()["end_effector_payload"].with_parameters(Parameter.widened).with_parameters(Parameter.widened)
    lower, upper = payload.bounds(physics)
    assert lower == pytest.approx([lowest, -REACH, -REACH, -REACH, 0.0])
    assert upper == pytest.approx([12.0, REACH, REACH, REACH, REACH])
    given = library()["end_effector_payload"].with_parameters(lambda own: own.within(-0.9, 0.9))
    assert given.bounds(physics)[1][1:] == pytest.approx(np.full(4, 0.9))  # a stick that its user knows


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


@pytest.mark.parametrize("share", [-0.99, -0.5, 0.5, 20.0])
@pytest.mark.parametrize("moments", [(0.02, 0.02, 0.02), (0.001, 0.02, 0.02), (0.03, 0.01, 0.02), (0.02, 0.02, 1e-4)])
def test_a_link_with_any_moment_about_its_axis_is_a_body(moments, share):
    """Twenty times the moment about one axis alone, the others as they were, no density of mass has."""
    ixx, iyy, izz = moments
    arm = bench().arms["arm"]
    link = arm.facts.links[0].model_copy(update={"inertia": (ixx, 0.001, 0.0005, iyy, -0.0005, izz)})
    thicker = inertia_of(second_moments(link.inertia_matrix) + 0.002 * np.eye(3))
    link = link.model_copy(update={"inertia": tuple(thicker[np.triu_indices(3)].tolist())})
    facts = arm.facts.model_copy(update={"links": (link,)})
    physics = replace(bench(), arms={"arm": replace(arm, facts=facts)})
    more = share * link.inertia[5]
    changed = switched_on(physics, "link_inertia", inertia_joint1=more).arms["arm"].facts.links[0]
    assert is_body(link.mass, link.inertia_matrix) and is_body(changed.mass, changed.inertia_matrix)
    assert changed.inertia[5] == pytest.approx(link.inertia[5] + more, rel=1e-12)
