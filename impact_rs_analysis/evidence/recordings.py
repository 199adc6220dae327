# SPDX-License-Identifier: Apache-2.0
"""Recordings of free motion as a source of evidence: clusters are stretches of time, predicted by a torque balance.

Stretches last about a second, longer than the correlation time of the low-passed torque noise. Torques are divided by
the root mean square of the residual of their joint, so that all joints have equal weight; the pure error is the noise
of the recorded torque below the cut-off. A gain counts against what is left of a joint as well, because its noise is
not known. A motion does not test the scale of each joint's torque: one that is 1 % off looks like a payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Cluster, Feature
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
from impact_rs_analysis.evidence.motion_difference import minus_references
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.torque_balance import Motion, TorqueBalance, prepare
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track, track_of_motion
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.actuation import TORQUE_GAIN
from impact_rs_sim.effects.surroundings import BASE_TILT
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.recent import Recent
from impact_rs_sim.robot import Array, joined_units
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import ARM, TooShort
from impact_rs_trials.recordings.remarks import merged
from impact_rs_trials.runs import Run
from impact_rs_trials.workers import Map

STRETCHES = 24  # at least, if they are not shorter than SHORTEST
LONGEST, SHORTEST = 2.0, 0.5  # s
LEAST_STRETCHES = 12
SLOW = 0.05  # rad/s, m/s
SIGNAL = "torque"
PHASES = ("moving up", "moving down", "slow")
WHAT = "torque balance of the arm in free motion, both sides low-passed"
MOST_MEMORY = 2**28  # bytes, of predicted torques that are kept
LEAST_KEPT = 64  # of them, as many as a linearisation asks for
TORQUE_SCALE = {"link": 0.01, "motor": 0.02}  # standard deviation, over the torque (torque sensors of arms: 1 to 2 %)
TORQUE_UNIT = "N m"  # of a joint that turns
MOST_OF_TORQUE = 0.99  # of the samples, below the largest torque; a few may be wild
LEAST_SAMPLES = 5  # of a phase of one joint; fewer are not reported

REMARKS = (
    "a recording is one condition: stretches of it are held out, so estimates are not tested at other speeds, poses or "
    "temperatures",
    "without repeats there is no pure error: the noise is that of the torque signal, and residuals above it need not "
    "come from an effect of the library",
)
DIFFERENCE = (
    "differences of recordings of one motion: what both have in common cancels, and an effect is a change between "
    "them. A gain of the torque that both have scales the load: its mass is what the recorded torques weigh, unless "
    "--model knows the gain (diagnose the recording without the load first)"
)
COUNTED = (
    "intervals count the scatter over the motion and a standard deviation of {scale:.0%} of the scale of each joint's "
    "torque; links of the model count as exact"
)
BEHIND_MOTORS = "the torque was measured behind the motors, so their inertia is not in it"


@dataclass(frozen=True)
class Stretch:
    """A stretch of a recording.

    Attributes:
        name: File and time.
        unit: File.
        rows: Its samples among those of all recordings.
    """

    name: str
    unit: str
    rows: slice


class RecordingSource(Source):
    """Recordings of free motion against the torque balance of a model.

    Args:
        recordings: The recordings.
        mapping: Mapping of their signals, and the mounted mass.
        model: The model.
        motions: Filtered recordings.
        physics: Of the arm under the model.
        stretches: Their stretches.
        minus: Recordings of the same motions that were subtracted.
        left_out: Path and reason of recordings that are too short.

    Attributes:
        balance: Prediction of their torque.
        rest: Recorded minus predicted torque of the model, ``(k, n)`` [N m].
        sigma: Scale of every joint, ``(n,)`` [N m].
        reading: Remarks on how the recordings were read.
    """

    kind = "recordings"
    repeated = False
    noise_apart = True
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
        self._known = model.known_effects
        self.motions, self.physics = tuple(motions), physics
        at_motor = mapping.torque_measured_at == "motor"
        self.balance = TorqueBalance(list(motions), at_motor)
        self._of_the_model = self.balance.predict(physics)
        self.rest = self.balance.recorded - self._of_the_model
        self.sigma = np.maximum(np.sqrt(np.mean(np.square(self.rest), axis=0)), 1e-12)
        self._units = [(int(joint), physics.arms[ARM].facts.units[joint]) for joint in self.balance.joints]
        self.size_unit = self.residual_unit = joined_units(units.effort for _, units in self._units)
        self._stretches = tuple(stretches)
        self._predicted = Recent[Array | None](max(LEAST_KEPT, int(MOST_MEMORY / self.balance.recorded.nbytes)))
        self.clusters = tuple(self._cluster(number) for number in range(len(self._stretches)))
        remarks = merged((item.path.name, remark) for item in (*recordings, *minus) for remark in item.remarks)
        remarks += [f"{Path(path).name} is left out: {why}" for path, why in left_out]
        self.reading = tuple(dict.fromkeys(remarks))
        self.remarks = (
            *REMARKS,
            *((DIFFERENCE,) if minus else ()),
            COUNTED.format(scale=TORQUE_SCALE[mapping.torque_measured_at]),
            *(() if at_motor else (BEHIND_MOTORS,)),
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
        """Filter recordings and predict them; those that are too short for the filter are left out.

        Args:
            recordings: The recordings.
            mapping: Mapping of their signals, and the mounted mass.
            model: The model.
            minus: Recordings of the same motions to subtract (:mod:`impact_rs_analysis.evidence.motion_difference`).
            left_out: Path and reason of recordings that were too short before.

        Raises:
            InputError: Sampled too slowly, all of them too short, too short for a hold-out, or of another motion than
                those to subtract.
        """
        short = list(left_out)
        recordings, motions = _prepared(recordings, mapping.low_pass, short)
        physics = model.apply(_physics_of(recordings))
        if minus:
            minus, references = _prepared(minus, mapping.low_pass, short)
            files = [recording.path for recording in recordings]
            motions = minus_references(motions, files, references, physics, mapping.torque_measured_at == "motor")
        return cls(recordings, mapping, model, motions, physics, _cut(recordings, motions), minus, short)

    @property
    def comparison_remarks(self) -> tuple[str, ...]:
        """See :class:`Source`: those on how the recordings were read."""
        return self.reading

    @cached_property
    def proportion(self) -> Proportion:  # type: ignore[override]
        """See :attr:`Source.proportion`; its drives may be large beside its links, and are in what was recorded."""
        turning = [number for number, (_, units) in enumerate(self._units) if units.effort == TORQUE_UNIT]
        largest = np.quantile(np.abs(self.balance.recorded[:, turning]), MOST_OF_TORQUE, axis=0).max(initial=0.0)
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
            used_s=float(sum(m.time[m.kept].size / m.rate for m in self.motions)),
            sampled_Hz=float(1.0 / np.median(np.diff(times[0]))),
            low_pass_Hz=self.motions[0].cut_off,
            signals=tuple(sorted(self.recordings[0].signals.arms[ARM].measured)),
            minus=tuple(dict.fromkeys(str(recording.path) for recording in self._minus)),
        )

    @property
    def stretch_seconds(self) -> float:
        """Mean length of a stretch [s]."""
        return self.recording.used_s / len(self._stretches)

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """See :meth:`Source.predict`."""
        del what
        found: list[Array | None] = []
        last: Added | None = None
        torque: Array | None = None
        for number, added in wanted:
            if added is not last:  # most follow each other, and the hash of many numbers is dear
                last, torque = added, self._torque(added)
            found.append(None if torque is None else torque[self._stretches[number].rows].ravel())
        return found

    def offers(self, effect: Effect) -> bool:
        """See :meth:`Source.offers`; recordings calibrate the bare arm."""
        return True

    def measure_again(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.measure_again`."""
        torque = self._torque(added)
        if torque is None:
            return None
        rest = self.balance.recorded - torque
        numbers = {item.name: number for number, item in enumerate(self.clusters)}
        return [
            replace(item, residuals=(rest[self._stretches[numbers[item.name]].rows].ravel() / item.sigma)[None, :])
            for item in like
        ]

    def size(self) -> float:
        """See :meth:`Source.size`; root mean square of the torque residual [N m]."""
        return root_mean_square(self.rest)

    def noise_size(self) -> float:
        """See :meth:`Source.noise_size`."""
        return root_mean_square(np.maximum(self.balance.noise, 1e-12))

    def compare_levels(self) -> Comparison:
        """See :meth:`Source.compare_levels`: the torque of every joint."""
        noise = np.maximum(self.balance.noise, 1e-12)
        phases = [[feature.phase for feature in item.features] for item in self.clusters]
        phase = np.concatenate([np.array(row, dtype=object).reshape(-1, self.rest.shape[1]) for row in phases])
        signals, cells = [], []
        for column, (joint, units) in enumerate(self._units):
            own = self.rest[:, column]
            signals.append(
                SignalLevel(
                    phase="free",
                    signal=SIGNAL,
                    index=f"joint{joint + 1}",
                    error=rounded(root_mean_square(own)),
                    mean=rounded(float(own.mean())),
                    noise_floor=rounded(float(noise[column])),
                    unit=units.effort,
                    times_noise=rounded(root_mean_square(own) / float(noise[column])),
                )
            )
            for name in dict.fromkeys(phase[:, column]):
                part = own[phase[:, column] == name]
                if part.size >= LEAST_SAMPLES:
                    cells.append(self._cell(name, joint, part, float(noise[column])))
        every = root_mean_square(np.sqrt(np.mean(np.square(self.rest), axis=0)) / noise)
        level = Level(what=WHAT, times_noise=rounded(every), signals=tuple(signals))
        files: dict[str, list[Array]] = {}
        for item in self.clusters:
            files.setdefault(item.unit, []).append(item.mean * item.sigma)
        return Comparison(
            levels={"recording": level},
            where=tuple(sorted(cells, key=lambda cell: -cell.share)),
            conditions=tuple(
                ConditionScore(name=name, repeats=len(parts), score=rounded(root_mean_square(np.concatenate(parts))))
                for name, parts in files.items()
            ),
        )

    def _cell(self, phase: str, joint: int, rest: Array, noise: float) -> Cell:
        """Residual of one joint in one phase."""
        return Cell(
            scenario=", ".join(run.path.name for run in self.recordings),
            object="",
            case="",
            phase=phase,
            signal=SIGNAL,
            index=f"joint{joint + 1}",
            error=rounded(float(rest.mean())),
            unit=self.physics.arms[ARM].facts.units[joint].effort,
            floor=0.0,
            share=rounded(float(np.sum(np.square(rest))) / max(float(np.sum(np.square(self.rest))), 1e-300)),
            times_noise=rounded(root_mean_square(rest) / noise),
        )

    def joint_sizes(self, rest: Sequence[Array]) -> list[tuple[str, float, float, str]]:
        """See :meth:`Source.joint_sizes`."""
        sizes = np.sqrt(np.mean(np.square(np.concatenate(rest).reshape(-1, self.sigma.size)), axis=0)) * self.sigma
        return [
            (f"joint{joint + 1}", float(size), float(noise), units.effort)
            for (joint, units), size, noise in zip(self._units, sizes, self.balance.noise, strict=True)
        ]

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """See :meth:`Source.tracks`: torque of every joint of every recording, recorded and predicted."""
        del map_tasks
        rests = {"the model": self.rest}
        if added:
            rests = {"the model with what was found": self.rest_with(added), "the model as it is": self.rest}
        found = []
        for label, rest in rests.items():
            start = 0
            for run, motion in zip(self.recordings, self.motions, strict=True):
                rows = slice(start, start := start + motion.time[motion.kept].size)
                measured, predicted = self.balance.recorded[rows], (self.balance.recorded - rest)[rows]
                curves = [
                    ComparedSignal(f"torque of joint {joint + 1}", units.effort, one, other)
                    for (joint, units), one, other in zip(self._units, measured.T, predicted.T, strict=True)
                ]
                name = label if len(self.motions) == 1 else f"{run.path.name}, {label}"
                found.append(track_of_motion(name, self.physics, motion, curves))
        return tuple(found)

    def rest_with(self, added: Added) -> Array:
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
        return self._predicted.of(added, lambda: self._torque_anew(added))

    def _torque_anew(self, added: Added) -> Array | None:
        try:
            torque = self.balance.predict(self._with(added))
            shared = tuple(one for one in added if self._shared(one[0])) if self._minus else ()
            return torque - self.balance.predict(self._with(shared)) + self._of_the_model if shared else torque
        except NotABody:
            return None

    def _with(self, added: Added) -> Physics:
        """The physics of the model with effects."""
        physics = self.physics
        for name, values in added:
            physics = self._known[name].apply_vector(physics, np.array(values))
        return physics

    def _shared(self, name: str) -> bool:
        """Whether two recordings of one motion have an effect in common: how arm and sensors are made."""
        return self._known[name].calibrates or name in (TORQUE_GAIN.name, BASE_TILT.name)

    def _cluster(self, number: int) -> Cluster:
        stretch = self._stretches[number]
        rest, velocity = self.rest[stretch.rows], self.balance.velocity[stretch.rows]
        phase = np.where(velocity > SLOW, 0, np.where(velocity < -SLOW, 1, 2))
        labels = [[_feature(name, joint, units.effort) for name in PHASES] for joint, units in self._units]
        sigma = np.broadcast_to(self.sigma, rest.shape).ravel()
        return Cluster(
            name=stretch.name,
            place=(stretch.unit, stretch.name, ""),
            layout=stretch.name,
            unit=stretch.unit,
            contact=False,
            features=tuple(labels[joint][phase[k, joint]] for k in range(len(rest)) for joint in range(rest.shape[1])),
            residuals=(rest.ravel() / sigma)[None, :],
            sigma=sigma,
            pure=np.broadcast_to(self.balance.noise / self.sigma, rest.shape).ravel(),
            discrepancy=np.zeros(rest.size),
            calibrations=self._of_scales(stretch.rows),
        )

    @cached_property
    def _scale_deviations(self) -> Array:
        """Standard deviations of the scale of each joint's torque, with that of a gain in the model, ``(n,)`` [-]."""
        found = np.full(self.physics.arms[ARM].facts.joint_count, TORQUE_SCALE[self.mapping.torque_measured_at])
        for effect in self.model.effects:
            if effect.name == TORQUE_GAIN.name:
                for joint, scalar in enumerate(TORQUE_GAIN.scalars(self.joints)):
                    known = effect.parameters[scalar.name]
                    low, high = known.ci95 or (known.estimate, known.estimate)
                    found[joint] = np.hypot(found[joint], (high - low) / (2.0 * NORMAL_95 * known.estimate))
        return found[self.balance.joints]

    def _of_scales(self, rows: slice) -> Array:
        """Change of the residuals by one standard deviation of the scale of each joint's torque, ``(n, k n)`` [-].

        In a difference of recordings the torque that both have is wrong by as much, and cancels.
        """
        torque = (self.rest if self._minus else self.balance.recorded)[rows] / self.sigma
        each = self._scale_deviations[:, None, None] * torque[None, :, :] * np.eye(self.sigma.size)[:, None, :]
        return np.asarray(each.reshape(self.sigma.size, -1))


def _feature(phase: str, joint: int, unit: str) -> Feature:
    return Feature(phase, SIGNAL, f"joint{joint + 1}", 0, unit, 0.0)


def _physics_of(runs: Sequence[Run]) -> Physics:
    """Nominal physics of the arm; where its end effector is on average is that of all recordings."""
    physics = runs[0].physics
    places = [run.physics.arms[ARM].impact_position for run in runs]
    return replace(physics, arms={ARM: replace(physics.arms[ARM], impact_position=np.mean(places, axis=0))})


def _prepared(
    recordings: Sequence[Run], cut_off: float, short: list[tuple[str, str]]
) -> tuple[list[Run], list[Motion]]:
    """Recordings that are long enough for the filter, and their motions; the others are added to those too short.

    Raises:
        InputError: Sampled too slowly, or none is long enough.
    """
    kept: list[Run] = []
    motions: list[Motion] = []
    for recording in recordings:
        try:
            motions.append(prepare(recording, cut_off))
            kept.append(recording)
        except TooShort as error:
            where = f"from {recording.begin:.3g} s on: " if recording.begin else ""
            short.append((str(recording.path), f"{where}{error.message}"))
    if not kept:
        raise TooShort(short[-1][1], file=recordings[-1].path)
    return kept, motions


def _cut(recordings: Sequence[Run], motions: Sequence[Motion]) -> list[Stretch]:
    """Cut the motions into stretches of one length.

    Raises:
        InputError: Too short for a hold-out.
    """
    lengths = [(motion.time[motion.kept].size, motion.rate) for motion in motions]
    total = sum(size / rate for size, rate in lengths)
    seconds = float(np.clip(total / STRETCHES, SHORTEST, LONGEST))
    found, first = [], 0
    for recording, motion, (size, rate) in zip(recordings, motions, lengths, strict=True):
        parts = max(1, round(size / rate / seconds))
        edges = np.arange(parts + 1) * size // parts
        start = recording.begin + float(motion.time[motion.kept][0])
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            name = f"{recording.path.name}, {start + low / rate:.1f} to {start + high / rate:.1f} s"
            found.append(Stretch(name, str(recording.path), slice(first + int(low), first + int(high))))
        first += size
    if len(found) < LEAST_STRETCHES:
        raise InputError(
            f"{total:.3g} s of usable motion, at least {LEAST_STRETCHES * SHORTEST:g} s are needed for a hold-out",
            file=recordings[0].path,
        )
    return found
