# SPDX-License-Identifier: Apache-2.0
"""Random impact problems with a solution, for tests and comparisons of engines."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map.problem import ImpactProblem, check_problem
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState

logger = logging.getLogger(__name__)

_ATTEMPTS = 100  # most samples fail at the reach of the arm or at a joint velocity limit; one in two passes


def random_problem(
    scenario: Scenario, rng: np.random.Generator, restitution: float | None = None, misalignment: float = 0.004
) -> ImpactProblem:
    """One arm that hits a box on a support somewhere around the scenario's impact pose, in some direction.

    Args:
        scenario: Scenario with one arm.
        rng: Source of randomness.
        restitution: Newton restitution [-]; absent: 0 in half of all problems, else up to 0.8.
        misalignment: Standard deviation of the angle between pad and face about two axes [rad].

    Raises:
        Infeasible: No feasible problem was found: the scenario's impact pose is at the edge of the arm's reach.
    """
    for _ in range(_ATTEMPTS):
        try:
            problem = _sample(scenario, rng, restitution, misalignment)
            check_problem(problem)
        except Infeasible as error:
            logger.debug("sample rejected: %s", error)
            continue
        return problem
    raise Infeasible(f"scenario {scenario.name!r}: no feasible problem in {_ATTEMPTS} samples")


def _sample(
    scenario: Scenario, rng: np.random.Generator, restitution: float | None, misalignment: float
) -> ImpactProblem:
    physics = Physics.nominal(scenario, str(rng.choice(list(scenario.objects))))
    name, robot = next(iter(scenario.robots.items()))
    model = physics.robot_model(name)
    yaw = rng.uniform(-0.5, 0.5)
    turn = pin.utils.rotate("z", yaw)
    target = pin.SE3(
        turn @ robot.impact.placement.rotation, robot.impact.placement.translation + rng.uniform(-0.08, 0.08, 3)
    )
    shift = rng.uniform(-0.4, 0.4)
    held = next(iter(scenario.cases.values())).robots[name].posture_joints
    guess = np.array(robot.impact.joint_guess)
    q = model.inverse_kinematics(target, {joint: float(guess[joint]) + shift for joint in held}, guess)
    normal = target.rotation[:, 2]
    speed = rng.uniform(0.2, 1.0)
    twist = np.concatenate((speed * (normal + rng.uniform(-0.3, 0.3, 3)), rng.uniform(-0.3, 0.3, 3)))
    velocity = np.linalg.pinv(model.jacobian(q)) @ twist + 0.2 * rng.standard_normal() * _self_motion(model.jacobian(q))
    size = np.array(physics.object.size) * rng.uniform(0.8, 1.2, 3)
    mass = rng.uniform(0.3, 3.0)
    inertia = mass / 12.0 * (np.sum(size**2) - size**2)
    offset = rng.uniform(-0.1, 0.1, 3) * size
    rotation = turn @ pin.utils.rotate("z", misalignment * rng.standard_normal())
    # The face that the pad hits touches the pad's most advanced corner.
    lateral = rng.uniform(-0.03, 0.03, 2)
    along = rotation @ np.array([lateral[0], 0.0, lateral[1]])
    axis = int(np.argmax(np.abs(rotation.T @ normal)))
    face = np.sign(rotation[:, axis] @ normal) * rotation[:, axis]
    corners = target.translation + [
        target.rotation[:, :2] @ (np.array(signs) * robot.end_effector.pad.size[:2] / 2.0)
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    reach = float(np.max(corners @ face))
    centre = target.translation + along
    centre = centre + face * (reach + size[axis] / 2.0 - centre @ face)
    physics = replace(
        physics,
        object=ObjectPhysics(mass, size, inertia, offset),
        support_height=float(centre[2] - size[2] / 2.0),
        support_friction=rng.uniform(0.0, 0.8),
        pad_friction=rng.uniform(0.0, 1.0),
    )
    rotor = physics.arms[name].motor_inertia_rotor
    motors = (0.0 * rotor, physics.arms[name].motor_inertia_reduced, rotor, rng.uniform(0.0, 0.8, rotor.size))
    if restitution is None:
        restitution = float(rng.choice([0.0, rng.uniform(0.0, 0.8)]))
    return ImpactProblem(
        physics=physics,
        arms={name: ArmState(q, velocity)},
        object=BodyState(centre, rotation, np.zeros(6)),
        motor_inertia={name: motors[rng.integers(4)]},
        restitution=restitution,
    )


def _self_motion(jacobian: Array) -> Array:
    """Joint velocity that leaves the end effector at rest, ``(n,)``, of length 1; 0 without redundant joints."""
    if jacobian.shape[1] <= jacobian.shape[0]:
        return np.zeros(jacobian.shape[1])
    return np.asarray(np.linalg.svd(jacobian)[2][-1])
