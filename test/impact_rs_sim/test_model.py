# SPDX-License-Identifier: Apache-2.0
"""Model files: checked without the robot, and refused when they meet one with another number of joints."""

import copy
from dataclasses import replace
from pathlib import Path

import pytest
from mixed_grab import MIXED

from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, check_model, load_model, parse_model, save_model
from impact_rs_sim.physics import Physics


def item(name, **values):
    units = {"offset": "N m", "coulomb": "N m", "breakaway": "N m", "stribeck": "rad/s"}
    return {
        "name": name,
        "parameters": {
            key: {"estimate": value, "unit": units.get(key.split("_")[0], "-")} for key, value in values.items()
        },
    }


def offsets(*joints):
    return item("torque_offset", **{f"offset_joint{joint}": 0.1 * joint for joint in joints})


def checked(*effects):
    return check_model(Model.model_validate({"name": "m", "effects": effects}), "m.yaml")


def test_a_model_file_may_be_for_any_number_of_joints(physics):
    for count in (1, 6, 7, 12):
        checked(offsets(*range(1, count + 1)))
    applied = checked(offsets(*range(1, 8))).apply(physics)
    assert applied.arms["arm"].torque_offset == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])


@pytest.mark.parametrize("count", [1, 6, 8])
def test_a_model_for_another_number_of_joints_does_not_fit_the_arm(count, physics):
    model = checked(offsets(*range(1, count + 1)))
    with pytest.raises(InputError, match=rf"'m' is for arms with {count} joints \(effect torque_offset\).* has 7"):
        model.apply(physics)


def test_a_model_of_an_arm_that_slides_says_newtons_and_fits_no_other(physics):
    facts = physics.arms["arm"].facts
    joints = (facts.joints[0].model_copy(update={"type": "prismatic"}), *facts.joints[1:])
    rail = replace(physics.arms["arm"], facts=facts.model_copy(update={"joints": joints}))
    on_rail, turning = replace(physics, arms={"arm": rail}), offsets(*range(1, 8))
    sliding = copy.deepcopy(turning)
    sliding["parameters"]["offset_joint1"] = {"estimate": 60.0, "unit": "N"}
    assert checked(sliding).apply(on_rail).arms["arm"].torque_offset[0] == 60.0  # one that turns: 5 N m
    with pytest.raises(
        InputError, match="'m' has torque_offset.offset_joint1 in N, this arm has it in N m: that joint"
    ):
        checked(sliding).apply(physics)
    with pytest.raises(InputError, match="offset_joint1 in N m, this arm has it in N: that joint moves otherwise"):
        checked(turning).apply(on_rail)
    sliding["parameters"]["offset_joint1"]["estimate"] = 12000.0
    with pytest.raises(InputError, match=r"expected -5000 ... 5000 N \(added torque\)"):
        checked(sliding)


def test_a_model_without_parameters_per_joint_fits_any_arm(physics):
    assert load_model("nominal").apply(physics) is physics
    softer = checked(item("joint_stiffness", scale=0.5)).apply(physics)
    assert softer.arms["arm"].stiffness == pytest.approx(0.5 * physics.arms["arm"].stiffness)


@pytest.mark.parametrize(
    ("effects", "complaint"),
    [
        ([offsets(1, 2, 4)], r"offset_joint3: this key is missing \(added torque \[N m\]\); joint 4 is here"),
        ([offsets()], r"offset_joint1: this key is missing"),
        ([offsets(1, 2), item("joint_coulomb_friction", coulomb_joint1=0.1)], "has 1 joints, but torque_offset has 2"),
        ([item("torque_offset", offset_joint1=0.1, offset_joint0=0.1)], "offset_joint0: unknown parameter"),
        ([item("torque_offset", offset_joint1=0.1, offset_joint99999999999=0.1)], "unknown parameter"),
        ([item("joint_stribeck_friction", breakaway_joint1=0.1)], "stribeck_velocity: this key is missing"),
        ([item("joint_stiffness", scale_joint1=0.5)], "scale_joint1: unknown parameter; joint_stiffness has: scale"),
    ],
)
def test_joints_are_numbered_from_1_without_gaps_and_alike_in_all_effects(effects, complaint):
    with pytest.raises(InputError, match=rf"m\.yaml: effects.*{complaint}"):
        checked(*effects)


def mass(scale):
    return item("object_mass", scale=scale)


def test_every_effect_of_a_model_is_applied_on_top_of_those_before(physics):
    both = checked(item("pad_compliance", scale=0.25), item("restitution", restitution=0.3)).apply(physics)
    softer = checked(item("pad_compliance", scale=0.25)).apply(physics)
    assert both.arms["arm"].pad_stiffness == softer.arms["arm"].pad_stiffness
    assert both.arms["arm"] == checked(item("restitution", restitution=0.3)).apply(softer).arms["arm"]


def test_an_effect_that_stands_twice_is_refused():
    """Kills: it acts twice, so that two masses of 1.5 times the assumed one make 2.25 times."""
    with pytest.raises(InputError, match=r"m\.yaml: effects\.1\.name = 'object_mass': this effect stands here twice"):
        checked(mass(1.5), mass(1.5))


def test_a_child_replaces_an_estimate_and_names_its_parent(physics):
    parent = checked(mass(1.2), offsets(*range(1, 8)))
    child = parent.with_effect(ModelEffect.model_validate(mass(1.1)), "child", "parent.yaml")
    assert [effect.name for effect in child.effects] == ["object_mass", "torque_offset"]
    assert child.apply(physics).object.mass == pytest.approx(1.1 * physics.object.mass)
    assert (child.parent, child.parent_digest) == ("parent.yaml", parent.digest)
    assert parent.apply(physics).object.mass == pytest.approx(1.2 * physics.object.mass)


def test_an_estimate_that_stays_changes_no_prediction(physics):
    """Restitution and stiffness of a pad do not commute. Kills a child that puts the new estimate last."""
    parent = checked(item("restitution", restitution=0.3), item("pad_compliance", scale=0.25))
    child = parent.with_effect(parent.effects[0], "child", "parent.yaml")
    before, after = (model.apply(physics).arms["arm"].pad_damping for model in (parent, child))
    assert after == before


def test_the_digest_is_of_the_physics_and_of_nothing_else():
    one = checked(mass(1.2))
    assert one.digest == one.model_copy(update={"name": "other", "note": "why", "parent": "p.yaml"}).digest
    assert one.digest != checked(mass(1.21)).digest


@pytest.mark.parametrize(
    ("effect", "complaint"),
    [
        (item("ghost"), "unknown effect"),
        (item("object_mass", offset=1.2), "unknown parameter"),
        (mass(-3.0), "mass over its assumed value"),
        ({**mass(1.2), "parameters": {"scale": {"estimate": 1.2, "unit": "kg"}}}, "expected the unit '-'"),
    ],
)
def test_what_an_effect_does_not_allow_is_refused_with_file_and_key(effect, complaint):
    with pytest.raises(InputError, match=rf"m\.yaml: effects\.0.*{complaint}"):
        checked(effect)


def test_a_model_that_is_written_is_read_back_and_never_overwritten(tmp_path: Path):
    path = tmp_path / "models" / "mine.yaml"
    written = checked(offsets(1, 2, 3), mass(1.2))
    save_model(written, path)
    assert load_model(path).effects == written.effects
    with pytest.raises(InputError, match="never overwritten"):
        save_model(written, path)


def mixed_model(*effects):
    return check_model(Model.model_validate({"name": "m", "arms": {"left": 7, "right": 6}, "effects": effects}), "m")


def own_offsets(left=7, right=6):
    joints = {"left": left, "right": right}
    return item(
        "torque_offset",
        **{f"offset_{arm}_joint{n + 1}": 0.1 * (n + 1) for arm, count in joints.items() for n in range(count)},
    )


def test_different_arms_have_own_parameters_beside_shared_ones(tmp_path):
    physics = Physics.nominal(MIXED, "parcel")
    inertia = item("motor_inertia_scale", scale_left=2.0, scale_right=1.0)
    model = mixed_model(item("joint_stiffness", scale=0.5), own_offsets(), inertia)
    save_model(model, tmp_path / "m.yaml")
    read = load_model(tmp_path / "m.yaml")
    assert read.digest == model.digest
    applied = read.apply(physics)
    for name, count in (("left", 7), ("right", 6)):
        before, after = physics.arms[name], applied.arms[name]
        assert after.torque_offset == pytest.approx([0.1 * (n + 1) for n in range(count)])
        assert after.stiffness == pytest.approx(0.5 * before.stiffness)
    assert applied.arms["left"].motor_inertia_reduced == pytest.approx(2.0 * physics.arms["left"].motor_inertia_reduced)


def test_a_model_of_one_arm_each_names_every_joint_of_every_arm(physics):
    with pytest.raises(InputError, match=r"offset_right_joint6: this key is missing \(added torque \[N m\]\)$"):
        mixed_model(own_offsets(right=5))
    with pytest.raises(InputError, match="offset_right_joint7: unknown parameter"):
        mixed_model(own_offsets(right=7))
    with pytest.raises(InputError, match="offset_left_joint1: unknown parameter"):
        checked(own_offsets())
    with pytest.raises(InputError, match="here is arm 'arm' with 7 joints"):
        mixed_model(own_offsets()).apply(physics)
    with pytest.raises(InputError, match="arms.left"):
        parse_model("{name: m, arms: {left: 0}}", "m.yaml")
