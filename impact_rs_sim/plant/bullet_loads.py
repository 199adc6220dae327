# SPDX-License-Identifier: Apache-2.0
"""Formula loads on the object of a Bullet world, and contact loads between object and pad or support.

Every period of the torque loop starts with the contact forces of the previous step, as in the twin (``Twin::push`` in
src/twin.cpp).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.effects.formula import MIN_SLIDING_SPEED_M_S
from impact_rs_sim.memory import Memory
from impact_rs_sim.physics import LoadState, Physics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scene import ArmState

Scene = dict[str, float]


@dataclass(frozen=True)
class LoadedPair:
    """Contact of the object with a partner, reduced to one point.

    Attributes:
        force: Normal force on the object [N].
        penetration: Penetration, mean over the contact points, weighted with their forces [m].
        point: Point of the force, in A, ``(3,)`` [m].
        normal: Into the object, ``(3,)``.
        velocity: Relative velocity of the object to the partner at that point, ``(3,)`` [m/s].
    """

    force: float
    penetration: float
    point: Array
    normal: Array
    velocity: Array

    @property
    def sliding(self) -> Array:
        """Sliding velocity: tangential part of the relative velocity, ``(3,)`` [m/s]."""
        return self.velocity - (self.velocity @ self.normal) * self.normal

    def load(self, normal_force: float, sliding_resistance: float) -> Array:
        """Force on the object in A from a repulsive normal force and a force against sliding [N], ``(3,)`` [N]."""
        sliding = self.sliding
        return normal_force * self.normal - sliding_resistance * sliding / math.hypot(
            float(np.linalg.norm(sliding)), MIN_SLIDING_SPEED_M_S
        )


class BulletLoads:
    """The loads of one world.

    Args:
        physics: Parameters of the scene.
        world: Their Bullet world.
        models: Rigid-body models by arm.

    Attributes:
        any: Whether there is a load on the object or at one of its contacts.
    """

    def __init__(self, physics: Physics, world: BulletWorld, models: Mapping[str, RobotModel]) -> None:
        self._physics, self._world, self._models = physics, world, models
        self._first: dict[str, float] = {}  # time of the first contact of each pad with the object [s]
        arms = [load for arm in physics.arms.values() for load in arm.loads]
        self.any = bool(physics.object_loads) or any(load.touches for load in arms)
        self._touching: dict[str | None, LoadedPair | None] = {}

    def scene(self, time: float, arm: str | None, links: Mapping[str, ArmState]) -> Scene:
        """Values of formula symbols: time, object, and its contacts with one arm (None: with all arms).

        Args:
            time: Time since the start of the trial [s].
            arm: Name of the arm; None: all arms.
            links: Joint states by arm.
        """
        state, symbols = self._world.object_state(), {"t": time}
        symbols |= {f"object_{axis}": float(value) for axis, value in zip(AXES, state.position, strict=True)}
        symbols |= {f"object_v{axis}": float(value) for axis, value in zip(AXES, state.twist[:3], strict=True)}
        symbols |= {f"object_w{axis}": float(value) for axis, value in zip(AXES, state.twist[3:], strict=True)}
        symbols["object_speed"] = float(np.linalg.norm(state.twist[:3]))
        self._touching = {name: self._touch(name, links) for name in (*self._physics.arms, None)}
        for name in self._physics.arms:
            if self._touching[name] is not None:
                self._first.setdefault(name, time)
        if (support := self._touching[None]) is not None:
            symbols |= {"support_force": support.force, "support_slip": float(np.linalg.norm(support.sliding))}
        if arm is None:
            pads = [self._touching[name] for name in self._physics.arms]
            symbols["normal_force"] = sum(pad.force for pad in pads if pad is not None)
            symbols["since_contact"] = max((time - first for first in self._first.values()), default=0.0)
        elif (pad := self._touching[arm]) is not None:
            symbols |= {"normal_force": pad.force, "penetration": pad.penetration}
            symbols |= {"closing": -float(pad.velocity @ pad.normal), "slip": float(np.linalg.norm(pad.sliding))}
        if arm in self._first:
            symbols["since_contact"] = time - self._first[arm]
        return symbols

    def push(self, time: float, links: Mapping[str, ArmState], torques: Mapping[str, Array], memory: Memory) -> None:
        """Apply the loads over the next step of the world.

        Args:
            time: Time since the start of the trial [s].
            links: Joint states by arm.
            torques: tau_J by arm, ``(n,)`` [N m].
            memory: Memory of the loads in this simulation.
        """
        scene, centre = self.scene(time, None, links), self._world.object_state().position
        support = self._touching[None]
        for object_load in self._physics.object_loads:
            wrench = object_load.wrench(scene, memory)
            self._world.push(None, centre, wrench[:3], wrench[3:])
            if support is None and not object_load.remembers:
                continue
            at_support = object_load.support_force(scene, memory)
            if support is not None:
                self._world.push(None, support.point, support.load(*at_support))
        for name, arm in self._physics.arms.items():
            pad, link, model = self._touching[name], links[name], self._models[name]
            arm_loads = [load for load in arm.loads if pad is not None or load.remembers]
            if not arm_loads:
                continue
            state = LoadState(
                time=time,
                joint_position=link.position,
                joint_velocity=link.velocity,
                position=model.placement(link.position).translation,
                velocity=model.jacobian(link.position)[:3] @ link.velocity,
                impact_position=arm.impact_position,
                joint_torque=torques[name],
                scene=self.scene(time, name, links),
                memory=memory.part(name),
            )
            for arm_load in arm_loads:
                if (forces := arm_load.pad_force(state)) is not None and pad is not None:
                    self._world.push(None, pad.point, pad.load(*forces))
                    self._world.push(name, pad.point, -pad.load(*forces))

    def _touch(self, arm: str | None, links: Mapping[str, ArmState]) -> LoadedPair | None:
        """Contact of the object with an arm (None: its support); None without contact."""
        points = self._world.contact_points(arm)
        loads = np.array([max(point[9], 0.0) for point in points])
        force = float(loads.sum())
        if force <= 0.0:
            return None
        share = loads / force
        centre = share @ np.array([point[6] for point in points])
        body = self._world.object_state()
        velocity = body.twist[:3] + np.cross(body.twist[3:], centre - body.position)
        if arm is not None:
            link, model = links[arm], self._models[arm]
            twist = model.jacobian(link.position) @ link.velocity
            velocity = velocity - twist[:3] - np.cross(twist[3:], centre - model.placement(link.position).translation)
        # Bullet's normal points out of its second body: the object for a pad, the support for the object.
        normal = np.array(points[0][7]) * (1.0 if arm is None else -1.0)
        return LoadedPair(force, -float(share @ [point[8] for point in points]), centre, normal, velocity)
