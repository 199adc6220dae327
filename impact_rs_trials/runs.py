# SPDX-License-Identifier: Apache-2.0
"""Runs: signals of arms and object over time, measured or simulated, with their scene.

Every reader returns a :class:`Run`: :meth:`~impact_rs_trials.bags.reader.TrialBag.run` for trials made here,
:func:`~impact_rs_trials.recordings.laboratory_runs.read_laboratory` for runs of another controller,
:func:`~impact_rs_trials.recordings.recording.read_recordings` for free motion without a scene. Simulation returns
:class:`Signals`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from impact_rs_control.closed_loop import Tick
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.sensors import ObjectMeasurement
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import yaw_of_quaternions
from impact_rs_sim.scene import BodyState
from impact_rs_trials.spec import TrialSpec

DriveName = Literal["command", "joint torque"]

NONE = np.zeros(0)  # a signal that was not measured


def none() -> Array:
    """A signal that was not measured."""
    return NONE


@dataclass(frozen=True)
class ArmSignals:
    """Signals of one arm, ``(k, n)`` on the clock of :class:`Signals` unless stated; empty if not measured.

    Attributes:
        position: q [rad].
        velocity: dq [rad/s].
        torque: tau_J [N m].
        motor_position: theta [rad].
        motor_velocity: dtheta [rad/s].
        torque_rate: dtau_J [N m/s].
        command_time: Times of the desired torques, ``(m,)`` [s].
        command: tau_d with gravity, held until the next sample, ``(m, n)`` [N m].
        q_desired: Target of position servos, from whose law ``torque`` was computed [rad].
        dq_desired: Its velocity [rad/s].
        wrench_time: Times of the wrench, ``(w,)`` [s].
        wrench: Force and torque of a sensor at the wrist, ``(w, 6)`` [N, N m].
    """

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array = field(default_factory=none)
    motor_velocity: Array = field(default_factory=none)
    torque_rate: Array = field(default_factory=none)
    command_time: Array = field(default_factory=none)
    command: Array = field(default_factory=none)
    q_desired: Array = field(default_factory=none)
    dq_desired: Array = field(default_factory=none)
    wrench_time: Array = field(default_factory=none)
    wrench: Array = field(default_factory=none)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the signals that were measured, without clocks."""
        return tuple(
            item.name for item in fields(self) if getattr(self, item.name).size and not item.name.endswith("_time")
        )

    @property
    def motor_measured(self) -> bool:
        """Whether motor position and velocity were measured."""
        return bool(self.motor_position.size and self.motor_velocity.size)

    @classmethod
    def stack(cls, arms: Sequence[ArmSignals]) -> ArmSignals:
        """Joint signals of simulations on the same clock along a first axis, ``(B, k, n)``; empty if not simulated."""
        names = [name for name in arms[0].measured if not name.startswith(("command", "wrench"))]
        return cls(**{name: np.stack([getattr(arm, name) for arm in arms]) for name in names})

    @classmethod
    def joined(cls, stacks: Sequence[ArmSignals]) -> ArmSignals:
        """Stacks of simulations on the same clock, ``(B, k, n)`` each, one after the other."""
        return cls(**{name: np.concatenate([getattr(arm, name) for arm in stacks]) for name in stacks[0].measured})

    def at(self, rows: slice | NDArray[np.bool_]) -> ArmSignals:
        """Selected samples, without commands and wrench, which have other timestamps."""
        return ArmSignals(
            **{
                item.name: value[rows] if (value := getattr(self, item.name)).size else value
                for item in fields(self)
                if not item.name.startswith(("command", "wrench"))
            }
        )


@dataclass(frozen=True)
class Poses:
    """Tracked poses of the geometric centre of a body.

    Attributes:
        time: Timestamps, ``(p,)`` [s]; empty: not tracked.
        position: In A, ``(p, 3)``, or ``(B, p, 3)`` of a stack [m].
        quaternion: Orientation in A, x y z w, ``(p, 4)``, or ``(B, p, 4)``.
    """

    time: Array
    position: Array
    quaternion: Array

    @staticmethod
    def of_samples(samples: Sequence[ObjectMeasurement]) -> Poses:
        """From samples of a tracker."""
        return Poses(
            np.array([sample.time for sample in samples]),
            np.array([sample.position for sample in samples]).reshape(-1, 3),
            np.array([sample.quaternion for sample in samples]).reshape(-1, 4),
        )

    @staticmethod
    def stack(simulations: Sequence[Poses]) -> Poses:
        """Simulations on the same clock along a first axis."""
        return Poses(
            simulations[0].time,
            np.stack([poses.position for poses in simulations]),
            np.stack([poses.quaternion for poses in simulations]),
        )

    def at(self, times: Array) -> Poses:
        """Samples at some of its timestamps."""
        rows = np.isin(self.time, times)
        return Poses(self.time[rows], self.position[rows], self.quaternion[rows])

    @property
    def yaw(self) -> Array:
        """Rotation about z of A, without jumps, ``(p,)``, or ``(B, p)`` of a stack [rad]."""
        return yaw_of_quaternions(self.quaternion)


@dataclass(frozen=True)
class Signals:
    """Signals of one run.

    Attributes:
        time: Samples of the joints, ``(k,)`` [s].
        arms: Signals by arm.
        object_time: Timestamps of the tracked object, ``(p,)`` [s]; empty: not tracked.
        object_position: Position of its geometric centre in A, ``(p, 3)`` [m].
        object_quaternion: Its orientation in A, x y z w, ``(p, 4)``.
        neighbours: Poses of the neighbours of the object by name.
    """

    time: Array
    arms: Mapping[str, ArmSignals]
    object_time: Array = field(default_factory=none)
    object_position: Array = field(default_factory=lambda: np.zeros((0, 3)))
    object_quaternion: Array = field(default_factory=lambda: np.zeros((0, 4)))
    neighbours: Mapping[str, Poses] = field(default_factory=dict)

    @classmethod
    def stack(cls, simulations: Sequence[Signals]) -> Signals:
        """Simulations on the same clocks along a first axis: joints ``(B, k, n)``, object ``(B, p, 3 or 4)``."""
        first = simulations[0]
        return cls(
            first.time,
            {name: ArmSignals.stack([signals.arms[name] for signals in simulations]) for name in first.arms},
            first.object_time,
            np.stack([signals.object_position for signals in simulations]),
            np.stack([signals.object_quaternion for signals in simulations]),
            {name: Poses.stack([signals.neighbours[name] for signals in simulations]) for name in first.neighbours},
        )

    @property
    def object(self) -> Poses:
        """Poses of the object."""
        return Poses(self.object_time, self.object_position, self.object_quaternion)

    @property
    def poses(self) -> dict[str, Poses]:
        """Poses of the object, ``object``, and of its neighbours, by name."""
        return {"object": self.object, **self.neighbours}

    @property
    def object_yaw(self) -> Array:
        """Rotation of the object about z of A, without jumps, ``(p,)``, or ``(B, p)`` of a stack [rad]."""
        return self.object.yaw


def signals_of_ticks(ticks: Iterable[Tick]) -> Signals:
    """Signals of a trial that runs in this process.

    Args:
        ticks: Its control ticks, at least one.
    """
    ticks = list(ticks)
    time = np.array([tick.measurement.time for tick in ticks])
    arms = {}
    for name in ticks[0].measurement.arms:
        measured = [tick.measurement.arms[name] for tick in ticks]
        signals = ("position", "velocity", "torque", "motor_position", "motor_velocity")
        arms[name] = ArmSignals(
            **{signal: np.array([getattr(arm, signal) for arm in measured]) for signal in signals},
            command_time=time,
            command=np.array([tick.commands[name].torque for tick in ticks]),
        )
    tracked = Poses.of_samples([tick.measurement.object for tick in ticks if tick.measurement.object is not None])
    neighbour_samples = [tick.measurement.neighbours for tick in ticks if tick.measurement.neighbours]
    neighbours = {
        name: Poses.of_samples([sample[name] for sample in neighbour_samples])
        for name in (neighbour_samples[0] if neighbour_samples else ())
    }
    return Signals(time, arms, tracked.time, tracked.position, tracked.quaternion, neighbours)


@dataclass(frozen=True)
class Run:
    """One run, measured or simulated.

    Attributes:
        path: File or folder of the run.
        name: Name in tables.
        condition: Name of the condition, equal for all repeats.
        condition_key: Scenario, object and case or condition.
        hit: Whether there is an impact.
        physics: Nominal physics of the scene.
        signals: Signals; joint signals on an even grid.
        object: Nominal state of the object before the impact, out of reach in free motion; None without a scenario.
        drive_period: Period of the torque loop [s]; 0 without a scenario.
        axis: Axis of A along which the scenario moves, for figures.
        spec: Plan of a trial made here; None for runs of other controllers.
        begin: Start in its file [s]; frozen sensors cut a file into runs.
        recorded: Time of the recording, seconds since 1970; None: unknown.
        gaps: Begin and end of gaps in the recording [s]; signals there are interpolated.
        remarks: Warnings about reading it.
    """

    path: Path
    name: str
    condition: str
    condition_key: tuple[str, str, str]
    hit: bool
    physics: Physics
    signals: Signals
    object: BodyState | None = None
    drive_period: float = 0.0
    axis: int = 0
    spec: TrialSpec | None = None
    begin: float = 0.0
    recorded: float | None = None
    gaps: tuple[tuple[float, float], ...] = ()
    remarks: tuple[str, ...] = ()

    def within_gap(self, start: float, end: float) -> bool:
        """Whether a gap overlaps the time from ``start`` to ``end`` [s]."""
        return any(start < last and first < end for first, last in self.gaps)

    @property
    def commanded(self) -> bool:
        """Whether the desired torque of every arm is known."""
        return all(arm.command.size for arm in self.signals.arms.values())

    @property
    def drive(self) -> DriveName:
        """Drive of its replay."""
        return "command" if self.commanded else "joint torque"

    @property
    def period(self) -> float:
        """Sampling period of the joints [s]."""
        time = self.signals.time
        return float((time[-1] - time[0]) / (time.size - 1))

    @property
    def motor_measured(self) -> bool:
        """Whether motor positions and velocities of every arm were recorded."""
        return all(arm.motor_measured for arm in self.signals.arms.values())

    def commands_later(self, offsets: Mapping[str, float]) -> Run:
        """The run with the commands of every arm sent later by ``offsets`` [s]."""
        arms = {
            name: replace(arm, command_time=arm.command_time + offsets[name]) for name, arm in self.signals.arms.items()
        }
        return replace(self, signals=replace(self.signals, arms=arms))


def run_of_trial(spec: TrialSpec, signals: Signals, path: Path) -> Run:
    """A trial made here, recorded or simulated.

    Args:
        spec: Plan of the trial.
        signals: Measured or simulated signals, with commands.
        path: Folder of the trial.

    Raises:
        InputError: The scenario, object or case does not exist.
    """
    scene = spec.scene
    return Run(
        path=path,
        name=path.name,
        condition=label_of(spec),
        condition_key=(scene.scenario.name, spec.object, spec.case),
        hit=scene.scenario.excursion is None,
        physics=scene.physics,
        signals=signals,
        object=scene.object,
        drive_period=scene.scenario.timing.drive_period,
        axis=scene.scenario.axis_index,
        spec=spec,
    )


def label_of(spec: TrialSpec) -> str:
    """Short name of a trial for tables: scenario, object, case and, if it is not 1, the velocity scale."""
    text = f"{spec.scenario.name}/{spec.object}/{spec.case}"
    return text if spec.scale == 1.0 else f"{text}/s{spec.scale:.2f}"
