# SPDX-License-Identifier: Apache-2.0
"""Predictions that lie far outside of what was measured.

A missing effect moves a prediction by some percent. One that is off by much more is no finding about physics: another
robot, object or speed was measured than was predicted. The statistic is

    |v+_predicted - v+_measured| / |v-|

with B_theta, for the first contact. Over v+, as errors are told, a heavy object that hardly moves would always be far.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

FAR = 0.2  # twice the worst that the paper publishes for B_theta (0.10, parcel in grab), six times the median of all


@dataclass(frozen=True)
class Jump:
    """One predicted and measured jump.

    Attributes:
        label: What was measured, in words.
        ante: Ante-impact velocity v- [m/s]; NaN where it is not known, which makes nothing far.
        predicted: Predicted post-impact velocity [m/s].
        measured: Measured post-impact velocity [m/s].
    """

    label: str
    ante: float
    predicted: float
    measured: float

    @property
    def mismatch(self) -> float:
        """Prediction from measurement, over the ante-impact speed [-]."""
        return abs(self.predicted - self.measured) / abs(self.ante) if self.ante else math.nan


def far_jumps(jumps: Iterable[Jump]) -> list[Jump]:
    """Those that are far, the farthest first."""
    return sorted((jump for jump in jumps if jump.mismatch > FAR), key=lambda jump: -jump.mismatch)


def far_words(jumps: Iterable[Jump]) -> str:
    """What is to be said of those that are far, in one line; empty where none is."""
    listed = list(jumps)
    found = far_jumps(listed)
    if not found:
        return ""
    worst = found[0]
    return (
        f"{len(found)} of {len(listed)} predictions are far from what was measured, most for {worst.label}: "
        f"{worst.predicted:+.3f} m/s predicted, {worst.measured:+.3f} m/s measured, {worst.mismatch:.0%} of the "
        f"ante-impact speed apart (far: beyond {FAR:.0%}). An ordinary missing effect is smaller: was another robot, "
        "object or speed measured?"
    )
