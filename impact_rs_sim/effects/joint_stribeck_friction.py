"""Stribeck friction: extra resistance at low speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class JointStribeckFriction(Effect):
    """Stribeck friction: extra resistance at low speed."""

    name = "joint_stribeck_friction"
    acts_on = "motor side"
    sentence = "Each joint sticks a little: it resists more at low speed than when it moves fast."
    parameters = (
        Parameter("breakaway", "N m", 0.0, 0.0, 5.0, 0.2, "torque above Coulomb at rest", per_joint=True),
        Parameter("stribeck_velocity", "rad/s", 0.05, 0.01, 0.5, 0.02, "speed at which the excess has fallen to 1/e"),
    )

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        velocity = float(values["stribeck_velocity"][0])

        def change(arm: ArmPhysics) -> ArmPhysics:
            friction = replace(
                arm.friction,
                stribeck=arm.friction.stribeck + values["breakaway"],
                stribeck_velocity=np.full(arm.stiffness.size, velocity),
            )
            return replace(arm, friction=friction)

        return change_arms(physics, change)
