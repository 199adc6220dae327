# SPDX-License-Identifier: Apache-2.0
"""Arms with their drives, object and support in one Bullet world, without sensors.

The plant adds sensors, scatter and a clock to it (:mod:`impact_rs_sim.plant`); a replay starts it in a measured state
and drives it with recorded torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from impact_rs_sim.approach import Approach
from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.drive import Drive, DriveStart, LinkTorque
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState, BodyState

SOLVER_ITERATIONS = 60
SOLVER_RESIDUAL = 1e-9


class Mechanics:
    """Arms with drives, object and support; :meth:`load` makes them.

    Args:
        physics: Parameters of the scene.
        world: Their Bullet world.
        drives: Drives by arm.
        period: Period of the torque loop, and step of Bullet [s].
    """

    def __init__(
        self, physics: Physics, world: BulletWorld, drives: Mapping[str, Drive | LinkTorque], period: float
    ) -> None:
        self.physics, self.world, self.drives = physics, world, drives
        self.links: dict[str, ArmState] = {}
        self._models = physics.robot_models()
        self._loaded = [name for name, arm in physics.arms.items() if arm.loads]
        self._period = period
        self._approach: Approach | None = None

    @classmethod
    def load(cls, physics: Physics, period: float, drive: type[Drive] | type[LinkTorque] = Drive) -> Mechanics:
        """A new world with arms, object and support.

        Args:
            physics: Parameters of the scene.
            period: Period of the torque loop, and step of Bullet [s].
            drive: Torque loop, or measured torque without one.

        Raises:
            NotABody: Mass and inertia of an end effector are those of no body.
        """
        world = BulletWorld.load(
            physics,
            time_step=period,
            gravity=True,
            compliant_pads=True,
            iterations=SOLVER_ITERATIONS,
            residual_threshold=SOLVER_RESIDUAL,
        )
        return cls(physics, world, {name: drive(arm, period) for name, arm in physics.arms.items()}, period)

    def start(
        self,
        arms: Mapping[str, ArmState],
        drives: Mapping[str, DriveStart],
        object_: BodyState,
        may_sleep: bool = True,
    ) -> None:
        """Set the state of arms, drives and object.

        Args:
            arms: Joint states by arm.
            drives: State of the drives by arm.
            object_: State of the object.
            may_sleep: Whether an object at rest, and Bullet with it, is left out until a pad comes near.
        """
        self.world.set_object(object_)
        self._approach = None
        if may_sleep and _rests(self.physics, object_):
            self.world.rest_object()
            self._approach = Approach(self.physics, self._models, self._period, arms, object_)
        for name, link in arms.items():
            self.links[name] = link
            self.world.set_arm(name, link)
            self.drives[name].start(link, drives[name])

    def step(
        self,
        desired: Mapping[str, Sequence[Array]],
        time: float,
        further: Mapping[str, Array] | None = None,
        after_sense: Callable[[str], None] | None = None,
    ) -> None:
        """Advance by as many periods of the torque loop as there are desired torques.

        Args:
            desired: By arm, desired torque of every period, ``(n,)`` [N m] each.
            time: Time now, for loads that depend on it [s].
            further: By arm, an additional torque on the links, ``(n,)`` [N m].
            after_sense: Called with the name of an arm whenever its drive has sensed the links.
        """
        world, drives = self._moving(), self.drives
        loads = {name: self._load_torque(name, time) for name in self._loaded}
        for name, torque in (further or {}).items():
            loads[name] = loads.get(name, 0.0) + torque
        motions = {}
        for wanted in zip(*desired.values(), strict=True):
            for name, torque in zip(desired, wanted, strict=True):
                drive = drives[name]
                link_torque = drive.link_torque(torque)
                world.apply_torque(name, link_torque + loads[name] if name in loads else link_torque)
                drive.step(torque)
            world.step()
            for name, drive in drives.items():
                motions[name] = world.joint_motion(name)
                drive.sense(*motions[name])
                if after_sense is not None:
                    after_sense(name)
        for name, (position, velocity) in motions.items():
            self.links[name] = ArmState(np.array(position), np.array(velocity))

    def _moving(self) -> BulletWorld | Approach:
        """The simulation of the links in this step."""
        if self._approach is not None and self._approach.is_near:
            for name, link in self.links.items():
                self.world.set_arm(name, link)
            self._approach = None
        return self._approach or self.world

    def _load_torque(self, name: str, time: float) -> Array:
        """Torque on the links of all loads outside the model, ``(n,)`` [N m]; sets that on the motors as well."""
        link = self.links[name]
        on_links, on_motors = self.physics.load_torques(name, self._models[name], time, link.position, link.velocity)
        self.drives[name].load(on_motors)
        return on_links

    def close(self) -> None:
        """Free the Bullet world."""
        self.world.close()


def _rests(physics: Physics, state: BodyState) -> bool:
    """Whether the object stays where it is until it is touched: at rest on a support that does not let it slide."""
    if physics.support_height is None or np.any(state.twist):
        return False
    across, down = float(np.hypot(*physics.gravity[:2])), -float(physics.gravity[2])
    return across < physics.support_friction * down
