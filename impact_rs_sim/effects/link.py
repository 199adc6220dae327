# SPDX-License-Identifier: Apache-2.0
"""Effects on the inertia of the links.

A point mass m at place p on the end effector of mass m_0, centre c_0:

    m' = m_0 + m,   m' c' = m_0 c_0 + m p,   I' = I_0 + m_0 S(c_0 - c') + m S(p - c'),   S(d) = |d|^2 1 - d d^T

m below zero takes mass away.

Torque is linear in the inertial parameters of the links, and depends on combinations of them only. Of link i behind a
joint that turns about its z, the mass, m z and the moment about y can be moved into link i-1 (Gautier and Khalil 1990,
direct calculation of minimum inertial parameters, eq. 21). So what is fitted of a link is where its centre lies across
the axis (:data:`LINK_COM`) and the moment of inertia about the axis (:data:`LINK_INERTIA`), or else its mass with the
centre as it is (:data:`LINK_MASS`), which stands for the same combinations with fewer numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number, vector3
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array, Link

REMOVABLE = 0.9  # share of the mass on the flange that may be taken away
REMOVABLE_MOMENT = 0.99  # the same of a link's moment of inertia about its centre, which may be that of a rod


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


def _with_links(arm: ArmPhysics, links: Sequence[Link]) -> ArmPhysics:
    """The arm with other links."""
    return replace(arm, facts=arm.facts.model_copy(update={"links": tuple(links)}))


def _link_mass(arm: ArmPhysics, values: Values) -> ArmPhysics:
    """A body of the same shape and another density."""
    pairs = zip(arm.facts.links, values["scale"].tolist(), strict=True)
    return _with_links(
        arm,
        [
            link.model_copy(
                update={"mass": scale * link.mass, "inertia": tuple(scale * moment for moment in link.inertia)}
            )
            for link, scale in pairs
        ],
    )


def _link_com(arm: ArmPhysics, values: Values) -> ArmPhysics:
    places = zip(arm.facts.links, values["com_x"].tolist(), values["com_y"].tolist(), strict=True)
    return _with_links(
        arm,
        [link.model_copy(update={"com": (link.com[0] + x, link.com[1] + y, link.com[2])}) for link, x, y in places],
    )


def _link_inertia(arm: ArmPhysics, values: Values) -> ArmPhysics:
    pairs = zip(arm.facts.links, values["inertia"].tolist(), strict=True)
    return _with_links(
        arm, [link.model_copy(update={"inertia": (*link.inertia[:5], link.inertia[5] + more)}) for link, more in pairs]
    )


@dataclass(frozen=True)
class LinkInertiaEffect(ArmEffect):
    """Moments of inertia of the links about their joint axes."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; only part of the least moment of inertia among the arms is removable."""
        lower, upper = super().bounds(physics)
        moments = [[link.inertia[5] for link in arm.facts.links] for arm in physics.arms.values()]
        return np.maximum(lower, -REMOVABLE_MOMENT * np.min(moments, axis=0)), upper


LINK_MASS = ArmEffect(
    name="link_mass",
    acts_on="link inertia",
    sentence="A link is heavier or lighter than the model says, with its centre of mass where the model has it.",
    parameters=(
        Parameter("scale", "-", 1.0, 0.2, 3.0, 0.05, "mass of the link over its assumed value", per_joint=True),
    ),
    law=_link_mass,
    calibrates=True,
)

LINK_COM = ArmEffect(
    name="link_com",
    acts_on="link inertia",
    sentence="The centre of mass of a link lies elsewhere across its joint axis than the model says.",
    parameters=tuple(
        Parameter(
            f"com_{axis}",
            "m",
            0.0,
            -0.1,
            0.1,
            0.005,
            f"shift along {axis} of the link's frame",
            per_joint=True,
            firm=True,  # within the link
        )
        for axis in "xy"
    ),
    law=_link_com,
    calibrates=True,
)

LINK_INERTIA = LinkInertiaEffect(
    name="link_inertia",
    acts_on="link inertia",
    sentence="A link resists turning about its joint axis more or less than the model says.",
    parameters=(
        Parameter("inertia", "kg m^2", 0.0, -1.0, 1.0, 0.02, "added moment about the joint axis", per_joint=True),
    ),
    law=_link_inertia,
    calibrates=True,
)
