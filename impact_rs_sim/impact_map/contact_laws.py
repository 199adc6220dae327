# SPDX-License-Identifier: Apache-2.0
"""Laws of a single contact point that depend on its closing speed and slip.

A measured impact (:mod:`impact_rs_sim.impact_map.measured`) obeys, at every contact point with the closing speed v and
the slip s just before the impact,

    0 <= L_n  perpendicular to  u_n^+ - e(v) max(v, 0) >= 0                    restitution
    |L_t| <= mu L_n                    against   u_t^+ + beta(s) u_t^-         friction and tangential restitution
    |M_n| <= a L_n                     against   omega_n^+ + gamma omega_n^-   drilling friction, spin restitution
    |M_t| <= b L_n                     against   omega_t^+                     rolling friction

with the velocity u and the angular velocity omega of the body relative to its partner. The first two lines are the
model of Walton (1993) with the three coefficients that Foerster et al. (1994) measured on small spheres: a sticking
contact stores tangential energy and reverses the share beta of the slip (Garwin 1969; Cross 2002), a sliding contact
has Coulomb friction. Drilling and rolling friction bound moments by the normal impulse (Johnson 1985, sec. 7.4 and 9.1;
a disc of radius R under even pressure has a = 2/3 mu R).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.physics import ContactCondition, Physics
from impact_rs_sim.robots.robot import Array

_COLUMNS = ("friction", "restitution", "tangential_restitution", "drilling_arm", "rolling_arm", "spin_restitution")


def laws_of(physics: Physics, closing: Array, slip: Array, on_support: Array) -> ContactCondition:
    """The laws at m contact points.

    Args:
        physics: Friction, restitution, and laws of single impacts.
        closing: v, ``(m,)``; below 0 the point opens, and v = 0 is used [m/s].
        slip: s, ``(m,)`` [m/s].
        on_support: Whether the partner of a point is the support, ``(m,)``.
    """
    zeros = np.zeros_like(closing)
    contact = ContactCondition(
        closing=np.maximum(closing, 0.0),
        slip=slip,
        friction=np.where(on_support, physics.support_friction, physics.pad_friction),
        restitution=zeros + physics.restitution + physics.bounce,
        tangential_restitution=zeros,
        drilling_arm=zeros,
        rolling_arm=zeros + physics.rolling_arm,
        spin_restitution=zeros,
    )
    for law in physics.contact_laws:
        contact = law.apply(contact)
    restitutions = ("restitution", "tangential_restitution", "spin_restitution")
    return replace(
        contact,
        **{name: np.clip(getattr(contact, name), 0.0, 1.0) for name in restitutions},
        **{name: np.maximum(getattr(contact, name), 0.0) for name in ("friction", "drilling_arm", "rolling_arm")},
    )


def table_of(contact: ContactCondition) -> Array:
    """The laws as :func:`impact_rs_sim._kernel.solve_impacts` takes them, ``(m, 6)``."""
    return np.column_stack([getattr(contact, name) for name in _COLUMNS])
