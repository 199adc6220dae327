"""A point mass on the end effector that the model does not know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


class EndEffectorPayload(Effect):
    """A point mass on the end effector that the model does not know."""

    name = "end_effector_payload"
    acts_on = "link inertia"
    sentence = "Something heavier or lighter than assumed is mounted on the end effector."
    parameters = (
        Parameter("mass", "kg", 0.0, -0.5, 3.0, 0.1, "added mass"),
        Parameter("com_x", "m", 0.0, -0.2, 0.2, 0.02, "where the added mass sits, x of frame E"),
        Parameter("com_y", "m", 0.0, -0.2, 0.2, 0.02, "where the added mass sits, y of frame E"),
        Parameter("com_z", "m", -0.04, -0.2, 0.2, 0.02, "where the added mass sits, z of frame E"),
    )

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`; masses add, inertias by the parallel-axis theorem."""
        added = float(values["mass"][0])
        place = np.array([float(values[name][0]) for name in ("com_x", "com_y", "com_z")])

        def change(arm: ArmPhysics) -> ArmPhysics:
            before = arm.end_effector
            mass = before.mass + added
            com = (before.mass * before.com + added * place) / mass
            inertia = before.inertia + before.mass * _steiner(before.com - com) + added * _steiner(place - com)
            return replace(arm, end_effector=replace(before, mass=mass, com=com, inertia=inertia))

        return change_arms(physics, change)


def _steiner(offset: Array) -> Array:
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))
