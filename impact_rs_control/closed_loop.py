# SPDX-License-Identifier: Apache-2.0
"""One trial in lockstep, in one process: measure, control, record, step.

The nodes run the same loop with messages in between; a trial through the nodes gives the same numbers.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from impact_rs_control.controller import ArmCommand, Controller
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.plant.plant import Measurement, Plant, PlantExtension, check_hidden
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Array

RUNAWAY = 2.0  # times its speed limit, beyond which a joint is out of control; a normal trial stays below 0.7


class RobotCell(Protocol):
    """Interface of a plant in a closed loop; :class:`~impact_rs_sim.plant.plant.Plant` or another simulator."""

    def measure(self) -> Measurement:
        """Present measurements; the same for every call between two steps."""

    def step(self, desired: dict[str, Array]) -> None:
        """Advance by one control period with desired torques ``(n,)`` [N m] by arm."""

    def close(self) -> None:
        """Release resources."""


@dataclass(frozen=True)
class Tick:
    """One control tick; until the next one ``plant.truth()`` is its true state."""

    number: int
    measurement: Measurement
    commands: dict[str, ArmCommand]


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Switch garbage collection off: messages have no reference cycles, and searching them takes 10 % of a trial."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def make_plant(
    plan: TrialPlan,
    seed: int,
    physics: Physics | None = None,
    extension: PlantExtension | None = None,
    simulator: Simulator = "bullet",
) -> Plant:
    """The plant of a planned trial.

    Args:
        plan: The trial, with the initial joint positions.
        seed: Seed of scatter and noise.
        physics: True physics; None: the scenario's.
        extension: Effects of the plant beyond its physics; of Bullet only.
        simulator: Simulator of its mechanics.

    Raises:
        InputError: As :func:`~impact_rs_sim.plant.plant.check_hidden`, of the true physics.
    """
    scene = plan.scene
    if physics is not None:
        check_hidden(physics)
    return Plant.for_trial(
        scene.scenario,
        scene.physics if physics is None else physics,
        {name: arm.initial for name, arm in plan.arms.items()},
        scene.object,
        seed,
        extension,
        simulator,
    )


def ran_away(plan: TrialPlan, measured: Mapping[str, ArmMeasurement], torques: Mapping[str, Array]) -> bool:
    """Whether the trial must stop: a joint beyond ``RUNAWAY`` times its speed limit, or a value that is not finite.

    Args:
        plan: The trial.
        measured: Measured state by arm.
        torques: Desired torque by arm, ``(n,)`` [N m].
    """
    for name, arm in measured.items():
        # NaN compares false with any bound, and a sum of products with an infinite or NaN term is not finite.
        if not np.max(np.abs(arm.velocity) / plan.scene.models[name].velocity_max) <= RUNAWAY:
            return True
        if not math.isfinite(arm.position @ torques[name] + arm.torque @ arm.torque):
            return True
    return False


def run_closed_loop(plan: TrialPlan, plant: RobotCell) -> Iterator[Tick]:
    """Run a trial tick by tick until the end of the scenario, or until :func:`ran_away`."""
    controller = Controller(plan)
    last = plan.scene.scenario.timing.ticks
    for number in range(last + 1):
        measurement = plant.measure()
        commands = controller.update(number, measurement.arms)
        yield Tick(number, measurement, commands)
        torques = {name: command.torque for name, command in commands.items()}
        if number == last or ran_away(plan, measurement.arms, torques):
            return
        plant.step(torques)
