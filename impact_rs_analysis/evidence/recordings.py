# SPDX-License-Identifier: Apache-2.0
"""Recordings of free motion as a source of evidence: clusters are stretches of time, predicted by a torque balance.

Stretches last about a second, longer than the correlation time of the low-passed torque noise. Torques are divided by
the root mean square of the residual of their joint, so that all joints have equal weight; the pure error is the noise
of the recorded torque below the cut-off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Cluster, Feature, Source
from impact_rs_analysis.evidence.torque_balance import ARM, Motion, TorqueBalance, physics_of, prepare
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array, joined_units
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import Recording

STRETCHES = 24  # at least, if they are not shorter than SHORTEST
LONGEST, SHORTEST = 2.0, 0.5  # s
LEAST_STRETCHES = 12
SLOW = 0.05  # rad/s, m/s
SIGNAL = "torque"
PHASES = ("moving up", "moving down", "slow")

REMARKS = (
    "a recording is one condition: stretches of it are held out, so estimates are not tested at other speeds, poses or "
    "temperatures",
    "without repeats there is no pure error: the noise is that of the torque signal, and residuals above it need not "
    "come from an effect of the library",
)
BEHIND_MOTORS = "the torque was measured behind the motors, so their inertia is not in it"


@dataclass(frozen=True)
class RecordingFacts:
    """How recordings were read and filtered.

    Attributes:
        files: Paths of the recordings.
        robot: Robot facts that were used.
        end_effector_mass_kg: Mounted mass by the mapping [kg].
        samples: Samples read.
        recorded_s: Their duration [s].
        used_s: Duration without the edges [s].
        sampled_Hz: Sampling rate [Hz].
        low_pass_Hz: Cut-off of the low-pass [Hz].
        signals: Signals that were found.
    """

    files: tuple[str, ...]
    robot: str
    end_effector_mass_kg: float
    samples: int
    recorded_s: float
    used_s: float
    sampled_Hz: float
    low_pass_Hz: float
    signals: tuple[str, ...]


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

    Attributes:
        balance: Prediction of their torque.
        rest: Recorded minus predicted torque of the model, ``(k, n)`` [N m].
        sigma: Scale of every joint, ``(n,)`` [N m].
        reading: Remarks on how the recordings were read.
    """

    repeated = False
    cheap = True

    def __init__(
        self,
        recordings: Sequence[Recording],
        mapping: Mapping,
        model: Model,
        motions: Sequence[Motion],
        physics: Physics,
        stretches: Sequence[Stretch],
    ) -> None:
        self.recordings, self.mapping, self.model = tuple(recordings), mapping, model
        self.motions, self.physics = tuple(motions), physics
        self.balance = TorqueBalance(list(motions))
        self.rest = self.balance.recorded - self.balance.predict(physics)
        self.sigma = np.maximum(np.sqrt(np.mean(np.square(self.rest), axis=0)), 1e-12)
        self.residual_unit = joined_units(joint.effort for joint in physics.arms[ARM].facts.units)
        self._stretches = tuple(stretches)
        self._predicted: dict[Added, Array | None] = {}
        self.clusters = tuple(self._cluster(number) for number in range(len(self._stretches)))
        behind_motors = physics.arms[ARM].motor_inertia_reduced.max() == 0.0
        remarks = (f"{item.path.name}: {remark}" for item in recordings for remark in item.remarks)
        self.reading = tuple(dict.fromkeys(remarks))
        self.remarks = (*REMARKS, *((BEHIND_MOTORS,) if behind_motors else ()), *self.reading)

    @classmethod
    def of(cls, recordings: Sequence[Recording], mapping: Mapping, model: Model) -> RecordingSource:
        """Filter recordings and predict them.

        Raises:
            InputError: Sampled too slowly, or too short for a hold-out.
        """
        motions = [prepare(recording, mapping.low_pass) for recording in recordings]
        physics = model.apply(physics_of(mapping, motions))
        return cls(recordings, mapping, model, motions, physics, _cut(recordings, motions))

    @property
    def facts(self) -> RecordingFacts:
        """How the recordings were read."""
        return RecordingFacts(
            files=tuple(dict.fromkeys(str(recording.path) for recording in self.recordings)),
            robot=self.mapping.robot,
            end_effector_mass_kg=self.mapping.end_effector.mass,
            samples=int(sum(recording.time.size for recording in self.recordings)),
            recorded_s=float(sum(recording.time[-1] - recording.time[0] for recording in self.recordings)),
            used_s=float(sum(m.time[m.kept].size / m.rate for m in self.motions)),
            sampled_Hz=float(1.0 / np.median(np.diff(self.recordings[0].time))),
            low_pass_Hz=self.motions[0].cut_off,
            signals=tuple(sorted({"position", "velocity", "torque", *self.recordings[0].others})),
        )

    @property
    def stretch_seconds(self) -> float:
        """Mean length of a stretch [s]."""
        return self.facts.used_s / len(self._stretches)

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """See :meth:`Source.predict`."""
        del what
        found: list[Array | None] = []
        for number, added in wanted:
            torque = self._torque(added)
            found.append(None if torque is None else torque[self._stretches[number].rows].ravel())
        return found

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
        if added not in self._predicted:
            physics = self.physics
            known = self.model.known_effects
            try:
                for name, values in added:
                    physics = known[name].apply_vector(physics, np.array(values))
                self._predicted[added] = self.balance.predict(physics)
            except NotABody:
                self._predicted[added] = None
        return self._predicted[added]

    def _cluster(self, number: int) -> Cluster:
        stretch = self._stretches[number]
        rest, velocity = self.rest[stretch.rows], self.balance.velocity[stretch.rows]
        phase = np.where(velocity > SLOW, 0, np.where(velocity < -SLOW, 1, 2))
        units = [joint.effort for joint in self.physics.arms[ARM].facts.units]
        labels = [[_feature(name, joint, unit) for name in PHASES] for joint, unit in enumerate(units)]
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
        )


def _feature(phase: str, joint: int, unit: str) -> Feature:
    return Feature(phase, SIGNAL, f"joint{joint + 1}", 0, unit, 0.0)


def _cut(recordings: Sequence[Recording], motions: Sequence[Motion]) -> list[Stretch]:
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
