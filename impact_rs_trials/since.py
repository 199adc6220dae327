# SPDX-License-Identifier: Apache-2.0
"""Measurements from a moment on: ``--since`` names a run, a row, or a time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from impact_rs_sim.errors import InputError, did_you_mean

MIN_WALL_CLOCK_S = (
    1e9  # later times count from 1970 (this is 2001), earlier ones from the start of a program or recording
)


def measured_since(when: str, stamps: Mapping[str, float], timed: bool = True) -> set[str]:
    """Names of the measurements from a moment on.

    Args:
        when: The first of the names, or a time: a date with or without a time of day (ISO 8601, local where it has no
            zone), or a number of seconds as the stamps have it.
        stamps: Times of the measurements [s], seconds since 1970 for dates, or any increasing number.
        timed: Whether these are times; otherwise only a name is a moment.

    Raises:
        InputError: There is no such name or time, or nothing was measured since.
    """
    begin = stamps.get(when)
    if begin is None and timed:
        begin = _time(when)
    if begin is None:
        last = max(stamps, key=lambda name: (stamps[name], name))
        times = ", or a time such as 2026-11-26T14:32" if timed else ""
        raise InputError(
            f"no such run or row{did_you_mean(when, stamps)}; expected a name, for example {last!r}{times}",
            key="--since",
            value=when,
        )
    found = {name for name, stamp in stamps.items() if stamp >= begin}
    if not found:
        last = max(stamps, key=lambda name: (stamps[name], name))
        raise InputError(f"nothing was measured since then; the last is {last!r}", key="--since", value=when)
    return found


def _time(text: str) -> float | None:
    """Seconds since 1970, or since the origin of a table's time; None: not a time."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return None
