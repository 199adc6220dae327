# SPDX-License-Identifier: Apache-2.0
"""Dimensional analysis of formula effects: does a formula yield a torque or a force?

A unit is a product of powers of kg, m and s (rad is a number). A joint turns or slides; a formula is right if it is so
for one of both. A number in a formula may carry an unwritten
unit, ``tanh(dq2 / 0.02)`` for example, so a product with a number has an unknown unit. A formula is refused only if two
known units disagree.
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
MAX_WAYS = 64  # in which six joints of a formula turn or slide
UNIT_PRESERVING_FUNCTIONS = ("abs", "min", "max")  # functions that give what they are given


def check_units(spec: FormulaSpec) -> dict[str, str]:
    """Unit of every formula of an effect, by its key; empty: unknown because of its numbers.

    Raises:
        InputError: A unit is not understood, or two of them clash.
    """
    parameters = {name: dimension_of(parameter.unit) for name, parameter in spec.parameters.items()}
    known = {name: dimension_of(unit) for name, unit in SYMBOLS.items()} | {"pi": NUMBER, **parameters}
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
    of_contact = parameters | dict.fromkeys(CONTACT_SYMBOLS, of(0, 1, -1)) | {"pi": NUMBER}
    units = {}
    for table, (formulas, wanted) in tables.items():
        for key, text in formulas.items():
            if not text:
                continue
            formula_key = f"{table}.{key}".removesuffix(".")
            symbols = of_contact if table == "contact" else known
            found = _fitting(text, formula_key, symbols, wanted)
            units[formula_key] = "" if found is None else text_of(found)
    return units


def _fitting(text: str, key: str, symbols: dict[str, Dimension], wanted: Dimension) -> Unit:
    """Unit of a formula, for the first types of its joints for which it is the wanted one."""
    errors, tree = [], ast.parse(text.strip(), mode="eval").body
    for known, expected in _ways(text, key, symbols, wanted):
        try:
            found = _unit(tree, known, text)
        except InputError as error:
            errors.append(error)
            continue
        if found is None or found == expected:
            return found
        errors.append(InputError(f"formula {text!r} gives {text_of(found)}, expected {text_of(expected)}", key=key))
    raise errors[0]


def _ways(
    text: str, key: str, symbols: dict[str, Dimension], wanted: Dimension
) -> Iterator[tuple[dict[str, Dimension], Dimension]]:
    """Units of the symbols and of the formula, for each way in which the joints that it names may move."""
    own = JOINT_KEY.fullmatch(key.partition(".")[2])
    joints = list(dict.fromkeys(([own[1]] if own else []) + [found[2] for found in JOINT_SYMBOL.finditer(text)]))
    for units in islice(product(JOINT_SYMBOL_UNITS, repeat=len(joints)), MAX_WAYS):
        of_joints = {
            f"{symbol}{joint}": unit
            for joint, table in zip(joints, units, strict=True)
            for symbol, unit in table.items()
        }
        yield symbols | of_joints, units[0]["tau"] if own else wanted


def _unit(node: ast.AST, known: dict[str, Dimension], text: str) -> Unit:
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, known, text)
    if isinstance(node, ast.BinOp):
        return _combined(node, known, text)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        given = [_unit(argument, known, text) for argument in node.args]
        return _given_to(node.func.id, given, text)
    return None  # a number


def _combined(node: ast.BinOp, known: dict[str, Dimension], text: str) -> Unit:
    left, right = _unit(node.left, known, text), _unit(node.right, known, text)
    if isinstance(node.op, (ast.Add, ast.Sub)):
        return _alike(left, right, text)
    if isinstance(node.op, ast.Pow):
        power = node.right
        if left is None or not (isinstance(power, ast.Constant) and isinstance(power.value, int)):
            return NUMBER if left == NUMBER else None
        return times(NUMBER, left, power.value)
    if left is None or right is None:
        return None
    return times(left, right, 1 if isinstance(node.op, ast.Mult) else -1)


def _given_to(function: str, given: list[Unit], text: str) -> Unit:
    if function in UNIT_PRESERVING_FUNCTIONS:
        return _alike(given[0], given[-1], text)
    if function == LAG:
        if given[1] not in (None, BASE["s"]):
            raise InputError(f"formula {text!r}: the time constant of {LAG} is in s, got {text_of(given[1] or NUMBER)}")
        return _alike(given[0], given[2], text) if len(given) > 2 else given[0]
    if function == "sqrt":
        return None if given[0] is None else times(NUMBER, given[0], Fraction(1, 2))
    if function == "sign":
        return NUMBER
    if given and given[0] not in (None, NUMBER) and function in FUNCTIONS:
        raise InputError(f"formula {text!r}: {function} takes a number, got {text_of(given[0] or NUMBER)}")
    return NUMBER


def _alike(left: Unit, right: Unit, text: str) -> Unit:
    if left is not None and right is not None and left != right:
        raise InputError(f"formula {text!r} adds or compares {text_of(left)} and {text_of(right)}")
    return left if right is None else right
