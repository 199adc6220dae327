# SPDX-License-Identifier: Apache-2.0
"""Text of estimates and intervals, with the number of digits that the width of the interval justifies."""

from __future__ import annotations

import math
import sys
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

CONFIDENCE_LEVEL = 0.95  # of every interval
NORMAL_95 = 1.959964  # half the width of a 95 % interval over the standard deviation, normal distribution
PLAIN_NOTATION_RANGE = (1e-4, 1e6)  # numbers written without an exponent
MAX_DIGITS = 15  # significant decimal digits of a float
# Half width of an interval over the estimate that rounding errors alone produce
MAX_ROUNDING_RATIO = 4.0 * sys.float_info.epsilon
MIN_SPEED_DECIMALS = 3  # of a speed with its half interval [m/s]


def estimate_text(estimate: float, ci95: tuple[float, float] | None, least: int = 0) -> tuple[str, ...]:
    """An estimate and the ends of its interval, with two digits of the half width; without interval three digits.

    An interval as narrow as rounding errors is treated as missing.

    Args:
        estimate: The estimate.
        ci95: Ends of its interval; None: it has none.
        least: Decimals that are always written, where there is no exponent.
    """
    numbers = (estimate, *(ci95 or ()))
    half = (ci95[1] - ci95[0]) / 2.0 if ci95 is not None else 0.0
    largest = max(abs(number) for number in numbers)
    plain = PLAIN_NOTATION_RANGE[0] <= largest < PLAIN_NOTATION_RANGE[1]
    if not MAX_ROUNDING_RATIO * largest < half < math.inf:
        return tuple(
            f"{number:.{least}f}" if least and (plain or not largest) else f"{number:.3g}" for number in numbers
        )
    exponent = _decimal_exponent(largest)
    decimals = min(1 - _decimal_exponent(half), MAX_DIGITS - exponent)
    if plain:
        return tuple(f"{number:.{max(decimals, least, 0)}f}" for number in numbers)
    return tuple(f"{number:.{max(exponent + decimals + 1, 3)}g}" for number in numbers)


def estimate_in_line(estimate: float, ci95: tuple[float, float] | None, least: int = 0) -> str:
    """An estimate with its interval, as in ``1.15 [1.13, 1.17]``; arguments as for :func:`estimate_text`."""
    value, *interval = estimate_text(estimate, ci95, least)
    return f"{value} [{', '.join(interval)}]" if interval else value


def rounded_interval(ci95: tuple[float, float] | None) -> tuple[float, float] | None:
    """An interval for a file, rounded outwards to three digits of its half width; without width as it is."""
    if ci95 is None or not MAX_ROUNDING_RATIO * max(map(abs, ci95)) < (half := (ci95[1] - ci95[0]) / 2.0) < math.inf:
        return ci95
    step = Decimal(1).scaleb(_decimal_exponent(half) - 2)
    low, high = (
        float((Decimal(repr(end)) / step).to_integral_value(rounding) * step)
        for end, rounding in zip(ci95, (ROUND_FLOOR, ROUND_CEILING), strict=True)
    )
    return low, high


def speed_text(speed: float, half: float | None) -> tuple[str, ...]:
    """A speed and half its interval [m/s], to the millimetre per second, or as finely as the half interval needs."""
    if half is None or not math.isfinite(half):
        return (f"{speed:.{MIN_SPEED_DECIMALS}f}",)
    needed = -_decimal_exponent(half) if half > 0.0 else MIN_SPEED_DECIMALS
    decimals = min(max(MIN_SPEED_DECIMALS, needed), MAX_DIGITS)
    return f"{speed:.{decimals}f}", f"{half:.{decimals}f}"


def _decimal_exponent(number: float) -> int:
    """Decimal exponent of a number; 0.1 less a rounding error is treated as 0.1."""
    return math.floor(math.log10(number) + 1e-9)
