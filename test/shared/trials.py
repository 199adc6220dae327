# SPDX-License-Identifier: Apache-2.0
"""Nominal physics, scenes and plans of the scenarios that come with the package."""

from __future__ import annotations

from pathlib import Path

from impact_rs_control.closed_loop import Tick, make_plant, run_closed_loop
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.plant import Truth
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags.outcome import Verdict
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.campaign import Trial, TrialReport

BRIEF = {"nominal_impact": 0.2, "approach": 0.15, "window_after": 0.05, "duration": 0.25}  # s, impact included


def nominal_physics(object_name: str = "juice") -> Physics:
    """Physics of the scenario ``push``."""
    return Physics.nominal(load_scenario("push"), object_name)


def scene_of(scenario: str, object_name: str, case: str, **timing: float) -> Scene:
    """A nominal scene; ``timing`` has other times [s] than the scenario."""
    loaded = load_scenario(scenario)
    timed = loaded.model_copy(update={"timing": loaded.timing.model_copy(update=timing)})
    return Scene.resolve(timed, object_name, case)


def plan_of(scenario: str, object_name: str, case: str, velocity_scale: float = 1.0, **timing: float) -> TrialPlan:
    return plan_trial(scene_of(scenario, object_name, case, **timing), velocity_scale)


def ticks_of(plan: TrialPlan, seed: int = 0, physics: Physics | None = None) -> list[tuple[Tick, Truth]]:
    """Every tick of a trial in this process, and what was true in it."""
    plant = make_plant(plan, seed, physics)
    try:
        return [(tick, plant.truth()) for tick in run_closed_loop(plan, plant)]
    finally:
        plant.close()


def made_up(directory: Path, trial: Trial) -> TrialReport:
    """A trial that is no more than a folder of its name."""
    (directory / trial.key.name).mkdir()
    return TrialReport(trial.key, "OK")


def recorded(plan: TrialPlan, path: Path, seed: int = 0, via: str = "inprocess") -> Verdict:
    """How a trial ended whose bag is recorded at a path."""
    scene = plan.scene
    info = TrialInfo.of(plan, TrialKey(scene.object_name, scene.case_name, plan.velocity_scale, 0), seed, via)
    return record_trial(plan, info, path)[0]
