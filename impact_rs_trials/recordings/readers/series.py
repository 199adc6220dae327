# SPDX-License-Identifier: Apache-2.0
"""One signal of a file, before interpolation on a common grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.remarks import remark

MAX_BRIDGED_PERIODS = 5.0  # between two samples, beyond which nothing is interpolated or differentiated
MAX_UNSTAMPED_SHARE = 0.1  # of the rows; more are a fault of the clock, which is refused
MAX_HELD_CHANGE = 0.25  # of the usual number of rows for which a value is held, or one row
MIN_HELD_SHARE = 0.8  # of the values that are held for about the usual number of rows
MIN_HELD_PERIODS = 1.5  # of the samples; a command with a longer period is held until its next value
DIFFERENCE_S = 0.002  # span of a velocity difference; short for a motion, long for the steps of an encoder


class MissingSignal(InputError):
    """A signal that the mapping names and the file lacks; readers go on if it is optional."""


@dataclass(frozen=True)
class Names:
    """Values of the placeholders of a mapping in one run.

    Attributes:
        object: ``{object}``, the object of the run; matches anything if unknown.
        arm: ``{arm}``, the arm of the scenario; matches anything if unknown.
        run: ``{run}``, the run's own name.
    """

    object: str = "*"
    arm: str = "*"
    run: str = "*"

    def fill(self, text: str) -> str:
        """``text`` with its placeholders filled in; ``{joint}`` stays."""
        return text.replace("{object}", self.object).replace("{arm}", self.arm).replace("{run}", self.run)


@dataclass(frozen=True)
class Series:
    """One signal.

    Attributes:
        label: Source for messages: ``topic /joint_states (position)``.
        time: Timestamps on the clock of the run, ``(k,)`` [s].
        values: Values in SI units, ``(k, c)``.
        log: Log times of the bag, ``(k,)`` [s]; None: no second clock.
        remarks: Warnings about reading it.
    """

    label: str
    time: Array
    values: Array
    log: Array | None = None
    remarks: tuple[str, ...] = ()

    def sampled(self) -> Series:
        """The series without rows that have no sample (all nan, as of a slow signal in a table) or no timestamp."""
        filled_rows = self.in_rows(np.any(~np.isnan(self.values), axis=1))
        stamped = ~np.isnan(filled_rows.time)
        if stamped.all() or np.mean(~stamped) > MAX_UNSTAMPED_SHARE:
            return filled_rows
        words = "{}: {:d} of {:d} samples have no time stamp: left out"
        return filled_rows.in_rows(stamped).with_remark(words, int(np.sum(~stamped)), stamped.size)

    def without_held(self) -> Series:
        """One row per value, if values are held for several rows, as of a slow signal in a fast table.

        Nearly all values are then held for about the same number of rows. A value that stays longer, because nothing
        moves, is kept once per that number of rows.
        """
        changes = np.flatnonzero(np.any(np.diff(self.values, axis=0) != 0.0, axis=1)) + 1
        if changes.size < 2:
            return self
        starts, lengths = np.append(0, changes), np.diff(changes)  # of values that begin and end in the series
        usual_length = round(float(np.median(lengths)))
        if (
            usual_length < 2
            or np.mean(np.abs(lengths - usual_length) <= max(1.0, MAX_HELD_CHANGE * usual_length)) < MIN_HELD_SHARE
        ):
            return self
        all_lengths = np.diff(np.append(starts, self.time.size))
        rows_since_change, lengths_of_rows = (
            np.arange(self.time.size) - np.repeat(starts, all_lengths),
            np.repeat(all_lengths, all_lengths),
        )
        mask = (rows_since_change == 0) | (
            (rows_since_change % usual_length == 0) & (lengths_of_rows > 2 * usual_length)
        )
        share, period = 100.0 * np.mean(~mask), float(np.median(np.diff(self.time[mask])))
        words = (
            "{}: {:.3g} % of the rows repeat the values of the row before, held for {} rows: sampled at {:.4g} Hz, the "
            "first of each is kept"
        )
        return self.in_rows(mask).with_remark(words, share, str(usual_length), 1.0 / max(period, 1e-9))

    def filled(self) -> Series:
        """Rows of the fullest column; missing numbers of other columns are interpolated in their column.

        Each joint may have its own rows, for example if each joint has a topic. Rows in a long gap of a column, or
        beyond its ends, are left out.
        """
        numbers = np.isfinite(self.values)
        if numbers.all() or np.min(numbers.sum(axis=0)) < 2 or not np.isfinite(self.time).all():
            return self
        clock = np.append(0.0, np.cumsum(np.maximum(np.diff(self.time), 0.0)))  # also where it was set back
        rows = numbers[:, int(np.argmax(numbers.sum(axis=0)))]
        rows_kept, times = self.in_rows(rows), clock[rows]
        interpolated, values = np.ones(times.size, dtype=bool), rows_kept.values.copy()
        for column, filled_cells in enumerate(numbers.T):
            time, blank = clock[filled_cells], ~np.isfinite(rows_kept.values[:, column])
            after = np.clip(np.searchsorted(time, times), 1, time.size - 1)
            in_short_gap = time[after] - time[after - 1] <= MAX_BRIDGED_PERIODS * float(np.median(np.diff(time)))
            interpolated &= ~blank | (in_short_gap & (times >= time[0]) & (times <= time[-1]))
            values[blank, column] = np.interp(times[blank], time, self.values[filled_cells, column])
        share = 100.0 * float(np.mean(~numbers))
        words = (
            "{}: {:.3g} % of the cells are blank or no number where others of their row are: interpolated in their "
            "column"
        )
        return replace(rows_kept, values=values).in_rows(interpolated).with_remark(words, share)

    def in_rows(self, mask: NDArray[np.bool_]) -> Series:
        """The series in the rows of a mask, ``(k,)``."""
        log = None if self.log is None else self.log[mask]
        return replace(self, time=self.time[mask], values=self.values[mask], log=log)

    def with_remark(self, template: str, *values: Any) -> Series:
        """The series with a further warning, a template that begins with its label (:mod:`remarks`)."""
        return replace(self, remarks=(*self.remarks, remark(template, self.label, *values)))

    def without_repeats(self) -> Series:
        """The series without samples that repeat the previous timestamp, with a warning about their number."""
        mask = np.diff(self.time, prepend=-np.inf) != 0.0
        if mask.all():
            return self
        words = "{}: {:d} of {:d} samples have the stamp of the one before; the first is kept"
        return self.in_rows(mask).with_remark(words, int(np.sum(~mask)), mask.size)

    def derivative(self) -> Series:
        """Rate of change, by central differences over :data:`DIFFERENCE_S` or two sampling periods, ``(k, c)``."""
        period = float(np.median(np.diff(self.time))) if self.time.size > 1 else DIFFERENCE_S
        half, rows = max(1, round(0.5 * DIFFERENCE_S / max(period, 1e-6))), np.arange(self.time.size)
        edges = np.flatnonzero(np.diff(self.time) > MAX_BRIDGED_PERIODS * period) + 1  # no difference spans a gap
        piece = np.searchsorted(edges, rows, side="right")
        first, last = np.append(0, edges)[piece], np.append(edges - 1, self.time.size - 1)[piece]
        before, after = np.maximum(rows - half, 0), np.minimum(rows + half, self.time.size - 1)
        has_neighbour = first < last
        before, after = (
            np.where(has_neighbour, np.maximum(before, first), before),
            np.where(has_neighbour, np.minimum(after, last), after),
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # of stamps that repeat, which are refused elsewhere
            rate = (self.values[after] - self.values[before]) / (self.time[after] - self.time[before])[:, None]
        text = f"velocities are its derivative, by differences over {2e3 * half * period:.3g} ms"
        return replace(self.with_remark("{}: {}", text), label=f"derivative of {self.label}", values=rate)

    def on(self, time: Array) -> Array:
        """A command at other timestamps, ``(m, c)``: held until the next sample if samples are rare, else :meth:`at`.

        Args:
            time: Timestamps, ``(m,)`` [s].
        """
        if self.time.size < 2 or time.size < 2:
            return self.at(time)
        if float(np.median(np.diff(self.time))) < MIN_HELD_PERIODS * float(np.median(np.diff(time))):
            return self.at(time)
        return np.asarray(self.values[np.maximum(np.searchsorted(self.time, time, side="right") - 1, 0)])

    def at(self, time: Array) -> Array:
        """Linear interpolation, constant beyond the ends, ``(m, c)``; exact at the series' own timestamps."""
        if np.array_equal(self.time, time):
            return self.values
        return np.column_stack([np.interp(time, self.time, column) for column in self.values.T])
