# SPDX-License-Identifier: Apache-2.0
"""Checks of a recorded arm, joint by joint, that need no friction model: signs, units, lags and repeated samples.

* *Velocity* is the derivative of position. After moving averages, for encoders are quantised, each joint is fitted by

      v = a (dq/dt - L d^2q/dt^2)

  to first order in a lag L. a is 1 and L is 0; both have the standard errors of the fit. Without correlation,
  columns were mixed up.
* *Torque* includes the gravity torque g(q), known by positions alone: sum g tau / sum g^2 = 1. A load that the mapping
  lacks is no factor of a joint: if mass and first moments at the end effector predict the other half of the poses
  better, the load is the remedy.
  Nor are directions and zeros of another convention (:mod:`joint_conventions`): they explain all torques together.
* *Energy*: a torque drives a joint against its friction, so that the power (tau - g) v is rarely negative. Without
  gravity torque, as at a vertical axis, the sign of that correlation decides.
* *Lag of torque*: tau(t + L) is fitted by rigid-body torque, inertia of the motor, Coulomb and viscous friction and an
  offset in every joint; L minimises sum_j log sum r_j^2 in cross-validation (two folds of blocks).
  A lag is reported if it predicts better than all of these without a lag.
* *Repeated samples*: all joints keep their numbers and then change by much more than the resolution, over and over.

A ratio far from 1 is reported only if the two signals are correlated; noise and friction lower the correlation and
do not invert its sign.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.joint_conventions import convention_warning
from impact_rs_trials.recordings.checks.plausibility import GRAVITY_SAMPLES, gravity_torques, noticed
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.relations import (
    DECISIVE_LOG_LIKELIHOOD,
    MAX_CORRELATION_DRIVING,
    MAX_FACTOR_ERROR,
    MIN_CORRELATION,
    MIN_REPORTED_SIGMA,
    PLAUSIBLE_FACTORS,
    AveragedMotion,
    averaged,
    correlation,
    dry_friction,
    evenly,
    fit,
    fit_with_lag,
    held_out_misfit,
    moves,
    odd_blocks,
)
from impact_rs_trials.recordings.remarks import Remark, joined, remark
from impact_rs_trials.runs import ArmSignals

MIN_REPORTED_LAG = (0.005, 1.0)  # s, and sampling periods
MAX_LAG_S = 0.1
MAX_COMMAND_LAG_S = 0.6  # of the commands of servos; a driver of a real arm took 0.53 s
MIN_LAG_SAMPLES = 100
MAX_TORQUE_SAMPLES = 1000  # in which torques are compared
MAX_REPEATED_SHARE = 0.02  # of the samples: a moving joint repeats none, whatever its encoder
MIN_MISSED_STEPS = 10.0  # of the resolution; a larger change was missed by the samples before
MIN_REST_S = 0.2  # of equal samples that are a rest


def arm_warnings(time: Array, arm: ArmSignals, mapping: Mapping, model: RobotModel, contact: bool = False) -> list[str]:
    """Warnings about the signals of an arm: joint, size of the error, and the remedy in the mapping.

    Args:
        time: Stamps, ``(k,)`` [s].
        arm: Recorded position, velocity and torque.
        mapping: Knows the robot.
        model: Nominal arm, for its gravity torque.
        contact: Whether contacts push the arm, so that torques show neither gravity nor friction.
    """
    rows = evenly(time.size, GRAVITY_SAMPLES)
    gravity, derived = gravity_torques(model, arm.position[rows]), np.gradient(arm.position, time, axis=0)
    moving = moves(derived, mapping.facts)
    motion, means = AveragedMotion.of(time, arm.position), averaged(time, arm.velocity)[1]
    velocity = motion.velocity_relation(time, arm.velocity)
    late, lag, lag_error = fit_with_lag(motion.velocity, motion.acceleration, means, motion.independent)
    speeds: dict[int, str] = {}
    mixed = []
    torques: dict[int, str] = {}
    lags: list[tuple[float, float]] = []
    factors = {"velocity": np.ones(moving.size), "torque": np.ones(moving.size)}
    for joint in range(moving.size):
        own, heavy = gravity[:, joint], _rms(gravity[:, joint]) > noticed(model)
        together = abs(float(velocity.correlation[joint]))
        if moving[joint] and together >= MIN_CORRELATION:
            ratio, error = float(late.factor[joint]), float(late.standard_error[joint])
            if abs(ratio - 1.0) > max(MAX_FACTOR_ERROR, MIN_REPORTED_SIGMA * error):
                words = "is {:.3g} times the derivative of its position (+- {:.1g}), expected 1"
                speeds[joint] = remark(words, ratio, error)
                factors["velocity"][joint] = _remedy(ratio)
            lags.append((float(lag[joint]), float(lag_error[joint])))
        elif moving[joint]:
            mixed.append(remark("of joint {} (correlation {:.2f})", str(joint + 1), together))
        if contact or not np.ptp(arm.torque[:, joint]):  # not measured
            continue
        if heavy and (ratio_of_gravity := _ratio(arm.torque[rows, joint], own)) is not None:
            torques[joint] = remark("is {:.2g} times the gravity torque, expected 1", ratio_of_gravity)
            factors["torque"][joint] = _remedy(ratio_of_gravity)
        driving = factors["velocity"][joint] * arm.velocity[rows, joint]
        against = correlation(arm.torque[rows, joint] - own, driving)
        if moving[joint] and not heavy and against < MAX_CORRELATION_DRIVING:
            torques[joint] = remark("points against its motion (correlation {:.2f}), as if friction drove it", against)
            factors["torque"][joint] = -1.0
    load = None if contact else convention_warning(model, motion, averaged(time, arm.torque)[1], mapping)
    if torques and load is None:
        load = _load(model, arm, rows, gravity, torques)
    is_not = "velocity {} is not the derivative of its position: columns of other joints?"
    period = float(np.median(np.diff(time)))
    return [
        *([remark(is_not, joined(", ", mixed))] if mixed and "velocity" in mapping.signals else []),
        *_with_remedy("velocity", speeds, factors["velocity"], mapping),
        *(_with_remedy("torque", torques, factors["torque"], mapping) if load is None else [load]),
        *(_lag_of_velocity(lags, period, mapping) if "velocity" in mapping.signals else []),
        *([] if contact or torques or not any(moving) else _lag_of_torque(time, arm, moving, model, mapping)),
        *_repeats(time, arm),
    ]


def _load(
    model: RobotModel, arm: ArmSignals, rows: NDArray[np.signedinteger], gravity: Array, flagged: dict[int, str]
) -> Remark | None:
    """Warning about a load that explains torques better than factors of the flagged joints; None: it does not.

    Both are judged by cross-validation over blocks of the poses.
    """
    joints = np.flatnonzero(np.ptp(arm.torque, axis=0) > 0.0)
    torque = arm.torque[rows][:, joints]
    every = np.array([_torques_of_a_load(model, q)[joints] for q in arm.position[rows]])
    odd, beyond = odd_blocks(rows.size), torque - gravity[:, joints]
    load = held_out_misfit(every.reshape(-1, 4), beyond.reshape(-1, 1), np.repeat(odd, joints.size))
    left = {"load": float(load[0]), "factors": 0.0}
    for place, joint in enumerate(joints):
        own = gravity[:, [joint]]
        factors = held_out_misfit(own, torque[:, [place]], odd) if joint in flagged else np.square(beyond[:, place])
        left["factors"] += float(np.sum(factors))
    mass = float(np.linalg.lstsq(every.reshape(-1, 4), beyond.ravel(), rcond=None)[0][0])
    if mass <= 0.0 or left["load"] >= left["factors"]:
        return None
    rms = {what: float(np.sqrt(squares / beyond.size)) for what, squares in left.items()}
    return remark(
        "torques hold {:.2g} kg more at the end effector than the mapping says: a load and its place predict them "
        "better ({:.2g} N m rms left) than factors of joints {} do ({:.2g} N m). Remedy in the mapping: end_effector, "
        "if it is known; diagnose finds it, if it is not",
        mass, rms["load"], ", ".join(str(joint + 1) for joint in flagged), rms["factors"],
    )  # fmt: skip


def _torques_of_a_load(model: RobotModel, position: Array) -> Array:
    """Regressor of a load: torques by 1 kg at the end effector, and by first moments of 1 kg m, ``(n, 4)``."""
    jacobian, up = model.jacobian(position), -np.asarray(model.pinocchio.gravity.linear)
    moments = np.cross(model.placement(position).rotation.T, up)  # of every axis
    return np.column_stack((jacobian[:3].T @ up, jacobian[3:].T @ moments.T))


def _lag_of_velocity(lags: list[tuple[float, float]], period: float, mapping: Mapping) -> list[str]:
    """Lag of velocities behind positions, pooled over all joints."""
    if not lags:
        return []
    values, errors = np.array(lags).T
    weights = 1.0 / np.square(np.maximum(errors, 1e-6))
    lag = float(np.sum(weights * values) / np.sum(weights))
    spread = np.sqrt(float(np.sum(weights * np.square(values - lag)) / np.sum(weights)) / len(lags))
    error = float(np.hypot(1.0 / np.sqrt(np.sum(weights)), spread))
    if abs(lag) < max(MIN_REPORTED_LAG[0], MIN_REPORTED_LAG[1] * period, MIN_REPORTED_SIGMA * error):
        return []
    return [_late("velocities", "the derivative of the positions", lag, error, "velocity", mapping)]


def _lag_of_torque(
    time: Array, arm: ArmSignals, moving: NDArray[np.bool_], model: RobotModel, mapping: Mapping
) -> list[str]:
    """Lag of torques, or of the commands of servos, behind positions, pooled over all moving joints."""
    motion, torque = AveragedMotion.of(time, arm.position), averaged(time, arm.torque)[1]
    at, q, dq, ddq = motion.time, motion.position, motion.velocity, motion.acceleration
    servo = mapping.servo is not None
    if servo and "velocity" not in mapping.signals:  # noise of second derivatives looks like lag of a servo
        return []
    if servo:
        dq = averaged(time, arm.velocity)[1]
        ddq = np.gradient(dq, at, axis=0)
    most = MAX_COMMAND_LAG_S if servo else MAX_LAG_S
    inside = np.flatnonzero((at > at[0] + most) & (at < at[-1] - most))
    if inside.size < MIN_LAG_SAMPLES:
        return []
    rows = inside[evenly(inside.size, MAX_TORQUE_SAMPLES)]
    rigid = np.array([model.inverse_dynamics(q[row], dq[row], ddq[row]) for row in rows])
    period = float(np.median(np.diff(time)))
    tried = np.arange(-MAX_LAG_S, most, max(0.5 * period, 1e-3))
    law = mapping.servo_law
    late: list[Array] = []
    if law is not None:
        target, rate = (averaged(time, one)[1] for one in (arm.q_desired, arm.dq_desired))
        late = [law.late(at, q, dq, target, rate, lag)[rows] for lag in tried.tolist()]
    independent = min(rows.size, (at[rows[-1]] - at[rows[0]]) / (at[-1] - at[0]) * motion.independent)
    likelihood = np.zeros(tried.size)
    odd, friction = odd_blocks(rows.size), dry_friction(dq[rows])
    for joint in np.flatnonzero(moving & (np.ptp(arm.torque, axis=0) > 0.0)):
        columns = rigid[:, joint], ddq[rows, joint], friction[:, joint], dq[rows, joint], np.ones(rows.size)
        shifted = np.column_stack(
            [one[:, joint] for one in late]
            if servo
            else [np.interp(at[rows] + lag, at, torque[:, joint]) for lag in tried]
        )
        left = held_out_misfit(np.column_stack(columns), shifted, odd)
        likelihood -= 0.5 * independent * np.log(np.maximum(left, 1e-12))
    best = int(np.argmax(likelihood))
    gain, lag = likelihood[best] - float(np.interp(0.0, tried, likelihood)), float(tried[best])
    least = max(MIN_REPORTED_LAG[0], MIN_REPORTED_LAG[1] * period)
    if not 0 < best < tried.size - 1 or abs(lag) < least or gain < DECISIVE_LOG_LIKELIHOOD:
        return []
    step = tried[1] - tried[0]
    bend = -(likelihood[best - 1] - 2.0 * likelihood[best] + likelihood[best + 1]) / step**2
    error = float(np.hypot(step / np.sqrt(12.0), 1.0 / np.sqrt(max(bend, 1e-12))))
    if servo:
        return [_late_commands(lag, error, mapping)]
    return [_late("torques", "the torque that the motion takes", lag, error, "torque", mapping)]


def _late_commands(lag: float, error: float, mapping: Mapping) -> str:
    """The time from the stamps of commands until servos act on them, with its remedy."""
    return remark(
        "commands act {:.0f} ms (+- {:.1g} ms) {} their stamps, by the torque that the motion takes. Remedy in the "
        "mapping: signals.q_desired.delay: {!r:.4g}, or diagnose, which names it actuation_delay",
        1e3 * abs(lag), 1e3 * error, "after" if lag > 0.0 else "before", mapping.signals["q_desired"].delay + lag,
    )  # fmt: skip


def _late(what: str, reference: str, lag: float, error: float, name: SignalName, mapping: Mapping) -> str:
    """A lag with its remedy."""
    return remark(
        "{} are {:.0f} ms (+- {:.1g} ms) {} {}: low-passed, or columns of different age? Remedy in the mapping: "
        "signals.{}.delay: {!r:.4g}",
        what, 1e3 * abs(lag), 1e3 * error, "behind" if lag > 0.0 else "ahead of", reference,
        name, mapping.signals[name].delay - lag,
    )  # fmt: skip


def _repeats(time: Array, arm: ArmSignals) -> list[str]:
    """Signals whose samples are repeated while the joints move."""
    found: dict[str, list[str]] = {}
    for name in ("position", "velocity", "torque"):
        if (text := _repeated(time, getattr(arm, name))) is not None:
            found.setdefault(text, []).append(name)
    return [remark("{} of all joints {}", ", ".join(names), text) for text, names in found.items()]


def _repeated(time: Array, values: Array) -> str | None:
    """Share of repeated samples, with the remedy; None: not repeated."""
    steps = np.abs(np.diff(values, axis=0))
    changed = np.flatnonzero(np.any(steps > 0.0, axis=1))
    if changed.size < 2:
        return None
    period = float(np.median(np.diff(time)))
    resolution = np.min(np.where(steps > 0.0, steps, np.inf), axis=0)
    lasts = np.diff(changed)  # samples with one value
    missed = np.any(steps[changed[1:]] > MIN_MISSED_STEPS * resolution, axis=1) & (lasts * period < MIN_REST_S)
    repeated = int(np.sum(lasts[missed] - 1))
    if repeated < MAX_REPEATED_SHARE * time.size:
        return None
    each = float(np.mean(lasts[missed]))
    return remark(
        "stay the same in {:.0f} % of the samples while the arm moves: every number stands {:.2g} times, as if "
        "measured at {:.3g} Hz and written at {:.3g} Hz. Remedy: of equal rows keep the first, or low_pass: {!r:.2g} "
        "in the mapping",
        100.0 * repeated / time.size, each, 1.0 / period / each, 1.0 / period, 0.25 / period / each,
    )  # fmt: skip


def _with_remedy(name: SignalName, warnings: dict[int, str], factors: Array, mapping: Mapping) -> list[str]:
    """One warning about a signal, with the correcting factors."""
    gains = name == "torque" and mapping.servo is not None
    if not warnings or (name not in mapping.signals and not gains):
        return []
    every = factors * np.array(mapping.servo.kp if mapping.servo and gains else mapping.signals[name].factor)
    key = "servo.kp" if gains else f"signals.{name}.factor"
    numbers = [remark("{!r:.3g}", value) for value in every.tolist()]
    remedy = numbers[0] if np.all(every == every[0]) else remark("[{}]", joined(", ", numbers))
    what = joined("; ", [remark("of joint {} {}", str(joint + 1), text) for joint, text in warnings.items()])
    why = "wrong sign, unit or joint" + (", or a load that the mapping lacks" if name == "torque" else "")
    if gains and np.any(every <= 0.0):
        words = "{} {}: {}? No positive {} corrects it: late commands, or torques that the controller adds?"
        return [remark(words, name, what, why, key)]
    return [remark("{} {}: {}? Remedy in the mapping: {}: {}", name, what, why, key, remedy)]


def _ratio(values: Array, expected: Array) -> float | None:
    """Factor between a signal and its expectation; None: about 1, or not correlated."""
    found = fit(expected[:, None], values[:, None])
    ratio, together = float(found.factor[0]), abs(float(found.correlation[0]))
    return None if PLAUSIBLE_FACTORS[0] < ratio < PLAUSIBLE_FACTORS[1] or together < MIN_CORRELATION else ratio


def _remedy(ratio: float) -> float:
    return -1.0 if PLAUSIBLE_FACTORS[0] < -ratio < PLAUSIBLE_FACTORS[1] else 1.0 / ratio


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
