# SPDX-License-Identifier: Apache-2.0
"""Recordings of free motion as a source of evidence: clusters are stretches of time, predicted by a torque balance.

Stretches last about a second, longer than the correlation time of the low-passed torque noise. Torques are divided by
the root mean square of the residual of their joint, so that all joints have equal weight; the pure error is the noise
of the recorded torque below the cut-off. The improvement by an effect is also judged joint by joint, because the noise
of each joint is unknown. The scale of each joint's torque is confounded with a payload and enters as a systematic
error. A scale that follows from estimated gains of servos is fitted with every model
(:mod:`impact_rs_analysis.evidence.free_motion.servo_gains`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.evidence.calibration import with_intervals
from impact_rs_analysis.evidence.cluster import Added, Cluster, Feature
from impact_rs_analysis.evidence.free_motion.motion_difference import minus_references, order_warning
from impact_rs_analysis.evidence.free_motion.servo_gains import GAIN_DEVIATION, ServoGains
from impact_rs_analysis.evidence.free_motion.torque_balance import Motion, TorqueBalance, motor_ratios, prepare
from impact_rs_analysis.evidence.free_motion.velocity_relation import VelocityRelation
from impact_rs_analysis.evidence.levels import (
    Cell,
    Comparison,
    ConditionScore,
    Level,
    RecordingDocument,
    SignalLevel,
    root_mean_square,
    rounded,
)
from impact_rs_analysis.evidence.minimum_data import MIN_BLOCKS
from impact_rs_analysis.evidence.rollouts import FreeMotion
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track, track_of_motion
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.actuation import TORQUE_GAIN
from impact_rs_sim.effects.link import LINK_ERRORS
from impact_rs_sim.effects.sensing import (
    COMMAND_CLOCK_OFFSET,
    MOTOR_ENCODER_OFFSET,
    TORQUE_DELAY,
    TORQUE_SENSOR_BUTTERWORTH,
    TORQUE_SENSOR_CROSSTALK,
    TORQUE_SENSOR_DRIFT,
    TORQUE_SENSOR_GAIN,
    TORQUE_SENSOR_LAG,
    TORQUE_SENSOR_OFFSET,
    VELOCITY_BUTTERWORTH,
    VELOCITY_DELAY,
    VELOCITY_GAIN,
    VELOCITY_LAG,
)
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array, joined_units
from impact_rs_trials.recordings.file_units import CURRENTS
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.run_finder import unique_names
from impact_rs_trials.recordings.recording import ARM, TooShort
from impact_rs_trials.recordings.remarks import merged
from impact_rs_trials.recordings.servo import ServoLaw
from impact_rs_trials.runs import Run
from impact_rs_trials.workers import Map

TARGET_STRETCHES = 24  # more in a recording that is longer than 24 times MAX_STRETCH_S
MAX_STRETCH_S, MIN_STRETCH_S = 2.0, 0.5  # longer than the correlation time of the noise
CLIPPING_ITERATIONS = 10  # of densities of information, until they converge
MIN_MOVING_SPEED = 0.05  # rad/s, m/s
MIN_SHARED_MOTION = 0.05  # of the squared velocity of a joint, outside the recording in which it moves most
TORQUE, DEFLECTION, POSITION_SLOPE, SERVO_GAIN = "torque", "deflection", "velocity of positions", "gain of the servo"
PHASES = ("moving up", "moving down", "slow")
LEVEL_TEXT = "torque balance of the arm in free motion, both sides low-passed"
CACHED_TORQUES_BYTES = 2**28
MIN_CACHED_TORQUES = 64  # predictions that one linearisation needs
TORQUE_SCALE_DEVIATION = {"link": 0.01, "motor": 0.02}  # over the torque; torque sensors of arms: 1 to 2 %
# Without a command, faults of torque sensor and motor are confounded: torque_gain and torque_offset represent both.
CONFOUNDED_WITH_MOTOR_FAULTS = (TORQUE_SENSOR_GAIN, TORQUE_SENSOR_OFFSET)
# No command was recorded, a deflection is known up to its mean, and all samples have one age.
UNIDENTIFIABLE_FAULTS = (COMMAND_CLOCK_OFFSET, MOTOR_ENCODER_OFFSET, TORQUE_SENSOR_DRIFT)
SERVO_WITHOUT_SENSOR = (
    TORQUE_DELAY,
    TORQUE_SENSOR_LAG,
    TORQUE_SENSOR_BUTTERWORTH,
)  # a computed torque passed no sensor
TORQUE_SENSOR_FAULTS = (
    TORQUE_SENSOR_CROSSTALK,
)  # strain gauges react to loads of neighbouring joints, currents do not
# Not for velocities that were derived from positions.
VELOCITY_SENSOR_FAULTS = (VELOCITY_LAG, VELOCITY_BUTTERWORTH, VELOCITY_DELAY, VELOCITY_GAIN)
MIN_NOISE_SHARE = 0.01  # noise over residual of a model, lower limit
TORQUE_UNIT = "N m"  # of a revolute joint
TORQUE_QUANTILE = 0.99  # in place of the largest torque: a few samples may be outliers
MIN_SAMPLES_OF_PHASE = 5  # of one joint; fewer are not reported

REMARKS = (
    "a recording is one condition: stretches of it are held out, so estimates are not tested at other speeds, poses or "
    "temperatures",
    "without repeats there is no pure error: noise means noise of the torque signal, and residuals above it need not "
    "come from an effect of the library",
)
DIFFERENCE_REMARK = (
    "differences of recordings of one motion: common errors cancel, and an effect is a change between the recordings; "
    "properties of arm, sensors and base do not change. A common gain of the torque scales the mass of the load, "
    "unless --model contains the gain (diagnose the recording without the load first)"
)
INTERVALS_REMARK = (
    "intervals include the scatter over the motion and a standard deviation of {scale:.0%} of the scale of each "
    "joint's torque; links of the model are taken as exact"
)
MOTOR_ENCODERS_REMARK = (
    "the motors of joints {joints} have encoders: their inertia and friction act on the motion of the motors, and the "
    "deflection of the transmission is a signal of its own, up to its mean"
)
MOTORS_UNUSED_REMARK = "motor_position is not used: in a difference of recordings the motion of the motors cancels"
FITTED_GAINS_REMARK = (
    "intervals include the scatter over the motion and the gains of the servos, which are fitted with every model; "
    "links of the model are taken as exact"
)
NO_MOTOR_ENCODERS_REMARK = (
    "no motor has an encoder of its own: the elasticity of a transmission shows only in the torque of its motor, and "
    "resembles a delay, a damping or another inertia; positions of the motors separate them (signals.motor_position)"
)
LINK_TORQUE = "the torque was measured behind the motors, so their inertia is not in it"
MOTOR_TORQUE = (
    "the torque was measured at the motors, before the gear: it accelerates their inertia and overcomes their friction"
)
CURRENT_TORQUE = (
    "the torque is motor current times torque_constant: it accelerates the motors and overcomes their friction"
)
ADDED = {
    "whole": "",
    "without_gravity": "; it was recorded without gravity, and the gravity torque of the nominal model is added",
    "external": "; it was recorded minus the torque of a rigid model, and the torque of the nominal model is added: an "
    "error of the links shows as far as the two models differ",
    "target": "",
}
ADDED_TO_SERVO = "; their controller adds the gravity torque, which is taken from the nominal model"
SERVO_TORQUE = "no torque was recorded: it is computed by the law of position servos, {law}"
UNKNOWN_GAIN = (
    f"; kp was estimated from gravity and inertia of the model and is known to {GAIN_DEVIATION:.0%}. It is fitted with "
    "every model, so this log cannot distinguish masses from gains: torques and friction are known in proportion to "
    "the masses of the model alone"
)
UNKNOWN_DAMPING = "; kd is unknown, so viscous friction includes the damping of the servos"


@dataclass(frozen=True)
class Stretch:
    """A stretch of a recording.

    Attributes:
        name: File and time.
        unit: File.
        rows: Its samples, in the stacked samples of all recordings.
    """

    name: str
    unit: str
    rows: slice


@dataclass(frozen=True)
class Column:
    """Column of the residuals: a signal of one joint.

    Attributes:
        signal: Torque, or deflection of the transmission.
        joint: Number of the joint.
        unit: Unit.
    """

    signal: str
    joint: int
    unit: str

    @property
    def index(self) -> str:
        """Name of its joint."""
        return f"joint{self.joint + 1}"


class RecordingSource(Source):
    """Recordings of free motion against the torque balance of a model.

    Args:
        recordings: The recordings.
        mapping: Mapping of their signals, and the mounted mass.
        model: The model.
        motions: Filtered recordings.
        physics: Physics of the arm under the model.
        stretches: Stretches of the recordings.
        minus: Recordings of the same motions that were subtracted.
        left_out: Path and reason of recordings that are too short.

    Attributes:
        balance: Torque balance that predicts them.
        residuals: Recorded minus predicted torque and deflection of the model, ``(k, c)`` [N m, rad].
        sigma: Scale of every column, ``(c,)`` [N m, rad].
        reading: Remarks on how the recordings were read.
    """

    kind = "recordings"
    repeated = False
    noise_by_joint = True
    size_is = "root mean square of recorded minus predicted joint torque over all joints and samples"
    not_measured = ("velocity jump", "contact and impulses", "object", "controller and its references")

    def __init__(
        self,
        recordings: Sequence[Run],
        mapping: Mapping,
        model: Model,
        motions: Sequence[Motion],
        physics: Physics,
        stretches: Sequence[Stretch],
        minus: Sequence[Run] = (),
        left_out: Sequence[tuple[str, str]] = (),
    ) -> None:
        self.recordings, self.mapping, self.model = tuple(recordings), mapping, model
        self._minus = tuple(minus)
        self.left_out = tuple(left_out)
        self._effects = model.known_effects | {LINK_ERRORS.name: LINK_ERRORS}
        self.motions, self.physics = tuple(motions), physics
        at_motor = mapping.torque_measured_at == "motor"
        self.balance = TorqueBalance(list(motions), at_motor)
        self._torques, self._stretches = self.balance.joints.size, tuple(stretches)
        self.whole_units = _joints_move_in_several(motions)
        related = "velocity" in mapping.signals and not minus
        self._relation = VelocityRelation(motions, [stretch.rows for stretch in stretches]) if related else None
        uncertain = mapping.servo is not None and mapping.servo.gains == "estimated"
        torque = self.balance.recorded[:, : self._torques]
        self._gains = ServoGains(torque, self.balance.noise[: self._torques], len(stretches)) if uncertain else None
        self._prediction_of_model = self.balance.predict(physics)
        predicted, self._related_of_model = self._with_relations(self._prediction_of_model, physics)
        self.residuals = self.balance.recorded - predicted
        self.sigma = np.maximum(np.sqrt(np.mean(np.square(self.residuals), axis=0)), 1e-12)
        units = physics.arms[ARM].facts.units
        self._columns = [Column(TORQUE, int(joint), units[joint].effort) for joint in self.balance.joints]
        self._columns += [Column(DEFLECTION, int(joint), units[joint].position) for joint in self.balance.elastic]
        self._weights = self._column_weights()
        self.size_unit = self.residual_unit = joined_units(column.unit for column in self._columns[: self._torques])
        self._predicted = Recent[tuple[Array, Array] | None](
            max(MIN_CACHED_TORQUES, int(CACHED_TORQUES_BYTES / self.balance.recorded.nbytes))
        )
        self.clusters = with_intervals(self, [self._cluster(number) for number in range(len(self._stretches))])
        remarks = merged((item.path.name, remark) for item in (*recordings, *minus) for remark in item.remarks)
        remarks += [f"{Path(path).name} is left out: {why}" for path, why in left_out]
        remarks += _motor_encoder_remarks(recordings, self.balance, minus)
        if minus and (drifts := order_warning(*([run.signals.time for run in runs] for runs in (recordings, minus)))):
            remarks.append(drifts)
        self.reading = (torque_in_words(mapping), *dict.fromkeys(remarks))
        self.remarks = (
            *REMARKS,
            *((DIFFERENCE_REMARK,) if minus else ()),
            FITTED_GAINS_REMARK
            if uncertain
            else INTERVALS_REMARK.format(scale=TORQUE_SCALE_DEVIATION[mapping.torque_measured_at]),
            *((NO_MOTOR_ENCODERS_REMARK,) if at_motor and not self.balance.elastic.size and not minus else ()),
            *self.reading,
        )

    @classmethod
    def of(
        cls,
        recordings: Sequence[Run],
        mapping: Mapping,
        model: Model,
        minus: Sequence[Run] = (),
        left_out: Sequence[tuple[str, str]] = (),
    ) -> RecordingSource:
        """Filter recordings and predict them; those too short for the filter are left out.

        Args:
            recordings: The recordings.
            mapping: Mapping of their signals, and the mounted mass.
            model: The model.
            minus: Recordings of the same motions to subtract
                (:mod:`impact_rs_analysis.evidence.free_motion.motion_difference`).
            left_out: Path and reason of recordings that were too short before.

        Raises:
            InputError: Sampled too slowly, all of them too short, too short for a hold-out, or of another motion than
                those to subtract.
        """
        short = list(left_out)
        law = mapping.servo_law
        recordings, motions = _prepared(recordings, mapping.low_pass, law, short)
        physics = model.apply(_physics_of(recordings))
        if minus:
            minus, references = _prepared(minus, mapping.low_pass, law, short)
            files = [recording.path for recording in recordings]
            motions = minus_references(motions, files, references, physics, mapping.torque_measured_at == "motor")
        return cls(recordings, mapping, model, motions, physics, _cut(recordings, motions), minus, short)

    @property
    def comparison_remarks(self) -> tuple[str, ...]:
        """See :class:`Source`: remarks on how the recordings were read."""
        return self.reading

    def _column_weights(self) -> Array:
        """Weight of a scaled residual in errors over all signals, ``(c,)`` [N m].

        A deflection has the weight of its joint's torque, so that the error of a model has the size of torques.
        """
        torques = self._columns[: self._torques]
        torque = {column.joint: float(size) for column, size in zip(torques, self.sigma, strict=False)}
        usual = root_mean_square(self.sigma[: self._torques])
        return np.array([torque.get(column.joint, usual) for column in self._columns])

    def residual_weight(self, item: Cluster) -> Array:
        """See :meth:`Source.residual_weight`."""
        torques = item.sigma.size - self._related
        scale = np.sqrt(item.sigma.size / torques)  # the mean square over all features equals that over the torques
        return np.concatenate((np.resize(self._weights, torques) * scale, np.zeros(self._related)))

    @property
    def _related(self) -> int:
        """Number of features of a stretch after its samples: velocities against positions, and gains of servos."""
        return sum(relation.noise.size for relation in self._relations)

    @property
    def _relations(self) -> list[VelocityRelation | ServoGains]:
        """Relations that give features beyond the samples."""
        return [relation for relation in (self._relation, self._gains) if relation is not None]

    @property
    def _weighted_residuals(self) -> Array:
        """Weighted residuals of the model, ``(k, c)`` [N m]."""
        return np.asarray(self.residuals / self.sigma * self._weights)

    @cached_property
    def proportion(self) -> Proportion:
        """See :attr:`Source.proportion`; the recorded torque shows drives that are large for their links."""
        turning = [number for number, column in enumerate(self._columns) if column.unit == TORQUE_UNIT]
        largest = np.quantile(np.abs(self.balance.recorded[:, turning]), TORQUE_QUANTILE, axis=0).max(initial=0.0)
        return super().proportion.driven_by(float(largest))

    @cached_property
    def recording(self) -> RecordingDocument:  # type: ignore[override]
        """How the recordings were read."""
        times = [run.signals.time for run in self.recordings]
        return RecordingDocument(
            files=tuple(dict.fromkeys(str(recording.path) for recording in self.recordings)),
            robot=self.mapping.robot,
            end_effector_mass_kg=self.mapping.end_effector.mass,
            samples=int(sum(time.size for time in times)),
            recorded_s=float(sum(time[-1] - time[0] for time in times)),
            used_s=float(sum(m.time[m.inner].size / m.rate for m in self.motions)),
            sampled_Hz=float(1.0 / np.median(np.diff(times[0]))),
            low_pass_Hz=self.motions[0].cut_off,
            signals=self._signals,
            torque=torque_in_words(self.mapping),
            minus=tuple(dict.fromkeys(str(recording.path) for recording in self._minus)),
        )

    @property
    def _signals(self) -> tuple[str, ...]:
        """Names of the recorded signals, without the computed torque of servos."""
        names = set(self.recordings[0].signals.arms[ARM].measured)
        if self.mapping.servo is not None:
            names -= {"torque"} | {name for name in ("dq_desired",) if name not in self.mapping.signals}
        return tuple(sorted(names))

    @property
    def stretch_seconds(self) -> float:
        """Mean length of a stretch [s]."""
        return self.recording.used_s / len(self._stretches)

    def predict(self, requests: Sequence[tuple[int, Added]], purpose: str) -> list[Array | None]:
        """See :meth:`Source.predict`."""
        del purpose
        features: list[Array | None] = []
        last: Added | None = None
        predicted: tuple[Array, Array] | None = None
        for number, added in requests:
            if added is not last:  # equal effects follow each other, and hashing many numbers is expensive
                last, predicted = added, self._prediction(added)
            features.append(None if predicted is None else self._features_of(number, *predicted))
        return features

    def _features_of(self, number: int, torque: Array, related: Array) -> Array:
        """Features of a stretch, ``(F,)``: torques and deflections by sample, then relations (:attr:`_related`)."""
        return np.concatenate((torque[self._stretches[number].rows].ravel(), related[number]))

    def offers(self, effect: Effect) -> bool:
        """See :meth:`Source.offers`; differences of recordings show only loads and effects that may change."""
        without = [*CONFOUNDED_WITH_MOTOR_FAULTS, *UNIDENTIFIABLE_FAULTS]
        if self.mapping.torque_measured_at == "motor":
            without += TORQUE_SENSOR_FAULTS
        if self.mapping.servo is not None:
            without += SERVO_WITHOUT_SENSOR
        if "velocity" not in self.mapping.signals:
            without += VELOCITY_SENSOR_FAULTS
        shown = effect.may_change or effect.shown_by_load or not self._minus
        acts = bool(effect.scalars(self.joints))  # one joint has no neighbour
        unidentifiable = {item.name for item in without}
        return acts and shown and effect.acts_on != "neighbour" and effect.name not in unidentifiable

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.residuals_with`."""
        numbers = {item.name: number for number, item in enumerate(self.clusters)}
        indices = [numbers[item.name] for item in like]
        predicted = self.predict([(number, added) for number in indices], "residuals")
        return [
            replace(item, residuals=((self._recorded(number) - features) / item.sigma)[None, :])
            for item, number, features in zip(like, indices, predicted, strict=True)
            if features is not None
        ] or None

    def _recorded(self, number: int) -> Array:
        """Recorded features of a stretch, ``(F,)``."""
        return self._features_of(number, self.balance.recorded, self._related_recorded)

    def size(self) -> float:
        """See :meth:`Source.size`; root mean square of the torque residual [N m]."""
        return root_mean_square(self._weighted_residuals)

    def noise_size(self) -> float:
        """See :meth:`Source.noise_size`."""
        return root_mean_square(np.maximum(self.balance.noise, 1e-12) / self.sigma * self._weights)

    def compare_levels(self) -> Comparison:
        """See :meth:`Source.compare_levels`: the torque of every joint."""
        noise = np.maximum(self.balance.noise, 1e-12)
        phases = [[feature.phase for feature in item.features] for item in self.clusters]
        torques = [row[: len(row) - self._related] for row in phases]
        phase = np.concatenate([np.array(row, dtype=object).reshape(-1, self.residuals.shape[1]) for row in torques])
        signals, cells = [], []
        for number, column in enumerate(self._columns):
            residuals = self.residuals[:, number]
            signals.append(
                SignalLevel(
                    phase="free",
                    signal=column.signal,
                    index=column.index,
                    error=rounded(root_mean_square(residuals)),
                    mean=rounded(float(residuals.mean())),
                    noise_floor=rounded(float(noise[number])),
                    unit=column.unit,
                    times_noise=rounded(root_mean_square(residuals) / float(noise[number])),
                )
            )
            for name in dict.fromkeys(phase[:, number]):
                rows = phase[:, number] == name
                if np.count_nonzero(rows) >= MIN_SAMPLES_OF_PHASE:
                    cells.append(self._cell(name, number, rows, float(noise[number])))
        times_noise = root_mean_square(np.sqrt(np.mean(np.square(self.residuals), axis=0)) / noise)
        level = Level(what=LEVEL_TEXT, times_noise=rounded(times_noise), signals=tuple(signals))
        files: dict[str, list[Array]] = {}
        for item in self.clusters:
            files.setdefault(item.unit, []).append(item.mean * self.residual_weight(item))
        return Comparison(
            levels={"recording": level},
            where=tuple(sorted(cells, key=lambda cell: -cell.share)),
            conditions=tuple(
                ConditionScore(name=name, repeats=len(parts), score=rounded(root_mean_square(np.concatenate(parts))))
                for name, parts in files.items()
            ),
        )

    def _cell(self, phase: str, number: int, rows: NDArray[np.bool_], noise: float) -> Cell:
        """Residual of one column in one phase, which has some rows."""
        residuals, weighted, column = self.residuals[rows, number], self._weighted_residuals, self._columns[number]
        return Cell(
            scenario=", ".join(run.path.name for run in self.recordings),
            object="",
            case="",
            phase=phase,
            signal=column.signal,
            index=column.index,
            error=rounded(float(residuals.mean())),
            unit=column.unit,
            floor=0.0,
            share=rounded(float(np.sum(np.square(weighted[rows, number]))) / max(float(np.sum(weighted**2)), 1e-300)),
            times_noise=rounded(root_mean_square(residuals) / noise),
        )

    def joint_sizes(self, residuals: Sequence[Array]) -> list[tuple[str, float, float, str]]:
        """See :meth:`Source.joint_sizes`."""
        torques = np.concatenate([stretch[: stretch.size - self._related] for stretch in residuals])
        sizes = np.sqrt(np.mean(np.square(torques.reshape(-1, self.sigma.size)), axis=0)) * self.sigma
        return [
            (column.index, float(size), float(noise), column.unit)
            for column, size, noise in zip(self._columns[: self._torques], sizes, self.balance.noise, strict=False)
        ]

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """See :meth:`Source.tracks`: torque of every joint of every recording, recorded and predicted."""
        del map_tasks
        residuals_of_model = {"the model": self.residuals}
        if added:
            residuals_of_model = {
                "the model with the effects found": self.residuals_by(added),
                "the model as it is": self.residuals,
            }
        tracks = []
        for label, residuals in residuals_of_model.items():
            start = 0
            for run, motion in zip(self.recordings, self.motions, strict=True):
                rows = slice(start, start := start + motion.time[motion.inner].size)
                measured, predicted = self.balance.recorded[rows], (self.balance.recorded - residuals)[rows]
                curves = [
                    ComparedSignal(f"{column.signal} of joint {column.joint + 1}", column.unit, *values)
                    for column, *values in zip(self._columns, measured.T, predicted.T, strict=True)
                ]
                name = label if len(self.motions) == 1 else f"{run.path.name}, {label}"
                tracks.append(track_of_motion(name, self.physics, motion, curves))
        return tuple(tracks)

    def free_motions(self, numbers: Sequence[int] | None = None) -> tuple[FreeMotion, ...]:
        """See :meth:`Source.free_motions`; empty for differences, and where a joint's torque was not measured."""
        if self._minus or not all(motion.measured.all() for motion in self.motions):
            return ()
        motions, first = [], 0
        for run, motion in zip(self.recordings, self.motions, strict=True):
            time = motion.time[motion.inner]
            last = first + time.size
            for low, high in self._parts(numbers, first, last):
                motions.append(
                    FreeMotion(
                        arm=ARM,
                        physics=self.physics,
                        time=motion.time,
                        position=motion.position,
                        velocity=motion.velocity,
                        acceleration=motion.acceleration,
                        torque_time=run.signals.time - run.signals.time[0],
                        torque=run.signals.arms[ARM].torque,  # unfiltered: a reversal of dry friction is sudden
                        begin=float(time[low]),
                        end=float(time[high - 1]),
                        with_motor=self.mapping.torque_measured_at == "motor",
                        servo=self.mapping.servo_law,
                        q_desired=run.signals.arms[ARM].q_desired,
                        dq_desired=run.signals.arms[ARM].dq_desired,
                    )
                )
            first = last
        return tuple(motions)

    def _rolled(self, motion: FreeMotion, added: Added) -> Physics:
        """Physics of a motion with effects, and with the gains of servos fitted to these effects."""
        physics = super()._rolled(motion, added)
        if self._gains is None:
            return physics
        arm, torque = physics.arms[ARM], self.balance.predict(physics)[:, : self._torques]
        share = self._gains.fitted(torque, self.balance.delay_loss(physics))
        return replace(physics, arms={ARM: replace(arm, torque_gain=arm.torque_gain / (1.0 + share))})

    def _parts(self, numbers: Sequence[int] | None, first: int, last: int) -> list[tuple[int, int]]:
        """Rows of the motion of the stacked samples ``first`` to ``last`` in some stretches; neighbours are merged."""
        if numbers is None:
            return [(0, last - first)]
        parts: list[tuple[int, int]] = []
        for number in sorted(numbers):
            rows = self._stretches[number].rows
            if not first <= rows.start < last:
                continue
            low, high = rows.start - first, rows.stop - first
            if parts and parts[-1][1] == low:
                low = parts.pop()[0]
            parts.append((low, high))
        return parts

    def residuals_by(self, added: Added) -> Array:
        """Recorded minus predicted torque of the model with effects, ``(k, n)`` [N m].

        Raises:
            InputError: The effects give a body without positive inertia.
        """
        torque = self._torque(added)
        if torque is None:
            raise InputError("with these effects the arm has no positive inertia")
        return np.asarray(self.balance.recorded - torque)

    def _torque(self, added: Added) -> Array | None:
        """Predicted torque of all recordings, ``(k, n)`` [N m]; None without positive inertia."""
        prediction = self._prediction(added)
        return None if prediction is None else prediction[0]

    def _prediction(self, added: Added) -> tuple[Array, Array] | None:
        """Torque ``(k, c)`` and relations ``(K, E)`` (:attr:`_related`) of all recordings; None: not a body."""
        return self._predicted.of(added, lambda: self._predict_uncached(added))

    def _predict_uncached(self, added: Added) -> tuple[Array, Array] | None:
        try:
            physics = self._physics_with(added)
            torque = self.balance.predict(physics)
            shared = tuple(effect for effect in added if self._shared(effect[0])) if self._minus else ()
            if shared:
                torque = torque - self.balance.predict(self._physics_with(shared)) + self._prediction_of_model
        except NotABody:
            return None
        return self._with_relations(torque, physics)

    def _with_relations(self, torque: Array, physics: Physics) -> tuple[Array, Array]:
        """Predicted torque with fitted gains ``(k, c)``, and relations ``(K, E)`` (:attr:`_related`)."""
        related = [np.empty((len(self._stretches), 0))]
        if self._relation is not None:
            related.append(self._relation.predicted(physics.arms[ARM].readings))
        if self._gains is not None:
            torque_columns, late = slice(self._torques), self.balance.delay_loss(physics)
            share = self._gains.fitted(torque[:, torque_columns], late)
            torque = torque.copy()
            torque[:, torque_columns] += share * (torque[:, torque_columns] - late)
            related.append(self._gains.predicted(share))
        return torque, np.hstack(related)

    @cached_property
    def _related_recorded(self) -> Array:
        """Recorded relations (:attr:`_related`), ``(K, E)``."""
        nothing = np.empty((len(self._stretches), 0))
        return np.hstack([nothing, *(relation.recorded for relation in self._relations)])

    def _physics_with(self, added: Added) -> Physics:
        """The physics of the model with effects."""
        physics = self.physics
        for name, values in added:
            physics = self._effects[name].apply_vector(physics, np.array(values))
        return physics

    def _shared(self, name: str) -> bool:
        """Whether an effect is common to two recordings of one motion, as a property of arm or sensors."""
        return not self._effects[name].may_change

    def _cluster(self, number: int) -> Cluster:
        stretch = self._stretches[number]
        residuals, velocity = self.residuals[stretch.rows], self.balance.velocity[stretch.rows]
        phase = np.where(velocity > MIN_MOVING_SPEED, 0, np.where(velocity < -MIN_MOVING_SPEED, 1, 2))
        labels = [[_feature(name, column) for name in PHASES] for column in self._columns]
        sigma = np.broadcast_to(self.sigma, residuals.shape).ravel()
        noise = np.broadcast_to(self.balance.noise, residuals.shape).ravel()
        features = [of_phase[number] for row in phase for of_phase, number in zip(labels, row, strict=True)]
        rows = residuals.ravel()
        if self._related:
            share = max(root_mean_square(self.balance.noise / self.sigma), MIN_NOISE_SHARE)
            related_noise = np.concatenate([relation.noise for relation in self._relations])
            noise = np.append(noise, related_noise)
            sigma = np.append(sigma, related_noise / share)  # equal noise has equal weight
            rows = np.append(rows, (self._related_recorded - self._related_of_model)[number])
            features += self._related_features()
        return Cluster(
            name=stretch.name,
            condition_key=(stretch.unit, stretch.name, ""),
            layout=stretch.name,
            unit=stretch.unit,
            contact=False,
            features=tuple(features),
            residuals=(rows / sigma)[None, :],
            sigma=sigma,
            pure_error=noise / sigma,
            discrepancy=np.zeros(rows.size),
            calibrations=np.pad(self._scale_errors(stretch.rows), ((0, 0), (0, self._related))),
        )

    def _related_features(self) -> list[Feature]:
        """Features of the relations: gains, then delays of the velocities of all joints; gains of servos."""
        units = self.physics.arms[ARM].facts.units
        velocities = [
            Feature("free", POSITION_SLOPE, f"joint{joint + 1}", order, unit.velocity, 0.0)
            for order in range(2)
            for joint, unit in enumerate(units)
        ]
        gains = [Feature("free", SERVO_GAIN, f"joint{joint + 1}", 0, "-", 0.0) for joint in self.balance.joints]
        return (velocities if self._relation else []) + (gains if self._gains else [])

    @cached_property
    def _scale_deviations(self) -> Array:
        """Relative standard deviations of each joint's torque scale, including a gain of the model, ``(n,)`` [-]."""
        deviation = 0.0 if self._gains else TORQUE_SCALE_DEVIATION[self.mapping.torque_measured_at]
        deviations = np.full(self.physics.arms[ARM].facts.joint_count, deviation)
        for effect in self.model.effects:
            if effect.name == TORQUE_GAIN.name:
                for joint, scalar in enumerate(TORQUE_GAIN.scalars(self.joints)):
                    gain = effect.parameters[scalar.name]
                    low, high = gain.ci95 or (gain.estimate, gain.estimate)
                    deviations[joint] = np.hypot(deviations[joint], (high - low) / (2.0 * NORMAL_95 * gain.estimate))
        return deviations[self.balance.joints]

    def _scale_errors(self, rows: slice) -> Array:
        """Change of the residuals by one standard deviation of the scale of each joint's torque, ``(n, k n)`` [-].

        In a difference of recordings the error of the common torque cancels.
        """
        torque = (self.residuals if self._minus else self.balance.recorded)[rows] / self.sigma
        joint_column = np.eye(self._torques, self.sigma.size)[:, None, :]
        change = self._scale_deviations[:, None, None] * torque[None, :, :] * joint_column
        return np.asarray(change.reshape(self._torques, -1))


def torque_in_words(mapping: Mapping) -> str:
    """Source of the torque of recordings, in one line."""
    if (servo := mapping.servo) is not None:
        damping = "" if servo.kd is None else " - kd dq" if servo.damps == "velocity" else " + kd (dq_desired - dq)"
        text = SERVO_TORQUE.format(law=f"kp (q_desired - q){damping}")
        text += UNKNOWN_GAIN if servo.gains == "estimated" else ""
        text += UNKNOWN_DAMPING if servo.kd is None else ""
        return text + (ADDED_TO_SERVO if mapping.torque_meaning == "without_gravity" else "")
    if mapping.torque_measured_at == "link":
        text = LINK_TORQUE
    else:
        text = CURRENT_TORQUE if mapping.signals["torque"].units[0] in CURRENTS else MOTOR_TORQUE
    return text + ADDED[mapping.torque_meaning]


def _feature(phase: str, column: Column) -> Feature:
    return Feature(phase, column.signal, column.index, 0, column.unit, 0.0)


def _motor_encoder_remarks(recordings: Sequence[Run], balance: TorqueBalance, minus: Sequence[Run]) -> list[str]:
    """Remarks on the use of recorded motor positions; empty without motor positions."""
    arms = [run.signals.arms[ARM] for run in recordings if run.signals.arms[ARM].motor_position.size]
    if not arms:
        return []
    if minus:
        return [MOTORS_UNUSED_REMARK]
    used = [f"{joint + 1}" for joint in balance.elastic]
    unused = [joint for joint in range(arms[0].position.shape[1]) if joint not in balance.elastic]
    ratios = motor_ratios(arms[0])
    text = [MOTOR_ENCODERS_REMARK.format(joints=", ".join(used))] if used else []
    if unused:
        moved = ", ".join(f"joint {joint + 1} {ratios[joint]:.3g} times" for joint in unused)
        text.append(
            f"motor_position is not used where it shows no deflection (motion over motion of the link: {moved}): "
            "expected the position of the motor, divided by the gear ratio (signals.motor_position.factor)"
        )
    return text


def _physics_of(runs: Sequence[Run]) -> Physics:
    """Nominal physics of the arm, with the mean end-effector position of all recordings."""
    physics = runs[0].physics
    positions = [run.physics.arms[ARM].impact_position for run in runs]
    return replace(physics, arms={ARM: replace(physics.arms[ARM], impact_position=np.mean(positions, axis=0))})


def _prepared(
    recordings: Sequence[Run], cut_off: float, law: ServoLaw | None, short: list[tuple[str, str]]
) -> tuple[list[Run], list[Motion]]:
    """Recordings that are long enough for the filter, and their motions; the others are appended to ``short``.

    Raises:
        InputError: Sampled too slowly.
        TooShort: No recording is long enough.
    """
    long_enough: list[Run] = []
    motions: list[Motion] = []
    for recording in recordings:
        try:
            motions.append(prepare(recording, cut_off, law))
            long_enough.append(recording)
        except TooShort as error:
            where = f"from {recording.begin:.3g} s on: " if recording.begin else ""
            short.append((str(recording.path), f"{where}{error.message}"))
    if not long_enough:
        raise TooShort(short[-1][1], file=recordings[-1].path)
    return long_enough, motions


def _information(motions: Sequence[Motion], shortest: float) -> list[Array]:
    """Cumulative information of the samples between the edges of every motion, ``(k,)`` each; its mean density is 1.

    The density is one third each of 1 (gravity and offsets), of the squared velocity and of the squared acceleration of
    the joints, the latter two over their mean squares.

    Args:
        motions: Filtered recordings.
        shortest: Length of the shortest over length of the mean stretch; densities are clipped at its inverse.
    """
    signals = [
        np.stack([motion.low_pass(values)[motion.inner] for values in (motion.velocity, motion.acceleration)])
        for motion in motions
    ]
    squares = np.mean(np.square(np.concatenate(signals, axis=1)), axis=1, keepdims=True)
    densities = [(1.0 + 2.0 * np.mean(part**2 / np.maximum(squares, 1e-300), axis=(0, 2))) / 3.0 for part in signals]
    for _ in range(CLIPPING_ITERATIONS):
        mean = float(np.mean(np.concatenate(densities)))
        densities = [np.minimum(part / mean, 1.0 / shortest) for part in densities]
    return [np.cumsum(part) for part in densities]


def _joints_move_in_several(motions: Sequence[Motion]) -> bool:
    """Whether every joint that moves does so in several recordings: in the others its friction does not show."""
    speeds = [np.abs(motion.velocity[motion.inner]) for motion in motions]
    squares = np.array([np.sum(np.where(speed > MIN_MOVING_SPEED, speed**2, 0.0), axis=0) for speed in speeds])
    shared = 1.0 - squares.max(axis=0) / np.maximum(squares.sum(axis=0), 1e-300)
    return bool(np.all(shared > MIN_SHARED_MOTION))


def _cut(recordings: Sequence[Run], motions: Sequence[Motion]) -> list[Stretch]:
    """Cut the motions into stretches of about equal information, not shorter than the correlation time of the noise.

    Most of a chirp is above the cut-off: a few stretches of equal length would contain all of the motion below it, and
    a sign-flip test of a few scores has no power.

    Raises:
        InputError: Too short for a hold-out.
    """
    lengths = [(motion.time[motion.inner].size, motion.rate) for motion in motions]
    total = sum(size / rate for size, rate in lengths)
    seconds = float(np.clip(total / TARGET_STRETCHES, MIN_STRETCH_S, MAX_STRETCH_S))
    shares = _information(motions, MIN_STRETCH_S / seconds)
    stretches, first = [], 0
    files = [recording.path for recording in recordings]
    names = unique_names([file.name for file in files], files)
    for name, recording, motion, (size, rate), share in zip(names, recordings, motions, lengths, shares, strict=True):
        parts = max(1, round(size / rate / seconds))
        edges = np.searchsorted(share, np.arange(parts) / parts * share[-1]).tolist() + [size]
        start = recording.begin + float(motion.time[motion.inner][0])
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            label = f"{name}, {start + low / rate:.1f} to {start + high / rate:.1f} s"
            stretches.append(Stretch(label, str(recording.path), slice(first + int(low), first + int(high))))
        first += size
    if len(stretches) < MIN_BLOCKS:
        raise InputError(
            f"{total:.3g} s of usable motion, at least {MIN_BLOCKS * MIN_STRETCH_S:g} s are needed for a hold-out",
            file=recordings[0].path,
        )
    return stretches
