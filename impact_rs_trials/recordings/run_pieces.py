# SPDX-License-Identifier: Apache-2.0
"""Pieces of a run between gaps, and the even grid of its samples.

Joint signals are on a regular grid with the median period of the joint states, interpolated where stamps are off the
grid. Command and object pose keep their own stamps, because a command is held until the next and the pose is slower.
Gaps split a run into pieces on the same grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags.types import STAMP_ROUNDING_S
from impact_rs_trials.recordings.checks.joint_jumps import impact_time
from impact_rs_trials.recordings.experiment import RunRow
from impact_rs_trials.recordings.laboratory import ArmSeries
from impact_rs_trials.recordings.mapping import REQUIRED, SignalName
from impact_rs_trials.recordings.readers.clock import (
    MAX_GRID_ERROR_PERIODS,
    Gap,
    check_jumps,
    check_stamps,
    even_grid,
    gaps,
    gaps_in_words,
)
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.recording import TooShort
from impact_rs_trials.recordings.remarks import remark

ARM_SIGNALS: tuple[SignalName, ...] = (*REQUIRED, "motor_position", "motor_velocity")
MIN_RUN_SAMPLES = 20
MIN_PIECE_S = 0.3  # of a piece between gaps
MIN_GAP_PERIODS = 3.0  # a gap is longer than so many sampling periods, and
MIN_REPORTED_GAP_S = 0.005  # longer than this; a shorter one fits into the window of the velocity fit at an impact
MAX_INTERPOLATED_GAP_S = 0.010  # longer gaps separate two pieces
MIN_CLOCK_JUMP_S = 0.1  # a longer step is a jump of the clock
MAX_JITTER_PERIODS = 0.2  # of timestamps about the regular grid, without a warning
MIN_JOINT_RATE_HZ = 200.0  # without a warning
MIN_POSE_RATE_HZ = 60.0  # without a warning
BEYOND_S = 0.1  # of command and pose that are kept before and after the joint signals


def check_signal(path: Path, name: SignalName, series: Series) -> None:
    """Check that stamps increase without a jump, and that numbers are finite."""
    if name in REQUIRED and series.time.size < MIN_RUN_SAMPLES:
        raise TooShort(f"{series.label}: {series.time.size} samples, at least {MIN_RUN_SAMPLES} are needed", file=path)
    check_stamps(path, series.label, series.time)
    if series.time.size > 1:
        largest = max(MIN_CLOCK_JUMP_S, 5.0 * float(np.median(np.diff(series.time))))
        check_jumps(path, series.label, series.time, series.log, largest, pauses=name in (*ARM_SIGNALS, "command"))
    not_finite = ~np.isfinite(series.values)
    if np.any(not_finite):
        row, column = np.argwhere(not_finite)[0]
        raise InputError(
            f"{series.label}: number {column + 1} is {series.values[row, column]} at t = "
            f"{series.time[row] - series.time[0]:.3f} s ({int(np.sum(not_finite.any(axis=1)))} of "
            f"{not_finite.shape[0]} samples); repair the file, or take the run out of the table",
            file=path,
        )


def check_overlap(path: Path, base: Series, series: ArmSeries) -> None:
    """Check that every signal overlaps with the joint positions ``base`` in time."""
    for signal in series.values():
        if signal.time[-1] < base.time[0] or signal.time[0] > base.time[-1]:
            raise InputError(
                f"{signal.label} spans {signal.time[0]:.3f} ... {signal.time[-1]:.3f} s, {base.label} "
                f"{base.time[0]:.3f} ... {base.time[-1]:.3f} s: another clock, or another run? In the "
                "mapping signals.NAME.delay shifts a signal, and clock: own finds the offset from the motion",
                file=path,
            )


def usable_pieces(
    run: RunRow, arms: Mapping[str, ArmSeries], pose: Series | None, remarks: list[str]
) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Pieces between gaps that are long enough, in order, and the main piece.

    The main piece is the longest piece. In a hit it is the piece with the impact, and no later piece is used.
    """
    start = max(float(series["position"].time[0]) for series in arms.values())
    end = min(float(series["position"].time[-1]) for series in arms.values())
    cuts: list[Gap] = []
    signals = [series.get(name) for series in arms.values() for name in (*ARM_SIGNALS, "command")]
    checked_times: list[Array] = []  # stamps that several signals share are checked once
    for signal in (*signals, pose):
        if signal is None or signal.time.size < 2 or any(np.array_equal(signal.time, time) for time in checked_times):
            continue
        checked_times.append(signal.time)
        periods = MIN_GAP_PERIODS * float(np.median(np.diff(signal.time)))
        signal_gaps = gaps(signal.time, max(MIN_REPORTED_GAP_S, periods))
        if not signal_gaps:
            continue
        remarks.append(
            f"{signal.label}: {'gaps' if len(signal_gaps) > 1 else 'a gap'} of {gaps_in_words(signal_gaps, start)}"
        )
        if signal is not pose:
            cuts += [
                gap
                for gap in signal_gaps
                if gap.length > MAX_INTERPOLATED_GAP_S and gap.end > start and gap.start < end
            ]
    if end - start < MIN_PIECE_S:
        raise TooShort(f"it lasts {end - start:.3f} s, at least {MIN_PIECE_S} s are needed", file=run.path)
    for series in arms.values():
        for time in (series["velocity"].time, series["torque"].time):  # missing samples at either end are a gap as well
            end_gaps = [Gap(start, float(time[0]) - start), Gap(float(time[-1]), end - float(time[-1]))]
            cuts += [gap for gap in end_gaps if gap.length > MAX_INTERPOLATED_GAP_S]
    impacts = [impact_time(series["position"], series["velocity"]) for series in arms.values()] if run.hit else []
    if any(not start <= impact <= end for impact in impacts):
        raise TooShort("the joint positions do not reach to the impact", file=run.path)
    if not cuts:
        return [(start, end)], (start, end)
    inside = [gap for gap in cuts if impacts and gap.start <= max(impacts) and min(impacts) <= gap.end]
    if inside:
        longest = max(inside, key=lambda gap: gap.length)
        raise TooShort(f"the impact falls into a gap of {gaps_in_words([longest], start)}", file=run.path)
    first = [start, *sorted(gap.end for gap in cuts)]
    last = [*sorted(gap.start for gap in cuts), end]
    between = [(a, b) for a, b in zip(first, last, strict=True) if b > a]
    if not between:
        raise TooShort("velocity and torque were never recorded at the same time", file=run.path)
    pieces = [piece for piece in between if piece[1] - piece[0] >= MIN_PIECE_S]
    main = max([p for p in between if all(p[0] <= impact <= p[1] for impact in impacts)], key=_length)
    if impacts:
        pieces = [piece for piece in pieces if piece[0] <= max(impacts)]
    if main not in pieces:
        with_impact = "with the impact " if run.hit else ""
        raise TooShort(
            f"gaps leave {_length(main):.3f} s {with_impact}in one piece, at least {MIN_PIECE_S} s are needed: gaps of "
            f"{gaps_in_words(sorted(cuts, key=lambda gap: gap.start), start)}",
            file=run.path,
        )
    remarks.append(f"cut to {_intervals(pieces, start)}, because of gaps > {MAX_INTERPOLATED_GAP_S:g} s")
    short = [piece for piece in between if _length(piece) < MIN_PIECE_S]
    after_impact = [piece for piece in between if piece not in pieces and piece not in short]
    if short:
        remarks.append(f"skipped, because it is shorter than {MIN_PIECE_S} s: {_intervals(short, start)}")
    if after_impact:
        remarks.append(f"skipped, because it comes after the impact and a gap: {_intervals(after_impact, start)}")
    return pieces, main


def _length(piece: tuple[float, float]) -> float:
    return piece[1] - piece[0]


def _intervals(pieces: list[tuple[float, float]], start: float) -> str:
    return ", ".join(f"{first - start:.3f} ... {last - start:.3f} s" for first, last in pieces)


def inside_pieces(time: Array, pieces: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Which stamps lie in one of the pieces, ``(k,)``."""
    return np.any([(time >= first) & (time <= last) for first, last in pieces], axis=0)


def on_grid(series: Series, grid: Array) -> Array:
    """One signal of the arm on the even grid, ``(k, n)``: samples where they lie on it, interpolated elsewhere."""
    nearest = np.clip(np.searchsorted(series.time, grid), 1, series.time.size - 1)
    nearest -= grid - series.time[nearest - 1] < series.time[nearest] - grid
    close = np.abs(series.time[nearest] - grid) < MAX_GRID_ERROR_PERIODS * (grid[1] - grid[0])
    return np.where(close[:, None], series.values[nearest], series.at(grid))


def around_grid(series: Series | None, grid: Array, none: Array) -> tuple[Array, Array]:
    """Stamps from the start of the grid, ``(p,)`` [s], and numbers of a signal around it, ``(p, c)``.

    A sample on the grid up to rounding gets exactly the time of the grid.
    """
    if series is None:
        return np.zeros(0), none
    inside = (series.time >= grid[0] - BEYOND_S) & (series.time <= grid[-1] + BEYOND_S)
    period = grid[1] - grid[0]
    nearest = grid[0] + period * np.rint((series.time[inside] - grid[0]) / period)
    time = np.where(np.abs(series.time[inside] - nearest) < STAMP_ROUNDING_S, nearest, series.time[inside])
    return time - grid[0], series.values[inside]


def warn_of_rates(
    position: Series,
    grid: Array,
    pieces: Sequence[tuple[float, float]],
    main: tuple[float, float] | None,
    remarks: list[str],
) -> None:
    """Warn of uneven stamps of joints, and of a rate too low for contact forces.

    Args:
        position: Joint positions of one arm.
        grid: Grid of the run, ``(k,)`` [s].
        pieces: Used pieces.
        main: Main piece, for an arm whose stamps did not make the grid; None: they did.
        remarks: Warnings, appended to.
    """
    raw = position.time[inside_pieces(position.time, pieces)]
    period = float(grid[1] - grid[0])
    if main is not None:
        arm_grid = even_grid(position.time[inside_pieces(position.time, [main])])
        period = max(period, float(arm_grid[1] - arm_grid[0]))
    deviation = np.abs(raw - grid[0] - period * np.rint((raw - grid[0]) / period)) / period
    worst = float(np.percentile(deviation, 99.0))
    if worst > MAX_JITTER_PERIODS:
        words = "{}: stamps deviate by up to {:.0f} % of a period from an even grid; samples are interpolated onto it"
        remarks.append(remark(words, position.label, 100.0 * worst))
    if 1.0 / period < MIN_JOINT_RATE_HZ:
        words = "joints at {:.0f} Hz: the jump of an impact is seen, its force is not"
        remarks.append(remark(words, 1.0 / period))


def warn_of_pose_rate(pose: Series | None, remarks: list[str]) -> None:
    """Warn of a tracker too slow for velocities right after an impact."""
    if pose is not None and pose.time.size > 1:
        rate = 1.0 / float(np.median(np.diff(pose.time)))
        if rate < MIN_POSE_RATE_HZ:
            words = (
                "object pose at {:.0f} Hz: where the object goes is seen, its velocity right after the impact is not"
            )
            remarks.append(remark(words, rate))
