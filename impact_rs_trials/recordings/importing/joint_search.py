# SPDX-License-Identifier: Apache-2.0
"""Assignment of the streams of a recording to positions, velocities and torques of a robot's joints, by likelihood.

Every candidate for the positions gives one assignment; the others are velocity, torque or neither in its motion
(:mod:`hypotheses`). The log posterior of an assignment is the sum over its three streams; few streams are as wide as a
robot has joints, so all are tried. Several streams may fit one role, as a measured and a commanded torque do. Only
names show which of them was measured, for the other one is as likely in its own role: streams of one role are ordered
by their names, and else torques in the order of the file, and velocities by how well they fit the positions.

Commanded positions and velocities fit each other better than measured ones, because they have no noise, but do so in
either role. An assignment therefore includes the likelihood of the pair that it leaves over, and the torque decides
which pair moved the arm. Where one pair follows the other, tracking errors are small against the noise of measured
accelerations, from which a command is free: then the lag of one pair behind the other decides in place of the torque,
for a measured motion is late.

Velocities and accelerations are a pair as well, and accelerations that a filter derived from them fit without noise. An
assignment therefore includes the likelihood of the derivative of its velocities, which that pair has in its velocities:
what decides between both are the positions, of which only one makes sense.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.torque_readings import MotionTorque, is_computed, is_external, lacks_gravity
from impact_rs_trials.recordings.file_units import TURNS, factors_of
from impact_rs_trials.recordings.importing.hypotheses import (
    NAME_LOG_ODDS,
    OUTLIERS,
    Role,
    RoleChoice,
    RoleHypothesis,
    choose,
    copies,
    driven_joints,
    is_magnitude,
    motor_positions,
    positions,
    torques,
    velocities,
)
from impact_rs_trials.recordings.importing.import_texts import PossibleReading
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.joint_motion import JointMotion, unit_of_joints
from impact_rs_trials.recordings.mapping import TorqueMeaning
from impact_rs_trials.recordings.readers.guesses import holds_a_turn
from impact_rs_trials.recordings.relations import (
    DECISIVE_LOG_ODDS,
    MIN_REPORTED_SIGMA,
    AveragedMotion,
    averaged,
    fit,
)

MAX_TRACKING_MISFIT_SHARE = 0.1  # of the squares of a motion about its mean, which its command and a lag leave
MAGNITUDE = (
    "never changes its sign, although joints reverse whose torque has both signs: magnitudes, as of a current register "
    "without sign, are no torque"
)
MAX_LOG_POSTERIOR_LOSS = 20.0  # below the best, of motions whose torques are compared


@dataclass(frozen=True)
class Reading:
    """A stream in a role.

    Attributes:
        stream: The stream.
        choice: Its likeliest hypothesis, and the next.
        computed: Whether a torque holds no friction of gears, so that it was computed and not measured.
        meaning: Meaning of a torque.
    """

    stream: JointStream
    choice: RoleChoice
    computed: bool = False
    meaning: TorqueMeaning = "whole"

    @staticmethod
    def of(stream: JointStream, role: Role, unit: Any, evidence: str, margin: float) -> Reading:
        """A stream in a role without a likelihood: by evidence of another kind, or by its name (margin 0)."""
        return Reading(stream, RoleChoice(RoleHypothesis(role, unit, evidence, 0.0), None, margin))

    @property
    def best(self) -> RoleHypothesis:
        """Its likeliest hypothesis."""
        return self.choice.best

    @property
    def by_name(self) -> float:
        """Log prior of the role by the stream's name."""
        return self.stream.log_prior(self.best.role)

    @property
    def log_posterior(self) -> float:
        """Log posterior, with the prior by the stream's name."""
        return self.best.log_posterior + self.by_name

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key of the streams in a role: measured before computed, then by name."""
        return not self.computed, self.by_name

    @property
    def factor(self) -> Array:
        """Factor from its numbers to SI units, of all joints or ``(n,)``; of currents to amperes."""
        quantity = "torque" if self.best.role == "current" else self.best.role
        return factors_of(quantity, self.best.unit) * np.asarray(self.best.further.get("factor", 1.0))

    @property
    def values(self) -> Array:
        """Its numbers in SI units, ``(k, n)``; currents in amperes."""
        return np.asarray(self.stream.series.values * self.factor)


def alternatives(readings: Iterable[tuple[Reading, float]]) -> tuple[PossibleReading, ...]:
    """Readings with their log posteriors, and the next hypothesis of each: first the chosen one, then by likelihood."""
    (first, most), *others = readings
    following = [(one.stream, one.best, most - total) for one, total in others]
    for one, total in ((first, most), *others):
        if one.choice.next is not None:
            following.append((one.stream, one.choice.next, most - total + one.choice.margin))
    following.sort(key=lambda each: each[2])
    return tuple(
        PossibleReading(stream.label, dict(stream.candidate.source), own.unit, float(behind), own.evidence)
        for stream, own, behind in ((first.stream, first.best, 0.0), *following)
    )


@dataclass(frozen=True)
class Assignment:
    """Streams in the roles of position, velocity and torque.

    Attributes:
        position: The positions.
        velocity: The velocities; None: derivatives of the positions.
        torques: Streams that fit a torque, the chosen one first.
        no_torques: Why further streams are no torques, by label: copies of the motion, magnitudes.
        alternatives: Alternatives by signal, the chosen one first.
        beside: Log likelihood of the derivative of its velocities, and of a further pair of positions and velocities as
            a command and its lead.
        tracked: That pair, if one of both follows the other.
    """

    position: Reading
    velocity: Reading | None
    torques: tuple[Reading, ...]
    no_torques: dict[str, str]
    alternatives: Mapping[str, tuple[PossibleReading, ...]] = field(default_factory=dict)
    beside: float = 0.0
    tracked: Assignment | None = None

    @property
    def time(self) -> Array:
        """Timestamps of the positions, ``(k,)`` [s]."""
        return self.position.stream.series.time

    @property
    def streams(self) -> list[JointStream]:
        """Streams of positions and velocities."""
        return [one.stream for one in (self.position, self.velocity) if one is not None]

    def motion(self, model: RobotModel) -> JointMotion:
        """The motion, with velocities where these were recorded."""
        return JointMotion.of(self.time, self.position.values, None if self.velocity is None else self.speeds, model)

    def with_torque(self, torque: Array, model: RobotModel) -> MotionTorque:
        """The motion, and a torque at its timestamps, ``(k, n)`` [N m]."""
        return MotionTorque.seen(self.time, self.position.values, self.speeds, torque, model)

    @property
    def log_posterior(self) -> float:
        """Log posterior of all its streams."""
        return self.motion_log_posterior + self.beside + self.torque_log_posterior

    @property
    def torque_log_posterior(self) -> float:
        """Log posterior of its torque; 0: none fits."""
        return max((one.log_posterior for one in self.torques), default=0.0)

    @property
    def motion_log_posterior(self) -> float:
        """Log posterior of positions and velocities."""
        return self.position.log_posterior + (0.0 if self.velocity is None else self.velocity.log_posterior)

    @property
    def speeds(self) -> Array:
        """dq at the timestamps of the positions, ``(k, n)`` [rad/s, m/s]."""
        if self.velocity is None:
            return replace(self.position.stream.series, values=self.position.values).derivative().values
        return replace(self.velocity.stream.series, values=self.velocity.values).at(self.time)


class JointSearch:
    """Assignments of the streams of one recording.

    Args:
        streams: As wide as the robot has joints; a pose is no signal of joints.
        model: Nominal arm.
    """

    def __init__(self, streams: Sequence[JointStream], model: RobotModel) -> None:
        self.streams, self.model = [one for one in streams if not holds_a_turn(one.series.values)], model
        self._averages: dict[tuple[int, int], Array] = {}
        found = [
            (stream, choose(positions(stream.series.values, self.model.facts), -np.inf)) for stream in self.streams
        ]
        self.places = [
            Reading(stream, choice)
            for stream, choice in found
            if choice is not None and np.ptp(stream.series.values, axis=0).any()
        ]

    def motions(self) -> list[Assignment]:
        """Positions with velocity streams, the likeliest first."""
        found = [
            Assignment(place, fitting[0], (), {})
            for place in self.places
            if (
                fitting := self._velocities(
                    place, JointMotion.of(place.stream.series.time, place.values, None, self.model)
                )
            )
        ]
        return sorted(found, key=lambda one: one.motion_log_posterior, reverse=True)

    def without_velocity(self) -> list[Assignment]:
        """Positions alone, from streams without the name of another signal."""
        return [Assignment(place, None, (), {}) for place in self.places if place.by_name >= 0.0]

    def best(self, motions: Sequence[Assignment]) -> Assignment:
        """The likeliest of motions, with its torques and the alternatives of its signals."""
        motions = with_commands(motions)
        most = max(one.log_posterior for one in motions)
        searched = [one for one in motions if one.velocity is None or one.log_posterior > most - MAX_LOG_POSTERIOR_LOSS]
        tried = [self._with_torques(one) for one in searched]
        found = [_with_shared_torque(one, tried) for one in tried]
        found.sort(key=lambda one: one.log_posterior, reverse=True)
        best, places = found[0], {id(one.position.stream): one for one in (*motions, *found)}
        others = [one for one in places.values() if one.position.stream is not best.position.stream]
        listed = {"position": alternatives((one.position, one.log_posterior) for one in (best, *others))}
        if best.velocity is not None:
            motion = JointMotion.of(best.time, best.position.values, None, self.model)
            fitting = self._velocities(best.position, motion)
            listed["velocity"] = alternatives((one, one.by_name) for one in fitting)
        if best.torques:
            listed["torque"] = alternatives((one, one.by_name) for one in best.torques)
        return replace(best, alternatives=listed)

    def motors(self, found: Assignment) -> Reading | None:
        """Angles of the motors, if a stream with such a name follows the positions; None: no stream does."""
        motion = JointMotion.of(found.time, found.position.values, found.speeds, self.model)
        for stream in self.free_of([*found.streams, *(one.stream for one in found.torques[:1])]):
            if stream.is_of_motors:
                choice = choose(motor_positions(motion, self._sampled(motion, stream)), -np.inf)
                if choice is not None:
                    return Reading(stream, choice)
        return None

    def free_of(self, taken: Sequence[JointStream]) -> list[JointStream]:
        """Streams that may belong to the joints of others, and share no column with them."""
        return [one for one in self.streams if not any(one.stands_apart(other) for other in taken)]

    def velocities_at_other_rates(self) -> Iterator[tuple[JointStream, JointStream, float]]:
        """Positions, streams proportional to their derivative with one positive factor, and the factor."""
        for place in self.places:
            time = place.stream.series.time
            motion = JointMotion.of(time, place.values, None, self.model)
            for stream in self.streams:
                if not stream.overlaps(place.stream):
                    choice = choose(velocities(motion, self._sampled(motion, stream)))
                    factor = 0.0 if choice is None or not choice.sure else choice.best.further.get("rate_", 0.0)
                    if factor > 0.0:
                        yield place.stream, stream, factor

    def _sampled(self, motion: JointMotion, stream: JointStream) -> Array:
        """A stream at the samples of a motion; many motions share timestamps."""
        time = motion.time
        key = id(stream), hash(time.tobytes())
        if key not in self._averages:
            self._averages[key] = motion.sampled(stream.series.at(time))
        return self._averages[key]

    def _velocities(self, place: Reading, motion: JointMotion) -> list[Reading]:
        """Streams that are the derivative of the positions, by their names, and then by likelihood."""
        found = [
            Reading(stream, choice)
            for stream in self.free_of([place.stream])
            if (choice := choose(velocities(motion, self._sampled(motion, stream)))) is not None
            and choice.best.role == "velocity"
            and choice.best.log_posterior > DECISIVE_LOG_ODDS
        ]
        return sorted(_exclusive(found), key=lambda one: (one.by_name, one.log_posterior), reverse=True)

    @OUTLIERS
    def _with_torques(self, found: Assignment) -> Assignment:
        """With the streams that fit the torque of a motion, or else by name."""
        motion, free = found.motion(self.model), self.free_of(found.streams)
        cut = found.position.stream.is_cut  # of another robot, perhaps, for which the torque must speak
        fitting, weightless, no_torques = [], [], {}
        for stream in free:
            raw = stream.series.at(found.time)
            y = motion.sampled(raw)
            copy, torque = choose(copies(motion, y)), choose(torques(motion, y))
            least = DECISIVE_LOG_ODDS if torque is None else max(DECISIVE_LOG_ODDS, torque.best.log_posterior)
            if copy is not None and copy.best.log_posterior > least:
                no_torques[stream.label] = copy.best.evidence
                continue
            if is_magnitude(motion, y):
                no_torques[stream.label] = MAGNITUDE
                continue
            if (lacking := self._without_gravity(stream, found)) is not None:
                weightless.append(lacking)
                continue
            if torque is None or torque.best.role == "other" or torque.best.log_posterior <= DECISIVE_LOG_ODDS:
                continue
            if cut and not torque.sure:
                continue
            computed = self._is_computed(found.with_torque(raw, self.model), torque.best)
            fitting.append(Reading(stream, _named(stream, torque, motion, y), computed))
        fitting = _exclusive(fitting or weightless)
        if all(one.computed for one in fitting) and not cut:  # a controller's target is no measurement, a current is
            named = [one for one in free if _is_named(one) and one.label not in no_torques]
            named = [
                one for one in named if not fitting or one.log_prior("current") > max(one.log_prior("torque"), 0.0)
            ]
            fitting += [self._by_name(one, found, motion) for one in named]
            fitting.sort(key=lambda one: one.rank, reverse=True)
        return replace(found, torques=tuple(fitting), no_torques=no_torques)

    @OUTLIERS
    def _without_gravity(self, stream: JointStream, found: Assignment) -> Reading | None:
        """A stream in N m or mN m that is a torque without gravity; None: no evidence."""
        raw = stream.series.at(found.time)
        for unit, slide in {"N m": "N", "mN m": "mN"}.items():
            if (why := lacks_gravity(found.with_torque(TURNS["torque"][unit] * raw, self.model))) is not None:
                units = unit_of_joints(self.model.facts, unit, slide)
                return replace(Reading.of(stream, "torque", units, why, np.inf), meaning="without_gravity")
        return None

    def _is_computed(self, seen: MotionTorque, hypothesis: RoleHypothesis) -> bool:
        """Whether a torque at motors was computed; torque sensors behind the gears measure no gear friction."""
        at_motor = hypothesis.role == "current" or not self.model.facts.joint_torque_loop
        return at_motor and is_computed(seen)

    def _by_name(self, stream: JointStream, found: Assignment, motion: JointMotion) -> Reading:
        """A torque or a current that only its name shows."""
        raw = stream.series.at(found.time)
        if stream.log_prior("current") > stream.log_prior("torque"):
            for one in torques(motion, motion.sampled(raw)):
                if one.role == "current":
                    return Reading(stream, RoleChoice(one, None, 0.0))
        seen = found.with_torque(raw, self.model)
        evidence = "the motion takes too little torque to show it"
        if np.any(driven_joints(seen.whole, seen.model)):
            most, left = (
                np.sqrt(np.mean(np.square(seen.whole), axis=0)),
                np.sqrt(seen.left(seen.whole) / len(seen.whole)),
            )
            joint = int(np.argmax(most))
            evidence = (
                f"gravity and inertia of the arm take {most[joint]:.3g} N m rms in joint {joint + 1}, from which the "
                f"signal is {left[joint]:.3g} N m away: another robot, other joints or another quantity?"
            )
        unit = motion.unit("N m", "N")
        if (external := is_external(seen, stream.is_external)) is not None:
            reading = Reading.of(stream, "torque", unit, external.evidence, external.margin)
            return replace(reading, meaning="external")
        return Reading.of(stream, "torque", unit, f"nothing but its name: {evidence}", 0.0)


def with_commands(motions: Sequence[Assignment]) -> list[Assignment]:
    """Motions with the likelihood of streams that each leaves over, without which they are of different streams."""
    return [_with_command(one, motions) for one in motions]


def _with_shared_torque(found: Assignment, tried: Sequence[Assignment]) -> Assignment:
    """A motion with the likelihood of the torque for its command, if it is larger and one of both follows the other."""
    if found.tracked is None:
        return found
    command = found.tracked.position.stream
    other = max((one.torque_log_posterior for one in tried if one.position.stream is command), default=0.0)
    return replace(found, beside=found.beside + max(other - found.torque_log_posterior, 0.0))


def _disjoint(found: Assignment, other: Assignment) -> bool:
    """Whether two motions with velocities have no columns in common."""
    pairs = (
        (one.stream, two.stream)
        for one in (found.position, found.velocity)
        for two in (other.position, other.velocity)
        if one is not None and two is not None
    )
    return found.velocity is not None and other.velocity is not None and not any(a.overlaps(b) for a, b in pairs)


def _with_command(found: Assignment, motions: Sequence[Assignment]) -> Assignment:
    """A motion with the derivative of its velocities, and with the likeliest pair of other streams as its command.

    Both by likelihood, without names.
    """

    def velocity(of: Assignment) -> float:
        return 0.0 if of.velocity is None else of.velocity.best.log_posterior

    def derivative(of: Assignment) -> float:
        return max(
            (velocity(one) for one in motions if of.velocity and one.position.stream is of.velocity.stream), default=0.0
        )

    beside = derivative(found)
    pairs = [
        (one.position.best.log_posterior + velocity(one) + derivative(one), one)
        for one in motions
        if _disjoint(found, one)
    ]
    if not pairs:
        return replace(found, beside=beside)
    likelihood, command = max(pairs, key=lambda pair: pair[0])
    lateness = _lateness(found, command)
    return replace(found, beside=beside + likelihood + (lateness or 0.0), tracked=None if lateness is None else command)


def _lateness(found: Assignment, other: Assignment) -> float | None:
    """Log odds that a motion follows another one, by the sign of the lag L of q(t) = q_other(t - L) + c, all joints.

    None: it does not follow it, nor the other way around.
    """
    series = other.position.stream.series
    command = AveragedMotion.of(found.time, replace(series, values=other.position.values).at(found.time))
    q = averaged(found.time, found.position.values)[1]
    relation = fit(command.velocity, q - command.position, [np.ones_like(q)], command.independent)
    if np.sum(relation.misfit) > MAX_TRACKING_MISFIT_SHARE * np.sum(np.square(q - q.mean(axis=0))):
        return None
    weight = 1.0 / np.maximum(np.square(relation.standard_error), 1e-12)
    lag, error = -float(np.sum(weight * relation.factor) / np.sum(weight)), float(np.sum(weight) ** -0.5)
    return float(np.sign(lag)) * NAME_LOG_ODDS if abs(lag) > MIN_REPORTED_SIGMA * error else 0.0


def _named(stream: JointStream, choice: RoleChoice, motion: JointMotion, y: Array) -> RoleChoice:
    """A choice between torque and current with the prior by the name."""
    every = [
        (one.log_posterior + stream.log_prior(one.role if one.role == "current" else "torque"), one)
        for one in torques(motion, y)
    ]
    every.sort(key=lambda one: one[0], reverse=True)
    (first, best), *others = every
    following = others[0] if others else None
    return RoleChoice(
        best, following[1] if following else None, float(first - following[0]) if following else choice.margin
    )


def _is_named(stream: JointStream) -> bool:
    named = max(stream.log_prior("torque"), stream.log_prior("current")) > 0.0
    return named and bool(np.ptp(stream.series.values, axis=0).any())


def _exclusive(readings: Sequence[Reading]) -> list[Reading]:
    """Readings without shared columns: the likeliest of several that share one; the chosen one first."""
    kept: list[Reading] = []
    for one in sorted(readings, key=lambda one: one.log_posterior, reverse=True):
        if not any(one.stream.overlaps(other.stream) for other in kept):
            kept.append(one)
    return sorted(
        (one for one in readings if any(one is other for other in kept)), key=lambda one: one.rank, reverse=True
    )
