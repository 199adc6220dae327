# SPDX-License-Identifier: Apache-2.0
"""Mechanics of the plant: Bullet for links and contacts, a drive per arm, all at the period of the torque loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Self

import numpy as np

from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.bullet_loads import BulletLoads
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.plant.mechanics import Mechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState
from impact_rs_sim.twin import rests

MAX_SOLVER_ITERATIONS = 60  # per step of Bullet
MAX_SOLVER_RESIDUAL = 1e-9  # largest squared change of a constraint row at which Bullet's solver stops


class BulletMechanics(Mechanics):
    """See :class:`~impact_rs_sim.plant.mechanics.Mechanics`.

    Args:
        physics: Parameters of the scene.
        world: Their Bullet world.
        drives: Drives by arm.
        may_sleep: Whether an object at rest sleeps until a pad comes near.

    Attributes:
        world: Their Bullet world.
        drives: Drives by arm.
        links: Joint states by arm.
    """

    def __init__(
        self, physics: Physics, world: BulletWorld, drives: Mapping[str, Drive], may_sleep: bool = True
    ) -> None:
        self.physics, self.world, self.drives = physics, world, drives
        self.links: dict[str, ArmState] = {}
        self._models = physics.robot_models()
        self._loaded = [name for name, arm in physics.arms.items() if arm.loads]
        self._loads = BulletLoads(physics, world, self._models)
        self._may_sleep = may_sleep and not self._loads.any

    @classmethod
    def load(cls, physics: Physics, period: float, may_sleep: bool = True) -> Self:
        """See :meth:`Mechanics.load`; without ``may_sleep`` an object at rest is simulated as well."""
        for name, arm in physics.arms.items():
            if arm.tool_spring is not None:
                raise InputError(
                    "the simulator bullet has rigid tools; expected no compliance, or --plant twin",
                    key=f"robots.{name}.end_effector.compliance",
                )
        world = BulletWorld.load(
            physics,
            time_step=period,
            gravity=True,
            compliant_pads=True,
            iterations=MAX_SOLVER_ITERATIONS,
            residual_threshold=MAX_SOLVER_RESIDUAL,
        )
        return cls(physics, world, {name: Drive(arm, period) for name, arm in physics.arms.items()}, may_sleep)

    def start(self, arms: Mapping[str, ArmState], drives: Mapping[str, DriveStart], object_: BodyState) -> None:
        """See :meth:`Mechanics.start`."""
        self._memory = Memory()
        self.world.set_object(object_)
        if self._may_sleep and rests(self.physics, object_):
            self.world.rest_object()
        for name, link in arms.items():
            self.links[name] = link
            self.world.set_arm(name, link)
            self.drives[name].start(link, drives[name])

    def step(
        self,
        desired: Mapping[str, Array],
        periods: int,
        time: float,
        further: Mapping[str, Array] | None = None,
        after_sense: Callable[[str], None] | None = None,
    ) -> None:
        """See :meth:`Mechanics.step`.

        Args:
            desired: Desired torque by arm, ``(n,)`` [N m].
            periods: Number of periods.
            time: Present time, for time-dependent loads [s].
            further: By arm, an additional torque on the links, ``(n,)`` [N m].
            after_sense: Called with the name of an arm whenever its drive has sensed the links.
        """
        world, drives = self.world, self.drives
        loads = {name: self._load_torque(name, time) for name in self._loaded}
        for name, torque in (further or {}).items():
            loads[name] = loads.get(name, 0.0) + torque
        motions, links = {}, self.links
        for number in range(periods):
            if self._loads.any:
                torques = {name: drive.elastic_torque for name, drive in drives.items()}
                now = time + number * next(iter(drives.values())).period
                self._loads.push(now, links, torques, self._memory)
            for name, torque in desired.items():
                drive = drives[name]
                link_torque = drive.transmission_torque
                world.apply_torque(name, link_torque + loads[name] if name in loads else link_torque)
                drive.step(torque)
            world.step()
            for name, drive in drives.items():
                motions[name] = world.joint_motion(name)
                drive.sense(*motions[name])
                if after_sense is not None:
                    after_sense(name)
            if self._loads.any:
                links = {name: ArmState(np.array(q), np.array(dq)) for name, (q, dq) in motions.items()}
        for name, (position, velocity) in motions.items():
            self.links[name] = ArmState(np.array(position), np.array(velocity))

    def _load_torque(self, name: str, time: float) -> Array:
        """Torque on the links of all loads outside the model, ``(n,)`` [N m]; sets that on the motors as well."""
        link = self.links[name]
        reads = any(load.reads_scene for load in self.physics.arms[name].loads)
        scene = self._loads.scene(time, name, self.links) if reads else None
        on_links, on_motors = self.physics.load_torques(
            name,
            self._models[name],
            time,
            link.position,
            link.velocity,
            self.drives[name].elastic_torque,
            scene,
            self._memory.part(name),
        )
        self.drives[name].load(on_motors)
        return on_links

    def arm(self, name: str) -> ArmMotion:
        """See :meth:`Mechanics.arm`."""
        link, drive = self.links[name], self.drives[name]
        return ArmMotion(link.position, link.velocity, drive.elastic_torque, drive.position, drive.velocity)

    def object_state(self, number: int = 0) -> BodyState:
        """See :meth:`Mechanics.object_state`."""
        return self.world.object_state(number)

    def pad_force(self, name: str) -> Array:
        """See :meth:`Mechanics.pad_force`."""
        return self.world.pad_force(name)

    def close(self) -> None:
        """Free the Bullet world."""
        self.world.close()
