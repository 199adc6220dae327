# SPDX-License-Identifier: Apache-2.0
"""Effects in the transmission between motor and link: ``tau_J = K (theta - q)``."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number
from impact_rs_sim.physics import ArmPhysics


def _stiffness(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return replace(arm, stiffness=arm.stiffness * number(values, "scale"))


JOINT_STIFFNESS = ArmEffect(
    name="joint_stiffness",
    acts_on="joint torque",
    sentence="The transmission between motor and link is softer or stiffer than assumed.",
    parameters=(Parameter("scale", "-", 1.0, 0.2, 3.0, 0.1, "K over its assumed value"),),
    law=_stiffness,
)
