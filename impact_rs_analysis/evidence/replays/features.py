# SPDX-License-Identifier: Apache-2.0
"""Features of windows, to which measurement and replay are reduced.

Torques enter as balances that are zero for the nominal rigid model, so that small differences of the path cancel:

    motor side   b_m = tau_d - tau_J - B_theta ddtheta               friction, offset, gain, delay, motor inertia
    link side    b_l = tau_J - M ddq - h                             payload, tilt, pulling cables, contact
    elasticity   b_e = (theta - q) - tau_J / K                       joint stiffness

each as mean over a window, with the acceleration part from the change of momentum. In contact b_l is converted to the
wrench at E. Without motor measurement, replay and measurement both use the motor velocity dq + dtau_J / K.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_control.detection import separable_wrench
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.robots.robot import UNITS, Array, JointType
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_trials.runs import ArmSignals, Poses, Signals

BIN_EDGE_S = 0.006  # averaged at each end of a bin for its momentum change
ONSET_SPEED_SHARE = 0.05  # of the ante-impact speed; its loss marks the begin of an impact
MAX_ONSET_LOSS_SHARE = 0.4  # upper limit of that threshold over the total loss: light objects take little speed
MIN_ONSET_NOISE_RATIO = 6.0  # lower limit of that threshold over the noise of the velocity
MIN_LOSS_SHARE = 0.004  # of the speed; a smaller loss is no impact
QUIET_S = 0.008  # at the begin of a window, before the impact
LOSS_WINDOW_S = 0.08  # after the begin of the window
JUMP_BEFORE_S = (-0.018, -0.003)  # from the begin of the impact
JUMP_WINDOWS_S = ((0.0, 0.004), (0.004, 0.010), (0.010, 0.020), (0.020, 0.040), (0.040, 0.080))
SETTLED_WINDOW = 3  # index of the window in which both bodies have settled after the impact
OBJECT_WINDOWS_S = ((0.006, 0.040), (0.040, 0.100))
PUSH_EDGES_S = (0.10, 0.175, 0.25, 0.325, 0.395)  # edges of the bins in which both bodies move together
DYNAMICS_STRIDE = 5  # samples from one evaluation of gravity and Coriolis torque to the next, in free motion
SLOPE_WINDOW_S = 0.009  # of the slope of the joint torque, without motor measurement
VELOCITY_LIMIT_RAD_S = 0.004  # relevance limit of the velocity of a joint


@functools.cache
def layout(
    arms: tuple[tuple[str, tuple[JointType, ...]], ...],
    free: int,
    pushes: int | None,
    command: bool,
    motor: bool,
    bodies: tuple[str, ...],
) -> tuple[Feature, ...]:
    """Description of the entries of a feature vector.

    Args:
        arms: Names of the arms, each with the types of its joints. Relevance limits in N and m are those in N m and
            rad at a lever of 1 m.
        free: Windows of free motion.
        pushes: Number of recorded bins of the push; None: free motion.
        command: Whether the desired torque is known.
        motor: Whether the motor's position is known.
        bodies: Names of the tracked objects: ``object``, then its neighbours.
    """
    result: list[Feature] = []
    for arm, moves in arms:
        label = f"{arm}." if len(arms) > 1 else ""
        joints = [(f"{label}joint{index}", UNITS[kind]) for index, kind in enumerate(moves, start=1)]
        torques = [(name, units.effort) for name, units in joints]
        positions = [(name, units.position) for name, units in joints]
        speeds = [(name, units.velocity) for name, units in joints]
        velocity, turning, force, moment = (
            [(f"{label}{axis}", unit) for axis in AXES] for unit in ("m/s", "rad/s", "N", "N m")
        )

        def add(
            phase: str, signal: str, entries: list[tuple[str, str]], bins: int, limit: float, arm: str = arm
        ) -> None:
            result.extend(
                Feature(phase, signal, name, b, unit, limit, arm) for b in range(bins) for name, unit in entries
            )

        if command:
            add("free", "motor torque balance", torques, free, 0.01)
        add("free", "link torque balance", torques, free, 0.02)
        if motor:
            add("free", "elastic deflection", positions, free, 4e-6)
        if pushes is None:
            continue
        add("impact", "joint velocity jump", speeds, 1, VELOCITY_LIMIT_RAD_S)
        add("impact", "end-effector velocity", velocity, len(JUMP_WINDOWS_S), 0.003)
        add("impact", "contact force", force, len(JUMP_WINDOWS_S), 1.0)
        add("impact", "end-effector rotation", turning, len(JUMP_WINDOWS_S), 0.02)
        if command:
            add("push", "motor torque balance", torques, pushes, 0.01)
        add("push", "contact force", force, pushes, 0.05)
        add("push", "contact moment", moment, pushes, 0.02)
        add("push", "end-effector velocity", velocity, pushes, 0.001)
    for body in () if pushes is None else bodies:
        for number in range(len(OBJECT_WINDOWS_S)):
            result.extend(Feature("impact", f"{body} velocity", axis, number, "m/s", 0.003) for axis in AXES[:2])
            result.append(Feature("impact", f"{body} rotation", "z", number, "rad/s", 0.05))
        for number in range(pushes or 0):
            result.extend(Feature("push", f"{body} velocity", axis, number, "m/s", 0.001) for axis in AXES[:2])
    return tuple(result)


def extract(
    windows: Sequence[Signals],
    commands: Sequence[Mapping[str, Array]],
    contact: Sequence[bool],
    arms: Mapping[str, tuple[ArmPhysics, RobotModel]],
    motor: bool,
    bodies: tuple[str, ...],
    pushes: int | None,
    levels: Mapping[str, float],
) -> list[Array | None]:
    """Feature vectors of several simulations of the same windows; None where an expected impact is missing.

    Args:
        windows: Signals of ``B`` simulations, or of one measurement, stacked along a first axis: ``(B, k, n)``,
            object ``(B, p, 3)``.
        commands: Per window desired torque by arm and tick, ``(k, n)`` [N m]; empty if not known.
        contact: Whether each window contains the impact.
        arms: Nominal physics and rigid-body model by arm.
        motor: Whether motor position and velocity are looked at.
        bodies: Names of the tracked objects.
        pushes: Bins of the push.
        levels: By arm, loss of speed that marks the begin of the impact [m/s].

    Returns:
        ``(F,)`` each, ``B`` of them.
    """
    parts: list[Array] = []
    onsets: list[Array] = []
    last = windows[-1] if contact and contact[-1] else None
    for name, (physics, model) in arms.items():
        free = _free_balances(
            [w for w, hit in zip(windows, contact, strict=True) if not hit], name, physics, model, motor
        )
        if commands[0]:
            parts += [
                f.motor_balance(torques[name], physics.motor_inertia_reduced)
                for f, torques in zip(free, commands, strict=False)
            ]
        parts += [f.link_balance for f in free]
        if motor:
            parts += [
                (w.arms[name].motor_position - w.arms[name].position - w.arms[name].torque / physics.stiffness).mean(
                    axis=1
                )
                for w in windows[: len(free)]
            ]
        if last is None:
            continue
        dynamics = Balances(last.time, last.arms[name], commands[-1].get(name), physics, model, motor)
        onset = onsets_of(last.time, dynamics.twists[..., :3], levels[name])
        onsets.append(onset)
        # A simulation without an impact has no features; features at an arbitrary time keep the arrays rectangular.
        onset = np.where(np.isfinite(onset), onset, last.time[0] - JUMP_BEFORE_S[0])
        parts += _impact_features(onset, dynamics)
        parts += _push_features(onset, dynamics, pushes or 0)
    if last is not None and bodies:
        first = np.min(np.where(np.isfinite(onsets), onsets, last.time[0]), axis=0)[:, None]
        bins = np.array([*OBJECT_WINDOWS_S, *zip(PUSH_EDGES_S[: (pushes or 0)], PUSH_EDGES_S[1:], strict=False)]).T
        for body in bodies:
            velocity = _object_velocity(last.poses[body], first + bins[0], first + bins[1])
            parts.append(_in_rows(velocity[:, : len(OBJECT_WINDOWS_S)]))
            parts.append(_in_rows(velocity[:, len(OBJECT_WINDOWS_S) :, :2]))
    rows = np.concatenate(parts, axis=1)
    hit = np.atleast_1d(np.all(np.isfinite(onsets), axis=0)) if onsets else np.full(len(rows), True)
    return [row if impact else None for row, impact in zip(rows, hit, strict=True)]


def _in_rows(values: Array) -> Array:
    """Values by simulation, bin and entry ``(B, w, m)``, as ``(B, w m)``."""
    return values.reshape(len(values), -1)


def onset_level(time: Array, velocity: Array) -> float | None:
    """Threshold of the speed loss that marks the begin of an impact [m/s]; None if the loss is within noise.

    A share of the speed, at least ``MIN_ONSET_NOISE_RATIO`` times the noise, at most a share of the total loss.

    Args:
        time: Ticks, ``(k,)`` [s]; the first 8 ms are before the impact.
        velocity: Measured velocity of the end effector, ``(k, 3)`` [m/s].
    """
    (loss,), (speed,) = _loss(time, velocity[None])
    noise = float(np.std(loss[: max(3, np.count_nonzero(time <= time[0] + QUIET_S))]))
    level = min(max(ONSET_SPEED_SHARE * speed, MIN_ONSET_NOISE_RATIO * noise), MAX_ONSET_LOSS_SHARE * float(loss.max()))
    return level if level > max(0.5 * MIN_ONSET_NOISE_RATIO * noise, MIN_LOSS_SHARE * speed) else None


def onsets_of(time: Array, velocity: Array, level: float) -> Array:
    """Times at which the speed loss reaches a threshold, interpolated between ticks, ``(B,)`` [s]; NaN if never.

    Args:
        time: Ticks, ``(k,)`` [s]; the first 8 ms are before the impact.
        velocity: Velocity of the end effector in ``B`` simulations, ``(B, k, 3)`` [m/s].
        level: Loss of speed, from the measured run (:func:`onset_level`) [m/s].
    """
    loss, _ = _loss(time, velocity)
    rising = (loss[:, :-1] < level) & (loss[:, 1:] >= level)
    row = np.argmax(rising, axis=1)
    simulations = np.arange(len(loss))
    before, after = loss[simulations, row], loss[simulations, row + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        moment = time[row] + (level - before) / (after - before) * (time[row + 1] - time[row])
    return np.asarray(np.where(rising.any(axis=1), moment, np.nan))


def _loss(time: Array, velocity: Array) -> tuple[Array, Array]:
    """Loss of speed against the direction before the impact, ``(B, k)``, and that speed, ``(B,)`` [m/s]."""
    before = velocity[:, time <= time[0] + QUIET_S].mean(axis=1)
    speed = np.linalg.norm(before, axis=1)
    near = time <= time[0] + LOSS_WINDOW_S
    return speed[:, None] - np.einsum("bki,bi->bk", velocity[:, near], before) / speed[:, None], speed


def _impact_features(onset: Array, dynamics: Balances) -> list[Array]:
    """Jump and first 80 ms; windows begin between ticks, so features are continuous in the time of the impact."""
    time = dynamics.time
    starts, ends = (onset[:, None] + np.array(edges) for edges in zip(JUMP_BEFORE_S, *JUMP_WINDOWS_S, strict=True))
    velocity = _Integral(time, dynamics.arm.velocity).mean(starts, ends)
    jump = velocity[:, 1 + SETTLED_WINDOW] - velocity[:, 0]
    twist = _Integral(time, dynamics.twists).mean(starts, ends)
    change = twist[:, 1:] - twist[:, :1]
    starts, ends = starts[:, 1:] - 0.003, ends[:, 1:]
    force = dynamics.wrench_at(0.5 * (starts + ends), dynamics.link_balance(starts, ends))[..., :3]
    return [jump, _in_rows(change[..., :3]), _in_rows(force), _in_rows(change[..., 3:])]


def _push_features(onset: Array, dynamics: Balances, pushes: int) -> list[Array]:
    """Motor balance, wrench and velocity while pad and object stay in contact."""
    begin, stop = (onset[:, None] + np.array(edges) for edges in (PUSH_EDGES_S[:pushes], PUSH_EDGES_S[1 : pushes + 1]))
    motor, link = dynamics.balance(begin, stop)
    wrench = dynamics.wrench_at(0.5 * (begin + stop), link)
    velocity = _Integral(dynamics.time, dynamics.twists[..., :3]).mean(begin, stop)
    motor_features = [motor] if dynamics.command is not None else []
    return [_in_rows(values) for values in (*motor_features, wrench[..., :3], wrench[..., 3:], velocity)]


class _Integral:
    """Means of sampled signals over windows whose ends lie between samples.

    Args:
        time: Samples, ``(k,)`` [s].
        values: ``(B, k, m)``.
    """

    def __init__(self, time: Array, values: Array) -> None:
        self._time, self._values = time, values
        steps = 0.5 * (values[:, 1:] + values[:, :-1]) * np.diff(time)[:, None]
        self._sums = np.concatenate((np.zeros_like(values[:, :1]), np.cumsum(steps, axis=1)), axis=1)

    def at(self, moments: Array) -> Array:
        """The signals at moments of each simulation, ``(B, w)`` [s], as ``(B, w, m)``."""
        return _between(self._time, self._values, moments)

    def mean(self, starts: Array, ends: Array) -> Array:
        """Means over windows of each simulation, ``(B, w)`` [s], as ``(B, w, m)``."""
        total = _between(self._time, self._sums, ends) - _between(self._time, self._sums, starts)
        return np.asarray(total / (ends - starts)[..., None])


def _between(time: Array, values: Array, moments: Array) -> Array:
    row = np.clip(np.searchsorted(time, moments) - 1, 0, time.size - 2)
    share = ((moments - time[row]) / (time[row + 1] - time[row]))[..., None]
    simulations = np.arange(len(values))[:, None]
    return np.asarray((1.0 - share) * values[simulations, row] + share * values[simulations, row + 1])


def _slope(time: Array, values: Array) -> Array:
    """Time derivative of signals ``(B, k, n)`` by parabolas over ``SLOPE_WINDOW_S`` (Savitzky and Golay 1964)."""
    period = float(time[1] - time[0])
    length = max(5, 2 * round(SLOPE_WINDOW_S / period / 2.0) + 1)
    length = min(length, time.size - 1 + time.size % 2)
    return np.asarray(scipy.signal.savgol_filter(values, length, 2, deriv=1, delta=period, axis=1))


def _spring_rate(time: Array, arm: ArmSignals, physics: ArmPhysics, motor: bool) -> Array:
    """dtheta - dq, measured or from the slope of the joint torque, ``(B, k, n)`` [rad/s]."""
    if motor:
        return arm.motor_velocity - arm.velocity
    return np.asarray(_slope(time, arm.torque) / physics.stiffness)


def _momenta(model: RobotModel, arm: ArmSignals, rows: NDArray[np.intp] | slice) -> tuple[Array, Array, Array]:
    """M dq, C^T dq - g and the twist of E along the rows of several motions, ``(B, r, .)``."""
    q, dq = arm.position[:, rows], arm.velocity[:, rows]
    joints = q.shape[-1]
    chain_terms = model.chain.momentum(q.reshape(-1, joints), dq.reshape(-1, joints))
    momentum, model_rate, twist = (values.reshape(*q.shape[:2], -1) for values in chain_terms)
    return momentum, model_rate, twist


def _middle(start: Array, end: Array) -> tuple[Array, Array]:
    """Effective limits of a bin [s]: momentum is averaged over both ends of a bin, and refers to their middles."""
    return start + 0.5 * BIN_EDGE_S, end - 0.5 * BIN_EDGE_S


def _change_and_mean(signal: _Integral, start: Array, end: Array) -> tuple[Array, Array]:
    """Rate of change of a signal over bins, between the means of their ends, and its mean between their middles."""
    begin, stop = _middle(start, end)
    ramp = signal.mean(end - BIN_EDGE_S, end) - signal.mean(start, start + BIN_EDGE_S)
    return ramp / (stop - begin)[..., None], signal.mean(begin, stop)


def _ticks(time: Array) -> bytes:
    """Cache key: times since the first tick; windows of equal ticks share their weights."""
    return np.round(time - time[0], 9).tobytes()


@functools.lru_cache(maxsize=1024)
def _weights(ticks: bytes) -> tuple[Array, Array]:
    """Weights of the samples for rate of change and mean of a signal over ticks (bytes, [s]), ``(k,)`` each."""
    time = np.frombuffer(ticks)
    change, mean = _change_and_mean(_Integral(time, np.eye(time.size)[None]), time[None, :1], time[None, -1:])
    return change[0, 0], mean[0, 0]


@functools.lru_cache(maxsize=1024)
def _weights_of_slope(ticks: bytes) -> tuple[Array, Array]:
    """:func:`_weights` of the slope of a signal (:func:`_slope`), ``(k,)`` each."""
    time = np.frombuffer(ticks)
    slope = _slope(time, np.eye(time.size)[None])[0]
    change, mean = _weights(ticks)
    return change @ slope, mean @ slope


@functools.lru_cache(maxsize=1024)
def _coarse(ticks: bytes) -> NDArray[np.intp]:
    """Rows at which gravity and momentum are computed: both ends, and every ``DYNAMICS_STRIDE`` rows between."""
    time = np.frombuffer(ticks)
    rows = np.arange(time.size)
    ends = (time <= time[0] + 1.5 * BIN_EDGE_S) | (time >= time[-1] - 1.5 * BIN_EDGE_S)
    return rows[ends | (rows % DYNAMICS_STRIDE == 0)]


@dataclass(frozen=True)
class FreeBalances:
    """Torque balances of the nominal model over whole windows of free motion; arrays are ``(B, n)``.

    Attributes:
        time: Ticks, ``(k,)`` [s].
        acceleration: Mean acceleration of the motors [rad/s^2].
        transmitted: Mean torque that the joints transmit [N m].
        link_balance: Mean of b_l [N m].
    """

    time: Array
    acceleration: Array
    transmitted: Array
    link_balance: Array

    @staticmethod
    def of(time: Array, arm: ArmSignals, physics: ArmPhysics, model: RobotModel, motor: bool) -> FreeBalances:
        """Balances of several motions on the same ticks; arguments as for :class:`Balances`."""
        ticks = _ticks(time)
        rows = _coarse(ticks)
        change, mean = _weights(ticks)
        coarse_change, coarse_mean = _weights(_ticks(time[rows]))
        momentum, model_rate, _ = _momenta(model, arm, rows)
        if motor:
            acceleration, spring_rate = change @ arm.motor_velocity, mean @ (arm.motor_velocity - arm.velocity)
        else:
            ramp, rate = (weights @ arm.torque / physics.stiffness for weights in _weights_of_slope(ticks))
            acceleration, spring_rate = change @ arm.velocity + ramp, rate
        transmitted = mean @ arm.torque + physics.damping * spring_rate
        link = transmitted + coarse_mean @ model_rate - coarse_change @ momentum
        return FreeBalances(time, acceleration, transmitted, link)

    @property
    def middle(self) -> tuple[float, float]:
        """Time to which the change of momentum refers: begin and end [s]."""
        begin, end = _middle(self.time[0], self.time[-1])
        return float(begin), float(end)

    def motor_balance(self, command: Array, inertia: Array) -> Array:
        """Mean of b_m for a desired torque at every tick, ``(k, n)`` [N m]."""
        _, mean = _weights(_ticks(self.time))
        return np.asarray(mean @ command - self.transmitted - inertia * self.acceleration)


def _free_balances(
    windows: Sequence[Signals], name: str, physics: ArmPhysics, model: RobotModel, motor: bool
) -> list[FreeBalances]:
    """Balances of one arm in windows of free motion; windows of equal ticks are computed together."""
    alike: dict[bytes, list[int]] = {}
    for number, window in enumerate(windows):
        alike.setdefault(_ticks(window.time), []).append(number)
    balances: dict[int, FreeBalances] = {}
    for numbers in alike.values():
        together = ArmSignals.joined([windows[number].arms[name] for number in numbers])
        whole = FreeBalances.of(windows[numbers[0]].time, together, physics, model, motor)
        parts = (np.split(array, len(numbers)) for array in (whole.acceleration, whole.transmitted, whole.link_balance))
        for number, part in zip(numbers, zip(*parts, strict=True), strict=True):
            balances[number] = FreeBalances(windows[number].time, *part)
    return [balances[number] for number in range(len(windows))]


class Balances:
    """Torque balances of the nominal model along several motions on the same ticks.

    Args:
        time: Ticks, ``(k,)`` [s].
        arm: Measured or simulated, ``(B, k, n)``.
        command: Desired torque, ``(k, n)`` [N m]; None: not known.
        physics: Nominal physics of arm and drives.
        model: Nominal rigid-body model.
        motor: Whether motor position and velocity are used.
    """

    def __init__(
        self,
        time: Array,
        arm: ArmSignals,
        command: Array | None,
        physics: ArmPhysics,
        model: RobotModel,
        motor: bool,
    ) -> None:
        self.time, self.arm, self.command, self.physics, self.model = time, arm, command, physics, model
        momentum, model_rate, self.twists = _momenta(model, arm, slice(None))
        spring_rate = _spring_rate(time, arm, physics, motor)
        self._damped = _Integral(time, arm.torque + physics.damping * spring_rate)
        self._command = None if command is None else _Integral(time, command[None])
        self._motor_velocity = _Integral(time, arm.velocity + spring_rate)
        self._momentum = _Integral(time, momentum)
        self._model_rates = _Integral(time, model_rate)

    def balance(self, start: Array, end: Array) -> tuple[Array, Array]:
        """Motor- and link-side balance over bins ``(B, w)`` [s], ``(B, w, n)`` [N m]; the former 0 without command."""
        begin, stop = _middle(start, end)
        ramp, _ = _change_and_mean(self._motor_velocity, start, end)
        damped = self._damped.mean(begin, stop)
        change, _ = _change_and_mean(self._momentum, start, end)
        link = damped + self._model_rates.mean(begin, stop) - change
        if self._command is None:
            return np.zeros_like(link), link
        return self._command.mean(begin, stop) - damped - self.physics.motor_inertia_reduced * ramp, link

    def link_balance(self, start: Array, end: Array) -> Array:
        """Link-side balance over short windows that begin and end between ticks, ``(B, w, n)`` [N m]."""
        change = (self._momentum.at(end) - self._momentum.at(start)) / (end - start)[..., None]
        return (self._damped.mean(start, end) + self._model_rates.mean(start, end)) - change

    def wrench_at(self, moments: Array, balances: Array) -> Array:
        """Contact wrench of the arm on its environment from link-side balances, at E in E[A], ``(B, w, 6)`` [N, N m].

        With the nominal arm; see :func:`impact_rs_control.detection.separable_wrench`.

        Args:
            moments: Time of the configuration in each simulation, ``(B, w)`` [s].
            balances: Link-side balance of each, ``(B, w, n)`` [N m].
        """
        rows = np.minimum(np.searchsorted(self.time, moments), self.time.size - 1)
        q = self.arm.position[np.arange(len(rows))[:, None], rows]
        jacobians, masses = self._at(q.reshape(-1, q.shape[-1]))
        return separable_wrench(jacobians, masses, balances.reshape(-1, q.shape[-1])).reshape(*rows.shape, 6)

    def _at(self, q: Array) -> tuple[Array, Array]:
        """Jacobians of E ``(k, 6, n)`` and mass matrices ``(k, n, n)``."""
        jacobians, masses = np.empty((len(q), 6, q.shape[1])), np.empty((len(q), q.shape[1], q.shape[1]))
        for row, position in enumerate(q):
            jacobians[row], masses[row] = self.model.jacobian(position), self.model.mass_matrix(position)
        return jacobians, masses


def _object_velocity(poses: Poses, start: Array, end: Array) -> Array:
    """Slope of position (x, y) and yaw over windows, ``(B, w, 3)`` [m/s, m/s, rad/s]; zero where it is not tracked.

    Between the means over the first and the last third: nearly as precise as a least-squares line, and continuous when
    a sample enters the window.
    """
    time = poses.time
    sample_count = np.searchsorted(time, end, side="right") - np.searchsorted(time, start)
    if time.size < 2:
        return np.zeros((*start.shape, 3))
    pose = _Integral(time, np.concatenate((poses.position[..., :2], poses.yaw[..., None]), axis=-1))
    third = (end - start) / 3.0
    slope = (pose.mean(end - third, end) - pose.mean(start, start + third)) / (2.0 * third)[..., None]
    return np.where(sample_count[..., None] < 2, 0.0, slope)


def pushes_recorded(onset: float, end: float) -> int:
    """Number of bins of the push before the end of a window [s]."""
    return sum(onset + edge <= end + 1e-9 for edge in PUSH_EDGES_S[1:])
