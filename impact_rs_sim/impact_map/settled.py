# SPDX-License-Identifier: Apache-2.0
"""The settled contact: velocities when the pads have aligned with the faces that they hit.

The impact map (:mod:`impact_rs_sim.impact_map.problem`) gives the velocities just after the first simultaneous impact.
Then one edge of a pad may be off the face, or the pad may slide. It returns and hits again: a sequence of impacts that
is unknown in detail. Its end is known: all impulses of the sequence add up to some impulses at the points of the pad's
face, and in the end the face rests on the object,

    H (u^+ - u^-) = J_c^T (L + A n)                                momentum balance over arms (M + B) and object
    J_n,i u^+ = J_n,j u^+,   sum A_i = 0                           a face stays aligned, by impulses A without resultant
    0 <= L_n  perpendicular to  J_n u^+ >= 0                       pads and support, without restitution
    |L_t| <= mu L_n, opposing the sliding velocity J_t u^+         Coulomb friction

for all points i and j of one pad. With N a basis of the motions that keep faces aligned, u^+ = N z^+, that is an impact
map once more, with the inertia N^T H N and the Jacobian J_c N,

    N^T H N (z^+ - z^-) = N^T J_c^T L,        z^- = (N^T H N)^-1 N^T H u^-

solved as in :mod:`impact_rs_sim.impact_map.solve`; A is the one of least norm. Where friction holds all pads and
the support gets no impulse, pads and object go on together, J_p u^+ = 0, and it is Gauss' principle of least constraint
for velocities (Moreau 1988; Glocker 2001): of all motions in which they do, the nearest to u^- in kinetic energy,

    u^+ = u^- - H^-1 J_p^T (J_p H^-1 J_p^T)^+ J_p u^-

Every such sequence ends there, because impulses between pad and object can make J_p u^+ = 0 in no other way.
Where the first impact leaves the faces closed already, the two maps agree.

* Kinetic energy never rises: A does no work in u^+, normal impulses do none, and friction takes some.
* Restitution has no influence: a body that bounces returns until this motion is lost.
* A pad that does not press in the end, sum L_n = 0, leaves. It is not kept aligned, and touches as in the first impact.
* Points of a face are redundant, and one of them may pull, L_n + A < 0, where the whole face pushes.
* The support takes part as in the first impact: what presses the object down while pads align is answered at once, with
  friction in proportion. Friction under the object's weight is finite, and no impulse.
* A pad aligns as a whole if all of its face is within ``MAX_CLOSING_GAP_M`` of the object; if a pad comes with an
  edge or a corner, only that contact lasts, as a hinge or a ball joint.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.impact_map.contacts import (
    GAP_TOLERANCE,
    OBJECT,
    SUPPORT,
    ContactPair,
    ContactPoint,
    find_contacts,
)
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system, solve_contacts
from impact_rs_sim.impact_map.problem import (
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_problem,
)
from impact_rs_sim.impact_map.solve import ExactEngine, result_of
from impact_rs_sim.robots.robot import Array

MAX_CLOSING_GAP_M = 0.01  # of points of a pad's face that close: a pad of 0.1 m that is tilted by 0.1 rad

_MIN_SINGULAR_VALUE_RATIO = 1e-9  # singular values below this share of the largest are taken as 0
_MIN_PRESSING_SPEED_M_S = 1e-6  # impulse of a pad times the inverse mass of its points: below it a pad does not press


def settle(problem: ImpactProblem) -> ImpactResult:
    """Velocities of pads and object after the contact has settled.

    Args:
        problem: The impact problem; its restitution is not used.

    Returns:
        The answer. Impulses L + A n of the whole sequence, at the points of the pads' faces and of the
        support. Its residual judges the laws above; penetration counts whatever turns a pad on its face.

    Raises:
        InputError: The problem is refused (see :func:`~impact_rs_sim.impact_map.problem.check_problem`).
        ImpactMapError: The answer breaks a law by more than the tolerance of the engine ``exact``.
    """
    start = time.perf_counter()
    models = problem.physics.robot_models()
    touching = [pair for pair in check_problem(problem, models) if pair.separation <= GAP_TOLERANCE]
    system = build_system(problem, models)
    facing = [pair for pair in touching if pair.partner != SUPPORT]
    found = {_name(pair): find_contacts(problem.physics, [pair], MAX_CLOSING_GAP_M) for pair in facing}
    faces = {name: points for name, points in found.items() if points}
    support = find_contacts(problem.physics, [pair for pair in touching if pair.partner == SUPPORT])
    settled = close_contacts(system, faces, support)
    if not settled.residual.largest <= ExactEngine.tolerance:
        law, amount = settled.residual.worst
        raise ImpactMapError(
            f"the settled contact breaks {law} by {amount:.3g} m/s (accepted: {ExactEngine.tolerance:.3g} m/s) "
            f"after {settled.iterations} iterations"
        )
    return result_of(
        system,
        settled.velocity,
        [*itertools.chain.from_iterable(faces.values()), *support],
        settled.impulses,
        settled.residual,
        ExactEngine.name,
        settled.iterations,
        start,
    )


def _name(pair: ContactPair) -> str:
    """Name of a face: that of the arm on the object, else of both bodies."""
    return pair.partner if pair.body == OBJECT else f"{pair.body} on {pair.partner}"


@dataclass(frozen=True)
class Settled:
    """Velocities and impulses of the settled contact.

    Attributes:
        lasting: Pads that press on the object in the end.
        impulses: L + A n on the object at the points of the pads, then of the support, in axes of A, ``(m, 3)`` [N s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        residual: Distance from the laws.
        iterations: Iterations of the solver.
    """

    lasting: tuple[str, ...]
    impulses: Array
    velocity: Array
    residual: Residual
    iterations: int


def close_contacts(
    system: System, faces: Mapping[str, Sequence[ContactPoint]], support: Sequence[ContactPoint]
) -> Settled:
    """The settled contact of a system; its accuracy is in its residual.

    Args:
        system: Inertia, kinematics and u^-.
        faces: Points of the pads' faces by arm, as many as there are.
        support: Points of the support.
    """
    aligned = [replace(point, gap=0.0) for face in faces.values() for point in face]  # the pad's point is the object's
    terms = ContactTerms.of(system, [*aligned, *support], 0.0)
    ends = np.cumsum([0, *(len(face) for face in faces.values())])
    rows = {name: slice(*pair) for name, pair in zip(faces, itertools.pairwise(ends), strict=True)}
    lasting = tuple(faces)
    iterations = 0
    while True:
        settled = _keep_aligned(system, terms, {name: rows[name] for name in lasting})
        iterations += settled.iterations
        normal, _ = terms.split(settled.impulses)
        pressing = {name: np.sum(normal[where]) * np.mean(terms.inverse_mass[where]) for name, where in rows.items()}
        pressed = tuple(name for name in lasting if pressing[name] > _MIN_PRESSING_SPEED_M_S)
        if pressed == lasting:
            return replace(settled, iterations=iterations)
        lasting = pressed


def _keep_aligned(system: System, terms: ContactTerms, rows: Mapping[str, slice]) -> Settled:
    """The settled contact with these pads aligned; ``rows`` are the rows of their points."""
    count, size = len(terms.contacts), system.velocity.size
    normal = np.einsum("mi,miv->mv", terms.normals, terms.jacobian.reshape(count, 3, size))  # J_n
    centring = np.zeros((count, count))  # points of a pad to their differences from its mean
    for where in rows.values():
        number = where.stop - where.start
        centring[where, where] = np.eye(number) - np.full((number, number), 1.0 / number)
    turning = centring @ normal
    basis = _free(turning)
    inertia = basis.T @ system.inertia @ basis
    jacobian = terms.jacobian @ basis
    response = np.asarray(np.linalg.solve(inertia, jacobian.T), dtype=np.float64)
    reduced = replace(
        terms,
        before=np.asarray(np.linalg.solve(inertia, basis.T @ system.inertia @ system.velocity), dtype=np.float64),
        jacobian=jacobian,
        response=response,
        inverse_mass=np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1),
    )
    impulses, iterations = solve_contacts(reduced)
    moving = reduced.before + response @ impulses.ravel()
    velocity = basis @ moving
    missing = system.inertia @ (velocity - system.velocity) - terms.jacobian.T @ impulses.ravel()
    aligning = centring @ np.linalg.lstsq(turning.T, missing, rcond=_MIN_SINGULAR_VALUE_RATIO)[0]  # A
    left = np.linalg.solve(system.inertia, missing - normal.T @ aligning)
    laws = reduced.residual(impulses, moving)
    turned = float(np.max(np.abs(turning @ velocity), initial=0.0))
    residual = replace(
        laws,
        penetration_velocity=max(laws.penetration_velocity, turned),
        momentum=max(laws.momentum, float(np.max(np.abs(left)))),
    )
    return Settled(tuple(rows), impulses + aligning[:, None] * terms.normals, velocity, residual, iterations)


def _free(rows: Array) -> Array:
    """Basis of the motions that ``rows`` ``(k, nv)`` leave free, ``(nv, d)``, however redundant they are."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, values, motions = np.linalg.svd(rows)
    return np.asarray(motions[int(np.sum(values > _MIN_SINGULAR_VALUE_RATIO * np.max(values))) :].T)
