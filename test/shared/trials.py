# SPDX-License-Identifier: Apache-2.0
"""Nominal physics, scenes and plans of the scenarios that come with the package."""

from __future__ import annotations

from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene


def nominal_physics(object_name: str = "juice") -> Physics:
    """Physics of the scenario ``push``."""
    return Physics.nominal(load_scenario("push"), object_name)


def scene_of(scenario: str, object_name: str, case: str) -> Scene:
    return Scene.resolve(load_scenario(scenario), object_name, case)


def plan_of(scenario: str, object_name: str, case: str, velocity_scale: float = 1.0) -> TrialPlan:
    return plan_trial(scene_of(scenario, object_name, case), velocity_scale)
