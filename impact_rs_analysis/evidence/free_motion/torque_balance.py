# SPDX-License-Identifier: Apache-2.0
"""Torque balance of an arm in free motion, for recordings without command and contact.

    tau(t + delay) + eps = (M(q) ddq + h(q, dq) [+ B ddq] - tau_fric(dq) - tau_load - offset) / gain

with q and dq at t (cf. paper eq. eom); tau is the recorded torque, B is included only if it was measured at the motor.
Positions, velocities and torques are smoothed by a zero-phase low-pass (Butterworth, order 4, forwards and backwards)
at three times the cut-off; accelerations are central differences of the smoothed velocity at the rate of the samples.
Predicted and recorded torque then pass the same low-pass at the cut-off; both ends are left out. The model is not
linear in the motion: with motion smoothed at the cut-off itself, the predicted torque is not the low-passed torque.

Dry friction jumps where a joint reverses: it is computed from the velocity at the rate of the samples, smoothed at ten
times the cut-off (differences of a coarse encoder stand still for some samples), and smoothed like the recorded torque.
At a reversal a joint sticks for a moment (Karnopp 1985, J. Dyn. Sys. Meas. Control 107). Sticking is not modelled: it
makes the inertia of a motor 1 to 2.6 % too large in swings of up to 1.5 Hz; with the true friction the error is 0.1 %.

Where the motors have encoders of their own (theta), B and friction act on the motion of the motors, and the deflection
of the transmission is a second signal without its mean, which is an offset of the encoders:

    tau_J = K (theta - q) + D (dtheta - dq) = M(q) ddq + h(q, dq) - loads on the links

Without encoders the motion of the motors is q plus the predicted deflection; a torque measured at the motors depends on
it.

The noise is the power of torques and deflections just above the cut-off that is not coherent with the motion of the
arm: a fast motion has power there.

Where position servos drive the joints and no torque was recorded, tau is computed by their law
(:mod:`impact_rs_trials.recordings.servo`). Commands that act late by d add to the prediction

    tau_servo(q_d(t)) - tau_servo(q_d(t - d))

Effects are applied through :class:`~impact_rs_sim.physics.Physics`, as in plant and twin. An effect that changes no
torque is not measured. Sensor models (:mod:`impact_rs_sim.readings`) correct the smoothed motion, and predict the
readings of the torque.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ArmPhysics, JointFriction, LoadState, Physics
from impact_rs_sim.readings import ArmReadings, delayed
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.recording import ARM, TooShort
from impact_rs_trials.recordings.servo import ServoLaw
from impact_rs_trials.runs import ArmSignals, Run

FILTER_ORDER = 4  # Butterworth low-pass, forwards and backwards
SMOOTHING_RATIO = 3.0  # cut-off of the signals, over the cut-off of predicted and recorded torque
REVERSAL_RATIO = 10.0  # cut-off of the velocity of dry friction, likewise
MAX_CUT_OFF_SHARE = 0.3  # of the sampling rate
PADDED_SAMPLES = 15  # beyond each end, three times the coefficients of the filter
MAX_SAMPLES_PER_PERIOD = 10.0  # of the cut-off frequency, on the grid
EDGE_PERIODS = 3.0  # of the cut-off frequency, left out at both ends: the slowest pole has decayed to 0.1 %
MIN_KEPT_SAMPLES = 40  # of the grid, between the edges
NOISE_BAND = (1.5, 3.0)  # times the cut-off frequency, where the noise is measured
MIN_SAMPLES_PER_BAND_PERIOD = 4.0  # of the upper end of the band
MAX_FITTED_NOISE_SHARE = 0.5  # degrees of freedom of the fit over independent numbers of a (short) recording
# Quarter periods of the middle of the band: any linear law of one motion with slow coefficients.
LAGS_QUARTER_PERIODS = (-2, -1, 0, 1, 2)
MIN_COULOMB_SPEED = 0.02  # rad/s, m/s; below, Coulomb friction is not full
MOTOR_RATIO_RANGE = (0.5, 2.0)  # motion of a motor, seen at the joint, over the motion of the link; elastic or not
CACHED_DELAYS = 8  # delays of commands whose torques are cached
MAX_CACHED_REGRESSORS = 2  # of the model, and of another direction of gravity


@dataclass(frozen=True)
class ServoMotion:
    """Desired and measured motion of position servos on an even grid, before the low-pass, ``(k, n)``.

    Attributes:
        law: The servos.
        time: Samples, ``(k,)`` [s].
        position: Readings of q [rad].
        velocity: Readings of dq [rad/s].
        q_desired: Desired positions by their stamps [rad].
        dq_desired: Desired velocities, likewise [rad/s].
        cut_off: Cut-off frequency of the low-pass [Hz].
        stride: Samples per sample of the filtered motion.
    """

    law: ServoLaw
    time: Array
    position: Array
    velocity: Array
    q_desired: Array
    dq_desired: Array
    cut_off: float
    stride: int

    def torque(self, delay: float) -> Array:
        """Torque if commands act ``delay`` [s] after their stamps, filtered, ``(k, n)`` [N m]."""
        torque = self.law.late(self.time, self.position, self.velocity, self.q_desired, self.dq_desired, delay)
        return _filtered(torque, self.cut_off, 1.0 / float(self.time[1] - self.time[0]), self.stride)

    def delay_loss(self, delay: float) -> Array:
        """Torque of punctual minus torque of late commands, filtered, ``(k, n)`` [N m]."""
        return self._delay_losses.of(delay, lambda: self.torque(0.0) - self.torque(delay))

    @cached_property
    def _delay_losses(self) -> Recent[Array]:
        return Recent[Array](CACHED_DELAYS)


@dataclass(frozen=True)
class Motion:
    """Signals of one recording on an even grid, ``(k, n)`` unless stated: smoothed motion, filtered torques.

    Attributes:
        time: Time since the first sample, ``(k,)`` [s].
        position: q [rad].
        velocity: dq [rad/s].
        acceleration: ddq [rad/s^2].
        torque: Recorded torque, filtered [N m].
        inner: Slice of the samples between the edges.
        noise: Noise of the recorded torque in ``torque``, ``(n,)`` [N m].
        motor_position: theta [rad]; NaN where a joint has no encoder at its motor.
        motor_velocity: dtheta [rad/s]; likewise.
        motor_acceleration: ddtheta [rad/s^2]; likewise.
        deflection: theta - q, filtered [rad]; likewise.
        deflection_noise: Noise of the deflection, ``(n,)`` [rad]; likewise.
        measured: Whether the torque of a joint was measured, ``(n,)``; one that never changes was not.
        cut_off: Cut-off frequency of the low-pass [Hz].
        rate: Sampling rate of the grid [Hz].
        stride: Samples of the recording per sample of the grid.
        fast: Part of dq above its smoothing and below ten times the cut-off, ``(stride (k - 1) + 1, n)`` [rad/s].
        servo: Servos from whose law the torque was computed; None: it was recorded.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    inner: slice
    noise: Array
    measured: NDArray[np.bool_]
    motor_position: Array
    motor_velocity: Array
    motor_acceleration: Array
    deflection: Array
    deflection_noise: Array
    cut_off: float
    rate: float
    stride: int
    fast: Array
    servo: ServoMotion | None = None

    @property
    def with_encoders(self) -> NDArray[np.bool_]:
        """Whether the motor of a joint has an encoder of its own, ``(n,)``."""
        return np.asarray(np.isfinite(self.deflection_noise))

    @property
    def without_motors(self) -> Motion:
        """The motion without motor encoders."""
        nothing = np.full_like(self.position, np.nan)
        return replace(
            self,
            motor_position=nothing,
            motor_velocity=nothing,
            motor_acceleration=nothing,
            deflection=nothing,
            deflection_noise=np.full_like(self.deflection_noise, np.nan),
        )

    def of(self, readings: ArmReadings) -> Motion:
        """The true motion of the links from its readings: position, velocity and acceleration.

        The filters of velocity readings are inverted exactly, because the low-pass has removed high-frequency noise:
        s s_v dq(t - d) = v_r + T1 dv_r/dt, and v_r + T2 dv_r/dt + T2^2 / 2 d2v_r/dt2 of the Butterworth filter.
        """
        scale = readings.position_scale * readings.velocity_gain
        velocity, acceleration = (
            delayed(self.time, values, -readings.velocity_delay) for values in (self.velocity, self.acceleration)
        )
        for lag, square in zip(readings.velocity_filters, (0.0, 0.5), strict=True):
            if lag:
                jerk = _derivative(acceleration, self.rate)
                snap = _derivative(jerk, self.rate)
                velocity = velocity + lag * acceleration + square * lag**2 * jerk
                acceleration = acceleration + lag * jerk + square * lag**2 * snap
        return replace(
            self,
            position=readings.position_of(self.position),
            velocity=velocity / scale,
            acceleration=acceleration / scale,
        )

    def low_pass(self, values: Array) -> Array:
        """The low-pass at the cut-off, on the grid."""
        return _low_pass(values, self.cut_off, self.rate)

    def at_samples(self, values: Array) -> Array:
        """Values on the grid interpolated at the rate of the samples, ``(stride (k - 1) + 1, n)``."""
        fine = np.linspace(self.time[0], self.time[-1], self.stride * (self.time.size - 1) + 1)
        return np.asarray(scipy.interpolate.CubicSpline(self.time, values)(fine))

    @cached_property
    def _fine_velocity(self) -> Array:
        """:attr:`velocity` at the rate of the samples [rad/s]."""
        return self.at_samples(self.velocity)

    def dry_friction(self, friction: JointFriction, velocity: Array, carried: Array) -> Array:
        """Friction without its viscous part, smoothed, ``(k, n)`` [N m].

        Args:
            friction: Friction of the joints.
            velocity: Smoothed velocity of the motors on the grid [rad/s].
            carried: Torque of the transmissions on the grid [N m].
        """
        velocity = self.fast + (self._fine_velocity if velocity is self.velocity else self.at_samples(velocity))
        loaded = 0.0 if friction.load is None else self.at_samples(carried)
        torque = friction.torque(velocity, loaded) - friction.viscous_torque(velocity)
        return _smoothed(torque, self.cut_off, self.rate * self.stride)[:: self.stride]


def _low_pass(values: Array, cut_off: float, rate: float) -> Array:
    """Zero-phase filter, as ``scipy.signal.sosfiltfilt``, with a cached steady state."""
    sections, steady = _butterworth(cut_off, rate)
    filtered = np.concatenate(
        (
            2.0 * values[0] - values[PADDED_SAMPLES:0:-1],
            values,
            2.0 * values[-1] - values[-2 : -PADDED_SAMPLES - 2 : -1],
        )
    )
    for _ in range(2):
        filtered = scipy.signal.sosfilt(sections, filtered, axis=0, zi=steady[:, :, None] * filtered[0])[0][::-1]
    return np.asarray(filtered[PADDED_SAMPLES:-PADDED_SAMPLES])


def _derivative(values: Array, rate: float) -> Array:
    """Central differences of sixth order by time, ``(k, n)``; three samples at each end are extrapolated.

    At a tenth of the sampling rate their error is 0.04 %, of second order 6 % (Fornberg 1988, Math. Comput. 51).
    """
    weights = rate * np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
    ends = [2.0 * values[0] - values[3:0:-1], values, 2.0 * values[-1] - values[-2:-5:-1]]
    return np.asarray(scipy.ndimage.correlate1d(np.concatenate(ends), weights, axis=0)[3:-3])


def _smoothed(values: Array, cut_off: float, sampled: float, ratio: float = SMOOTHING_RATIO) -> Array:
    """Signals at the rate of the samples [Hz] below a multiple of the cut-off [Hz]."""
    return _low_pass(values, min(ratio * cut_off, MAX_CUT_OFF_SHARE * sampled), sampled)


def _filtered(values: Array, cut_off: float, sampled: float, stride: int) -> Array:
    """Smoothed signals on the grid of every ``stride``-th sample, after the low-pass."""
    return _low_pass(_smoothed(values, cut_off, sampled)[::stride], cut_off, sampled / stride)


@functools.lru_cache(maxsize=16)
def _butterworth(cut_off: float, rate: float) -> tuple[Array, Array]:
    """Butterworth filter in second-order sections and its steady state, cached for thousands of predictions."""
    sections = np.asarray(scipy.signal.butter(FILTER_ORDER, cut_off, fs=rate, output="sos"))
    return sections, np.asarray(scipy.signal.sosfilt_zi(sections))


def prepare(run: Run, cut_off: float, law: ServoLaw | None = None) -> Motion:
    """Filter and differentiate a recording of free motion.

    Args:
        run: The recording.
        cut_off: Cut-off frequency of the low-pass [Hz].
        law: Servos from whose law its torque was computed; None: it was recorded.

    Raises:
        TooShort: Too short for the cut-off.
        InputError: Sampled too slowly for it.
    """
    arm = run.signals.arms[ARM]
    start = run.signals.time - run.signals.time[0]
    sampled = 1.0 / float(np.median(np.diff(start)))
    if cut_off > (highest := MAX_CUT_OFF_SHARE * sampled):
        raise InputError(
            f"sampled at {sampled:.3g} Hz, too slow for low_pass = {cut_off:g} Hz; at most {highest:.2g} Hz",
            file=run.path,
        )
    even = np.arange(0.0, start[-1], 1.0 / sampled)

    def resampled(values: Array) -> Array:
        return np.column_stack([np.interp(even, start, column) for column in values.T])

    raw, positions, speeds = (resampled(values) for values in (arm.torque, arm.position, arm.velocity))
    motors = resampled(motor_positions(arm))
    stride = max(1, int(sampled / (MAX_SAMPLES_PER_PERIOD * cut_off)))
    rate = sampled / stride
    servo = None
    if law is not None:
        desired = resampled(arm.q_desired), resampled(arm.dq_desired)
        servo = ServoMotion(law, even, positions, speeds, *desired, cut_off, stride)
    q, dq, theta = (_smoothed(values, cut_off, sampled) for values in (positions, speeds, motors))
    dtheta = _derivative(theta, sampled)
    edge = int(np.ceil(EDGE_PERIODS * rate / cut_off))
    count = q[::stride].shape[0]
    if count < (least := 2 * edge + MIN_KEPT_SAMPLES):
        raise TooShort(
            f"{start[-1]:.3g} s long, at least {least / rate:.2g} s needed with low_pass = {cut_off:g} Hz",
            file=run.path,
        )
    # A servo's torque has the noise of the encoder in it, so the motion that it is compared with is the desired one.
    driven = positions if servo is None else servo.q_desired
    moved = np.hstack((driven, motors[:, np.isfinite(motors).all(axis=0)]))
    driving = np.where(np.isnan(motors), positions, motors)
    turning = np.tanh(np.gradient(driving, 1.0 / sampled, axis=0) / MIN_COULOMB_SPEED)
    return Motion(
        time=even[::stride],
        position=q[::stride],
        velocity=dq[::stride],
        acceleration=_derivative(dq, sampled)[::stride],
        torque=_filtered(raw, cut_off, sampled, stride),
        inner=slice(edge, count - edge),
        noise=_noise(raw, moved, turning, cut_off, sampled),
        measured=np.ptp(arm.torque, axis=0) > 0.0,
        motor_position=theta[::stride],
        motor_velocity=dtheta[::stride],
        motor_acceleration=_derivative(dtheta, sampled)[::stride],
        deflection=_filtered(motors - positions, cut_off, sampled, stride),
        deflection_noise=_noise(motors - positions, moved, turning, cut_off, sampled),
        cut_off=cut_off,
        rate=rate,
        stride=stride,
        fast=(_smoothed(speeds, cut_off, sampled, REVERSAL_RATIO) - dq)[: (count - 1) * stride + 1],
        servo=servo,
    )


def motor_positions(arm: ArmSignals) -> Array:
    """Positions of the motors at the joint side of the gears, ``(k, n)`` [rad]; NaN where a motor has no encoder.

    A signal that equals the position of the link, or has the ratio of a gear, is not used.
    """
    if not arm.motor_position.size:
        return np.full_like(arm.position, np.nan)
    ratios = motor_ratios(arm)
    deflected = np.ptp(arm.motor_position - arm.position, axis=0) > 0.0
    near = (MOTOR_RATIO_RANGE[0] < ratios) & (ratios < MOTOR_RATIO_RANGE[1])
    return np.asarray(np.where(deflected & near, arm.motor_position, np.nan))


def motor_ratios(arm: ArmSignals) -> Array:
    """Ratio of motor motion to link motion, rms, by joint, ``(n,)`` [-]; NaN where a joint does not move."""
    moved = arm.position.std(axis=0)
    return np.asarray(arm.motor_position.std(axis=0) / np.where(moved > 0.0, moved, np.nan))


def _noise(raw: Array, moved: Array, turning: Array, cut_off: float, rate: float) -> Array:
    """Noise below the cut-off, from the incoherent power just above it, ``(n,)`` in the unit of ``raw``.

    In the band every signal is regressed on the positions of all joints at several lags and the direction of its own
    joint, which removes the response of inertia, friction and springs to a fast motion (coherent power, Bendat and
    Piersol 2010, sec. 6). The median over short windows is robust to reversals, where dry friction jumps.

    Args:
        raw: Recorded signals, ``(k, n)``; NaN where a signal is missing.
        moved: Positions of all joints and motors, ``(k, m)`` [rad].
        turning: Direction in which every joint is driven against its friction, ``(k, n)`` [-].
        cut_off: Cut-off frequency of the low-pass [Hz].
        rate: Rate of the samples [Hz].
    """
    highest = 0.45 * rate
    band = (
        (NOISE_BAND[0] * cut_off, NOISE_BAND[1] * cut_off)
        if NOISE_BAND[1] * cut_off < highest
        else (1.2 * cut_off, highest)
    )
    sections = scipy.signal.butter(FILTER_ORDER, band, btype="bandpass", fs=rate, output="sos")

    step = max(1, int(rate / (MIN_SAMPLES_PER_BAND_PERIOD * band[1])))

    def passed(values: Array) -> Array:
        return np.asarray(scipy.signal.sosfiltfilt(sections, values, axis=0))[::step]

    rate /= step
    motion, signals = passed(moved), passed(np.nan_to_num(raw))
    direction = passed(turning)
    lag = max(1, round(0.5 * rate / (band[0] + band[1])))
    shifted = np.hstack([np.roll(motion, quarters * lag, axis=0) for quarters in LAGS_QUARTER_PERIODS])
    inside = slice(LAGS_QUARTER_PERIODS[-1] * lag, signals.shape[0] - LAGS_QUARTER_PERIODS[-1] * lag)
    count = max(1, int(signals.shape[0] * cut_off / rate))
    powers = []
    for joint in range(raw.shape[1]):
        basis = np.column_stack((shifted, direction[:, joint]))[inside]
        residuals = signals[inside, joint] - basis @ np.linalg.lstsq(basis, signals[inside, joint], rcond=None)[0]
        freedom = 2.0 * (band[1] - band[0]) * residuals.size / rate  # independent numbers in a band of this width
        fitted_share = min(np.linalg.matrix_rank(basis) / freedom, MAX_FITTED_NOISE_SHARE)
        windows = [np.mean(np.square(window)) for window in np.array_split(residuals, count)]
        powers.append(np.median(windows) / (1.0 - fitted_share))
    noise = np.sqrt(np.array(powers) * cut_off / (band[1] - band[0]))
    return np.where(np.isnan(raw).any(axis=0), np.nan, noise)


def _motor_motion(motion: Motion, transmitted: Array, arm: ArmPhysics) -> tuple[Array, Array]:
    """Velocity and acceleration of the motors, ``(k, n)`` each [rad/s, rad/s^2].

    Args:
        motion: Recorded motion.
        transmitted: Torque of the transmissions on the links, ``(k, n)`` [N m].
        arm: Stiffness and damping of the transmissions.
    """
    velocity, acceleration, with_encoders = motion.velocity, motion.acceleration, motion.with_encoders
    if np.any(np.isfinite(arm.stiffness[~with_encoders])):
        rate, change = _deflection_derivatives(motion, transmitted, arm, (1, 2))
        velocity, acceleration = velocity + rate, acceleration + change
    if not np.any(with_encoders):
        return velocity, acceleration
    velocity = np.where(with_encoders, motion.motor_velocity, velocity)
    return velocity, np.where(with_encoders, motion.motor_acceleration, acceleration)


def _deflection_derivatives(motion: Motion, transmitted: Array, arm: ArmPhysics, orders: Sequence[int]) -> list[Array]:
    """Derivatives of the deflection of the transmissions of some orders, ``(k, n)`` each [rad, rad/s, ...].

    With the time constant T = D / K, short against the motion,
    (1 + T d/dt)^-1 tau_J / K = (1 - T d/dt + T^2 d^2/dt^2) tau_J / K.
    """
    spline = scipy.interpolate.make_interp_spline(motion.time, transmitted / arm.stiffness, k=5)
    late = arm.damping / arm.stiffness
    terms = 3 if np.any(late) else 1
    return [sum((-late) ** term * spline(motion.time, order + term) for term in range(terms)) for order in orders]


def _inverse_dynamics(model: RobotModel, motion: Motion) -> Array:
    """M ddq + h along a motion, ``(k, n)`` [N m]."""
    states = zip(motion.position, motion.velocity, motion.acceleration, strict=True)
    return np.array([pin.rnea(model.pinocchio, model.data, *state) for state in states])


def _load_state(motion: Motion, model: RobotModel, impact_position: Array) -> tuple[LoadState, Array]:
    """Arguments of loads along a motion, and the linear part of the Jacobians, ``(k, 3, n)``."""
    jacobian = np.array([model.jacobian(q)[:3] for q in motion.position])
    state = LoadState(
        time=motion.time,
        joint_position=motion.position,
        joint_velocity=motion.velocity,
        position=np.array([model.placement(q).translation for q in motion.position]),
        velocity=np.einsum("kan,kn->ka", jacobian, motion.velocity),
        impact_position=impact_position,
    )
    return state, jacobian


class TorqueBalance:
    """Predicts the recorded torque of several motions under given physics.

    Args:
        motions: Filtered recordings.
        at_motor: Whether the torque was measured at the motors, so that it accelerates their inertia as well.

    Attributes:
        joints: Joints whose torque was measured in all of them, ``(m,)``.
        elastic: Joints whose deflection was measured, ``(e,)``.
    """

    def __init__(self, motions: list[Motion], at_motor: bool = False) -> None:
        self.motions, self._at_motor = motions, at_motor
        self.joints = np.flatnonzero(np.all([motion.measured for motion in motions], axis=0))
        self.elastic = np.flatnonzero(np.all([motion.with_encoders for motion in motions], axis=0))
        self._regressors: dict[bytes, list[Array]] = {}
        self._cached_states: dict[bytes, list[tuple[LoadState, Array]]] = {}
        self._cached_model: tuple[tuple[object, ...], RobotModel] | None = None
        self._cached_motions: tuple[ArmReadings, list[Motion]] | None = None

    def predict(self, physics: Physics) -> Array:
        """Predicted torque of :attr:`joints` and deflection of :attr:`elastic`, ``(k, m + e)`` [N m, rad].

        All motions are stacked between their edges.
        """
        return np.concatenate(
            [
                np.hstack((torque[motion.inner][:, self.joints], bent[motion.inner][:, self.elastic]))
                for motion, torque, bent in zip(
                    self.motions, self.predicted(physics), self._deflections(physics), strict=True
                )
            ]
        )

    def predicted(self, physics: Physics) -> list[Array]:
        """Predicted recorded torque of every motion, with its edges, ``(k, n)`` [N m]."""
        arm = physics.arms[ARM]
        rows = []
        motions = self._true_motions(arm.readings)
        for number, (motion, rigid) in enumerate(zip(motions, self._rigid_torques(physics), strict=True)):
            velocity, acceleration = _motor_motion(motion, rigid, arm)
            torque = rigid + arm.motor_inertia_reduced * acceleration if self._at_motor else rigid
            if not arm.friction.is_zero:
                viscous = arm.friction.viscous_torque(velocity)
                carried = self._transmitted_torques(physics, number, rigid)
                torque = torque - viscous - motion.dry_friction(arm.friction, velocity, carried)
            if arm.loads:
                torque = torque - self._load_torques(physics, number, rigid)
            torque = motion.low_pass((torque - arm.torque_offset) / arm.torque_gain)
            if motion.servo is not None:
                torque = torque + motion.servo.delay_loss(arm.actuation_delay + arm.readings.command_delay)
            rows.append(arm.readings.torque(motion.time, torque, 0.0))
        return rows

    def delay_loss(self, physics: Physics) -> Array:
        """Part of :meth:`predict` from late commands of servos, ``(k, m)`` [N m]."""
        arm = physics.arms[ARM]
        delay = arm.actuation_delay + arm.readings.command_delay
        return np.concatenate(
            [
                (np.zeros_like(motion.torque) if motion.servo is None else motion.servo.delay_loss(delay))[motion.inner]
                for motion in self.motions
            ]
        )[:, self.joints]

    def _deflections(self, physics: Physics) -> list[Array]:
        """Predicted deflection of the transmissions of every motion, with its edges, ``(k, n)`` [rad]."""
        if not self.elastic.size:
            return [np.zeros_like(motion.position) for motion in self.motions]
        arm = physics.arms[ARM]
        rows = []
        motions = self._true_motions(arm.readings)
        for number, (motion, rigid) in enumerate(zip(motions, self._rigid_torques(physics), strict=True)):
            carried = self._transmitted_torques(physics, number, rigid)
            bent = motion.low_pass(_deflection_derivatives(motion, carried, arm, (0,))[0] + motion.position)
            bent = bent - motion.low_pass(arm.readings.position(motion.position))  # of the encoder of the link
            rows.append(bent - bent[motion.inner].mean(axis=0))
        return rows

    def _true_motions(self, readings: ArmReadings) -> list[Motion]:
        """True motions from the readings, cached while effects change other parts of the physics."""
        if readings.exact_motion:
            return self.motions
        if self._cached_motions is None or self._cached_motions[0] is not readings:
            self._cached_motions = readings, [motion.of(readings) for motion in self.motions]
        return self._cached_motions[1]

    def _model(self, physics: Physics) -> RobotModel:
        """Rigid-body model of the arm, cached while effects change other parts of the physics."""
        arm = physics.arms[ARM]
        parts = (arm.facts, arm.end_effector, arm.base, physics.gravity)
        if self._cached_model is None or any(
            part is not cached for part, cached in zip(parts, self._cached_model[0], strict=True)
        ):
            self._cached_model = parts, physics.robot_model(ARM)
        return self._cached_model[1]

    def _rigid_torques(self, physics: Physics) -> list[Array]:
        """M ddq + h = Y pi, linear in the inertial parameters pi of all links, ``(k, n)`` each [N m]."""
        model, readings = self._model(physics), physics.arms[ARM].readings
        if not readings.exact_motion:  # a regressor of another motion would be used once
            return [_inverse_dynamics(model, motion) for motion in self._true_motions(readings)]
        parameters = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.pinocchio.inertias)[1:]])
        key = model.pinocchio.gravity.linear.tobytes()
        if key not in self._regressors:
            while len(self._regressors) >= MAX_CACHED_REGRESSORS:
                self._regressors.pop(list(self._regressors)[1])  # the first belongs to the model
            self._regressors[key] = [
                np.array(
                    [
                        pin.computeJointTorqueRegressor(model.pinocchio, model.data, *state)
                        for state in zip(motion.position, motion.velocity, motion.acceleration, strict=True)
                    ]
                ).reshape(*motion.position.shape, parameters.size)  # for one joint Pinocchio returns a vector
                for motion in self.motions
            ]
        return [regressor @ parameters for regressor in self._regressors[key]]

    def _transmitted_torques(self, physics: Physics, number: int, rigid: Array) -> Array:
        """Torques of the transmissions on the links: rigid-body torque minus loads on the links, ``(k, n)`` [N m]."""
        if not physics.arms[ARM].loads:
            return rigid
        return rigid - self._load_torques(physics, number, rigid, links_alone=True)

    def _load_torques(self, physics: Physics, number: int, rigid: Array, links_alone: bool = False) -> Array:
        """Torques of loads outside the rigid model: on links, and unless ``links_alone`` on motors, ``(k, n)`` [N m].

        A law of the transmitted torque gets the predicted torque of the links: the recorded torque contains the
        friction of the motor, and the noise of the signal that the law has to explain.
        """
        state, jacobian = self._states(physics)[number]
        on_links, on_motors = physics.arms[ARM].load_torques(replace(state, joint_torque=rigid), jacobian)
        return on_links if links_alone else on_links + on_motors

    def _states(self, physics: Physics) -> list[tuple[LoadState, Array]]:
        """Arguments of loads of every motion, and the linear part of the Jacobians, ``(k, 3, n)``."""
        arm, model = physics.arms[ARM], self._model(physics)
        start = np.zeros(arm.facts.joint_count)
        key = np.concatenate((model.placement(start).homogeneous.ravel(), arm.impact_position)).tobytes()
        motions = self._true_motions(arm.readings)
        key += b"".join(motion.position[:1].tobytes() + motion.velocity[:1].tobytes() for motion in motions)
        if key not in self._cached_states:
            self._cached_states = {key: [_load_state(motion, model, arm.impact_position) for motion in motions]}
        return self._cached_states[key]

    @cached_property
    def recorded(self) -> Array:
        """Recorded torque of :attr:`joints` and deflection of :attr:`elastic` between the edges, ``(k, m + e)``."""
        bent = [motion.deflection[motion.inner][:, self.elastic] for motion in self.motions]
        return np.concatenate(
            [
                np.hstack((motion.torque[motion.inner][:, self.joints], deflection - deflection.mean(axis=0)))
                for motion, deflection in zip(self.motions, bent, strict=True)
            ]
        )

    @property
    def velocity(self) -> Array:
        """Velocities of the joints of every column of :attr:`recorded`, ``(k, m + e)`` [rad/s]."""
        columns = np.concatenate((self.joints, self.elastic))
        return np.concatenate([motion.velocity[motion.inner][:, columns] for motion in self.motions])

    @property
    def noise(self) -> Array:
        """Noise of every column of :attr:`recorded` below the cut-off, ``(m + e,)`` [N m, rad]."""
        rows = [
            np.concatenate((motion.noise[self.joints], motion.deflection_noise[self.elastic]))
            for motion in self.motions
        ]
        return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))
