"""A cable or hose that pulls on the end effector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Load, LoadState, Physics
from impact_rs_sim.robot import Array


class ExternalSpring(Effect):
    """A cable or hose that pulls on the end effector: ``f = f_0 - k (p - p_impact)`` at frame E."""

    name = "external_spring"
    acts_on = "joint torque"
    sentence = "A cable or hose pulls on the end effector, more the further it moves."
    parameters = (
        Parameter("pull_x", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along x"),
        Parameter("pull_y", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along y"),
        Parameter("pull_z", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along z"),
        Parameter("stiffness", "N/m", 0.0, 0.0, 500.0, 5.0, "growth of the force with distance"),
    )

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        pull = np.array([float(values[name][0]) for name in ("pull_x", "pull_y", "pull_z")])
        spring = Spring(pull, float(values["stiffness"][0]))

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, loads=(*arm.loads, spring))

        return change_arms(physics, change)


@dataclass(frozen=True)
class Spring(Load):
    """The force law of :class:`ExternalSpring`."""

    pull: Array
    stiffness: float

    def end_effector_force(self, state: LoadState) -> Array | None:
        """Force at E, axes of A, ``(3,)`` [N]."""
        return np.asarray(self.pull - self.stiffness * (state.position - state.impact_position))
