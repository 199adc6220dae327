# SPDX-License-Identifier: Apache-2.0
"""The impact map on Pinocchio: its contact solver, then Newton's method (:mod:`impact_rs_sim.impact_map.cones`)."""

from __future__ import annotations

from collections.abc import Sequence

from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.contacts import ContactPoint, Meeting, find_contacts
from impact_rs_sim.impact_map.engine import Answer, Engine
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.residual import ContactTerms
from impact_rs_sim.impact_map.restitution import solve_poisson
from impact_rs_sim.impact_map.system import System


class PinocchioEngine(Engine):
    """Impact map by Pinocchio's ADMM contact solver."""

    name = "pinocchio"
    tolerance = 1e-5  # m/s; most answers are below 1e-7
    laws = ("newton", "poisson")

    def _solve(self, problem: ImpactProblem, system: System, meetings: Sequence[Meeting]) -> Answer:
        terms = ContactTerms.of(system, self._contacts(meetings), problem.restitution)
        if problem.restitution_law == "poisson":
            found = solve_poisson(terms)
            return Answer(terms, found.impulses, found.velocity, found.iterations, found.residual)
        impulses, iterations = solve_contacts(terms)
        return Answer(terms, impulses, system.velocity + terms.response @ impulses.ravel(), iterations)

    def _contacts(self, meetings: Sequence[Meeting]) -> list[ContactPoint]:
        return find_contacts(self.physics, meetings)
