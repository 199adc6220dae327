# SPDX-License-Identifier: Apache-2.0
"""Effect laws that add parameters to a quantity of an arm or a scene, or multiply it by a parameter."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_rs_sim.effects.base import Values, number


@dataclass(frozen=True)
class Added:
    """Law that adds parameters to a quantity; None stands for 0.

    Attributes:
        quantity: Path of an attribute of the arm or the scene, such as ``readings.torque_lag``.
        parameters: Name of the parameter; for a tuple, one name per component.
        per_joint: Whether the parameter has a value per joint.
        minimum: Lower bound of a scalar quantity.
    """

    quantity: str
    parameters: tuple[str, ...]
    per_joint: bool = False
    minimum: float | None = None

    def __call__(self, whole: Any, values: Values) -> Any:
        """The arm or the scene with the effect; without a change the same object."""
        if not any(np.any(values[name]) for name in self.parameters):
            return whole
        before = _quantity(whole, self.quantity)
        if isinstance(before, tuple):
            pairs = zip(before, self.parameters, strict=True)
            return _replaced(whole, self.quantity, tuple(component + number(values, name) for component, name in pairs))
        (name,) = self.parameters
        increment = values[name] if self.per_joint else number(values, name)
        after = (0.0 if before is None else before) + increment
        return _replaced(whole, self.quantity, after if self.minimum is None else max(after, self.minimum))


@dataclass(frozen=True)
class Multiplied:
    """Law that multiplies a quantity by a parameter; None stays None.

    Attributes:
        quantity: As for :class:`Added`.
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
    """Attribute by its dotted path."""
    return functools.reduce(getattr, path.split("."), whole)


def _replaced(whole: Any, path: str, value: Any) -> Any:
    """``whole`` with a new value of the attribute at a dotted path."""
    name, _, remaining_path = path.partition(".")
    return replace(whole, **{name: _replaced(getattr(whole, name), remaining_path, value) if remaining_path else value})
