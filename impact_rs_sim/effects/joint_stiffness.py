"""The joints are softer or stiffer than assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class JointStiffness(Effect):
    """The joints are softer or stiffer than assumed."""

    name = "joint_stiffness"
    acts_on = "joint torque"
    sentence = "The transmission between motor and link is softer or stiffer than assumed."
    parameters = (Parameter("scale", "-", 1.0, 0.2, 3.0, 0.1, "K over its assumed value"),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, stiffness=arm.stiffness * values["scale"])

        return change_arms(physics, change)
