# SPDX-License-Identifier: Apache-2.0
"""One signal as a file has it, before it is brought together with the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.remarks import Amount, Remark

DIFFERENCE_S = 0.002  # of the differences that give a velocity; short for a motion, long for the steps of an encoder


class MissingSignal(InputError):
    """A signal that the mapping names and the file lacks; readers go on where it is an optional one."""


@dataclass(frozen=True)
class Names:
    """What the placeholders of a mapping stand for in one run.

    Attributes:
        object: ``{object}``, the object of the run; anything where it is not known.
        arm: ``{arm}``, the arm of the scenario; anything where it is not known.
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
        place: Where it is, for messages: ``topic /joint_states (position)``.
        time: Stamps on the clock of the run, ``(k,)`` [s].
        values: SI, ``(k, c)``.
        log: When the bag logged it, ``(k,)`` [s]; None where there is no second clock.
        remarks: What the user should know of how it was read.
    """

    place: str
    time: Array
    values: Array
    log: Array | None = None
    remarks: tuple[str, ...] = ()

    def sampled(self) -> Series:
        """Without the rows that hold no sample (all NaN), as tables have them where a slower signal has none."""
        kept = ~np.isnan(self.values).all(axis=1)
        if kept.all():
            return self
        log = None if self.log is None else self.log[kept]
        return Series(self.place, self.time[kept], self.values[kept], log, self.remarks)

    def without_repeats(self) -> Series:
        """Without the samples that have the stamp of the one before them; a remark says how many."""
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

    def at(self, time: Array) -> Array:
        """Interpolated linearly, and held at the ends, ``(m, c)``; the samples themselves at their own stamps."""
        if np.array_equal(self.time, time):
            return self.values
        return np.column_stack([np.interp(time, self.time, column) for column in self.values.T])
