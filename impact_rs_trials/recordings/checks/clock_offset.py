# SPDX-License-Identifier: Apache-2.0
"""Clocks that differ by a constant: the offset of a stream by cross-correlation of the motion that two streams share.

A stream with timestamps of another clock (``clock: own`` in the mapping) is shifted to fit the joint positions q(t)
best, which predict it: dq/dt its velocities, q its motor positions, g(q) the gravity part of its torques. The offset d
maximises the correlation of prediction x and stream y over their overlap,

    c(d) = sum_j |sum_t x_j(t) y_j(t - d)| / sqrt(sum_jt x_j(t)^2 sum_jt y_j(t - d)^2),

where every column j is centred and divided by its norm; around the maximum y = a x + b is fitted to every column by
least squares. Objects do not move with the joints: in a hit the object starts to move when the joint velocities jump.

The standard error follows from least squares with residuals r, sigma_d^-2 = sum (a dx/dt)^2 / mean r^2 over samples and
columns. It assumes independent residuals: friction, which lasts, makes it too small for torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.joint_jumps import JointJump, jumps_of
from impact_rs_trials.recordings.checks.plausibility import gravity_torques
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.relations import cross_correlation, fit
from impact_rs_trials.recordings.remarks import remark

FOUND_BY: dict[SignalName, str] = {
    "velocity": "the derivative of the positions",
    "motor_position": "the positions",
    "motor_velocity": "the derivative of the positions",
    "torque": "the gravity torque at the positions",
    "command": "the gravity torque at the positions",
}
OBJECT_SIGNALS: tuple[SignalName, ...] = ("object_pose", "object_position", "object_quaternion")
MAX_START_DIFFERENCE = (0.010, 1.5)  # s, and periods of the pose, between the impact and the start of the object
MAX_START_SIGMA = 5.0  # standard deviations between them
MIN_OVERLAP_SHARE = 0.5  # of the shorter stream
MIN_LAG_CORRELATION = 0.7  # from which an offset is accepted
MIN_PEAK_DROP = 0.05  # from the highest to the second peak of the correlation; less is ambiguous
MAX_GRID_SAMPLES = 200_000  # of the common grid
REFINED_SAMPLES = 3.0  # of the grid about the largest correlation, in which the offset is fitted
MIN_TRACKER_NOISE_M = 5e-5  # no tracker resolves less
MIN_MOTION_SIGMA = 5.0  # standard deviations of the noise, beyond which an object moves
MIN_MOVING_SAMPLES = 4  # in a row
MIN_REST_SAMPLES = 5  # before the start
FITTED_SAMPLES = 12  # after the start


def on_one_clock(
    path: Path, series: dict[SignalName, Series], mapping: Mapping, model: RobotModel
) -> dict[SignalName, Series]:
    """Joint signals on the clock of the positions, with a warning about every shift.

    Args:
        path: File, for messages.
        series: Signals with the timestamps of their files.
        mapping: Names the signals with another clock.
        model: Nominal arm, for its gravity torque.

    Raises:
        InputError: The motion does not determine an offset.
    """
    on_clock = dict(series)
    for name, signal in series.items():
        if name in mapping.signals and mapping.signals[name].clock == "own" and name in FOUND_BY:
            expected = _expected(name, series["position"], model)
            offset, error = offset_between(expected, signal, path, f"signals.{name}.clock")
            on_clock[name] = shifted(signal, offset, error, FOUND_BY[name])
    return on_clock


def shifted_to_impact(path: Path, pose: Series, position: Series, key: str) -> Series:
    """The pose of an object on the clock of the joints: it starts to move at the impact.

    Args:
        path: File, for messages.
        pose: Position first, with the timestamps of its file.
        position: q, ``(m, n)``, whose velocities jump in the impact.
        key: Key of the mapping, for messages.

    Raises:
        InputError: The object does not start to move, or the arm hits nothing.
    """
    jump = next(jumps_of(position), None)
    if jump is None:
        raise InputError(
            "no jump of the joint velocities exceeds their noise, so the time of the impact is unknown: set "
            f"{_delay_of(key)} and remove clock", file=path, key=key, value="own",
        )  # fmt: skip
    start, error = start_of_motion(pose, path, key)
    error = float(np.hypot(error, jump.time_error))
    return shifted(pose, jump.time - start, error, "the start of the object in the impact")


def start_of_motion(pose: Series, path: Path, key: str) -> tuple[float, float]:
    """Time at which an object that rests at first starts to move, and its standard error [s].

    s = v (t - t_0) - a (t - t_0)^2 / 2 is fitted to the displacement s along the motion in the first samples beyond the
    noise. t_0 is the last root of the parabola between the last sample at rest and the second sample in motion. The
    error is at most a period of the pose.

    Args:
        pose: Position first, ``(k, 3 or more)``.
        path: File, for messages.
        key: Key of the mapping, for messages.

    Raises:
        InputError: The object does not rest at first, or never moves.
    """
    position = pose.values[:, :3]
    initial = position[: max(MIN_REST_SAMPLES, position.shape[0] // 20)]
    noise = _scatter_about_a_line(initial) + MIN_TRACKER_NOISE_M
    clear = np.linalg.norm(position - np.median(initial, axis=0), axis=1) > MIN_MOTION_SIGMA * noise
    steady = clear.copy()
    for later in range(1, MIN_MOVING_SAMPLES):
        steady[:-later] &= clear[later:]
        steady[-later:] = False
    first = int(np.argmax(steady))
    if not steady.any() or first < MIN_REST_SAMPLES:
        raise InputError(
            "the object does not rest at first and move later, so its motion does not determine the offset of its "
            f"clock: set {_delay_of(key)} and remove clock", file=path, key=key, value="own",
        )  # fmt: skip
    rest_position = np.median(position[max(0, first - 5 * MIN_REST_SAMPLES) : first - 1], axis=0)
    rows = slice(first, first + FITTED_SAMPLES)
    time, displacement = pose.time[rows], position[rows] - rest_position
    direction = displacement[-1] / np.linalg.norm(displacement[-1])
    t, s = time - time[0], displacement @ direction
    design = np.column_stack((np.ones_like(t), t, t**2))
    parabola, covariance = np.linalg.lstsq(design, s, rcond=None)[0], np.linalg.inv(design.T @ design)
    roots = np.roots(parabola[::-1])
    real = roots[np.isreal(roots)].real
    candidates = real[real < t[1]]
    start = float(candidates.max()) if candidates.size else -float(parabola[0] / parabola[1])
    start = float(np.clip(start, pose.time[first - 2] - time[0], t[1]))
    powers = np.array([1.0, start, start**2])
    speed = abs(float(parabola[1] + 2.0 * parabola[2] * start))
    scatter = max(float(np.sqrt(np.sum(np.square(s - design @ parabola)) / max(len(s) - 3, 1))), noise)
    error = scatter * float(np.sqrt(powers @ covariance @ powers)) / max(speed, 1e-9)
    return float(time[0] + start), min(error, float(t[1]))


def _delay_of(key: str) -> str:
    """Key of the delay of a signal, from the key of its clock."""
    return f"{key.rpartition('.')[0]}.delay"


def _scatter_about_a_line(position: Array) -> float:
    """Standard deviation per axis of places ``(k, 3)`` about a constant velocity [m]."""
    sample = np.arange(len(position), dtype=float)
    residuals = np.polyfit(sample, position, 1, full=True)[1]
    return float(np.sqrt(np.sum(residuals) / (position.shape[1] * max(len(position) - 2, 1))))


@dataclass(frozen=True)
class ClocksApart:
    """An object that does not move from rest when an arm hits it.

    Attributes:
        offset: Start of the object minus impact of the arm; or first timestamp of the object minus that of the arm [s].
        error: Its standard deviation [s]; None: the timestamps do not overlap.
    """

    offset: float
    error: float | None

    @property
    def evidence(self) -> str:
        """Evidence in words."""
        if self.error is None:
            return (
                f"the stamps of the object begin {self.offset:+.6g} s after those of the joints, and have no time in "
                "common with them"
            )
        return (
            f"the object starts to move {1e3 * abs(self.offset):.1f} ms (+- {1e3 * self.error:.1g} ms) "
            f"{'after' if self.offset > 0.0 else 'before'} the joint velocities jump"
        )

    def in_words(self, mapping: Mapping) -> str:
        """Evidence and remedy."""
        keys = " and ".join(f"signals.{name}.clock: own" for name in OBJECT_SIGNALS if name in mapping.signals)
        return f"{self.evidence}: another clock? Remedy in the mapping: {keys}"


def clocks_apart(pose: Series, position: Series, jumps: Sequence[JointJump], path: Path) -> ClocksApart | None:
    """Offset between the clocks of object and joints; None: no evidence of an offset.

    Args:
        pose: Position of the object first, ``(k, 3 or more)``.
        position: q, ``(m, n)``.
        jumps: Jumps of its velocities.
        path: File, for messages.
    """
    if pose.time[0] > position.time[-1] or pose.time[-1] < position.time[0]:
        return ClocksApart(float(pose.time[0] - position.time[0]), None)
    try:
        start, error = start_of_motion(pose, path, "")
    except InputError:
        return None
    nearest = min(jumps, key=lambda jump: abs(start - jump.time), default=None)
    if nearest is None:
        return None
    offset, offset_error = start - nearest.time, float(np.hypot(error, nearest.time_error))
    allowed = max(
        MAX_START_DIFFERENCE[0],
        MAX_START_DIFFERENCE[1] * float(np.median(np.diff(pose.time))),
        MAX_START_SIGMA * offset_error,
    )
    return ClocksApart(float(offset), offset_error) if abs(offset) > allowed else None


def shifted(series: Series, offset: float, error: float, found_by: str) -> Series:
    """A signal with its timestamps shifted by an offset [s], and a warning about it."""
    words = "{}: on another clock; stamps moved by {:+.6g} s (+- {:.2g} ms), by {}"
    warning = remark(words, series.label, offset, 1e3 * error, found_by)
    return replace(series, time=series.time + offset, remarks=(*series.remarks, warning))


def offset_between(expected: Series, measured: Series, path: Path, key: str) -> tuple[float, float]:
    """Offset added to the timestamps of ``measured`` for the best fit to ``expected``, and its standard error [s].

    Args:
        expected: Predicted signal, up to a factor and an offset of every column.
        measured: Measured signal, with as many columns.
        path: File, for messages.
        key: Key of the mapping, for messages.

    Raises:
        InputError: No offset, or several, fit.
    """
    period = max(float(np.median(np.diff(series.time))) for series in (expected, measured)) / 2.0
    first, second = (_evenly(series, period) for series in (expected, measured))
    if max(len(first), len(second)) > MAX_GRID_SAMPLES:
        raise InputError(f"streams of more than {MAX_GRID_SAMPLES} samples; cut them first", file=path, key=key)
    correlation, lags, overlap = cross_correlation(first, second)
    allowed = overlap >= MIN_OVERLAP_SHARE * min(len(first), len(second))
    correlation = np.where(allowed, correlation, 0.0)
    best = int(np.argmax(correlation))
    width = _peak_width(correlation, best)
    off_peak = np.abs(np.arange(correlation.size) - best) > width
    second_peak = float(np.max(correlation[off_peak], initial=0.0))
    if correlation[best] < MIN_LAG_CORRELATION or second_peak > correlation[best] - MIN_PEAK_DROP:
        raise InputError(
            f"the motion does not determine the offset of this clock (correlation {correlation[best]:.2f}, elsewhere "
            f"{second_peak:.2f}; expected at least {MIN_LAG_CORRELATION} at one lag): set {_delay_of(key)} and remove "
            "clock",
            file=path,
            key=key,
            value="own",
        )
    initial_offset = float(expected.time[0] - measured.time[0] + lags[best] * period)
    minimum = scipy.optimize.minimize_scalar(
        lambda offset: misfit(expected, measured, offset)[0],
        bounds=(initial_offset - REFINED_SAMPLES * period, initial_offset + REFINED_SAMPLES * period),
        method="bounded",
        options={"xatol": 1e-7},
    )
    return float(minimum.x), misfit(expected, measured, float(minimum.x))[1]


def misfit(expected: Series, measured: Series, offset: float) -> tuple[float, float]:
    """1 - R^2 of a linear fit per column, averaged, and the standard error of the clock offset [s].

    Args:
        expected: Predicted signal, up to a factor and an offset of every column.
        measured: Measured signal, with as many columns.
        offset: Added to the timestamps of ``measured`` [s].
    """
    time = measured.time + offset
    rows = (time >= expected.time[0]) & (time <= expected.time[-1])
    x, y = expected.at(time[rows]), measured.values[rows]
    derivative = np.gradient(x, time[rows], axis=0)
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    line = fit(x, y)
    slope, mean_square = line.factor, line.misfit / len(y)
    changing = np.ptp(y, axis=0) > 0.0
    unexplained = mean_square[changing] / np.maximum(np.var(y[:, changing], axis=0), 1e-300)
    information = np.sum(np.square(slope * derivative), axis=0)[changing] / np.maximum(mean_square[changing], 1e-300)
    return float(np.mean(unexplained)), float(1.0 / np.sqrt(max(float(np.sum(information)), 1e-300)))


def _expected(name: SignalName, position: Series, model: RobotModel) -> Series:
    """Prediction of a signal by the positions."""
    if name == "motor_position":
        return position
    if name in ("velocity", "motor_velocity"):
        return replace(position, values=np.gradient(position.values, position.time, axis=0))
    return replace(position, values=gravity_torques(model, position.values))


def _evenly(series: Series, period: float) -> Array:
    """Columns on an even grid, centred, ``(m, c)``."""
    grid = np.arange(series.time[0], series.time[-1], period)
    values = series.at(grid)
    return np.asarray(values - values.mean(axis=0))


def _peak_width(correlation: Array, best: int) -> int:
    """Half width of the peak: samples until the correlation has fallen to half on either side."""
    below = np.flatnonzero(correlation < 0.5 * correlation[best])
    left, right = below[below < best], below[below > best]
    return int(max(best - left[-1] if left.size else best, right[0] - best if right.size else correlation.size - best))
