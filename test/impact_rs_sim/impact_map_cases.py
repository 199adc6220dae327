# SPDX-License-Identifier: Apache-2.0
"""Problems that the impact-map tests share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map import ImpactProblem, ImpactResult
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene

ENGINES = ("bullet", "exact")
PUSH = load_scenario("push")
GRAB = load_scenario("grab")
LEAN = 0.5  # rad, of the common normal of edges that cross to the pad's
SCENE = Scene.resolve(PUSH, "cat_food", "case_2")
MODEL = SCENE.models["arm"]


def nominal(motor_inertia: str = "reduced", **physics: object) -> ImpactProblem:
    """The push scene at its nominal impact, with some of its physics replaced."""
    problem = ImpactProblem.at_nominal_impact(SCENE, motor_inertia)
    return replace(problem, physics=replace(problem.physics, **physics)) if physics else problem


def grab(motor_inertia: str = "reduced", thing: str = "cat_food", **physics: object) -> ImpactProblem:
    """The grab scene at its nominal impact, with some of its physics replaced."""
    problem = ImpactProblem.at_nominal_impact(Scene.resolve(GRAB, thing, "case_2"), motor_inertia)
    return replace(problem, physics=replace(problem.physics, **physics)) if physics else problem


def one_point(**physics: object) -> ImpactProblem:
    """The object hangs free and meets one corner of the pad: tilted by 2 degrees about two axes."""
    problem = nominal(support_height=None, **physics)
    tilt = pin.rpy.rpyToMatrix(0.035, 0.0, 0.03)
    placement = MODEL.placement(problem.arms["arm"].position)
    half = problem.physics.object.size / 2.0
    pad = placement.rotation @ np.array([[sx * 0.05, sy * 0.05, 0.0] for sx in (-1, 1) for sy in (-1, 1)]).T
    face = -tilt[:, 1]  # points from the object's centre away from the pad
    first = np.max((pad.T + placement.translation) @ face)
    centre = problem.object.position + face * (first + half[1] - problem.object.position @ face)
    return replace(problem, object=BodyState(centre, tilt, np.zeros(6)))


def crossed(gap: float, turned: Sequence[float] = (0.0, 0.0, 0.0), **physics: object) -> ImpactProblem:
    """The object hangs free; one of its edges crosses an edge of the pad at some distance [m].

    They cross at right angles, or ``turned`` about the point where they do, by a rotation vector [rad].
    """
    problem = nominal(support_height=None, **physics)
    end_effector = problem.physics.arms["arm"].end_effector
    pad, half = MODEL.placement(problem.arms["arm"].position) * end_effector.pad_placement, end_effector.pad_size
    along, normal = pad.rotation[:, 0], pad.rotation @ np.array([0.0, np.sin(LEAN), np.cos(LEAN)])
    across = np.cross(normal, along)
    right = np.column_stack(((along - normal) / np.sqrt(2.0), (-along - normal) / np.sqrt(2.0), across))
    rotation = pin.exp3(np.array(turned)) @ right
    size = problem.physics.object.size / 2.0
    meets = pad.act(np.array([0.0, half[1], half[2]]) / 2.0) + gap * normal
    return replace(problem, object=BodyState(meets - rotation[:, :2] @ size[:2], rotation, np.zeros(6)))


def with_velocity(problem: ImpactProblem, velocity: np.ndarray) -> ImpactProblem:
    """``problem`` with another joint velocity of its arm [rad/s]."""
    return replace(problem, arms={"arm": ArmState(problem.arms["arm"].position, velocity)})


def ante_speed(problem: ImpactProblem) -> float:
    """Speed of the end effector before the impact [m/s]."""
    state = problem.arms["arm"]
    model = problem.physics.robot_model("arm")
    return float(np.linalg.norm((model.jacobian(state.position) @ state.velocity)[:3]))


def disagreement(first: ImpactResult, second: ImpactResult) -> float:
    """Largest difference of two answers in a linear velocity of end effector or object [m/s]."""
    return float(
        max(
            np.max(np.abs(first.object_twist[:3] - second.object_twist[:3])),
            *(
                np.max(np.abs(first.end_effector_twist[name][:3] - second.end_effector_twist[name][:3]))
                for name in first.end_effector_twist
            ),
        )
    )
