# SPDX-License-Identifier: Apache-2.0
"""Clocks that were set back in the middle of a recording: the parts before and after are used, each by itself."""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from dataclasses import replace

import numpy as np

from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.remarks import remark

MAX_STEPS_BACK = 10  # of a clock that was set; with more, rows are not in order
PAUSE_S = 1.0  # in the place of a step back; longer than any gap that is bridged


def without_steps_back(
    recorded: AbstractMapping[SignalName, Series],
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals on clocks that go on after a pause where they were set back, and a warning about each step.

    A gap of :data:`PAUSE_S` cuts a recording into pieces. The offset of the positions after a step holds for all
    signals, so that these stay together. Clocks with other numbers of steps are left as they are.

    Args:
        recorded: Signals of one arm, with positions.
    """
    found = dict(recorded)
    rows = {name: np.flatnonzero(np.diff(one.time) < 0.0) + 1 for name, one in found.items()}
    own, time = rows["position"], recorded["position"].time
    if not 0 < own.size <= MAX_STEPS_BACK or any(other.size != own.size for other in rows.values()):
        return found, []
    back = time[own - 1] - time[own] + float(np.median(np.diff(time)))  # the next sample was due a period later
    offsets = np.append(0.0, np.cumsum(back + PAUSE_S))
    for name, one in recorded.items():
        part = np.searchsorted(rows[name], np.arange(one.time.size), side="right")
        found[name] = replace(one, time=one.time + offsets[part])
    moments = zip(back.tolist(), (found["position"].time[own - 1] - time[0]).tolist(), strict=True)
    words = (
        "the clock was set back by {:.4g} s at t = {:.3f} s: the recording is cut there, and times after it count from "
        f"{PAUSE_S:g} s later"
    )
    return found, [remark(words, size, at) for size, at in moments]
