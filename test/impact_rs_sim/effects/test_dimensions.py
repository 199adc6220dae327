# SPDX-License-Identifier: Apache-2.0
"""Units of formulas: right ones pass, wrong ones are named, and a number leaves them open."""

from __future__ import annotations

import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.effects.dimensions import TORQUE, check_units, dimension_of, text_of
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError


def spec(formula: str, unit: str, table: str = "joint_torque", key: str = "joint1") -> FormulaSpec:
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
    assert check_units(spec(formula, unit)) == {"joint_torque.joint1": "N m"}


def test_a_force_at_the_end_effector_is_a_force() -> None:
    assert check_units(spec("-c * vy", "N s/m", "end_effector_force", "y")) == {"end_effector_force.y": "N"}


@pytest.mark.parametrize(
    ("formula", "unit", "expected"),
    [
        ("-c * dq1", "N m", "gives kg m^2 s^-3, expected N m"),
        ("c", "N", "gives N, expected N m"),
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
        check_units(spec(formula, unit))


def test_a_number_in_a_formula_may_carry_any_unit() -> None:
    """The speed below which friction fades is written as a number in the manual itself."""
    assert check_units(spec("-c * tanh(dq1 / 0.02)", "N m")) == {"joint_torque.joint1": "N m"}
    assert check_units(spec("3 * c", "N")) == {"joint_torque.joint1": ""}


def test_every_unit_of_the_library_is_understood() -> None:
    for effect in library().values():
        for parameter in effect.parameters:
            dimension_of(parameter.unit)
    assert text_of(TORQUE) == "N m"
