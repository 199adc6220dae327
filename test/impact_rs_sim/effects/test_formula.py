# SPDX-License-Identifier: Apache-2.0
"""Formulas in YAML: arithmetic and nothing else; units; a lag is that of its differential equation."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from trials import nominal_physics, plan_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_sim.effects import library
from impact_rs_sim.effects.dimensions import TORQUE, check_units, dimension_of, text_of
from impact_rs_sim.effects.formula import Formula, FormulaEffect, FormulaParameter, FormulaSpec, load_formulas
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory, lag_along
from impact_rs_sim.model import parse_model
from impact_rs_sim.physics import LoadState

# ---- what a formula means -------------------------------------------------------------------------------------------

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


def test_two_effects_of_one_name_are_refused(tmp_path):
    """Kills: the second of two formulas takes the place of the first without a word, in a file and in a model."""
    twice = [spec().model_dump(mode="json") for _ in range(2)]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"effects": twice}))
    with pytest.raises(InputError, match=rf"mine\.yaml: effects.*two effects have the name '{twice[0]['name']}'"):
        load_formulas(path)
    with pytest.raises(InputError, match=r"m\.yaml: formulas.*two effects"):
        parse_model(yaml.safe_dump({"name": "m", "formulas": twice}), "m.yaml")


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


def test_the_nominal_value_lies_within_the_limits() -> None:
    with pytest.raises(ValueError, match="nominal = 0 must lie within lower and upper"):
        FormulaParameter(unit="N m", lower=1.0, upper=3.0, scale=0.1)


# ---- units: right ones pass, wrong ones are named, and a number leaves them open ------------------------------------


def with_unit(formula: str, unit: str, table: str = "joint_torque", key: str = "joint1") -> FormulaSpec:
    parameter = {"unit": unit, "lower": -1.0, "upper": 1.0, "scale": 0.1}
    content = {"name": "mine", "sentence": "It is mine.", table: {key: formula}, "parameters": {"c": parameter}}
    return FormulaSpec.model_validate(content)


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        ("-c * dq1", "N m s/rad"),
        ("c * sin(q1)", "N m"),
        ("c * q1 ** 2", "N m/rad^2"),
        ("c * sign(dq1)", "N m"),
        ("c * sqrt(x ** 2) / t", "N s"),
        ("c * max(vx, vy)", "N s"),
        ("c * exp(-t / t)", "J"),
        ("c * dq1 + c * dq2", "kg m^2/s"),
        ("c * lag(dq1, 0.2)", "N m s/rad"),
        ("lag(c * dq1, t, c * dq2)", "N m s/rad"),
        ("-c * lag(sign(dq1), 0.01 / max(abs(dq1), 1e-6))", "N m"),
    ],
)
def test_a_torque_is_a_torque_however_its_unit_is_written(formula: str, unit: str) -> None:
    assert check_units(with_unit(formula, unit)) == {"joint_torque.joint1": "N m"}


@pytest.mark.parametrize(
    ("formula", "unit", "effort"),
    [("-c * dq1", "N s/m", "N"), ("c * q2 * dq1", "N s/m", "N"), ("-c * dq2", "N s", "N m")],
)
def test_a_joint_may_slide(formula: str, unit: str, effort: str) -> None:
    """Kills rad/s and N m for every joint."""
    assert check_units(with_unit(formula, unit)) == {"joint_torque.joint1": effort}


def test_a_force_at_the_end_effector_is_a_force() -> None:
    assert check_units(with_unit("-c * vy", "N s/m", "end_effector_force", "y")) == {"end_effector_force.y": "N"}


@pytest.mark.parametrize(
    ("formula", "unit", "expected"),
    [
        ("-c * dq1", "N m", "gives kg m^2 s^-3, expected N m"),
        ("c", "kg", "gives kg, expected N m"),
        ("c * sin(x)", "N m", "sin takes a number, got m"),
        ("c + dq1", "N m", "adds or compares N m and s^-1"),
        ("c * max(x, t)", "N", "adds or compares m and s"),
        ("c", "Nm", "'Nm' is not understood"),
        ("c * lag(q1, x)", "N m", "the time constant of lag is in s, got m"),
        ("c * lag(dq1, t, q1)", "N m s", "adds or compares s^-1 and -"),
    ],
)
def test_units_that_clash_are_named(formula: str, unit: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected.replace("^", r"\^")):
        check_units(with_unit(formula, unit))


def test_a_number_in_a_formula_may_carry_any_unit() -> None:
    """The speed below which friction fades is written as a number in the manual itself."""
    assert check_units(with_unit("-c * tanh(dq1 / 0.02)", "N m")) == {"joint_torque.joint1": "N m"}
    assert check_units(with_unit("3 * c", "N")) == {"joint_torque.joint1": ""}


def test_every_unit_of_the_library_is_understood() -> None:
    for effect in library().values():
        for parameter in effect.parameters:
            dimension_of(parameter.unit)
    assert text_of(TORQUE) == "N m"


# ---- memory: a lag at any sampling, in one step and over many samples alike -----------------------------------------

T = 0.2  # s
FORMULA = Formula("lag(u, T)", {"u", "T"})


def stepped(time: np.ndarray, u: np.ndarray, constant: float = T) -> np.ndarray:
    memory = Memory()
    values = [{"t": now, "u": value, "T": constant} for now, value in zip(time.tolist(), u.tolist(), strict=True)]
    return np.array([FORMULA(one, memory) for one in values])


@pytest.mark.parametrize("step", [1e-3, 0.02])
def test_a_step_is_followed_exponentially(step: float) -> None:
    """1 - exp(-t/T), t from the middle of the sampling step in which u rises, to the second order of that step."""
    time = np.arange(0.0, 1.0, step)
    found = stepped(time, np.where(time > 0.0, 1.0, 0.0))
    np.testing.assert_allclose(found[1:], 1.0 - np.exp(-(time[1:] - step / 2.0) / T), atol=0.1 * (step / T) ** 2)


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0])
def test_a_sine_is_smaller_and_later(rate: float) -> None:
    """Gain 1 / sqrt(1 + (w T)^2), phase -atan(w T), once the start has died away."""
    time = np.arange(0.0, 4.0, 2e-3)
    found, late = stepped(time, np.sin(rate * time)), time > 10.0 * T
    expected = np.sin(rate * time - np.arctan(rate * T)) / np.hypot(1.0, rate * T)
    np.testing.assert_allclose(found[late], expected[late], atol=3e-4)


def test_a_ramp_is_followed_exactly_at_any_sampling() -> None:
    """z = s (t - T (1 - exp(-t/T))): whoever records slowly finds the same time constant."""
    for time in (np.arange(0.0, 1.0, 1e-3), np.arange(0.0, 1.0, 0.1), np.array([0.0, 0.03, 0.4, 0.41, 0.9])):
        np.testing.assert_allclose(stepped(time, 3.0 * time), 3.0 * (time - T * -np.expm1(-time / T)), atol=1e-12)


@pytest.mark.parametrize(("constant", "follows"), [(0.0, True), (1e-9, True), (1e12, False), (np.inf, False)])
def test_its_limits_are_the_quantity_and_its_start(constant: float, follows: bool) -> None:
    time = np.arange(0.0, 1.0, 0.01)
    u = 2.0 + np.sin(9.0 * time)
    np.testing.assert_allclose(stepped(time, u, constant), u if follows else 2.0, atol=1e-6)


@given(st.lists(st.tuples(st.floats(1e-4, 1.0), st.floats(-5.0, 5.0), st.floats(0.0, 10.0)), min_size=1, max_size=20))
def test_many_samples_at_once_are_those_one_after_another(rows: list[tuple[float, float, float]]) -> None:
    """With a time constant that changes as well."""
    length, u, constant = (np.array(column) for column in zip(*rows, strict=True))
    time = np.cumsum(length)
    memory = Memory()
    one = [memory.lag("z", *row) for row in zip(time.tolist(), u.tolist(), constant.tolist(), strict=True)]
    np.testing.assert_allclose(lag_along(time, u, constant), one, atol=1e-9)
    np.testing.assert_array_equal(FORMULA({"t": time, "u": u, "T": constant}), lag_along(time, u, constant))


def test_a_friction_of_dahl_is_a_lag_over_the_distance() -> None:
    """F = F_c (1 - exp(-x/d)) from rest: dF/dx = (F_c - F) / d (Dahl 1968), at any speed."""
    law = Formula("lag(sign(dq), d / max(abs(dq), 1e-9))", {"dq", "d"})
    for speed in (0.01, 1.0):
        time = np.linspace(0.0, 0.3 / speed, 3000)
        dq = np.where(time > 0.0, speed, 0.0)
        np.testing.assert_allclose(law({"t": time, "dq": dq, "d": 0.05}), -np.expm1(-speed * time / 0.05), atol=2e-3)


def test_asked_twice_at_one_time_it_is_the_same() -> None:
    memory = Memory()
    first = [memory.lag("z", time, value, T) for time, value in ((0.0, 1.0), (0.1, 2.0), (0.1, 9.0))]
    assert first[1] == first[2]
    assert memory.lag("z", 0.2, 2.0, T) == pytest.approx(2.0 - (2.0 - first[1]) * np.exp(-0.5))


def test_memories_are_apart() -> None:
    """Two lags of one formula, two formulas of one text, and what two owners remember of one formula."""
    both = Formula("lag(u, T) - lag(u, 10 * T)", {"u", "T"})
    twin, whole = Formula(both.text, both.symbols), Memory()
    for formula, memory in ((both, whole.part("a")), (both, whole.part("b")), (twin, whole.part("a"))):
        assert formula({"t": 0.0, "u": 0.0, "T": T}, memory) == 0.0
        found = formula({"t": 0.1, "u": 1.0, "T": T}, memory)
        assert found == pytest.approx(2.0 * np.exp(-0.5) - 20.0 * np.exp(-0.05) + 18.0)
    assert pickle.loads(pickle.dumps(both))({"t": 0.1, "u": 1.0, "T": T}, Memory()) == 0.0


def test_a_single_state_has_no_past() -> None:
    with pytest.raises(InputError, match=r"lag\(\) depends on what was before.*acts in trials and recordings"):
        FORMULA({"t": 0.1, "u": 1.0, "T": T})
    for text in ("lag(u)", "lag(u, 1, 2, 3)"):
        with pytest.raises(InputError, match=r"lag takes a quantity, a time constant and"):
            Formula(text, {"u"})


def test_a_lag_may_start_cold() -> None:
    """z = u (1 - exp(-t/T)) from 0, in one step after another and along samples."""
    time = np.arange(0.0, 1.0, 0.05)
    cold = Formula("lag(u, T, 0)", {"u", "T"})
    expected = -3.0 * np.expm1(-time / T)
    np.testing.assert_allclose(cold({"t": time, "u": 3.0, "T": T}), expected, atol=1e-12)
    memory = Memory()
    one = [cold({"t": now, "u": 3.0, "T": T}, memory) for now in time.tolist()]
    np.testing.assert_allclose(one, expected, atol=1e-12)
