# SPDX-License-Identifier: Apache-2.0
"""Payload and links: a body weighs and resists being turned; no effect leaves one that cannot exist."""

from __future__ import annotations

from collections.abc import Callable
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

from impact_rs_sim.effects import ArmEffect, Effect, Parameter, library
from impact_rs_sim.effects.depending import Depending, Slope
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robots.bodies import inertia_of, is_physically_consistent, second_moments
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import mounted_inertia
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.recordings.mapping import load_mapping

# ---- a payload, and links of another mass, centre and inertia -------------------------------------------------------

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


def test_a_payload_may_take_the_whole_tool_away():
    """Kills a tool of another mass in the Steiner terms than in the sum, off by mass times centre squared."""
    place = {name: 0.2 * value for name, value in PAYLOAD.items()}
    nearly, wholly = (
        switched_on(bench(), "end_effector_payload", **place | {"mass": less - TOOL_MASS}).robot_model("arm")
        for less in (3e-6, 0.0)
    )
    matrices = [model.mass_matrix(np.array([0.3])) for model in (nearly, wholly)]
    np.testing.assert_allclose(matrices[1], matrices[0], atol=1e-5)


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
    assert is_physically_consistent(link.mass, link.inertia_matrix) and is_physically_consistent(
        changed.mass, changed.inertia_matrix
    )
    assert changed.inertia[5] == pytest.approx(link.inertia[5] + more, rel=1e-12)


# ---- no effect leaves a link, a motor or the object as something that cannot exist ----------------------------------

PAYLOAD_EFFECT = library()["end_effector_payload"]


def bare_flange() -> Physics:
    """A Franka arm with nothing on its flange; its last link weighs 0.7355 kg."""
    mapping = load_mapping("joint_state")
    physics = Scene.resolve(load_scenario("push"), "juice", "case_1").physics
    arm = replace(physics.arms["arm"], facts=mapping.facts, end_effector=mapping.end_effector.build())
    return replace(physics, arms={"arm": arm})


def removable(arm: ArmPhysics, place: Array) -> float:
    """Largest point mass at a place without which the pseudo-inertia P is still positive: 1 / (x^T P^-1 x) [kg].

    x = (place, 1); by the determinant of P - m x x^T.
    """
    body = mounted_inertia(arm.facts, arm.end_effector)
    first = body.mass * body.lever
    moments = second_moments(body.inertia) + np.outer(first, body.lever)
    x = np.append(place, 1.0)
    return float(1.0 / (x @ np.linalg.solve(np.block([[moments, first[:, None]], [first, body.mass]]), x)))


def fails(effect: Effect, physics: Physics, vector: list[float]) -> bool:
    try:
        effect.apply_vector(physics, np.array(vector))
    except NotABody:
        return True
    return False


@pytest.mark.parametrize("side", [(0.36, 0.0, 0.0), (0.0, 0.36, 0.0), (0.0, -0.36, 0.0), (0.25, 0.25, -0.04)])
@pytest.mark.parametrize("make", [bare_flange, lambda: Scene.resolve(load_scenario("push"), "juice", "case_1").physics])
def test_sixteen_grams_are_not_taken_away_36_centimetres_beside_the_flange(
    make: Callable[[], Physics], side: tuple[float, float, float]
) -> None:
    """What an encoder that is 0.7 degrees off looked like: -0.0156 kg, where there is no mass at all."""
    physics = make()
    with pytest.raises(NotABody, match="takes away mass that is not there"):
        PAYLOAD_EFFECT.apply_vector(physics, np.array([-0.0156, *side]))
    assert PAYLOAD_EFFECT.apply_vector(physics, np.array([0.0156, *side])) is not physics  # there may be more


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.01, 0.0, -0.04), (0.03, -0.02, -0.06)])
def test_as_much_is_removable_as_leaves_a_positive_pseudo_inertia(place: tuple[float, float, float]) -> None:
    physics = bare_flange()
    most = removable(physics.arms["arm"], np.array(place))
    assert 0.25 < most < 0.7355
    assert not fails(PAYLOAD_EFFECT, physics, [-0.999 * most, *place])
    assert fails(PAYLOAD_EFFECT, physics, [-1.001 * most, *place])
    assert fails(PAYLOAD_EFFECT, physics, [-0.9 * most, *place, 0.2])  # nor a body that is larger than the link


def test_two_effects_together_leave_a_body_too() -> None:
    """Of a link that is half as heavy less can be taken away."""
    physics, lighter = bare_flange(), np.where(np.arange(7) == 6, 0.5, 1.0)
    less = [-0.4, 0.0, 0.0, -0.04]
    assert not fails(PAYLOAD_EFFECT, physics, less)
    assert fails(PAYLOAD_EFFECT, library()["link_mass"].apply_vector(physics, lighter), less)


def hollow(arm: ArmPhysics, values: dict[str, Array]) -> ArmPhysics:
    (link,) = arm.facts.links
    moment = link.inertia[5] + float(values["added"][0])
    link = link.model_copy(update={"inertia": (*link.inertia[:5], moment)})
    return replace(arm, facts=arm.facts.model_copy(update={"links": (link,)}))


HOLLOW = ArmEffect(
    name="hollow",
    acts_on="link inertia",
    sentence="An effect of a user who knows nothing of triangle inequalities.",
    parameters=(Parameter("added", "kg m^2", 0.0, -1.0, 1.0, 0.01, "moment about z"),),
    law=hollow,
)


def test_an_effect_of_a_user_leaves_a_body_as_well() -> None:
    """A sphere of 0.02 kg m^2, with a tool of 0.002 at its end, may have up to twice that about one axis."""
    assert not fails(HOLLOW, bench(), [0.015])
    assert fails(HOLLOW, bench(), [0.025]) and fails(HOLLOW, bench(), [-0.5])
    assert HOLLOW.changes_bodies(bench())
    with pytest.raises(NotABody, match="effect 'hollow' leaves link 1 of arm 'arm' a mass of 2.5 kg .* no rigid body"):
        HOLLOW.apply_vector(bench(), np.array([-0.5]))
    assert LINK_MASS + TOOL_MASS == 2.5


def test_a_mass_that_depends_on_a_covariate_is_positive_under_all_circumstances() -> None:
    """Within its range at the mean, a slope leads below zero at the ends."""
    effect = Depending(library()["object_mass"], "fill", Slope(0.0, 1.0))
    for fill, refused in ((0.0, False), (1.0, False), (2.0, True)):
        assert fails(effect, replace(bench(), circumstances={"fill": fill}), [0.9, -0.5]) == refused


def test_a_motor_has_no_negative_inertia() -> None:
    effect = Depending(library()["motor_inertia_scale"], "age", Slope(0.0, 1.0))
    with pytest.raises(NotABody, match="motor of joint 1 of arm 'arm' an inertia of -0.045 kg m"):
        effect.apply_vector(replace(bench(), circumstances={"age": 1.0}), np.array([1.0, -1.3]))


def test_a_body_that_the_model_itself_has_wrong_is_no_fault_of_an_effect() -> None:
    physics = bench()
    arm = physics.arms["arm"]
    link = arm.facts.links[0].model_copy(update={"inertia": (0.001, 0.0, 0.0, 0.001, 0.0, 0.5)})
    wrong = replace(physics, arms={"arm": replace(arm, facts=arm.facts.model_copy(update={"links": (link,)}))})
    assert not fails(PAYLOAD_EFFECT, wrong, [0.3, 0.0, 0.0, 0.0])


def test_only_some_effects_change_bodies() -> None:
    physics = Scene.resolve(load_scenario("push"), "juice", "case_1").physics
    changing = {name for name, effect in library().items() if effect.changes_bodies(physics)}
    assert changing == {
        "end_effector_payload",
        "link_mass",
        "link_com",
        "link_inertia",
        "motor_inertia_scale",
        "added_motor_inertia",
        "stiff_control",
        "object_mass",
    }
