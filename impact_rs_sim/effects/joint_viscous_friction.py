"""Viscous friction of the joints, as the desired torque feels it."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class JointViscousFriction(Effect):
    """Viscous friction of the joints, as the desired torque feels it."""

    name = "joint_viscous_friction"
    acts_on = "motor side"
    sentence = "Each joint resists motion with a torque that grows with its speed."
    parameters = (Parameter("viscous", "N m s/rad", 0.0, 0.0, 5.0, 0.1, "viscous friction", per_joint=True),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            friction = arm.friction
            return replace(arm, friction=replace(friction, viscous=friction.viscous + values["viscous"]))

        return change_arms(physics, change)
