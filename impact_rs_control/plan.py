# SPDX-License-Identifier: Apache-2.0
"""Plan of one trial: references, predicted velocity jump, feedforward wrench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_control.references import (
    SampledPath,
    ante_impact_path,
    carry_path,
    excursion_path,
    post_impact_path,
)
from impact_rs_sim.clearance import check_clearance, deepest_penetration
from impact_rs_sim.errors import Infeasible, InputError, UnreachablePose
from impact_rs_sim.impact_map import DEFAULT_ENGINE, predict_impact
from impact_rs_sim.impact_map.problem import ImpactProblem, ImpactResult
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene

POSE_TASKS = 6  # position and orientation of E
MAX_POSE_SPACING_M = 0.01  # displacement of E between two poses that are checked against support and ground
TASK_SINGULAR_VALUE_TOLERANCE = 1e-3  # over the largest singular value of the tasks [-]; below, an arm cannot follow
MIN_REFERENCE_SPEED_M_S = 1e-3  # a slower reference is about to come to rest
RESTITUTION_TOLERANCE = 0.05  # [-], between impact map and pad; a third of a damped pad's restitution
LARGEST_SCALE = 3.0  # [-], of the velocity; a reference far beyond the prediction does not test it


@dataclass(frozen=True)
class ArmPlan:
    """Plan of one arm; paths are sampled at the control ticks.

    Attributes:
        ante_position: Ante-impact position reference of E.
        post_position: Post-impact position reference of E.
        posture: Joints of the posture task, counted from 0; k of them.
        ante_posture: Ante-impact reference of these joints.
        post_posture: Post-impact reference of these joints.
        orientation: Desired orientation R_d of E per tick, ``(ticks + 1, 3, 3)``; constant in a hit.
        rotation: Desired rotation about the pad's normal that ``orientation`` holds, ``(ticks + 1, 1)`` [rad].
        pad_normal: The pad's normal in A, ``(3,)``; it keeps its direction.
        wrench: Desired wrench f_d of the arm on the object per tick, at E in E[A], ``(ticks + 1, 6)`` [N, N m].
        ante_friction: Friction compensation of the ante mode per tick, ``(ticks + 1, 6 + k)`` [m/s^2, rad/s^2]; see
            TASKS.
        post_friction: Friction compensation of interim and post mode, ``(ticks + 1, 6 + k)`` [m/s^2, rad/s^2].
        approach_direction: Direction of the ante-impact velocity, the pad's normal if the arm waits, ``(3,)``.
        initial: Initial joint positions, ``(n,)`` [rad].
    """

    ante_position: SampledPath
    post_position: SampledPath
    posture: tuple[int, ...]
    ante_posture: SampledPath
    post_posture: SampledPath
    orientation: Array
    rotation: SampledPath
    pad_normal: Array
    wrench: Array
    ante_friction: Array
    post_friction: Array
    approach_direction: Array
    initial: Array


@dataclass(frozen=True)
class TrialPlan:
    """One trial, planned.

    Attributes:
        scene: Scenario, object and case.
        velocity_scale: Post-impact reference velocity over predicted velocity [-].
        motor_inertia: Motor-inertia model of the reference's impact map.
        impact: The prediction the reference is made from, of the contact that the scenario names; None where nothing
            is hit.
        arms: Plan by arm.
    """

    scene: Scene
    velocity_scale: float
    motor_inertia: str
    impact: ImpactResult | None
    arms: dict[str, ArmPlan]

    @property
    def expects_impact(self) -> bool:
        """Whether the arms are meant to hit the object."""
        return self.impact is not None

    @property
    def expected_lift(self) -> float:
        """Planned lift of a clamped object [m]; 0 if it is pushed."""
        return self.expected_lift_at(self.scene.scenario.timing.duration)

    def expected_lift_at(self, time: float) -> float:
        """Planned lift of a clamped object up to a time in the trial [m]; 0 if it is pushed."""
        timing = self.scene.scenario.timing
        if self.scene.scenario.control.clamp_force == 0.0:
            return 0.0
        tick, at_impact = (round(at / timing.control_period) for at in (time, timing.nominal_impact))
        paths = [arm.post_position.position[:, 2] for arm in self.arms.values()]
        return float(np.mean([path[min(tick, timing.ticks)] - path[at_impact] for path in paths]))

    @property
    def ante_velocity(self) -> float:
        """Ante-impact velocity along the measured axis, mean over the arms [m/s]."""
        axis, scenario = self.scene.scenario.axis_index, self.scene.scenario
        case = scenario.cases[self.scene.case_name]
        return float(np.mean([robot.ante_velocity[axis] for robot in case.robots.values()]))

    @property
    def predicted_post_velocity(self) -> float:
        """Predicted post-impact velocity along the measured axis, mean over the arms [m/s]; 0 without impact."""
        if self.impact is None:
            return 0.0
        axis = self.scene.scenario.axis_index
        return float(np.mean([twist[axis] for twist in self.impact.end_effector_twist.values()]))

    @property
    def reference_post_velocity(self) -> float:
        """Post-impact reference velocity along the measured axis at T_nom [m/s]."""
        return self.velocity_scale * self.predicted_post_velocity


def check_scale(velocity_scale: float) -> None:
    """Check a post-impact reference velocity over the predicted velocity [-].

    Raises:
        InputError: It is not positive, or beyond ``LARGEST_SCALE``.
    """
    if not 0.0 < velocity_scale <= LARGEST_SCALE:
        raise InputError(f"velocity scale = {velocity_scale!r}: expected a number > 0 and <= {LARGEST_SCALE:g} [-]")


def plan_trial(
    scene: Scene, velocity_scale: float = 1.0, motor_inertia: str = "reduced", engine: str = DEFAULT_ENGINE
) -> TrialPlan:
    """Make the references of a trial.

    Args:
        scene: Scenario, object and case.
        velocity_scale: Post-impact reference velocity over predicted velocity [-].
        motor_inertia: ``reduced``, ``rotor`` or ``zero``: the model behind the prediction.
        engine: Engine of the impact map; the settled contact has one solver.

    Raises:
        InputError: An invalid scale or motor-inertia model, an arm with fewer than six joints, a restitution that
            differs from the pad's, or a friction compensation not identified for this object and case.
        Infeasible: A start that cannot be reached, or arms that collide with each other, support or ground.
    """
    check_scale(velocity_scale)
    if motor_inertia not in MOTOR_INERTIA_MODELS:
        raise InputError(f"no motor-inertia model {motor_inertia!r}; known: {', '.join(MOTOR_INERTIA_MODELS)}")
    check_joint_counts(scene.scenario)
    if scene.scenario.excursion is not None:
        arms = {name: _plan_excursion(scene, name) for name in scene.arms}
        _check_collisions(scene, arms)
        return TrialPlan(scene, velocity_scale, motor_inertia, None, arms)
    check_restitution(scene)
    check_clearance(scene.models, {name: state.position for name, state in scene.arms.items()}, "at the impact")
    problem = ImpactProblem.at_nominal_impact(scene, motor_inertia)
    impact = predict_impact(problem, scene.scenario.control.reference_contact, engine)
    arms = {name: _plan_hit(scene, name, impact, velocity_scale) for name in scene.arms}
    check_clearance(scene.models, {name: arm.initial for name, arm in arms.items()}, "at the start")
    _check_collisions(scene, arms)
    return TrialPlan(scene, velocity_scale, motor_inertia, impact, arms)


def _check_collisions(scene: Scene, arms: Mapping[str, ArmPlan]) -> None:
    """Check that no arm touches support or ground on its references, the object's own contacts aside.

    Raises:
        Infeasible: Names arm, link or pad, partner, depth and time.
    """
    scenario, physics = scene.scenario, scene.physics
    pushed = scenario.excursion is None and scenario.control.clamp_force == 0.0
    displacement = np.mean([arm.post_position.position[-1] - _at_impact(scene, arm) for arm in arms.values()], axis=0)
    for name, arm in arms.items():
        times, positions = _reference_poses(scene, name, arm)
        penetration = deepest_penetration(
            physics, name, positions, scene.object, displacement if pushed else np.zeros(3)
        )
        if penetration is None:
            continue
        remedy = f"raise robots.{name}.impact.position, or choose another pose there (pad_normal, pad_up, joint_guess)"
        if penetration.partner == "ground":
            remedy += "; if the floor is lower, raise bases, poses and support by as much"
        raise Infeasible(
            f"arm {name!r}: {penetration.part} would be {penetration.depth:.3f} m inside the {penetration.partner}, "
            f"whose surface is at z = {penetration.surface:g} m, at {times[penetration.index]:.3f} s of its reference; "
            f"{remedy}"
        )


def _at_impact(scene: Scene, arm: ArmPlan) -> Array:
    """Position of the post-impact reference at T_nom, ``(3,)`` [m]."""
    timing = scene.scenario.timing
    return np.asarray(arm.post_position.position[round(timing.nominal_impact / timing.control_period)])


def _reference_poses(scene: Scene, name: str, arm: ArmPlan) -> tuple[Array, Array]:
    """Joint positions along both references, the ante-impact one to its end and the other from T_nom on.

    Returns:
        Times ``(k,)`` [s] and joint positions ``(k, n)`` [rad] of samples; E moves at most ``MAX_POSE_SPACING_M``
        between two.
    """
    model, timing = scene.models[name], scene.scenario.timing
    impact = round(timing.nominal_impact / timing.control_period)
    times, rows = [], []
    for path, posture, first, q in (
        (arm.ante_position, arm.ante_posture, 0, arm.initial),
        (arm.post_position, arm.post_posture, impact, scene.arms[name].position),
    ):
        displacement = np.linalg.norm(np.diff(path.position[first:], axis=0), axis=1)
        cells = np.floor(np.cumsum(displacement) / MAX_POSE_SPACING_M)
        ticks = first + np.concatenate(([0], 1 + np.flatnonzero(np.diff(cells)), [len(displacement)])).astype(int)
        for tick in dict.fromkeys(ticks.tolist()):
            q = _inverse_kinematics_step(
                model, q, pin.SE3(arm.orientation[tick], path.position[tick]), arm, posture.position[tick]
            )
            times.append(tick * timing.control_period)
            rows.append(q)
    return np.array(times), np.array(rows)


def _inverse_kinematics_step(model: RobotModel, q: Array, target: pin.SE3, arm: ArmPlan, posture: Array) -> Array:
    """Joint positions near ``q`` with E and the posture joints at their targets, ``(n,)``.

    Two Gauss-Newton steps of least norm (pseudo-inverse) for redundant or infeasible tasks.
    """
    posture_joints = list(arm.posture)
    for _ in range(2):
        placement = model.placement(q)
        rotation_error = placement.rotation @ pin.log3(placement.rotation.T @ target.rotation)
        error = np.concatenate(
            (target.translation - placement.translation, rotation_error, posture - q[posture_joints])
        )
        tasks = np.vstack((model.jacobian(q), np.eye(model.joint_count)[posture_joints]))
        q = q + np.linalg.lstsq(tasks, error, rcond=TASK_SINGULAR_VALUE_TOLERANCE)[0]
    return q


def check_restitution(scene: Scene) -> None:
    """Check that pads and impact map of a trial have the same coefficient of restitution.

    A restitution of 0 fits every pad: under a continued push a series of bounces ends in the state of a single
    inelastic impact (paper sec. Single-arm hit-and-push scenario).

    Raises:
        InputError: The restitution of a pad differs from the impact map's, with the pad damping that would remove the
            difference in the message; or a restitution above 0 between object and neighbours.
    """
    assumed, object_ = scene.physics.restitution, scene.physics.object
    if assumed > 0.0 and scene.physics.neighbours:
        raise InputError(
            "object and neighbours do not bounce off each other in a trial: expected 0",
            key="contact.restitution",
            value=assumed,
        )
    for name, arm in scene.physics.arms.items() if assumed > 0.0 else ():
        pad, pad_restitution = f"robots.{name}.end_effector.pad", arm.pad_restitution(object_)
        if abs(pad_restitution - assumed) <= RESTITUTION_TOLERANCE:
            continue
        if arm.pad_stiffness is None:
            behaviour, remedy = "does not bounce, for it is rigid", f"give {pad} a stiffness and a damping"
        else:
            behaviour = f"bounces off {scene.object_name} with {pad_restitution:.2f}, by its stiffness and damping"
            remedy = f"set {pad}.damping: {arm.pad_damping_of(assumed, object_):.4g} [N s/m]"
        raise InputError(
            f"the pad of {name!r} {behaviour}, so that no trial could follow the prediction; {remedy}, or "
            "contact.restitution: 0, with which a pad that goes on pushing ends its bounces",
            key="contact.restitution",
            value=assumed,
        )


def check_joint_counts(scenario: Scenario) -> None:
    """Refuse trees, and arms with too few joints for the tasks.

    Raises:
        InputError: An arm is a tree, or has fewer joints than the pose of its pad has components.
    """
    for name, robot in scenario.robots.items():
        robot.robot_facts.check_chain("the controller", f"robots.{name}", scenario.name)
        if (count := robot.robot_facts.joint_count) < POSE_TASKS:
            raise InputError(
                f"the arm has {count} joints, and the controller holds the pose of its pad, which takes {POSE_TASKS}: "
                "no trials; impact-rs map and recordings take any arm",
                key=f"robots.{name}",
            )


def tick_times(scene: Scene) -> Array:
    """Times of the control ticks of a trial, ``(ticks + 1,)`` [s]."""
    timing = scene.scenario.timing
    return np.arange(timing.ticks + 1, dtype=np.float64) * timing.control_period


def _plan_hit(scene: Scene, name: str, impact: ImpactResult, scale: float) -> ArmPlan:
    scenario, model, state = scene.scenario, scene.models[name], scene.arms[name]
    timing, times = scenario.timing, tick_times(scene)
    pose = scenario.impact_placement(name, scene.object_name)
    normal = pose.rotation[:, 2]
    velocity = model.jacobian(state.position)[:3] @ state.velocity
    posture_joints = posture_of(scene, name)
    ante_position = ante_impact_path(timing, pose.translation, velocity, times)
    ante_posture = ante_impact_path(timing, state.position[posture_joints], state.velocity[posture_joints], times)
    post_velocity = scale * impact.end_effector_twist[name][:3]
    mean_velocity = scale * np.mean([twist[:3] for twist in impact.end_effector_twist.values()], axis=0)
    post_position = carry_path(
        timing, pose.translation, post_velocity, mean_velocity, np.eye(3)[scenario.axis_index], normal, times
    )
    post_posture = post_impact_path(
        timing, state.position[posture_joints], scale * impact.joint_velocity[name][posture_joints], times
    )
    still = np.zeros((times.size, 1))
    ante_friction, post_friction = _friction(scene, name, times)
    return ArmPlan(
        ante_position=ante_position,
        post_position=post_position,
        posture=tuple(posture_joints),
        ante_posture=ante_posture,
        post_posture=post_posture,
        orientation=np.broadcast_to(pose.rotation, (times.size, 3, 3)),
        rotation=SampledPath(still, still, still),
        pad_normal=normal,
        wrench=_wrench(scene, name, post_position),
        ante_friction=ante_friction,
        post_friction=post_friction,
        approach_direction=velocity / np.linalg.norm(velocity) if np.any(velocity) else normal,
        initial=initial_position(scene, name, pose.rotation, ante_position, posture_joints, ante_posture),
    )


def _plan_excursion(scene: Scene, name: str) -> ArmPlan:
    """Plan of an excursion through free space; ante- and post-impact references are equal."""
    scenario, state = scene.scenario, scene.arms[name]
    excursion, times = scenario.excursion, tick_times(scene)
    assert excursion is not None
    robot = scenario.cases[scene.case_name].robots[name]
    pose = scenario.impact_placement(name, scene.object_name)
    normal = pose.rotation[:, 2]
    leg = scenario.excursion_leg(robot)

    def path(start: Array, end: Array) -> SampledPath:
        return excursion_path(excursion.begin, leg, excursion.rest, start, end, times)

    position = path(pose.translation + np.array(excursion.start), pose.translation + np.array(excursion.end))
    posture_joints = posture_of(scene, name)
    joint_displacement = np.array([excursion.joint_1 if joint == 0 else 0.0 for joint in posture_joints])
    posture = path(state.position[posture_joints], state.position[posture_joints] + joint_displacement)
    rotation = path(np.zeros(1), np.array([excursion.twist]))
    orientation = np.array([pose.rotation @ pin.exp3(np.array([0.0, 0.0, angle])) for angle in rotation.position[:, 0]])
    ante_friction, post_friction = _friction(scene, name, times)
    return ArmPlan(
        ante_position=position,
        post_position=position,
        posture=tuple(posture_joints),
        ante_posture=posture,
        post_posture=posture,
        orientation=orientation,
        rotation=rotation,
        pad_normal=normal,
        wrench=np.zeros((times.size, 6)),
        ante_friction=ante_friction,
        post_friction=post_friction,
        approach_direction=np.array(robot.ante_velocity) / np.linalg.norm(robot.ante_velocity),
        initial=initial_position(scene, name, pose.rotation, position, posture_joints, posture),
    )


def posture_of(scene: Scene, name: str) -> list[int]:
    """Joints of the posture task of an arm, counted from 0."""
    return list(scene.scenario.cases[scene.case_name].robots[name].posture_joints)


def initial_position(
    scene: Scene, name: str, rotation: Array, position: SampledPath, posture_joints: Sequence[int], posture: SampledPath
) -> Array:
    """Joint positions of an arm at the start of its motion, ``(n,)`` [rad].

    Args:
        scene: The scene.
        name: Name of the arm.
        rotation: Orientation of E, ``(3, 3)``.
        position: Path of E.
        posture_joints: Joints of the posture task, counted from 0.
        posture: Their path.

    Raises:
        UnreachablePose: The start cannot be reached.
    """
    start = pin.SE3(rotation, position.position[0])
    try:
        posture_target = dict(zip(posture_joints, posture.position[0].tolist(), strict=True))
        return scene.models[name].inverse_kinematics(start, posture_target, scene.arms[name].position)
    except UnreachablePose as error:
        raise UnreachablePose(f"arm {name!r}, start of the motion: {error}") from None


def _friction(scene: Scene, name: str, times: Array) -> tuple[Array, Array]:
    """Friction compensation of the ante mode and of the modes after it, ``(ticks + 1, 6 + k)`` each; see TASKS."""
    compensation = scene.scenario.friction_compensation
    if compensation is None:
        zeros = np.zeros((times.size, 6 + len(posture_of(scene, name))))
        return zeros, zeros
    arm = compensation.arms(scene.object_name, scene.case_name)[name]
    return arm.ante.at(times, compensation.period), arm.post.at(times, compensation.period)


def _wrench(scene: Scene, name: str, post: SampledPath) -> Array:
    """Wrench of one arm on the object that keeps it on the reference, ``(ticks + 1, 6)`` [N, N m].

    The paper asks the desired wrench to apply a normal contact force and to "compensate for the external forces exerted
    on the end effectors through interaction with the object", friction due to sliding among them (sec. Post-impact
    mode). Held: the clamping force along the pad's normal n, and this arm's share of m (a_d - g), which a fixed object
    does not need, nor one whose bearing carries it: on a hinge or slide without friction a reference that comes to rest
    needs no push.
    """
    physics, scenario = scene.physics, scene.scenario
    borne = physics.object.fixed or physics.object.guide is not None
    if scenario.control.clamp_force <= 0.0 and not borne:
        return _pushing_wrench(scene, name, post)
    normal = scenario.robots[name].impact_placement.rotation[:, 2]
    share = np.zeros_like(post.acceleration)
    if not borne:
        share = physics.object.mass / len(scene.arms) * (post.acceleration - np.asarray(physics.gravity))
    force = scenario.control.clamp_force * normal + share
    return np.hstack((force, np.zeros_like(force)))


def _pushing_wrench(scene: Scene, name: str, post: SampledPath) -> Array:
    """Wrench of one arm on a pushed object that follows the reference across its support.

    In the plane of the support f = m a_d + mu m g v_d / |v_d|, with this arm's share of the mass as m: the object
    slides along the reference against friction. The component across n is limited by the friction cone of the pad; a
    pulling force is 0. The force acts at E and the object shall not rotate, so the vertical moment about its centre of
    mass is compensated; the support carries the tipping moment.
    """
    physics, mass = scene.physics, scene.physics.moved_mass / len(scene.arms)
    normal = scene.scenario.robots[name].impact_placement.rotation[:, 2]
    gravity = np.asarray(physics.gravity, dtype=float)
    weight = mass * float(np.linalg.norm(gravity))
    up = -gravity / np.linalg.norm(gravity) if weight > 0.0 else np.array([0.0, 0.0, 1.0])
    in_plane = np.eye(3) - np.outer(up, up)
    friction = physics.support_friction * weight if physics.support_height is not None else 0.0
    speed = np.linalg.norm(post.velocity @ in_plane, axis=1, keepdims=True)
    force = (
        mass * post.acceleration + friction * post.velocity / np.maximum(speed, MIN_REFERENCE_SPEED_M_S)
    ) @ in_plane
    pressing = np.maximum(force @ normal, 0.0)
    across = force - np.outer(force @ normal, normal)
    tangential_force = np.linalg.norm(across, axis=1)
    friction_share = np.minimum(1.0, physics.pad_friction * pressing / np.maximum(tangential_force, 1e-12))
    force = np.outer(pressing, normal) + friction_share[:, None] * across
    centre = scene.object.position + scene.object.rotation @ physics.object.com_offset
    lever = centre - scene.scenario.impact_placement(name, scene.object_name).translation
    return np.hstack((force, np.outer(np.cross(lever, force) @ up, up)))
