"""The torque loop leaves another motor inertia than assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class MotorInertiaScale(Effect):
    """The torque loop leaves another motor inertia than assumed."""

    name = "motor_inertia_scale"
    acts_on = "motor side"
    sentence = "The motor inertia that the torque loop leaves is a multiple of the assumed one."
    parameters = (Parameter("scale", "-", 1.0, 0.1, 3.0, 0.1, "B_theta over its assumed value"),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, motor_inertia_reduced=arm.motor_inertia_reduced * values["scale"])

        return change_arms(physics, change)
