# SPDX-License-Identifier: Apache-2.0
"""Rollouts: growth of the error of a model's prediction, from measured states under the recorded torque.

From many moments of a measured motion the model is integrated in open loop, without feedback
(:mod:`impact_rs_sim.forward_dynamics`). The error after a horizon is predicted minus measured: positions of the joints
and pose of frame E. Stretches with contact are left out.

A constant error dtau of the torque, too small to change the pose noticeably, gives

    dq(t) = (M + B)^-1 dtau t^2 / 2

so in open loop a torque error grows with the square of time, an error of the initial velocity linearly, and the error
of an unstable motion exponentially. By this formula every position error is also given as the equivalent constant
torque, comparable with the residuals of the torque balance; in closed loop that torque is K_p dq.

Where position servos drive the joints and their targets were recorded, rollouts are in closed loop: the servos of the
model follow the targets, and the error settles instead of growing.

Sensor models are applied once: their inverse corrects the start and the torque, and the predicted positions pass them
forward (:mod:`impact_rs_sim.readings`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import NDArray
from pydantic import Field

from impact_rs_analysis.evidence.levels import rounded
from impact_rs_analysis.evidence.replays.replay import START_FIT_HALF_WIDTH_S, held_means
from impact_rs_sim.forward_dynamics import ForwardDynamics, Servo
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.readings import ArmReadings
from impact_rs_sim.robots.robot import Array, JointType
from impact_rs_sim.schema import Schema
from impact_rs_trials.recordings.servo import ServoLaw
from impact_rs_trials.runs import Run, none

HORIZONS_S = (0.1, 0.5, 2.0)
STEP_S = 0.005  # of the integrator; at 5 Hz, a usual low-pass, one step in 40 of a period
STEPS_PER_ERROR = 4  # from one evaluation of the error to the next
MAX_ROLLOUT_STARTS = 40  # 2 s of 32 rollouts of seven joints take 0.15 s of processor time, with friction 1 s
MAX_PHASE_PER_STEP = 0.5  # rad, of the fastest mode of servos; at 2 the step is unstable
MAX_SUBSTEPS = 8  # of a step; beyond, servos are too stiff to be rolled out
MAX_INERTIAS = 5  # of the starts, from which the fastest mode is taken
MIN_STARTS_APART = 6  # whose rollouts do not overlap; a paired test of fewer cannot be significant at 5 %
SPREAD_QUANTILES = (0.05, 0.95)  # over starts
OPEN_LOOP = "open loop: recorded torque drives the model from measured states, no controller pulls it back"
CLOSED_LOOP = "closed loop: servos drive the model from measured states towards the recorded desired positions"
# A rollout that is further off predicts nothing: it has diverged [rad, m].
MAX_JOINT_ERROR: dict[JointType, float] = {"revolute": 2.0 * np.pi, "prismatic": 1.0}
DIVERGED = "diverged (a joint off by more than a turn, or a metre)"
SHOWN_UNITS: dict[JointType, tuple[float, str]] = {"revolute": (180.0 / np.pi, "deg"), "prismatic": (1e3, "mm")}


@dataclass(frozen=True)
class FreeMotion:
    """A measured motion of one arm without contact, and the torque that drives it.

    Attributes:
        arm: Name of the arm.
        physics: Physics of the model.
        time: Samples, ``(k,)`` [s].
        position: Readings of q, ``(k, n)`` [rad].
        velocity: Readings of dq, ``(k, n)`` [rad/s].
        acceleration: Slope of ``velocity``, ``(k, n)`` [rad/s^2].
        torque_time: Samples of the torque, ``(m,)`` [s].
        torque: Recorded torque, ``(m, n)`` [N m].
        begin: First moment of a rollout [s].
        end: Last moment of a rollout [s].
        commanded: Whether the torque is a command, which is held until the next one.
        with_motor: Whether it accelerates the inertia of the motors.
        with_drive: Whether friction, gain and offset of the drives act on it.
        age: Time since the first run of the campaign [s].
        servo: Servos that drive it in closed loop, in place of a torque; None: open loop.
        q_desired: Their targets at ``torque_time``, ``(m, n)`` [rad]; empty without servos.
        dq_desired: Velocities of the targets, ``(m, n)`` [rad/s].
    """

    arm: str
    physics: Physics
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque_time: Array
    torque: Array
    begin: float
    end: float
    commanded: bool = False
    with_motor: bool = True
    with_drive: bool = True
    age: float = 0.0
    servo: ServoLaw | None = None
    q_desired: Array = field(default_factory=none)
    dq_desired: Array = field(default_factory=none)

    def servos(self, physics: Physics) -> Servo | None:
        """Torque of the servos on the motors, by time and true state; None: a recorded torque drives the motion.

        Args:
            physics: Physics of the model with effects: readings of the servos, delay, gain and offset of the drives.
        """
        if self.servo is None:
            return None
        arm, law = physics.arms[self.arm], self.servo
        readings, late = arm.readings, _command_delay(arm)
        targets = np.hstack((self.q_desired, self.dq_desired))
        desired = scipy.interpolate.make_interp_spline(self.torque_time, targets, k=1)

        def torque(time: Array, q: Array, dq: Array) -> Array:
            moments = np.clip(time - late, self.torque_time[0], self.torque_time[-1])
            target, rate = np.split(desired(moments), 2, axis=-1)
            speed = dq * readings.position_scale * readings.velocity_gain
            return np.asarray(
                arm.torque_gain * law.torque(readings.position(q), speed, target, rate) + arm.torque_offset
            )

        return torque

    def states(self, moments: Array, readings: ArmReadings) -> tuple[Array, Array]:
        """q and dq at moments ``(...,)`` from their readings, ``(..., n)`` each [rad, rad/s]."""
        position, velocity, slope = (
            scipy.interpolate.CubicSpline(self.time, values)(moments)
            for values in (self.position, self.velocity, self.acceleration)
        )
        scale = readings.position_scale * readings.velocity_gain
        return readings.position_of(position), (velocity + readings.velocity_late * slope) / scale

    def driving(self, edges: Array, physics: Physics) -> Array:
        """Mean of the torque that drives links and motors in every step, ``(K, S, n)`` [N m].

        Args:
            edges: Begin and end of the steps of every rollout, ``(K + 1, S)`` [s].
            physics: Physics of the model with effects.
        """
        arm = physics.arms[self.arm]
        if self.servo is not None:
            return np.zeros((len(edges) - 1, edges.shape[1], self.q_desired.shape[1]))
        if self.commanded:
            sent = self.torque_time + _command_delay(arm)
            mean = np.stack([held_means(sent, self.torque, rollout_edges) for rollout_edges in edges.T], axis=1)
        else:
            rate = np.gradient(self.torque, self.torque_time, axis=0)
            torque = arm.readings.torque_of(self.torque, rate, self.age)
            impulse = scipy.interpolate.CubicSpline(self.torque_time, torque).antiderivative()
            mean = np.diff(impulse(edges), axis=0) / np.diff(edges, axis=0)[..., None]
        return arm.torque_gain * mean + arm.torque_offset if self.with_drive else mean


def _command_delay(arm: ArmPhysics) -> float:
    """Time from the stamp of a command until it acts [s]."""
    return arm.readings.command_delay + arm.actuation_delay


@dataclass(frozen=True)
class RolledOut:
    """Errors of the rollouts of one motion, predicted minus measured, S starts, at T moments; NaN once diverged.

    Attributes:
        arm: Name of the arm.
        kinds: Types of its joints.
        joints: Readings of the joints, ``(T, S, n)`` [rad].
        torque: Constant torque that gives this error, ``(T, S, n)`` [N m].
        tool: Distance of frame E from its measured position, ``(T, S)`` [m].
        turned: Angle between predicted and measured orientation of E, ``(T, S)`` [rad].
        apart: Mask of a set of rollouts that do not overlap, ``(S,)``.
        closed: Whether servos close the loop.
    """

    arm: str
    kinds: tuple[JointType, ...]
    joints: Array
    torque: Array
    tool: Array
    turned: Array
    apart: NDArray[np.bool_]
    closed: bool = False

    def until(self, count: int) -> RolledOut:
        """The first moments alone."""
        errors = ("joints", "torque", "tool", "turned")
        return replace(self, **{name: getattr(self, name)[:count] for name in errors})


def shown(value: float) -> str:
    """Three digits, without an exponent where it is large."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


class JointRollout(Schema):
    """Error of one joint after a horizon, over the starts."""

    joint: str = Field(description="joint, with its arm where there are several")
    error: float = Field(description="root mean square over the starts [unit]")
    spread: tuple[float, float] = Field(description="5 and 95 % quantile of its size over the starts [unit]")
    unit: str = Field(description="deg, or mm of a joint that slides")
    as_torque: float = Field(description="constant torque that gives these errors, rms [N m, or N of one that slides]")


class RolloutHorizon(Schema):
    """Errors after a horizon."""

    horizon_s: float = Field(description="time after the start [s]")
    joints: tuple[JointRollout, ...] = Field(description="by joint")
    tool_mm: float = Field(description="distance of the end effector from where it was, rms [mm]")
    tool_spread_mm: tuple[float, float] = Field(description="5 and 95 % quantile over the starts [mm]")
    tool_deg: float = Field(description="rotation of the end effector against the measured one, rms [deg]")
    tool_spread_deg: tuple[float, float] = Field(description="5 and 95 % quantile over the starts [deg]")


class RolloutDocument(Schema):
    """Errors of rollouts."""

    what: str = Field(OPEN_LOOP, description="how the model is driven")
    starts: int = Field(description="measured states from which it starts")
    starts_apart: int = Field(description="of these, states whose rollouts do not overlap at the longest horizon")
    diverged: int = Field(0, description=f"rollouts that are in no error: {DIVERGED}")
    all_diverged_after_s: float | None = Field(
        None, description="shortest horizon at which every rollout has diverged; null: some reach all horizons [s]"
    )
    step_s: float = Field(STEP_S, description="step of the integrator, of second order [s]")
    horizons: tuple[RolloutHorizon, ...] = Field(description="by horizon, those that the data allow")
    growth: Literal["power", "exponential"] | None = Field(
        None,
        description="which fits the growth of the joint errors better: t^exponent, or exp(rate t); null: one horizon",
    )
    exponent: float | None = Field(
        None, description="of the time: 1 for an error of the velocity at the start, 2 for a constant torque error [-]"
    )
    rate_per_s: float | None = Field(None, description="of the exponential [1/s]")
    time_s: tuple[float, ...] = Field(description="moments of tool_mm [s]")
    tool_mm: tuple[float, ...] = Field(description="distance of the end effector over time, rms over starts [mm]")

    @property
    def last(self) -> RolloutHorizon:
        """Errors after the longest horizon."""
        return self.horizons[-1]

    @property
    def loop(self) -> str:
        """``open loop``, or ``closed loop`` where servos drive the model along recorded targets."""
        return self.what.partition(":")[0]

    @property
    def growth_in_words(self) -> str:
        """Its law of growth; empty for one horizon."""
        if self.exponent is None or self.rate_per_s is None:
            return ""
        if self.growth == "exponential":
            return f"grows exponentially, with {self.rate_per_s:.2g}/s"
        return f"grows with time to the power {self.exponent:.1f}"

    @property
    def in_words(self) -> str:
        """Errors at all horizons in one line."""
        tool = " / ".join(f"{shown(horizon.tool_mm)}" for horizon in self.horizons)
        angle = " / ".join(f"{shown(horizon.tool_deg)}" for horizon in self.horizons)
        number, worst = max(enumerate(self.last.joints), key=lambda joint: joint[1].error)
        joint = " / ".join(shown(horizon.joints[number].error) for horizon in self.horizons)
        time = " / ".join(f"{horizon.horizon_s:g}" for horizon in self.horizons)
        text = (
            f"rollouts in {self.loop} from {self.starts} measured states, after {time} s: tool off by "
            f"{tool} mm and {angle} deg, {worst.joint} by {joint} {worst.unit} (rms)"
        )
        return "; ".join(filter(None, [text, self.growth_in_words, self.diverged_in_words]))

    @property
    def diverged_in_words(self) -> str:
        """Number of diverged rollouts, and the horizon that no rollout reaches; empty: all reach all horizons."""
        diverged = f"{self.diverged} of {self.starts} have {DIVERGED} and are left out" if self.diverged else ""
        after = f"after {self.all_diverged_after_s:g} s all have {DIVERGED}" if self.all_diverged_after_s else ""
        return "; ".join(filter(None, [diverged, after]))


@dataclass(frozen=True)
class Rollouts:
    """Errors of rollouts of several motions.

    Attributes:
        time: Moments after the start, ``(T,)`` [s].
        parts: By motion, or part of one.
        all_diverged_after: Shortest horizon at which every rollout of an arm has diverged; None: some reach all [s].
    """

    time: Array
    parts: tuple[RolledOut, ...]
    all_diverged_after: float | None = None

    @property
    def apart(self) -> NDArray[np.bool_]:
        """Which starts have rollouts that do not overlap, ``(S,)``."""
        return np.concatenate([part.apart for part in self.parts])

    @property
    def tool(self) -> Array:
        """Distance of frame E from its measured position, ``(T, S)`` [m]."""
        return np.concatenate([part.tool for part in self.parts], axis=1)

    def document(self) -> RolloutDocument:
        """The errors as a document."""
        tool = self.tool
        valid = np.isfinite(tool).all(axis=0)
        over_time = 1e3 * _rms(tool[:, valid])
        closed = self.parts[0].closed
        power, rate, law = (None, None, None) if closed else _growth(self.time, self._joint_growth)
        return RolloutDocument(
            what=CLOSED_LOOP if closed else OPEN_LOOP,
            starts=tool.shape[1],
            starts_apart=int(self.apart.sum()),
            diverged=int(np.sum(~valid)),
            all_diverged_after_s=self.all_diverged_after,
            horizons=tuple(self._horizon(row) for row in self.rows),
            growth=law,
            exponent=power,
            rate_per_s=rate,
            time_s=tuple(rounded(float(moment)) for moment in self.time),
            tool_mm=tuple(rounded(float(value)) for value in over_time),
        )

    @property
    def rows(self) -> list[int]:
        """Rows of the horizons that the data allow, among the moments."""
        reached = [horizon for horizon in HORIZONS_S if horizon <= self.time[-1] + 1e-9]
        return [int(np.argmin(np.abs(self.time - horizon))) for horizon in reached]

    @property
    def _joint_growth(self) -> Array:
        """Mean over the joints of the logarithm of their rms errors over starts, ``(T,)``; units shift it only."""
        curves = []
        for arm in dict.fromkeys(part.arm for part in self.parts):
            errors = np.concatenate([part.joints for part in self.parts if part.arm == arm], axis=1)
            valid = np.isfinite(errors).all(axis=(0, 2))
            curves.append(_rms(errors[:, valid].swapaxes(1, 2)))
        joints = np.hstack(curves)
        moved = joints[:, np.all(joints > 0.0, axis=0)]
        return np.asarray(np.log(moved).mean(axis=1)) if moved.size else np.full(self.time.size, np.nan)

    def _horizon(self, row: int) -> RolloutHorizon:
        tool, turned = (
            np.concatenate([getattr(part, name)[row] for part in self.parts]) for name in ("tool", "turned")
        )
        tool, turned = 1e3 * tool[np.isfinite(tool)], np.rad2deg(turned[np.isfinite(turned)])
        return RolloutHorizon(
            horizon_s=rounded(float(self.time[row])),
            joints=tuple(self._joints(row)),
            tool_mm=rounded(float(_rms(tool))),
            tool_spread_mm=_spread(tool),
            tool_deg=rounded(float(_rms(turned))),
            tool_spread_deg=_spread(turned),
        )

    def _joints(self, row: int) -> list[JointRollout]:
        """Errors of the joints of all arms after a horizon."""
        joints = []
        kinds = {part.arm: part.kinds for part in self.parts}
        for arm, joint_kinds in kinds.items():
            parts = [part for part in self.parts if part.arm == arm]
            errors, torques = (
                np.concatenate([getattr(part, name)[row] for part in parts]) for name in ("joints", "torque")
            )
            valid = np.isfinite(errors).all(axis=1)
            for number, kind in enumerate(joint_kinds):
                factor, unit = SHOWN_UNITS[kind]
                error = factor * errors[valid, number]
                joints.append(
                    JointRollout(
                        joint=f"{arm + '.' if len(kinds) > 1 else ''}joint{number + 1}",
                        error=rounded(float(_rms(error))),
                        spread=_spread(error),
                        unit=unit,
                        as_torque=rounded(float(_rms(torques[valid, number]))),
                    )
                )
        return joints


def _rms(values: Array) -> Array:
    """Root mean square over the last axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=-1)))


def _spread(values: Array) -> tuple[float, float]:
    """Quantiles of the sizes of errors."""
    low, high = np.quantile(np.abs(values), SPREAD_QUANTILES)
    return rounded(float(low)), rounded(float(high))


def _growth(time: Array, log_error: Array) -> tuple[float | None, float | None, Literal["power", "exponential"] | None]:
    """Exponent of the time, rate [1/s], and the law that fits better, by least squares of the logarithm."""
    rows = (time >= HORIZONS_S[0] - 1e-9) & np.isfinite(log_error)
    if np.count_nonzero(rows) < 3:
        return None, None, None
    log_error, time = log_error[rows], time[rows]
    (exponent, _), of_power, *_ = np.polyfit(np.log(time), log_error, 1, full=True)
    (rate, _), of_exponential, *_ = np.polyfit(time, log_error, 1, full=True)
    law: Literal["power", "exponential"] = "power" if of_power.sum() <= of_exponential.sum() else "exponential"
    return rounded(float(exponent)), rounded(float(rate)), law


def starts_of(motions: Sequence[FreeMotion]) -> tuple[float, list[Array]]:
    """Longest horizon that the motions allow [s], and starts of rollouts, evenly over each of them [s].

    Args:
        motions: The motions, or parts of them.

    Returns:
        The longest horizon with enough rollouts that do not overlap, and starts by motion; 0: no such horizon.
    """
    lengths = np.array([max(motion.end - motion.begin, 0.0) for motion in motions])
    fitting = [h for h in HORIZONS_S if np.sum(np.floor(lengths / h + 1e-9)) >= MIN_STARTS_APART]
    nothing = [np.zeros(0)] * len(motions)
    if not fitting:
        return 0.0, nothing
    horizon = fitting[-1]
    usable = np.flatnonzero(lengths >= horizon - 1e-9)
    if usable.size > MAX_ROLLOUT_STARTS:
        usable = usable[np.linspace(0, usable.size - 1, MAX_ROLLOUT_STARTS).astype(int)]
    room = np.maximum(lengths - horizon, 0.0)
    spacing = float(room[usable].sum()) / max(MAX_ROLLOUT_STARTS - usable.size, 1)
    if 0.0 < spacing < horizon:  # a whole number of spacings per horizon: one rollout begins where another ends
        spacing = horizon / int(horizon / spacing)
    starts = list(nothing)
    for number in usable.tolist():
        count = 1 + (int(room[number] / spacing + 1e-9) if spacing > 0.0 else 0)
        first = motions[number].begin + 0.5 * (room[number] - (count - 1) * spacing)
        starts[number] = first + spacing * np.arange(count)
    return horizon, starts


def rolled_out(
    motion: FreeMotion, starts: Array, horizon: float, physics: Physics, step: float = STEP_S
) -> RolledOut | None:
    """Errors of the rollouts of a motion; None without a start.

    Args:
        motion: The motion.
        starts: Moments at which rollouts start, ``(S,)`` [s].
        horizon: Their duration [s].
        physics: Physics of the model with effects.
        step: Step of the integrator [s].

    Raises:
        NotABody: Mass and inertia of an end effector are not physical.
    """
    if not starts.size:
        return None
    arm = physics.arms[motion.arm]
    readings = arm.readings
    dynamics = ForwardDynamics(physics, motion.arm, motion.with_motor, motion.with_drive)
    q, dq = motion.states(starts, readings)
    if motion.servo is not None:
        step = step / _substeps(step, motion.servo, dynamics.inertia(q[:MAX_INERTIAS]))
    steps = round(horizon / step)
    edges = starts + step * np.arange(steps + 1)[:, None]
    with np.errstate(all="ignore"):  # a rollout may diverge
        path, _ = dynamics.motion(starts, q, dq, motion.driving(edges, physics), step, motion.servos(physics))
    stride = round(STEPS_PER_ERROR * STEP_S / step)
    path, moments = path[stride::stride], edges[stride::stride]
    measured, _ = motion.states(moments, readings)
    error, after = path - measured, moments - starts
    limits = [MAX_JOINT_ERROR[kind] for kind in arm.facts.joint_types]
    error[np.logical_or.accumulate(~np.all(np.abs(error) <= limits, axis=2))] = np.nan
    tool, turned = _tool_errors(dynamics, measured + error, measured)
    if motion.servo is not None:
        torque = motion.servo.kp * error
    else:
        torque = np.einsum("sij,tsj->tsi", dynamics.inertia(q), error) * 2.0 / np.square(after)[..., None]
    return RolledOut(
        arm=motion.arm,
        kinds=arm.facts.joint_types,
        joints=readings.position_scale * error,
        torque=torque,
        tool=tool,
        turned=turned,
        apart=_apart(starts, horizon),
        closed=motion.servo is not None,
    )


def _substeps(step: float, servo: ServoLaw, inertia: Array) -> int:
    """Parts of a step [s] in which the fastest mode of servos on the arm, of inertia ``(S, n, n)``, is stable."""
    fastest = np.sqrt(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(servo.kp))))))
    return int(np.clip(np.ceil(step * fastest / MAX_PHASE_PER_STEP), 1, MAX_SUBSTEPS))


def _tool_errors(dynamics: ForwardDynamics, predicted: Array, measured: Array) -> tuple[Array, Array]:
    """Distance and angle between predicted and measured frame E, ``(T, S)`` each [m, rad]."""
    distance, angle = np.full(predicted.shape[:2], np.nan), np.full(predicted.shape[:2], np.nan)
    for index in np.ndindex(distance.shape):
        if np.isfinite(predicted[index]).all():
            a, b = (dynamics.model.placement(q[index]) for q in (predicted, measured))
            distance[index] = np.linalg.norm(a.translation - b.translation)
            angle[index] = np.linalg.norm(pin.log3(a.rotation.T @ b.rotation))
    return distance, angle


def _apart(starts: Array, horizon: float) -> NDArray[np.bool_]:
    """Starts whose rollouts do not overlap, from the first on, ``(S,)``."""
    apart, free_from = np.zeros(starts.size, dtype=bool), -np.inf
    for number, start in enumerate(starts):
        if start >= free_from - 1e-9:
            apart[number], free_from = True, start + horizon
    return apart


def rollouts_of(motions: Sequence[FreeMotion], physics: Sequence[Physics] | None = None) -> Rollouts | None:
    """Rollouts of motions, up to the longest horizon that some rollout of every arm reaches; None: no horizon.

    Args:
        motions: The motions, or parts of them.
        physics: Physics of every motion with effects; None: physics of the model.

    Raises:
        NotABody: Mass and inertia of an end effector are not physical.
    """
    horizon, starts = starts_of(motions)
    of = [motion.physics for motion in motions] if physics is None else physics
    parts = [
        part
        for motion, motion_starts, world in zip(motions, starts, of, strict=True)
        if (part := rolled_out(motion, motion_starts, horizon, world)) is not None
    ]
    step = STEPS_PER_ERROR * STEP_S
    ends = [round(horizon_s / step) for horizon_s in HORIZONS_S if horizon_s <= horizon]
    reached = [end for end in ends if _all_reach(parts, end - 1)]
    if not reached:
        return None
    last, all_diverged_after = reached[-1], next((step * end for end in ends if end > reached[-1]), None)
    return Rollouts(step * np.arange(1.0, last + 1), tuple(part.until(last) for part in parts), all_diverged_after)


def _all_reach(parts: Sequence[RolledOut], row: int) -> bool:
    """Whether some rollout of every arm has not diverged at a moment."""
    reaching = {part.arm for part in parts if np.isfinite(part.tool[row]).any()}
    return reaching == {part.arm for part in parts}


def free_of_contact(run: Run, impacts: Mapping[str, float], physics: Physics, age: float = 0.0) -> list[FreeMotion]:
    """Motions of the arms of a run up to its first impact, smoothed by local polynomials (Savitzky and Golay 1964).

    Args:
        run: The run.
        impacts: Begin of the impact by arm [s]; empty in free motion.
        physics: Physics of the model.
        age: Time since the first run of the campaign [s].
    """
    time, width = run.signals.time, START_FIT_HALF_WIDTH_S
    begin, end = float(time[0]) + width, min([*impacts.values(), float(time[-1])]) - width
    window = 1 + 2 * max(2, round(width / run.period))
    motions = []
    for name, arm in run.signals.arms.items():
        position = scipy.signal.savgol_filter(arm.position, window, 3, axis=0)
        velocity = scipy.signal.savgol_filter(arm.velocity, window, 2, axis=0)
        slope = scipy.signal.savgol_filter(arm.velocity, window, 2, deriv=1, delta=run.period, axis=0)
        sent, torque = (arm.command_time, arm.command) if run.commanded else (time, arm.torque)
        motions.append(
            FreeMotion(
                arm=name,
                physics=physics,
                time=time,
                position=position,
                velocity=velocity,
                acceleration=slope,
                torque_time=sent,
                torque=torque,
                begin=begin,
                end=end,
                commanded=run.commanded,
                with_motor=run.commanded,
                with_drive=run.commanded,
                age=age,
            )
        )
    return motions


def without(motion: FreeMotion, gaps: Sequence[tuple[float, float]]) -> list[FreeMotion]:
    """The parts of a motion between gaps of its recording."""
    edges = [motion.begin, *(edge for gap in sorted(gaps) for edge in gap), motion.end]
    ends = [(max(low, motion.begin), min(high, motion.end)) for low, high in zip(edges[::2], edges[1::2], strict=True)]
    return [replace(motion, begin=low, end=high) for low, high in ends if high > low]
