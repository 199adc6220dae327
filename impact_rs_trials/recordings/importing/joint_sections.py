# SPDX-License-Identifier: Apache-2.0
"""Sections of a mapping for the signals of the joints, with their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.torque_readings import (
    MEASURED_TORQUE,
    NOTHING_SHOWS,
    MotionTorque,
    explains_most,
    meaning_of,
    motor_inertia_in,
    order_of_joints,
)
from impact_rs_trials.recordings.file_units import factors_of
from impact_rs_trials.recordings.importing.candidates import (
    MAX_GRIPPER_NUMBERS,
    PART_OF_ARM,
    SignalCandidate,
    joints_of,
    of_side,
    vector_width,
)
from impact_rs_trials.recordings.importing.flange_path import FlangePath
from impact_rs_trials.recordings.importing.hypotheses import range_in_words
from impact_rs_trials.recordings.importing.import_texts import PossibleReading, flow
from impact_rs_trials.recordings.importing.joint_search import (
    MAGNITUDE,
    Assignment,
    JointSearch,
    Reading,
    alternatives,
)
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.importing.recorded_files import (
    ImportedFiles,
    RecordedFile,
    read_streams,
    refuse_several,
    settle_clock,
    source_in,
)
from impact_rs_trials.recordings.importing.servo_search import (
    DERIVATIVE,
    PROPORTIONAL,
    ServoHypothesis,
    find_servo,
    gains_in,
    named_servo_torques,
)
from impact_rs_trials.recordings.mapping import MountedEndEffector, TorqueMeaning
from impact_rs_trials.recordings.readers.guesses import are_derivatives, at_rest, steps_back
from impact_rs_trials.recordings.relations import DECISIVE_LOG_LIKELIHOOD, DECISIVE_LOG_ODDS

ADDED_BY_THE_MODEL = {
    "without_gravity": "The gravity torque of the model is added to it (torque_meaning), with the load of end_effector",
    "external": "The whole torque of the model is added to it (torque_meaning), so that an error of the links shows "
    "only as far as the subtracted model differs from this one",
}
MAX_SHOWN_SIGNALS = 3  # of a kind in a message
MAX_COMMAND_RMS_RATIO = 0.5  # difference of commanded and measured torque, rms over the measured one
MIN_GRAVITY_RMS_RATIO = 2.0  # of these differences with and without gravity torque, beyond which the choice is sure
DECLARED = (
    "{label} is taken for the desired positions because its format says so: their distance to the positions does not "
    "show the torque of this motion (log odds {odds:.2g}), as where commands act late, a controller adds torques, or "
    "friction is as large. The gains are a guess; write the gains of your servos into servo.kp"
)
NO_HEADER = "its messages have no header: times at which the bag received them"


class JointSections:
    """Describes the joints of a recording.

    Args:
        files: Its files; findings are appended to their notes.

    Attributes:
        readings: Possible readings by signal, the chosen reading first.
        flange: Path of the flange, once the joints are described.
    """

    def __init__(self, files: ImportedFiles) -> None:
        self._files, self._groups, self._rate, self._notes = files.files, files.groups, files.rate, files.notes
        self._refused: dict[str, str] = {}
        self._order_shown = "columns hold the joints from base to tip"
        self.readings: dict[str, tuple[PossibleReading, ...]] = {}
        self.flange: FlangePath | None = None

    def describe(self, robot: str, facts: RobotFacts) -> tuple[RecordedFile, dict[str, Any], dict[str, dict[str, Any]]]:
        """File of the positions, keys of the mapping except its signals, and the signals."""
        model = RobotModel(facts, MountedEndEffector().build())
        for recorded in self._files:
            recorded.candidates = of_side(recorded.candidates, facts)
            self._refused |= read_streams(recorded, robot, facts.joint_count, self._rate)
            if self._rate is None:
                settle_clock(recorded, model)
        search = JointSearch([stream for recorded in self._files for stream in recorded.streams], model)
        assignment = self._assignment(search, robot)
        if (order := self._order(assignment, search)) is not None:
            search = JointSearch([stream.in_order(order) for stream in search.streams], model)
            assignment = self._assignment(search, robot)
        self.flange = FlangePath.of(assignment.time, assignment.position.values, model)
        self._notes.remarks += [
            f"{label} is left out: it {reason}"
            for label, reason in assignment.no_torques.items()
            if reason == MAGNITUDE
        ]
        servo = None if self._is_measured(assignment, model) else find_servo(search, self._motions(search))
        if servo is not None:
            self._notes.remarks += [
                f"{torque.stream.label} is left out: its numbers show no measured torque, the errors of servos do"
                for torque in assignment.torques
            ]
            assignment = self._moved_by(servo, search)
        recorded = self._file_of(assignment.position.stream)
        _check_width(assignment, recorded, robot, facts.joint_count)
        if servo is None:
            self._check_torques(assignment, search, robot)
        self._notes.remarks += [
            f"{label} is left out, because the reader refuses it: {reason}" for label, reason in self._refused.items()
        ]
        refuse_several(recorded, self._groups, "joints", "robot")
        signals = {
            "position": self._joint_signal(
                assignment.position, "position", recorded, assignment.alternatives["position"]
            )
        }
        if assignment.velocity is None:
            self._notes.add(
                "signals.velocity", "none", "no signal is the derivative of the positions: velocities are computed"
            )
        else:
            signals["velocity"] = self._joint_signal(
                assignment.velocity, "velocity", recorded, assignment.alternatives["velocity"]
            )
        recorded.on_log = not assignment.position.stream.candidate.stamped
        keys = {"joints": list(self._joints(assignment.position.stream.candidate, facts.joint_count))}
        if servo is None:
            keys |= self._torque(assignment, model, robot, signals, recorded)
        else:
            keys |= self._servo(servo, search, signals, recorded)
        if (motors := search.motors(assignment)) is not None:
            signals["motor_position"] = self._joint_signal(motors, "motor_position", recorded)
        if servo is None:
            keys |= self._commands(assignment, search, model, signals, recorded, "torque_constant" in keys)
        return recorded, keys, signals

    def _assignment(self, search: JointSearch, robot: str) -> Assignment:
        """The likeliest assignment of streams to the roles of the joints."""
        facts = search.model.facts
        self._check_motion([position for position in search.position_readings if position.by_name > 0.0], facts)
        motions = self._motions(search)
        if not motions:
            raise self._nothing(search.streams, robot, facts.joint_count)
        assignment = search.best(motions)
        self._check_motion([assignment.position], facts)
        return assignment

    def _motions(self, search: JointSearch) -> list[Assignment]:
        """Positions with their velocities; positions alone if no stream has the name of a velocity."""
        motions = search.motions()
        if not motions and self._rate is not None:
            self._check_rate(self._rate, search)
        if not motions and not any(stream.log_prior("velocity") > 0.0 for stream in search.streams):
            return search.without_velocity()
        return motions

    def _is_measured(self, assignment: Assignment, model: RobotModel) -> bool:
        """Whether a torque fits the motion, by more than its name, and is no target of a controller."""
        if not assignment.torques:
            return False
        best = assignment.torques[0]
        if best.meaning == "whole" and best.best.log_likelihood == 0.0:
            return False
        return meaning_of(self._with_motion(best, assignment, model), best.meaning, best.computed).best != "target"

    def _with_motion(self, reading: Reading, assignment: Assignment, model: RobotModel) -> MotionTorque:
        """A torque in N m, also of currents, and its motion."""
        constant = np.array(reading.best.further.get("torque_constant", 1.0))
        torque = reading.stream.series.at(assignment.time) * reading.factor * constant
        return assignment.with_torque(torque, model)

    def _moved_by(self, servo: ServoHypothesis, search: JointSearch) -> Assignment:
        """The motion that servos drive; the chosen reading is its only alternative."""
        motion = servo.motion
        listed = {"position": alternatives([(motion.position, motion.log_posterior)])}
        if motion.velocity is not None:
            listed["velocity"] = alternatives([(motion.velocity, motion.velocity.by_name)])
        self._check_motion([motion.position], search.model.facts)
        return replace(motion, alternatives=listed)

    def _servo(
        self, servo: ServoHypothesis, search: JointSearch, signals: dict[str, dict[str, Any]], recorded: RecordedFile
    ) -> dict[str, Any]:
        """Add the desired positions of servos to the signals; further keys of the mapping."""
        target = Reading.of(servo.stream, "position", servo.unit, servo.evidence, servo.margin)
        signals["q_desired"] = self._joint_signal(target, "q_desired", recorded)
        self._notes.add("torque_measured_at", "motor", "no torque was recorded: servos give the torque of their motors")
        if servo.margin < 0.0:
            self._notes.remarks.append(DECLARED.format(label=servo.stream.label, odds=servo.margin))
        servo_keys: dict[str, Any] = {"kp": [float(f"{gain:.4g}") for gain in servo.kp]}
        if servo.kd is not None:
            servo_keys["kd"] = [float(f"{gain:.4g}") for gain in servo.kd]
            servo_keys["damps"] = servo.damps
        servo_keys["gains"] = "given" if servo.has_recorded_gains else "estimated"
        for pattern in (PROPORTIONAL, DERIVATIVE):
            if (changing := gains_in(search.streams, pattern)[1]) is not None:
                self._notes.remarks.append(changing)
        if servo.has_recorded_gains:
            text = "kp is a column of the recording" if servo.kd is None else "kp and kd are columns of the recording"
            text += "" if servo.kd is None else f"; the torque is nearer to the motion's if kd damps the {servo.damps}"
        else:
            listed = ", ".join(str(joint + 1) for joint in np.flatnonzero(servo.informative))
            text = f"kp by gravity and inertia of the model in joints {listed}; prefer the gains of your controller"
            self._notes.remarks.append(
                "no gains were recorded: kp was found with the masses of the model, so this log cannot "
                "distinguish masses from gains, and kd is a part of the viscous friction. Write kp and kd of your "
                "controller into servo, with gains: given, if you know them"
            )
        self._notes.add("servo", flow(servo_keys), text, sure=servo.has_recorded_gains)
        gravity = "with gravity" if servo.meaning == "whole" else "without gravity"
        text = f"the error of the servos makes the torque of the motion {gravity} (log odds {servo.margin:.3g})"
        self._notes.add("torque_meaning", servo.meaning, text, servo.sure)
        return {"torque_measured_at": "motor", "torque_meaning": servo.meaning, "servo": servo_keys}

    def _check_torques(self, assignment: Assignment, search: JointSearch, robot: str) -> None:
        """Refuse a recording without a torque that a mapping could take."""
        if not assignment.torques:
            reasons = "; ".join(f"{label} {reason}" for label, reason in assignment.no_torques.items())
            no_torques = f" ({reasons})" if reasons else ""
            tried = "; ".join(stream.label for stream in search.streams)
            raise InputError(
                f"nothing goes with the torque that gravity and inertia of {robot} take in this motion, and a mapping "
                f"needs torques or currents, or desired positions of servos that make it; signals as wide as its "
                f"joints: {tried}{no_torques}. Another --robot, or a "
                "mapping by hand (docs/files.md)",
                file=self._file_of(assignment.position.stream).path,
            )

    def _order(self, assignment: Assignment, search: JointSearch) -> tuple[int, ...] | None:
        """Order of unnamed columns by the torque of the arm; None: the given order."""
        positions, model = assignment.position.stream, search.model
        if positions.is_cut or positions.candidate.joints or PART_OF_ARM.search(positions.candidate.label):
            return None
        torques = list(named_servo_torques(search, assignment)) if not assignment.torques else []
        if not assignment.torques:
            free = [
                stream for stream in search.free_of(assignment.streams) if stream.label not in assignment.no_torques
            ]
            torques += [stream.series.at(assignment.time) for stream in free[:MAX_SHOWN_SIGNALS]]
        for reading in assignment.torques[:MAX_SHOWN_SIGNALS]:
            constant, raw = reading.best.further.get("torque_constant"), reading.stream.series.at(assignment.time)
            if constant is None or not explains_most(assignment.with_torque(raw * np.array(constant), model)):
                torques.append(factors_of("torque", reading.best.unit) * raw)  # perhaps torques in a wrong order
        for torque in torques:
            if (ordered := order_of_joints(assignment.with_torque(torque, model))) is not None:
                order, self._order_shown = ordered
                return order
        return None

    def _check_motion(self, position_readings: Sequence[Reading], facts: RobotFacts) -> None:
        """Refuse an arm at rest: its noise would be taken for velocity and torque."""
        rests = [at_rest(reading.stream.series.time, reading.values, facts) for reading in position_readings]
        if rests and None not in rests:
            stream = position_readings[0].stream
            raise InputError(f"{stream.label}: {rests[0]}", file=self._file_of(stream).path)

    def _nothing(self, streams: Sequence[JointStream], robot: str, count: int) -> InputError:
        """Error: no signal is the motion of the joints."""
        text = f"no signal of {_joints_of(count)} can be read"
        if streams:
            text = (
                f"no two signals of {_joints_of(count)} are positions within the limits of {robot} and their "
                f"derivative; signals as wide as that: {'; '.join(stream.label for stream in streams)}"
            )
        other_widths = [
            candidate
            for recorded in self._files
            for candidate in recorded.candidates
            if not candidate.pose and candidate.width not in (1, count)
        ]
        if other_widths:
            listed = ", ".join(candidate.label for candidate in other_widths[:MAX_SHOWN_SIGNALS])
            text += f"; signals of other widths: {listed}"
            text += ", of which a mapping takes joints by entries" * any(
                candidate.width > count for candidate in other_widths
            )
        text += "".join(f"; the reader refuses {why}" for why in self._refusals())
        backwards = [back for recorded in self._files if (back := steps_back(recorded.columns)) is not None]
        text += "".join(f"; {back}, so another clock was taken" for back in backwards)
        remedy = "Another --robot, or a mapping by hand" if streams else "A mapping by hand"
        return InputError(f"{text}. {remedy} (docs/files.md)", file=self._files[0].path)

    def _refusals(self) -> list[str]:
        """Signals that the reader refuses, with its reason."""
        by_reason: dict[str, list[str]] = {}
        for label, reason in self._refused.items():
            by_reason.setdefault(reason, []).append(label)
        return [f"{', '.join(labels[:MAX_SHOWN_SIGNALS])}: {reason}" for reason, labels in by_reason.items()]

    def _check_rate(self, rate: float, search: JointSearch) -> None:
        """Refuse ``--rate`` if a signal is a constant multiple of dq/dt at that rate; name the fitting rate."""
        for position, velocity, factor in search.velocities_at_other_rates():
            true_rate = rate * factor
            raise InputError(
                f"{velocity.label} is {factor:.3g} times the derivative of {position.label} in all joints, which is a "
                f"velocity in rad/s at {true_rate:.4g} Hz, in deg/s at {true_rate * np.pi / 180.0:.4g} Hz",
                key="--rate",
                value=f"{rate:g}",
            )

    def _torque(
        self,
        assignment: Assignment,
        model: RobotModel,
        robot: str,
        signals: dict[str, dict[str, Any]],
        recorded: RecordedFile,
    ) -> dict[str, Any]:
        """Add the torque of the joints to the signals; further keys of the mapping."""
        best, *rivals = assignment.torques
        facts, listed = model.facts, assignment.alternatives["torque"]
        if recorded.is_bag:
            rivals = [reading for reading in rivals if reading.stream.candidate.guess != "command"]
        computed = (
            "follows the model of the arm without any friction of its gears: a controller or a simulation computed it"
        )
        self._notes.remarks += [
            f"{reading.stream.label} is left out: it {computed}"
            for reading in rivals
            if reading.computed and not best.computed
        ]
        if best.computed:
            self._notes.remarks.append(f"{best.stream.label} {computed}, so {NOTHING_SHOWS}. {MEASURED_TORQUE}")
        equals = "; ".join(reading.stream.label for reading in rivals if reading.computed == best.computed)
        constant = best.best.further.get("torque_constant")
        signals["torque"] = self._joint_signal(best, "torque", recorded, listed, equals)
        motion = self._with_motion(best, assignment, model)
        at_motor = constant is not None or not facts.joint_torque_loop
        loop = f"joint_torque_loop of {robot} is {str(facts.joint_torque_loop).lower()}"
        text = loop if constant is None else "currents are measured at motors"
        text += self._motors_in(motion, best.meaning, at_motor)
        self._notes.add("torque_measured_at", "motor" if at_motor else "link", text, sure=constant is not None)
        meaning = meaning_of(motion, best.meaning, best.computed and constant is None)
        self._notes.add("torque_meaning", meaning.best, meaning.evidence, meaning.sure)
        if meaning.best in ADDED_BY_THE_MODEL:
            self._notes.remarks.append(f"{best.stream.label} {best.best.evidence}. {ADDED_BY_THE_MODEL[meaning.best]}")
        keys: dict[str, Any] = {
            "torque_measured_at": "motor" if at_motor else "link", "torque_meaning": meaning.best
        }  # fmt: skip
        if constant is not None:
            self._notes.add(
                "torque_constant", flow(constant), "by the gravity torque in this recording; prefer a data sheet", False
            )
            keys["torque_constant"] = constant
        return keys

    def _motors_in(self, motion: MotionTorque, meaning: TorqueMeaning, at_motor: bool) -> str:
        """Whether a torque accelerates the motors as well, in words; a warning if it was measured behind the gears."""
        gain, inertia = motor_inertia_in(motion, meaning)
        motor_inertia = inertia[inertia > 0.0]
        if gain < DECISIVE_LOG_LIKELIHOOD or not motor_inertia.size:
            return f"; no inertia of motors shows in it (log likelihood {gain:+.0f})"
        size = f"{range_in_words(motor_inertia)} kg m^2"
        if not at_motor:
            self._notes.remarks.append(
                f"the torque accelerates {size} more than the links (log likelihood {gain:+.0f}): measured before the "
                "gears, or links of other inertia? In the first case torque_measured_at: motor"
            )
        return f"; it accelerates {size} in addition to the links (log likelihood {gain:+.0f})"

    def _commands(
        self, assignment: Assignment, search: JointSearch, model: RobotModel, signals: dict[str, dict[str, Any]],
        recorded: RecordedFile, currents: bool,
    ) -> dict[str, Any]:  # fmt: skip
        """Add the commanded torque of a bag to the signals; further keys of the mapping."""
        free = search.free_of([*assignment.streams, assignment.torques[0].stream])
        commanded = [stream for stream in free if stream.candidate.guess == "command" and self._file_of(stream).is_bag]
        copied = [stream for stream in commanded if stream.label in assignment.no_torques]
        self._notes.remarks += [
            f"{stream.label} is left out: it {assignment.no_torques[stream.label]}" for stream in copied
        ]
        commands = [stream for stream in commanded if stream not in copied]
        if commands and currents:
            reason = "only currents were measured, no torque"
            self._notes.remarks += [f"{stream.label} is left out: {reason}" for stream in commands]
            return {}
        return self._command(assignment, commands, model, signals, recorded) if commands else {}

    def _command(
        self, assignment: Assignment, commanded: Sequence[JointStream], model: RobotModel,
        signals: dict[str, dict[str, Any]], recorded: RecordedFile,
    ) -> dict[str, Any]:  # fmt: skip
        """Add the commanded torque closest (rms) to the measured torque, with or without gravity, to the signals."""
        time, q = assignment.time, assignment.position.values
        series = assignment.torques[0].stream.series
        torque = replace(series, values=assignment.torques[0].values).at(time)
        gravity = np.array([model.gravity_torque(row) for row in q])
        size = max(float(np.sqrt(np.mean(np.square(torque)))), 1e-12)

        def distance(stream: JointStream, gravity_torque: Array | float) -> float:
            """Difference to the measured torque over that torque, rms."""
            return float(np.sqrt(np.mean(np.square(stream.series.at(time) + gravity_torque - torque)))) / size

        distances = [((distance(stream, 0.0), distance(stream, gravity)), stream) for stream in commanded]
        (as_recorded, with_gravity), nearest = min(distances, key=lambda entry: min(entry[0]))
        for pair, stream in distances:
            if stream is not nearest or min(pair) > MAX_COMMAND_RMS_RATIO:
                far = f"{100.0 * min(pair):.0f} % of the measured torque away from it"
                self._notes.remarks.append(f"{stream.label} is left out: by its name it was commanded, and it is {far}")
        smaller, larger = sorted((as_recorded, with_gravity))
        if smaller > MAX_COMMAND_RMS_RATIO:
            return {}
        included = as_recorded <= with_gravity
        text = (
            f"{100.0 * as_recorded:.0f} % of the measured torque away from it as it is, {100.0 * with_gravity:.0f} % "
            "with the gravity torque added (rms)"
        )
        signals["command"] = self._joint_signal(Reading.of(nearest, "torque", "N m", text, np.inf), "command", recorded)
        sure = larger > MIN_GRAVITY_RMS_RATIO * smaller
        text = f"it is nearer to the measured torque {'as it is' if included else 'with the gravity torque added'}"
        self._notes.add("command_includes_gravity", str(included).lower(), text, sure)
        return {"command_includes_gravity": included}

    def _joint_signal(
        self,
        reading: Reading,
        name: str,
        main: RecordedFile,
        possible: Sequence[PossibleReading] = (),
        equals: str = "",
    ) -> dict[str, Any]:
        """Section of a signal of the joints, added to the notes, with the layout of its file if it is not the main one.

        Args:
            reading: The stream with its unit.
            name: The signal.
            main: File of the positions.
            possible: Possible readings of the signal, the chosen reading first.
            equals: Streams that fit the role equally well, also by name.
        """
        recorded, candidate, best = self._file_of(reading.stream), reading.stream.candidate, reading.best
        evidence = "by its numbers; see unit"
        if reading.stream.is_cut:
            evidence += "; the other numbers, as of a gripper, are left out"
            self._notes.remarks.append(f"signals.{name}: of {candidate.label} numbers are taken for the joints")
        rival = next((alternative for alternative in possible if alternative.stream != reading.stream.label), None)
        margin = np.inf if rival is None else rival.behind
        if rival is not None and margin < DECISIVE_LOG_ODDS:
            evidence += f"; next: {rival.stream}, log odds {margin:.2g}"
        evidence += "" if candidate.stamped else f"; {NO_HEADER}"
        self._notes.add(
            f"signals.{name}", candidate.label, evidence, not reading.stream.is_cut and bool(margin > DECISIVE_LOG_ODDS)
        )
        text = reading.choice.evidence + (f"; so do {equals}: take the one that was measured" if equals else "")
        sure = reading.choice.sure and not equals and not reading.computed and best.role != "current"
        self._notes.add(f"signals.{name}.unit", flow(best.unit), text, sure)
        self._notes.remarks += best.remarks
        self.readings[name] = tuple(possible)
        further = {key: value for key, value in best.further.items() if key == "factor"}
        source = {**source_in(recorded, candidate.source, self._groups), "unit": best.unit, **further}
        return source | recorded.own_layout(main)

    def _joints(self, candidate: SignalCandidate, count: int) -> tuple[str, ...]:
        joints = joints_of(candidate.joints, "", False, count)
        if candidate.joints:
            self._notes.add("joints", flow(list(joints)), "the recording names them")
        else:
            self._notes.add("joints", flow(list(joints)), self._order_shown, sure=False)
        return joints

    def _file_of(self, stream: JointStream) -> RecordedFile:
        """The file of a stream."""
        return next(recorded for recorded in self._files if recorded.pattern == stream.file)


def _check_width(assignment: Assignment, recorded: RecordedFile, robot: str, count: int) -> None:
    """Refuse a few joints of a wider arm: unnamed columns with neighbours that are positions and derivatives."""
    series = assignment.position.stream.series
    names = [name for name, cells in recorded.columns.items() if np.ndim(cells) == 1 and vector_width(cells) == 1]
    names = [name for name in names if name not in recorded.clock_columns]
    if assignment.velocity is None or not names or series.time.size != len(recorded.columns[names[0]]):
        return
    first_position, first_velocity = (
        _first_of(names, reading.stream.candidate) for reading in (assignment.position, assignment.velocity)
    )
    if first_position is None or first_velocity is None or assignment.velocity.stream.file != recorded.pattern:
        return
    offset = first_velocity - first_position  # from a position to its velocity, in columns
    joints = range(first_position, first_position + count)
    paired = range(max(0, -offset), len(names) - max(0, offset))  # columns with another one at that offset
    near = range(first_position - abs(offset) + 1, first_position + abs(offset))
    neighbours = [n for n in near if n in paired and n not in joints]
    if not neighbours:
        return
    positions, rates = (
        np.column_stack([np.asarray(recorded.columns[names[n + shift]], dtype=float) for n in neighbours])
        for shift in (0, offset)
    )
    derivatives = are_derivatives(series.time, positions, rates)
    block = [*joints, *(n for n, derivative in zip(neighbours, derivatives, strict=True) if derivative)]
    if len(block) > count + MAX_GRIPPER_NUMBERS:
        blocks = " and ".join(f"{names[min(block) + shift]} … {names[max(block) + shift]}" for shift in (0, offset))
        raise InputError(
            f"columns {blocks} hold positions and velocities of {len(block)} joints, and {robot} has {count}: another "
            "--robot, or a mapping by hand with the columns of this robot (docs/files.md)",
            file=recorded.path,
        )


def _first_of(names: Sequence[str], candidate: SignalCandidate) -> int | None:
    """Index of the first column of a signal if its columns are adjacent; None: not adjacent."""
    columns = candidate.source.get("columns") or []
    first = names.index(columns[0]) if columns and columns[0] in names else None
    return first if first is not None and list(names[first : first + len(columns)]) == list(columns) else None


def _joints_of(count: int) -> str:
    return f"{count} joint{'s' if count > 1 else ''}"
