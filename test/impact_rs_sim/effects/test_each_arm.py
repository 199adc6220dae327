# SPDX-License-Identifier: Apache-2.0
"""Arms that do not share their parameters: each has its own set, with as many joints as it has."""

from dataclasses import replace

import numpy as np
import pytest
from mixed_grab import JOINTS, MIXED, with_own

from impact_rs_sim.effects import library
from impact_rs_sim.effects.each_arm import of_each
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics


@pytest.fixture(scope="module")
def physics() -> Physics:
    return Physics.nominal(MIXED, "parcel")


def each(name: str):
    return of_each(library()[name], JOINTS)


def test_parameters_belong_to_arm_and_joint() -> None:
    scalars = each("joint_stribeck_friction").scalars(0)
    names = [scalar.name for scalar in scalars]
    assert names[0] == "breakaway_left_joint1" and names[6:8] == ["breakaway_left_joint7", "stribeck_velocity_left"]
    assert names[8:] == [*(f"breakaway_right_joint{joint}" for joint in range(1, 7)), "stribeck_velocity_right"]
    assert [(scalar.arm, scalar.joint) for scalar in scalars[12:]] == [("right", 4), ("right", 5), ("right", None)]
    assert [scalars[n].shared_name for n in (6, 7, 8)] == ["breakaway_joint7", "stribeck_velocity", "breakaway_joint1"]
    assert each("joint_stribeck_friction").complexity(0) == 13


def test_friction_of_one_arm_opposes_that_arm_alone(physics: Physics) -> None:
    """At full speed tanh is 1: the torque is minus the Coulomb friction of the joint, and nothing in the other arm."""
    values = np.zeros(13)
    values[7 + 1] = 2.0
    hidden = with_own(physics, "joint_coulomb_friction", values)
    np.testing.assert_allclose(hidden.arms["right"].friction.torque(np.ones(6)), [0.0, -2.0, 0.0, 0.0, 0.0, 0.0])
    assert hidden.arms["left"].friction.is_zero


def test_each_arm_has_the_delay_of_its_own_on_top_of_what_it_has(physics: Physics) -> None:
    late = with_own(with_own(physics, "actuation_delay", [0.001, 0.004]), "actuation_delay", [0.002, 0.0])
    assert [arm.actuation_delay for arm in late.arms.values()] == pytest.approx([0.003, 0.004])


def test_what_all_arms_share_is_the_same_for_each(physics: Physics) -> None:
    shared = library()["motor_inertia_scale"].apply_vector(physics, [1.4])
    own = with_own(physics, "motor_inertia_scale", [1.4, 1.4])
    for name, arm in shared.arms.items():
        np.testing.assert_array_equal(own.arms[name].motor_inertia_reduced, arm.motor_inertia_reduced)


def test_bounds_are_those_of_the_arm(physics: Physics) -> None:
    """What the last link weighs with its end effector may go; a light one says nothing of the other arm."""
    left = physics.arms["left"]
    *others, last = left.facts.links
    facts = left.facts.model_copy(update={"links": (*others, last.model_copy(update={"mass": 0.1}))})
    light = replace(left, facts=facts, end_effector=replace(left.end_effector, mass=0.2))
    lower, upper = each("end_effector_payload").bounds(replace(physics, arms={**physics.arms, "left": light}))
    assert (lower[0], lower[5]) == pytest.approx((-0.3, -0.5))
    assert upper.shape == (10,)
    lower, _ = each("end_effector_payload").bounds(replace(physics, arms={"left": light}))
    assert (lower[0], lower[5]) == pytest.approx((-0.3, -0.5))


def test_an_arm_without_parameters_is_told(physics: Physics) -> None:
    alone = replace(physics, arms={"arm": physics.arms["left"]})
    with pytest.raises(InputError, match="arms left with 7 joints, right with 6 joints; here is arm 'arm' with 7"):
        each("torque_offset").apply_vector(alone, np.zeros(13))
    swapped = replace(physics, arms={"right": physics.arms["left"]})
    with pytest.raises(InputError, match="here is arm 'right' with 7 joints"):
        each("torque_offset").bounds(swapped)
    with pytest.raises(InputError, match="needs 13 finite numbers"):
        each("torque_offset").apply_vector(physics, np.zeros(7))
    with pytest.raises(InputError, match="share a parameter per joint, found: left 7, right 6"):
        library()["torque_offset"].apply_vector(physics, np.zeros(7))


def test_effects_of_the_scene_belong_to_no_arm() -> None:
    assert of_each(library()["object_mass"], JOINTS) is library()["object_mass"]
    assert of_each(library()["torque_offset"], {}) is library()["torque_offset"]
    assert each("torque_offset").identity != library()["torque_offset"].identity
