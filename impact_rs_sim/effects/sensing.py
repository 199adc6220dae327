# SPDX-License-Identifier: Apache-2.0
"""Effects of sensors: clocks, ``recorded(t) = torque(t - delay)``, and axes, ``measured = R omega``."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import SINGLE_IMPACT, ArmEffect, Parameter, SceneEffect, Values, number
from impact_rs_sim.physics import ArmPhysics, Physics

AXES = ("x", "y", "z")


def _torque_delay(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return replace(arm, torque_delay=arm.torque_delay + number(values, "delay"))


def _spin_axes(physics: Physics, values: Values) -> Physics:
    x, y, z = (before + number(values, axis) for before, axis in zip(physics.angular_velocity_axes, AXES, strict=True))
    return replace(physics, angular_velocity_axes=(x, y, z))


TORQUE_DELAY = ArmEffect(
    name="torque_delay",
    acts_on="sensing",
    sentence=(
        "The torque was recorded some milliseconds later than the positions (below 0: earlier); signals.torque.delay "
        "of the mapping takes it back."
    ),
    parameters=(Parameter("delay", "s", 0.0, -0.1, 0.1, 0.002, "delay of the torque after the positions"),),
    law=_torque_delay,
    phases=("free",),
    calibrates=True,
)

# A turn of 0.01 rad (0.6 deg) is seen as 1 % of a spin in another component; trackers are calibrated about as well.
SPIN_AXES = SceneEffect(
    name="spin_axes",
    acts_on="sensing",
    sentence="Angular velocities were measured in axes that are turned against those of positions and velocities.",
    parameters=tuple(
        Parameter(axis, "rad", 0.0, -0.5, 0.5, 0.01, f"component {axis} of the rotation vector from A to these axes")
        for axis in AXES
    ),
    law=_spin_axes,
    phases=SINGLE_IMPACT,
)
