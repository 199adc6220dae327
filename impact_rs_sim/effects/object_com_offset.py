"""The centre of mass of the object is not in its middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Parameter
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array


class ObjectComOffset(Effect):
    """The centre of mass of the object is not in its middle."""

    name = "object_com_offset"
    acts_on = "object"
    sentence = "The weight of the object is not in its middle."
    parameters = (
        Parameter("x", "m", 0.0, -0.08, 0.08, 0.01, "offset along the object's x axis"),
        Parameter("y", "m", 0.0, -0.08, 0.08, 0.01, "offset along the object's y axis"),
        Parameter("z", "m", 0.0, -0.08, 0.08, 0.01, "offset along the object's z axis"),
    )
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        offset = np.array([float(values[name][0]) for name in ("x", "y", "z")])
        thing = physics.object
        return replace(physics, object=replace(thing, com_offset=thing.com_offset + offset))
