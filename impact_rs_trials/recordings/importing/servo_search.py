# SPDX-License-Identifier: Apache-2.0
"""Desired positions of servos among the streams of a log without torque, by likelihood.

A proportional servo turns its error e = q_d - q into the torque of the motion:

    e = (M ddq + h) / K_p + F + D dq + B ddq + c     F: dry friction; D: damping of servo and gear; B: motor inertia

with K_p > 0, anywhere within a factor of 1e4, and joints that follow targets within their limits. The log likelihood
ratio to the same fit without M ddq + h has samples and priors as in :mod:`hypotheses`. The same without the gravity
torque shows a controller that adds gravity. Without recorded gains K_p follows from

    M ddq + h = K_p e - F - D dq - B ddq - c

in the joints under gravity load. The other joints get the geometric mean, because motor inertia and inertia of the
links have similar torques.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.file_units import factors_of
from impact_rs_trials.recordings.importing.candidates import COMMANDED, Q_DESIRED
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
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.joint_motion import JointMotion
from impact_rs_trials.recordings.mapping import TorqueMeaning
from impact_rs_trials.recordings.readers.turns import unwrapped
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
class ServoHypothesis:
    """A stream as the desired positions of the servos that drive a motion.

    Attributes:
        motion: Positions and velocities.
        stream: Desired positions.
        unit: Their unit.
        kp: Gains by recorded columns or by the gravity torque, ``(n,)`` [N m/rad].
        kd: Recorded gains of the velocity, ``(n,)`` [N m s/rad]; None: unknown.
        damps: Whether kd damps the velocity of the joint or of the position error.
        has_recorded_gains: Whether kp was recorded.
        informative: Joints whose gravity torque shows kp, ``(n,)``; all if it was recorded.
        meaning: Whether the servos carry gravity.
        log_odds: Log posterior odds of this role against no role.
        margin: Log odds against the next stream, unit or meaning.
        evidence: Evidence in words.
    """

    motion: Assignment
    stream: JointStream
    unit: str
    kp: Array
    kd: Array | None
    damps: Damps
    has_recorded_gains: bool
    informative: NDArray[np.bool_]
    meaning: TorqueMeaning
    log_odds: float
    margin: float
    evidence: str

    @property
    def log_posterior(self) -> float:
        """Log posterior of the motion, of its second pair of streams, and of the servos that drive it."""
        return self.motion.motion_log_posterior + self.motion.further_log_likelihood + self.log_odds

    @property
    def reading(self) -> tuple[str, str]:
        """Unit, and whether the servos carry gravity."""
        return str(self.unit), self.meaning

    @property
    def declared(self) -> bool:
        """Whether the file format names positions and desired positions, and both have the same unit."""
        position = self.motion.position
        named = self.stream.candidate.guess == Q_DESIRED and position.stream.candidate.guess == "position"
        return named and self.unit == position.best.unit

    def same_columns(self, other: ServoHypothesis) -> bool:
        """Whether positions and desired positions are the same numbers."""
        pairs = (self.stream, other.stream), (self.motion.position.stream, other.motion.position.stream)
        return all(np.array_equal(first.series.values, second.series.values) for first, second in pairs)

    @property
    def sure(self) -> bool:
        """Whether the margin is decisive."""
        return self.margin > DECISIVE_LOG_ODDS


def gains_in(streams: Sequence[JointStream], pattern: re.Pattern[str]) -> tuple[Array | None, str | None]:
    """Constant gains in a stream with a matching name, ``(n,)``, and a warning about gains that change."""
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


def named_servo_torques(search: JointSearch, assignment: Assignment) -> Iterator[Array]:
    """Torque of the recorded gains with every stream that has the name of a target, in the order of the columns [N m].

    It shows the order of unnamed joints, as a recorded torque does, before a law of the servos was found.

    Args:
        search: Streams and arm.
        assignment: Positions in the unit of the targets, and velocities.
    """
    kp, kd = (gains_in(search.streams, pattern)[0] for pattern in (PROPORTIONAL, DERIVATIVE))
    if kp is None or np.any(kp <= 0.0):
        return
    damping = 0.0 if kd is None else kd * assignment.speeds
    for stream in search.streams:
        if COMMANDED.search(stream.candidate.label) and not stream.stands_apart(assignment.position.stream):
            target = assignment.position.factor * stream.series.at(assignment.time)
            yield np.asarray(kp * (target - assignment.position.values) - damping)


def find_servo(search: JointSearch, motions: Sequence[Assignment]) -> ServoHypothesis | None:
    """The likeliest stream of desired positions over all motions; None: no stream is decisive.

    Desired positions that the file format declares need no evidence; their margin is then small or below 0.

    Args:
        search: Streams and arm.
        motions: Positions, with velocities where these were recorded.
    """
    kp, kd = (gains_in(search.streams, pattern)[0] for pattern in (PROPORTIONAL, DERIVATIVE))
    kp = None if kp is None or np.any(kp <= 0.0) else kp
    servos = [servo for motion in with_commands(motions) for servo in _servos_of(search, motion, kp, kd)]
    servos.sort(key=lambda servo: servo.log_posterior, reverse=True)
    if not servos:
        return None
    best = servos[0]
    if best.log_odds < DECISIVE_LOG_ODDS:
        declared = [servo for servo in servos if servo.declared]
        if not declared:
            return None
        best = declared[0]
        return replace(best, margin=best.log_odds)
    # Columns that were grouped in several ways are one stream.
    rivals = [servo for servo in servos[1:] if not (servo.same_columns(best) and servo.reading == best.reading)]
    next_log_posterior = max((servo.log_posterior for servo in rivals), default=-np.inf)
    return replace(best, margin=min(best.log_posterior - next_log_posterior, best.log_odds))


@OUTLIERS
def _servos_of(
    search: JointSearch, assignment: Assignment, kp: Array | None, kd: Array | None
) -> Iterator[ServoHypothesis]:
    """Servos that may drive one motion."""
    motion = assignment.motion(search.model)
    torques: dict[TorqueMeaning, Array] = {
        "whole": motion.rigid_torque,
        "without_gravity": motion.rigid_torque - motion.gravity_torque,
    }
    weight = driven_joints(motion.gravity_torque - motion.gravity_torque.mean(axis=0), search.model)
    for stream in search.free_of(assignment.streams):
        if not np.ptp(stream.series.values, axis=0).all():
            continue
        named = NAME_LOG_ODDS if COMMANDED.search(f"{stream.file} {stream.column_text}") else 0.0
        named -= NAME_LOG_ODDS if stream.candidate.guess in ("velocity", "acceleration", "torque") else 0.0
        for unit, slide in UNITS_OF_TARGETS.items():
            values = factors_of("position", motion.unit(unit, slide)) * stream.series.values
            target = unwrapped(replace(stream.series, values=values), motion.facts, assignment.in_si)
            error = motion.sampled(target.at(assignment.time)) - motion.position
            if not _follows(motion, error):
                continue
            for meaning, torque in torques.items():
                if meaning == "without_gravity" and not np.any(weight):
                    continue
                ratio = _log_likelihood_ratio(motion, error, torque, search)
                yield _servo(assignment, stream, unit, motion, error, (meaning, torque), (kp, kd), ratio + named)


def _follows(motion: JointMotion, error: Array) -> bool:
    """Whether the joints follow their targets ``q + error``, which lie within their limits."""
    low, high = (np.array(getattr(motion.facts.limits, f"position_{end}_rad")) for end in ("min", "max"))
    excess = MAX_TARGET_EXCESS_SHARE * (high - low)
    target = motion.position + error
    inside = np.mean((target >= low - excess) & (target <= high + excess), axis=0)
    moving = travels(motion.position, MAIN_TRAVEL_SHARE)
    relative_error = np.std(error[:, moving], axis=0) / np.std(motion.position[:, moving], axis=0)
    return bool(np.all(inside > 1.0 - MAX_OUTSIDE_SHARE) and np.median(relative_error) < 1.0)


def _log_likelihood_ratio(motion: JointMotion, error: Array, torque: Array, search: JointSearch) -> float:
    """Log likelihood ratio of a position error that makes the torque to one without it, with the prior of the gains."""
    informative = driven_joints(torque - torque.mean(axis=0), search.model)
    if not np.any(informative):
        return -np.inf
    samples = np.maximum(effective_samples(torque, error), MIN_SERVO_SAMPLES)
    further = dry_friction(motion.velocity), motion.velocity, motion.acceleration, np.ones_like(error)
    relation = fit(torque, error, further, samples)
    ratios = relation.log_likelihood_ratio - 0.5 * np.log(relation.independent) - np.log(LOG_GAIN_RANGE)
    ratios = np.where((relation.factor > 0.0) & np.isfinite(ratios), ratios, -np.inf)
    return float(np.sum(np.logaddexp(ratios, np.log(PROBABILITY_OF_BROKEN_ORDER))[informative]))


def _servo(
    assignment: Assignment,
    stream: JointStream,
    unit: str,
    motion: JointMotion,
    error: Array,
    driving: tuple[TorqueMeaning, Array],
    gains: tuple[Array | None, Array | None],
    log_ratio: float,
) -> ServoHypothesis:
    meaning, torque = driving
    kp, kd = gains
    estimate, informative = _estimated_gains(motion, error, torque)
    evidence = f"q_desired - q in {unit} drives the motion"
    if meaning == "without_gravity":
        evidence += " without its gravity torque, which the controller adds"
    if kp is None:
        evidence += f", with kp {range_in_words(estimate)} N m/rad by gravity and inertia of the model"
    else:
        ratio = estimate[informative] / kp[informative]
        evidence += f", with {range_in_words(ratio)} times the recorded gains by gravity and inertia of the model"
    damps: Damps = "velocity"
    if kp is not None and kd is not None:
        damps = _damped(motion, error, torque, kp, kd)
    return ServoHypothesis(
        motion=assignment,
        stream=stream,
        unit=motion.unit(unit, UNITS_OF_TARGETS[unit]),
        kp=estimate if kp is None else kp,
        kd=kd if kp is not None else None,
        damps=damps,
        has_recorded_gains=kp is not None,
        informative=informative if kp is None else np.ones_like(informative),
        meaning=meaning,
        log_odds=log_ratio + float(np.log(PRIOR[unit])),
        margin=0.0,
        evidence=evidence,
    )


def _estimated_gains(motion: JointMotion, error: Array, torque: Array) -> tuple[Array, NDArray[np.bool_]]:
    """K_p ``(n,)`` [N m/rad], and a mask of the joints that determine it: joints under gravity load, or else all.

    Without gravity load the motor inertia is taken as 0, because its torque resembles the torque of the links.
    """
    friction = [dry_friction(motion.velocity), motion.velocity, np.ones_like(error)]
    inertia = np.std(motion.rigid_torque - motion.gravity_torque, axis=0)
    loaded = np.std(motion.gravity_torque, axis=0) > MIN_GRAVITY_SHARE * inertia
    relation = fit(error, torque, [*friction, motion.acceleration])
    carried = loaded & (relation.factor > 0.0) & (torque is motion.rigid_torque)
    if not np.any(carried):
        relation = fit(error, torque, friction)
        carried = relation.factor > 0.0
    if not np.any(carried):
        return np.ones(error.shape[1]), np.ones(error.shape[1], dtype=bool)
    typical_gain = float(np.exp(np.mean(np.log(relation.factor[carried]))))
    return np.where(carried, np.maximum(relation.factor, 1e-9), typical_gain), carried


def _damped(motion: JointMotion, error: Array, torque: Array, kp: Array, kd: Array) -> Damps:
    """Whether kd damps velocity or velocity error: the smaller residual of the torque, beyond friction and motors."""
    desired_velocity = motion.velocity + np.gradient(error, motion.moments, axis=0)
    further = dry_friction(motion.velocity), motion.velocity, np.ones_like(error)
    log_misfit = {}
    damped: Damps
    for damped, target in (("velocity", 0.0), ("error", desired_velocity)):
        driving = kp * error + kd * (target - motion.velocity)
        relation = fit(motion.acceleration, driving - torque, further)
        log_misfit[damped] = float(np.sum(np.log(np.maximum(relation.misfit, 1e-12))))
    return "error" if log_misfit["error"] < log_misfit["velocity"] else "velocity"
