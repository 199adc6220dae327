"""Constant torque on top of the desired one."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class TorqueOffset(Effect):
    """Constant torque on top of the desired one."""

    name = "torque_offset"
    acts_on = "actuation"
    sentence = (
        "Each joint delivers a constant torque that nobody asked for, for example a torque sensor that is not zeroed."
    )
    parameters = (Parameter("offset", "N m", 0.0, -5.0, 5.0, 0.1, "added torque", per_joint=True),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, torque_offset=arm.torque_offset + values["offset"])

        return change_arms(physics, change)
