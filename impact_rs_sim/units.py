# SPDX-License-Identifier: Apache-2.0
"""Units of parameters and formulas as products of powers of kg, m and s; rad is dimensionless."""

from __future__ import annotations

import functools
import re
from fractions import Fraction

from impact_rs_sim.errors import InputError

Dimension = tuple[Fraction, Fraction, Fraction]  # exponents of kg, m and s


def of(kg: int, m: int, s: int) -> Dimension:
    """Dimension with these exponents."""
    return Fraction(kg), Fraction(m), Fraction(s)


NUMBER = of(0, 0, 0)
BASE = {
    "kg": of(1, 0, 0), "m": of(0, 1, 0), "s": of(0, 0, 1), "rad": NUMBER, "N": of(1, 1, -2), "J": of(1, 2, -2),
    "W": of(1, 2, -3), "Hz": of(0, 0, -1), "1": NUMBER, "-": NUMBER,
}  # fmt: skip
TORQUE, FORCE = BASE["J"], BASE["N"]


@functools.cache
def dimension_of(unit: str) -> Dimension:
    """Dimension of a unit as parameters have it, ``N s/m`` for example.

    Raises:
        InputError: The unit is not understood.
    """
    total = NUMBER
    for index, part in enumerate(unit.split("/")):
        for word in part.strip("()").split():
            match = re.fullmatch(r"([A-Za-z]+|1|-)(?:\^(-?\d+))?", word)
            if match is None or match[1] not in BASE:
                raise InputError(f"unit {unit!r}: {word!r} is not understood; known: {', '.join(BASE)}, as in N s/m")
            power = int(match[2] or 1) * (-1 if index else 1)
            total = times(total, BASE[match[1]], power)
    return total


def text_of(dimension: Dimension) -> str:
    """Text of a dimension: N m, N or - if it is one of these, else powers of kg, m and s."""
    for name, named in (("N m", TORQUE), ("N", FORCE), ("-", NUMBER)):
        if dimension == named:
            return name
    parts = [f"{name}^{power}" if power != 1 else name for name, power in zip(("kg", "m", "s"), dimension, strict=True)]
    return " ".join(part for part, power in zip(parts, dimension, strict=True) if power)


def times(base: Dimension, factor: Dimension, power: int | Fraction) -> Dimension:
    """Product of a dimension and a power of another."""
    a, b, c = (exponent + power * factor_exponent for exponent, factor_exponent in zip(base, factor, strict=True))
    return a, b, c
