# SPDX-License-Identifier: Apache-2.0
"""Effects between the desired torque and the motors: ``delivered(t) = gain * desired(t - delay) + offset``."""

from __future__ import annotations

from impact_rs_sim.effects.base import ArmEffect, Parameter
from impact_rs_sim.effects.quantity_laws import Added, Multiplied

TORQUE_OFFSET = ArmEffect(
    name="torque_offset",
    acts_on="actuation",
    sentence=(
        "Each joint delivers a constant torque that was not commanded, for example from a torque sensor with an offset."
    ),
    parameters=(Parameter("offset", "N m", 0.0, -5.0, 5.0, 0.1, "added torque", per_joint=True),),
    law=Added("torque_offset", ("offset",), per_joint=True),
)

TORQUE_GAIN = ArmEffect(
    name="torque_gain",
    acts_on="actuation",
    sentence=(
        "Each joint delivers a few percent more or less torque than commanded; where no command was recorded, its "
        "torque sensor may as well read so."
    ),
    parameters=(Parameter("gain", "-", 1.0, 0.7, 1.3, 0.01, "delivered over desired torque", per_joint=True),),
    law=Multiplied("torque_gain", "gain", per_joint=True),
    lasting=True,
)

ACTUATION_DELAY = ArmEffect(
    name="actuation_delay",
    acts_on="actuation",
    sentence="Torque commands reach the joints some milliseconds late.",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.02, 0.001, "delay of the desired torque"),),
    law=Added("actuation_delay", ("delay",)),
)
