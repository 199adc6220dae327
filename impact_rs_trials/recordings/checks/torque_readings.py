# SPDX-License-Identifier: Apache-2.0
"""Meaning of a torque signal, by likelihood.

A signal may be the torque that drives the joints, this torque without gravity (which many controllers add), or neither.
Its columns may be in another order. A controller may have computed it, so that it is no measurement. Every meaning
predicts the signal of each joint by least squares,

    tau_j = a_j x_j + c_j tanh(dq_j / v) + d_j dq_j + noise,    1/2 <= abs(a_j) <= 2

with x = M ddq + h, M ddq + C dq or 0: friction is fitted, and the factor leaves room for a load or a rough model. The
log likelihood, with k independent samples and the residuals r of the best fit, is

    -k/2 sum_j log sum r_j^2                                                                     (noise marginalised)

The likeliest meaning is chosen: the whole torque, the torque without gravity, or an external torque (x = 0: friction is
left). Its margin is its log likelihood over that of the next meaning. A torque before the gear accelerates the motors
as well: B_j ddq_j is added to the prediction, and its gain in log likelihood shows B_j > 0. A signal that gravity,
inertia or both predict to 0.1 % without a fitted number is a target that a controller computed. Another such target is
gravity compensation with other masses: a gravity torque Y(q) pi of some masses pi, without the inertial torque that
moves the arm (:func:`gravity_alone`).

A torque measured at a motor drives the friction of its gear. A torque without friction was computed: with dry friction
c_j ~ N(0, s_j^2) of usual gears and its estimate c_j +- e_j, the log Bayes factor of no friction against friction is

    sum_j  log(1 + s_j^2 / e_j^2) / 2 - c_j^2 s_j^2 / (2 e_j^2 (s_j^2 + e_j^2))
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.plausibility import noticed
from impact_rs_trials.recordings.joint_motion import JointMotion
from impact_rs_trials.recordings.mapping import TorqueMeaning
from impact_rs_trials.recordings.relations import (
    DECISIVE_LOG_LIKELIHOOD,
    DECISIVE_LOG_ODDS,
    FULL_FRICTION_RAD_S,
    PLAUSIBLE_FACTORS,
    LinearRelation,
    averaged,
    dry_friction,
    fit,
)
from impact_rs_trials.runs import ArmSignals

WHOLE_TORQUE = (
    "Its controller adds the gravity torque: take the measured torque or the motor currents, or "
    "torque_meaning: without_gravity in the mapping, which adds the gravity torque of the model"
)
NOTHING_SHOWS = "nothing that the model lacks, as a load, can show in it"
MEASURED_TORQUE = (
    "Take the measured torque or the motor currents, or desired positions and the gains of the servos (servo); "
    "torque_meaning: whole, if a simulation applied it"
)
COMPARED_SAMPLES = 300  # in which meanings are compared
SEARCHED_SAMPLES = 30  # in which all orders of the joints are compared
MAX_ORDERED_JOINTS = 7  # whose orders are searched: 7! = 5040
COULOMB_SHARE = 0.03  # of the largest torque of geared joints; data sheets and identifications give 1 to 10 %
MIN_TORQUE_SHARE = 1e-3  # of the largest torque: a tenth of the smallest friction, within the error of differences
MAX_RESIDUAL_RATIO = (
    0.5  # of the residuals of two meanings, rms, below which the better one explains more of the torque
)
MAX_RESIDUAL_SHARE = 0.3  # of the torque, rms: friction, a load and a rough model leave about as much
GRAVITY_ALONE = "the gravity torque"
MAX_TARGET_RESIDUAL = 0.001  # of the torque, rms: error of finite differences in a torque that was computed
MAX_GRAVITY_RESIDUAL = 0.01  # of the torque, rms: rounding of a log, and a sample between position and torque
MIN_SINGULAR_RATIO = 1e-8  # of the gravity regressor; smaller ones belong to masses that no pose loads
MIN_MOTOR_SHARE = 0.01  # of a joint's torque, rms, that accelerates its motor; less is an error of differences
SIGNALS = ("position", "velocity", "acceleration", "recorded")


@dataclass(frozen=True)
class MotionTorque(JointMotion):
    """A motion of the joints, and a torque signal at its samples.

    Attributes:
        recorded: Torque signal, ``(k, n)`` [N m].
        independent: Number of independent samples; moving averages overlap [-].
    """

    recorded: Array
    independent: float

    @staticmethod
    def from_signals(time: Array, position: Array, velocity: Array, torque: Array, model: RobotModel) -> MotionTorque:
        """Motion and torque from signals ``(m, n)`` on the same timestamps, after moving averages.

        Args:
            time: Stamps, ``(m,)`` [s].
            position: q [rad].
            velocity: dq [rad/s].
            torque: Torque signal [N m].
            model: Nominal arm.
        """
        motion = JointMotion.of(time, position, velocity, model, COMPARED_SAMPLES)
        averaged_time, averaged_torque = averaged(time, torque)
        independent = min(float(motion.rows.size), time.size / max(1, time.size - averaged_time.size + 1))
        return MotionTorque(**vars(motion), recorded=averaged_torque[motion.rows], independent=independent)

    def prediction(self, meaning: TorqueMeaning) -> Array:
        """Torque of the model in a signal of a meaning, ``(k, n)`` [N m]."""
        if meaning == "without_gravity":
            return np.asarray(self.rigid_torque - self.gravity_torque)
        return np.zeros_like(self.rigid_torque) if meaning == "external" else self.rigid_torque

    def relation(self, prediction: Array) -> LinearRelation:
        """Fit of the recorded torque by a prediction ``(k, n)`` and friction."""
        friction = (dry_friction(self.velocity), self.velocity)
        return fit(prediction, self.recorded, friction, self.independent, PLAUSIBLE_FACTORS)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of the joints whose torque changes, ``(n,)``; others were not measured."""
        return np.asarray(np.ptp(self.recorded, axis=0) > 0.0)

    def misfit(self, prediction: Array) -> Array:
        """Residual sum of squares of a prediction ``(k, n)``, ``(n,)`` [N^2 m^2]."""
        return np.where(self.measured, self.relation(prediction).misfit, 0.0)

    def residual_rms(self, prediction: Array) -> float:
        """Residual of a prediction ``(k, n)``: root of the sum over joints of the mean squares [N m]."""
        return float(np.sqrt(np.sum(self.misfit(prediction)) / len(self.recorded)))

    def likelihood(self, prediction: Array) -> float:
        """Log likelihood of a prediction ``(k, n)``, up to a constant of the signal."""
        return float(np.sum(self.relation(prediction).log_likelihood[self.measured]))

    def ordered(self, order: tuple[int, ...], rows: slice = slice(None)) -> MotionTorque:
        """Reordered joints at all or some samples."""
        return replace(self, **{name: getattr(self, name)[rows, list(order)] for name in SIGNALS})


def lacks_gravity(motion: MotionTorque) -> str | None:
    """Evidence that a torque signal lacks the gravity torque; None: no evidence.

    Args:
        motion: Signal and motion.
    """
    gravity_size = float(np.sqrt(np.mean(np.square(motion.gravity_torque)) * motion.gravity_torque.shape[1]))
    if gravity_size < noticed(motion.model):
        return None
    inertial = motion.rigid_torque - motion.gravity_torque
    without_gravity, whole, friction = (
        motion.likelihood(prediction) for prediction in (inertial, motion.rigid_torque, np.zeros_like(inertial))
    )
    rms_without, rms_whole = (motion.residual_rms(prediction) for prediction in (inertial, motion.rigid_torque))
    if without_gravity < max(whole, friction) + DECISIVE_LOG_LIKELIHOOD or rms_without > MAX_RESIDUAL_RATIO * rms_whole:
        return None
    largest = float(np.max(np.abs(motion.gravity_torque)))
    return (
        f"holds the torque of inertia without gravity, which takes up to {largest:.3g} N m: it is "
        f"{rms_without:.3g} N m rms away from that torque, {rms_whole:.3g} N m from the whole torque (log likelihood "
        f"{without_gravity - whole:+.0f})"
    )


@dataclass(frozen=True)
class MeaningChoice:
    """Meaning of a torque signal.

    Attributes:
        best: The likeliest meaning.
        margin: Log likelihood over the next meaning; 0 where gravity takes no torque.
        evidence: Evidence in words.
    """

    best: TorqueMeaning
    margin: float
    evidence: str

    @property
    def sure(self) -> bool:
        """Whether the margin is decisive."""
        return self.margin > DECISIVE_LOG_LIKELIHOOD


def meaning_of(motion: MotionTorque, expected: TorqueMeaning, computed: bool = False) -> MeaningChoice:
    """Likeliest meaning of a torque signal, with its margin.

    Args:
        motion: Signal and motion.
        expected: Meaning by its likelihoods and names alone.
        computed: Whether a torque of motors holds no dry friction.
    """
    meanings: tuple[TorqueMeaning, ...] = ("whole", "without_gravity", "external")
    likelihoods = {meaning: motion.likelihood(motion.prediction(meaning)) for meaning in meanings}
    gains = {meaning: likelihoods[expected] - value for meaning, value in likelihoods.items() if meaning != expected}
    evidence = f"log likelihood {', '.join(f'{gain:+.0f} over {meaning}' for meaning, gain in gains.items())}"
    margin = min(gains.values())
    exact_part = exactness(motion)
    if exact_part is None and (value := gravity_alone(motion)) is not None:
        held = f"is the gravity torque of some masses to {100.0 * value:.2g} % and holds nothing of the inertia"
        return MeaningChoice("target", np.inf, f"{held}: gravity compensation, a target that a controller computed")
    if exact_part is None:
        return MeaningChoice(expected, margin, evidence)
    part, share = exact_part
    follows = f"follows {part} of the model to {100.0 * share:.2g} % without any friction"
    if computed or part == GRAVITY_ALONE:
        return MeaningChoice("target", np.inf, f"{follows}: a target that a controller computed")
    return MeaningChoice(expected, 0.0, f"{follows}: simulated, or a target that a controller computed? {evidence}")


def exactness(motion: MotionTorque) -> tuple[str, float] | None:
    """Part of the model that predicts a torque exactly, and residual over torque, rms [-]; None: no part does.

    The parts are gravity (gravity compensation), inertia, or both (feedforward). No number is fitted.
    """
    size = np.sqrt(np.mean(np.square(motion.recorded[:, motion.measured])))
    inertial = motion.rigid_torque - motion.gravity_torque
    shares = []
    for part, torque in (
        ("the torque", motion.rigid_torque),
        (GRAVITY_ALONE, motion.gravity_torque),
        ("the inertia", inertial),
    ):
        residual = np.sqrt(np.mean(np.square((motion.recorded - torque)[:, motion.measured])))
        shares.append((float(residual / max(size, 1e-300)), part))
    share, part = min(shares)
    return (part, share) if share < MAX_TARGET_RESIDUAL else None


def gravity_alone(motion: MotionTorque) -> float | None:
    """Residual over torque, rms [-], of a gravity torque of other masses; None: the torque is no gravity torque.

    In tau = Y(q) pi + a (M ddq + C dq), with the regressor Y of the gravity torque (Atkeson, An and Hollerbach 1986), a
    torque that moves the arm has 1/2 < a < 2. Decisive is the log likelihood of a = 0 over the best a in that range.
    """
    model, zero = motion.model, np.zeros(motion.model.joint_count)
    at_rest = [pin.computeJointTorqueRegressor(model.pinocchio, model.data, q, zero, zero) for q in motion.position]
    regressor = np.array(at_rest).reshape(*motion.position.shape, -1)  # of one joint Pinocchio makes a vector
    rows = regressor[:, motion.measured].reshape(-1, regressor.shape[2])
    inertial_torque = motion.rigid_torque - motion.gravity_torque
    torque, inertial = (signal[:, motion.measured].ravel() for signal in (motion.recorded, inertial_torque))
    columns = np.column_stack((torque, inertial))
    torque_residual, inertial_residual = (
        columns - rows @ np.linalg.lstsq(rows, columns, rcond=MIN_SINGULAR_RATIO)[0]
    ).T
    share = float(np.sqrt(np.mean(np.square(torque_residual)) / max(float(np.mean(np.square(torque))), 1e-300)))
    relation = fit(inertial_residual[:, None], torque_residual[:, None], bounds=PLAUSIBLE_FACTORS)
    ratio = max(relation.misfit[0], 1e-300) / max(relation.unexplained[0], 1e-300)
    gain = 0.5 * motion.independent * float(np.log(ratio))
    return share if share < MAX_GRAVITY_RESIDUAL and gain > DECISIVE_LOG_LIKELIHOOD else None


def is_external(motion: MotionTorque, named: bool) -> MeaningChoice | None:
    """Evidence that a signal is a torque from which a whole rigid model was subtracted; None: no evidence.

    Friction alone then explains the signal far better than any torque of the motion.

    Args:
        motion: Signal and motion.
        named: Whether its name calls it external.
    """
    inertial = motion.rigid_torque - motion.gravity_torque
    likelihood_of_friction = motion.likelihood(np.zeros_like(inertial))
    likelihood_of_motion = max(motion.likelihood(motion.rigid_torque), motion.likelihood(inertial))
    gain = likelihood_of_friction - likelihood_of_motion
    residual, residual_of_motion = (
        motion.residual_rms(prediction) for prediction in (np.zeros_like(inertial), motion.rigid_torque)
    )
    if gain < DECISIVE_LOG_LIKELIHOOD or residual > MAX_RESIDUAL_RATIO * residual_of_motion:
        return None
    friction = fit(dry_friction(motion.velocity), motion.recorded, (), motion.independent)
    friction_gain = float(np.sum(friction.log_likelihood_ratio[motion.measured & (friction.factor > 0.0)]))
    size, rigid_size = (
        float(np.sqrt(np.mean(np.square(torque[:, motion.measured]))))
        for torque in (motion.recorded, motion.rigid_torque)
    )
    largest_residual = MAX_RESIDUAL_RATIO * size * np.sqrt(motion.model.joint_count)
    shows_friction = friction_gain > DECISIVE_LOG_LIKELIHOOD and residual < largest_residual
    if not named and not shows_friction:
        return None
    evidence = (
        f"{size:.3g} N m rms where the motion takes {rigid_size:.3g} N m: the torque of a rigid model is subtracted "
        f"(log likelihood {gain:+.0f}), friction is left ({friction_gain:+.0f})"
    )
    return MeaningChoice("external", gain if shows_friction else 0.0, evidence)


def motor_inertia_in(motion: MotionTorque, meaning: TorqueMeaning) -> tuple[float, Array]:
    """Gain in log likelihood if a torque accelerates the motors as well, and their inertia ``(n,)`` [kg m^2].

    The residual of the links is fitted by B_j ddq_j and friction; B_j < 0 is taken as 0. Each B_j costs log(k) / 2
    (Schwarz 1978).

    Args:
        motion: Signal and motion.
        meaning: Meaning of the signal.
    """
    torque = motion.prediction(meaning)
    friction = (dry_friction(motion.velocity), motion.velocity)
    residual = motion.recorded - motion.relation(torque).factor * torque
    motors = fit(motion.acceleration, residual, friction, motion.independent)
    gain = motors.log_likelihood_ratio - 0.5 * np.log(motion.independent)
    size = np.sqrt(np.mean(np.square(motion.recorded), axis=0))
    driven = np.sqrt(np.mean(np.square(motors.factor * motion.acceleration), axis=0))
    driving = motion.measured & (motors.factor > 0.0) & (gain > DECISIVE_LOG_ODDS) & (driven > MIN_MOTOR_SHARE * size)
    return float(np.sum(np.maximum(gain, 0.0)[driving])), np.where(driving, np.maximum(motors.factor, 0.0), 0.0)


def whole_torque(path: Path, time: Array, arm: ArmSignals, meaning: TorqueMeaning, model: RobotModel) -> Array:
    """Torque that moves the joints, ``(k, n)`` [N m]: the nominal model adds the part that the signal lacks.

    Accelerations are differences of the velocities, as in the torque balance, whose low-pass they pass as well.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        arm: Recorded signals of free motion.
        meaning: Meaning of the torque signal.
        model: Nominal arm with its load.

    Raises:
        InputError: The torque is no measurement.
    """
    if meaning == "target":
        raise InputError(
            f"torque is a target that a controller computed, no measurement: {NOTHING_SHOWS}. {MEASURED_TORQUE}",
            file=path,
            key="torque_meaning of the mapping",
        )
    if meaning == "without_gravity":
        return arm.torque + np.array([model.gravity_torque(q) for q in arm.position])
    if meaning == "external":
        acceleration = np.gradient(arm.velocity, time, axis=0)
        states = zip(arm.position, arm.velocity, acceleration, strict=True)
        return arm.torque + np.array([model.inverse_dynamics(*state) for state in states])
    return arm.torque


def check_includes_gravity(path: Path, time: Array, arm: ArmSignals, model: RobotModel) -> None:
    """Check that a recorded torque includes the gravity torque.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        arm: Recorded signals of free motion.
        model: Nominal arm.

    Raises:
        InputError: The torque holds inertia and friction alone.
    """
    evidence = lacks_gravity(MotionTorque.from_signals(time, arm.position, arm.velocity, arm.torque, model))
    if evidence is not None:
        raise InputError(f"torque {evidence}. {WHOLE_TORQUE}", file=path, key="signals.torque of the mapping")


def is_computed(motion: MotionTorque) -> bool:
    """Whether a torque at the motors holds no dry friction, so that a controller or a simulation computed it.

    Args:
        motion: Signal and motion; the signal may be a current.
    """
    signs = dry_friction(motion.velocity)
    fast = np.sqrt(np.mean(np.square(motion.velocity), axis=0)) >= FULL_FRICTION_RAD_S
    torque = fit(motion.rigid_torque, motion.recorded, [signs])
    dry = fit(signs, motion.recorded, [motion.rigid_torque], motion.independent)
    log_bayes_factor = 0.0
    for joint, torque_max in enumerate(motion.model.torque_max):
        if not fast[joint] or not np.any(motion.recorded[:, joint]):
            continue
        scale = torque_max * abs(float(torque.factor[joint])) + 1e-12  # in the unit of the signal, torque or current
        error = float(np.hypot(dry.standard_error[joint], MIN_TORQUE_SHARE * scale))
        ratio = (COULOMB_SHARE * scale / error) ** 2
        log_bayes_factor += 0.5 * np.log1p(ratio) - 0.5 * (float(dry.factor[joint]) / error) ** 2 * ratio / (
            1.0 + ratio
        )
    return log_bayes_factor > DECISIVE_LOG_ODDS


def explains_most(motion: MotionTorque) -> bool:
    """Whether gravity, inertia and friction of the arm explain most of a torque signal."""
    size = float(np.sqrt(np.mean(np.square(motion.recorded)) * motion.model.joint_count))
    return motion.residual_rms(motion.rigid_torque) < MAX_RESIDUAL_SHARE * size


def order_of_joints(motion: MotionTorque) -> tuple[tuple[int, ...], str] | None:
    """Order of the columns from base to tip, by the inverse dynamics of the arm, with the evidence.

    Args:
        motion: Signal and motion in the order of the columns.

    Returns:
        Index of the column of every joint; None: the order of the columns leaves a small residual, or no other order is
        clearly better.
    """
    count, before = motion.model.joint_count, motion.residual_rms(motion.rigid_torque)
    if not 1 < count <= MAX_ORDERED_JOINTS or explains_most(motion):
        return None
    low, high = motion.model.position_min, motion.model.position_max
    smallest, largest = motion.position.min(axis=0), motion.position.max(axis=0)
    rows = slice(None, None, max(1, len(motion.position) // SEARCHED_SAMPLES))
    scores = {}
    for order in itertools.permutations(range(count)):
        columns = list(order)
        if np.all(smallest[columns] >= low) and np.all(largest[columns] <= high):
            reordered = motion.ordered(order, rows)
            scores[order] = reordered.likelihood(reordered.rigid_torque)
    if not scores:
        return None
    best = max(scores, key=lambda order: scores[order])
    if best == tuple(range(count)):
        return None
    reordered = motion.ordered(best)
    after = reordered.residual_rms(reordered.rigid_torque)
    gain = reordered.likelihood(reordered.rigid_torque) - motion.likelihood(motion.rigid_torque)
    if gain < DECISIVE_LOG_LIKELIHOOD or after > MAX_RESIDUAL_RATIO * before or not explains_most(reordered):
        return None
    listed = ", ".join(str(column + 1) for column in best)
    return best, (
        f"base to tip the columns are {listed}: in this order the torque is {after:.3g} N m rms away from gravity and "
        f"inertia of the arm, in the order of the file {before:.3g} N m (log likelihood {gain:+.0f})"
    )
