"""The pad bounces more or less than assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Parameter, change_arms
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array

REDUCED_MASS = 1.0  # kg, of arm and object together; turns a coefficient into a damping


class Restitution(Effect):
    """The pad bounces more or less than assumed.

    A spring-damper with damping ratio z throws a mass back with e = exp(-pi z / sqrt(1 - z^2)); the pad's damping is
    set so that a reduced mass of 1 kg would leave with ``restitution``. The rigid impact map keeps e = 0: a
    series of bounces under a constant push ends where a single inelastic impact ends (paper sec. Single-arm
    hit-and-push scenario).
    """

    name = "restitution"
    acts_on = "contact"
    sentence = "The object bounces off the pad more or less than assumed before both move together."
    parameters = (
        Parameter("restitution", "-", 0.0, 0.0, 0.9, 0.1, "restitution of pad and object beyond the assumed"),
    )
    phases = ("contact",)

    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """See :meth:`Effect.apply`."""
        more = float(values["restitution"][0])

        def change(arm: ArmPhysics) -> ArmPhysics:
            if arm.pad_stiffness is None or more == 0.0:
                return arm
            root = 2.0 * np.sqrt(arm.pad_stiffness * REDUCED_MASS)
            present = np.clip(arm.pad_damping / root, 0.0, 0.999)
            assumed = np.exp(-np.pi * present / np.sqrt(1.0 - present**2))
            logarithm = np.log(np.clip(assumed + more, 1e-6, 0.999))
            ratio = -logarithm / np.hypot(np.pi, logarithm)
            return replace(arm, pad_damping=float(ratio * root))

        return change_arms(physics, change)
