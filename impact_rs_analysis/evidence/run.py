# SPDX-License-Identifier: Apache-2.0
"""One measured run of any origin, with its scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from impact_rs_analysis.evidence.signals import Signals, signals_of_bag
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import BodyState
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.spec import TrialSpec

DriveName = Literal["command", "joint torque"]


@dataclass(frozen=True)
class Run:
    """One measured run.

    Attributes:
        path: Where it was read from.
        condition: Short name of the condition, the same for repeats.
        place: Scenario, object and case or condition.
        hit: Whether there is an impact.
        physics: Nominal physics of the scene.
        object: Nominal state of the object before the impact; out of reach in free motion.
        drive_period: Period of the torque loop [s].
        axis: Axis of A along which the scenario moves, for figures.
        signals: Measured signals, on an even grid.
        command_time: Times at which desired torques were sent, by arm, ``(m,)`` [s]; empty if not known.
        command: The desired torques, by arm, ``(m, n)`` [N m].
        spec: Plan of a native trial; None for a laboratory's run.
        gaps: Begin and end of gaps in the recording [s]; signals there are interpolated.
    """

    path: Path
    condition: str
    place: tuple[str, str, str]
    hit: bool
    physics: Physics
    object: BodyState
    drive_period: float
    axis: int
    signals: Signals
    command_time: dict[str, Array]
    command: dict[str, Array]
    spec: TrialSpec | None = None
    gaps: tuple[tuple[float, float], ...] = ()

    def within_gap(self, start: float, end: float) -> bool:
        """Whether a gap overlaps the time from ``start`` to ``end`` [s]."""
        return any(start < last and first < end for first, last in self.gaps)

    @property
    def drive(self) -> DriveName:
        """Drive of its replay."""
        return "command" if self.command else "joint torque"

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        time = self.signals.time
        return float((time[-1] - time[0]) / (time.size - 1))

    @property
    def motor_measured(self) -> bool:
        """Whether motor positions and velocities were recorded."""
        return all(arm.motor_position.size and arm.motor_velocity.size for arm in self.signals.arms.values())


def run_of_trial(bag: TrialBag) -> Run:
    """A recorded native trial.

    Raises:
        BagError: A topic is missing, damaged, has NaN, gaps or stamps that run backwards.
        InputError: The scenario in it cannot be read.
    """
    return run_of_signals(bag.info.spec, signals_of_bag(bag), bag.path)


def run_of_signals(spec: TrialSpec, signals: Signals, path: Path) -> Run:
    """A native trial, recorded or simulated.

    Args:
        spec: Plan of the trial.
        signals: Measured or simulated, with commands.
        path: Where it was read from.

    Raises:
        InputError: There is no such scenario, object or case.
    """
    scene = spec.scene
    return Run(
        path=path,
        condition=label_of(spec),
        place=(scene.scenario.name, spec.object, spec.case),
        hit=scene.scenario.excursion is None,
        physics=scene.physics,
        object=scene.object,
        drive_period=scene.scenario.timing.drive_period,
        axis=scene.scenario.axis_index,
        signals=signals,
        command_time=dict.fromkeys(signals.arms, signals.time),
        command={name: arm.command for name, arm in signals.arms.items()},
        spec=spec,
    )


def label_of(spec: TrialSpec) -> str:
    """Short name of a trial for tables: scenario, object, case and, if it is not 1, the velocity scale."""
    text = f"{spec.scenario.name}/{spec.object}/{spec.case}"
    return text if spec.scale == 1.0 else f"{text}/s{spec.scale:.2f}"
