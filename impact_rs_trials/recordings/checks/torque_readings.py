# SPDX-License-Identifier: Apache-2.0
"""Readings of a torque signal, compared by their likelihood.

A signal may be the torque that drives the joints, the torque without gravity (which many controllers add on
their own), or neither; its columns may stand in another order; and it may be computed by a controller instead of
measured. Every reading predicts each joint's signal by least squares,

    tau_j = a_j x_j + c_j tanh(dq_j / v) + d_j dq_j + noise,    1/2 <= abs(a_j) <= 2

with x = M ddq + h, M ddq + C dq or 0: friction is fitted, and the factor leaves room for a load or a rough model. The
log likelihood, with k independent samples and the residuals r of the best fit, is

    -k/2 sum_j log sum r_j^2                                                                     (noise marginalised)

The reading with the highest likelihood is the meaning of the signal: the whole torque, the torque without gravity, or
with x = 0 an external torque, of which friction is left. Its margin is the log likelihood over the next one. A torque
before the gear accelerates the motors as well: B_j ddq_j is added to the reading, and its gain in log likelihood shows
B_j > 0. A signal that gravity, inertia or both give to 0.1 % without a fitted number is a controller's own target, and
so is gravity compensation with masses of its own: a gravity torque Y(q) pi of some masses pi, with no share a of the
inertia that moves the arm (:func:`gravity_alone`).

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
    "Its controller adds gravity by itself: take the measured torque or the motor currents, or "
    "torque_meaning: without_gravity in the mapping, which adds the gravity torque of the model"
)
NOTHING_SHOWS = "nothing that the model lacks, as a load, can show in it"
MEASURED_TORQUE = (
    "Take the measured torque or the motor currents, or desired positions and the gains of the servos (servo); "
    "torque_meaning: whole, if a simulation applied it"
)
READING_SAMPLES = 300  # in which readings are compared
SEARCHED_SAMPLES = 30  # in which all orders of the joints are compared
MAX_ORDERED_JOINTS = 7  # whose orders are searched: 7! = 5040
COULOMB_SHARE = 0.03  # of the largest torque of geared joints; data sheets and identifications give 1 to 10 %
MIN_TORQUE_SHARE = 1e-3  # of the largest torque: a tenth of the smallest friction, within the error of differences
MAX_RESIDUAL_RATIO = 0.5  # rms of the residual; below it another reading explains more of the torque as well
MAX_RESIDUAL_SHARE = 0.3  # of the torque, rms: friction, a load and a rough model leave about as much
GRAVITY_ALONE = "the gravity torque"
MAX_TARGET_RESIDUAL = 0.001  # of the torque, rms: what differences of the motion leave of a torque that was computed
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
    def seen(time: Array, position: Array, velocity: Array, torque: Array, model: RobotModel) -> MotionTorque:
        """Motion and torque from signals ``(m, n)`` on the same timestamps, after moving averages.

        Args:
            time: Stamps, ``(m,)`` [s].
            position: q [rad].
            velocity: dq [rad/s].
            torque: Torque signal [N m].
            model: Nominal arm.
        """
        motion = JointMotion.of(time, position, velocity, model, READING_SAMPLES)
        at, tau = averaged(time, torque)
        independent = min(float(motion.rows.size), time.size / max(1, time.size - at.size + 1))
        return MotionTorque(**vars(motion), recorded=tau[motion.rows], independent=independent)

    def reading(self, meaning: TorqueMeaning) -> Array:
        """Torque of the model that a signal of this meaning holds, ``(k, n)`` [N m]."""
        if meaning == "without_gravity":
            return np.asarray(self.whole - self.gravity_torque)
        return np.zeros_like(self.whole) if meaning == "external" else self.whole

    def relation(self, reading: Array) -> LinearRelation:
        """Fit of the recorded torque by a reading ``(k, n)`` and friction."""
        friction = (dry_friction(self.velocity), self.velocity)
        return fit(reading, self.recorded, friction, self.independent, PLAUSIBLE_FACTORS)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of the joints whose torque changes, ``(n,)``; others were not measured."""
        return np.asarray(np.ptp(self.recorded, axis=0) > 0.0)

    def left(self, reading: Array) -> Array:
        """Residual sum of squares of a reading ``(k, n)``, ``(n,)`` [N^2 m^2]."""
        return np.where(self.measured, self.relation(reading).misfit, 0.0)

    def likelihood(self, reading: Array) -> float:
        """Log likelihood of a reading ``(k, n)``, up to a constant of the signal."""
        return float(np.sum(self.relation(reading).log_likelihood[self.measured]))

    def ordered(self, order: tuple[int, ...], rows: slice = slice(None)) -> MotionTorque:
        """Reordered joints at all or some samples."""
        return replace(self, **{name: getattr(self, name)[rows, list(order)] for name in SIGNALS})


def lacks_gravity(seen: MotionTorque) -> str | None:
    """Evidence that a torque signal lacks the gravity torque; None: no evidence.

    Args:
        seen: Signal and motion.
    """
    gravity = float(np.sqrt(np.mean(np.square(seen.gravity_torque)) * seen.gravity_torque.shape[1]))
    if gravity < noticed(seen.model):
        return None
    alone = seen.whole - seen.gravity_torque
    without, whole, neither = (seen.likelihood(one) for one in (alone, seen.whole, np.zeros_like(alone)))
    left_without, left = (_rms(seen.left(one), seen) for one in (alone, seen.whole))
    if without < max(whole, neither) + DECISIVE_LOG_LIKELIHOOD or left_without > MAX_RESIDUAL_RATIO * left:
        return None
    most = float(np.max(np.abs(seen.gravity_torque)))
    return (
        f"holds the torque of inertia without gravity, which takes up to {most:.3g} N m: it is "
        f"{left_without:.3g} N m rms away from that torque, {left:.3g} N m from the whole one (log likelihood "
        f"{without - whole:+.0f})"
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


def meaning_of(seen: MotionTorque, expected: TorqueMeaning, computed: bool = False) -> MeaningChoice:
    """Likeliest meaning of a torque signal, with its margin.

    Args:
        seen: Signal and motion.
        expected: Meaning by its likelihoods and names alone.
        computed: Whether a torque of motors holds no dry friction.
    """
    tried: tuple[TorqueMeaning, ...] = ("whole", "without_gravity", "external")
    likelihood = {meaning: seen.likelihood(seen.reading(meaning)) for meaning in tried}
    others = {meaning: likelihood[expected] - own for meaning, own in likelihood.items() if meaning != expected}
    evidence = f"log likelihood {', '.join(f'{gain:+.0f} over {meaning}' for meaning, gain in others.items())}"
    margin = min(others.values())
    exact = exactness(seen)
    if exact is None and (own := gravity_alone(seen)) is not None:
        held = f"is the gravity torque of some masses to {100.0 * own:.2g} % and holds nothing of the inertia"
        return MeaningChoice("target", np.inf, f"{held}: gravity compensation, a controller's own target")
    if exact is None:
        return MeaningChoice(expected, margin, evidence)
    part, share = exact
    follows = f"follows {part} of the model to {100.0 * share:.2g} % without any friction"
    if computed or part == GRAVITY_ALONE:
        return MeaningChoice("target", np.inf, f"{follows}: a controller's own target")
    return MeaningChoice(expected, 0.0, f"{follows}: of a simulation, or a controller's own target? {evidence}")


def exactness(seen: MotionTorque) -> tuple[str, float] | None:
    """Part of the model that gives a torque exactly, and the residual over the torque, rms [-]; None: none does.

    Parts are gravity, inertia, or both, as in gravity compensation and feedforward; no fitted number is in it.
    """
    size = np.sqrt(np.mean(np.square(seen.recorded[:, seen.measured])))
    inertial = seen.whole - seen.gravity_torque
    found = []
    for part, torque in (("the torque", seen.whole), (GRAVITY_ALONE, seen.gravity_torque), ("the inertia", inertial)):
        left = np.sqrt(np.mean(np.square((seen.recorded - torque)[:, seen.measured])))
        found.append((float(left / max(size, 1e-300)), part))
    share, part = min(found)
    return (part, share) if share < MAX_TARGET_RESIDUAL else None


def gravity_alone(seen: MotionTorque) -> float | None:
    """Residual over the torque, rms [-], of a gravity torque of some masses; None: it is another torque.

    In tau = Y(q) pi + a (M ddq + C dq), with the regressor Y of the gravity torque (Atkeson, An and Hollerbach 1986), a
    torque that moves the arm has 1/2 < a < 2. Decisive is the log likelihood of a = 0 over the best a in that range.
    """
    model, zero = seen.model, np.zeros(seen.model.joint_count)
    at_rest = [pin.computeJointTorqueRegressor(model.pinocchio, model.data, q, zero, zero) for q in seen.position]
    regressor = np.array(at_rest).reshape(*seen.position.shape, -1)  # of one joint Pinocchio makes a vector
    rows = regressor[:, seen.measured].reshape(-1, regressor.shape[2])
    torque, inertial = (one[:, seen.measured].ravel() for one in (seen.recorded, seen.whole - seen.gravity_torque))
    both = np.column_stack((torque, inertial))
    torque_left, inertial_left = (both - rows @ np.linalg.lstsq(rows, both, rcond=MIN_SINGULAR_RATIO)[0]).T
    share = float(np.sqrt(np.mean(np.square(torque_left)) / max(float(np.mean(np.square(torque))), 1e-300)))
    moved = fit(inertial_left[:, None], torque_left[:, None], bounds=PLAUSIBLE_FACTORS)
    gain = 0.5 * seen.independent * float(np.log(max(moved.misfit[0], 1e-300) / max(moved.unexplained[0], 1e-300)))
    return share if share < MAX_GRAVITY_RESIDUAL and gain > DECISIVE_LOG_LIKELIHOOD else None


def is_external(seen: MotionTorque, named: bool) -> MeaningChoice | None:
    """Evidence that a signal is a torque from which a whole rigid model was subtracted; None: no evidence.

    Friction alone explains it far better than any torque of the motion does.

    Args:
        seen: Signal and motion.
        named: Whether its name calls it external.
    """
    alone = seen.whole - seen.gravity_torque
    neither = seen.likelihood(np.zeros_like(alone))
    best = max(seen.likelihood(seen.whole), seen.likelihood(alone))
    left, left_whole = (_rms(seen.left(one), seen) for one in (np.zeros_like(alone), seen.whole))
    if neither < best + DECISIVE_LOG_LIKELIHOOD or left > MAX_RESIDUAL_RATIO * left_whole:
        return None
    friction = fit(dry_friction(seen.velocity), seen.recorded, (), seen.independent)
    shown = float(np.sum(friction.log_likelihood_ratio[seen.measured & (friction.factor > 0.0)]))
    sizes = [float(np.sqrt(np.mean(np.square(one[:, seen.measured])))) for one in (seen.recorded, seen.whole)]
    rubs = shown > DECISIVE_LOG_LIKELIHOOD and left < MAX_RESIDUAL_RATIO * sizes[0] * np.sqrt(seen.model.joint_count)
    if not named and not rubs:
        return None
    evidence = (
        f"{sizes[0]:.3g} N m rms where the motion takes {sizes[1]:.3g} N m: the torque of a rigid model is subtracted "
        f"(log likelihood {neither - best:+.0f}), friction is left ({shown:+.0f})"
    )
    return MeaningChoice("external", neither - best if rubs else 0.0, evidence)


def motor_inertia_in(seen: MotionTorque, meaning: TorqueMeaning) -> tuple[float, Array]:
    """Log likelihood that a torque accelerates the motors as well, and their inertia ``(n,)`` [kg m^2].

    Each joint's own acceleration is added to the torque of the links and friction; an inertia below zero counts as
    none. Each has the cost of one more parameter, log(k) / 2 (Schwarz 1978).

    Args:
        seen: Signal and motion.
        meaning: Meaning of the signal.
    """
    torque = seen.reading(meaning)
    friction = (dry_friction(seen.velocity), seen.velocity)
    rest = seen.recorded - seen.relation(torque).factor * torque
    motors = fit(seen.acceleration, rest, friction, seen.independent)
    gain = motors.log_likelihood_ratio - 0.5 * np.log(seen.independent)
    size = np.sqrt(np.mean(np.square(seen.recorded), axis=0))
    driven = np.sqrt(np.mean(np.square(motors.factor * seen.acceleration), axis=0))
    shown = seen.measured & (motors.factor > 0.0) & (gain > DECISIVE_LOG_ODDS) & (driven > MIN_MOTOR_SHARE * size)
    return float(np.sum(np.maximum(gain, 0.0)[shown])), np.where(shown, np.maximum(motors.factor, 0.0), 0.0)


def whole_torque(path: Path, time: Array, arm: ArmSignals, meaning: TorqueMeaning, model: RobotModel) -> Array:
    """The torque that moves the joints, ``(k, n)`` [N m]: what a signal lacks is added by the nominal model.

    Accelerations are differences of the velocities, as in the torque balance, whose low-pass they pass as well.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        arm: Recorded signals of free motion.
        meaning: Meaning of the torque signal.
        model: Nominal arm with its load.

    Raises:
        InputError: It is no measurement.
    """
    if meaning == "target":
        raise InputError(
            f"torque is a controller's own target, no measurement: {NOTHING_SHOWS}. {MEASURED_TORQUE}",
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
        InputError: It holds the inertial torque alone.
    """
    why = lacks_gravity(MotionTorque.seen(time, arm.position, arm.velocity, arm.torque, model))
    if why is not None:
        raise InputError(f"torque {why}. {WHOLE_TORQUE}", file=path, key="signals.torque of the mapping")


def is_computed(seen: MotionTorque) -> bool:
    """Whether a torque at the motors holds no dry friction, so that a controller or a simulation computed it.

    Args:
        seen: Signal and motion; the signal may be a current.
    """
    signs = dry_friction(seen.velocity)
    fast = np.sqrt(np.mean(np.square(seen.velocity), axis=0)) >= FULL_FRICTION_RAD_S
    torque = fit(seen.whole, seen.recorded, [signs])
    dry = fit(signs, seen.recorded, [seen.whole], seen.independent)
    factor = 0.0
    for joint, most in enumerate(seen.model.torque_max):
        if not fast[joint] or not np.any(seen.recorded[:, joint]):
            continue
        scale = most * abs(float(torque.factor[joint])) + 1e-12  # in the unit of the signal, torque or current
        error = float(np.hypot(dry.standard_error[joint], MIN_TORQUE_SHARE * scale))
        ratio = (COULOMB_SHARE * scale / error) ** 2
        factor += 0.5 * np.log1p(ratio) - 0.5 * (float(dry.factor[joint]) / error) ** 2 * ratio / (1.0 + ratio)
    return factor > DECISIVE_LOG_ODDS


def explains_most(seen: MotionTorque) -> bool:
    """Whether gravity, inertia and friction of the arm explain most of a torque signal."""
    size = float(np.sqrt(np.mean(np.square(seen.recorded)) * seen.model.joint_count))
    return _rms(seen.left(seen.whole), seen) < MAX_RESIDUAL_SHARE * size


def order_of_joints(seen: MotionTorque) -> tuple[tuple[int, ...], str] | None:
    """Order of the columns that makes them joints from base to tip, by the arm's inverse dynamics, with the evidence.

    Args:
        seen: Signal and motion as the columns stand.

    Returns:
        Index of every joint's column; None: the given order leaves a small residual, or no other is clearly
        better.
    """
    count, before = seen.model.joint_count, _rms(seen.left(seen.whole), seen)
    if not 1 < count <= MAX_ORDERED_JOINTS or explains_most(seen):
        return None
    low, high = seen.model.position_min, seen.model.position_max
    least, most = seen.position.min(axis=0), seen.position.max(axis=0)
    rows = slice(None, None, max(1, len(seen.position) // SEARCHED_SAMPLES))
    scores = {}
    for order in itertools.permutations(range(count)):
        columns = list(order)
        if np.all(least[columns] >= low) and np.all(most[columns] <= high):
            own = seen.ordered(order, rows)
            scores[order] = own.likelihood(own.whole)
    if not scores:
        return None
    best = max(scores, key=lambda order: scores[order])
    if best == tuple(range(count)):
        return None
    own = seen.ordered(best)
    after, gain = _rms(own.left(own.whole), own), own.likelihood(own.whole) - seen.likelihood(seen.whole)
    if gain < DECISIVE_LOG_LIKELIHOOD or after > MAX_RESIDUAL_RATIO * before or not explains_most(own):
        return None
    listed = ", ".join(str(column + 1) for column in best)
    return best, (
        f"base to tip the columns are {listed}: so the torque is {after:.3g} N m rms away from gravity and inertia of "
        f"the arm, as they stand {before:.3g} N m (log likelihood {gain:+.0f})"
    )


def _rms(left: Array, seen: MotionTorque) -> float:
    """Root of the sum over joints of the mean squares [N m]."""
    return float(np.sqrt(np.sum(left) / len(seen.recorded)))
