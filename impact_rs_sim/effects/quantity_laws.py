# SPDX-License-Identifier: Apache-2.0
"""Laws that change one quantity of an arm or a scene: parameters are added to it, or it is multiplied by one."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_rs_sim.effects.base import Values, number


@dataclass(frozen=True)
class Added:
    """Law that adds parameters to a quantity; where the quantity is None, it is 0 so far.

    Attributes:
        quantity: Attribute of the arm or the scene, with dots where it belongs to a part: ``readings.torque_lag``.
        parameters: Name of the parameter; of a quantity that is a tuple, one name per component.
        per_joint: Whether the parameter has a value per joint.
        least: Value below which a single quantity never falls.
    """

    quantity: str
    parameters: tuple[str, ...]
    per_joint: bool = False
    least: float | None = None

    def __call__(self, whole: Any, values: Values) -> Any:
        """The arm or the scene with the effect; without a change the same object."""
        if not any(np.any(values[name]) for name in self.parameters):
            return whole
        before = _quantity(whole, self.quantity)
        if isinstance(before, tuple):
            pairs = zip(before, self.parameters, strict=True)
            return _replaced(whole, self.quantity, tuple(one + number(values, name) for one, name in pairs))
        (name,) = self.parameters
        more = values[name] if self.per_joint else number(values, name)
        after = (0.0 if before is None else before) + more
        return _replaced(whole, self.quantity, after if self.least is None else max(after, self.least))


@dataclass(frozen=True)
class Multiplied:
    """Law that multiplies a quantity by a parameter; where the quantity is None, it stays so.

    Attributes:
        quantity: As of :class:`Added`.
        parameter: Name of the parameter.
        per_joint: Whether the parameter has a value per joint.
    """

    quantity: str
    parameter: str
    per_joint: bool = False

    def __call__(self, whole: Any, values: Values) -> Any:
        """The arm or the scene with the effect; without a change the same object."""
        before = _quantity(whole, self.quantity)
        if before is None or np.all(values[self.parameter] == 1.0):
            return whole
        factor = values[self.parameter] if self.per_joint else number(values, self.parameter)
        return _replaced(whole, self.quantity, before * factor)


def _quantity(whole: Any, path: str) -> Any:
    """Attribute of a part, by its path with dots."""
    return functools.reduce(getattr, path.split("."), whole)


def _replaced(whole: Any, path: str, value: Any) -> Any:
    """The same with another value of this attribute."""
    name, _, rest = path.partition(".")
    return replace(whole, **{name: _replaced(getattr(whole, name), rest, value) if rest else value})
