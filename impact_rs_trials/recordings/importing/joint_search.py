# SPDX-License-Identifier: Apache-2.0
"""Assignment of the streams of a recording to positions, velocities and torques of a robot's joints, by likelihood.

Every candidate for the positions gives one assignment, in whose motion the other streams are velocity, torque or
neither (:mod:`hypotheses`). The log posterior of an assignment is the sum over its three streams. Few streams are as
wide as a robot has joints, so all are tried. Several streams may fit one role, as a measured and a commanded torque do.
Only names show which of them was measured. Streams of one role are therefore ordered by name. Ties: torques in the
order of the file, velocities by how well they fit the positions.

Commanded positions and velocities fit each other better than measured ones, because they have no noise. An assignment
therefore includes the likelihood of the second pair of positions and velocities, and the torque decides which pair
moved the arm. Where one pair follows the other, tracking errors are small against the noise of measured accelerations,
which commands do not have. Then the lag between the pairs decides in place of the torque, because a measured motion is
late.

Velocities and accelerations are a pair as well, and accelerations that a filter derived from velocities fit without
noise. An assignment therefore includes the likelihood of the derivative of its velocities. Both assignments then have
the same likelihood, up to the positions, which decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from impact_rs_sim.robots.robot import Array, RobotFacts
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
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.turns import unwrapped
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
    """Readings with their log posteriors, and the next hypothesis of each: the chosen reading, then by likelihood."""
    (chosen, best_log_posterior), *rivals = readings
    possible = [(reading.stream, reading.best, best_log_posterior - log_posterior) for reading, log_posterior in rivals]
    for reading, log_posterior in ((chosen, best_log_posterior), *rivals):
        if reading.choice.next is not None:
            log_odds = best_log_posterior - log_posterior + reading.choice.margin
            possible.append((reading.stream, reading.choice.next, log_odds))
    possible.sort(key=lambda entry: entry[2])
    return tuple(
        PossibleReading(stream.label, dict(stream.candidate.source), best.unit, float(log_odds), best.evidence)
        for stream, best, log_odds in ((chosen.stream, chosen.best, 0.0), *possible)
    )


@dataclass(frozen=True)
class Assignment:
    """Streams in the roles of position, velocity and torque.

    Attributes:
        position: The positions.
        velocity: The velocities; None: derivatives of the positions.
        torques: Streams that fit a torque, the chosen stream first.
        no_torques: Why further streams are no torques, by label: copies of the motion, magnitudes.
        alternatives: Alternatives by signal, the chosen reading first.
        further_log_likelihood: Log likelihood of the derivative of the velocities, and of a second pair of positions
            and velocities as the command of this motion.
        command: The second pair, if either pair follows the other; None: neither does.
    """

    position: Reading
    velocity: Reading | None
    torques: tuple[Reading, ...]
    no_torques: dict[str, str]
    alternatives: Mapping[str, tuple[PossibleReading, ...]] = field(default_factory=dict)
    further_log_likelihood: float = 0.0
    command: Assignment | None = None

    @property
    def time(self) -> Array:
        """Timestamps of the positions, ``(k,)`` [s]."""
        return self.position.stream.series.time

    @property
    def in_si(self) -> Series:
        """The positions in SI units."""
        return replace(self.position.stream.series, values=self.position.values)

    @property
    def streams(self) -> list[JointStream]:
        """Streams of positions and velocities."""
        return [reading.stream for reading in (self.position, self.velocity) if reading is not None]

    def motion(self, model: RobotModel) -> JointMotion:
        """The motion, with velocities where these were recorded."""
        return JointMotion.of(self.time, self.position.values, None if self.velocity is None else self.speeds, model)

    def with_torque(self, torque: Array, model: RobotModel) -> MotionTorque:
        """The motion, and a torque at its timestamps, ``(k, n)`` [N m]."""
        return MotionTorque.from_signals(self.time, self.position.values, self.speeds, torque, model)

    @property
    def log_posterior(self) -> float:
        """Log posterior of all its streams."""
        return self.motion_log_posterior + self.further_log_likelihood + self.torque_log_posterior

    @property
    def torque_log_posterior(self) -> float:
        """Log posterior of its torque; 0: none fits."""
        return max((reading.log_posterior for reading in self.torques), default=0.0)

    @property
    def motion_log_posterior(self) -> float:
        """Log posterior of positions and velocities."""
        return self.position.log_posterior + (0.0 if self.velocity is None else self.velocity.log_posterior)

    @property
    def speeds(self) -> Array:
        """dq at the timestamps of the positions, ``(k, n)`` [rad/s, m/s]."""
        if self.velocity is None:
            return self.in_si.derivative().values
        return replace(self.velocity.stream.series, values=self.velocity.values).at(self.time)


class JointSearch:
    """Assignments of the streams of one recording.

    Args:
        streams: As wide as the robot has joints; a pose is no signal of joints.
        model: Nominal arm.
    """

    def __init__(self, streams: Sequence[JointStream], model: RobotModel) -> None:
        self.streams, self.model = [stream for stream in streams if not holds_a_turn(stream.series.values)], model
        self._averages: dict[tuple[int, int], Array] = {}
        self.position_readings = [
            Reading(stream, choice)
            for stream in (_unwrapped(stream, model.facts) for stream in self.streams)
            if (choice := choose(positions(stream.series.values, model.facts), -np.inf)) is not None
            and np.ptp(stream.series.values, axis=0).any()
        ]

    def motions(self) -> list[Assignment]:
        """Positions with velocity streams, the likeliest first."""
        assignments: list[Assignment] = []
        for position in self.position_readings:
            motion = JointMotion.of(position.stream.series.time, position.values, None, self.model)
            if velocity := self._velocities(position, motion):
                assignments.append(Assignment(position, velocity[0], (), {}))
        return sorted(assignments, key=lambda assignment: assignment.motion_log_posterior, reverse=True)

    def without_velocity(self) -> list[Assignment]:
        """Positions alone, from streams without the name of another signal."""
        return [Assignment(position, None, (), {}) for position in self.position_readings if position.by_name >= 0.0]

    def best(self, motions: Sequence[Assignment]) -> Assignment:
        """The likeliest of motions, with its torques and the alternatives of its signals."""
        motions = with_commands(motions)
        least = max(motion.log_posterior for motion in motions) - MAX_LOG_POSTERIOR_LOSS
        likely = [motion for motion in motions if motion.velocity is None or motion.log_posterior > least]
        with_torques = [self._with_torques(motion) for motion in likely]
        assignments = [_with_shared_torque(motion, with_torques) for motion in with_torques]
        assignments.sort(key=lambda assignment: assignment.log_posterior, reverse=True)
        best = assignments[0]
        by_position = {id(rival.position.stream): rival for rival in (*motions, *assignments)}
        rivals = [rival for rival in by_position.values() if rival.position.stream is not best.position.stream]
        listed = {"position": alternatives((rival.position, rival.log_posterior) for rival in (best, *rivals))}
        if best.velocity is not None:
            motion = JointMotion.of(best.time, best.position.values, None, self.model)
            fitting = self._velocities(best.position, motion)
            listed["velocity"] = alternatives((reading, reading.by_name) for reading in fitting)
        if best.torques:
            listed["torque"] = alternatives((reading, reading.by_name) for reading in best.torques)
        return replace(best, alternatives=listed)

    def motors(self, assignment: Assignment) -> Reading | None:
        """Angles of the motors, if a stream with such a name follows the positions; None: no stream does."""
        motion = JointMotion.of(assignment.time, assignment.position.values, assignment.speeds, self.model)
        for stream in self.free_of([*assignment.streams, *(torque.stream for torque in assignment.torques[:1])]):
            if stream.is_of_motors:
                choice = choose(motor_positions(motion, self._sampled(motion, stream)), -np.inf)
                if choice is not None:
                    return Reading(stream, choice)
        return None

    def free_of(self, assigned: Sequence[JointStream]) -> list[JointStream]:
        """Streams that may belong to the joints of the assigned streams, and share no column with them."""
        return [stream for stream in self.streams if not any(stream.stands_apart(other) for other in assigned)]

    def velocities_at_other_rates(self) -> Iterator[tuple[JointStream, JointStream, float]]:
        """Positions, a stream that is their derivative times one positive factor in all joints, and the factor."""
        for position in self.position_readings:
            time = position.stream.series.time
            motion = JointMotion.of(time, position.values, None, self.model)
            for stream in self.streams:
                if not stream.overlaps(position.stream):
                    choice = choose(velocities(motion, self._sampled(motion, stream)))
                    factor = 0.0 if choice is None or not choice.sure else choice.best.further.get("rate_", 0.0)
                    if factor > 0.0:
                        yield position.stream, stream, factor

    def _sampled(self, motion: JointMotion, stream: JointStream) -> Array:
        """A stream at the samples of a motion, kept because many motions share timestamps."""
        time = motion.time
        key = id(stream), hash(time.tobytes())
        if key not in self._averages:
            self._averages[key] = motion.sampled(stream.series.at(time))
        return self._averages[key]

    def _velocities(self, position: Reading, motion: JointMotion) -> list[Reading]:
        """Streams that are the derivative of the positions, sorted by their names, and then by likelihood."""
        readings = [
            Reading(stream, choice)
            for stream in self.free_of([position.stream])
            if (choice := choose(velocities(motion, self._sampled(motion, stream)))) is not None
            and choice.best.role == "velocity"
            and choice.best.log_posterior > DECISIVE_LOG_ODDS
        ]
        return sorted(_exclusive(readings), key=lambda reading: (reading.by_name, reading.log_posterior), reverse=True)

    @OUTLIERS
    def _with_torques(self, assignment: Assignment) -> Assignment:
        """The assignment with the streams that fit the torque of its motion, or else have the name of a torque."""
        motion, free = assignment.motion(self.model), self.free_of(assignment.streams)
        cut = assignment.position.stream.is_cut  # perhaps of another robot: only a decisive torque is accepted
        fitting, weightless, no_torques = [], [], {}
        for stream in free:
            raw = stream.series.at(assignment.time)
            y = motion.sampled(raw)
            copy, torque = choose(copies(motion, y)), choose(torques(motion, y))
            threshold = DECISIVE_LOG_ODDS if torque is None else max(DECISIVE_LOG_ODDS, torque.best.log_posterior)
            if copy is not None and copy.best.log_posterior > threshold:
                no_torques[stream.label] = copy.best.evidence
                continue
            if is_magnitude(motion, y):
                no_torques[stream.label] = MAGNITUDE
                continue
            if (inertial := self._without_gravity(stream, assignment)) is not None:
                weightless.append(inertial)
                continue
            if torque is None or torque.best.role == "other" or torque.best.log_posterior <= DECISIVE_LOG_ODDS:
                continue
            if cut and not torque.sure:
                continue
            computed = self._is_computed(assignment.with_torque(raw, self.model), torque.best)
            fitting.append(Reading(stream, _named(stream, torque, motion, y), computed))
        fitting = _exclusive(fitting or weightless)
        # A controller's target is no measurement. A current is, also if the fit does not show it.
        if all(reading.computed for reading in fitting) and not cut:
            named = [stream for stream in free if _is_named(stream) and stream.label not in no_torques]
            if fitting:
                named = [
                    stream for stream in named if stream.log_prior("current") > max(stream.log_prior("torque"), 0.0)
                ]
            fitting += [self._by_name(stream, assignment, motion) for stream in named]
            fitting.sort(key=lambda reading: reading.rank, reverse=True)
        return replace(assignment, torques=tuple(fitting), no_torques=no_torques)

    @OUTLIERS
    def _without_gravity(self, stream: JointStream, assignment: Assignment) -> Reading | None:
        """A stream in N m or mN m that is a torque without gravity; None: no evidence."""
        raw = stream.series.at(assignment.time)
        for unit, slide in {"N m": "N", "mN m": "mN"}.items():
            if (evidence := lacks_gravity(assignment.with_torque(TURNS["torque"][unit] * raw, self.model))) is not None:
                units = unit_of_joints(self.model.facts, unit, slide)
                return replace(Reading.of(stream, "torque", units, evidence, np.inf), meaning="without_gravity")
        return None

    def _is_computed(self, motion: MotionTorque, hypothesis: RoleHypothesis) -> bool:
        """Whether a torque at motors was computed; torque sensors behind the gears measure no gear friction."""
        at_motor = hypothesis.role == "current" or not self.model.facts.joint_torque_loop
        return at_motor and is_computed(motion)

    def _by_name(self, stream: JointStream, assignment: Assignment, motion: JointMotion) -> Reading:
        """A torque or a current that only its name shows."""
        raw = stream.series.at(assignment.time)
        if stream.log_prior("current") > stream.log_prior("torque"):
            for hypothesis in torques(motion, motion.sampled(raw)):
                if hypothesis.role == "current":
                    return Reading(stream, RoleChoice(hypothesis, None, 0.0))
        measured = assignment.with_torque(raw, self.model)
        evidence = "the motion takes too little torque to show it"
        if np.any(driven_joints(measured.rigid_torque, measured.model)):
            rigid_rms = np.sqrt(np.mean(np.square(measured.rigid_torque), axis=0))
            residual_rms = np.sqrt(measured.misfit(measured.rigid_torque) / len(measured.rigid_torque))
            joint = int(np.argmax(rigid_rms))
            evidence = (
                f"gravity and inertia of the arm take {rigid_rms[joint]:.3g} N m rms in joint {joint + 1}, from which "
                f"the signal is {residual_rms[joint]:.3g} N m away: another robot, other joints or another quantity?"
            )
        unit = motion.unit("N m", "N")
        if (external := is_external(measured, stream.is_external)) is not None:
            reading = Reading.of(stream, "torque", unit, external.evidence, external.margin)
            return replace(reading, meaning="external")
        return Reading.of(stream, "torque", unit, f"nothing but its name: {evidence}", 0.0)


@OUTLIERS
def _unwrapped(stream: JointStream, facts: RobotFacts) -> JointStream:
    """A stream as continuous angles, in the unit in which it jumps by a full turn."""
    for unit, slide in (("rad", "m"), ("deg", "mm"), ("mrad", "mm")):
        factor = factors_of("position", unit_of_joints(facts, unit, slide))
        in_si = replace(stream.series, values=stream.series.values * factor)
        if (series := unwrapped(in_si, facts)) is not in_si:
            return replace(stream, series=replace(series, values=series.values / factor))
    return stream


def with_commands(motions: Sequence[Assignment]) -> list[Assignment]:
    """Motions with the likelihood of their remaining streams, so that all are compared on the same streams."""
    return [_with_command(motion, motions) for motion in motions]


def _with_shared_torque(assignment: Assignment, assignments: Sequence[Assignment]) -> Assignment:
    """An assignment with the likelihood of the torque in the motion of its command, where that is larger."""
    if assignment.command is None:
        return assignment
    stream = assignment.command.position.stream
    of_command = [rival.torque_log_posterior for rival in assignments if rival.position.stream is stream]
    gain = max(max(of_command, default=0.0) - assignment.torque_log_posterior, 0.0)
    return replace(assignment, further_log_likelihood=assignment.further_log_likelihood + gain)


def _disjoint(first: Assignment, second: Assignment) -> bool:
    """Whether two motions with velocities have no columns in common."""
    if first.velocity is None or second.velocity is None:
        return False
    return not any(a.overlaps(b) for a in first.streams for b in second.streams)


def _with_command(assignment: Assignment, motions: Sequence[Assignment]) -> Assignment:
    """A motion with the derivative of its velocities, and with the likeliest pair of other streams as its command.

    Names are not used.
    """

    def velocity(motion: Assignment) -> float:
        return 0.0 if motion.velocity is None else motion.velocity.best.log_posterior

    def derivative(motion: Assignment) -> float:
        if motion.velocity is None:
            return 0.0
        stream = motion.velocity.stream
        return max((velocity(second) for second in motions if second.position.stream is stream), default=0.0)

    pairs = [
        (pair.position.best.log_posterior + velocity(pair) + derivative(pair), pair)
        for pair in motions
        if _disjoint(assignment, pair)
    ]
    if not pairs:
        return replace(assignment, further_log_likelihood=derivative(assignment))
    log_likelihood, command = max(pairs, key=lambda entry: entry[0])
    lateness = _lateness(assignment, command)
    return replace(
        assignment,
        further_log_likelihood=derivative(assignment) + log_likelihood + (lateness or 0.0),
        command=None if lateness is None else command,
    )


def _lateness(follower: Assignment, leader: Assignment) -> float | None:
    """Log odds that the first motion follows the second, by the sign of the lag L in q(t) = q_leader(t - L) + c.

    All joints share L. None: neither motion follows the other.
    """
    series = leader.position.stream.series
    command = AveragedMotion.of(follower.time, replace(series, values=leader.position.values).at(follower.time))
    q = averaged(follower.time, follower.position.values)[1]
    relation = fit(command.velocity, q - command.position, [np.ones_like(q)], command.independent)
    if np.sum(relation.misfit) > MAX_TRACKING_MISFIT_SHARE * np.sum(np.square(q - q.mean(axis=0))):
        return None
    weight = 1.0 / np.maximum(np.square(relation.standard_error), 1e-12)
    lag, error = -float(np.sum(weight * relation.factor) / np.sum(weight)), float(np.sum(weight) ** -0.5)
    return float(np.sign(lag)) * NAME_LOG_ODDS if abs(lag) > MIN_REPORTED_SIGMA * error else 0.0


def _named(stream: JointStream, choice: RoleChoice, motion: JointMotion, y: Array) -> RoleChoice:
    """A choice between torque and current with the prior by the name."""

    def log_posterior(hypothesis: RoleHypothesis) -> float:
        return hypothesis.log_posterior + stream.log_prior("current" if hypothesis.role == "current" else "torque")

    best, *rivals = sorted(torques(motion, y), key=log_posterior, reverse=True)
    if not rivals:
        return RoleChoice(best, None, choice.margin)
    return RoleChoice(best, rivals[0], float(log_posterior(best) - log_posterior(rivals[0])))


def _is_named(stream: JointStream) -> bool:
    named = max(stream.log_prior("torque"), stream.log_prior("current")) > 0.0
    return named and bool(np.ptp(stream.series.values, axis=0).any())


def _exclusive(readings: Sequence[Reading]) -> list[Reading]:
    """The likeliest readings that share no columns, sorted by rank."""
    exclusive: list[Reading] = []
    for reading in sorted(readings, key=lambda reading: reading.log_posterior, reverse=True):
        if not any(reading.stream.overlaps(likelier.stream) for likelier in exclusive):
            exclusive.append(reading)
    in_order = [reading for reading in readings if any(reading is likeliest for likeliest in exclusive)]
    return sorted(in_order, key=lambda reading: reading.rank, reverse=True)
