# SPDX-License-Identifier: Apache-2.0
"""Friction identification from the feedback in free motion (paper Appendix A).

    a_i,fric(t) = 2 sqrt(k_p) (dp_d - dp_i) + k_p (p_d - p_i),      a_fric(t) = mean over the runs i

and likewise for orientation and joint 1, which the paper leaves to feedback. Seven tasks move seven joints, so all of
the friction is fed forward, and the pad has the orientation at impact that the impact map assumes. Feedback lags behind
the friction that it compensates; the remainder is therefore identified in further rounds, with the earlier result fed
forward.

A run has one arm and no object, and stays in one mode. The post-impact controller starts from rest on its own
reference: a run with impact would identify the error of the predicted velocity jump as friction, and remove it from the
net feedback that measures this error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from impact_rs_control.closed_loop import make_plant, without_garbage_collection
from impact_rs_control.controller import Controller
from impact_rs_control.plan import TrialPlan, initial_position, plan_trial, posture_of, tick_times
from impact_rs_control.references import run_up_path
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.friction_compensation import TASKS, AccelerationSamples, ArmFriction
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.seeds import seed_of

Phase = Literal["ante", "post"]

SAMPLE_PERIOD_S = 0.01  # feedback with k_p = 200 / s^2 follows nothing faster than some 70 ms
IDENTIFICATION_ROUNDS = 3  # each with the feedforward of those before; see docs/physics.md
OUT_OF_REACH_OFFSET_M = np.array([100.0, 0.0, 0.0])  # position of an object that no arm meets
ACCELERATION_DECIMALS = 5  # digits after the point [m/s^2, rad/s^2], far below the noise


def identify_arm(scene: Scene, arm: str, runs: int, seed: int, effects: Model | None = None) -> ArmFriction:
    """Feedforward of one arm for both controllers.

    Args:
        scene: Scenario, object and case; a friction compensation of the scenario is ignored.
        arm: Name of the arm.
        runs: Runs to average, for each controller and round.
        seed: Seed of scatter and noise; the same seed gives the same result.
        effects: Effects of the plant beyond the scenario; None: none.

    Raises:
        InputError: The scenario has no impact, ``runs`` is below 1, or an arm cannot reach its initial position.
    """
    if scene.scenario.excursion is not None:
        raise InputError(
            f"scenario {scene.scenario.name!r} hits nothing: it has no net feedback that friction could bias"
        )
    if posture_of(scene, arm) != [0]:
        raise InputError(
            f"arm {arm!r}: friction is identified with the posture task of joint 1 alone, which cases."
            f"{scene.case_name} has not; give joint_1 [rad]"
        )
    if runs < 1:
        raise InputError(f"runs = {runs}: expected at least 1")
    scene = replace(scene, scenario=scene.scenario.model_copy(update={"friction_compensation": None}))
    plan = plan_trial(scene)
    physics = scene.physics if effects is None else effects.apply(scene.physics)
    samples = {}
    for phase in get_args(Phase):
        motion = _free_motion(plan, arm, phase)
        total: Array | float = 0.0
        for iteration in range(IDENTIFICATION_ROUNDS):
            name = f"{scene.object_name}__{scene.case_name}__{arm}__{phase}__t{iteration}"
            seeds = [seed_of(seed, f"{name}__r{run}") for run in range(runs)]
            feedback = np.mean([run_free_motion(motion, arm, phase, physics, run_seed) for run_seed in seeds], axis=0)
            total = total + _decimated(feedback, sample_every(scene.scenario))
            samples[phase] = AccelerationSamples.of(np.round(total, ACCELERATION_DECIMALS))
            motion = _fed_forward(motion, arm, phase, samples[phase])
    return ArmFriction(**samples)


def sample_every(scenario: Scenario) -> int:
    """Control periods in one period of the identified samples."""
    return max(1, round(SAMPLE_PERIOD_S / scenario.timing.control_period))


def sample_period(scenario: Scenario) -> float:
    """Time between two identified samples [s]."""
    return sample_every(scenario) * scenario.timing.control_period


def run_free_motion(plan: TrialPlan, arm: str, phase: Phase, physics: Physics, seed: int) -> Array:
    """Feedback of all control tasks of one run in one mode, ``(ticks + 1, 7)`` [m/s^2, rad/s^2].

    Args:
        plan: Motion of one arm in free space.
        arm: Its name.
        phase: Controller: ante-impact or post-impact.
        physics: True physics of the plant.
        seed: Seed of scatter and noise.
    """
    scenario = plan.scene.scenario
    controller = Controller(plan).arms[arm]
    if phase == "post":
        interim = math.ceil(scenario.control.interim_duration / scenario.timing.control_period)
        controller.begin_interim(-interim)  # impact long ago: the interim mode is over
    arm_physics = replace(physics, arms={arm: physics.arms[arm]})
    plant = make_plant(plan, seed, arm_physics, simulator="twin")  # in free motion both simulators are equal
    feedback = np.empty((scenario.timing.ticks + 1, len(TASKS)))
    try:
        with without_garbage_collection():
            for tick in range(feedback.shape[0]):
                measured = plant.measure().arms[arm]
                command = controller.command(tick, measured, controller.watch(tick, measured))
                feedback[tick] = command.task_feedback
                if tick < scenario.timing.ticks:
                    plant.step({arm: command.torque})
    finally:
        plant.close()
    return feedback


def _free_motion(plan: TrialPlan, arm: str, phase: Phase) -> TrialPlan:
    """Plan of one arm alone: two arms would collide where the object was."""
    scene, arm_plan = plan.scene, plan.arms[arm]
    if phase == "post":
        timing, times = scene.scenario.timing, tick_times(scene)
        position, posture = (
            run_up_path(timing, path, times) for path in (arm_plan.post_position, arm_plan.post_posture)
        )
        arm_plan = replace(
            arm_plan,
            post_position=position,
            post_posture=posture,
            wrench=np.zeros_like(arm_plan.wrench),
            initial=initial_position(scene, arm, arm_plan.orientation[0], position, arm_plan.posture, posture),
        )
    distant_object = replace(scene.object, position=scene.object.position + OUT_OF_REACH_OFFSET_M)
    return replace(plan, scene=replace(scene, object=distant_object), arms={arm: arm_plan})


def _fed_forward(plan: TrialPlan, arm: str, phase: Phase, samples: AccelerationSamples) -> TrialPlan:
    """Plan with the feedforward identified so far."""
    rows, arm_plan = samples.at(tick_times(plan.scene), sample_period(plan.scene.scenario)), plan.arms[arm]
    arm_plan = replace(arm_plan, ante_friction=rows) if phase == "ante" else replace(arm_plan, post_friction=rows)
    return replace(plan, arms={arm: arm_plan})


def _decimated(signal: Array, every: int) -> Array:
    """Moving average and decimation by ``every``, ``(k, 7)``; removes noise and keeps friction."""
    half = every // 2
    return np.array(
        [signal[max(0, centre - half) : centre + half + 1].mean(axis=0) for centre in range(0, len(signal), every)]
    )
