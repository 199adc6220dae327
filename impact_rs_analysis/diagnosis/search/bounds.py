# SPDX-License-Identifier: Apache-2.0
"""Bounds of parameters that a user knows better (``diagnose --bounds``).

A range that follows from the size of the robot is doubled where a fit ends at its end; one that is given is kept.
Bounds of physics, such as no friction below none, hold as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.schema import load_mapping

EXPECTED_BOUNDS = "expected EFFECT.PARAMETER=LOW:HIGH, for example restitution.restitution=0:0.8, or a YAML file"

Bounds = Mapping[str, tuple[float, float]]
"""Lower and upper bound in the unit of the parameter, by ``EFFECT.PARAMETER``."""

NO_BOUNDS: Bounds = MappingProxyType({})


def read_bounds(texts: Iterable[str], known: Mapping[str, Effect]) -> Bounds:
    """Bounds of a command line.

    Args:
        texts: ``EFFECT.PARAMETER=LOW:HIGH``, or YAML files that map ``EFFECT.PARAMETER`` to ``[LOW, HIGH]``.
        known: Effects by name.

    Raises:
        InputError: A text or file cannot be read, there is no such parameter, or no range that holds its nominal value.
    """
    found = read_ranges(texts, "--bounds", EXPECTED_BOUNDS)
    for name, (low, high) in found.items():
        _check(name, low, high, known)
    return found


def read_ranges(texts: Iterable[str], option: str, expected: str) -> dict[str, tuple[float, float]]:
    """Ranges of a command line by name.

    Args:
        texts: ``NAME=LOW:HIGH``, or YAML files that map names to ``[LOW, HIGH]``.
        option: Option that has them, for messages.
        expected: Expected values, for messages.

    Raises:
        InputError: A text or file cannot be read, or is no range.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, span = text.partition("=")
        if equals:
            found[name.strip()] = _span(span.split(":"), text, None, option, expected)
            continue
        for key, values in load_mapping(text).items():
            parts = values if isinstance(values, list) else [values]
            found[str(key)] = _span(parts, str(key), text, option, expected)
    return found


def _span(parts: Sequence[object], key: str, file: str | None, option: str, expected: str) -> tuple[float, float]:
    """Lower and upper bound of one entry."""
    try:
        low, high = (float(str(part)) for part in parts)
    except ValueError:
        if file is None:
            raise InputError(expected, key=option, value=key) from None
        raise InputError("expected [LOW, HIGH]", file=file, key=key, value=list(parts)) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(
            "expected two finite numbers, the lower one first", file=file, key=key, value=f"{low:g}:{high:g}"
        )
    return low, high


def _check(name: str, low: float, high: float, known: Mapping[str, Effect]) -> None:
    """Refuse a parameter that does not exist, and a range without its nominal value."""
    parameters = {f"{effect.name}.{own.name}": own for effect in known.values() for own in effect.parameters}
    if name not in parameters:
        there = ", ".join(sorted(parameters))
        raise InputError(f"no parameter {name!r}{did_you_mean(name, parameters)}; known: {there}", key="--bounds")
    own = parameters[name]
    if not low <= own.nominal <= high:
        raise InputError(
            f"the range of {name} must hold {own.nominal:g} [{own.unit}], at which the effect does nothing",
            key="--bounds",
            value=f"{low:g}:{high:g}",
        )


def bounded(effect: Effect, bounds: Bounds) -> Effect:
    """The effect with given ranges."""
    own = {name.partition(".")[2]: span for name, span in bounds.items() if name.partition(".")[0] == effect.name}
    if not own:
        return effect
    return effect.with_parameters(
        lambda parameter: parameter.within(*own[parameter.name]) if parameter.name in own else parameter
    )
