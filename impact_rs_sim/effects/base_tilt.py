"""The cell is not level: gravity comes from another direction."""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from impact_rs_sim.effects.base import Effect, Parameter
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array


class BaseTilt(Effect):
    """The cell is not level: gravity comes from another direction."""

    name = "base_tilt"
    acts_on = "scene"
    sentence = "The table and the robot are not level, so gravity pulls a little sideways."
    parameters = (
        Parameter("roll", "rad", 0.0, -0.2, 0.2, 0.01, "tilt about x"),
        Parameter("pitch", "rad", 0.0, -0.2, 0.2, 0.01, "tilt about y"),
    )
    phases = ("free", "contact")

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        tilt = pin.rpy.rpyToMatrix(float(values["roll"][0]), float(values["pitch"][0]), 0.0)
        return replace(physics, gravity=tilt.T @ physics.gravity)
