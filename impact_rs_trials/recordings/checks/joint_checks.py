# SPDX-License-Identifier: Apache-2.0
"""Checks of a recorded arm, joint by joint, that need no friction model: signs, units, lags and repeated samples.

* *Velocity* is the derivative of position. After moving averages (encoders are quantised), each joint is fitted by

      v = a (dq/dt - L d^2q/dt^2)

  to first order in a lag L. Expected are a = 1 and L = 0, within the standard errors of the fit. Without correlation,
  columns were mixed up.
* *Torque* includes the gravity torque g(q) of the positions: sum g tau / sum g^2 = 1. Another ratio may be a factor of
  a joint, but also a load that the mapping lacks, if mass and first moments at the end effector predict the held-out
  half of the poses better; or directions and zeros of another convention (:mod:`joint_conventions`), if they explain
  the torques of all joints together.
* *Energy*: a torque drives a joint against its friction, so that the power (tau - g) v is rarely negative. Without
  gravity torque, as at a vertical axis, the sign of that correlation decides.
* *Lag of torque*: tau(t + L) is fitted by rigid-body torque, inertia of the motor, Coulomb and viscous friction and an
  offset in every joint; L minimises sum_j log sum r_j^2 in cross-validation (two folds of blocks).
  A lag is reported if it predicts better than the same fit without a lag.
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
MIN_MISSED_STEPS = 10.0  # of the resolution; the samples before a larger change were repeated
MIN_REST_S = 0.2  # of equal samples, from which the arm rests


def arm_warnings(time: Array, arm: ArmSignals, mapping: Mapping, model: RobotModel, contact: bool = False) -> list[str]:
    """Warnings about the signals of an arm: joint, size of the error, and the remedy in the mapping.

    Args:
        time: Stamps, ``(k,)`` [s].
        arm: Recorded position, velocity and torque.
        mapping: Knows the robot.
        model: Nominal arm, for its gravity torque.
        contact: Whether contact forces act on the arm, so that torques show neither gravity nor friction.
    """
    rows = evenly(time.size, GRAVITY_SAMPLES)
    gravity, derived = gravity_torques(model, arm.position[rows]), np.gradient(arm.position, time, axis=0)
    moving = moves(derived, mapping.facts)
    motion, means = AveragedMotion.of(time, arm.position), averaged(time, arm.velocity)[1]
    velocity = motion.velocity_relation(time, arm.velocity)
    relation, lag, lag_error = fit_with_lag(motion.velocity, motion.acceleration, means, motion.independent)
    velocity_faults: dict[int, str] = {}
    uncorrelated = []
    torque_faults: dict[int, str] = {}
    lags: list[tuple[float, float]] = []
    factors = {"velocity": np.ones(moving.size), "torque": np.ones(moving.size)}
    for joint in range(moving.size):
        gravity_torque, loaded = gravity[:, joint], _rms(gravity[:, joint]) > noticed(model)
        velocity_correlation = abs(float(velocity.correlation[joint]))
        if moving[joint] and velocity_correlation >= MIN_CORRELATION:
            ratio, error = float(relation.factor[joint]), float(relation.standard_error[joint])
            if abs(ratio - 1.0) > max(MAX_FACTOR_ERROR, MIN_REPORTED_SIGMA * error):
                words = "is {:.3g} times the derivative of its position (+- {:.1g}), expected 1"
                velocity_faults[joint] = remark(words, ratio, error)
                factors["velocity"][joint] = _remedy(ratio)
            lags.append((float(lag[joint]), float(lag_error[joint])))
        elif moving[joint]:
            uncorrelated.append(remark("of joint {} (correlation {:.2f})", str(joint + 1), velocity_correlation))
        if contact or not np.ptp(arm.torque[:, joint]):  # not measured
            continue
        if loaded and (ratio_of_gravity := _ratio(arm.torque[rows, joint], gravity_torque)) is not None:
            torque_faults[joint] = remark("is {:.2g} times the gravity torque, expected 1", ratio_of_gravity)
            factors["torque"][joint] = _remedy(ratio_of_gravity)
        driving = factors["velocity"][joint] * arm.velocity[rows, joint]
        power_correlation = correlation(arm.torque[rows, joint] - gravity_torque, driving)
        if moving[joint] and not loaded and power_correlation < MAX_CORRELATION_DRIVING:
            torque_faults[joint] = remark(
                "points against its motion (correlation {:.2f}), as if friction drove it", power_correlation
            )
            factors["torque"][joint] = -1.0
    load = None if contact else convention_warning(model, motion, averaged(time, arm.torque)[1], mapping)
    if torque_faults and load is None:
        load = _load(model, arm, rows, gravity, torque_faults)
    no_derivative = "velocity {} is not the derivative of its position: columns of other joints?"
    period, in_mapping = float(np.median(np.diff(time))), "velocity" in mapping.signals
    return [
        *([remark(no_derivative, joined(", ", uncorrelated))] if uncorrelated and in_mapping else []),
        *_with_remedy("velocity", velocity_faults, factors["velocity"], mapping),
        *(_with_remedy("torque", torque_faults, factors["torque"], mapping) if load is None else [load]),
        *(_lag_of_velocity(lags, period, mapping) if in_mapping else []),
        *([] if contact or torque_faults or not any(moving) else _lag_of_torque(time, arm, moving, model, mapping)),
        *_repeats(time, arm),
    ]


def _load(
    model: RobotModel, arm: ArmSignals, rows: NDArray[np.signedinteger], gravity: Array, flagged: dict[int, str]
) -> Remark | None:
    """Warning about a load that explains torques better than factors of the flagged joints; None: no load does.

    Load and factors are compared by cross-validation over blocks of the poses.
    """
    joints = np.flatnonzero(np.ptp(arm.torque, axis=0) > 0.0)
    torque = arm.torque[rows][:, joints]
    regressor = np.array([_torques_of_a_load(model, q)[joints] for q in arm.position[rows]])
    odd, unexplained = odd_blocks(rows.size), torque - gravity[:, joints]
    load = held_out_misfit(regressor.reshape(-1, 4), unexplained.reshape(-1, 1), np.repeat(odd, joints.size))
    misfits = {"load": float(load[0]), "factors": 0.0}
    for column, joint in enumerate(joints):
        if joint in flagged:
            squares = held_out_misfit(gravity[:, [joint]], torque[:, [column]], odd)
        else:
            squares = np.square(unexplained[:, column])
        misfits["factors"] += float(np.sum(squares))
    mass = float(np.linalg.lstsq(regressor.reshape(-1, 4), unexplained.ravel(), rcond=None)[0][0])
    if mass <= 0.0 or misfits["load"] >= misfits["factors"]:
        return None
    rms = {name: float(np.sqrt(misfit / unexplained.size)) for name, misfit in misfits.items()}
    return remark(
        "torques hold {:.2g} kg more at the end effector than the mapping says: a load and its place predict them "
        "better (residual {:.2g} N m rms) than factors of joints {} ({:.2g} N m). Remedy in the mapping: end_effector, "
        "if the load is known; else diagnose finds it",
        mass, rms["load"], ", ".join(str(joint + 1) for joint in flagged), rms["factors"],
    )  # fmt: skip


def _torques_of_a_load(model: RobotModel, position: Array) -> Array:
    """Regressor of a load: torques by 1 kg at the end effector, and by first moments of 1 kg m, ``(n, 4)``."""
    jacobian, upwards = model.jacobian(position), -np.asarray(model.pinocchio.gravity.linear)
    moments = np.cross(model.placement(position).rotation.T, upwards)  # by the first moment along each axis
    return np.column_stack((jacobian[:3].T @ upwards, jacobian[3:].T @ moments.T))


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
    averaged_time, q, dq, ddq = motion.time, motion.position, motion.velocity, motion.acceleration
    servo = mapping.servo is not None
    if servo and "velocity" not in mapping.signals:  # noise of second derivatives looks like lag of a servo
        return []
    if servo:
        dq = averaged(time, arm.velocity)[1]
        ddq = np.gradient(dq, averaged_time, axis=0)
    max_lag = MAX_COMMAND_LAG_S if servo else MAX_LAG_S
    interior = np.flatnonzero(
        (averaged_time > averaged_time[0] + max_lag) & (averaged_time < averaged_time[-1] - max_lag)
    )
    if interior.size < MIN_LAG_SAMPLES:
        return []
    rows = interior[evenly(interior.size, MAX_TORQUE_SAMPLES)]
    rigid_torque = np.array([model.inverse_dynamics(q[row], dq[row], ddq[row]) for row in rows])
    period = float(np.median(np.diff(time)))
    lags = np.arange(-MAX_LAG_S, max_lag, max(0.5 * period, 1e-3))
    law = mapping.servo_law
    late_torques: list[Array] = []
    if law is not None:
        target, rate = (averaged(time, desired)[1] for desired in (arm.q_desired, arm.dq_desired))
        late_torques = [law.late(averaged_time, q, dq, target, rate, lag)[rows] for lag in lags.tolist()]
    covered = (averaged_time[rows[-1]] - averaged_time[rows[0]]) / (averaged_time[-1] - averaged_time[0])
    independent = min(rows.size, covered * motion.independent)
    likelihood = np.zeros(lags.size)
    odd, friction = odd_blocks(rows.size), dry_friction(dq[rows])
    for joint in np.flatnonzero(moving & (np.ptp(arm.torque, axis=0) > 0.0)):
        columns = rigid_torque[:, joint], ddq[rows, joint], friction[:, joint], dq[rows, joint], np.ones(rows.size)
        shifted = np.column_stack(
            [late_torque[:, joint] for late_torque in late_torques]
            if servo
            else [np.interp(averaged_time[rows] + lag, averaged_time, torque[:, joint]) for lag in lags]
        )
        misfit = held_out_misfit(np.column_stack(columns), shifted, odd)
        likelihood -= 0.5 * independent * np.log(np.maximum(misfit, 1e-12))
    best = int(np.argmax(likelihood))
    gain, lag = likelihood[best] - float(np.interp(0.0, lags, likelihood)), float(lags[best])
    min_lag = max(MIN_REPORTED_LAG[0], MIN_REPORTED_LAG[1] * period)
    if not 0 < best < lags.size - 1 or abs(lag) < min_lag or gain < DECISIVE_LOG_LIKELIHOOD:
        return []
    step = lags[1] - lags[0]
    curvature = -(likelihood[best - 1] - 2.0 * likelihood[best] + likelihood[best + 1]) / step**2
    error = float(np.hypot(step / np.sqrt(12.0), 1.0 / np.sqrt(max(curvature, 1e-12))))
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


def _late(signals: str, reference: str, lag: float, error: float, name: SignalName, mapping: Mapping) -> str:
    """A lag with its remedy."""
    return remark(
        "{} are {:.0f} ms (+- {:.1g} ms) {} {}: low-passed, or columns of different age? Remedy in the mapping: "
        "signals.{}.delay: {!r:.4g}",
        signals, 1e3 * abs(lag), 1e3 * error, "behind" if lag > 0.0 else "ahead of", reference,
        name, mapping.signals[name].delay - lag,
    )  # fmt: skip


def _repeats(time: Array, arm: ArmSignals) -> list[str]:
    """Signals whose samples are repeated while the joints move."""
    names_by_text: dict[str, list[str]] = {}
    for name in ("position", "velocity", "torque"):
        if (text := _repeated(time, getattr(arm, name))) is not None:
            names_by_text.setdefault(text, []).append(name)
    return [remark("{} of all joints {}", ", ".join(names), text) for text, names in names_by_text.items()]


def _repeated(time: Array, values: Array) -> str | None:
    """Share of repeated samples, with the remedy; None: not repeated."""
    steps = np.abs(np.diff(values, axis=0))
    changed = np.flatnonzero(np.any(steps > 0.0, axis=1))
    if changed.size < 2:
        return None
    period = float(np.median(np.diff(time)))
    resolution = np.min(np.where(steps > 0.0, steps, np.inf), axis=0)
    lengths = np.diff(changed)  # samples with one value
    missed = np.any(steps[changed[1:]] > MIN_MISSED_STEPS * resolution, axis=1) & (lengths * period < MIN_REST_S)
    repeated = int(np.sum(lengths[missed] - 1))
    if repeated < MAX_REPEATED_SHARE * time.size:
        return None
    repeats = float(np.mean(lengths[missed]))
    return remark(
        "stay the same in {:.0f} % of the samples while the arm moves: every number occurs {:.2g} times, as if "
        "measured at {:.3g} Hz and written at {:.3g} Hz. Remedy: keep the first of equal rows, or low_pass: {!r:.2g} "
        "in the mapping",
        100.0 * repeated / time.size, repeats, 1.0 / period / repeats, 1.0 / period, 0.25 / period / repeats,
    )  # fmt: skip


def _with_remedy(name: SignalName, warnings: dict[int, str], factors: Array, mapping: Mapping) -> list[str]:
    """One warning about a signal, with the correcting factors."""
    gains = name == "torque" and mapping.servo is not None
    if not warnings or (name not in mapping.signals and not gains):
        return []
    corrected = factors * np.array(mapping.servo.kp if mapping.servo and gains else mapping.signals[name].factor)
    key = "servo.kp" if gains else f"signals.{name}.factor"
    numbers = [remark("{!r:.3g}", value) for value in corrected.tolist()]
    remedy = numbers[0] if np.all(corrected == corrected[0]) else remark("[{}]", joined(", ", numbers))
    faults = joined("; ", [remark("of joint {} {}", str(joint + 1), text) for joint, text in warnings.items()])
    causes = "wrong sign, unit or joint" + (", or a load that the mapping lacks" if name == "torque" else "")
    if gains and np.any(corrected <= 0.0):
        words = "{} {}: {}? No positive {} corrects it: late commands, or torques that the controller adds?"
        return [remark(words, name, faults, causes, key)]
    return [remark("{} {}: {}? Remedy in the mapping: {}: {}", name, faults, causes, key, remedy)]


def _ratio(values: Array, expected: Array) -> float | None:
    """Factor between a signal and its prediction; None: about 1, or not correlated."""
    relation = fit(expected[:, None], values[:, None])
    ratio, correlated = float(relation.factor[0]), abs(float(relation.correlation[0])) >= MIN_CORRELATION
    return ratio if correlated and not PLAUSIBLE_FACTORS[0] < ratio < PLAUSIBLE_FACTORS[1] else None


def _remedy(ratio: float) -> float:
    return -1.0 if PLAUSIBLE_FACTORS[0] < -ratio < PLAUSIBLE_FACTORS[1] else 1.0 / ratio


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
