# SPDX-License-Identifier: Apache-2.0
"""Measurements from a moment on: ``--since`` names a run, a row, or a time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from impact_rs_sim.errors import InputError, did_you_mean

MIN_WALL_CLOCK_S = 1e9  # larger times are seconds since 1970 (1e9: 2001), smaller ones since the start of a recording


def measured_since(when: str, stamps: Mapping[str, float], timed: bool = True) -> set[str]:
    """Names of the measurements from a moment on.

    Args:
        when: Name of the first measurement, or a time: a date with or without a time of day (ISO 8601, local without a
            zone), or a number of seconds on the clock of the stamps. Where these are seconds since 1970, a number below
            ``MIN_WALL_CLOCK_S`` is a date, ``20261126``.
        stamps: Times of the measurements [s], seconds since 1970 for dates, or any increasing number.
        timed: Whether the stamps are times; if not, ``when`` has to be a name.

    Raises:
        InputError: ``when`` is neither a name nor a time, or nothing was measured since.
    """
    begin = stamps.get(when)
    if begin is None and timed:
        begin = _time(when, min(stamps.values()))
    if begin is None:
        last = max(stamps, key=lambda name: (stamps[name], name))
        times = ", or a time such as 2026-11-26T14:32" if timed else ""
        raise InputError(
            f"no such run or row{did_you_mean(when, stamps)}; expected a name, for example {last!r}{times}",
            key="--since",
            value=when,
        )
    names = {name for name, stamp in stamps.items() if stamp >= begin}
    if not names:
        last = max(stamps, key=lambda name: (stamps[name], name))
        raise InputError(f"nothing was measured since then; the last is {last!r}", key="--since", value=when)
    return names


def _time(text: str, first: float) -> float | None:
    """Seconds on the clock of the stamps, of which ``first`` is the first; None: not a time."""
    try:
        seconds = float(text)
        if seconds >= MIN_WALL_CLOCK_S or first < MIN_WALL_CLOCK_S:
            return seconds
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return None
