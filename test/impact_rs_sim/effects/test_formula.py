# SPDX-License-Identifier: Apache-2.0
"""Formulas in YAML: arithmetic and nothing else."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import nominal_physics, plan_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_sim.effects import library
from impact_rs_sim.effects.formula import Formula, FormulaEffect, FormulaParameter, FormulaSpec, load_formulas
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import LoadState

PARAMETER = {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 50.0, "scale": 1.0}


def spec(**changes):
    content = {
        "name": "cable_drag",
        "sentence": "A cable drags.",
        "end_effector_force": {"y": "-drag * vy"},
        "parameters": {"drag": PARAMETER},
    }
    return FormulaSpec.model_validate({**content, **changes})


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_formula_means_what_it_says(a, b):
    value = Formula("-a**2 + 2*sin(b) / (1 + abs(a)) - min(a, b) * tanh(b)", {"a", "b"})({"a": a, "b": b})
    assert value == pytest.approx(-(a**2) + 2 * math.sin(b) / (1 + abs(a)) - min(a, b) * math.tanh(b))


@pytest.mark.parametrize(("value", "sign"), [(-0.3, -1.0), (0.0, 0.0), (0.3, 1.0)])
def test_sign_is_zero_at_rest(value, sign):
    """Dry friction written with it pushes nothing that stands still."""
    assert Formula("sign(v)", {"v"})({"v": value}) == sign


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("2 +", "does not parse"),
        ("speed * 2", "unknown symbol 'speed'"),
        ("__import__('os').system('ls')", "arithmetic|unknown function"),
        ("(1).__class__", "only arithmetic"),
        ("[x for x in (1,)]", "only arithmetic"),
        ("lambda: 1", "only arithmetic"),
        ("open('f')", "unknown function 'open'"),
        ("sin(1, 2)", "takes 1 argument"),
        ("a if a else 1", "only arithmetic"),
        ("'text'", "only arithmetic"),
        ("True", "only arithmetic"),
        ("a = 1", "does not parse"),
        ("1" * 1001, "longer than"),
        ("(" * 199 + "a" + ")" * 198, "does not parse"),
    ],
)
def test_what_is_no_arithmetic_is_refused(text, complaint):
    with pytest.raises(InputError, match=complaint):
        Formula(text, {"a"})


def test_formula_effect_acts_on_the_plant_as_a_force_and_as_a_torque():
    effect = FormulaEffect(spec(joint_torque={"joint2": "drag * cos(q2)"}))
    physics = nominal_physics()
    load = effect.apply_vector(physics, np.array([4.0])).arms["arm"].loads[0]
    velocity = np.array([0.1, -0.5, 0.0])
    state = LoadState(0.2, np.full(7, 0.3), np.zeros(7), np.zeros(3), velocity, np.zeros(3))
    np.testing.assert_allclose(load.end_effector_force(state), [0.0, 2.0, 0.0])
    np.testing.assert_allclose(load.joint_torque(state)[1], 4.0 * np.cos(0.3))


def test_a_formula_effect_and_its_load_reach_a_worker_process_unchanged():
    effect = FormulaEffect(spec(motor_torque={"joint2": "-drag * dq2 / (1 + abs(dq2))"}))
    load = effect.apply_vector(nominal_physics(), np.array([4.0])).arms["arm"].loads[0]
    there, load_there = pickle.loads(pickle.dumps((effect, load)))
    state = LoadState(0.2, np.zeros(7), np.full(7, 0.3), np.zeros(3), np.array([0.1, -0.5, 0.0]), np.zeros(3))
    assert there.identity == effect.identity
    np.testing.assert_array_equal(load_there.motor_torque(state), load.motor_torque(state))
    np.testing.assert_array_equal(load_there.end_effector_force(state), [0.0, 2.0, 0.0])


def test_every_joint_has_its_own_position_and_speed():
    number = {"c": {**PARAMETER, "unit": "-"}}
    table = {f"joint{joint}": f"c * (q{joint} + 100 * dq{joint})" for joint in range(1, 8)}
    effect = FormulaEffect(spec(end_effector_force={}, parameters=number, motor_torque=table, joint_torque=table))
    load = effect.apply_vector(nominal_physics(), np.ones(1)).arms["arm"].loads[0]
    position, velocity = np.arange(1.0, 8.0), np.arange(0.1, 0.75, 0.1)
    state = LoadState(0.0, position, velocity, np.zeros(3), np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(load.motor_torque(state), position + 100.0 * velocity)
    np.testing.assert_allclose(load.joint_torque(state), position + 100.0 * velocity)


@pytest.mark.parametrize("text", ["exp(700) * exp(700) * c", "-exp(700) * exp(700) * c"])
def test_a_force_that_is_not_finite_is_refused(text):
    effect = FormulaEffect(spec(end_effector_force={"y": text}, parameters={"c": PARAMETER}))
    load = effect.apply_vector(nominal_physics(), np.ones(1)).arms["arm"].loads[0]
    with pytest.raises(InputError, match="'cable_drag' blows up at t = 0.200 s"):
        load.end_effector_force(LoadState(0.2, np.zeros(7), np.zeros(7), np.zeros(3), np.zeros(3), np.zeros(3)))


def test_a_constant_motor_torque_is_a_torque_offset_a_link_torque_is_not():
    plan = plan_of("push", "juice", "case_1")
    number = {"c": {**PARAMETER, "unit": "N m"}}
    ends = {}
    for key in ("motor_torque", "joint_torque"):
        effect = FormulaEffect(spec(end_effector_force={}, parameters=number, **{key: {"joint2": "c"}}))
        ends[key] = held(plan, effect.apply_vector(plan.scene.physics, np.array([0.5])))
    offset = held(plan, library()["torque_offset"].apply_vector(plan.scene.physics, np.eye(7)[1] * 0.5))
    np.testing.assert_allclose(ends["motor_torque"], offset, atol=1e-9)
    # A torque on the link drives motor and link alike, and the transmission carries the other part of it.
    assert offset[1] - ends["joint_torque"][1] == pytest.approx(0.5, abs=0.02)


def held(plan, physics):
    """Mean torque of the transmissions while the arm holds its weight, 30 to 130 ms after it was let go."""
    plant = make_plant(plan, seed=0, physics=physics)
    arm = plan.scene.models["arm"]
    gravity = arm.inverse_dynamics(plan.arms["arm"].initial, np.zeros(7), np.zeros(7))
    torques = []
    for _ in range(130):
        plant.step({"arm": gravity})
        torques.append(plant.truth().arms["arm"].torque)
    plant.close()
    return np.mean(torques[30:], axis=0)


def test_formula_that_blows_up_says_when():
    effect = FormulaEffect(spec(end_effector_force={"y": "drag / (t - 0.2)"}))
    physics = nominal_physics()
    load = effect.apply_vector(physics, np.array([4.0])).arms["arm"].loads[0]
    state = LoadState(0.2, np.zeros(7), np.zeros(7), np.zeros(3), np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match=r"cable_drag.*t = 0\.200 s"):
        load.end_effector_force(state)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"end_effector_force": {"w": "drag"}}, "unknown 'w'"),
        ({"joint_torque": {"joint0": "drag"}}, "unknown 'joint0'"),
        ({"joint_torque": {"elbow": "drag"}}, "unknown 'elbow'"),
        ({"end_effector_force": {"y": "drag * q0"}}, "unknown symbol 'q0'"),
        ({"end_effector_force": {}}, "needs a formula of one of: joint_torque, motor_torque"),
        ({"end_effector_force": {"y": "t"}, "parameters": {"t": PARAMETER}}, "cannot be parameter names"),
        ({"end_effector_force": {"y": "q12"}, "parameters": {"q12": PARAMETER}}, "cannot be parameter names"),
    ],
)
def test_formula_effect_that_makes_no_sense_is_refused(changes, complaint):
    with pytest.raises(InputError, match=complaint):
        FormulaEffect(spec(**changes))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"joint_torque": {"joint9": "drag"}}, r"cable_drag.*'joint9'.*7 joints"),
        ({"motor_torque": {"joint8": "drag"}}, r"cable_drag.*'joint8'.*7 joints"),
        ({"end_effector_force": {"y": "drag * dq8"}}, r"'drag \* dq8'.*'dq8'.*7 joints"),
    ],
)
def test_a_joint_that_the_arm_lacks_is_refused_by_the_arm(changes, complaint):
    effect = FormulaEffect(spec(**changes))
    physics = nominal_physics()
    with pytest.raises(InputError, match=complaint):
        effect.apply_vector(physics, np.array([1.0]))


def test_file_and_place_are_named(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "effects:\n  - {name: drag, sentence: s, end_effector_force: {y: 'k * vv'},"
        " parameters: {k: {unit: N, lower: 0, upper: 1, scale: 1}}}\n"
    )
    with pytest.raises(InputError, match=r"mine\.yaml.*unknown symbol 'vv'"):
        load_formulas(path)


def test_a_single_impact_has_no_memory(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "effects:\n  - {name: worn, sentence: s, contact: {restitution: '-c * lag(v, 1)'},"
        " parameters: {c: {unit: s/m, lower: 0, upper: 1, scale: 1}}}\n"
    )
    with pytest.raises(
        InputError, match="a single impact has no past.*contact_normal and contact_tangential can"
    ) as refused:
        load_formulas(path)
    assert (refused.value.key, refused.value.value) == ("contact", "-c * lag(v, 1)") and "mine.yaml" in str(
        refused.value
    )


@pytest.mark.parametrize("name", ["lag", "tanh"])
def test_a_function_is_no_parameter(name):
    with pytest.raises(InputError, match="cannot be parameter names"):
        FormulaEffect(spec(end_effector_force={"y": "1"}, parameters={name: PARAMETER}))


def test_a_formula_with_a_number_beyond_any_float_is_refused() -> None:
    with pytest.raises(InputError, match="does not parse"):
        FormulaEffect(spec(end_effector_force={"y": f"{'9' * 330} * vy"}))


def test_limits_of_a_parameter_are_in_order() -> None:
    with pytest.raises(ValueError, match="must be below upper"):
        FormulaParameter(unit="N m", lower=3.0, upper=0.0, scale=0.1)
