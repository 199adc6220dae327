"""The joint delivers a multiple of the desired torque."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class TorqueGain(Effect):
    """The joint delivers a multiple of the desired torque."""

    name = "torque_gain"
    acts_on = "actuation"
    sentence = "Each joint delivers a few percent more or less torque than asked for."
    parameters = (Parameter("gain", "-", 1.0, 0.7, 1.3, 0.01, "delivered over desired torque", per_joint=True),)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""

        def change(arm: ArmPhysics) -> ArmPhysics:
            return replace(arm, torque_gain=arm.torque_gain * values["gain"])

        return change_arms(physics, change)
