"""Model files: checked without the robot, and refused when they meet one with another number of joints."""

import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, check_model, load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario


def item(name, **values):
    units = {"offset": "N m", "coulomb": "N m", "breakaway": "N m", "stribeck": "rad/s", "scale": "-"}
    return {
        "name": name,
        "parameters": {key: {"estimate": value, "unit": units[key.split("_")[0]]} for key, value in values.items()},
    }


def offsets(*joints):
    return item("torque_offset", **{f"offset_joint{joint}": 0.1 * joint for joint in joints})


def checked(*effects):
    return check_model(Model.model_validate({"name": "m", "effects": effects}), "m.yaml")


@pytest.fixture(scope="module")
def physics():
    return Physics.nominal(load_scenario("push"), "juice")


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
