# SPDX-License-Identifier: Apache-2.0
"""Effects on the inertia of the links: a point mass m at place p on the end effector of mass m_0, centre c_0.

    m' = m_0 + m,   m' c' = m_0 c_0 + m p,   I' = I_0 + m_0 S(c_0 - c') + m S(p - c'),   S(d) = |d|^2 1 - d d^T

m below zero takes mass away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number, vector3
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array

REMOVABLE = 0.9  # share of the mass on the flange that may be taken away


@dataclass(frozen=True)
class PayloadEffect(ArmEffect):
    """A point mass on the end effector, with its mass as first parameter."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; only part of the mass on the flange is removable, none of a bare flange."""
        lower, upper = super().bounds(physics)
        lightest = min((arm.end_effector.mass for arm in physics.arms.values()), default=0.0)
        lower[0] = max(lower[0], 0.0 - REMOVABLE * lightest)
        return lower, upper


def _payload(arm: ArmPhysics, values: Values) -> ArmPhysics:
    added, place = number(values, "mass"), vector3(values, ("com_x", "com_y", "com_z"))
    if added == 0.0:
        return arm
    before = arm.end_effector
    mass = before.mass + added
    com = (before.mass * before.com + added * place) / mass
    inertia = before.inertia + before.mass * _steiner(before.com - com) + added * _steiner(place - com)
    return replace(arm, end_effector=replace(before, mass=mass, com=com, inertia=inertia))


def _steiner(offset: Array) -> Array:
    """S of the module's head, ``(3, 3)`` [m^2]."""
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))


def _place(axis: str, nominal: float, hidden: tuple[float, float]) -> Parameter:
    meaning = f"where the added mass sits, {axis} of frame E"
    return Parameter(f"com_{axis}", "m", nominal, -0.2, 0.2, 0.02, meaning, shape=True, hidden=hidden)


END_EFFECTOR_PAYLOAD = PayloadEffect(
    name="end_effector_payload",
    acts_on="link inertia",
    sentence="Something heavier or lighter than assumed is mounted on the end effector.",
    parameters=(
        Parameter("mass", "kg", 0.0, -0.5, 3.0, 0.1, "added mass"),
        _place("x", 0.0, (-0.04, 0.04)),
        _place("y", 0.0, (-0.04, 0.04)),
        _place("z", -0.04, (-0.1, 0.02)),
    ),
    law=_payload,
)
