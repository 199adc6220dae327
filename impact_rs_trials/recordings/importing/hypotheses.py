# SPDX-License-Identifier: Apache-2.0
"""Role of a stream of a recording: hypotheses with one likelihood.

A hypothesis gives the numbers y of a stream a role in the motion q(t) of the joints, with unit u, signs s and factors:

    position    y = q / u                             anywhere within the joints' limits
    velocity    y = s a dq/dt / u                     0.8 < a < 1.25, for low-passes
    torque      y = s a (M ddq + h) / u + F + c       0.2 < a < 5: loads and rough models; log a ~ N(0, 0.35^2)
    current     y = s (M ddq + h) / K + F + c         torque constants K of one sign, apart by a factor of 30 at most
    other       y = b (M ddq + h) + F + c             a factor b of any size and sign in every joint: in no unit
                y = a b dq/dt                         one factor b in all joints: at another sampling rate
                y = b dq/dt                           a different factor in every joint: viscous friction
    motors      y = (N q + C (M ddq + h) + c) / u     angles of motors: gear ratio N, compliance C of the transmission
    copy        y = s a (x + L dx/dt) / u + c         of x = q, dq or ddq, as commanded or filtered signals are
    none        y = F + c                             F: Coulomb and viscous friction where it is a torque; c: offset

Its log likelihood ratio to *none* is, with the residuals r of least squares and k independent samples,

    sum_j  k_j / 2  log(sum r_none^2 / sum r^2)  -  log(k_j) / 2                             (Schwarz 1978)

where k_j is the effective number of samples of two autocorrelated signals (Bartlett 1946): smooth motions resemble each
other by chance. The log prior holds the densities of the factors and the names. Both can be added, and compared between
streams, units and roles. The *margin* of a hypothesis is its log posterior minus that of the next hypothesis. A margin
below log(100) (Jeffreys 1961) is not decisive, and the choice is marked as assumed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from collections.abc import Mapping as AbstractMapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.file_units import TURNS, factors_of
from impact_rs_trials.recordings.joint_motion import JointMotion, unit_of_joints
from impact_rs_trials.recordings.relations import (
    DECISIVE_LOG_ODDS,
    MIN_CORRELATION,
    MIN_CORRELATION_OF_COLUMNS,
    SAME_UNIT_FACTORS,
    TORQUE_UNIT_FACTORS,
    LinearRelation,
    dry_friction,
    effective_samples,
    fit,
    moves,
)

Role = Literal["position", "velocity", "torque", "current", "other", "copy", "none"]

NAME_LOG_ODDS = float(np.log(20.0))  # log odds of a role that a name hints at: names are right in 20 of 21 files
FORMAT_LOG_ODDS = float(np.log(1e4))  # of a role that the format of a file defines: a driver that breaks it is rare
LOG_TORQUE_FACTOR_SIGMA = 0.35  # standard deviation of log a: factors of rough models and loads
MAX_CONSTANT_RATIO = 30.0  # of the torque constants of one arm
INVERSE_TORQUE_CONSTANTS = (1e-2, 1e2)  # current over torque: from large geared joints to the smallest servos [A/(N m)]
MAX_FACTOR_RATIO = 1e8  # largest over smallest factor, where its size is unknown
MAX_GEAR_RATIO = 300.0  # of harmonic drives; the log of a ratio is uniform up to it
MIN_TORQUE_NM = 0.3  # of the largest robot's scale, about its mean and rms, from which a motion shows a joint's torque
MAX_OUTSIDE_SHARE = 0.01  # of the positions beyond the limits, as outliers
MAX_EXCESS_SHARE = 0.05  # of a joint's range, by which positions may exceed it
MIN_OPPOSITE_SHARE = 0.25  # of the range of a torque on the smaller side of zero, from which it has both signs
MAIN_TRAVEL_SHARE, MIN_TRAVEL_SHARE = 0.5, 0.2  # of the farthest travel of a joint, from which a joint is informative
PRIOR: dict[str, float] = {  # of units and roles
    "rad": 0.8, "deg": 0.19, "mrad": 0.01, "rad/s": 0.8, "deg/s": 0.18, "mrad/s": 0.01, "rpm": 0.01,
    "N m": 0.75, "mN m": 0.05, "A": 0.2, "other": 1e-4, "copy": 0.2,
}  # fmt: skip
LOW_PASS_LOG_DENSITY = -float(np.log(np.log(SAME_UNIT_FACTORS[1] / SAME_UNIT_FACTORS[0])))  # of log a in one unit
FREE_FACTOR_LOG_DENSITY = -float(np.log(2.0 * np.log(MAX_FACTOR_RATIO)))  # of log |b| of either sign, of any size
PROBABILITY_OF_BROKEN_ORDER = 1e-3  # that the column of one joint holds another one
SIGN_PRIOR = (0.9, 0.09, 0.01)  # all signals have the sign of the joints, all the opposite one, or they differ
OUTLIERS = np.errstate(
    over="ignore", invalid="ignore", divide="ignore"
)  # in the numbers, of any size: a stream that overflows fits no role


@dataclass(frozen=True)
class RoleHypothesis:
    """A possible role of a stream.

    Attributes:
        role: Its role in the motion.
        unit: Unit of its numbers, or the units of all joints.
        evidence: Evidence in words.
        log_likelihood: Log likelihood ratio to no role.
        log_prior: Of unit, signs and factors.
        further: Further keys of the mapping with their values.
        remarks: Warnings to the user.
    """

    role: Role
    unit: Any
    evidence: str
    log_likelihood: float
    log_prior: float = 0.0
    further: AbstractMapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def log_posterior(self) -> float:
        """Log posterior, up to a constant of the stream."""
        return self.log_likelihood + self.log_prior

    @property
    def name(self) -> str:
        """Role and unit."""
        unit = self.unit if isinstance(self.unit, str) else ", ".join(self.unit)
        return f"{self.role} in {unit}" if unit else self.role


@dataclass(frozen=True)
class RoleChoice:
    """The likeliest of several hypotheses about one stream.

    Attributes:
        best: The likeliest.
        next: The second likeliest; None: there is a single hypothesis.
        margin: Log posterior odds of the best against the next hypothesis, or against no role.
    """

    best: RoleHypothesis
    next: RoleHypothesis | None
    margin: float

    @property
    def sure(self) -> bool:
        """Whether the margin is decisive."""
        return bool(self.margin > DECISIVE_LOG_ODDS)

    @property
    def evidence(self) -> str:
        """Evidence for the best, and the next hypothesis if the margin is not decisive."""
        if self.sure or self.next is None:
            return self.best.evidence
        return f"{self.best.evidence}; next: {self.next.name}, log odds {self.margin:.2g}"


def choose(hypotheses: Iterable[RoleHypothesis], null_log_posterior: float = 0.0) -> RoleChoice | None:
    """Choose the likeliest hypothesis about one stream; None: there are no hypotheses.

    Args:
        hypotheses: Hypotheses about one stream.
        null_log_posterior: Log posterior of having no role.
    """
    ordered = sorted(hypotheses, key=lambda hypothesis: hypothesis.log_posterior, reverse=True)
    if not ordered:
        return None
    best, second = ordered[0], ordered[1] if len(ordered) > 1 else None
    rival = null_log_posterior if second is None else max(null_log_posterior, second.log_posterior)
    return RoleChoice(best, second, best.log_posterior - rival)


# ---- roles ----------------------------------------------------------------------------------------------------------


def positions(raw: Array, facts: RobotFacts) -> list[RoleHypothesis]:
    """Units in which numbers ``(k, n)`` lie within the joints' limits, the likeliest first.

    A position is uniform within its range, so that the density of its number is unit over range: numbers that fill the
    range in rad are unlikely in deg, in which the range is 57 times wider.
    """
    low, high = np.array(facts.limits.position_min_rad), np.array(facts.limits.position_max_rad)
    margin = MAX_EXCESS_SHARE * (high - low)
    ends = zip(raw.min(axis=0), raw.max(axis=0), strict=True)
    span = ", ".join(f"{lowest:.3g} ... {highest:.3g}" for lowest, highest in ends)
    hypotheses: list[RoleHypothesis] = []
    rejected_units: list[str] = []
    for turns, slide in (("rad", "m"), ("deg", "mm"), ("mrad", "mm")):
        unit = unit_of_joints(facts, turns, slide)
        factor = factors_of("position", unit)
        share_inside = np.mean((raw * factor >= low - margin) & (raw * factor <= high + margin), axis=0)
        if np.all(share_inside > 1.0 - MAX_OUTSIDE_SHARE):
            text = f"the joints reach {span}, which lies within their limits in {turns}"
            text += f" and not in {' or '.join(rejected_units)}" if rejected_units else ""
            density = float(np.sum(np.log(np.broadcast_to(factor, low.shape))))
            hypotheses.append(RoleHypothesis("position", unit, text, density, np.log(PRIOR[turns])))
        elif not hypotheses:
            rejected_units.append(turns)
    return hypotheses


@OUTLIERS
def velocities(motion: JointMotion, y: Array) -> list[RoleHypothesis]:
    """Units of a velocity, the likeliest first.

    Args:
        motion: Motion of the joints.
        y: The stream, :meth:`JointMotion.sampled`, ``(k, n)``.
    """
    informative = moves(motion.derivative, motion.facts)
    informative = informative if np.any(informative) else travels(motion.position, MAIN_TRAVEL_SHARE)
    samples = effective_samples(motion.derivative, y)
    unbounded = fit(motion.derivative, y, independent=samples)
    hypotheses = []
    for turns, slide in (("rad/s", "m/s"), ("deg/s", "mm/s"), ("mrad/s", "mm/s"), ("rpm", "mm/s")):
        per_unit = 1.0 / TURNS["velocity"][turns]
        relation = fit(per_unit * motion.derivative, y, independent=samples, bounds=SAME_UNIT_FACTORS)
        text = (
            f"{range_in_words(unbounded.factor[informative] / per_unit)} times the derivative of the position in "
            f"{turns} (correlation {range_in_words(unbounded.correlation[informative])})"
        )
        correlated = informative & (np.abs(unbounded.correlation) > MIN_CORRELATION)
        signs = np.where(correlated, np.sign(relation.factor), usual_sign(relation.factor[informative]))
        prior = float(np.log(PRIOR[turns])) + _signs_prior(signs[informative])
        further = {} if np.all(signs > 0.0) else {"factor": signs_of(signs)}
        remarks = _contradictions(informative, unbounded)
        unit = motion.unit(turns, slide)
        log_ratio = _log_likelihood_ratio_of_copy(relation, informative)
        hypotheses.append(RoleHypothesis("velocity", unit, text, log_ratio, prior, further, remarks))
    typical_factor = float(np.median(unbounded.factor[informative]))
    relation = fit(typical_factor * motion.derivative, y, independent=samples, bounds=SAME_UNIT_FACTORS)
    prior = float(np.log(PRIOR["other"] / np.log(MAX_FACTOR_RATIO)))
    text = f"{typical_factor:.3g} times the derivative of the position: at another sampling rate?"
    log_ratio = _log_likelihood_ratio_of_copy(relation, informative)
    hypotheses.append(RoleHypothesis("other", "", text, log_ratio, prior, {"rate_": typical_factor}))
    text = "a different factor times the derivative of the position in every joint: friction?"
    log_ratio = _log_likelihood_ratio(unbounded, informative, FREE_FACTOR_LOG_DENSITY)
    hypotheses.append(RoleHypothesis("other", "", text, log_ratio, float(np.log(PRIOR["other"]))))
    return _ordered(hypotheses)


@OUTLIERS
def copies(motion: JointMotion, y: Array) -> list[RoleHypothesis]:
    """Hypotheses that a stream repeats a part of the motion: one factor for all joints, a lag and an offset."""
    informative = travels(motion.position, MIN_TRAVEL_SHARE)
    parts = motion.position, motion.velocity, motion.acceleration
    rates = (motion.velocity, motion.acceleration, None)
    hypotheses = []
    for quantity, part, rate in zip(("positions", "velocities", "accelerations"), parts, rates, strict=True):
        further = [np.ones_like(part), *([] if rate is None else [rate])]
        samples = effective_samples(part, y)
        for unit, factor in TURNS["position"].items():
            relation = fit(part / factor, y, further, samples, SAME_UNIT_FACTORS)
            text = f"repeats the {quantity}, in {unit}" if unit != "rad" else f"repeats the {quantity}"
            prior = float(np.log(PRIOR["copy"] * PRIOR[unit])) + _signs_prior(np.sign(relation.factor[informative]))
            log_ratio = _log_likelihood_ratio_of_copy(relation, informative)
            hypotheses.append(RoleHypothesis("copy", unit, text, log_ratio, prior))
    return _ordered(hypotheses)


def is_magnitude(motion: JointMotion, y: Array) -> bool:
    """Whether a stream never changes its sign although the torque of some joint does, by more than friction.

    Registers of currents without sign hold magnitudes. A joint without gravity load, as a vertical first axis, is
    accelerated and braked by torques of both signs.

    Args:
        motion: Motion of the joints.
        y: The stream, :meth:`JointMotion.sampled`, ``(k, n)``.
    """
    torque, changing = motion.rigid_torque, np.ptp(y, axis=0) > 0.0
    smaller_side = np.minimum(np.max(torque, axis=0), -np.min(torque, axis=0))
    two_signed = smaller_side > MIN_OPPOSITE_SHARE * np.ptp(torque, axis=0)
    reverses = np.minimum(np.max(motion.velocity, axis=0), -np.min(motion.velocity, axis=0)) > 0.0
    one_sided = np.all(y >= 0.0) or np.all(y <= 0.0)
    return bool(one_sided and changing.sum() > 1 and np.any(changing & two_signed & reverses))


@OUTLIERS
def motor_positions(motion: JointMotion, y: Array) -> list[RoleHypothesis]:
    """Units of motor angles, which equal joint angles up to gear ratio and deflection, the likeliest first.

    Args:
        motion: Motion of the joints.
        y: The stream, :meth:`JointMotion.sampled`, ``(k, n)``.
    """
    informative = travels(motion.position, MIN_TRAVEL_SHARE)
    further = np.ones_like(y), motion.rigid_torque
    samples = effective_samples(motion.position, y)
    hypotheses = []
    for turns, slide in (("rad", "m"), ("deg", "mm")):
        factor = TURNS["position"][turns]
        relation = fit(motion.position / factor, y, further, samples)
        if not np.all(np.abs(relation.correlation[informative]) > MIN_CORRELATION_OF_COLUMNS):
            continue
        typical_ratio = float(np.median(np.abs(relation.factor[informative])))
        positive = bool(np.all(relation.factor[informative] > 0.0))
        direct = SAME_UNIT_FACTORS[0] < typical_ratio < SAME_UNIT_FACTORS[1] and positive
        if not direct and turns != "rad":  # another unit only changes the ratio
            continue
        gear_ratios = np.where(informative, relation.factor, typical_ratio)
        deviation = factor * y / (1.0 if direct else gear_ratios) - motion.position
        deflection = float(np.max(np.std(deviation[:, informative], axis=0)))
        if deflection == 0.0:  # a copy of the positions
            continue
        text = f"follows the positions, {deflection:.3g} rad rms away from them"
        text += "" if direct else f", with gear ratios {range_in_words(gear_ratios[informative])}"
        keys = {} if direct else {"factor": [float(f"{1.0 / gear_ratio:.6g}") for gear_ratio in gear_ratios]}
        prior = float(np.log(PRIOR[turns])) - (0.0 if direct else float(np.log(MAX_GEAR_RATIO)))
        hypotheses.append(RoleHypothesis("position", motion.unit(turns, slide), text, 0.0, prior, keys))
    return _ordered(hypotheses)


@OUTLIERS
def torques(motion: JointMotion, y: Array) -> list[RoleHypothesis]:
    """Units of a torque, motor currents, or neither, the likeliest first; empty: the motion takes no torque.

    Args:
        motion: Motion of the joints.
        y: The stream, :meth:`JointMotion.sampled`, ``(k, n)``.
    """
    rigid_torque = motion.rigid_torque
    informative = driven_joints(rigid_torque - rigid_torque.mean(axis=0), motion.model) & (np.ptp(y, axis=0) > 0.0)
    if not np.any(informative):
        return []
    friction = dry_friction(motion.velocity), motion.velocity, np.ones_like(y)
    samples = effective_samples(rigid_torque, y)
    unbounded = fit(rigid_torque, y, friction, samples)
    heavy = informative & (np.abs(unbounded.correlation) > MIN_CORRELATION)
    heavy = heavy if np.any(heavy) else informative
    text = (
        f"{range_in_words(unbounded.factor[heavy])} times the torque that gravity and inertia of the arm take in "
        f"{_joints_in_words(heavy)}"
    )
    if np.any(contradicting := informative & ~heavy):
        text += (
            f"; {range_in_words(unbounded.factor[contradicting])} times in {_joints_in_words(contradicting)}, with a "
            f"correlation of {range_in_words(unbounded.correlation[contradicting])}: columns of other joints?"
        )
    text += "" if np.all(informative) else "; the other joints show nothing, and are assumed to have the same unit"
    signs = np.where(heavy, np.sign(unbounded.factor), usual_sign(unbounded.factor[heavy]))
    further: dict[str, Any] = {} if np.all(signs > 0.0) else {"factor": signs_of(signs)}
    hypotheses = []
    for turns, slide in (("N m", "N"), ("mN m", "mN")):
        per_unit = 1.0 / TURNS["torque"][turns]
        relation = fit(per_unit * rigid_torque, y, friction, samples, TORQUE_UNIT_FACTORS)
        size = np.log(np.abs(relation.factor)) / LOG_TORQUE_FACTOR_SIGMA
        log_density = -0.5 * np.square(size) - np.log(LOG_TORQUE_FACTOR_SIGMA * np.sqrt(2.0 * np.pi))
        prior = float(np.log(PRIOR[turns])) + _signs_prior(signs[heavy])
        unit = motion.unit(turns, slide)
        log_ratio = _log_likelihood_ratio(relation, informative, log_density)
        hypotheses.append(RoleHypothesis("torque", unit, text, log_ratio, prior, further))
    inertial_rms = np.std(rigid_torque - motion.gravity_torque, axis=0)
    # Inertia shows no torque constant, because the motors' own inertia is unknown.
    gravity_shown = heavy & (np.std(motion.gravity_torque, axis=0) > inertial_rms)
    gravity_shown = gravity_shown if np.any(gravity_shown) else heavy
    typical_factor = float(np.clip(np.median(np.abs(unbounded.factor[gravity_shown])), *INVERSE_TORQUE_CONSTANTS))
    sign = usual_sign(unbounded.factor[heavy])
    bounds = typical_factor / np.sqrt(MAX_CONSTANT_RATIO), typical_factor * np.sqrt(MAX_CONSTANT_RATIO)
    relation = fit(sign * rigid_torque, y, friction, samples, bounds)
    opposite = relation.factor < 0.0
    factors = np.where(gravity_shown & ~opposite, np.maximum(np.abs(unbounded.factor), 1e-12), typical_factor)
    constants = {"torque_constant": [float(f"{constant:.3g}") for constant in 1.0 / factors]}
    current_keys = constants if sign > 0.0 else {"factor": -1.0, **constants}
    evidence = f"{text}: no unit of torque; assumed: currents, or torques before gears, with constants by gravity"
    # The constant of the first joint is anywhere in the range, and the others are near it.
    log_range = float(np.log(np.log(MAX_CONSTANT_RATIO)))
    any_constant = np.log(INVERSE_TORQUE_CONSTANTS[1] / INVERSE_TORQUE_CONSTANTS[0])
    prior = float(np.log(PRIOR["A"] * SIGN_PRIOR[0 if sign > 0.0 else 1] / any_constant)) + log_range
    log_ratio = _log_likelihood_ratio(relation, informative, np.where(opposite, -np.inf, -log_range))
    hypotheses.append(RoleHypothesis("current", "A", evidence, log_ratio, prior, current_keys))
    log_ratio = _log_likelihood_ratio(unbounded, informative, FREE_FACTOR_LOG_DENSITY)
    hypotheses.append(RoleHypothesis("other", "", f"{text}: in no unit", log_ratio, float(np.log(PRIOR["other"]))))
    return _ordered(hypotheses)


def driven_joints(torque: Array, model: RobotModel) -> NDArray[np.bool_]:
    """Joints with a noticeable torque, by the torque ``(k, n)`` [N m] of the motion; ``(n,)``."""
    scale = Proportion.of_robots([model.facts], np.asarray(model.pinocchio.gravity.linear)).factor("N m")
    return np.asarray(np.sqrt(np.mean(np.square(torque), axis=0)) > MIN_TORQUE_NM * scale)


# ---- likelihoods ----------------------------------------------------------------------------------------------------


def _log_likelihood_ratio(
    relation: LinearRelation, informative: NDArray[np.bool_], log_density: Array | float
) -> float:
    """Log likelihood ratio of a role to no role, with the density of the factors, summed over informative joints.

    The column of a joint is broken, or holds another joint, with :data:`PROBABILITY_OF_BROKEN_ORDER`: a single joint
    refutes no role.
    """
    ratios = relation.log_likelihood_ratio - 0.5 * np.log(relation.independent) + log_density
    ratios = np.where(np.isfinite(ratios), ratios, -np.inf)
    return float(np.sum(np.logaddexp(ratios, np.log(PROBABILITY_OF_BROKEN_ORDER))[informative]))


def _log_likelihood_ratio_of_copy(relation: LinearRelation, informative: NDArray[np.bool_]) -> float:
    """:func:`_log_likelihood_ratio` of velocities and copies of the motion, which have less noise than signal."""
    noisy = relation.misfit > (1.0 - MIN_CORRELATION**2) * relation.unexplained
    return _log_likelihood_ratio(relation, informative, np.where(noisy, -np.inf, LOW_PASS_LOG_DENSITY))


def _signs_prior(signs: Array) -> float:
    if np.all(signs > 0.0):
        return float(np.log(SIGN_PRIOR[0]))
    if np.all(signs < 0.0):
        return float(np.log(SIGN_PRIOR[1]))
    return float(np.log(SIGN_PRIOR[2]) - signs.size * np.log(2.0))


def _contradictions(moving: NDArray[np.bool_], relation: LinearRelation) -> tuple[str, ...]:
    """Joints whose velocity has the opposite sign of the others, or is not the derivative of their position."""
    factors = relation.factor
    correlated = np.abs(relation.correlation) >= MIN_CORRELATION
    sign_differs = np.sign(factors) != usual_sign(factors[moving])
    unrelated, opposite = np.flatnonzero(moving & ~correlated), np.flatnonzero(moving & correlated & sign_differs)
    text = []
    if unrelated.size:
        joints = _joint_numbers(unrelated)
        text.append(f"velocities of joints {joints} are not the derivative of their positions: other columns?")
    if opposite.size:
        text.append(
            f"velocities of joints {_joint_numbers(opposite)} have the opposite sign of the others: their positions or "
            "their velocities are inverted, and nothing here shows which; assumed: the velocities"
        )
    return tuple(text)


def _joints_in_words(mask: NDArray[np.bool_]) -> str:
    return f"joint{'s' if np.sum(mask) > 1 else ''} {_joint_numbers(np.flatnonzero(mask))}"


def _joint_numbers(numbers: NDArray[np.signedinteger]) -> str:
    return ", ".join(str(number + 1) for number in numbers)


def _ordered(hypotheses: Sequence[RoleHypothesis]) -> list[RoleHypothesis]:
    return sorted(hypotheses, key=lambda hypothesis: hypothesis.log_posterior, reverse=True)


def travels(position: Array, share: float) -> NDArray[np.bool_]:
    """Joints that travel at least a share of the farthest travel of all, ``(n,)``."""
    travel = np.ptp(position, axis=0)
    return np.asarray(travel >= share * float(np.max(travel)))


def usual_sign(ratio: Array) -> float:
    """Sign of the majority; 1 if there is no majority."""
    return -1.0 if np.sum(np.sign(ratio)) < 0.0 else 1.0


def range_in_words(values: Array) -> str:
    """Smallest and largest number, in words."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} ... {high:.3g}"


def signs_of(signs: Array) -> Any:
    """One sign if all are equal, else a list."""
    return float(signs[0]) if np.all(signs == signs[0]) else [float(sign) for sign in signs]
