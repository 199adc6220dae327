# SPDX-License-Identifier: Apache-2.0
"""Effects on the motor side of the joints: friction, and the inertia that the torque loop leaves.

Friction is stated as the desired torque feels it (tau_fric of paper eq. EOM_motor_mod).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number
from impact_rs_sim.physics import ArmPhysics


def _coulomb(arm: ArmPhysics, values: Values) -> ArmPhysics:
    friction = arm.friction
    return replace(arm, friction=replace(friction, coulomb=friction.coulomb + values["coulomb"]))


def _viscous(arm: ArmPhysics, values: Values) -> ArmPhysics:
    friction = arm.friction
    return replace(arm, friction=replace(friction, viscous=friction.viscous + values["viscous"]))


def _stribeck(arm: ArmPhysics, values: Values) -> ArmPhysics:
    if not np.any(values["breakaway"]):
        return arm  # the velocity alone means nothing, and the arm may have one already
    friction = replace(
        arm.friction,
        stribeck=arm.friction.stribeck + values["breakaway"],
        stribeck_velocity=np.full(arm.stiffness.size, number(values, "stribeck_velocity")),
    )
    return replace(arm, friction=friction)


def _motor_inertia(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return replace(arm, motor_inertia_reduced=arm.motor_inertia_reduced * number(values, "scale"))


def _added_motor_inertia(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return replace(arm, motor_inertia_reduced=arm.motor_inertia_reduced + values["inertia"])


COULOMB_FRICTION = ArmEffect(
    name="joint_coulomb_friction",
    acts_on="motor side",
    sentence="Each joint resists motion with a constant torque that flips sign with the direction of motion.",
    parameters=(Parameter("coulomb", "N m", 0.0, 0.0, 5.0, 0.1, "Coulomb friction torque", per_joint=True),),
    law=_coulomb,
)

VISCOUS_FRICTION = ArmEffect(
    name="joint_viscous_friction",
    acts_on="motor side",
    sentence="Each joint resists motion with a torque that grows with its speed.",
    parameters=(Parameter("viscous", "N m s/rad", 0.0, 0.0, 5.0, 0.1, "viscous friction", per_joint=True),),
    law=_viscous,
)

STRIBECK_FRICTION = ArmEffect(
    name="joint_stribeck_friction",
    acts_on="motor side",
    sentence="Each joint sticks a little: it resists more at low speed than when it moves fast.",
    parameters=(
        Parameter("breakaway", "N m", 0.0, 0.0, 5.0, 0.2, "torque above Coulomb at rest", per_joint=True),
        Parameter(
            "stribeck_velocity",
            "rad/s",
            0.05,
            0.01,
            0.5,
            0.02,
            "speed at which the excess has fallen to 1/e",
            shape=True,
            grid=(0.01, 0.02, 0.035, 0.05, 0.08, 0.12, 0.2, 0.35, 0.5),
            hidden=(0.03, 0.15),
        ),
    ),
    law=_stribeck,
)

MOTOR_INERTIA_SCALE = ArmEffect(
    name="motor_inertia_scale",
    acts_on="motor side",
    sentence="The motor inertia that the torque loop leaves is a multiple of the assumed one.",
    parameters=(Parameter("scale", "-", 1.0, 0.1, 3.0, 0.1, "B_theta over its assumed value"),),
    law=_motor_inertia,
)

ADDED_MOTOR_INERTIA = ArmEffect(
    name="added_motor_inertia",
    acts_on="motor side",
    sentence="The motor of a joint has more inertia than the model says.",
    parameters=(
        Parameter("inertia", "kg m^2", 0.0, 0.0, 5.0, 0.05, "added motor inertia, seen at the joint", per_joint=True),
    ),
    law=_added_motor_inertia,
    calibrates=True,
)
