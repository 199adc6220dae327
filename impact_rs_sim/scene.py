# SPDX-License-Identifier: Apache-2.0
"""One object and case of a scenario: impact configuration of every arm and nominal pose of the object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_sim.errors import Infeasible, InputError, UnreachablePose
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario

SINGULAR_VALUE_TOLERANCE = 1e-9  # over the largest singular value of a Jacobian [-]; smaller ones are rounding
MIN_HORIZONTAL_COSINE = 0.95  # between pad normal and horizontal; a steeper pad meets no side face


@dataclass(frozen=True)
class ArmState:
    """State of one arm: of a floating base, if any, and of the joints (:mod:`impact_rs_sim.robots.robot`).

    Attributes:
        position: q, ``(n,)`` [rad]; with a floating base ``(7 + n,)``, beginning with its position and quaternion.
        velocity: dq, ``(n,)`` [rad/s]; with a floating base v, ``(6 + n,)``, beginning with its twist in its own axes.
    """

    position: Array
    velocity: Array


@dataclass(frozen=True)
class ArmMotion:
    """Motion of the joints and motors of one arm: at one time, ``(n,)``, or along a path, ``(k, n)``.

    Attributes:
        position: q [rad].
        velocity: dq [rad/s].
        torque: tau_J [N m].
        motor_position: theta [rad].
        motor_velocity: dtheta [rad/s].
    """

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array
    motor_velocity: Array


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


def standing(physics: Physics, object_: BodyState) -> tuple[BodyState, ...]:
    """States of the neighbours (:attr:`Physics.neighbours`) at rest, for the object in any pose."""
    return tuple(
        BodyState(object_.position + object_.rotation @ body.position, object_.rotation @ body.rotation, np.zeros(6))
        for body in physics.neighbours
    )


def pad_placements(
    physics: Physics, models: Mapping[str, RobotModel], arms: Mapping[str, ArmState]
) -> dict[str, pin.SE3]:
    """Frames E of all pads in A by name of the pad; ``models`` are the rigid-body models by arm."""
    return {name: models[pad.arm].placement(arms[pad.arm].position, pad.hand) for name, pad in physics.pads.items()}


def pad_twists(physics: Physics, models: Mapping[str, RobotModel], arms: Mapping[str, ArmState]) -> dict[str, Array]:
    """Twists of frames E of all pads in E[A] by name of the pad, ``(6,)`` [m/s, rad/s]; ``models`` by arm."""
    return {
        name: models[pad.arm].jacobian(arms[pad.arm].position, pad.hand) @ arms[pad.arm].velocity
        for name, pad in physics.pads.items()
    }


@dataclass(frozen=True)
class Scene:
    """One object and case of a scenario, at the nominal impact.

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

    def under(self, physics: Physics) -> Scene:
        """The scene with other physics, for example of a model, in the same state."""
        return replace(self, physics=physics, models=physics.robot_models())

    @staticmethod
    def resolve(scenario: Scenario, object_name: str, case_name: str) -> Scene:
        """Solve the inverse kinematics of the impact pose, unless joints are given, and place the object.

        Raises:
            InputError: No such object or case, or no object can stand at a pad with given joints.
            Infeasible: The pose cannot be reached, or a joint exceeds its limit.
        """
        physics = Physics.nominal(scenario, object_name)
        case_name = scenario.case_name(case_name)
        case = scenario.cases[case_name]
        models, arms = {}, {}
        for name, robot in scenario.robots.items():
            motion = case.robots[name]
            model = physics.robot_model(name)
            linear = {
                "": np.array(motion.ante_velocity),
                **{hand: np.array(velocity) for hand, velocity in motion.hands.items()},
            }
            try:
                if robot.impact.joint_position is not None:
                    q = model.position_of(_within_limits(model, np.array(robot.impact.joint_position)))
                    dq = _velocity_of_given_joints(model, q, linear)
                else:
                    placement = scenario.impact_placement(name, object_name)
                    guess = np.array(robot.impact.joint_guess)
                    hands = {hand: scenario.impact_placement(name, object_name, hand) for hand in robot.hands}
                    q = model.inverse_kinematics(placement, motion.posture_joints, guess, hands=hands)
                    dq = _impact_velocity(model, q, linear, motion.joint_1_velocity)
            except UnreachablePose as error:
                raise UnreachablePose(
                    f"cases.{case_name}, robots.{name}.impact of scenario {scenario.name!r}: {error}"
                ) from None
            if np.any(np.abs(dq) > model.velocity_max):
                joints, limits = (values[model.facts.base_size :] for values in (dq, model.velocity_max))
                joint = int(np.argmax(np.abs(joints) / limits))
                unit = model.facts.units[joint].velocity
                raise Infeasible(
                    f"cases.{case_name}: arm {name!r} needs {joints[joint]:.3g} {unit} in joint {joint + 1}, "
                    f"its limit is {limits[joint]:.3g} {unit}"
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


def _impact_velocity(model: RobotModel, q: Array, linear: Mapping[str, Array], joint_1: float | None) -> Array:
    """Least-norm joint velocity for the desired velocities of the pads, without rotation, and of joint 1 if given.

    Raises:
        UnreachablePose: No solution: too few joints, or a singular pose.
    """
    tasks = np.vstack([model.jacobian(q, hand) for hand in linear])
    target = np.concatenate([np.append(velocity, np.zeros(3)) for velocity in linear.values()])
    if joint_1 is not None:
        tasks, target = np.vstack((tasks, np.eye(model.joint_count)[:1])), np.append(target, joint_1)
    dq = np.linalg.pinv(tasks) @ target
    error = float(np.abs(tasks @ dq - target).max())
    if error > 1e-6 * max(1.0, float(np.abs(target).max())):
        raise UnreachablePose(
            f"ante_velocity {_velocities_in_words(linear)} m/s without rotation is beyond these joints: the nearest "
            f"velocity is off by {error:.3g} (m/s or rad/s)"
        )
    return np.asarray(dq)


def _within_limits(model: RobotModel, joints: Array) -> Array:
    """Check ``joints`` ``(n,)`` [rad], and return them.

    Raises:
        UnreachablePose: A joint is beyond its limits.
    """
    limits = model.facts.limits
    ranges = zip(joints, limits.position_min_rad, limits.position_max_rad, strict=True)
    for joint, (position, low, high) in enumerate(ranges):
        if not low <= position <= high:
            unit = model.facts.units[joint].position
            raise UnreachablePose(
                f"joint {joint + 1} at {position:.4g} {unit} is outside its limits [{low:.4g}, {high:.4g}] {unit}"
            )
    return joints


def _velocity_of_given_joints(model: RobotModel, q: Array, linear: Mapping[str, Array]) -> Array:
    """Least-norm joint velocity for the desired velocities of the pads with their least rotation, ``(nv,)``.

    With a floating base and one pad, the base has the desired velocity (in its own axes) and the joints rest. With a
    floating base and several hands, the base rests and the joints move.

    Raises:
        UnreachablePose: No joint velocity gives the desired velocities.
    """
    base = model.facts.base_size
    if base and len(linear) == 1:
        return np.concatenate((model.base.rotation.T @ linear[""], np.zeros(model.joint_count - 3)))
    jacobians, target = [model.jacobian(q, hand)[:, base:] for hand in linear], np.concatenate(list(linear.values()))
    moving, turning = (np.vstack([jacobian[rows] for jacobian in jacobians]) for rows in (slice(0, 3), slice(3, 6)))
    dq = np.linalg.pinv(moving, rcond=SINGULAR_VALUE_TOLERANCE) @ target
    error = float(np.abs(moving @ dq - target).max())
    if error > 1e-6 * max(1.0, float(np.abs(target).max())):
        raise UnreachablePose(
            f"ante_velocity {_velocities_in_words(linear)} m/s is beyond these joints there: the nearest is off by "
            f"{error:.3g} m/s"
        )
    null_space = scipy.linalg.null_space(moving, rcond=SINGULAR_VALUE_TOLERANCE)
    correction = np.linalg.pinv(turning @ null_space, rcond=SINGULAR_VALUE_TOLERANCE) @ (turning @ dq)
    return np.concatenate((np.zeros(base), dq - null_space @ correction))


def _velocities_in_words(linear: Mapping[str, Array]) -> str:
    """Velocities of the pads as text, with the names of the hands."""
    return " and ".join(f"{f'of {hand} ' if hand else ''}{velocity.tolist()}" for hand, velocity in linear.items())


def resting_pose(scenario: Scenario, object_name: str) -> BodyState:
    """Rest pose of an object on the support: at ``object_position``, or with a face in the plane of the only pad.

    Raises:
        InputError: The scenario has no such object.
    """
    spec = scenario.object(object_name)
    height = scenario.support.height + spec.reach(np.array([0.0, 0.0, -1.0]))
    if scenario.object_position is not None:
        return BodyState(np.append(scenario.object_position, height), spec.rotation, np.zeros(6))
    name, robot = next(iter(scenario.robots.items()))
    pad = robot.impact_placement
    if robot.impact.joint_position is not None:
        if not spec.form.is_box or any(spec.rpy):
            raise InputError(
                f"object {object_name!r} is a {spec.shape}, or turned; at a pad that given joints hold only a level "
                "box can be placed: give impact.position, pad_normal, pad_up and joint_guess",
                key=f"robots.{name}.impact.joint_position",
            )
        return _square_to_given_pad(scenario, name, pad, np.array(spec.size), height)
    normal = pad.rotation[:, 2]
    position = pad.translation + normal * (spec.reach(-normal) + scenario.object_gap)
    position[2] = height
    return BodyState(position, spec.rotation, np.zeros(6))


def _square_to_given_pad(scenario: Scenario, name: str, pad: pin.SE3, size: Array, height: float) -> BodyState:
    """Object on its support with the nearest face parallel to a pad whose pose follows from given joints.

    A slightly tilted pad touches with an edge: the object is placed at first contact of pad and face.

    Raises:
        InputError: The pad points up or down, or past the object.
    """
    key = f"robots.{name}.impact.joint_position"
    normal, extent = pad.rotation[:, 2], np.array(scenario.robots[name].end_effector.pad.size)
    level = np.append(normal[:2], 0.0)
    if (share := float(np.linalg.norm(level))) < MIN_HORIZONTAL_COSINE:
        direction = "up" if normal[2] > 0.0 else "down"
        raise InputError(
            f"the pad looks {direction} there, by {np.degrees(np.arccos(share)):.0f} degrees; objects are hit from the "
            f"side, expected at most {np.degrees(np.arccos(MIN_HORIZONTAL_COSINE)):.0f}",
            key=key,
        )
    level /= share
    yaw = float(np.arctan2(level[1], level[0]))
    rotation = pin.rpy.rpyToMatrix(0.0, 0.0, yaw - np.pi / 2.0 * round(yaw / (np.pi / 2.0)))
    reach = float(np.abs(pad.rotation[2, :2]) @ extent[:2]) / 2.0
    if abs(height - pad.translation[2]) >= size[2] / 2.0 + reach:
        low, high = height - size[2] / 2.0, height + size[2] / 2.0
        raise InputError(
            f"the pad is at z = {pad.translation[2]:.3g} m there, the object stands from {low:.3g} to {high:.3g} m; "
            "expected another support.height",
            key=key,
        )
    plane = float(np.abs(normal @ rotation) @ size) / 2.0 - (height - pad.translation[2]) * float(normal[2])
    face = float(np.abs(level @ rotation) @ size + np.abs(level @ pad.rotation[:, :2]) @ extent[:2]) / 2.0
    position = pad.translation + level * (min(plane / share, face) + scenario.object_gap)
    position[2] = height
    return BodyState(position, rotation, np.zeros(6))
