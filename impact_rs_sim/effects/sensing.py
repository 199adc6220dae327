# SPDX-License-Identifier: Apache-2.0
"""Effects of sensors and their clocks: ``recorded(t) = torque(t - delay)`` beside positions and velocities at t."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number
from impact_rs_sim.physics import ArmPhysics


def _torque_delay(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return replace(arm, torque_delay=arm.torque_delay + number(values, "delay"))


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
