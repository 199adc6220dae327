"""What the controller shall do in one trial: references, predicted jump, feedforward wrench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_control.references import SampledPath, ante_impact_path, post_impact_path, push_path
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.problem import ImpactProblem, ImpactResult
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import Scene

REFERENCE_ENGINE = "pinocchio"


@dataclass(frozen=True)
class ArmPlan:
    """What one arm shall do; paths are sampled at the control ticks.

    Attributes:
        ante_position: Ante-impact position reference of E.
        post_position: Post-impact position reference of E.
        ante_posture: Ante-impact reference of joint 1.
        post_posture: Post-impact reference of joint 1.
        orientation: Constant desired orientation R_d of E, ``(3, 3)``.
        wrench: Desired wrench f_d of the arm on the object per tick, at E in E[A], ``(ticks + 1, 6)`` [N, N m].
        approach_direction: Direction of the ante-impact velocity, ``(3,)``.
        initial: Initial joint positions, ``(n,)`` [rad].
    """

    ante_position: SampledPath
    post_position: SampledPath
    ante_posture: SampledPath
    post_posture: SampledPath
    orientation: Array
    wrench: Array
    approach_direction: Array
    initial: Array


@dataclass(frozen=True)
class TrialPlan:
    """One trial, planned.

    Attributes:
        scene: Scenario, object and case.
        velocity_scale: Post-impact reference velocity over predicted velocity [-].
        motor_inertia: Motor-inertia model of the reference's impact map.
        impact: The prediction the reference is made from.
        arms: Plan by arm.
    """

    scene: Scene
    velocity_scale: float
    motor_inertia: str
    impact: ImpactResult
    arms: dict[str, ArmPlan]

    @property
    def ante_velocity(self) -> float:
        """Ante-impact velocity along the measured axis, mean over the arms [m/s]."""
        axis, scenario = self.scene.scenario.axis_index, self.scene.scenario
        case = scenario.cases[self.scene.case_name]
        return float(np.mean([robot.ante_velocity[axis] for robot in case.robots.values()]))

    @property
    def predicted_post_velocity(self) -> float:
        """Predicted post-impact velocity along the measured axis, mean over the arms [m/s]."""
        axis = self.scene.scenario.axis_index
        return float(np.mean([twist[axis] for twist in self.impact.end_effector_twist.values()]))

    @property
    def reference_post_velocity(self) -> float:
        """Post-impact reference velocity along the measured axis at T_nom [m/s]."""
        return self.velocity_scale * self.predicted_post_velocity


def plan_trial(
    scene: Scene, velocity_scale: float = 1.0, motor_inertia: str = "reduced", engine: str = REFERENCE_ENGINE
) -> TrialPlan:
    """Make the references of a trial.

    Args:
        scene: Scenario, object and case.
        velocity_scale: Post-impact reference velocity over predicted velocity [-].
        motor_inertia: ``reduced``, ``rotor`` or ``zero``: the model behind the prediction.
        engine: Engine of the impact map.

    Raises:
        InputError: A scale or motor-inertia model that is none, or a start of the motion that cannot be reached.
    """
    if not (np.isfinite(velocity_scale) and velocity_scale > 0.0):
        raise InputError(f"velocity scale = {velocity_scale!r}: expected a number > 0 [-]")
    if motor_inertia not in MOTOR_INERTIA_MODELS:
        raise InputError(f"no motor-inertia model {motor_inertia!r}; known: {', '.join(MOTOR_INERTIA_MODELS)}")
    impact = compute_impact_map(ImpactProblem.at_nominal_impact(scene, motor_inertia), engine)
    arms = {name: _plan_arm(scene, name, impact, velocity_scale) for name in scene.arms}
    return TrialPlan(scene, velocity_scale, motor_inertia, impact, arms)


def _plan_arm(scene: Scene, name: str, impact: ImpactResult, scale: float) -> ArmPlan:
    scenario, model, state = scene.scenario, scene.models[name], scene.arms[name]
    timing = scenario.timing
    times: Array = np.arange(timing.ticks + 1, dtype=np.float64) * timing.control_period
    pose = scenario.robots[name].impact.placement
    velocity = model.jacobian(state.position)[:3] @ state.velocity
    joint_1, joint_1_velocity = state.position[:1], state.velocity[:1]
    ante_position = ante_impact_path(timing, pose.translation, velocity, times)
    ante_posture = ante_impact_path(timing, joint_1, joint_1_velocity, times)
    normal = np.array(scenario.robots[name].impact.pad_normal)
    post_position = push_path(timing, pose.translation, scale * impact.end_effector_twist[name][:3], normal, times)
    post_posture = post_impact_path(timing, joint_1, scale * impact.joint_velocity[name][:1], times)

    start = pose.copy()
    start.translation = ante_position.position[0]
    try:
        initial = model.inverse_kinematics(start, float(ante_posture.position[0, 0]), state.position)
    except InputError as error:
        raise InputError(f"arm {name!r}, start of the motion: {error}") from None
    return ArmPlan(
        ante_position=ante_position,
        post_position=post_position,
        ante_posture=ante_posture,
        post_posture=post_posture,
        orientation=pose.rotation,
        wrench=_push_wrench(scene, name, post_position),
        approach_direction=velocity / np.linalg.norm(velocity),
        initial=initial,
    )


def _push_wrench(scene: Scene, name: str, post: SampledPath) -> Array:
    """Wrench that keeps the object on the reference: sliding friction plus the object's own acceleration.

    The paper asks the desired wrench to "compensate for the external forces exerted on the end effectors through
    interaction with the object" (sec. Post-impact mode): along the pad's normal n these are mu m g and m a_d . n.
    """
    physics = scene.physics
    normal = np.array(scene.scenario.robots[name].impact.pad_normal)
    weight = physics.object.mass * float(np.linalg.norm(physics.gravity))
    friction = physics.support_friction * weight if physics.support_height is not None else 0.0
    force = np.maximum(friction + physics.object.mass * (post.acceleration @ normal), 0.0)
    return np.hstack((np.outer(force, normal), np.zeros((force.size, 3))))
