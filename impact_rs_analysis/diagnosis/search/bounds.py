# SPDX-License-Identifier: Apache-2.0
"""Ranges of parameters by the user (``diagnose --bounds``).

A default range follows from the size of the robot and is doubled if a fit ends at its end; a range by the user is kept.
Bounds of physics, such as friction >= 0, hold as well.
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


def read_bounds(texts: Iterable[str], effects: Mapping[str, Effect]) -> Bounds:
    """Bounds of a command line.

    Args:
        texts: ``EFFECT.PARAMETER=LOW:HIGH``, or YAML files that map ``EFFECT.PARAMETER`` to ``[LOW, HIGH]``.
        effects: Effects by name.

    Raises:
        InputError: A text or file cannot be read, a parameter does not exist, or a range excludes its nominal value.
    """
    bounds = read_ranges(texts, "--bounds", EXPECTED_BOUNDS)
    check_bounds(bounds, effects)
    return bounds


def check_bounds(bounds: Bounds, effects: Mapping[str, Effect]) -> None:
    """Refuse bounds of parameters that do not exist, and ranges without the nominal value.

    Args:
        bounds: The bounds.
        effects: Effects by name.

    Raises:
        InputError: Such bounds.
    """
    for name, (low, high) in bounds.items():
        _check(name, low, high, effects)


def read_ranges(texts: Iterable[str], option: str, expected: str) -> dict[str, tuple[float, float]]:
    """Ranges of a command line by name.

    Args:
        texts: ``NAME=LOW:HIGH``, or YAML files that map names to ``[LOW, HIGH]``.
        option: Option of the command, for messages.
        expected: Expected values, for messages.

    Raises:
        InputError: A text or file cannot be read, or holds no range.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, span = text.partition("=")
        if equals:
            ranges[name.strip()] = _span(span.split(":"), text, None, option, expected)
            continue
        for key, values in load_mapping(text).items():
            parts = values if isinstance(values, list) else [values]
            ranges[str(key)] = _span(parts, str(key), text, option, expected)
    return ranges


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


def _check(name: str, low: float, high: float, effects: Mapping[str, Effect]) -> None:
    """Refuse a parameter that does not exist, and a range without its nominal value."""
    parameters = {
        f"{effect.name}.{parameter.name}": parameter for effect in effects.values() for parameter in effect.parameters
    }
    if name not in parameters:
        names = ", ".join(sorted(parameters))
        raise InputError(f"no parameter {name!r}{did_you_mean(name, parameters)}; known: {names}", key="--bounds")
    parameter = parameters[name]
    if not low <= parameter.nominal <= high:
        raise InputError(
            f"the range of {name} must hold {parameter.nominal:g} [{parameter.unit}], at which the effect does nothing",
            key="--bounds",
            value=f"{low:g}:{high:g}",
        )


def with_bounds(effect: Effect, bounds: Bounds) -> Effect:
    """The effect with the ranges of the user."""
    spans = {name.partition(".")[2]: span for name, span in bounds.items() if name.partition(".")[0] == effect.name}
    if not spans:
        return effect
    return effect.with_parameters(
        lambda parameter: parameter.within(*spans[parameter.name]) if parameter.name in spans else parameter
    )
