"""The impact map on Pinocchio: one conic complementarity problem in the contact impulses.

    v^+ = G L + J_c u^-,     G = J_c (M + B)^-1 J_c^T           (Delassus operator, B as armature)
    K* contains  v^+ + e J_n u^- n + mu |v_t^+| n,  perpendicular to L in K      (K: Coulomb's cones, de Saxce's term)

Solved by Pinocchio's ADMM solver. Its proximal term makes redundant contacts (a singular G) harmless: it leads to
impulses without favourites among equivalent ones, and u^+ does not depend on the choice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map.contacts import ContactPoint, contact_frame, find_contacts
from impact_rs_sim.impact_map.engine import Engine
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.system import System
from impact_rs_sim.robot import Array

UPDATE_RULES = (pin.ADMMUpdateRule.OSQP, pin.ADMMUpdateRule.SPECTRAL, pin.ADMMUpdateRule.LINEAR)


class PinocchioEngine(Engine):
    """Impact map by Pinocchio's ADMM contact solver."""

    name = "pinocchio"
    tolerance = 1e-6  # m/s

    _FEASIBILITY = 1e-9  # m/s, and N s after scaling: what the solver is asked for
    _ITERATIONS = 2000  # per update rule; a typical face contact needs 100

    def _solve(self, problem: ImpactProblem, system: System) -> tuple[Sequence[ContactPoint], Array, Array, int]:
        contacts = find_contacts(problem.physics, problem.object, self._placements(problem))
        if not contacts:
            return contacts, np.zeros((0, 3)), system.velocity.copy(), 0
        frames = np.array([contact_frame(point.normal) for point in contacts])
        jacobian = (frames @ system.jacobian(contacts).reshape(len(contacts), 3, -1)).reshape(3 * len(contacts), -1)
        response = np.linalg.solve(system.inertia, jacobian.T)
        delassus = jacobian @ response
        drift = jacobian @ system.velocity
        drift[2::3] *= 1.0 + problem.restitution
        # In units of the mean inverse mass, impulses are velocities too, and one tolerance means the same to both.
        scale = np.trace(delassus) / len(delassus)
        impulse, iterations = _admm((delassus + delassus.T) / (2.0 * scale), drift, contacts, self)
        impulse = impulse / scale
        velocity = system.velocity + response @ impulse
        impulses = np.einsum("mji,mj->mi", frames, impulse.reshape(-1, 3))
        return contacts, impulses, velocity, iterations


def _admm(
    delassus: Array, drift: Array, contacts: Sequence[ContactPoint], engine: PinocchioEngine
) -> tuple[Array, int]:
    """Impulses ``(3 m,)`` in contact frames (normal last), and iterations."""
    constraints, data = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for contact in contacts:
        # The solver takes only the cone from the constraint; the operator brings geometry and inertia.
        constraint = pin.PointContactConstraintModel(_ANY_MODEL, 1, pin.SE3.Identity())
        constraint.setFriction(contact.friction)
        constraints.append(pin.ConstraintModel(constraint))
        data.append(pin.ConstraintData(constraint.createData()))
    settings = pin.ADMMSolverSettings()
    settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = engine._FEASIBILITY
    settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
    settings.max_iterations = engine._ITERATIONS
    settings.anderson_capacity = 0  # acceleration saves little here and costs the last digits
    iterations = 0
    best: tuple[float, Array] | None = None
    for rule in UPDATE_RULES:
        settings.admm_update_rule = rule
        solver, result = pin.ADMMConstraintSolver(len(drift)), pin.ADMMSolverResult()
        converged = solver.solve(pin.DelassusOperatorDense(delassus), drift, constraints, data, settings, result)
        iterations += result.iterations
        error = max(result.primal_feasibility, result.dual_feasibility, result.complementarity)
        if best is None or error < best[0]:
            best = (error, result.retrieveConstraintImpulses())
        if converged:
            break
    assert best is not None
    return best[1], iterations


def _any_model() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    return model


_ANY_MODEL = _any_model()
