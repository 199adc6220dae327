# SPDX-License-Identifier: Apache-2.0
"""Gross errors: predictions far from the measurement.

A missing effect changes a prediction by a few percent. A much larger error usually means that the prediction is for
another robot, object or speed. The statistic is

    |v+_predicted - v+_measured| / |v-|

with B_theta, for the first contact. It refers to v-, because v+ of a heavy object is close to zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

# [-]; twice the largest mismatch of the paper for B_theta (0.10, parcel in grab), six times the median of all rows
FAR_MISMATCH = 0.2


@dataclass(frozen=True)
class Jump:
    """One predicted and measured velocity jump.

    Attributes:
        label: Object and case in words.
        ante: Ante-impact velocity v- [m/s]; NaN if not known: never a gross error.
        predicted: Predicted post-impact velocity [m/s].
        measured: Measured post-impact velocity [m/s].
    """

    label: str
    ante: float
    predicted: float
    measured: float

    @property
    def mismatch(self) -> float:
        """Distance of prediction and measurement over the ante-impact speed [-]."""
        return abs(self.predicted - self.measured) / abs(self.ante) if self.ante else math.nan


def far_jumps(jumps: Iterable[Jump]) -> list[Jump]:
    """Jumps with a gross error, the largest first."""
    return sorted((jump for jump in jumps if jump.mismatch > FAR_MISMATCH), key=lambda jump: -jump.mismatch)


def far_words(jumps: Iterable[Jump]) -> str:
    """Warning about gross errors in one line; empty without gross errors."""
    all_jumps = list(jumps)
    gross = far_jumps(all_jumps)
    if not gross:
        return ""
    worst = gross[0]
    return (
        f"{len(gross)} of {len(all_jumps)} predictions are far from the measurement, most for {worst.label}: "
        f"{worst.predicted:+.3f} m/s predicted, {worst.measured:+.3f} m/s measured, a difference of "
        f"{worst.mismatch:.0%} of the ante-impact speed (far: beyond {FAR_MISMATCH:.0%}). "
        "A missing effect is usually smaller: "
        "was another robot, object or speed measured?"
    )
