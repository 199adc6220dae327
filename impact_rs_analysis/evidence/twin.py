"""The model twin: the same trial in closed loop, with the physics we believe in, without noise and scatter.

It starts where the measurement started (measured joint positions, measured pose of the object), because that is known
and need not be explained; what differs afterwards is the model's fault or the measurement's noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.signals import SignalCollector, Signals
from impact_rs_control.closed_loop import run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant import Plant
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import Scenario
from impact_rs_sim.scene import BodyState

MARGIN = 0.02  # s
START_SAMPLES = 10  # of the object tracker, averaged for its initial pose


@dataclass(frozen=True)
class Start:
    """Where a trial started.

    Attributes:
        joints: Joint positions by arm, ``(n,)`` [rad].
        object_position: Position of the object's geometric centre, ``(3,)`` [m].
        object_yaw: Its rotation about z [rad].
    """

    joints: dict[str, Array]
    object_position: Array
    object_yaw: float

    @property
    def identity(self) -> str:
        """All of it, to the last bit."""
        numbers = (*self.joints.values(), self.object_position, np.array(self.object_yaw))
        return ",".join(self.joints) + b"".join(array.tobytes() for array in numbers).hex()

    @staticmethod
    def nominal(plan: TrialPlan) -> Start:
        """Where the plan says it starts."""
        joints = {name: arm.initial for name, arm in plan.arms.items()}
        return Start(joints, plan.scene.object.position, 0.0)

    @staticmethod
    def measured(signals: Signals, plan: TrialPlan) -> Start:
        """Where a measured trial started; what the tracker cannot see from above stays nominal."""
        position = plan.scene.object.position.copy()
        yaw = 0.0
        if signals.object_time.size:
            position[:2] = signals.object_position[:START_SAMPLES, :2].mean(axis=0)
            yaw = float(signals.object_yaw[:START_SAMPLES].mean())
        return Start({name: arm.position[0] for name, arm in signals.arms.items()}, position, yaw)


def quiet(scenario: Scenario) -> Scenario:
    """The scenario with ideal sensors and no scatter."""
    sensors = {name: 0.0 for name in type(scenario.sensors).model_fields if name != "object_period"}
    scatter = {name: 0.0 for name in type(scenario.scatter).model_fields}
    return scenario.model_copy(
        update={
            "sensors": scenario.sensors.model_copy(update=sensors),
            "scatter": scenario.scatter.model_copy(update=scatter),
        }
    )


def observed_until(plan: TrialPlan) -> float:
    """When the last feature of a trial is taken [s]; a twin need not run longer."""
    scenario = plan.scene.scenario
    if scenario.excursion is None:
        return scenario.timing.window[1]
    case = scenario.cases[plan.scene.case_name]
    return max(scenario.excursion_end(robot) for robot in case.robots.values())


def run_twin(plan: TrialPlan, physics: Physics, start: Start, until: float | None = None) -> Signals:
    """Run the trial with believed physics.

    Args:
        plan: References and controller, the same as in the measurement.
        physics: What we believe.
        start: Where the trial started.
        until: When to stop [s]; None: at the end of the trial.
    """
    state = BodyState(start.object_position, pin.rpy.rpyToMatrix(0.0, 0.0, start.object_yaw), np.zeros(6))
    scene = replace(plan.scene, scenario=quiet(plan.scene.scenario), object=state)
    plant = Plant.for_trial(scene.scenario, physics, start.joints, state, seed=0)
    collector = SignalCollector(plan)
    try:
        with without_garbage_collection():
            for tick in run_closed_loop(plan, plant):
                collector.add(tick.number, tick.measurement, tick.commands)
                if until is not None and tick.measurement.time >= until + MARGIN:
                    break
    finally:
        plant.close()
    return collector.signals()
