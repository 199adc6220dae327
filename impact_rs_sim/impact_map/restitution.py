# SPDX-License-Identifier: Apache-2.0
"""Poisson's law of restitution: an impact in two phases, compression and expansion.

Newton's law sets velocities, and what the contacts then have to push to get there may be more than the impact had: with
friction u^+ can carry more energy than u^-. Poisson's law sets impulses. Compression ends where nothing closes any
more,

    u^c = u^- + H^-1 J_c^T L^c,      0 <= L^c_n  perpendicular to  J_n u^c >= 0

and expansion returns the share e of every normal impulse, and more only where something would close again,

    u^+ = u^c + H^-1 J_c^T L^e,      0 <= L^e_n - e L^c_n  perpendicular to  J_n u^+ >= 0

with Coulomb friction in either phase against the sliding velocity at its end (Glocker and Pfeiffer 1995, Anitescu and
Potra 1997; no restitution along the face). Where sliding keeps its direction, or ends, this is Routh's diagram; where
it turns round within a phase it is not, for no point of one phase slides two ways. Without friction at a single point
both laws are one. With several points they differ: a point that was not pressed has nothing to give back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.laws import ContactTerms, harden, newton
from impact_rs_sim.impact_map.problem import ImpactMapError, Residual
from impact_rs_sim.robot import Array


@dataclass(frozen=True)
class TwoPhases:
    """Answer of Poisson's law.

    Attributes:
        impulses: L^c + L^e on the object, ``(m, 3)`` [N s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        compressed: u^c, ``(nv,)`` [rad/s, m/s].
        residual: The larger one of both phases, law by law.
        iterations: Of the solver.
    """

    impulses: Array
    velocity: Array
    compressed: Array
    residual: Residual
    iterations: int


def solve_poisson(terms: ContactTerms) -> TwoPhases:
    """Compression and expansion of a problem with the restitution of ``terms``.

    Raises:
        ImpactMapError: No answer for the second phase was found.
    """
    first = replace(terms, restitution=0.0, rebound=np.zeros(len(terms.contacts)))
    pressed, iterations = solve_contacts(first)
    compressed = terms.before + terms.response @ pressed.ravel()
    judged = first.residual(pressed, compressed)
    least = terms.restitution * np.maximum(first.split(pressed)[0], 0.0)
    second = replace(first, before=compressed)
    for guess in (terms.restitution * pressed, least[:, None] * terms.normals):
        returned, converged = newton(second, guess, least)
        if converged:
            break
    else:
        raise ImpactMapError(
            f"no answer for the expansion of Poisson's law with {len(terms.contacts)} contact points; "
            "restitution_law 'newton' solves one phase only"
        )
    returned = harden(second, returned, least)
    velocity = compressed + terms.response @ returned.ravel()
    again = second.residual(returned, velocity, least)
    return TwoPhases(
        impulses=pressed + returned,
        velocity=velocity,
        compressed=compressed,
        residual=Residual(*(max(vars(judged)[law], vars(again)[law]) for law in vars(judged))),
        iterations=iterations,
    )
