# SPDX-License-Identifier: Apache-2.0
"""Desired positions of servos among the streams of a log without torque, by likelihood.

A proportional servo turns its error e = q_d - q into the torque of the motion:

    e = (M ddq + h) / K_p + F + D dq + B ddq + c     F: dry friction; D: damping of servo and gear; B: motor inertia

with K_p > 0, anywhere within a factor of 1e4, and joints that follow targets within their limits. The log likelihood
ratio to the same fit without M ddq + h has samples and priors as in :mod:`hypotheses`; with the gravity torque
left out it shows a controller that adds it. Without recorded gains K_p follows from

    M ddq + h = K_p e - F - D dq - B ddq - c

in the joints that carry gravity; the others get the geometric mean, as motor inertia takes the place of their torque.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.file_units import factors_of
from impact_rs_trials.recordings.importing.candidates import Q_DESIRED
from impact_rs_trials.recordings.importing.hypotheses import (
    MAIN_TRAVEL_SHARE,
    MAX_OUTSIDE_SHARE,
    NAME_LOG_ODDS,
    OUTLIERS,
    PRIOR,
    PROBABILITY_OF_BROKEN_ORDER,
    driven_joints,
    range_in_words,
    travels,
)
from impact_rs_trials.recordings.importing.joint_search import Assignment, JointSearch, with_commands
from impact_rs_trials.recordings.importing.joint_streams import COMMANDED, JointStream
from impact_rs_trials.recordings.joint_motion import JointMotion
from impact_rs_trials.recordings.mapping import TorqueMeaning
from impact_rs_trials.recordings.relations import DECISIVE_LOG_ODDS, dry_friction, effective_samples, fit
from impact_rs_trials.recordings.servo import Damps

PROPORTIONAL = re.compile(r"(^|[^a-z])(k_?p|p_?gains?|gains?_?p|stiffness(es)?)([^a-z]|$)", re.IGNORECASE)
DERIVATIVE = re.compile(r"(^|[^a-z])(k_?d|d_?gains?|gains?_?d|dampings?)([^a-z]|$)", re.IGNORECASE)
LOG_GAIN_RANGE = float(np.log(1e4))  # of the gain of a joint that is unknown
MIN_GRAVITY_SHARE = 0.3  # of the torque of inertia, from which gravity shows the gain of a joint
MAX_TARGET_EXCESS_SHARE = 0.5  # of the range of a joint, by which a target may pass its end to push there
UNITS_OF_TARGETS = {"rad": "m", "deg": "m", "mrad": "mm"}  # of joints that turn, and that slide
MIN_SERVO_SAMPLES = 5.0  # independent ones; fewer show no relation


@dataclass(frozen=True)
class FoundServo:
    """Desired positions of the servos that drive a motion.

    Attributes:
        motion: Positions and velocities.
        stream: Desired positions.
        unit: Their unit.
        kp: Gains by recorded columns or by the gravity torque, ``(n,)`` [N m/rad].
        kd: Recorded gains of the velocity, ``(n,)`` [N m s/rad]; None: unknown.
        damps: Velocity that kd damps: that of the joint or of the position error.
        known: Whether kp was recorded.
        shown: Joints from whose gravity kp was found, ``(n,)``; all if it was recorded.
        meaning: Whether the servos carry gravity.
        log_odds: Log posterior odds of this role against none.
        margin: Log odds against the next stream, unit or meaning.
        evidence: Evidence in words.
    """

    motion: Assignment
    stream: JointStream
    unit: str
    kp: Array
    kd: Array | None
    damps: Damps
    known: bool
    shown: NDArray[np.bool_]
    meaning: TorqueMeaning
    log_odds: float
    margin: float
    evidence: str

    @property
    def log_posterior(self) -> float:
        """Log posterior of the motion, of a pair that is left over, and of the servos that drive it."""
        return self.motion.motion_log_posterior + self.motion.further_log_likelihood + self.log_odds

    @property
    def reading(self) -> tuple[str, str]:
        """Unit, and whether gravity is carried."""
        return str(self.unit), self.meaning

    @property
    def declared(self) -> bool:
        """Whether the format of the file says which are positions and desired positions, and both have one unit."""
        position = self.motion.position
        named = self.stream.candidate.guess == Q_DESIRED and position.stream.candidate.guess == "position"
        return named and self.unit == position.best.unit

    def same_columns(self, other: FoundServo) -> bool:
        """Whether positions and desired positions are the same numbers."""
        pairs = (self.stream, other.stream), (self.motion.position.stream, other.motion.position.stream)
        return all(np.array_equal(one.series.values, two.series.values) for one, two in pairs)

    @property
    def sure(self) -> bool:
        """Whether the margin is decisive."""
        return self.margin > DECISIVE_LOG_ODDS


def gains_in(streams: Sequence[JointStream], pattern: re.Pattern[str]) -> tuple[Array | None, str | None]:
    """Constant gains in a stream with such a name, ``(n,)``, and a warning about one that changes."""
    for stream in streams:
        if not pattern.search(stream.column_text) or stream.is_cut:
            continue
        values = stream.series.values
        if np.ptp(values, axis=0).any():
            return (
                None,
                f"{stream.label} changes, and servos with changing gains are not described: gains are estimated",
            )
        if np.all(values[0] >= 0.0):
            return values[0], None
    return None, None


def named_servo_torques(search: JointSearch, found: Assignment) -> Iterator[Array]:
    """Torque that recorded gains make of every stream that is called a target, in the order of the columns [N m].

    It shows the order of joints without names, as a recorded torque does, where no law is known to hold yet.

    Args:
        search: Streams and arm.
        found: Positions in the unit of the targets, and velocities.
    """
    kp, kd = (gains_in(search.streams, pattern)[0] for pattern in (PROPORTIONAL, DERIVATIVE))
    if kp is None or np.any(kp <= 0.0):
        return
    damping = 0.0 if kd is None else kd * found.speeds
    for stream in search.streams:
        if COMMANDED.search(stream.candidate.label) and not stream.stands_apart(found.position.stream):
            target = found.position.factor * stream.series.at(found.time)
            yield np.asarray(kp * (target - found.position.values) - damping)


def find_servo(search: JointSearch, motions: Sequence[Assignment]) -> FoundServo | None:
    """The likeliest stream of desired positions over all motions; None: none is decisively a servo's.

    One that its format declares to be that is taken without evidence, with a margin below 0.

    Args:
        search: Streams and arm.
        motions: Positions, with velocities where these were recorded.
    """
    kp, kd = (gains_in(search.streams, pattern)[0] for pattern in (PROPORTIONAL, DERIVATIVE))
    kp = None if kp is None or np.any(kp <= 0.0) else kp
    found = [one for motion in with_commands(motions) for one in _servos_of(search, motion, kp, kd)]
    found.sort(key=lambda one: one.log_posterior, reverse=True)
    if not found:
        return None
    best = found[0]
    if best.log_odds < DECISIVE_LOG_ODDS:
        declared = [one for one in found if one.declared]
        if not declared:
            return None
        best = declared[0]
        return replace(best, margin=best.log_odds)
    # Columns that were grouped in several ways are one stream.
    others = [one for one in found[1:] if not (one.same_columns(best) and one.reading == best.reading)]
    following = max((one.log_posterior for one in others), default=-np.inf)
    return replace(best, margin=min(best.log_posterior - following, best.log_odds))


@OUTLIERS
def _servos_of(search: JointSearch, found: Assignment, kp: Array | None, kd: Array | None) -> Iterator[FoundServo]:
    """Servos that may drive one motion."""
    motion = found.motion(search.model)
    needed: dict[TorqueMeaning, Array] = {
        "whole": motion.rigid_torque,
        "without_gravity": motion.rigid_torque - motion.gravity_torque,
    }
    weight = driven_joints(motion.gravity_torque - motion.gravity_torque.mean(axis=0), search.model)
    for stream in search.free_of(found.streams):
        if not np.ptp(stream.series.values, axis=0).all():
            continue
        y = motion.sampled(stream.series.at(found.time))
        named = NAME_LOG_ODDS if COMMANDED.search(f"{stream.file} {stream.column_text}") else 0.0
        named -= NAME_LOG_ODDS if stream.candidate.guess in ("velocity", "acceleration", "torque") else 0.0
        for unit, slide in UNITS_OF_TARGETS.items():
            error = factors_of("position", motion.unit(unit, slide)) * y - motion.position
            if not _follows(motion, error):
                continue
            for meaning, torque in needed.items():
                if meaning == "without_gravity" and not np.any(weight):
                    continue
                ratio = _log_likelihood_ratio(motion, error, torque, search)
                yield _servo(found, stream, unit, motion, error, (meaning, torque), (kp, kd), ratio + named)


def _follows(motion: JointMotion, error: Array) -> bool:
    """Whether the joints follow their targets ``q + error``, which lie within their limits."""
    low, high = (np.array(getattr(motion.facts.limits, f"position_{end}_rad")) for end in ("min", "max"))
    beyond = MAX_TARGET_EXCESS_SHARE * (high - low)
    target = motion.position + error
    inside = np.mean((target >= low - beyond) & (target <= high + beyond), axis=0)
    moving = travels(motion.position, MAIN_TRAVEL_SHARE)
    apart = np.std(error[:, moving], axis=0) / np.std(motion.position[:, moving], axis=0)
    return bool(np.all(inside > 1.0 - MAX_OUTSIDE_SHARE) and np.median(apart) < 1.0)


def _log_likelihood_ratio(motion: JointMotion, error: Array, torque: Array, search: JointSearch) -> float:
    """Log likelihood ratio of an error that makes the torque to one that does not, with the prior of the gains."""
    shown = driven_joints(torque - torque.mean(axis=0), search.model)
    if not np.any(shown):
        return -np.inf
    samples = np.maximum(effective_samples(torque, error), MIN_SERVO_SAMPLES)
    further = dry_friction(motion.velocity), motion.velocity, motion.acceleration, np.ones_like(error)
    relation = fit(torque, error, further, samples)
    each = relation.log_likelihood_ratio - 0.5 * np.log(relation.independent) - np.log(LOG_GAIN_RANGE)
    each = np.where((relation.factor > 0.0) & np.isfinite(each), each, -np.inf)
    return float(np.sum(np.logaddexp(each, np.log(PROBABILITY_OF_BROKEN_ORDER))[shown]))


def _servo(
    found: Assignment,
    stream: JointStream,
    unit: str,
    motion: JointMotion,
    error: Array,
    needed: tuple[TorqueMeaning, Array],
    gains: tuple[Array | None, Array | None],
    log_ratio: float,
) -> FoundServo:
    meaning, torque = needed
    kp, kd = gains
    estimate, shown = _estimated_gains(motion, error, torque)
    evidence = f"q_desired - q in {unit} drives the motion"
    if meaning == "without_gravity":
        evidence += " without its gravity torque, which the controller adds"
    if kp is None:
        evidence += f", with kp {range_in_words(estimate)} N m/rad by gravity and inertia of the model"
    else:
        ratio = estimate[shown] / kp[shown]
        evidence += f", with {range_in_words(ratio)} times the recorded gains by gravity and inertia of the model"
    damps: Damps = "velocity"
    if kp is not None and kd is not None:
        damps = _damped(motion, error, torque, kp, kd)
    return FoundServo(
        motion=found,
        stream=stream,
        unit=motion.unit(unit, UNITS_OF_TARGETS[unit]),
        kp=estimate if kp is None else kp,
        kd=kd if kp is not None else None,
        damps=damps,
        known=kp is not None,
        shown=shown if kp is None else np.ones_like(shown),
        meaning=meaning,
        log_odds=log_ratio + float(np.log(PRIOR[unit])),
        margin=0.0,
        evidence=evidence,
    )


def _estimated_gains(motion: JointMotion, error: Array, torque: Array) -> tuple[Array, NDArray[np.bool_]]:
    """K_p of every joint ``(n,)``, and the joints that show their own: those that carry gravity, or else all.

    Where no gravity is carried the motor inertia, whose torque resembles the torque of the links, is taken as zero.
    """
    friction = [dry_friction(motion.velocity), motion.velocity, np.ones_like(error)]
    inertia = np.std(motion.rigid_torque - motion.gravity_torque, axis=0)
    weighs = np.std(motion.gravity_torque, axis=0) > MIN_GRAVITY_SHARE * inertia
    free = fit(error, torque, [*friction, motion.acceleration])
    carried = weighs & (free.factor > 0.0) & (torque is motion.rigid_torque)
    if not np.any(carried):
        free = fit(error, torque, friction)
        carried = free.factor > 0.0
    if not np.any(carried):
        return np.ones(error.shape[1]), np.ones(error.shape[1], dtype=bool)
    usual = float(np.exp(np.mean(np.log(free.factor[carried]))))
    return np.where(carried, np.maximum(free.factor, 1e-9), usual), carried


def _damped(motion: JointMotion, error: Array, torque: Array, kp: Array, kd: Array) -> Damps:
    """Whether kd damps the velocity or the velocity error, by what friction and motor inertia leave of the torque."""
    desired_velocity = motion.velocity + np.gradient(error, motion.moments, axis=0)
    further = dry_friction(motion.velocity), motion.velocity, np.ones_like(error)
    left = {}
    damped: Damps
    for damped, target in (("velocity", 0.0), ("error", desired_velocity)):
        driving = kp * error + kd * (target - motion.velocity)
        relation = fit(motion.acceleration, driving - torque, further)
        left[damped] = float(np.sum(np.log(np.maximum(relation.misfit, 1e-12))))
    return "error" if left["error"] < left["velocity"] else "velocity"
