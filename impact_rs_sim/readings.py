# SPDX-License-Identifier: Apache-2.0
"""Sensor models: readings from true signals, and the initial state of a motion from its readings.

A prediction passes forward through the sensor models; the measured start of a replay is corrected by their inverse:

    position    q_r   = s q + o                                             encoder of the link
    motor       th_r  = theta + o_m                                         encoder of the motor
    velocity    v_r   = H s s_v dq(t - d)                                   filters and delay
    torque      tau_r = H (G tau_J)(t - d) + o + r age                      G: gains, and crosstalk of neighbours
    object      p_r   = R(yaw) (p + R_obj c) + t                            frame of the tracker, and tracked point

    H = 1 / (1 + T1 s) / (1 + T2 s + (T2 s)^2 / 2)        low-pass of first order, and Butterworth filter of second

with T2 = sqrt(2) / (2 pi f) and the cut-off f. T1, T2 and d are delays at low frequencies: both denominators agree with
the series of exp(T s) to their order.

Filters act on predictions, which have no noise. For a measured start they are inverted to second order, with slope and
curvature of the reading (exact for a parabola; torques to first order):

    x(t) = x_r + L dx_r/dt + C d2x_r/dt2,       L = T1 + T2 + d,       C = (T2 + d)^2 / 2 + T1 (T2 + d)
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_sim.robots.robot import Array

Values = Array | float  # per joint, ``(n,)``, or one number for all joints
Lags = tuple[float, float]  # T1 and T2 [s]
Start = tuple[Array, Array]  # a value and its slope
# For real signals 1 / (1 + T s + (T s)^2 / 2) is the real part of (1 - i) / (1 + c T s), with c = (1 + i) / 2.
COMPLEX_LAG = 0.5 + 0.5j


@dataclass(frozen=True)
class ArmReadings:
    """Sensor models of one arm.

    Attributes:
        position_scale: s of the link encoders, also of velocities, which are derived from them [-].
        position_offset: o of the link encoders [rad].
        motor_offset: o_m of the motor encoders [rad].
        velocity_gain: s_v [-].
        velocity_lag: T1 of the filter of velocities [s].
        velocity_butterworth: T2 of the filter of velocities [s].
        velocity_delay: d of velocities [s].
        torque_gain: Diagonal of G [-].
        torque_from_previous: Share of the torque of the previous joint in a reading; 0 for the first joint [-].
        torque_from_next: Share of the torque of the next joint in a reading; 0 for the last joint [-].
        torque_offset: o of the torque sensors [N m].
        torque_drift: r, growth of the offset with the age of a run in its campaign [N m/s].
        torque_lag: T1 of the filter of torques [s].
        torque_butterworth: T2 of the filter of torques [s].
        torque_delay: d of torques after positions [s].
        command_delay: Time from the stamp of a command until it acts [s]; below 0 it acts before.
    """

    position_scale: Values = 1.0
    position_offset: Values = 0.0
    motor_offset: Values = 0.0
    velocity_gain: Values = 1.0
    velocity_lag: float = 0.0
    velocity_butterworth: float = 0.0
    velocity_delay: float = 0.0
    torque_gain: Values = 1.0
    torque_from_previous: Values = 0.0
    torque_from_next: Values = 0.0
    torque_offset: Values = 0.0
    torque_drift: Values = 0.0
    torque_lag: float = 0.0
    torque_butterworth: float = 0.0
    torque_delay: float = 0.0
    command_delay: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether readings are the true signals."""
        return self.same_as(EXACT)

    def same_as(self, other: ArmReadings) -> bool:
        """Whether both sensor models are equal."""
        pairs = ((value, getattr(other, name)) for name, value in vars(self).items())
        return all(first is second or np.all(first == second) for first, second in pairs)

    @property
    def exact_motion(self) -> bool:
        """Whether readings of positions and velocities are the true ones."""
        return replace(self, **{name: value for name, value in vars(EXACT).items() if name.startswith("torque")}).exact

    @property
    def in_words(self) -> str:
        """Names and values of the parameters that are not nominal."""
        changed = {name: value for name, value in vars(self).items() if np.any(value != getattr(EXACT, name))}
        return ", ".join(f"{name.replace('_', ' ')} {np.asarray(value).tolist()}" for name, value in changed.items())

    def position(self, true: Array) -> Array:
        """Readings of link encoders, ``(..., n)`` [rad]."""
        return self.position_scale * true + self.position_offset

    def position_of(self, reading: Array) -> Array:
        """Positions for readings of link encoders, ``(..., n)`` [rad]."""
        return (reading - self.position_offset) / self.position_scale

    def velocity(self, time: Array, true: Array, first: Start | None = None) -> Array:
        """Readings of velocities, ``(k, n)`` [rad/s].

        Args:
            time: Samples, ``(k,)`` [s].
            true: dq, ``(k, n)`` [rad/s].
            first: First output of the filters [rad/s] and its slope [rad/s^2], ``(n,)`` each; None: steady state of a
                ramp as input.
        """
        unfiltered = self.position_scale * self.velocity_gain * true
        return filtered(time, delayed(time, unfiltered, self.velocity_delay), self.velocity_filters, first)

    def mixing(self, joints: int) -> Array:
        """G, ``(n, n)`` [-]."""
        every = np.ones(joints)
        return (
            np.diag(self.torque_gain * every)
            + np.diag((self.torque_from_previous * every)[1:], -1)
            + np.diag((self.torque_from_next * every)[:-1], 1)
        )

    def torque(self, time: Array, true: Array, age: float, first: Start | None = None) -> Array:
        """Readings of torques, ``(k, n)`` [N m], as :meth:`velocity`.

        Args:
            time: Samples, ``(k,)`` [s].
            true: tau_J, ``(k, n)`` [N m].
            age: Time since the first run of the campaign [s].
            first: First output of the filters [N m] and its slope [N m/s], ``(n,)`` each; None: as in :meth:`velocity`.
        """
        if self.exact:
            return true
        unfiltered = true @ self.mixing(true.shape[-1]).T + self._bias(age)
        return filtered(time, delayed(time, unfiltered, self.torque_delay), self.torque_filters, first)

    def torque_of(self, reading: Array, rate: Array, age: float) -> Array:
        """Torque for a reading and its slope, ``(n,)`` or ``(k, n)`` [N m].

        Args:
            reading: Reading of the sensors [N m].
            rate: Its slope [N m/s].
            age: Time since the first run of the campaign [s].
        """
        return self.torque_rate_of(reading + self.torque_late * rate - self._bias(age))

    def torque_rate_of(self, rate: Array) -> Array:
        """Slope of the torque for a slope of its readings, ``(n,)`` or ``(k, n)`` [N m/s]: G^-1 times it."""
        return np.asarray(np.linalg.solve(self.mixing(rate.shape[-1]), rate.T).T)

    @property
    def velocity_filters(self) -> Lags:
        """T1 and T2 of velocities [s]."""
        return self.velocity_lag, self.velocity_butterworth

    @property
    def torque_filters(self) -> Lags:
        """T1 and T2 of torques [s]."""
        return self.torque_lag, self.torque_butterworth

    @property
    def velocity_late(self) -> float:
        """T1 + T2 + d of velocities [s]."""
        return sum(self.velocity_filters) + self.velocity_delay

    @property
    def velocity_curvature(self) -> float:
        """C of velocities [s^2]."""
        second = self.velocity_butterworth + self.velocity_delay
        return second * (0.5 * second + self.velocity_lag)

    @property
    def torque_late(self) -> float:
        """T1 + T2 + d of torques [s]."""
        return sum(self.torque_filters) + self.torque_delay

    def _bias(self, age: float) -> Values:
        return self.torque_offset + age * self.torque_drift


EXACT = ArmReadings()


@dataclass(frozen=True)
class TrackerReadings:
    """Sensor model of the object tracker.

    Attributes:
        position: t, origin of A in the frame of the readings along x and y [m].
        yaw: Rotation of A in the frame of the readings about z [rad].
        point: c, tracked point from the object's centre, axes of the object [m], along x and y.
        delay: Delay of its timestamps [s].
        lag: T1 of its filter [s].
        butterworth: T2 of its filter [s].
    """

    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    point: tuple[float, float] = (0.0, 0.0)
    delay: float = 0.0
    lag: float = 0.0
    butterworth: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether readings are the true poses."""
        return self == TrackerReadings()

    @property
    def filters(self) -> Lags:
        """T1 and T2 [s]."""
        return self.lag, self.butterworth

    def pose(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Readings of position ``(3,)`` [m] and rotation matrix of the object's centre in A, without delay and lag."""
        turn, shift, point = self._placed
        return turn @ (position + rotation @ point) + shift, turn @ rotation

    def pose_of(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Position ``(3,)`` [m] and rotation matrix for a reading at rest."""
        turn, shift, point = self._placed
        true = turn.T @ rotation
        return turn.T @ (position - shift) - true @ point, true

    def poses(self, time: Array, poses: Array, moments: Array) -> Array:
        """Readings at moments, position and quaternion x y z w, ``(m, 7)``.

        Args:
            time: Times of the samples, ``(k,)`` [s]; before the first sample the object rests.
            poses: True poses, ``(k, 7)`` [m, -], quaternions without changes of sign.
            moments: Time stamps of the readings, ``(m,)`` [s].
        """
        turn, shift, point = self._placed
        filtered_poses = filtered(time, poses, self.filters)
        readings = np.column_stack([np.interp(moments - self.delay, time, column) for column in filtered_poses.T])
        x, y, z, w = readings[:, 3:].T  # of a box that turns about z and is tracked at a point of it
        scale = 2.0 / np.maximum(x * x + y * y + z * z + w * w, 1e-300)
        first = np.column_stack((1.0 - scale * (y * y + z * z), scale * (x * y + z * w), scale * (x * z - y * w)))
        second = np.column_stack((scale * (x * y - z * w), 1.0 - scale * (x * x + z * z), scale * (y * z + x * w)))
        readings[:, :3] = (readings[:, :3] + first * point[0] + second * point[1]) @ turn.T + shift
        half = 0.5 * self.yaw
        c, s = math.cos(half), math.sin(half)  # product of the quaternions of the turn and of the object
        readings[:, 3:] = np.column_stack((c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z))
        return readings

    @property
    def _placed(self) -> tuple[Array, Array, Array]:
        """Rotation, shift and tracked point."""
        return pin.rpy.rpyToMatrix(0.0, 0.0, self.yaw), np.array([*self.position, 0.0]), np.array([*self.point, 0.0])


def delayed(time: Array, values: Array, delay: float) -> Array:
    """Values at ``time - delay``, ``(k, m)``; beyond the samples they are extrapolated linearly."""
    if delay == 0.0:
        return values
    values_delayed = np.asarray(scipy.interpolate.CubicSpline(time, values)(time - delay))
    early, late = time - delay < time[0], time - delay > time[-1]
    values_delayed[early] = values[0] + np.outer((time - delay - time[0])[early], _slope(time[:4], values[:4]))
    values_delayed[late] = values[-1] + np.outer((time - delay - time[-1])[late], _slope(time[-4:], values[-4:]))
    return values_delayed


def filtered(time: Array, values: Array, lags: Lags, first: Start | None = None) -> Array:
    """Output of the filters H, ``(k, m)``, with an input that is linear between samples.

    Args:
        time: Times of samples on an even grid, ``(k,)`` [s].
        values: Input, ``(k, m)``.
        lags: T1 and T2 [s].
        first: Output at the first sample and its slope, ``(m,)`` each; None: the input was a ramp before.
    """
    period = float(time[-1] - time[0]) / (time.size - 1)
    lag, butterworth = lags
    if first is None:
        slope = _slope(time[:4], values[:4])
        first = values[0] - (lag + butterworth) * slope, slope
    start, slope = first
    if lag > 0.0:  # at its bound, a fitted lag may be negative by rounding
        values = _lagged(values, lag, period, start + butterworth * slope)
    if butterworth > 0.0:
        before = start + butterworth * slope * COMPLEX_LAG.conjugate()
        values = _real(_lagged(values, butterworth * COMPLEX_LAG, period, before))
    return values


def _lagged(values: Array, lag: complex, period: float, first: Array) -> Array:
    """Output y of T dy/dt + y = u, ``(k, m)``, with y at the first sample."""
    a, b0, b1 = _hold(lag, period)
    memory = (first - b1 * values[0])[None, :]  # of the direct form II transposed: y_0 = b1 u_0 + memory
    return np.asarray(scipy.signal.lfilter([b1, b0], [1.0, -a], values, axis=0, zi=memory)[0])


def _real(values: Array) -> Array:
    """Butterworth output: real part of (1 - i) times the output of the first-order filter with ``COMPLEX_LAG``."""
    return np.asarray(values.real + values.imag)


def _slope(time: Array, values: Array) -> Array:
    """Slope of the regression line through some samples, ``(m,)``."""
    t = time - time.mean()
    return np.asarray(t @ values / (t @ t))


class Filter:
    """Delay and filters, sample by sample; :func:`delayed` and :func:`filtered` filter whole signals.

    Args:
        delay: d [s]; a negative delay is treated as 0.
        lags: T1 and T2 [s].
        period: From sample to sample [s].
    """

    def __init__(self, delay: float, lags: Lags, period: float) -> None:
        self._back = max(delay, 0.0) / period
        lag, butterworth = lags
        self._lag = _Lag(lag, period) if lag else None
        self._butterworth = _Lag(butterworth * COMPLEX_LAG, period) if butterworth else None
        self._earlier: list[Array] = []
        self._sample, self._output = -1, np.zeros(0)

    def __call__(self, sample: int, values: Array) -> Array:
        """Output ``(m,)`` of the next sample, or again of the last one; before the first the input was constant."""
        if sample == self._sample:
            return self._output
        self._earlier = [*self._earlier, values][-(int(self._back) + 2) :]
        last = len(self._earlier) - 1
        older = max(last - int(self._back) - 1, 0)
        newer, share = max(last - int(self._back), 0), self._back % 1.0
        delayed_value = (1.0 - share) * self._earlier[newer] + share * self._earlier[older]
        first_stage = self._lag(delayed_value) if self._lag else delayed_value
        self._sample, self._output = sample, _real(self._butterworth(first_stage)) if self._butterworth else first_stage
        return self._output


class _Lag:
    """First-order low-pass filter, sample by sample."""

    def __init__(self, lag: complex, period: float) -> None:
        self._a, self._b0, self._b1 = _hold(lag, period)
        self._input: Array | None = None
        self._output = np.zeros(0)

    def __call__(self, values: Array) -> Array:
        """Output ``(m,)`` of the next sample; the first output equals the input."""
        if self._input is None:
            self._output = values
        else:
            self._output = self._a * self._output + self._b0 * self._input + self._b1 * values
        self._input = values
        return self._output


def _hold(lag: complex, period: float) -> tuple[complex, complex, complex]:
    """a, b0 and b1 of y_(i+1) = a y_i + b0 u_i + b1 u_(i+1), for T dy/dt + y = u with u linear between samples.

    a = exp(-h / T),  b1 = 1 - (1 - a) T / h,  b0 = 1 - a - b1
    (first-order hold; Franklin, Powell, Workman 1998, sec. 4.3).
    """
    a = cmath.exp(-period / lag) if isinstance(lag, complex) else math.exp(-period / lag)
    b1 = 1.0 - (1.0 - a) * lag / period
    return a, 1.0 - a - b1, b1
