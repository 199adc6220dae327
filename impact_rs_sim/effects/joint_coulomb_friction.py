"""Coulomb friction of the joints, as the desired torque feels it."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class JointCoulombFriction(Effect):
    """Coulomb friction of the joints, as the desired torque feels it."""

    name = "joint_coulomb_friction"
    acts_on = "motor side"
    sentence = "Each joint resists motion with a constant torque that flips sign with the direction of motion."
    parameters = (Parameter("coulomb", "N m", 0.0, 0.0, 5.0, 0.1, "Coulomb friction torque", per_joint=True),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            friction = arm.friction
            return replace(arm, friction=replace(friction, coulomb=friction.coulomb + values["coulomb"]))

        return change_arms(physics, change)
