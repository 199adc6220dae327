"""Friction between object and support differs from the assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array


class SupportFriction(Effect):
    """Friction between object and support differs from the assumed."""

    name = "support_friction"
    acts_on = "contact"
    sentence = "The object slides on its support with more or less friction than assumed."
    parameters = (Parameter("scale", "-", 1.0, 0.0, 4.0, 0.1, "friction coefficient over its assumed value"),)
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        return replace(physics, support_friction=physics.support_friction * float(values["scale"][0]))
