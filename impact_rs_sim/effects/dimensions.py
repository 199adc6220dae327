# SPDX-License-Identifier: Apache-2.0
"""Dimensional analysis of formula effects: does a formula yield a torque or a force?

A unit is a product of powers of kg, m and s (rad is a number). A joint turns or slides; a formula is accepted if its
units fit either. A number in a formula may carry an unwritten unit, ``tanh(dq2 / 0.02)`` for example, so a product with
a number has an unknown unit. A formula is refused only if two known units disagree.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from fractions import Fraction
from itertools import islice, product

from impact_rs_sim.effects.formula import (
    CONTACT_SYMBOLS,
    FUNCTIONS,
    JOINT_KEY,
    JOINT_SYMBOL,
    LAG,
    SYMBOLS,
    FormulaSpec,
)
from impact_rs_sim.errors import InputError
from impact_rs_sim.units import BASE, FORCE, NUMBER, TORQUE, Dimension, dimension_of, of, text_of, times

Unit = Dimension | None  # None: not known
JOINT_SYMBOL_UNITS = (
    {"q": NUMBER, "dq": BASE["Hz"], "tau": TORQUE},  # of a revolute joint: rad, rad/s, N m
    {"q": of(0, 1, 0), "dq": of(0, 1, -1), "tau": FORCE},  # of a prismatic joint: m, m/s, N
)
MAX_TYPE_COMBINATIONS = 64  # of revolute and prismatic, for six joints in a formula
UNIT_PRESERVING_FUNCTIONS = ("abs", "min", "max")  # functions whose value has the unit of their arguments


def check_units(spec: FormulaSpec) -> dict[str, str]:
    """Unit of every formula of an effect, by its key; empty if a number in it makes the unit unknown.

    Raises:
        InputError: A unit is not understood, or two of them clash.
    """
    parameters = {name: dimension_of(parameter.unit) for name, parameter in spec.parameters.items()}
    symbol_units = {name: dimension_of(unit) for name, unit in SYMBOLS.items()} | {"pi": NUMBER, **parameters}
    tables = {
        "joint_torque": (spec.joint_torque, TORQUE),
        "motor_torque": (spec.motor_torque, TORQUE),
        "end_effector_force": (spec.end_effector_force, FORCE),
        "object_force": (spec.object_force, FORCE),
        "object_moment": (spec.object_moment, TORQUE),
        "contact_normal": ({"": spec.contact_normal}, FORCE),
        "contact_tangential": ({"": spec.contact_tangential}, FORCE),
        "support_normal": ({"": spec.support_normal}, FORCE),
        "support_tangential": ({"": spec.support_tangential}, FORCE),
        "contact": (spec.contact, NUMBER),
    }
    contact_symbols = parameters | dict.fromkeys(CONTACT_SYMBOLS, of(0, 1, -1)) | {"pi": NUMBER}
    units = {}
    for table, (formulas, expected) in tables.items():
        for key, text in formulas.items():
            if not text:
                continue
            formula_key = f"{table}.{key}".removesuffix(".")
            table_symbols = contact_symbols if table == "contact" else symbol_units
            unit = _unit_for_joint_types(text, formula_key, table_symbols, expected)
            units[formula_key] = "" if unit is None else text_of(unit)
    return units


def _unit_for_joint_types(text: str, key: str, symbols: dict[str, Dimension], nominal: Dimension) -> Unit:
    """Unit of a formula, for the first joint types with which it is the expected one."""
    errors, tree = [], ast.parse(text.strip(), mode="eval").body
    for symbol_units, expected_unit in _units_by_joint_types(text, key, symbols, nominal):
        try:
            unit = _unit(tree, symbol_units, text)
        except InputError as error:
            errors.append(error)
            continue
        if unit is None or unit == expected_unit:
            return unit
        errors.append(InputError(f"formula {text!r} gives {text_of(unit)}, expected {text_of(expected_unit)}", key=key))
    raise errors[0]


def _units_by_joint_types(
    text: str, key: str, symbols: dict[str, Dimension], nominal: Dimension
) -> Iterator[tuple[dict[str, Dimension], Dimension]]:
    """Units of symbols and formula for every combination of types of the joints in the formula and its key."""
    acting_joint = JOINT_KEY.fullmatch(key.partition(".")[2])
    named = [match[2] for match in JOINT_SYMBOL.finditer(text)]
    joints = list(dict.fromkeys([acting_joint[1], *named] if acting_joint else named))
    for units in islice(product(JOINT_SYMBOL_UNITS, repeat=len(joints)), MAX_TYPE_COMBINATIONS):
        joint_symbols = {
            f"{symbol}{joint}": unit
            for joint, table in zip(joints, units, strict=True)
            for symbol, unit in table.items()
        }
        yield symbols | joint_symbols, units[0]["tau"] if acting_joint else nominal


def _unit(node: ast.AST, symbols: dict[str, Dimension], text: str) -> Unit:
    if isinstance(node, ast.Name):
        return symbols.get(node.id)
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, symbols, text)
    if isinstance(node, ast.BinOp):
        return _unit_of_operation(node, symbols, text)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        argument_units = [_unit(argument, symbols, text) for argument in node.args]
        return _unit_of_call(node.func.id, argument_units, text)
    return None  # a number


def _unit_of_operation(node: ast.BinOp, symbols: dict[str, Dimension], text: str) -> Unit:
    left, right = _unit(node.left, symbols, text), _unit(node.right, symbols, text)
    if isinstance(node.op, (ast.Add, ast.Sub)):
        return _common_unit(left, right, text)
    if isinstance(node.op, ast.Pow):
        power = node.right
        if left is None or not (isinstance(power, ast.Constant) and isinstance(power.value, int)):
            return NUMBER if left == NUMBER else None
        return times(NUMBER, left, power.value)
    if left is None or right is None:
        return None
    return times(left, right, 1 if isinstance(node.op, ast.Mult) else -1)


def _unit_of_call(function: str, arguments: list[Unit], text: str) -> Unit:
    if function in UNIT_PRESERVING_FUNCTIONS:
        return _common_unit(arguments[0], arguments[-1], text)
    if function == LAG:
        if arguments[1] not in (None, BASE["s"]):
            raise InputError(
                f"formula {text!r}: the time constant of {LAG} is in s, got {text_of(arguments[1] or NUMBER)}"
            )
        return _common_unit(arguments[0], arguments[2], text) if len(arguments) > 2 else arguments[0]
    if function == "sqrt":
        return None if arguments[0] is None else times(NUMBER, arguments[0], Fraction(1, 2))
    if function == "sign":
        return NUMBER
    if arguments and arguments[0] not in (None, NUMBER) and function in FUNCTIONS:
        raise InputError(f"formula {text!r}: {function} takes a number, got {text_of(arguments[0] or NUMBER)}")
    return NUMBER


def _common_unit(left: Unit, right: Unit, text: str) -> Unit:
    if left is not None and right is not None and left != right:
        raise InputError(f"formula {text!r} adds or compares {text_of(left)} and {text_of(right)}")
    return left if right is None else right
