# SPDX-License-Identifier: Apache-2.0
"""Intervals, tested on both sides: one that is too wide is as wrong as one that misses the truth."""

from __future__ import annotations

from collections.abc import Sequence

WIDER = 1.5  # than expected, or narrower: an interval of twice the width, or of half, is noticed


def assert_covers(interval: Sequence[float], truth: float, half_width: float, within: float = WIDER) -> None:
    """The interval holds the truth, and its half width is that expected to a factor ``within``.

    ``half_width`` comes from a closed form (1.96 standard errors) where there is one, and else from a fit that was
    looked at: then it holds the interval where it was.
    """
    low, high = interval
    assert low <= truth <= high, f"[{low:.6g}, {high:.6g}] leaves {truth:.6g} out"
    half = (high - low) / 2.0
    assert half_width / within <= half <= half_width * within, (
        f"[{low:.6g}, {high:.6g}] has a half width of {half:.3g}, expected {half_width:.3g} to a factor of {within}"
    )
