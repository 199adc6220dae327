# SPDX-License-Identifier: Apache-2.0
"""Clocks that were set back during a recording: the parts before and after the step become separate pieces."""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from dataclasses import replace

import numpy as np

from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.remarks import remark

MAX_STEPS_BACK = 10  # of a clock that was set; with more, rows are not in order
PAUSE_S = 1.0  # replaces a step back; longer than any gap that is bridged


def without_steps_back(
    recorded: AbstractMapping[SignalName, Series],
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals with a pause of :data:`PAUSE_S` in place of every step back of the clock, and a warning about each step.

    The pause cuts a recording into pieces. The offset of the positions after a step is applied to all signals, which
    keeps them synchronous. If the signals differ in the number of steps, nothing changes.

    Args:
        recorded: Signals of one arm, with positions.
    """
    continued = dict(recorded)
    rows = {name: np.flatnonzero(np.diff(series.time) < 0.0) + 1 for name, series in continued.items()}
    step_rows, time = rows["position"], recorded["position"].time
    if not 0 < step_rows.size <= MAX_STEPS_BACK or any(other.size != step_rows.size for other in rows.values()):
        return continued, []
    period = float(np.median(np.diff(time)))
    set_back = time[step_rows - 1] - time[step_rows] + period  # expected less recorded stamp
    offsets = np.append(0.0, np.cumsum(set_back + PAUSE_S))
    for name, series in recorded.items():
        piece = np.searchsorted(rows[name], np.arange(series.time.size), side="right")
        continued[name] = replace(series, time=series.time + offsets[piece])
    moments = zip(set_back.tolist(), (continued["position"].time[step_rows - 1] - time[0]).tolist(), strict=True)
    words = (
        "the clock was set back by {:.4g} s at t = {:.3f} s: the recording is cut there, and times after it count from "
        f"{PAUSE_S:g} s later"
    )
    return continued, [remark(words, size, at) for size, at in moments]
