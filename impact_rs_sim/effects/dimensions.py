# SPDX-License-Identifier: Apache-2.0
"""Units of a formula effect: whether a formula yields a torque or a force, where the units of its symbols are known.

A unit is a product of powers of kg, m and s (rad is a number). A number in a formula may carry an unwritten
unit, ``tanh(dq2 / 0.02)`` for example, so a product with a number has an unknown unit. A formula is refused only where
two known units disagree.
"""

from __future__ import annotations

import ast
import re
from fractions import Fraction

from impact_rs_sim.effects.formula import AXES, CONTACT_SYMBOLS, FUNCTIONS, SPEEDS, FormulaSpec
from impact_rs_sim.errors import InputError

Dimension = tuple[Fraction, Fraction, Fraction]  # exponents of kg, m and s
Unit = Dimension | None  # None: not known


def _of(kg: int, m: int, s: int) -> Dimension:
    return Fraction(kg), Fraction(m), Fraction(s)


NUMBER = _of(0, 0, 0)
BASE = {
    "kg": _of(1, 0, 0), "m": _of(0, 1, 0), "s": _of(0, 0, 1), "rad": NUMBER, "N": _of(1, 1, -2), "J": _of(1, 2, -2),
    "W": _of(1, 2, -3), "Hz": _of(0, 0, -1), "1": NUMBER, "-": NUMBER,
}  # fmt: skip
TORQUE, FORCE = BASE["J"], BASE["N"]
SAME = ("abs", "min", "max")  # functions that give what they are given


def dimension_of(unit: str) -> Dimension:
    """Dimension of a unit as parameters have it, ``N s/m`` for example.

    Raises:
        InputError: The unit is not understood.
    """
    total = NUMBER
    for place, part in enumerate(unit.split("/")):
        for word in part.strip("()").split():
            found = re.fullmatch(r"([A-Za-z]+|1|-)(?:\^(-?\d+))?", word)
            if found is None or found[1] not in BASE:
                raise InputError(f"unit {unit!r}: {word!r} is not understood; known: {', '.join(BASE)}, as in N s/m")
            power = int(found[2] or 1) * (-1 if place else 1)
            total = _times(total, BASE[found[1]], power)
    return total


def text_of(dimension: Dimension) -> str:
    """A dimension in words: N or N m where it is one, else powers of kg, m and s."""
    for name, known in (("N m", TORQUE), ("N", FORCE), ("-", NUMBER)):
        if dimension == known:
            return name
    parts = [f"{name}^{power}" if power != 1 else name for name, power in zip(("kg", "m", "s"), dimension, strict=True)]
    return " ".join(part for part, power in zip(parts, dimension, strict=True) if power)


def check_units(spec: FormulaSpec) -> dict[str, str]:
    """Unit of every formula of an effect, by its key; empty: unknown because of its numbers.

    Raises:
        InputError: A unit is not understood, or two of them clash.
    """
    parameters = {name: dimension_of(parameter.unit) for name, parameter in spec.parameters.items()}
    known: dict[str, Dimension] = {"t": BASE["s"], "pi": NUMBER, **parameters}
    known |= dict.fromkeys(AXES, BASE["m"]) | dict.fromkeys(SPEEDS, _of(0, 1, -1))
    tables = {
        "joint_torque": (spec.joint_torque, TORQUE),
        "motor_torque": (spec.motor_torque, TORQUE),
        "end_effector_force": (spec.end_effector_force, FORCE),
        "contact": (spec.contact, NUMBER),
    }
    of_contact = parameters | dict.fromkeys(CONTACT_SYMBOLS, _of(0, 1, -1)) | {"pi": NUMBER}
    units = {}
    for table, (formulas, wanted) in tables.items():
        for key, text in formulas.items():
            place = f"{table}.{key}"
            symbols = of_contact if table == "contact" else known
            found = _unit(ast.parse(text.strip(), mode="eval").body, symbols, text)
            if found is not None and found != wanted:
                raise InputError(f"formula {text!r} gives {text_of(found)}, expected {text_of(wanted)}", key=place)
            units[place] = "" if found is None else text_of(found)
    return units


def _unit(node: ast.AST, known: dict[str, Dimension], text: str) -> Unit:
    if isinstance(node, ast.Name):
        turn = re.fullmatch(r"(d?)q\d+", node.id)  # joints turn: rad, rad/s
        return (BASE["Hz"] if turn[1] else NUMBER) if turn else known.get(node.id)
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
        return _times(NUMBER, left, power.value)
    if left is None or right is None:
        return None
    return _times(left, right, 1 if isinstance(node.op, ast.Mult) else -1)


def _given_to(function: str, given: list[Unit], text: str) -> Unit:
    if function in SAME:
        return _alike(given[0], given[-1], text)
    if function == "sqrt":
        return None if given[0] is None else _times(NUMBER, given[0], Fraction(1, 2))
    if function == "sign":
        return NUMBER
    if given and given[0] not in (None, NUMBER) and function in FUNCTIONS:
        raise InputError(f"formula {text!r}: {function} takes a number, got {text_of(given[0] or NUMBER)}")
    return NUMBER


def _alike(left: Unit, right: Unit, text: str) -> Unit:
    if left is not None and right is not None and left != right:
        raise InputError(f"formula {text!r} adds or compares {text_of(left)} and {text_of(right)}")
    return left if right is None else right


def _times(one: Dimension, other: Dimension, power: int | Fraction) -> Dimension:
    a, b, c = (mine + power * its for mine, its in zip(one, other, strict=True))
    return a, b, c
