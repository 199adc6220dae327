"""Scenario x object x case, resolved: impact configuration of every arm and nominal pose of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.errors import Infeasible, UnreachablePose
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import Scenario


@dataclass(frozen=True)
class ArmState:
    """Joint state of one arm.

    Attributes:
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """

    position: Array
    velocity: Array


@dataclass(frozen=True)
class BodyState:
    """State of a free rigid body, at its geometric centre O.

    Attributes:
        position: O in A, ``(3,)`` [m].
        rotation: Axes of the body in A, ``(3, 3)``.
        twist: Velocity of O, then angular velocity, in axes of A, ``(6,)`` [m/s, rad/s].
    """

    position: Array
    rotation: Array
    twist: Array

    def point_velocity(self, point: Array) -> Array:
        """Velocity of the body's material point at ``point`` (in A), ``(3,)`` [m/s]."""
        return np.asarray(self.twist[:3] + np.cross(self.twist[3:], point - self.position))


@dataclass(frozen=True)
class Scene:
    """One object and case of a scenario, at the nominal moment of impact.

    Attributes:
        scenario: The scenario.
        object_name: Name of the object.
        case_name: Full name of the case.
        physics: Nominal physics.
        models: Rigid-body models by arm.
        arms: Ante-impact state by arm: impact configuration and velocity.
        object: Nominal state of the object: at rest on its support, its face in the plane of the pad.
    """

    scenario: Scenario
    object_name: str
    case_name: str
    physics: Physics
    models: dict[str, RobotModel]
    arms: dict[str, ArmState]
    object: BodyState

    @staticmethod
    def resolve(scenario: Scenario, object_name: str, case_name: str) -> Scene:
        """Solve the inverse kinematics of the impact pose and place the object.

        Raises:
            InputError: No such object or case.
            Infeasible: The pose cannot be reached, or a joint velocity is beyond its limit.
        """
        physics = Physics.nominal(scenario, object_name)
        case_name = scenario.case_name(case_name)
        case = scenario.cases[case_name]
        models, arms = {}, {}
        for name, robot in scenario.robots.items():
            wanted = case.robots[name]
            model = physics.robot_model(name)
            placement = scenario.impact_placement(name, object_name)
            try:
                q = model.inverse_kinematics(placement, wanted.held, np.array(robot.impact.joint_guess))
                dq = _impact_velocity(model, q, np.array(wanted.ante_velocity), wanted.joint_1_velocity)
            except UnreachablePose as error:
                raise UnreachablePose(
                    f"cases.{case_name}, robots.{name}.impact of scenario {scenario.name!r}: {error}"
                ) from None
            if np.any(np.abs(dq) > model.velocity_max):
                joint = int(np.argmax(np.abs(dq) / model.velocity_max))
                unit = model.facts.units[joint].velocity
                raise Infeasible(
                    f"cases.{case_name}: arm {name!r} needs {dq[joint]:.3g} {unit} in joint {joint + 1}, "
                    f"its limit is {model.velocity_max[joint]:.3g} {unit}"
                )
            models[name] = model
            arms[name] = ArmState(q, dq)
        return Scene(
            scenario=scenario,
            object_name=object_name,
            case_name=case_name,
            physics=physics,
            models=models,
            arms=arms,
            object=resting_pose(scenario, object_name),
        )


def _impact_velocity(model: RobotModel, q: Array, linear: Array, joint_1: float | None) -> Array:
    """The least joint velocity with the wanted end-effector velocity, no rotation, and joint 1 as asked.

    Raises:
        UnreachablePose: There is none: too few joints, or a singular pose.
    """
    tasks, wanted = model.jacobian(q), np.concatenate((linear, np.zeros(3)))
    if joint_1 is not None:
        tasks, wanted = np.vstack((tasks, np.eye(model.joint_count)[:1])), np.append(wanted, joint_1)
    dq = np.linalg.pinv(tasks) @ wanted
    missed = float(np.abs(tasks @ dq - wanted).max())
    if missed > 1e-6 * max(1.0, float(np.abs(wanted).max())):
        raise UnreachablePose(
            f"ante_velocity {linear.tolist()} m/s without rotation is beyond these joints: the nearest velocity is off "
            f"by {missed:.3g} (m/s or rad/s)"
        )
    return np.asarray(dq)


def resting_pose(scenario: Scenario, object_name: str) -> BodyState:
    """Where an object rests on the support: as the scenario says, or with a face in the plane of the only pad.

    Raises:
        InputError: The scenario has no such object.
    """
    size = np.array(scenario.object(object_name).size)
    height = scenario.support.height + size[2] / 2.0
    if scenario.object_position is not None:
        return BodyState(np.append(scenario.object_position, height), np.eye(3), np.zeros(6))
    impact = next(iter(scenario.robots.values())).impact
    normal = np.array(impact.pad_normal)
    position = np.array(impact.position) + normal * ((np.abs(normal) @ size) / 2.0 + scenario.object_gap)
    position[2] = height
    return BodyState(position, np.eye(3), np.zeros(6))
