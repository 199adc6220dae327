"""The desired torque arrives late."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class ActuationDelay(Effect):
    """The desired torque arrives late."""

    name = "actuation_delay"
    acts_on = "actuation"
    sentence = "Torque commands reach the joints some milliseconds late."
    parameters = (Parameter("delay", "s", 0.0, 0.0, 0.02, 0.001, "delay of the desired torque"),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, actuation_delay=arm.actuation_delay + float(values["delay"][0]))

        return change_arms(physics, change)
