# SPDX-License-Identifier: Apache-2.0
"""The physics, free of ROS: robot model, effects, plant, impact map and scenario.

The velocities just after an impact::

    from impact_rs_sim import ImpactProblem, compute_impact_map, load_scenario
    from impact_rs_trials import TrialSpec

    scene = TrialSpec.of(load_scenario("push"), "cat_food", "case_2").scene
    result = compute_impact_map(ImpactProblem.at_nominal_impact(scene, "reduced"))
    print("end effector [m/s]:", result.end_effector_twist["arm"][:3])
    for contact in result.contacts:
        print("impulse [N s]:", contact.impulse)

The names below are imported when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rs_sim.lazy_names import lazy_names

if TYPE_CHECKING:
    from impact_rs_sim.effects import Effect as Effect
    from impact_rs_sim.effects import library as library
    from impact_rs_sim.errors import InputError as InputError
    from impact_rs_sim.impact_map import ImpactMapError as ImpactMapError
    from impact_rs_sim.impact_map import ImpactProblem as ImpactProblem
    from impact_rs_sim.impact_map import ImpactResult as ImpactResult
    from impact_rs_sim.impact_map import compute_impact_map as compute_impact_map
    from impact_rs_sim.impact_map import settle as settle
    from impact_rs_sim.model import Model as Model
    from impact_rs_sim.model import ModelEffect as ModelEffect
    from impact_rs_sim.model import ParameterValue as ParameterValue
    from impact_rs_sim.model import load_model as load_model
    from impact_rs_sim.model import save_model as save_model
    from impact_rs_sim.physics import Physics as Physics
    from impact_rs_sim.scenarios.scenario import Scenario as Scenario
    from impact_rs_sim.scenarios.scenario_files import load_scenario as load_scenario
    from impact_rs_sim.scene import Scene as Scene

MODULES = {
    "effects": ("Effect", "library"),
    "errors": ("InputError",),
    "impact_map": ("ImpactMapError", "ImpactProblem", "ImpactResult", "compute_impact_map", "settle"),
    "model": ("Model", "ModelEffect", "ParameterValue", "load_model", "save_model"),
    "physics": ("Physics",),
    "scenarios.scenario": ("Scenario",),
    "scenarios.scenario_files": ("load_scenario",),
    "scene": ("Scene",),
}
__all__ = sorted(name for names in MODULES.values() for name in names)  # noqa: PLE0605
__getattr__ = lazy_names(__name__, MODULES)
