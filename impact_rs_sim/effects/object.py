# SPDX-License-Identifier: Apache-2.0
"""Effects on the manipulated object and its neighbours: masses, and where its centre of mass is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import Parameter, SceneEffect, Values, number, vector3
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class ComOffsetEffect(SceneEffect):
    """An offset of the centre of mass, which stays inside the extents; no effect on a ball or a fixed object."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`."""
        lower, upper = super().bounds(physics)
        half, present = physics.object.size / 2.0, physics.object.com_offset
        return np.maximum(lower, -half - present), np.minimum(upper, half - present)


def _mass(physics: Physics, values: Values) -> Physics:
    if physics.object.fixed:
        return physics
    return replace(physics, object=_denser(physics.object, number(values, "scale")))


def _neighbour_mass(physics: Physics, values: Values) -> Physics:
    scale = number(values, "scale")
    return replace(
        physics,
        neighbours=tuple(replace(neighbour, body=_denser(neighbour.body, scale)) for neighbour in physics.neighbours),
    )


def _denser(body: ObjectPhysics, scale: float) -> ObjectPhysics:
    """A body of equal shape with ``scale`` times the mass."""
    return replace(body, mass=body.mass * scale, inertia=body.inertia * scale)


def _com_offset(physics: Physics, values: Values) -> Physics:
    object_ = physics.object
    if object_.round or object_.fixed:
        return physics
    return replace(physics, object=replace(object_, com_offset=object_.com_offset + vector3(values, ("x", "y", "z"))))


OBJECT_MASS = SceneEffect(
    name="object_mass",
    acts_on="object",
    sentence="The object is heavier or lighter than its label says.",
    parameters=(Parameter("scale", "-", 1.0, 0.2, 4.0, 0.05, "mass over its assumed value"),),
    law=_mass,
    phases=("contact",),
)

NEIGHBOUR_MASS = SceneEffect(
    name="neighbour_mass",
    acts_on="neighbour",
    sentence="The objects beside the object that is hit are heavier or lighter than their labels say.",
    parameters=(Parameter("scale", "-", 1.0, 0.2, 4.0, 0.05, "mass over its assumed value, of all neighbours"),),
    law=_neighbour_mass,
    phases=("contact",),
    drawn=False,
)

OBJECT_COM_OFFSET = ComOffsetEffect(
    name="object_com_offset",
    acts_on="object",
    sentence="The weight of the object is not in its middle.",
    # While a box stays flat on support and pad its motion hardly depends on its centre of mass; with some offset it
    # tips, so a second fit starts there (far).
    parameters=tuple(
        Parameter(axis, "m", 0.0, -0.08, 0.08, 0.01, f"offset along the object's {axis} axis", far=(-0.03, 0.03))
        for axis in "xyz"
    ),
    law=_com_offset,
    phases=("contact",),
)
