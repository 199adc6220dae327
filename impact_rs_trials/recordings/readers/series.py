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
MIN_HELD_SHARE = 0.8  # of the values, held for about as many rows
MIN_HELD_PERIODS = 1.5  # of the samples, from which on a command is held from one to the next
DIFFERENCE_S = 0.002  # of the differences that give a velocity; short for a motion, long for the steps of an encoder


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
        values: SI, ``(k, c)``.
        log: Log times of the bag, ``(k,)`` [s]; None: no second clock.
        remarks: Warnings about reading it.
    """

    label: str
    time: Array
    values: Array
    log: Array | None = None
    remarks: tuple[str, ...] = ()

    def sampled(self) -> Series:
        """Without the rows that hold no sample (all NaN), as in tables with a slower signal, or no timestamp."""
        own = self.in_rows(np.any(~np.isnan(self.values), axis=1))
        stamped = ~np.isnan(own.time)
        if stamped.all() or np.mean(~stamped) > MAX_UNSTAMPED_SHARE:
            return own
        words = "{}: {:d} of {:d} samples have no time stamp: left out"
        return own.in_rows(stamped).with_remark(words, int(np.sum(~stamped)), stamped.size)

    def without_held(self) -> Series:
        """One row of each value, if values are held for several rows, as of a slow signal in a fast table.

        Nearly all values are then held for about the same number of rows. A value that stays longer, because nothing
        moves, is kept once for each such number.
        """
        changes = np.flatnonzero(np.any(np.diff(self.values, axis=0) != 0.0, axis=1)) + 1
        if changes.size < 2:
            return self
        starts, lengths = np.append(0, changes), np.diff(changes)  # of values that begin and end in the series
        usual = round(float(np.median(lengths)))
        if usual < 2 or np.mean(np.abs(lengths - usual) <= max(1.0, MAX_HELD_CHANGE * usual)) < MIN_HELD_SHARE:
            return self
        spans = np.diff(np.append(starts, self.time.size))
        since, long = np.arange(self.time.size) - np.repeat(starts, spans), np.repeat(spans, spans)
        kept = (since == 0) | ((since % usual == 0) & (long > 2 * usual))
        share, period = 100.0 * np.mean(~kept), float(np.median(np.diff(self.time[kept])))
        words = (
            "{}: {:.3g} % of the rows repeat the values of the row before, held for {} rows: sampled at {:.4g} Hz, the "
            "first of each is kept"
        )
        return self.in_rows(kept).with_remark(words, share, str(usual), 1.0 / max(period, 1e-9))

    def filled(self) -> Series:
        """Rows of the fullest column; numbers that other columns lack there are interpolated in their own column.

        Each joint may have its own rows, as where every one has a topic. Rows in a longer gap of a column, or beyond
        its ends, are left out.
        """
        numbers = np.isfinite(self.values)
        if numbers.all() or np.min(numbers.sum(axis=0)) < 2 or not np.isfinite(self.time).all():
            return self
        clock = np.append(0.0, np.cumsum(np.maximum(np.diff(self.time), 0.0)))  # also where it was set back
        rows = numbers[:, int(np.argmax(numbers.sum(axis=0)))]
        own, at = self.in_rows(rows), clock[rows]
        kept, values = np.ones(at.size, dtype=bool), own.values.copy()
        for column, has in enumerate(numbers.T):
            time, blank = clock[has], ~np.isfinite(own.values[:, column])
            after = np.clip(np.searchsorted(time, at), 1, time.size - 1)
            near = time[after] - time[after - 1] <= MAX_BRIDGED_PERIODS * float(np.median(np.diff(time)))
            kept &= ~blank | (near & (at >= time[0]) & (at <= time[-1]))
            values[blank, column] = np.interp(at[blank], time, self.values[has, column])
        share = 100.0 * float(np.mean(~numbers))
        words = (
            "{}: {:.3g} % of the cells are blank or no number where others of their row are: interpolated in their "
            "column"
        )
        return replace(own, values=values).in_rows(kept).with_remark(words, share)

    def in_rows(self, kept: NDArray[np.bool_]) -> Series:
        """The series in the rows of a mask, ``(k,)``."""
        log = None if self.log is None else self.log[kept]
        return replace(self, time=self.time[kept], values=self.values[kept], log=log)

    def with_remark(self, template: str, *values: Any) -> Series:
        """The series with a further warning, a template that begins with its label (:mod:`remarks`)."""
        return replace(self, remarks=(*self.remarks, remark(template, self.label, *values)))

    def without_repeats(self) -> Series:
        """Without the samples that repeat the previous timestamp, with a warning about their number."""
        kept = np.diff(self.time, prepend=-np.inf) != 0.0
        if kept.all():
            return self
        words = "{}: {:d} of {:d} samples have the stamp of the one before; the first is kept"
        return self.in_rows(kept).with_remark(words, int(np.sum(~kept)), kept.size)

    def derivative(self) -> Series:
        """Rate of change, by central differences over :data:`DIFFERENCE_S` or two sampling periods, ``(k, c)``."""
        period = float(np.median(np.diff(self.time))) if self.time.size > 1 else DIFFERENCE_S
        half, rows = max(1, round(0.5 * DIFFERENCE_S / max(period, 1e-6))), np.arange(self.time.size)
        edges = np.flatnonzero(np.diff(self.time) > MAX_BRIDGED_PERIODS * period) + 1  # no difference spans a gap
        part = np.searchsorted(edges, rows, side="right")
        first, last = np.append(0, edges)[part], np.append(edges - 1, self.time.size - 1)[part]
        before, after = np.maximum(rows - half, 0), np.minimum(rows + half, self.time.size - 1)
        several = first < last
        before, after = (
            np.where(several, np.maximum(before, first), before),
            np.where(several, np.minimum(after, last), after),
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # of stamps that repeat, which are refused elsewhere
            rate = (self.values[after] - self.values[before]) / (self.time[after] - self.time[before])[:, None]
        how = f"velocities are its derivative, by differences over {2e3 * half * period:.3g} ms"
        return replace(self.with_remark("{}: {}", how), label=f"derivative of {self.label}", values=rate)

    def on(self, time: Array) -> Array:
        """A command at other timestamps, ``(m, c)``: held until the next one if these are rare, else as :meth:`at`.

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
