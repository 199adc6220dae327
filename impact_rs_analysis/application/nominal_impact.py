# SPDX-License-Identifier: Apache-2.0
"""The impact that a scenario plans, as a problem of the impact map."""

from __future__ import annotations

from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene, pad_twists


def planned_impact(
    scenario: Scenario, object_name: str, case: str, model: Model, motor_inertia: str
) -> tuple[Scene, ImpactProblem]:
    """The scene of a planned hit with the effects of a model, and the problem of the impact map there.

    Args:
        scenario: The scenario.
        object_name: Object that is hit.
        case: Case of the scenario.
        model: Effects beyond the scenario's nominal physics.
        motor_inertia: Motor-inertia model.

    Raises:
        InputError: The scenario has no such object or case, or the poses cannot be reached.
    """
    scene = Scene.resolve(scenario, object_name, case)
    scene = scene.under(model.apply(scene.physics))
    return scene, ImpactProblem.at_nominal_impact(scene, motor_inertia)


def velocities_before(scene: Scene) -> dict[str, Array]:
    """Twist of frame E of every pad before the impact, ``(6,)`` [m/s, rad/s], by pad."""
    return pad_twists(scene.physics, scene.models, scene.arms)
