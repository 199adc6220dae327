# SPDX-License-Identifier: Apache-2.0
"""Rows that were lost while timestamps go on, or timestamps that jump while rows go on, by the motion of all joints.

Positions are continuous. Between two rows they advance by dq (Delta t + d), where d is 0 if both rows were taken at
their timestamps, and m periods if m rows between them were lost. Polynomials of the positions through the rows before
and through the rows after differ by e_j = dq_j d + noise half-way between them. All joints share

    d = sum_j e_j dq_j / s_j^2 / sum_j (dq_j / s_j)^2,      s_d^-2 = sum_j (dq_j / s_j)^2

with the robust scatter s_j of e_j over the recording (1.4826 times the median absolute deviation). The power across dq
must be small against the power along dq: an outlier of one encoder is no lost row. d must exceed the jitter of the
recording, which is the robust scatter of d, and e the error of the polynomials at a kink of the motion. If velocities
were recorded, their integral is subtracted first, so that the polynomials are straight lines.

Timestamps after lost rows are moved by d, in whole periods. Gaps that are too long for the low-pass then cut the
recording.
"""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.readers.series import MAX_BRIDGED_PERIODS, Series
from impact_rs_trials.recordings.remarks import joined, remark

SIDE_SAMPLES = 6  # of each polynomial
ORDER = {"positions": 2, "integrals": 1}  # of a polynomial of positions, or of positions minus the integral of velocity
MIN_ADVANCE_PERIODS = 0.5  # half the advance of one lost row; jitter is less
MIN_ADVANCE_SIGMA = 8.0  # standard deviations: every row is a test, and a motion may jerk
MIN_ADVANCE_PER_JITTER = 7.0  # robust standard deviations of d, whose tails are heavy where an arm is slow
MAX_JITTER_ERROR_PERIODS = 0.25  # standard deviation of d at the rows that show the jitter
MIN_STEP_PER_KINK = 0.5  # of e over the change of the velocity in the duration of a polynomial
MAX_ACROSS_SHARE = 0.1  # power of e over noise in a direction across dq, over the power along dq
MAX_PASSES = 20  # each finds the clearest places, one in every two polynomials
MAX_NAMED_PLACES = 3  # in a warning


def without_lost_rows(
    recorded: AbstractMapping[SignalName, Series],
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals with timestamps corrected for lost rows, and warnings with their number and times.

    Signals with different timestamps, as of several topics, are unchanged.

    Args:
        recorded: Signals of one arm, with positions.
    """
    signals, position = dict(recorded), recorded["position"]
    time, q = position.time, position.values
    same_clock = all(np.array_equal(series.time, time) for series in signals.values())
    if not same_clock or time.size < 4 * SIDE_SAMPLES or np.any(np.diff(time) <= 0.0) or not np.isfinite(q).all():
        return signals, []
    velocity = recorded["velocity"].values if "velocity" in recorded else None
    stamped = np.diff(time)
    period = float(np.median(stamped))
    durations = stamped.copy()
    for _ in range(MAX_PASSES):
        delay, clear = _advances(np.append(0.0, np.cumsum(durations)), q, velocity, period)
        corrected = np.where(clear, np.maximum(np.round((durations + delay) / period), 1.0) * period, durations)
        if np.array_equal(corrected, durations):
            break
        durations = corrected
    lost_rows = np.round((durations - stamped) / period)
    if not np.any(lost_rows):
        return signals, []
    moments = time[0] + np.append(0.0, np.cumsum(durations))
    by = "the velocities" if velocity is not None else "the motion before and after"
    remarks = [
        *_remark(lost_rows, time, "rows were lost while timestamps went on", f"further than by {by}"),
        *_remark(-lost_rows, time, "periods are in the timestamps in which no time passed", f"less than by {by}"),
    ]
    return {name: replace(series, time=moments) for name, series in signals.items()}, remarks


def _advances(time: Array, position: Array, velocity: Array | None, period: float) -> tuple[Array, NDArray[np.bool_]]:
    """d after every row [s], and whether it is significant and the local maximum, ``(k - 1,)`` each."""
    count, middle = time.size - 1, 0.5 * (time[1:] + time[:-1])
    if velocity is None:
        values, order = position, ORDER["positions"]
    else:
        advance = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None]
        values, order = (
            position - np.vstack((np.zeros_like(advance[:1]), np.cumsum(advance, axis=0))),
            ORDER["integrals"],
        )
    interior = slice(SIDE_SAMPLES - 1, count - SIDE_SAMPLES + 1)  # rows with polynomials on both sides
    moments = middle[interior]
    before, speed_before = _extrapolated(time, values, order, moments, 0)
    after, speed_after = _extrapolated(time, values, order, moments, SIDE_SAMPLES)
    speed = 0.5 * (speed_before + speed_after if velocity is None else (velocity[1:] + velocity[:-1])[interior])
    step = after - before
    long = np.diff(time) > MAX_BRIDGED_PERIODS * period
    gaps = np.convolve(long, np.ones(2 * SIDE_SAMPLES - 1), "valid") > 0.5
    step[gaps] = np.nan
    steps = np.abs(np.diff(position, axis=0))
    resolution = np.min(np.where(steps > 0.0, steps, np.inf), axis=0)
    scatter = np.maximum(
        1.4826 * np.nanmedian(np.abs(step), axis=0), np.where(np.isfinite(resolution), resolution, 1.0)
    )
    e, v = step / scatter, speed / scatter
    information = np.maximum(np.sum(np.square(v), axis=1), 1e-300)
    delay = np.sum(e * v, axis=1) / information
    along = np.square(delay) * information
    across = (np.sum(np.square(e), axis=1) - along) / max(position.shape[1] - 1, 1)
    informative = np.isfinite(delay) & (information > (MAX_JITTER_ERROR_PERIODS * period) ** -2)
    jitter = 1.4826 * float(np.median(np.abs(delay[informative]))) if np.any(informative) else np.inf
    kink = SIDE_SAMPLES * period * np.linalg.norm((speed_after - speed_before) / scatter, axis=1)
    with np.errstate(invalid="ignore"):
        clear = (along > MIN_ADVANCE_SIGMA**2) & (across < MAX_ACROSS_SHARE * along)
        clear &= np.abs(delay) > np.maximum(MIN_ADVANCE_PERIODS * period, MIN_ADVANCE_PER_JITTER * jitter)
        clear &= np.sqrt(along) > MIN_STEP_PER_KINK * kink
    sizes = np.where(clear, along, 0.0)
    neighbourhood = np.lib.stride_tricks.sliding_window_view(np.pad(sizes, SIDE_SAMPLES), 2 * SIDE_SAMPLES + 1)
    clear &= sizes >= neighbourhood.max(axis=1)
    delays, mask = np.zeros(count), np.zeros(count, dtype=bool)
    delays[interior], mask[interior] = np.nan_to_num(delay), clear
    return delays, mask


def _extrapolated(time: Array, values: Array, order: int, moments: Array, first: int) -> tuple[Array, Array]:
    """Values and slopes at moments ``(m,)`` of polynomials through rows from moment index + ``first`` on."""
    rows = np.arange(moments.size)[:, None] + first + np.arange(SIDE_SAMPLES)
    t = time[rows] - moments[:, None]
    size = np.max(np.abs(t), axis=1, keepdims=True)
    basis = (t / size)[..., None] ** np.arange(order + 1)
    transposed = basis.swapaxes(1, 2)
    fitted = np.linalg.solve(transposed @ basis, transposed @ values[rows])
    return fitted[:, 0], fitted[:, 1] / size


def _remark(rows: Array, time: Array, event: str, evidence: str) -> list[str]:
    """A warning about ``rows`` ``(k - 1,)``, numbers of lost rows or of superfluous periods; empty: there are none."""
    indices = np.flatnonzero(rows > 0.5)
    if not indices.size:
        return []
    listed = [
        remark("t = {:.3f} s ({:d})", float(time[index] - time[0]), int(rows[index]))
        for index in indices[:MAX_NAMED_PLACES].tolist()
    ]
    more = remark(" and {:d} more places", indices.size - len(listed)) if indices.size > len(listed) else ""
    return [
        remark(
            "{:d} {}: at {}{} all joints move on {}. Times are corrected by as many periods, and a gap that is longer "
            "than the low-pass bridges cuts the recording",
            int(rows[indices].sum()), event, joined(", ", listed), more, evidence,
        )
    ]  # fmt: skip
