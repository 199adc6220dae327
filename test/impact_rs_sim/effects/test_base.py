# SPDX-License-Identifier: Apache-2.0
"""What every effect answers about itself; effects that depend on a circumstance; effects of each arm by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import bench
from impact_table_cases import cube
from mixed_grab import JOINTS, MIXED, with_own

from impact_rs_sim.effects import ArmEffect, Parameter, SceneEffect, library
from impact_rs_sim.effects.depending import Depending, Levels, Slope
from impact_rs_sim.effects.each_arm import of_each
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.effects.quantity_laws import Added, Multiplied
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics

# ---- scalars, steps, bounds, complexity, phases and identity --------------------------------------------------------

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


def test_laws_of_one_quantity_add_up_and_multiply(physics):
    """Kills: a component of a tuple that takes another's parameter, and an error where the quantity is None."""
    (arm,) = physics.arms.values()
    turned = Added("end_effector.pad_tilt", ("roll", "pitch"))
    once = turned(arm, {"roll": np.array([0.01]), "pitch": np.array([0.03])})
    twice = turned(once, {"pitch": np.array([0.04]), "roll": np.array([0.02])})
    assert twice.end_effector.pad_tilt == pytest.approx((0.03, 0.07))
    uneven = Added("friction.asymmetry", ("difference",), per_joint=True)
    first = uneven(arm, {"difference": np.arange(7.0)})
    assert arm.friction.asymmetry is None and np.array_equal(first.friction.asymmetry, np.arange(7.0))
    assert np.array_equal(uneven(first, {"difference": np.ones(7)}).friction.asymmetry, 1.0 + np.arange(7.0))
    softer, rigid = Multiplied("pad_stiffness", "scale"), replace(arm, pad_stiffness=None)
    assert softer(arm, {"scale": np.array([0.5])}).pad_stiffness == 0.5 * arm.pad_stiffness
    assert softer(rigid, {"scale": np.array([0.5])}) is rigid
    assert softer(arm, {"scale": np.ones(1)}) is arm and uneven(arm, {"difference": np.zeros(7)}) is arm


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
    (drift, _) = library()["torque_sensor_drift"].scalars(kinds)
    assert (drift.unit, drift.upper) == ("N/s", pytest.approx(0.1))
    assert [scalar.unit for scalar in library()["link_inertia"].scalars(kinds)] == ["kg m^2", "kg m^2"]
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
        "contact_dissipation",
        "restitution_threshold",
        "tangential_restitution",
        "drilling_friction",
        "spin_axes",
        "mirrored_spins",
        "twist_axes",
        "tracked_point_of_impact",
        "pad_position",
        "tracker_frame",
        "tracked_point",
        "tracker_delay",
        "tracker_lag",
        "tracker_butterworth",
        "stiff_control",
        "neighbour_mass",
        "object_friction",
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


# ---- a value under each level, or a line over a number --------------------------------------------------------------

FRICTION, TANGENTIAL = library()["support_friction"], library()["tangential_restitution"]
BY_SESSION = Depending(FRICTION, "session", Levels(("A", "B")))
BY_TEMPERATURE = Depending(FRICTION, "temperature", Slope(mean=20.0, spread=5.0))


def under(**circumstances: float | str) -> Physics:
    return replace(cube(friction=0.5), circumstances=circumstances)


def test_a_level_has_its_own_value_and_an_unknown_one_the_mean() -> None:
    values = np.array([-0.2, 0.1])
    friction = {
        level: BY_SESSION.apply_vector(under(session=level), values).support_friction for level in ("A", "B", "C")
    }
    assert friction == pytest.approx({"A": 0.3, "B": 0.6, "C": 0.45})


def test_a_number_moves_the_value_along_a_line() -> None:
    """0.5 - 0.1 at the mean of 20, and 0.05 less with every 5 more."""
    at = [BY_TEMPERATURE.apply_vector(under(temperature=t), np.array([-0.1, -0.05])) for t in (15.0, 20.0, 30.0)]
    assert [physics.support_friction for physics in at] == pytest.approx([0.45, 0.4, 0.3])


def test_alike_under_all_circumstances_it_is_the_effect_itself() -> None:
    for pair, physics in ((BY_SESSION, under(session="B")), (BY_TEMPERATURE, under(temperature=31.0))):
        found = pair.apply_vector(physics, pair.at(np.array([-0.2]), ()))
        assert found.support_friction == FRICTION.apply_vector(physics, np.array([-0.2])).support_friction
        np.testing.assert_array_equal(pair.nominal(()), pair.at(FRICTION.nominal(()), ()))


def test_no_level_falls_below_no_friction_and_a_change_spans_the_range() -> None:
    lower, upper = BY_SESSION.bounds(under(session="A"))
    assert (lower.tolist(), upper.tolist()) == ([-0.5, -0.5], [2.0, 2.0])
    lower, upper = BY_TEMPERATURE.bounds(under(temperature=0.0))
    assert (lower.tolist(), upper.tolist()) == ([-0.5, -2.5], [2.0, 2.5])


def test_shapes_are_the_same_everywhere_and_cost_nothing() -> None:
    pair = Depending(TANGENTIAL, "session", Levels(("A", "B", "C")))
    assert [scalar.name for scalar in pair.scalars(())] == ["restitution A", "restitution B", "restitution C", "fall"]
    assert (pair.complexity(()), TANGENTIAL.complexity(())) == (3, 1)
    found = pair.apply_vector(under(session="B"), np.array([0.1, 0.4, 0.7, 0.02]))
    one = TANGENTIAL.apply_vector(under(session="B"), np.array([0.4, 0.02]))
    assert found.contact_laws == one.contact_laws


# ---- a set of parameters for each arm, with as many joints as it has ------------------------------------------------


@pytest.fixture(scope="module")
def mixed() -> Physics:
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


def test_friction_of_one_arm_opposes_that_arm_alone(mixed: Physics) -> None:
    """At full speed tanh is 1: the torque is minus the Coulomb friction of the joint, and nothing in the other arm."""
    values = np.zeros(13)
    values[7 + 1] = 2.0
    hidden = with_own(mixed, "joint_coulomb_friction", values)
    np.testing.assert_allclose(hidden.arms["right"].friction.torque(np.ones(6)), [0.0, -2.0, 0.0, 0.0, 0.0, 0.0])
    assert hidden.arms["left"].friction.is_zero


def test_each_arm_has_the_delay_of_its_own_on_top_of_what_it_has(mixed: Physics) -> None:
    late = with_own(with_own(mixed, "actuation_delay", [0.001, 0.004]), "actuation_delay", [0.002, 0.0])
    assert [arm.actuation_delay for arm in late.arms.values()] == pytest.approx([0.003, 0.004])


def test_what_all_arms_share_is_the_same_for_each(mixed: Physics) -> None:
    shared = library()["motor_inertia_scale"].apply_vector(mixed, [1.4])
    own = with_own(mixed, "motor_inertia_scale", [1.4, 1.4])
    for name, arm in shared.arms.items():
        np.testing.assert_array_equal(own.arms[name].motor_inertia_reduced, arm.motor_inertia_reduced)


def test_bounds_are_those_of_the_arm(mixed: Physics) -> None:
    """What the last link weighs with its end effector may go; a light one says nothing of the other arm."""
    left = mixed.arms["left"]
    *others, last = left.facts.links
    facts = left.facts.model_copy(update={"links": (*others, last.model_copy(update={"mass": 0.1}))})
    light = replace(left, facts=facts, end_effector=replace(left.end_effector, mass=0.2))
    lower, upper = each("end_effector_payload").bounds(replace(mixed, arms={**mixed.arms, "left": light}))
    assert (lower[0], lower[5]) == pytest.approx((-0.3, -0.5))
    assert upper.shape == (10,)
    lower, _ = each("end_effector_payload").bounds(replace(mixed, arms={"left": light}))
    assert (lower[0], lower[5]) == pytest.approx((-0.3, -0.5))


def test_an_arm_without_parameters_is_told(mixed: Physics) -> None:
    alone = replace(mixed, arms={"arm": mixed.arms["left"]})
    with pytest.raises(InputError, match="arms left with 7 joints, right with 6 joints; here is arm 'arm' with 7"):
        each("torque_offset").apply_vector(alone, np.zeros(13))
    swapped = replace(mixed, arms={"right": mixed.arms["left"]})
    with pytest.raises(InputError, match="here is arm 'right' with 7 joints"):
        each("torque_offset").bounds(swapped)
    with pytest.raises(InputError, match="needs 13 finite numbers"):
        each("torque_offset").apply_vector(mixed, np.zeros(7))
    with pytest.raises(InputError, match="share a parameter per joint, found: left 7, right 6"):
        library()["torque_offset"].apply_vector(mixed, np.zeros(7))


def test_effects_of_the_scene_belong_to_no_arm() -> None:
    assert of_each(library()["object_mass"], JOINTS) is library()["object_mass"]
    assert of_each(library()["torque_offset"], {}) is library()["torque_offset"]
    assert each("torque_offset").identity != library()["torque_offset"].identity
