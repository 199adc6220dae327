# SPDX-License-Identifier: Apache-2.0
"""Effects in the transmission between motor and link: ``tau_J = K (theta - q) + D (dtheta - dq)``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values
from impact_rs_sim.effects.quantity_laws import Multiplied
from impact_rs_sim.physics import ArmPhysics


def _elasticity(arm: ArmPhysics, values: Values) -> ArmPhysics:
    elastic = values["compliance"] > 0.0
    if not np.any(elastic):
        return arm
    stiffness = np.where(elastic, 1.0 / np.where(elastic, values["compliance"], 1.0), arm.stiffness)
    damping = np.where(elastic, values["relaxation"] * np.where(elastic, stiffness, 0.0), arm.damping)
    return replace(arm, stiffness=stiffness, damping=damping)


JOINT_STIFFNESS = ArmEffect(
    name="joint_stiffness",
    acts_on="joint torque",
    sentence="The transmission between motor and link is softer or stiffer than assumed.",
    parameters=(Parameter("scale", "-", 1.0, 0.2, 3.0, 0.1, "K over its assumed value"),),
    law=Multiplied("stiffness", "scale"),
)

JOINT_ELASTICITY = ArmEffect(
    name="joint_elasticity",
    acts_on="joint torque",
    sentence="The transmission of a joint yields to the torque that it passes on, and the joint resonates.",
    parameters=(
        Parameter(
            "compliance",
            "rad/(N m)",
            0.0,
            0.0,
            1e-3,
            1e-5,
            "1/K, in place of the stiffness that the model assumes",
            per_joint=True,
        ),
        Parameter(
            "relaxation",
            "s",
            0.0,
            0.0,
            0.02,
            0.001,
            "D/K, after which the deflection follows the torque",
            per_joint=True,
            shape=True,
            hidden=(0.0005, 0.005),
        ),
    ),
    law=_elasticity,
    calibrates=True,
)
