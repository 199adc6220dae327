# SPDX-License-Identifier: Apache-2.0
"""What every effect answers about itself: scalars, steps, bounds, complexity, phases and identity."""

from dataclasses import replace

import numpy as np
import pytest
from bench import bench

from impact_rs_sim.effects import ArmEffect, Parameter, SceneEffect, library
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError

STRIBECK = library()["joint_stribeck_friction"]
PAYLOAD = library()["end_effector_payload"]


def test_a_parameter_per_joint_has_a_scalar_for_every_joint():
    for count in (1, 6, 7):
        scalars = STRIBECK.scalars(count)
        assert [scalar.name for scalar in scalars] == [
            *(f"breakaway_joint{joint + 1}" for joint in range(count)),
            "stribeck_velocity",
        ]
        assert [scalar.joint for scalar in scalars] == [*range(count), None]
        assert STRIBECK.complexity(count) == count
    with pytest.raises(InputError, match="2 finite numbers"):
        STRIBECK.apply_vector(bench(), np.zeros(8))


def test_shape_parameters_do_nothing_while_the_effect_is_off(physics):
    assert [scalar.name for scalar in PAYLOAD.scalars(7) if scalar.shape] == ["com_x", "com_y", "com_z", "gyration"]
    assert PAYLOAD.complexity(7) == 1
    assert library()["torque_offset"].complexity(7) == 7
    for effect in library().values():
        off = effect.nominal(7)
        for index, scalar in enumerate(effect.scalars(7)):
            if scalar.shape:
                off[index] += scalar.difference
                assert (scalar.hidden is None) == (scalar.prior is not None)  # then nothing is hidden of it
                if scalar.hidden is not None:
                    assert scalar.lower <= scalar.hidden[0] < scalar.hidden[1] <= scalar.upper
                assert all(scalar.lower <= value <= scalar.upper for value in scalar.grid)
        same = effect.apply_vector(physics, off)
        if any(scalar.shape for scalar in effect.scalars(7)):
            assert all(same.arms[name] is arm for name, arm in physics.arms.items())


def test_joints_that_slide_have_newtons_and_ranges_of_a_pinion():
    """A torque of 1 N m behind a pinion of 50 mm is a force of 20 N, and 1 N m s/rad is 400 N s/m."""
    kinds = ("prismatic", "revolute")
    coulomb = library()["joint_coulomb_friction"]
    assert [(scalar.name, scalar.unit) for scalar in coulomb.scalars(kinds)] == [
        ("coulomb_joint1", "N"),
        ("coulomb_joint2", "N m"),
    ]
    assert [scalar.upper for scalar in coulomb.scalars(kinds)] == pytest.approx([100.0, 5.0])
    np.testing.assert_allclose(coulomb.steps(kinds, np.zeros(2)), [2.0, 0.1])
    (rail, _) = library()["joint_viscous_friction"].scalars(kinds)
    assert (rail.unit, rail.upper) == ("N s/m", pytest.approx(2000.0))
    assert [scalar.unit for scalar in library()["torque_gain"].scalars(kinds)] == ["-", "-"]
    assert coulomb.scalars(2) == coulomb.scalars(("revolute",) * 2)
    facts = bench().arms["arm"].facts
    rails = facts.model_copy(update={"joints": tuple(j.model_copy(update={"type": "prismatic"}) for j in facts.joints)})
    physics = replace(bench(), arms={"arm": replace(bench().arms["arm"], facts=rails)})
    lower, upper = library()["torque_offset"].bounds(physics)
    np.testing.assert_allclose(upper, 100.0)
    np.testing.assert_allclose(lower, -100.0)


def test_steps_go_the_other_way_where_a_bound_is_in_the_way():
    stiffness = library()["joint_stiffness"]
    np.testing.assert_allclose(stiffness.steps(7, np.array([1.0])), [0.1])
    np.testing.assert_allclose(stiffness.steps(7, np.array([2.95])), [-0.1])
    grip = library()["pad_friction"]
    np.testing.assert_allclose(grip.steps(7, np.array([0.0])), [-0.4])
    np.testing.assert_allclose(grip.steps(7, np.array([-1.9])), [0.4])


def test_bounds_are_those_of_the_parameters(physics):
    for effect in library().values():
        if effect.name in ("object_com_offset", "pad_friction", "support_friction", "link_inertia"):
            continue  # inside the box: test_object.py; never less than none: test_contact.py, test_link.py
        lower, upper = effect.bounds(physics)
        scalars = effect.scalars(7)
        np.testing.assert_array_equal(upper, [scalar.upper for scalar in scalars])
        np.testing.assert_array_equal(lower, [scalar.lower for scalar in scalars])


def test_effects_of_the_contact_are_not_seen_in_free_motion():
    seen = {name: effect.seen_in(contact=False) for name, effect in library().items()}
    assert [name for name, free in seen.items() if not free] == [
        "restitution",
        "pad_compliance",
        "pad_friction",
        "support_friction",
        "object_mass",
        "object_com_offset",
        "pad_shear",
        "pad_creep",
        "pad_tilt",
        "support_compliance",
        "rolling_resistance",
        "restitution_fall",
        "tangential_restitution",
        "drilling_friction",
        "spin_axes",
    ]
    assert all(effect.seen_in(contact=True) for effect in library().values())


def test_unequal_joint_counts_cannot_share_a_parameter_per_joint(physics):
    pair = replace(physics, arms={"left": physics.arms["arm"], "right": bench().arms["arm"]})
    with pytest.raises(InputError, match="left 7, right 1"):
        library()["torque_offset"].apply_vector(pair, np.zeros(7))
    softer = library()["joint_stiffness"].apply_vector(pair, np.array([0.5]))
    np.testing.assert_array_equal(softer.arms["right"].stiffness, 0.5 * pair.arms["right"].stiffness)


def louder(physics, values):
    return replace(physics, pad_friction=physics.pad_friction * (1.0 + values["size"][0]))


def test_identity_tells_effects_laws_and_parameters_apart():
    identities = [effect.identity for effect in library().values()]
    assert len(set(identities)) == len(identities)
    parameter = Parameter("size", "-", 0.0, 0.0, 1.0, 0.1, "size")
    one = SceneEffect("loud", "scene", "It is loud.", (parameter,), louder)
    assert one.identity == replace(one).identity
    assert one.identity != replace(one, parameters=(replace(parameter, upper=2.0),)).identity
    assert one.identity != replace(one, law=unheard).identity
    assert one.identity != ArmEffect("loud", "scene", "It is loud.", (parameter,), louder).identity


def unheard(physics, values):
    return physics


def test_identity_of_a_formula_is_that_of_its_text():
    def effect(text):
        number = {"unit": "N", "lower": 0.0, "upper": 1.0, "scale": 0.1}
        content = {"name": "drag", "sentence": "s", "end_effector_force": {"y": text}, "parameters": {"k": number}}
        return FormulaEffect(FormulaSpec.model_validate(content))

    assert effect("-k * vy").identity == effect("-k * vy").identity
    assert effect("-k * vy").identity != effect("k * vy").identity
