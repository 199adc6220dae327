"""The object is heavier or lighter than assumed."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.effects.base import Effect, Parameter
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array


class ObjectMass(Effect):
    """The object is heavier or lighter than assumed."""

    name = "object_mass"
    acts_on = "object"
    sentence = "The object is heavier or lighter than its label says."
    parameters = (Parameter("scale", "-", 1.0, 0.2, 4.0, 0.05, "mass over its assumed value"),)
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        scale = float(values["scale"][0])
        thing = physics.object
        return replace(physics, object=replace(thing, mass=thing.mass * scale, inertia=thing.inertia * scale))
