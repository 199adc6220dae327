# SPDX-License-Identifier: Apache-2.0
"""Time of an arm's impact, and the jump of its joint velocities (change-point detection in recorded positions).

Joint positions are continuous and their velocities jump. With T the time of the impact, every joint obeys

    q(t) = q_0 + dq_minus (t - T) + c_minus (t - T)^2 / 2                                         t <= T
    q(t) = q_0 + dq_plus  (t - T) + c_plus  (t - T)^2 / 2                                         t >  T

in a window about it, linear except for T. A recorded velocity is often low-passed and jumps some 10 ms later; the
reading of an encoder is not. So the jump dq_plus - dq_minus is fitted at every time of the run; the largest jump beyond
its noise is the impact. T maximises the likelihood of the residuals r of all joints, each with a different scatter,

    T = argmin sum_j log sum_k r_jk(T)^2,      sigma_T^-2 = sum_j |(1 - B B^+) dq_j/dT|^2 / sigma_j^2

with B the columns of the linear parameters and sigma_j the scatter of joint j. The noise of a jump includes the error
of T. Arms vibrate after an impact, and a vibration may change velocities more than the impact did. So T is sought at
the largest ratio of the jump to the scatter of the motion before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.readers.series import Series

Rows = NDArray[np.signedinteger]

VELOCITY_CHANGE_S = 0.004  # on either side, over which a recorded velocity changes
PARABOLA_S = 0.04  # on either side, in which joint motion is a parabola,
MIN_WINDOW_SAMPLES = 6  # on either side
SEARCH_STEP_S = 0.002  # between the times at which a jump is sought
MAX_WINDOW_RATIO = 3.0  # of a window with a gap to one without
SEARCH_HALF_WIDTH_S = 0.006  # about the seed, in which the impact is sought at once
SEARCHED_TIMES = 25  # in that stretch
MAX_STRETCH_MOVES = 5  # while the best time lies at the edge of the stretch
MIN_JUMP_SIGMA = 4.0  # standard deviations of a velocity jump, rms over the joints
MIN_JUMP_SHARE = 0.3  # of the largest jump of velocities, of joints and object alike; smaller ones are no impacts
WINDOWS_PER_FIT = 1000  # fitted at once
FITTED_PARAMETERS = 5  # of a window and joint
MIN_SCATTER_RAD = 1e-12
JUMP_OF_PARAMETERS = np.array([0.0, -1.0, 1.0, 0.0, 0.0])  # velocity after less velocity before


@dataclass(frozen=True)
class JointJump:
    """Joint motion about an impact.

    Attributes:
        time: T [s].
        time_error: Its standard deviation [s].
        position: q_0, ``(n,)`` [rad].
        before: dq_minus, ``(n,)`` [rad/s].
        after: dq_plus, ``(n,)`` [rad/s].
        noise: Standard deviation of the jump of every joint, ``(n,)`` [rad/s].
    """

    time: float
    time_error: float
    position: Array
    before: Array
    after: Array
    noise: Array

    @property
    def clear(self) -> bool:
        """Whether the velocities jump beyond their noise."""
        return bool(np.mean(np.square((self.after - self.before) / self.noise)) > MIN_JUMP_SIGMA**2)


def impact_time(position: Series, velocity: Series) -> float:
    """Time of an arm's impact: at the largest jump of dq/dt, or else at the largest change of the recorded velocity.

    Args:
        position: q, ``(k, n)`` [rad].
        velocity: dq as recorded, ``(m, n)`` [rad/s].
    """
    jump = next(jumps_of(position), None)
    if jump is not None:
        return jump.time
    change = np.linalg.norm(
        velocity.at(velocity.time + VELOCITY_CHANGE_S) - velocity.at(velocity.time - VELOCITY_CHANGE_S), axis=1
    )
    return float(velocity.time[int(np.argmax(change))])


def jumps_of(position: Series, least: float = 0.0) -> Iterator[JointJump]:
    """Jumps of joint velocities beyond their noise in a run, the largest first.

    Args:
        position: q, ``(k, n)`` [rad].
        least: Smallest size of a further jump over the largest one [-].
    """
    usable = np.isfinite(position.values).all(axis=1) & (np.diff(position.time, prepend=-np.inf) > 0.0)
    position = replace(position, time=position.time[usable], values=position.values[usable])
    half, times, sizes, onset = _sizes(position)
    min_size = least * float(np.max(sizes, initial=0.0))
    jumps: list[JointJump] = []
    while sizes.size and float(np.max(sizes)) > min_size:
        nearby = np.abs(times - times[int(np.argmax(sizes))]) <= half
        jump = joint_jump(position, float(times[int(np.argmax(np.where(nearby, onset, -1.0)))]))
        if jump is not None and jump.clear and all(abs(jump.time - earlier.time) > half for earlier in jumps):
            jumps.append(jump)
            yield jump
        sizes = np.where(nearby, 0.0, sizes)


def joint_jump(position: Series, near: float) -> JointJump | None:
    """Joint motion about an impact near a time; None: too few samples, or no likelihood maximum near it.

    Args:
        position: q, ``(k, n)`` [rad].
        near: The time [s].
    """
    period = float(np.median(np.diff(position.time)))
    half, reach = _half(period), max(SEARCH_HALF_WIDTH_S, 2.0 * period)
    for _ in range(MAX_STRETCH_MOVES):
        rows = np.abs(position.time - near) <= half + reach
        time, values = position.time[rows], position.values[rows]
        if time.size < 2 * MIN_WINDOW_SAMPLES or near - time[0] < half / 2.0 or time[-1] - near < half / 2.0:
            return None

        def misfit(shift: float, at: Array = time - near, values: Array = values) -> float:
            mean_square = np.mean(np.square(_broken(at, values, shift)[1]), axis=0)
            return float(np.sum(np.log(mean_square + MIN_SCATTER_RAD**2)))

        shifts = np.linspace(-reach, reach, SEARCHED_TIMES)
        best = int(np.argmin([misfit(float(shift)) for shift in shifts]))
        if 0 < best < SEARCHED_TIMES - 1:
            minimum = scipy.optimize.minimize_scalar(
                misfit, bounds=(shifts[best - 1], shifts[best + 1]), method="bounded", options={"xatol": 1e-6}
            )
            return _at(time, values, near + float(minimum.x), half)
        near += float(shifts[best])
    return None


def jump_at(position: Series, impact: float, error: float) -> JointJump | None:
    """Joint motion about an impact with a known time; None: too few samples.

    Args:
        position: q, ``(k, n)`` [rad].
        impact: T [s].
        error: Its standard deviation [s].
    """
    half = _half(float(np.median(np.diff(position.time))))
    near = np.abs(position.time - impact) <= half
    sides = [np.count_nonzero(near & side) for side in (position.time <= impact, position.time > impact)]
    if min(sides) < MIN_WINDOW_SAMPLES - 1:
        return None
    return _at(position.time, position.values, impact, half, error)


def _at(time: Array, values: Array, impact: float, half: float, error: float | None = None) -> JointJump:
    """Fit and standard deviations at the time of the impact; ``error`` [s]: of a known time, None: a fitted time."""
    inside = np.abs(time - impact) <= half
    t = time[inside] - impact
    coefficients, residual = _broken(time[inside], values[inside], impact)
    basis = _basis(t)
    inverse = np.linalg.pinv(basis)
    scatter = np.maximum(np.sqrt(np.sum(residual**2, axis=0) / max(t.size - FITTED_PARAMETERS - 1, 1)), MIN_SCATTER_RAD)
    before, after = (coefficients[side] + np.outer(t, coefficients[side + 2]) for side in (1, 2))  # dq/dt
    sensitivity = -np.where(t[:, None] <= 0.0, before, after)  # dq/dT
    information = float(np.sum(np.square((sensitivity - basis @ (inverse @ sensitivity)) / scatter)))
    time_error = min(1.0 / np.sqrt(max(information, MIN_SCATTER_RAD)), half) if error is None else error
    noise = np.hypot(
        scatter * np.linalg.norm(JUMP_OF_PARAMETERS @ inverse),
        np.abs(JUMP_OF_PARAMETERS @ inverse @ sensitivity) * time_error,
    )
    return JointJump(impact, float(time_error), coefficients[0], coefficients[1], coefficients[2], noise)


def _sizes(position: Series) -> tuple[float, Array, Array, Array]:
    """Half a window [s]; times ``(p,)`` [s], norms of the jumps [rad/s]; mean squared ratio to scatter before."""
    time, values = position.time, position.values
    period = float(np.median(np.diff(time))) if time.size > 1 else 1.0
    half = _half(period)
    side = round(half / period)
    middles = np.arange(side, time.size - side, max(1, round(SEARCH_STEP_S / period)))
    middles = middles[time[middles + side] - time[middles - side] <= MAX_WINDOW_RATIO * 2.0 * half]
    if not middles.size:
        return half, np.zeros(0), np.zeros(0), np.zeros(0)
    fits = [_windows(time, values, part, side) for part in np.array_split(middles, 1 + middles.size // WINDOWS_PER_FIT)]
    jump, scatter, before, gain = (np.concatenate(parts) for parts in zip(*fits, strict=True))
    steps = np.abs(np.diff(values, n=2, axis=0))
    rounding = np.min(np.where(steps > 0.0, steps, np.inf), axis=0) / np.sqrt(12.0)  # an encoder rounds
    usual_scatter = np.maximum(
        np.maximum(np.median(scatter, axis=0), np.where(np.isfinite(rounding), rounding, 0.0)), MIN_SCATTER_RAD
    )
    noise = gain[:, None] * np.maximum(scatter, usual_scatter)
    onset = np.mean(np.square(jump / gain[:, None] / np.maximum(before, usual_scatter)), axis=1)
    clear = np.mean(np.square(jump / noise), axis=1) > MIN_JUMP_SIGMA**2
    return half, time[middles], np.where(clear, np.linalg.norm(jump, axis=1), 0.0), onset


def _windows(time: Array, values: Array, middles: Rows, side: int) -> tuple[Array, Array, Array, Array]:
    """Jumps in windows about rows ``middles``.

    Returns:
        Jumps ``(p, n)`` [rad/s]; scatter in the window, and before its middle, ``(p, n)`` [rad]; noise of the jump over
        scatter, ``(p,)`` [1/s].
    """
    rows = middles[:, None] + np.arange(-side, side + 1)
    t = time[rows] - time[middles][:, None]
    size = np.max(np.abs(t), axis=1)
    basis = _basis(t / size[:, None])
    inverse = np.linalg.pinv(basis)
    relative = values[rows] - values[middles][:, None]
    coefficients = inverse @ relative
    variance = np.sum(np.square(relative - basis @ coefficients), axis=1) / max(rows.shape[1] - FITTED_PARAMETERS, 1)
    early_basis = basis[:, : side + 1][:, :, [0, 1, 3]]
    early_values = relative[:, : side + 1]
    early_residuals = early_values - early_basis @ (np.linalg.pinv(early_basis) @ early_values)
    early_variance = np.sum(np.square(early_residuals), axis=1) / max(side - 2, 1)
    gain = np.linalg.norm(JUMP_OF_PARAMETERS @ inverse, axis=1) / size
    return JUMP_OF_PARAMETERS @ coefficients / size[:, None], np.sqrt(variance), np.sqrt(early_variance), gain


def _half(period: float) -> float:
    return max(PARABOLA_S, MIN_WINDOW_SAMPLES * period)


def _basis(t: Array) -> Array:
    """Two parabolas that meet at 0, ``(..., k, 5)``."""
    before, after = np.minimum(t, 0.0), np.maximum(t, 0.0)
    return np.stack((np.ones_like(t), before, after, 0.5 * before**2, 0.5 * after**2), axis=-1)


def _broken(time: Array, values: Array, impact: float) -> tuple[Array, Array]:
    """Coefficients of two parabolas that meet at the impact, ``(5, n)``, and residuals."""
    basis = _basis(time - impact)
    coefficients = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0], dtype=float)
    return coefficients, values - basis @ coefficients
