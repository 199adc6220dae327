# SPDX-License-Identifier: Apache-2.0
"""Torque balance of an arm in free motion, for recordings without command and contact.

    tau(t + delay) + eps = (M(q) ddq + h(q, dq) [+ B ddq] - tau_fric(dq) - tau_load - offset) / gain

with q and dq at t (cf. paper eq. eom); tau is what was recorded, B counts only where it was measured at the motor.
Positions, velocities and torques pass the same zero-phase low-pass (Butterworth, order 4, forwards and backwards),
accelerations are central differences of the filtered velocity, the prediction passes the low-pass once more and so does
the recorded torque; both ends are cut off.

Effects are applied through :class:`~impact_rs_sim.physics.Physics`, as in plant and twin. An effect that changes no
torque counts as not measured.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import LoadState, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.recording import ARM, TooShort
from impact_rs_trials.runs import Run

ORDER = 4
GRID = 10.0  # samples per period of the cut-off frequency, at most
EDGE = 2.0  # periods of the cut-off frequency, cut off at both ends
BAND = (1.5, 3.0)  # times the cut-off frequency, where the noise is measured
MOST_REGRESSORS = 2  # kept: of the model, and of another direction of gravity


@dataclass(frozen=True)
class Motion:
    """Filtered signals of one recording on an even grid, ``(k, n)`` unless stated.

    Attributes:
        time: Since the first sample, ``(k,)`` [s].
        position: q [rad].
        velocity: dq [rad/s].
        acceleration: ddq [rad/s^2].
        torque: Recorded torque, low-passed twice [N m].
        kept: Mask of the samples between the edges.
        noise: Noise of the recorded torque in ``torque``, ``(n,)`` [N m].
        measured: Whether the torque of a joint was measured, ``(n,)``; one that never changes was not.
        cut_off: Of the low-pass [Hz].
        rate: Of the grid [Hz].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    kept: slice
    noise: Array
    measured: NDArray[np.bool_]
    cut_off: float
    rate: float

    def low_pass(self, values: Array) -> Array:
        """The low-pass on the grid."""
        return _low_pass(values, self.cut_off, self.rate)


def _low_pass(values: Array, cut_off: float, rate: float) -> Array:
    return np.asarray(scipy.signal.sosfiltfilt(_butterworth(cut_off, rate), values, axis=0))


@functools.lru_cache(maxsize=16)
def _butterworth(cut_off: float, rate: float) -> Array:
    """The filter in second-order sections, cached: a search filters thousands of predictions."""
    return np.asarray(scipy.signal.butter(ORDER, cut_off, fs=rate, output="sos"))


def prepare(run: Run, cut_off: float) -> Motion:
    """Filter and differentiate a recording of free motion.

    Raises:
        TooShort: Too short for the cut-off.
        InputError: Sampled too slowly for it.
    """
    arm = run.signals.arms[ARM]
    start = run.signals.time - run.signals.time[0]
    sampled = 1.0 / float(np.median(np.diff(start)))
    if cut_off > 0.3 * sampled:
        raise InputError(
            f"sampled at {sampled:.3g} Hz, too slow for low_pass = {cut_off:g} Hz; at most {0.3 * sampled:.2g} Hz",
            file=run.path,
        )
    even = np.arange(0.0, start[-1], 1.0 / sampled)

    def resampled(values: Array) -> Array:
        return np.column_stack([np.interp(even, start, column) for column in values.T])

    raw = resampled(arm.torque)
    once = _low_pass(raw, cut_off, sampled)
    noise = _noise(raw, cut_off, sampled)
    stride = max(1, int(sampled / (GRID * cut_off)))
    rate = sampled / stride
    q, dq = (_low_pass(resampled(values), cut_off, sampled)[::stride] for values in (arm.position, arm.velocity))
    edge = int(np.ceil(EDGE * rate / cut_off))
    if q.shape[0] < 2 * edge + 60:
        raise TooShort(
            f"{start[-1]:.3g} s long, at least {(2 * edge + 60) / rate:.2g} s needed with low_pass = {cut_off:g} Hz",
            file=run.path,
        )
    return Motion(
        time=even[::stride],
        position=q,
        velocity=dq,
        acceleration=np.gradient(dq, 1.0 / rate, axis=0),
        torque=_low_pass(once[::stride], cut_off, rate),
        kept=slice(edge, q.shape[0] - edge),
        noise=noise,
        measured=np.ptp(arm.torque, axis=0) > 0.0,
        cut_off=cut_off,
        rate=rate,
    )


def _noise(raw: Array, cut_off: float, rate: float) -> Array:
    """Noise below the cut-off, from its power just above, where smooth motion is absent, ``(n,)`` [N m].

    The median over short windows leaves out those in which a joint turns back: dry friction jumps there, and is no
    noise.
    """
    highest = 0.45 * rate
    band = (BAND[0] * cut_off, BAND[1] * cut_off) if BAND[1] * cut_off < highest else (1.2 * cut_off, highest)
    passed = scipy.signal.sosfiltfilt(
        scipy.signal.butter(ORDER, band, btype="bandpass", fs=rate, output="sos"), raw, axis=0
    )
    count = max(1, int(raw.shape[0] * cut_off / rate))
    power = np.array([np.mean(np.square(window), axis=0) for window in np.array_split(passed, count)])
    return np.asarray(np.sqrt(np.median(power, axis=0) * cut_off / (band[1] - band[0])))


def _delayed(values: Array, time: Array, delay: float) -> Array:
    """Low-passed signals later by a delay, which is shorter than the edges that are cut off."""
    return np.asarray(scipy.interpolate.CubicSpline(time, values)(time - delay)) if delay else values


def _state(motion: Motion, model: RobotModel, impact_position: Array) -> tuple[LoadState, Array]:
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
    """

    def __init__(self, motions: list[Motion], at_motor: bool = False) -> None:
        self.motions, self._at_motor = motions, at_motor
        self.joints = np.flatnonzero(np.any([motion.measured for motion in motions], axis=0))
        self._regressors: dict[bytes, list[Array]] = {}
        self._known_states: dict[bytes, list[tuple[LoadState, Array]]] = {}
        self._kept: tuple[tuple[object, ...], RobotModel] | None = None

    def predict(self, physics: Physics) -> Array:
        """Predicted recorded torque of :attr:`joints`, all motions stacked between their edges, ``(k, m)`` [N m]."""
        return np.concatenate(
            [
                torque[motion.kept][:, self.joints]
                for motion, torque in zip(self.motions, self.predicted(physics), strict=True)
            ]
        )

    def predicted(self, physics: Physics) -> list[Array]:
        """Predicted recorded torque of every motion, with its edges, ``(k, n)`` [N m]."""
        arm = physics.arms[ARM]
        rows = []
        for number, (motion, rigid) in enumerate(zip(self.motions, self._rigid_torques(physics), strict=True)):
            torque = rigid + arm.motor_inertia_reduced * motion.acceleration if self._at_motor else rigid
            if not arm.friction.is_zero:
                torque = torque - arm.friction.torque(motion.velocity)
            if arm.loads:
                torque = torque - self._load_torques(physics, number, rigid)
            torque = motion.low_pass((torque - arm.torque_offset) / arm.torque_gain)
            rows.append(_delayed(torque, motion.time, arm.torque_delay))
        return rows

    def _model(self, physics: Physics) -> RobotModel:
        """Rigid-body model of the arm, kept while effects change other parts of the physics."""
        arm = physics.arms[ARM]
        parts = (arm.facts, arm.end_effector, arm.base, physics.gravity)
        if self._kept is None or any(one is not other for one, other in zip(parts, self._kept[0], strict=True)):
            self._kept = parts, physics.robot_model(ARM)
        return self._kept[1]

    def _rigid_torques(self, physics: Physics) -> list[Array]:
        """M ddq + h = Y pi, linear in the inertial parameters pi of all links, ``(k, n)`` each [N m]."""
        model = self._model(physics)
        parameters = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.pinocchio.inertias)[1:]])
        key = model.pinocchio.gravity.linear.tobytes()
        if key not in self._regressors:
            while len(self._regressors) >= MOST_REGRESSORS:
                self._regressors.pop(list(self._regressors)[1])  # the first is that of the model
            self._regressors[key] = [
                np.array(
                    [
                        pin.computeJointTorqueRegressor(model.pinocchio, model.data, *state)
                        for state in zip(motion.position, motion.velocity, motion.acceleration, strict=True)
                    ]
                ).reshape(*motion.position.shape, parameters.size)  # of one joint Pinocchio makes a vector
                for motion in self.motions
            ]
        return [regressor @ parameters for regressor in self._regressors[key]]

    def _load_torques(self, physics: Physics, number: int, rigid: Array) -> Array:
        """Torques of loads outside the rigid model on links and motors, ``(k, n)`` [N m].

        A law of the transmitted torque is given that of the links: the recorded one contains the friction of the motor
        and the noise of the very signal that the law shall explain.
        """
        state, jacobian = self._states(physics)[number]
        return np.add(*physics.arms[ARM].load_torques(replace(state, joint_torque=rigid), jacobian))

    def _states(self, physics: Physics) -> list[tuple[LoadState, Array]]:
        """Arguments of loads of every motion, and the linear part of the Jacobians, ``(k, 3, n)``."""
        arm, model = physics.arms[ARM], self._model(physics)
        start = np.zeros(arm.facts.joint_count)
        key = np.concatenate((model.placement(start).homogeneous.ravel(), arm.impact_position)).tobytes()
        if key not in self._known_states:
            self._known_states = {key: [_state(motion, model, arm.impact_position) for motion in self.motions]}
        return self._known_states[key]

    @property
    def recorded(self) -> Array:
        """Recorded torque of :attr:`joints` between the edges, ``(k, m)`` [N m]."""
        return np.concatenate([motion.torque[motion.kept][:, self.joints] for motion in self.motions])

    @property
    def velocity(self) -> Array:
        """Velocities of :attr:`joints` between the edges, ``(k, m)`` [rad/s]."""
        return np.concatenate([motion.velocity[motion.kept][:, self.joints] for motion in self.motions])

    @property
    def noise(self) -> Array:
        """Noise of the recorded torque of :attr:`joints` below the cut-off, ``(m,)`` [N m]."""
        return np.asarray(np.sqrt(np.mean([np.square(motion.noise[self.joints]) for motion in self.motions], axis=0)))
