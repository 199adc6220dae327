# SPDX-License-Identifier: Apache-2.0
"""The impact map by Newton's method on the contact laws, exact to rounding.

One compiled call answers the usual problem (:mod:`impact_rs_sim.impact_map.compiled`). The rest goes step by step:
Poisson's law, problems whose data are refused with a reason, and the few for which the compiled call does not converge.
Their terms come from Pinocchio's kinematics; where Newton's method does not converge, Pinocchio's ADMM solver gives it
another first guess (:mod:`impact_rs_sim.impact_map.cones`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from impact_rs_sim.impact_map.compiled import SOLVED, Compiled, CompiledMap
from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.contacts import SUPPORT, ContactPoint, Meeting, find_contacts
from impact_rs_sim.impact_map.engine import Answer, Engine, check_energy
from impact_rs_sim.impact_map.problem import ContactImpulse, ImpactProblem, ImpactResult, Residual
from impact_rs_sim.impact_map.residual import ContactTerms
from impact_rs_sim.impact_map.restitution import solve_poisson
from impact_rs_sim.impact_map.system import System
from impact_rs_sim.physics import Physics


class ExactEngine(Engine):
    """Impact map by Newton's method on the contact laws.

    Args:
        physics: Parameters of the scene.
    """

    name = "exact"
    tolerance = 1e-5  # m/s; answers of Newton's method are below 1e-10
    laws = ("newton", "poisson")

    def __init__(self, physics: Physics) -> None:
        super().__init__(physics)
        self._compiled: CompiledMap | None = None

    def _at_once(self, problem: ImpactProblem, start: float) -> ImpactResult | None:
        if self._compiled is None or problem.physics is not self._compiled.physics:
            self._compiled = CompiledMap(problem.physics, self.models)
        found = self._compiled.answer(problem, self._points())
        if found is None or found.status[0] != SOLVED:
            return None
        judged = found.residual[0].tolist()
        if not all(amount <= self.tolerance for amount in judged):
            return None
        residual = Residual(*judged)
        before, gain = found.energy[0].tolist()
        check_energy(before, gain, found.impulse, residual, problem.restitution)
        return self._result(problem, found, residual, start)

    def _points(self) -> Sequence[ContactPoint] | None:
        """Contact points that are given; None: those where bodies touch."""
        return None

    def _result(self, problem: ImpactProblem, found: Compiled, residual: Residual, start: float) -> ImpactResult:
        velocity, twists = found.velocity[0], found.twists[0]
        joints, of_frames, column = {}, {}, 0
        for number, (name, state) in enumerate(problem.arms.items()):
            joints[name] = velocity[column : column + state.position.size]
            of_frames[name] = twists[6 * number : 6 * number + 6]
            column += state.position.size
        partners = (*joints, SUPPORT)
        points = zip(
            found.partner.tolist(), found.position, found.normal, found.impulse, found.gap.tolist(), strict=True
        )
        return ImpactResult(
            joint_velocity=joints,
            end_effector_twist=of_frames,
            object_twist=velocity[column:],
            contacts=tuple(
                ContactImpulse("object", partners[number], position, normal, impulse, gap)
                for number, position, normal, impulse, gap in points
            ),
            residual=residual,
            engine=self.name,
            iterations=int(found.steps[0]),
            elapsed=time.perf_counter() - start,
        )

    def _solve(self, problem: ImpactProblem, system: System, meetings: Sequence[Meeting]) -> Answer:
        points = self._points()
        contacts = find_contacts(problem.physics, meetings) if points is None else points
        terms = ContactTerms.of(system, contacts, problem.restitution)
        if problem.restitution_law == "poisson":
            found = solve_poisson(terms)
            return Answer(terms, found.impulses, found.velocity, found.iterations, found.residual)
        impulses, iterations = solve_contacts(terms)
        return Answer(terms, impulses, system.velocity + terms.response @ impulses.ravel(), iterations)
