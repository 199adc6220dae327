# SPDX-License-Identifier: Apache-2.0
"""Loads of a hit on an arm: Monte Carlo simulation over the uncertain parameters.

The compiled twin (:mod:`impact_rs_sim.twin`) simulates drives with flexible joints and a compliant pad. A simulation
begins when the pads touch and lasts ``HIT_WINDOW_S``, with the joint torques that keep the arms in motion at the touch;
feedback of a controller hardly acts in that time. The rigid impact map would not do: the bounce of a compliant pad adds
up to a quarter to the largest joint velocity jump.

A draw changes all uncertain quantities of the scenario, stiffness and damping of joints and pads, and adds the known
discrepancy between the twin and another simulator:

    jump    + share v_n / l  n     (``JUMP_SHARES``; v_n closing speed, l reach)
    others  times exp(share n)     (``PEAK_SHARES``)                       with n standard normal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from impact_rs_analysis.evidence.discrepancy import MAX_SQUARE_ANGLE_RAD
from impact_rs_analysis.evidence.replays.ante_impact import obliqueness_of
from impact_rs_analysis.evidence.tables.map_discrepancy import HitKind
from impact_rs_analysis.limits.hit_bounds import Bounds, Thresholds, bounds_of
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.impact_map.contacts import SUPPORT, contact_pairs
from impact_rs_sim.impact_map.derivatives import change
from impact_rs_sim.impact_map.uncertainty import draw, possible, sources_of
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.robots.robot import Array, Reflexes
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.trial_settings import Uncertainties
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState, Scene, pad_placements
from impact_rs_sim.twin import TwinJob, simulate

DEFAULT_DRAWS = 200  # for a speed limit: bounds may be exceeded in two of them
HIT_WINDOW_S = 0.035  # after the touch; the spring of a joint swings back within it
INITIAL_GAP_M = 1e-4  # between pad and object
STIFFNESS_HALF_WIDTH = 0.2  # of joints and pads, relative: half the width of a 95 % interval; assumed
DAMPING_HALF_WIDTH = 0.3  # of joints and pads, relative: half the width of a 95 % interval; assumed
JUMP_WINDOW_S = (0.005, 0.015)  # after the touch, over which the post-impact velocity is averaged
# Difference between MuJoCo and the twin with equal parameters in 18 pushes (benchmarks/accuracy/limits.py --calibrate).
# Jumps: rms difference times l / v_n. Largest values: standard deviation of the logarithm of their ratio.
JUMP_SHARES: Mapping[HitKind, float] = {"square": 0.005, "oblique": 0.02}
PEAK_SHARES: Mapping[str, float] = {"speed": 0.02, "torque": 0.02, "reflex": 0.03, "force": 0.02}


@dataclass(frozen=True)
class DrawnHit:
    """One draw of a hit, at the speed of the scene.

    Attributes:
        physics: Parameters of the twin.
        arms: States of the arms when their pads touch.
        object: State of the object.
        offsets: Added to the jumps, proportional to the speed, ``(k,)``; 0 for other quantities.
        factors: Factors of the other quantities, ``(k,)`` [-]; 1 for jumps.
    """

    physics: Physics
    arms: Mapping[str, ArmState]
    object: BodyState
    offsets: Array
    factors: Array


class Hits:
    """Hits of one scene at any speed, with one set of draws.

    Args:
        scene: Arms, object, case.
        thresholds: Used instead of the limits of the robot facts.
        uncertainties: Uncertain quantities; None: those of the scenario.
        draws: Number of draws; 0: the nominal hit alone, without discrepancy.
        seed: Seed of the draws.

    Attributes:
        scene: The scene.
        bounds: Bounds of all quantities.
        speed: Closing speed of the fastest pad in the scene [m/s].
        kind: Kind of the hit.
    """

    def __init__(
        self,
        scene: Scene,
        thresholds: Thresholds,
        uncertainties: Uncertainties | None = None,
        draws: int = 0,
        seed: int = 0,
    ) -> None:
        scene.scenario.check_chains("the search for a speed limit")
        self.scene = scene
        self.bounds: Bounds = bounds_of(scene.physics, thresholds)
        problem = touching(scene)
        closing = closing_speeds(scene.physics, scene.arms, problem.object, scene.models)
        self.speed = max(closing.values())
        self.kind: HitKind = (
            "oblique" if obliqueness_of(scene.physics, scene.arms, problem.object) > MAX_SQUARE_ANGLE_RAD else "square"
        )
        kinds = np.array(self.bounds.kinds)
        jumps = kinds == "jump"
        jump_scale = np.zeros(kinds.size)
        jump_scale[jumps] = JUMP_SHARES[self.kind] * np.concatenate(
            [
                np.full(arm.facts.joint_count, closing[name] / reach_of(arm.facts))
                for name, arm in scene.physics.arms.items()
            ]
        )
        peak_shares = np.array([PEAK_SHARES.get(kind, 0.0) for kind in kinds])
        rng = np.random.default_rng(seed)
        sources = sources_of(problem, scene.scenario.uncertainty if uncertainties is None else uncertainties)
        self._draws: list[DrawnHit] = []
        for _ in range(max(draws, 1)):
            amounts = possible(problem, draw(sources, rng) if draws else {})
            noise = rng.standard_normal(kinds.size) if draws else np.zeros(kinds.size)
            springs = {name: drawn_springs(arm, rng) if draws else arm for name, arm in scene.physics.arms.items()}
            physics, arms, body = drawn(problem, scene.models, amounts, springs)
            self._draws.append(DrawnHit(physics, arms, body, jump_scale * noise, np.exp(noise * peak_shares)))

    @property
    def ratios_at_rest(self) -> Array:
        """Quantities over their bounds at speed 0, ``(draws, k)`` [-]: gravity torques, else 0."""
        quantities_at_rest = np.zeros((len(self._draws), len(self.bounds.names)))
        for row, hit in enumerate(self._draws):
            gravity = [hit.physics.robot_model(name).gravity_torque(arm.position) for name, arm in hit.arms.items()]
            quantities_at_rest[row, np.array(self.bounds.kinds) == "torque"] = np.abs(np.concatenate(gravity))
        return quantities_at_rest / self.bounds.values

    def ratios(self, scale: float) -> Array:
        """Quantities over their bounds at a multiple of the scene's speed, ``(draws, k)`` [-]; nan: unstable."""
        return self.values(scale) / self.bounds.values

    def values(self, scale: float) -> Array:
        """Quantities at a multiple of the scene's speed in their units, ``(draws, k)``; nan: the draw is unstable."""
        period = self.scene.scenario.timing.drive_period
        jobs = [twin_job(hit.physics, _scaled(hit.arms, scale), hit.object, period) for hit in self._draws]
        return np.array(
            [
                np.abs(quantities(self.scene, job.time, result.arms) * hit.factors + scale * hit.offsets)
                for hit, job, result in zip(self._draws, jobs, simulate(jobs), strict=True)
            ]
        )


def quantities(scene: Scene, time: Array, arms: Mapping[str, ArmMotion]) -> Array:
    """Quantities of a hit from its signals, in the order of :class:`Bounds`, ``(k,)``.

    Args:
        scene: Scene whose models the observer of the robot uses.
        time: Times of the samples after the touch, evenly spaced, ``(m,)`` [s].
        arms: Signals by arm, ``(m, n)``.
    """
    peaks: list[Array] = []
    after = (time >= JUMP_WINDOW_S[0]) & (time <= JUMP_WINDOW_S[1])
    for name, arm in arms.items():
        model, facts = scene.models[name], scene.physics.arms[name].facts
        gain = (facts.reflexes or Reflexes()).observer_gain
        external = observed(model, scene.arms[name].position, time, arm, gain)
        jacobian = model.jacobian(scene.arms[name].position)[:3]
        force = np.linalg.norm(np.linalg.lstsq(jacobian.T, external.T, rcond=None)[0], axis=0)
        signals = (arm.velocity, arm.torque, external)
        jump = arm.velocity[after].mean(axis=0) - arm.velocity[0]
        peaks += [np.abs(jump), *(np.abs(signal).max(axis=0) for signal in signals), force.max(keepdims=True)]
    return np.concatenate(peaks)


def observed(model: RobotModel, position: Array, time: Array, arm: ArmMotion, gain: float) -> Array:
    """External joint torques by a momentum observer in steady state at the first sample, ``(m, n)`` [N m].

    The configuration hardly changes during a hit: M and gravity torque are taken at its start.
    """
    period = float(time[1] - time[0])
    momentum = (arm.velocity - arm.velocity[0]) @ model.mass_matrix(position)
    carried = np.vstack((np.zeros_like(momentum[:1]), np.cumsum(arm.torque[:-1] - arm.torque[0], axis=0))) * period
    filter_ = ([gain, -gain], [1.0, gain * period - 1.0])
    return np.asarray(scipy.signal.lfilter(*filter_, momentum - carried, axis=0))


def closing_speeds(
    physics: Physics, arms: Mapping[str, ArmState], body: BodyState, models: Mapping[str, RobotModel]
) -> dict[str, float]:
    """Closing speed of every pad along its normal [m/s]."""
    return {name: speed for name, (_, speed) in _approach(physics, arms, body, models).items()}


def touching(scene: Scene) -> ImpactProblem:
    """The nominal impact with every pad moved along its velocity into contact; needed for tilted pads."""
    problem = ImpactProblem.at_nominal_impact(scene)
    arms = _moved(problem.arms, _approach(scene.physics, problem.arms, problem.object, scene.models), 0.0)
    return replace(problem, arms=arms)


def _moved(
    arms: Mapping[str, ArmState], approach: Mapping[str, tuple[float, float]], gap: float
) -> dict[str, ArmState]:
    """Arms moved back along their velocity to a distance ``gap`` between pad and object [m]."""
    return {
        name: replace(arms[name], position=arms[name].position + (separation - gap) / speed * arms[name].velocity)
        for name, (separation, speed) in approach.items()
    }


def _approach(
    physics: Physics, arms: Mapping[str, ArmState], body: BodyState, models: Mapping[str, RobotModel]
) -> dict[str, tuple[float, float]]:
    """Distance [m] and closing speed [m/s] of every pad.

    Raises:
        InputError: A pad does not approach the object.
    """
    placements = pad_placements(physics, models, arms)
    approach = {}
    for pair in contact_pairs(physics, body, placements):
        if pair.partner == SUPPORT:
            continue
        state = arms[pair.partner]
        speed = float(pair.normal @ models[pair.partner].jacobian(state.position)[:3] @ state.velocity)
        if speed <= 0.0:
            raise InputError(
                f"arm {pair.partner!r} does not approach the object; expected a case in which its pad hits the object"
            )
        approach[pair.partner] = (pair.separation, speed)
    return approach


def drawn(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel],
    amounts: Mapping[str, float],
    arms: Mapping[str, ArmPhysics],
) -> tuple[Physics, dict[str, ArmState], BodyState]:
    """Physics and states of a drawn hit for a simulator; pads are moved along their velocity into contact.

    Args:
        problem: The hit of the scene.
        models: Its rigid-body models by arm.
        amounts: Changes of parameters of the impact map; the contact points stay at the pads.
        arms: Arms with the springs of the draw.
    """
    changed = change(problem, amounts)
    drawn_arms = {}
    for name, arm in arms.items():
        factor = 1.0 + changed.link_inertia.get(name, 0.0)
        motor_ratio = changed.problem.motor_inertia[name] / problem.motor_inertia[name]
        links = tuple(
            link.model_copy(update={"mass": factor * link.mass, "inertia": tuple(factor * np.array(link.inertia))})
            for link in arm.facts.links
        )
        effector = arm.end_effector
        drawn_arms[name] = replace(
            arm,
            facts=arm.facts.model_copy(update={"links": links}),
            end_effector=replace(effector, mass=factor * effector.mass, inertia=factor * effector.inertia),
            motor_inertia_reduced=motor_ratio * arm.motor_inertia_reduced,
            motor_inertia_rotor=motor_ratio * arm.motor_inertia_rotor,
        )
    physics, body = replace(changed.problem.physics, arms=drawn_arms), changed.problem.object
    states = _moved(changed.problem.arms, _approach(physics, changed.problem.arms, body, models), INITIAL_GAP_M)
    return physics, states, body


def twin_job(physics: Physics, arms: Mapping[str, ArmState], body: BodyState, period: float) -> TwinJob:
    """A hit of the twin: arms in motion at the object, with the torque that keeps them in motion.

    Args:
        physics: Parameters.
        arms: States of the arms when their pads touch.
        body: State of the object.
        period: Period of the torque loop [s].
    """
    ticks = round(HIT_WINDOW_S / period)
    torque, starts = {}, {}
    for name, arm in arms.items():
        bias = physics.robot_model(name).terms(arm.position, arm.velocity).bias.copy()
        torque[name], starts[name] = bias[None], DriveStart(bias, np.zeros_like(bias))
    return TwinJob(
        physics=physics,
        arms=arms,
        drives=starts,
        torque=torque,
        acting={name: np.zeros(ticks, dtype=np.int32) for name in arms},
        time=np.linspace(0.0, ticks * period, ticks + 1),
        period=period,
        object=body,
    )


def _scaled(arms: Mapping[str, ArmState], scale: float) -> dict[str, ArmState]:
    """States with scaled velocities."""
    return {name: replace(arm, velocity=scale * arm.velocity) for name, arm in arms.items()}


def drawn_springs(arm: ArmPhysics, rng: np.random.Generator) -> ArmPhysics:
    """An arm with drawn stiffness and damping of joints and pad."""

    def factor(width: float, size: int = 1) -> Array:
        return np.maximum(1.0 + width / NORMAL_95 * rng.standard_normal(size), 0.1)

    joints = arm.stiffness.size
    stiffness = arm.stiffness * factor(STIFFNESS_HALF_WIDTH, joints)
    damping = arm.damping * factor(DAMPING_HALF_WIDTH, joints)
    pad, pad_damping = float(factor(STIFFNESS_HALF_WIDTH)[0]), float(factor(DAMPING_HALF_WIDTH)[0])
    return replace(
        arm,
        stiffness=stiffness,
        damping=damping,
        pad_stiffness=None if arm.pad_stiffness is None else pad * arm.pad_stiffness,
        pad_damping=pad_damping * arm.pad_damping,
    )
