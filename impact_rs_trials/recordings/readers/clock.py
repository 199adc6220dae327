# SPDX-License-Identifier: Apache-2.0
"""Timestamps: their errors, gaps between samples, and the regular grid closest to them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.file_units import UNITS

if TYPE_CHECKING:
    from impact_rs_trials.recordings.mapping import TimeSource

MAX_GRID_ERROR_PERIODS = 0.02  # of a timestamp on a regular grid
MAX_SHOWN_GAPS = 5  # in a message


@dataclass(frozen=True)
class Gap:
    """A stretch without samples.

    Attributes:
        start: Timestamp of the last sample before it [s].
        length: Time until the next sample [s].
    """

    start: float
    length: float

    @property
    def end(self) -> float:
        """Timestamp of the first sample after it [s]."""
        return self.start + self.length


def check_stamps(path: Path, label: str, time: Array) -> None:
    """Check that timestamps are finite and strictly increasing.

    Args:
        path: File, for messages.
        label: Topic or column, for messages.
        time: Stamps, ``(k,)`` [s].

    Raises:
        InputError: They are not; the message has time and remedy.
    """
    if not np.isfinite(time).all():
        raise InputError(f"{label}: sample {int(np.argmin(np.isfinite(time)))} has no finite time", file=path)
    steps = np.diff(time)
    if not np.any(steps <= 0.0):
        return
    index = int(np.argmax(steps <= 0.0))
    position = f"at t = {time[index] - time[0]:.3f} s"
    if steps[index] < 0.0:
        raise InputError(
            f"{label}: time stamps run backwards by {-steps[index]:.4g} s {position}: the clock was set, or the file "
            "is not in order; cut the recording there, or sort it by time",
            file=path,
        )
    count = int(np.sum(steps == 0.0))
    raise InputError(
        f"{label}: time stamps stand still {position}, {count} of {time.size} repeat the one before: recorded twice, "
        "or stamped by a clock that is too coarse; in the mapping time.repeated: keep_first keeps one sample of each, "
        "and time.column takes other stamps",
        file=path,
    )


def check_jumps(path: Path, label: str, time: Array, log: Array | None, largest: float, pauses: bool) -> None:
    """Check that timestamps do not jump.

    Args:
        path: File, for messages.
        label: Topic or column, for messages.
        time: Stamps, increasing, ``(k,)`` [s].
        log: A second clock that distinguishes jumps from pauses, ``(k,)`` [s]; None: not available.
        largest: Largest step that is no jump [s].
        pauses: Whether a pause, which the second clock shows as well, is an error, too.

    Raises:
        InputError: They jump; the message has time and remedy.
    """
    steps = np.diff(time)
    long = steps > largest
    jumps = long & (np.abs(steps - np.diff(log)) > largest) if log is not None else np.zeros_like(long)
    wrong = long if pauses else jumps
    if not np.any(wrong):
        return
    index = int(np.argmax(wrong))
    if jumps[index]:
        assert log is not None
        reason = f"{np.diff(log)[index]:.4g} s by the log: the clock was set"
    else:
        reason = "a jump of the clock, or a pause"
    raise InputError(
        f"{label}: time stamps jump by {steps[index]:.4g} s at t = {time[index] - time[0]:.3f} s, {reason}; cut the "
        "recording there into two runs, or leave it out",
        file=path,
    )


def seconds_of(stamps: NDArray[Any], unit: float) -> Array:
    """Timestamps in seconds, ``(k,)``.

    Nanoseconds of a wall clock have more digits than a floating-point number. Integers are therefore split into whole
    seconds and remainder first, with the rounding of a ROS stamp.

    Args:
        stamps: Timestamps of the file, ``(k,)``.
        unit: Their unit [s].
    """
    if not np.issubdtype(stamps.dtype, np.integer):
        return np.asarray(stamps * unit)
    per_second = round(1.0 / unit)
    return np.asarray(stamps // per_second + (stamps % per_second) * unit)


def seconds_of_dates(stamps: NDArray[Any]) -> Array:
    """Dates or durations of NumPy in seconds, ``(k,)``; NaT is not a number."""
    nanoseconds = stamps.astype(f"{stamps.dtype.kind}8[ns]").astype(np.int64)
    return np.where(np.isnat(stamps), np.nan, seconds_of(nanoseconds, 1e-9))


def seconds_by(path: Path, clock: TimeSource, stamps: NDArray[Any]) -> Array:
    """Timestamps in seconds from times, frame numbers or time steps in the unit of a clock, ``(k,)``.

    Args:
        path: File, for messages.
        clock: Unit of the numbers (not ``date``), frame rate, and whether the numbers are time steps.
        stamps: Numbers, ``(k,)``.

    Raises:
        InputError: The rate of frames is missing.
    """
    if clock.unit == "frames":
        if clock.rate is None:
            raise InputError("is missing; expected the frame rate [Hz]", file=path, key="time.rate")
        return seconds_of(stamps, 1.0 / clock.rate)
    seconds = seconds_of(stamps, UNITS["time"][clock.unit])
    return since_first(seconds) if clock.steps else seconds


def since_first(steps: Array) -> Array:
    """Timestamps from time steps, ``(k,)`` [s]; the first step is ignored and the first stamp is 0."""
    return np.concatenate(([0.0], np.cumsum(steps[1:])))


def seconds_of_pair(path: Path, label: str, seconds: NDArray[Any], nanoseconds: NDArray[Any]) -> Array:
    """Timestamps in seconds from whole seconds and nanoseconds, ``(k,)``.

    Args:
        path: File, for messages.
        label: Columns or arrays, for messages.
        seconds: Whole seconds, ``(k,)``.
        nanoseconds: 0 to 999 999 999, ``(k,)``.

    Raises:
        InputError: The numbers are out of range.
    """
    if seconds.shape != nanoseconds.shape or seconds.ndim != 1:
        message = f"{label}: {seconds.shape} and {nanoseconds.shape}, expected two numbers a sample"
        raise InputError(message, file=path)
    for numbers, meaning, limit in ((seconds, "whole seconds", 2**33), (nanoseconds, "nanoseconds", 10**9)):
        wrong = ~((numbers >= 0) & (numbers < limit) & (np.mod(numbers, 1) == 0))
        if np.any(wrong):
            row = int(np.argmax(wrong))
            message = (
                f"{label}: sample {row + 1} has {numbers[row]:.12g} where {meaning} are expected, 0 ... {limit - 1}"
            )
            raise InputError(f"{message}; the first has whole seconds, the second the remaining nanoseconds", file=path)
    return seconds_of(seconds.astype(np.int64) * 10**9 + nanoseconds.astype(np.int64), 1e-9)


def gaps(time: Array, longest: float) -> list[Gap]:
    """Stretches longer than ``longest`` [s] without samples; ``time`` increases, ``(k,)`` [s]."""
    steps = np.diff(time)
    return [Gap(float(time[index]), float(steps[index])) for index in np.flatnonzero(steps > longest)]


def gaps_in_words(gaps_found: list[Gap], start: float) -> str:
    """``0.030 s at t = 1.250 s, ...`` with times since ``start`` [s]."""
    shown = ", ".join(f"{gap.length:.3f} s at t = {gap.start - start:.3f} s" for gap in gaps_found[:MAX_SHOWN_GAPS])
    return shown + (f" and {len(gaps_found) - MAX_SHOWN_GAPS} more" if len(gaps_found) > MAX_SHOWN_GAPS else "")


def even_grid(time: Array) -> Array:
    """Times of equal distance from the first stamp to the last, ``(k,)`` [s].

    The distance is the mean step without gaps; the median would be one of the steps, which are rounded on wall clocks.
    If every timestamp lies on the grid, samples need no interpolation.
    """
    length, steps = time[-1] - time[0], np.diff(time)
    without_gaps = np.abs(steps / np.median(steps) - 1.0) < 0.5
    count = max(1, round(length / float(np.mean(steps[without_gaps]))))
    return np.asarray(time[0] + length / count * np.arange(count + 1))


def grid_from(time: Array, main: Array) -> Array:
    """The even grid of the timestamps ``main``, extended to the first and the last of ``time``, ``(k,)`` [s].

    Samples of the main piece then do not depend on the samples beyond its gaps.
    """
    grid = even_grid(main)
    period = grid[1] - grid[0]
    before, after = (
        int(length / period + MAX_GRID_ERROR_PERIODS) for length in (grid[0] - time[0], time[-1] - grid[-1])
    )
    if before == after == 0:
        return grid
    return np.concatenate(
        (grid[0] - period * np.arange(before, 0, -1), grid, grid[-1] + period * np.arange(1, after + 1))
    )
