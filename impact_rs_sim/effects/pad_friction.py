"""Friction between pad and object differs from the assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array


class PadFriction(Effect):
    """Friction between pad and object differs from the assumed."""

    name = "pad_friction"
    acts_on = "contact"
    sentence = "The pad grips the object more or less than assumed."
    # A pad that sticks does not tell how much better it might stick: only a far step towards slipping shows anything.
    parameters = (
        Parameter("scale", "-", 1.0, 0.0, 4.0, 0.2, "friction coefficient over its assumed value", step=-0.8),
    )
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        return replace(physics, pad_friction=physics.pad_friction * float(values["scale"][0]))
