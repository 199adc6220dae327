# SPDX-License-Identifier: Apache-2.0
"""Units of the numbers in files, and their factors to SI.

    value in SI = FACTORS[SI unit][unit] * number in the file

Mappings state the unit of a signal, impact tables the unit of a column. All readers take their factors from here.
SI units of joints are listed in :data:`impact_rs_sim.robots.robot.UNITS`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robots.robot import Array

RAD_PER_DEG = np.pi / 180.0

FACTORS: dict[str, dict[str, float]] = {  # by SI unit, which is the first of its units
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "g": 9.80665},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": RAD_PER_DEG},
    "rad/s": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": RAD_PER_DEG, "rpm": np.pi / 30.0},
    "kg": {"kg": 1.0, "g": 1e-3},
    "kg m^2": {"kg m^2": 1.0},
    "N": {"N": 1.0, "mN": 1e-3},
    "N/s": {"N/s": 1.0},
    "N m": {"N m": 1.0, "mN m": 1e-3},
    "N m/s": {"N m/s": 1.0},
    "A": {"A": 1.0, "mA": 1e-3},
    "N, N m": {"N, N m": 1.0},  # force and torque of a wrench
    "-": {"-": 1.0},
}
CURRENTS = tuple(FACTORS["A"])  # of a motor; torque_constant of a mapping makes a torque of them
TURNS: dict[str, dict[str, float]] = {  # of joints that turn, by quantity
    "position": FACTORS["rad"],
    "velocity": FACTORS["rad/s"],
    "torque": FACTORS["N m"] | FACTORS["A"],
    "torque_rate": FACTORS["N m/s"],
}
SLIDES: dict[str, dict[str, float]] = {  # of joints that slide
    "position": FACTORS["m"],
    "velocity": FACTORS["m/s"],
    "torque": FACTORS["N"] | FACTORS["A"],
    "torque_rate": FACTORS["N/s"],
}
UNITS: dict[str, dict[str, float]] = {  # of signals, by quantity
    **{quantity: TURNS[quantity] | SLIDES[quantity] for quantity in TURNS},
    "length": FACTORS["m"],
    "orientation": FACTORS["-"],
    "wrench": FACTORS["N, N m"],
    "acceleration": FACTORS["m/s^2"],
    "time": FACTORS["s"] | {"date": 1e-9},  # dates are read as whole nanoseconds
}
_OTHERS = ("", "1", "sec", "v", "nm", "rad/s^2", "mrad/s^2", "deg/s^2", "mm/s^2")  # in a line of units, never converted
_IGNORED = str.maketrans("", "", " ^*[]()")


def factors_of(quantity: str, unit: str | Sequence[str]) -> Array:
    """Factors to SI: of the common unit of all joints, ``(1,)``, or of a unit per joint, ``(n,)``."""
    return np.array([UNITS[quantity][joint_unit] for joint_unit in ([unit] if isinstance(unit, str) else unit)])


def si_unit(quantity: str, unit: str, unit_quantity: str) -> str:
    """SI unit of a joint's quantity, from the unit of another quantity of the joint.

    Args:
        quantity: The quantity.
        unit: Unit of the other quantity, which shows whether the joint turns or slides.
        unit_quantity: The other quantity.
    """
    factors = next((table for table in (TURNS, SLIDES) if unit in table.get(unit_quantity, {})), UNITS)
    return next(iter(factors[quantity]))


def is_unit(text: str) -> bool:
    """Whether a cell below a column name states a unit, ``[rad/s]`` for example, or is empty for no unit."""
    return _bare(text) in _KNOWN


def _bare(text: str) -> str:
    """A unit in lower case without brackets, blanks, and signs of powers and products."""
    return text.lower().translate(_IGNORED)


_KNOWN = {_bare(unit) for unit in (*_OTHERS, *(unit for units in FACTORS.values() for unit in units))}
