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
    FoundServo,
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
    "friction is as large. The gains are a guess; write those of your servos into servo.kp"
)
NO_HEADER = "its messages have no header: times at which the bag received them"


class JointSections:
    """Describes the joints of a recording.

    Args:
        files: Its files; findings are appended to their notes.

    Attributes:
        readings: Possible readings by signal, the chosen one first.
        flange: Path of the flange, once the joints are described.
    """

    def __init__(self, files: ImportedFiles) -> None:
        self._parts, self._groups, self._rate, self._notes = files.parts, files.groups, files.rate, files.notes
        self._refused: dict[str, str] = {}
        self._order_shown = "columns hold the joints from base to tip"
        self.readings: dict[str, tuple[PossibleReading, ...]] = {}
        self.flange: FlangePath | None = None

    def describe(self, robot: str, facts: RobotFacts) -> tuple[RecordedFile, dict[str, Any], dict[str, dict[str, Any]]]:
        """File of the positions, keys of the mapping except its signals, and the signals."""
        model = RobotModel(facts, MountedEndEffector().build())
        for part in self._parts:
            part.candidates = of_side(part.candidates, facts)
            self._refused |= read_streams(part, robot, facts.joint_count, self._rate)
            if self._rate is None:
                settle_clock(part, model)
        search = JointSearch([stream for part in self._parts for stream in part.streams], model)
        found = self._assignment(search, robot)
        if (order := self._order(found, search)) is not None:
            search = JointSearch([stream.in_order(order) for stream in search.streams], model)
            found = self._assignment(search, robot)
        self.flange = FlangePath.of(found.time, found.position.values, model)
        self._notes.remarks += [
            f"{label} is left out: it {why}" for label, why in found.no_torques.items() if why == MAGNITUDE
        ]
        servo = None if self._is_measured(found, model) else find_servo(search, self._motions(search))
        if servo is not None:
            self._notes.remarks += [
                f"{one.stream.label} is left out: its numbers do not show that it was measured, and those of servos do"
                for one in found.torques
            ]
            found = self._moved_by(servo, search)
        part = self._part_of(found.position.stream)
        _check_width(found, part, robot, facts.joint_count)
        if servo is None:
            self._check_torques(found, search, robot)
        self._notes.remarks += [
            f"{label} is left out, for the reader refuses it: {why}" for label, why in self._refused.items()
        ]
        refuse_several(part, self._groups, "joints", "robot")
        signals = {"position": self._joint_signal(found.position, "position", part, found.alternatives["position"])}
        if found.velocity is None:
            self._notes.add(
                "signals.velocity", "none", "no signal is the derivative of the positions: velocities are computed"
            )
        else:
            signals["velocity"] = self._joint_signal(found.velocity, "velocity", part, found.alternatives["velocity"])
        part.on_log = not found.position.stream.candidate.stamped
        own = {"joints": list(self._joints(found.position.stream.candidate, facts.joint_count))}
        if servo is None:
            own |= self._torque(found, model, robot, signals, part)
        else:
            own |= self._servo(servo, search, signals, part)
        if (motors := search.motors(found)) is not None:
            signals["motor_position"] = self._joint_signal(motors, "motor_position", part)
        if servo is None:
            own |= self._commands(found, search, model, signals, part, "torque_constant" in own)
        return part, own, signals

    def _assignment(self, search: JointSearch, robot: str) -> Assignment:
        """The likeliest assignment of streams to the roles of the joints."""
        facts = search.model.facts
        self._check_motion([place for place in search.position_readings if place.by_name > 0.0], facts)
        motions = self._motions(search)
        if not motions:
            raise self._nothing(search.streams, robot, facts.joint_count)
        found = search.best(motions)
        self._check_motion([found.position], facts)
        return found

    def _motions(self, search: JointSearch) -> list[Assignment]:
        """Positions with their velocities, or alone where nothing is called a velocity."""
        motions = search.motions()
        if not motions and self._rate is not None:
            self._check_rate(self._rate, search)
        if not motions and not any(stream.log_prior("velocity") > 0.0 for stream in search.streams):
            return search.without_velocity()
        return motions

    def _is_measured(self, found: Assignment, model: RobotModel) -> bool:
        """Whether a torque goes with the motion, by more than its name, and is no target of a controller."""
        if not found.torques:
            return False
        best = found.torques[0]
        if best.meaning == "whole" and best.best.log_likelihood == 0.0:
            return False
        return meaning_of(self._seen(best, found, model), best.meaning, best.computed).best != "target"

    def _seen(self, one: Reading, found: Assignment, model: RobotModel) -> MotionTorque:
        """A torque in N m, also of currents, and its motion."""
        constant = np.array(one.best.further.get("torque_constant", 1.0))
        torque = one.stream.series.at(found.time) * one.factor * constant
        return found.with_torque(torque, model)

    def _moved_by(self, servo: FoundServo, search: JointSearch) -> Assignment:
        """The motion of servos, with its only reading."""
        one = servo.motion
        listed = {"position": alternatives([(one.position, one.log_posterior)])}
        if one.velocity is not None:
            listed["velocity"] = alternatives([(one.velocity, one.velocity.by_name)])
        self._check_motion([one.position], search.model.facts)
        return replace(one, alternatives=listed)

    def _servo(
        self, servo: FoundServo, search: JointSearch, signals: dict[str, dict[str, Any]], part: RecordedFile
    ) -> dict[str, Any]:
        """Add the desired positions of servos to the signals; further keys of the mapping."""
        target = Reading.of(servo.stream, "position", servo.unit, servo.evidence, servo.margin)
        signals["q_desired"] = self._joint_signal(target, "q_desired", part)
        self._notes.add("torque_measured_at", "motor", "no torque was recorded: servos give that of their motors")
        if servo.margin < 0.0:
            self._notes.remarks.append(DECLARED.format(label=servo.stream.label, odds=servo.margin))
        own: dict[str, Any] = {"kp": [float(f"{one:.4g}") for one in servo.kp]}
        if servo.kd is not None:
            own["kd"] = [float(f"{one:.4g}") for one in servo.kd]
            own["damps"] = servo.damps
        own["gains"] = "given" if servo.known else "estimated"
        for pattern in (PROPORTIONAL, DERIVATIVE):
            if (changing := gains_in(search.streams, pattern)[1]) is not None:
                self._notes.remarks.append(changing)
        if servo.known:
            text = "kp is a column of the recording" if servo.kd is None else "kp and kd are columns of the recording"
            text += "" if servo.kd is None else f"; the torque is nearer to the motion's if kd damps the {servo.damps}"
        else:
            listed = ", ".join(str(joint + 1) for joint in np.flatnonzero(servo.shown))
            text = f"kp by gravity and inertia of the model in joints {listed}; prefer those of your controller"
            self._notes.remarks.append(
                "no gains were recorded: kp was found with the masses of the model, so this log cannot hold masses or "
                "gains apart, and kd is a part of the viscous friction. Write kp and kd of your controller into servo "
                "and gains: given, if you know them"
            )
        self._notes.add("servo", flow(own), text, sure=servo.known)
        held = "with" if servo.meaning == "whole" else "without"
        text = f"the error of the servos makes the torque of the motion {held} gravity (log odds {servo.margin:.3g})"
        self._notes.add("torque_meaning", servo.meaning, text, servo.sure)
        return {"torque_measured_at": "motor", "torque_meaning": servo.meaning, "servo": own}

    def _check_torques(self, found: Assignment, search: JointSearch, robot: str) -> None:
        """Refuse a recording without a torque that a mapping could take."""
        path = self._part_of(found.position.stream).path
        if not found.torques:
            others = [f"{label} {why}" for label, why in found.no_torques.items()]
            not_these = f" ({'; '.join(others)})" if others else ""
            seen = "; ".join(stream.label for stream in search.streams)
            raise InputError(
                f"nothing goes with the torque that gravity and inertia of {robot} take in this motion, and a mapping "
                f"needs torques or currents, or desired positions of servos that make it; signals as wide as its "
                f"joints: {seen}{not_these}. Another --robot, or a "
                "mapping by hand (docs/files.md)",
                file=path,
            )

    def _order(self, found: Assignment, search: JointSearch) -> tuple[int, ...] | None:
        """Order of unnamed columns by the torque of the arm; None: the given order."""
        one, model = found.position.stream, search.model
        if one.is_cut or one.candidate.joints or PART_OF_ARM.search(one.candidate.label):
            return None
        tried = list(named_servo_torques(search, found)) if not found.torques else []
        if not found.torques:
            free = [other for other in search.free_of(found.streams) if other.label not in found.no_torques]
            tried += [other.series.at(found.time) for other in free[:MAX_SHOWN_SIGNALS]]
        for torque in found.torques[:MAX_SHOWN_SIGNALS]:
            constant, raw = torque.best.further.get("torque_constant"), torque.stream.series.at(found.time)
            if constant is None or not explains_most(found.with_torque(raw * np.array(constant), model)):
                tried.append(factors_of("torque", torque.best.unit) * raw)  # no currents, but perhaps in a wrong order
        for one_torque in tried:
            if (ordered := order_of_joints(found.with_torque(one_torque, model))) is not None:
                order, self._order_shown = ordered
                return order
        return None

    def _check_motion(self, places: Sequence[Reading], facts: RobotFacts) -> None:
        """Refuse an arm at rest, whose noise would be taken for velocity and torque."""
        found = [at_rest(one.stream.series.time, one.values, facts) for one in places]
        if found and None not in found:
            stream = places[0].stream
            raise InputError(f"{stream.label}: {found[0]}", file=self._part_of(stream).path)

    def _nothing(self, every: Sequence[JointStream], robot: str, count: int) -> InputError:
        """Error if no signal is the motion of the joints."""
        text = f"no signal of {_joints_of(count)} can be read"
        if every:
            text = (
                f"no two signals of {_joints_of(count)} are positions within the limits of {robot} and their "
                f"derivative; signals as wide as that: {'; '.join(one.label for one in every)}"
            )
        others = [
            one for part in self._parts for one in part.candidates if not one.pose and one.width not in (1, count)
        ]
        if others:
            listed = ", ".join(one.label for one in others[:MAX_SHOWN_SIGNALS])
            text += f"; signals of other widths: {listed}"
            text += ", of which a mapping takes joints by entries" * any(one.width > count for one in others)
        text += "".join(f"; the reader refuses {why}" for why in self._refusals())
        backwards = [back for part in self._parts if (back := steps_back(part.columns)) is not None]
        text += "".join(f"; {back}, so another clock was taken" for back in backwards)
        remedy = "Another --robot, or a mapping by hand" if every else "A mapping by hand"
        return InputError(f"{text}. {remedy} (docs/files.md)", file=self._parts[0].path)

    def _refusals(self) -> list[str]:
        """Signals that the reader refuses, with its reason."""
        by_reason: dict[str, list[str]] = {}
        for label, why in self._refused.items():
            by_reason.setdefault(why, []).append(label)
        return [f"{', '.join(labels[:MAX_SHOWN_SIGNALS])}: {why}" for why, labels in by_reason.items()]

    def _check_rate(self, rate: float, search: JointSearch) -> None:
        """Refuse ``--rate`` if a signal is a constant multiple of dq/dt at that rate; name the fitting rate."""
        for place, other, factor in search.velocities_at_other_rates():
            real = rate * factor
            raise InputError(
                f"{other.label} is {factor:.3g} times the derivative of {place.label} in all joints, which is a "
                f"velocity in rad/s at {real:.4g} Hz, in deg/s at {real * np.pi / 180.0:.4g} Hz",
                key="--rate",
                value=f"{rate:g}",
            )

    def _torque(
        self, found: Assignment, model: RobotModel, robot: str, signals: dict[str, dict[str, Any]], part: RecordedFile
    ) -> dict[str, Any]:
        """Add the torque of the joints to the signals; further keys of the mapping."""
        best, *others = found.torques
        facts, listed = model.facts, found.alternatives["torque"]
        free = [other for other in others if not (part.is_bag and other.stream.candidate.guess == "command")]
        computed = (
            "follows the model of the arm without any friction of its gears: a controller or a simulation computed it"
        )
        self._notes.remarks += [
            f"{other.stream.label} is left out: it {computed}" for other in free if other.computed and not best.computed
        ]
        if best.computed:
            self._notes.remarks.append(f"{best.stream.label} {computed}, so {NOTHING_SHOWS}. {MEASURED_TORQUE}")
        alike = "; ".join(other.stream.label for other in free if other.computed == best.computed)
        constant = best.best.further.get("torque_constant")
        signals["torque"] = self._joint_signal(best, "torque", part, listed, alike)
        seen = self._seen(best, found, model)
        at_motor = constant is not None or not facts.joint_torque_loop
        text = "currents are those of motors" if constant is not None else f"joint_torque_loop of {robot} is "
        text += "" if constant is not None else str(facts.joint_torque_loop).lower()
        text += self._motors_in(seen, best.meaning, at_motor)
        self._notes.add("torque_measured_at", "motor" if at_motor else "link", text, sure=constant is not None)
        meaning = meaning_of(seen, best.meaning, best.computed and constant is None)
        self._notes.add("torque_meaning", meaning.best, meaning.evidence, meaning.sure)
        if meaning.best in ADDED_BY_THE_MODEL:
            self._notes.remarks.append(f"{best.stream.label} {best.best.evidence}. {ADDED_BY_THE_MODEL[meaning.best]}")
        own: dict[str, Any] = {
            "torque_measured_at": "motor" if at_motor else "link", "torque_meaning": meaning.best
        }  # fmt: skip
        if constant is not None:
            self._notes.add(
                "torque_constant", flow(constant), "by the gravity torque in this recording; prefer a data sheet", False
            )
            own["torque_constant"] = constant
        return own

    def _motors_in(self, seen: MotionTorque, meaning: TorqueMeaning, at_motor: bool) -> str:
        """Whether a torque accelerates the motors as well, in words; a warning if that contradicts its place."""
        gain, inertia = motor_inertia_in(seen, meaning)
        shown = inertia[inertia > 0.0]
        if gain < DECISIVE_LOG_LIKELIHOOD or not shown.size:
            return f"; no inertia of motors shows in it (log likelihood {gain:+.0f})"
        size = f"{range_in_words(shown)} kg m^2"
        if not at_motor:
            self._notes.remarks.append(
                f"the torque accelerates {size} more than the links (log likelihood {gain:+.0f}): measured before the "
                "gears, or links of other inertia? In the first case torque_measured_at: motor"
            )
        return f"; it accelerates {size} in addition to the links (log likelihood {gain:+.0f})"

    def _commands(
        self, found: Assignment, search: JointSearch, model: RobotModel, signals: dict[str, dict[str, Any]],
        part: RecordedFile, currents: bool,
    ) -> dict[str, Any]:  # fmt: skip
        """Add the commanded torque of a bag to the signals; further keys of the mapping."""
        free = search.free_of([*found.streams, found.torques[0].stream])
        asked = [one for one in free if one.candidate.guess == "command" and self._part_of(one).is_bag]
        copied = [one for one in asked if one.label in found.no_torques]
        self._notes.remarks += [f"{one.label} is left out: it {found.no_torques[one.label]}" for one in copied]
        commands = [one for one in asked if one not in copied]
        if commands and currents:
            why = "nothing but currents was measured beside it"
            self._notes.remarks += [f"{one.label} is left out: {why}" for one in commands]
            return {}
        return self._command(found, commands, model, signals, part) if commands else {}

    def _command(
        self, found: Assignment, asked: Sequence[JointStream], model: RobotModel,
        signals: dict[str, dict[str, Any]], part: RecordedFile,
    ) -> dict[str, Any]:  # fmt: skip
        """Add the commanded torque closest (rms) to the measured one, with or without gravity, to the signals."""
        time, q = found.time, found.position.values
        series = found.torques[0].stream.series
        torque = replace(series, values=found.torques[0].values).at(time)
        gravity = np.array([model.gravity_torque(row) for row in q])
        size = max(float(np.sqrt(np.mean(np.square(torque)))), 1e-12)

        def apart(one: JointStream, missing: Array | float) -> float:
            """Difference to the measured torque over that torque, rms."""
            return float(np.sqrt(np.mean(np.square(one.series.at(time) + missing - torque)))) / size

        tried = [(apart(one, 0.0), apart(one, gravity), one) for one in asked]
        taken = min(tried, key=lambda one: min(one[:2]))
        for alone, lifted, one in tried:
            if one is not taken[2] or min(alone, lifted) > MAX_COMMAND_RMS_RATIO:
                far = f"{100.0 * min(alone, lifted):.0f} % of the measured torque away from it"
                self._notes.remarks.append(f"{one.label} is left out: by its name it was commanded, and it is {far}")
        alone, lifted, one = taken
        if min(alone, lifted) > MAX_COMMAND_RMS_RATIO:
            return {}
        included, both = alone <= lifted, f"{100.0 * alone:.0f} % of the measured torque away from it as it is"
        text = f"{both}, {100.0 * lifted:.0f} % with the gravity torque added (rms)"
        signals["command"] = self._joint_signal(Reading.of(one, "torque", "N m", text, np.inf), "command", part)
        sure = max(alone, lifted) > MIN_GRAVITY_RMS_RATIO * min(alone, lifted)
        text = f"it is nearer to the measured torque {'as it is' if included else 'with the gravity torque added'}"
        self._notes.add("command_includes_gravity", str(included).lower(), text, sure)
        return {"command_includes_gravity": included}

    def _joint_signal(
        self, one: Reading, name: str, main: RecordedFile, others: Sequence[PossibleReading] = (), alike: str = ""
    ) -> dict[str, Any]:
        """Section of a signal of the joints, added to the notes, with the layout of its file if it is not the main one.

        Args:
            one: The stream with its unit.
            name: The signal.
            main: File of the positions.
            others: Possible readings of the signal, the chosen one first.
            alike: Streams that fit the role equally well, also by name.
        """
        part, candidate, best = self._part_of(one.stream), one.stream.candidate, one.best
        shown = "by its numbers; see unit"
        if one.stream.is_cut:
            shown += "; what stands beside the joints is left out, as a gripper"
            self._notes.remarks.append(f"signals.{name}: of {candidate.label} numbers are taken for the joints")
        rival = next((other for other in others if other.stream != one.stream.label), None)
        margin = np.inf if rival is None else rival.behind
        if rival is not None and margin < DECISIVE_LOG_ODDS:
            shown += f"; next: {rival.stream}, log odds {margin:.2g}"
        shown += "" if candidate.stamped else f"; {NO_HEADER}"
        self._notes.add(
            f"signals.{name}", candidate.label, shown, not one.stream.is_cut and bool(margin > DECISIVE_LOG_ODDS)
        )
        text = one.choice.evidence + (f"; so do {alike}: take the one that was measured" if alike else "")
        sure = one.choice.sure and not alike and not one.computed and best.role != "current"
        self._notes.add(f"signals.{name}.unit", flow(best.unit), text, sure)
        self._notes.remarks += best.remarks
        self.readings[name] = tuple(others)
        further = {key: value for key, value in best.further.items() if key == "factor"}
        source = {**source_in(part, candidate.source, self._groups), "unit": best.unit, **further}
        return source | part.own_layout(main)

    def _joints(self, one: SignalCandidate, count: int) -> tuple[str, ...]:
        joints = joints_of(one.joints, "", False, count)
        if one.joints:
            self._notes.add("joints", flow(list(joints)), "the recording names them")
        else:
            self._notes.add("joints", flow(list(joints)), self._order_shown, sure=False)
        return joints

    def _part_of(self, stream: JointStream) -> RecordedFile:
        """The file of a stream."""
        return next(part for part in self._parts if part.pattern == stream.file)


def _check_width(found: Assignment, part: RecordedFile, robot: str, count: int) -> None:
    """Refuse a few joints of a wider arm: unnamed columns, if other columns are positions and derivatives as well."""
    series = found.position.stream.series
    free = [name for name, cells in part.columns.items() if np.ndim(cells) == 1 and vector_width(cells) == 1]
    free = [name for name in free if name not in part.clock_columns]
    if found.velocity is None or not free or series.time.size != len(part.columns[free[0]]):
        return
    first, other = (_first_of(free, one.stream.candidate) for one in (found.position, found.velocity))
    if first is None or other is None or found.velocity.stream.file != part.pattern:
        return
    apart = other - first
    own, within = range(first, first + count), range(max(0, -apart), len(free) - max(0, apart))
    around = [n for n in range(first - abs(apart) + 1, first + abs(apart)) if n in within and n not in own]
    if not around:
        return
    values, raw = (
        np.column_stack([np.asarray(part.columns[free[n + shift]], dtype=float) for n in around])
        for shift in (0, apart)
    )
    shown = are_derivatives(series.time, values, raw)
    block = [*own, *(n for n, derivative in zip(around, shown, strict=True) if derivative)]
    if len(block) > count + MAX_GRIPPER_NUMBERS:
        blocks = " and ".join(f"{free[min(block) + shift]} … {free[max(block) + shift]}" for shift in (0, apart))
        raise InputError(
            f"columns {blocks} hold positions and velocities of {len(block)} joints, and {robot} has {count}: another "
            "--robot, or a mapping by hand that says which columns are its own (docs/files.md)",
            file=part.path,
        )


def _first_of(names: Sequence[str], candidate: SignalCandidate) -> int | None:
    """Index of the first of a signal's columns if they are adjacent; None: not adjacent."""
    own = candidate.source.get("columns") or []
    first = names.index(own[0]) if own and own[0] in names else None
    return first if first is not None and list(names[first : first + len(own)]) == list(own) else None


def _joints_of(count: int) -> str:
    return f"{count} joint{'s' if count > 1 else ''}"
