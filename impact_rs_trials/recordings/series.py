# SPDX-License-Identifier: Apache-2.0
"""One signal of a file, before interpolation on a common grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.remarks import Amount, Remark

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
        place: Source label for messages: ``topic /joint_states (position)``.
        time: Timestamps on the clock of the run, ``(k,)`` [s].
        values: SI, ``(k, c)``.
        log: Log times of the bag, ``(k,)`` [s]; None: no second clock.
        remarks: Warnings about reading it.
    """

    place: str
    time: Array
    values: Array
    log: Array | None = None
    remarks: tuple[str, ...] = ()

    def sampled(self) -> Series:
        """Without the rows that hold no sample (all NaN), as in tables with a slower signal."""
        kept = ~np.isnan(self.values).all(axis=1)
        if kept.all():
            return self
        log = None if self.log is None else self.log[kept]
        return Series(self.place, self.time[kept], self.values[kept], log, self.remarks)

    def without_repeats(self) -> Series:
        """Without the samples that repeat the previous timestamp, with a warning about their number."""
        kept = np.diff(self.time, prepend=-np.inf) != 0.0
        if kept.all():
            return self
        repeats = int(np.sum(~kept))
        share = Amount(repeats, "d"), " of ", Amount(kept.size, "d")
        said = Remark(f"{self.place}: ", *share, " samples have the stamp of the one before; the first is kept")
        log = None if self.log is None else self.log[kept]
        return replace(self, time=self.time[kept], values=self.values[kept], log=log, remarks=(*self.remarks, said))

    def derivative(self) -> Series:
        """Rate of change, by central differences over :data:`DIFFERENCE_S` or two sampling periods, ``(k, c)``."""
        period = float(np.median(np.diff(self.time))) if self.time.size > 1 else DIFFERENCE_S
        half, rows = max(1, round(0.5 * DIFFERENCE_S / max(period, 1e-6))), np.arange(self.time.size)
        before, after = np.maximum(rows - half, 0), np.minimum(rows + half, self.time.size - 1)
        with np.errstate(divide="ignore", invalid="ignore"):  # of stamps that repeat, which are refused elsewhere
            rate = (self.values[after] - self.values[before]) / (self.time[after] - self.time[before])[:, None]
        said = f"{self.place}: velocities are its derivative, by differences over {2e3 * half * period:.3g} ms"
        return replace(self, place=f"derivative of {self.place}", values=rate, remarks=(*self.remarks, said))

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
