# SPDX-License-Identifier: Apache-2.0
"""Closed-loop simulation of a trial that was not measured, by controller and twin, without noise and scatter.

Used to propose experiments (:mod:`impact_rs_analysis.design`); measured trials are replayed instead.
"""

from __future__ import annotations

from pathlib import Path

from impact_rs_analysis.evidence.replays.replay import WINDOW_AFTER_IMPACT_S
from impact_rs_control.closed_loop import RobotCell, run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.bags.outcome import TickLog, Verdict, judge
from impact_rs_trials.runs import Run, run_of_trial, signals_of_ticks
from impact_rs_trials.spec import TrialSpec

LATE_IMPACT_MARGIN_S = 0.1  # s after the last window, for a late impact


def quiet(scenario: Scenario) -> Scenario:
    """The scenario with ideal sensors and no scatter."""
    sensors = {name: 0.0 for name in type(scenario.sensors).model_fields if name != "object_period"}
    scatter = dict.fromkeys(type(scenario.scatter).model_fields, 0.0)
    return scenario.model_copy(
        update={
            "sensors": scenario.sensors.model_copy(update=sensors),
            "scatter": scenario.scatter.model_copy(update=scatter),
        }
    )


def observed_until(plan: TrialPlan) -> float:
    """End of the last window of a trial [s], where its simulation may stop."""
    scenario = plan.scene.scenario
    if scenario.excursion is None:
        return scenario.timing.nominal_impact + WINDOW_AFTER_IMPACT_S + LATE_IMPACT_MARGIN_S
    case = scenario.cases[plan.scene.case_name]
    return max(scenario.excursion_end(robot) for robot in case.robots.values()) + LATE_IMPACT_MARGIN_S


def simulated(spec: TrialSpec, physics: Physics, simulator: Simulator = "twin") -> Run:
    """A simulated trial without noise and scatter, as :func:`simulated_and_judged`."""
    return simulated_and_judged(spec, physics, simulator)[0]


def simulated_and_judged(
    spec: TrialSpec, physics: Physics, simulator: Simulator = "twin", seed: int | None = None
) -> tuple[Run, Verdict]:
    """A simulated trial, and whether it stays within the limits of joints and torques.

    Args:
        spec: Plan of the trial.
        physics: Physics of the model.
        simulator: Physics simulator of arms and object.
        seed: Seed of noise and scatter; None: there are none.

    Raises:
        InputError: There is no such trial, or the physics is not valid.
    """
    plan = spec.plan
    scene = plan.scene
    initial = {name: arm.initial for name, arm in plan.arms.items()}
    scenario = quiet(scene.scenario) if seed is None else scene.scenario
    plant = Plant.for_trial(scenario, physics, initial, scene.object, seed=seed or 0, simulator=simulator)
    log = TickLog(plan)
    return observed(spec, plant, log), judge(plan, log.record())


def observed(spec: TrialSpec, plant: RobotCell, log: TickLog | None = None) -> Run:
    """A trial on a plant up to the end of its last window; closes the plant.

    Args:
        spec: The trial.
        plant: Where it runs.
        log: Takes down every tick.
    """
    plan = spec.plan
    ticks, until = [], observed_until(plan)
    try:
        with without_garbage_collection():
            for tick in run_closed_loop(plan, plant):
                ticks.append(tick)
                if log is not None:
                    log.append(tick)
                if tick.measurement.time >= until:
                    break
    finally:
        plant.close()
    return run_of_trial(spec, signals_of_ticks(ticks), Path("simulated"))
