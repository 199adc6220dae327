# SPDX-License-Identifier: Apache-2.0
"""The laws of an impact as one conic complementarity problem in the contact impulses, by Pinocchio's ADMM solver.

    v^+ = G L + J_c u^-,     G = J_c (M + B)^-1 J_c^T           (Delassus operator, B as armature)
    K* contains  v^+ + e min(J_n u^-, 0) n + mu |v_t^+| n,  perpendicular to L in K      (K: Coulomb's cones)

The term with mu is that of de Saxce.

Where the solution is not unique, that of ADMM depends on its first guess: with sliding corners u^+ differs by up to
some percent of the ante-impact speed. Newton's method (:mod:`impact_rs_sim.impact_map.laws`) continues from it to the
solution with minimum-norm impulses. Mostly ADMM is not needed (``src/laws.cpp``): with a compliance of a tenth of its
inverse mass at every point the solution is unique, shares loads evenly, and some Gauss-Seidel sweeps are a good first
guess; from there the compliance is reduced. Of 100,000 random pushes 6 needed ADMM, and none remained unsolved.

The ADMM solver needs Pinocchio 4. With the 3.9 of ROS 2 Jazzy only the compiled Newton's method is used.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map.contacts import contact_frame
from impact_rs_sim.impact_map.laws import COMPLIANCE, ContactTerms, harden, newton
from impact_rs_sim.robot import Array

COARSE = 1e-5  # m/s, tolerance of ADMM for a first guess of Newton's method
FEASIBILITY = 1e-8  # m/s, tolerance of ADMM where Newton's method did not converge from that guess
GOOD_ENOUGH = 1e-6  # m/s; no other update rule is tried below
ITERATIONS = 3000  # per update rule; a face contact takes some hundred
UPDATE_RULES = ("OSQP", "SPECTRAL", "LINEAR")  # of pin.ADMMUpdateRule


def has_admm() -> bool:
    """Whether the installed Pinocchio has the conic solver (version 4 or newer)."""
    return hasattr(pin, "ADMMConstraintSolver")


def solve_contacts(terms: ContactTerms) -> tuple[Array, int]:
    """Solve the problem.

    Args:
        terms: The problem at its m contact points.

    Returns:
        Impulses on the object ``(m, 3)`` [N s], and the number of sweeps, steps of Newton's method, and iterations of
        ADMM. Where Newton's method does not converge, the impulses are those of ADMM (without it those of Newton's
        method); how well they obey the laws is for the caller to judge.
    """
    impulses, converged, total = terms.kernel.solve(COMPLIANCE)
    if converged or not has_admm():
        return impulses, total
    guess = impulses
    for feasibility in (COARSE, FEASIBILITY):
        guess, iterations = solve_cones(terms, feasibility)
        total += iterations
        impulses, converged = newton(terms, guess)
        if converged:
            return harden(terms, impulses), total
    return guess, total


def solve_cones(terms: ContactTerms, feasibility: float = FEASIBILITY) -> tuple[Array, int]:
    """Solve the conic problem by ADMM alone, which ends at any of its answers; needs Pinocchio 4 (:func:`has_admm`).

    Args:
        terms: The problem at its m contact points.
        feasibility: Tolerance of the solver [m/s].

    Returns:
        Impulses on the object ``(m, 3)`` [N s], and the number of ADMM iterations.
    """
    count = len(terms.contacts)
    if not count:
        return np.zeros((0, 3)), 0
    frames = np.array([contact_frame(normal) for normal in terms.normals])
    jacobian = (frames @ terms.jacobian.reshape(count, 3, -1)).reshape(3 * count, -1)
    response = np.einsum("vmj,mij->vmi", terms.response.reshape(-1, count, 3), frames).reshape(-1, 3 * count)
    delassus = jacobian @ response
    drift = jacobian @ terms.before
    drift[2::3] += terms.rebound
    # In units of the mean inverse mass, impulses are velocities too, and one tolerance means the same to both.
    scale = np.trace(delassus) / len(delassus)
    operator = pin.DelassusOperatorDense((delassus + delassus.T) / (2.0 * scale))
    constraints, data = _cones(tuple(terms.friction.tolist()))
    settings = pin.ADMMSolverSettings()
    settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = feasibility
    settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
    settings.max_iterations = ITERATIONS
    iterations = 0
    best, impulse = np.inf, np.zeros(3 * count)
    for rule in UPDATE_RULES:
        settings.admm_update_rule = getattr(pin.ADMMUpdateRule, rule)
        solver, result = pin.ADMMConstraintSolver(3 * count), pin.ADMMSolverResult()
        converged = solver.solve(operator, drift, constraints, data, settings, result)
        iterations += result.iterations
        error = max(result.primal_feasibility, result.dual_feasibility, result.complementarity)
        if error < best:
            best, impulse = error, result.retrieveConstraintImpulses() / scale
        if converged or error < max(GOOD_ENOUGH, feasibility):
            break
    return np.einsum("mji,mj->mi", frames, impulse.reshape(-1, 3)), iterations


@lru_cache(maxsize=64)
def _cones(friction: tuple[float, ...]) -> tuple[pin.StdVec_ConstraintModel, pin.StdVec_ConstraintData]:
    """Coulomb's cones; the solver takes nothing else from a constraint: geometry and inertia are in the operator."""
    constraints, data = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for coefficient in friction:
        constraint = pin.PointContactConstraintModel(_any_model(), 1, pin.SE3.Identity())
        constraint.setFriction(coefficient)
        constraints.append(pin.ConstraintModel(constraint))
        data.append(pin.ConstraintData(constraint.createData()))
    return constraints, data


@lru_cache(maxsize=1)
def _any_model() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    return model
