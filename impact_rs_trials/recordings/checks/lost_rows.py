# SPDX-License-Identifier: Apache-2.0
"""Rows that were lost while timestamps go on, or timestamps that jump while rows go on, by the motion of all joints.

Positions are continuous. Between two rows they advance by dq (Delta t + d), where d is 0 if both rows were taken at
their timestamps, and m periods if m rows between them were lost. With one polynomial of the positions through the rows
before and one through those after, which differ by e_j = dq_j d + noise half-way, all joints share

    d = sum_j e_j dq_j / s_j^2 / sum_j (dq_j / s_j)^2,      s_d^-2 = sum_j (dq_j / s_j)^2

with the robust scatter s_j of e_j over the recording (1.4826 times the median absolute deviation). What is left across
dq must be small against what lies along it: an outlier of one encoder is no lost row. d must exceed the jitter of the
recording, which is its own robust scatter, and e what a kink of the motion beside the place makes of the polynomials.
Where velocities were recorded, their integral is subtracted before, so that polynomials are straight lines.

Timestamps after such a place are moved by d, in whole periods; gaps that are too long for the low-pass then cut the
recording there.
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
MIN_ADVANCE_PERIODS = 0.5  # half of what one lost row makes; jitter is less
MIN_ADVANCE_SIGMA = 8.0  # standard deviations: every row is a test, and a motion may jerk
MIN_ADVANCE_PER_JITTER = 7.0  # robust standard deviations of d, whose tails are heavy where an arm is slow
MAX_JITTER_ERROR_PERIODS = 0.25  # standard deviation of d at the rows that show the jitter
MIN_STEP_PER_KINK = 0.5  # of e over the change of the velocity in the duration of a polynomial
MAX_ACROSS_SHARE = 0.1  # of the power of e along dq, over the noise, in every direction across it
MAX_PASSES = 20  # each finds the clearest places, one in every two polynomials
MAX_NAMED_PLACES = 3  # in a warning


def without_lost_rows(
    recorded: AbstractMapping[SignalName, Series],
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals on timestamps that count lost rows, and warnings with their number and places.

    Signals on different clocks, as of several topics, are left as they are.

    Args:
        recorded: Signals of one arm, with positions.
    """
    found, position = dict(recorded), recorded["position"]
    time, q = position.time, position.values
    alike = all(np.array_equal(one.time, time) for one in found.values())
    if not alike or time.size < 4 * SIDE_SAMPLES or np.any(np.diff(time) <= 0.0) or not np.isfinite(q).all():
        return found, []
    velocity = recorded["velocity"].values if "velocity" in recorded else None
    stamped = np.diff(time)
    period = float(np.median(stamped))
    taken = stamped.copy()
    for _ in range(MAX_PASSES):
        late, clear = _advances(np.append(0.0, np.cumsum(taken)), q, velocity, period)
        moved = np.where(clear, np.maximum(np.round((taken + late) / period), 1.0) * period, taken)
        if np.array_equal(moved, taken):
            break
        taken = moved
    off = np.round((taken - stamped) / period)
    if not np.any(off):
        return found, []
    moments = time[0] + np.append(0.0, np.cumsum(taken))
    by = "the velocities" if velocity is not None else "the motion before and after"
    remarks = [
        *_remark(off, time, "rows were lost while timestamps went on", f"further than by {by}"),
        *_remark(-off, time, "periods are in the timestamps in which no time passed", f"less than by {by}"),
    ]
    return {name: replace(one, time=moments) for name, one in found.items()}, remarks


def _advances(time: Array, position: Array, velocity: Array | None, period: float) -> tuple[Array, NDArray[np.bool_]]:
    """d after every row [s], and whether it is clear and larger than at the rows about it, ``(k - 1,)`` each."""
    count, middle = time.size - 1, 0.5 * (time[1:] + time[:-1])
    if velocity is None:
        values, order = position, ORDER["positions"]
    else:
        way = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None]
        values, order = position - np.vstack((np.zeros_like(way[:1]), np.cumsum(way, axis=0))), ORDER["integrals"]
    inside = slice(SIDE_SAMPLES - 1, count - SIDE_SAMPLES + 1)  # rows with polynomials on both sides
    at = middle[inside]
    before, speed_before = _extrapolated(time, values, order, at, 0)
    after, speed_after = _extrapolated(time, values, order, at, SIDE_SAMPLES)
    speed = 0.5 * (speed_before + speed_after if velocity is None else (velocity[1:] + velocity[:-1])[inside])
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
    late = np.sum(e * v, axis=1) / information
    along = np.square(late) * information
    across = (np.sum(np.square(e), axis=1) - along) / max(position.shape[1] - 1, 1)
    shown = np.isfinite(late) & (information > (MAX_JITTER_ERROR_PERIODS * period) ** -2)
    jitter = 1.4826 * float(np.median(np.abs(late[shown]))) if np.any(shown) else np.inf
    kink = SIDE_SAMPLES * period * np.linalg.norm((speed_after - speed_before) / scatter, axis=1)
    with np.errstate(invalid="ignore"):
        clear = (along > MIN_ADVANCE_SIGMA**2) & (across < MAX_ACROSS_SHARE * along)
        clear &= np.abs(late) > np.maximum(MIN_ADVANCE_PERIODS * period, MIN_ADVANCE_PER_JITTER * jitter)
        clear &= np.sqrt(along) > MIN_STEP_PER_KINK * kink
    sizes = np.where(clear, along, 0.0)
    about = np.lib.stride_tricks.sliding_window_view(np.pad(sizes, SIDE_SAMPLES), 2 * SIDE_SAMPLES + 1)
    clear &= sizes >= about.max(axis=1)
    found, mask = np.zeros(count), np.zeros(count, dtype=bool)
    found[inside], mask[inside] = np.nan_to_num(late), clear
    return found, mask


def _extrapolated(time: Array, values: Array, order: int, at: Array, first: int) -> tuple[Array, Array]:
    """Values and slopes at moments ``(m,)`` of polynomials through rows from ``first`` on, moving with the moments."""
    rows = np.arange(at.size)[:, None] + first + np.arange(SIDE_SAMPLES)
    t = time[rows] - at[:, None]
    size = np.max(np.abs(t), axis=1, keepdims=True)
    basis = (t / size)[..., None] ** np.arange(order + 1)
    transposed = basis.swapaxes(1, 2)
    fitted = np.linalg.solve(transposed @ basis, transposed @ values[rows])
    return fitted[:, 0], fitted[:, 1] / size


def _remark(rows: Array, time: Array, what: str, how: str) -> list[str]:
    """A warning about rows that were lost, or that took no time, ``(k - 1,)``; empty without such rows."""
    places = np.flatnonzero(rows > 0.5)
    if not places.size:
        return []
    each = [
        remark("t = {:.3f} s ({:d})", float(time[place] - time[0]), int(rows[place]))
        for place in places[:MAX_NAMED_PLACES].tolist()
    ]
    more = remark(" and {:d} more places", places.size - len(each)) if places.size > len(each) else ""
    return [
        remark(
            "{:d} {}: at {}{} all joints move on {}. Times are corrected by as many periods, and a gap that is longer "
            "than the low-pass bridges cuts the recording",
            int(rows[places].sum()), what, joined(", ", each), more, how,
        )
    ]  # fmt: skip
