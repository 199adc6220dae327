"""The pad is softer or stiffer than assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class PadCompliance(Effect):
    """The pad is softer or stiffer than assumed."""

    name = "pad_compliance"
    acts_on = "contact"
    sentence = "The silicone cover of the pad is softer or stiffer than assumed."
    parameters = (Parameter("scale", "-", 1.0, 0.1, 10.0, 0.2, "pad stiffness over its assumed value"),)
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return (
                arm
                if arm.pad_stiffness is None
                else replace(arm, pad_stiffness=arm.pad_stiffness * float(values["scale"][0]))
            )

        return change_arms(physics, change)
