# SPDX-License-Identifier: Apache-2.0
"""Speed limits of a scenario: for its objects and cases, and for other positions of the hit."""

from __future__ import annotations

from dataclasses import dataclass

from impact_rs_analysis.limits.drawn_hits import DEFAULT_DRAWS, Hits
from impact_rs_analysis.limits.hit_bounds import NO_THRESHOLDS, Thresholds
from impact_rs_analysis.limits.speed import SpeedLimit, speed_limit
from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene


def moved(scenario: Scenario, x: float, z: float) -> Scenario:
    """The scenario with its hit at another position: pads, object and support move, the bases of the arms stay.

    Args:
        scenario: The scenario.
        x: Along the x axis of the inertial frame [m].
        z: Upwards [m].

    Raises:
        InputError: The impact pose of an arm is given by joint positions.
    """
    robots = {}
    for name, robot in scenario.robots.items():
        if robot.impact.position is None:
            raise InputError(
                "this arm hits where joint_position puts it, which cannot be moved; expected position, pad_normal, "
                "pad_up and joint_guess",
                key=f"robots.{name}.impact",
            )
        nominal = robot.impact.position
        position = (nominal[0] + x, nominal[1], nominal[2] + z)
        robots[name] = robot.model_copy(update={"impact": robot.impact.model_copy(update={"position": position})})
    update: dict[str, object] = {
        "robots": robots,
        "support": scenario.support.model_copy(update={"height": scenario.support.height + z}),
    }
    if scenario.object_position is not None:
        update["object_position"] = (scenario.object_position[0] + x, scenario.object_position[1])
    return scenario.model_copy(update=update)


@dataclass(frozen=True)
class LimitTask:
    """Search for one speed limit.

    Attributes:
        scenario: The scenario.
        object_name: Object.
        case_name: Case.
        x: How far the hit is moved along x [m].
        z: How far it is moved upwards [m].
        thresholds: Used instead of the limits of the robot facts.
        draws: Draws of the uncertain parameters.
    """

    scenario: Scenario
    object_name: str
    case_name: str
    x: float = 0.0
    z: float = 0.0
    thresholds: Thresholds = NO_THRESHOLDS
    draws: int = DEFAULT_DRAWS


@dataclass(frozen=True)
class PlacedLimit:
    """A speed limit and the position of its hit.

    Attributes:
        x: How far the hit is moved along x [m].
        z: How far it is moved upwards [m].
        limit: The limit; None if the arm cannot hit there.
        reason: Why there is no limit; empty if there is one.
    """

    x: float
    z: float
    limit: SpeedLimit | None
    reason: str = ""


def limit_of(task: LimitTask) -> PlacedLimit:
    """The speed limit of a task; without a limit for an unreachable position."""
    scenario = moved(task.scenario, task.x, task.z) if task.x or task.z else task.scenario
    try:
        scene = Scene.resolve(scenario, task.object_name, task.case_name)
        hits = Hits(scene, task.thresholds, draws=task.draws)
        return PlacedLimit(task.x, task.z, speed_limit(hits))
    except Infeasible as error:
        if not (task.x or task.z):
            raise
        return PlacedLimit(task.x, task.z, None, str(error))
