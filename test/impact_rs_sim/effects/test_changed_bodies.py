# SPDX-License-Identifier: Apache-2.0
"""No effect leaves a link, a motor or the object as something that cannot exist, whoever wrote the effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench import LINK_MASS, TOOL_MASS, bench

from impact_rs_sim.bodies import second_moments
from impact_rs_sim.effects import ArmEffect, Effect, Parameter, library
from impact_rs_sim.effects.depending import Depending, Slope
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import mounted_inertia
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.recordings.mapping import load_mapping

PAYLOAD = library()["end_effector_payload"]


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
        PAYLOAD.apply_vector(physics, np.array([-0.0156, *side]))
    assert PAYLOAD.apply_vector(physics, np.array([0.0156, *side])) is not physics  # there may be more


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.01, 0.0, -0.04), (0.03, -0.02, -0.06)])
def test_as_much_is_removable_as_leaves_a_positive_pseudo_inertia(place: tuple[float, float, float]) -> None:
    physics = bare_flange()
    most = removable(physics.arms["arm"], np.array(place))
    assert 0.25 < most < 0.7355
    assert not fails(PAYLOAD, physics, [-0.999 * most, *place])
    assert fails(PAYLOAD, physics, [-1.001 * most, *place])
    assert fails(PAYLOAD, physics, [-0.9 * most, *place, 0.2])  # nor a body that is larger than the link


def test_two_effects_together_leave_a_body_too() -> None:
    """Of a link that is half as heavy less can be taken away."""
    physics, lighter = bare_flange(), np.where(np.arange(7) == 6, 0.5, 1.0)
    less = [-0.4, 0.0, 0.0, -0.04]
    assert not fails(PAYLOAD, physics, less)
    assert fails(PAYLOAD, library()["link_mass"].apply_vector(physics, lighter), less)


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
    assert not fails(PAYLOAD, wrong, [0.3, 0.0, 0.0, 0.0])


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
        "object_mass",
    }
