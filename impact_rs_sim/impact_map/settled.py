# SPDX-License-Identifier: Apache-2.0
"""The settled contact: velocities when the pads have aligned with the faces that they hit.

The impact map (:mod:`impact_rs_sim.impact_map.problem`) gives the velocities just after the first simultaneous impact.
Then one edge of a pad may be off the face, or the pad may slide. It returns and hits again, in a sequence of impacts
that is unknown in detail. Its end is known: the impulses of the sequence add up to impulses at the points of the pad's
face, and the face then rests on the object,

    H (u^+ - u^-) = J_c^T (L + A n)                                momentum balance over arms (M + B) and object
    J_n,i u^+ = J_n,j u^+,   sum A_i = 0                           a face stays aligned, by impulses A without resultant
    0 <= L_n  perpendicular to  J_n u^+ >= 0                       pads and support, without restitution
    |L_t| <= mu L_n, opposing the sliding velocity J_t u^+         Coulomb friction

for all points i and j of one pad. With N a basis of the motions that keep faces aligned, u^+ = N z^+, that is an impact
map once more, with the inertia N^T H N and the Jacobian J_c N,

    N^T H N (z^+ - z^-) = N^T J_c^T L,        z^- = (N^T H N)^-1 N^T H u^-

solved as in :mod:`impact_rs_sim.impact_map.solve`; A has the least norm. If friction holds all pads and the support
gets no impulse, pads and object move on together, J_p u^+ = 0, and u^+ follows from Gauss' principle of least
constraint for velocities (Moreau 1988; Glocker 2001): the motion with J_p u^+ = 0 nearest to u^- in kinetic energy,

    u^+ = u^- - H^-1 J_p^T (J_p H^-1 J_p^T)^+ J_p u^-

Every such sequence ends there, because impulses between pad and object can make J_p u^+ = 0 in no other way.
Where the first impact leaves the faces closed already, the two maps agree.

* Kinetic energy never rises: neither A nor the normal impulses do work in u^+, and friction dissipates.
* Restitution has no influence: a bouncing body returns until its relative normal motion is lost.
* A pad that does not press in the end, sum L_n = 0, separates. It is not kept aligned, and touches as in the first
  impact.
* Points of a face are redundant: one of them may pull, L_n + A < 0, although the whole face pushes.
* The support takes part as in the first impact: an impulse that presses the object down is balanced at once, with
  friction in proportion. Friction due to the weight of the object is a finite force and drops out.
* A pad aligns as a whole if all of its face is within ``MAX_CLOSING_GAP_M`` of the object; if it arrives with an edge
  or a corner, only that contact lasts, as a hinge or a ball joint.
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

MAX_CLOSING_GAP_M = 0.01  # largest gap of a point of a pad's face that closes: 0.1 m wide and tilted by 0.1 rad

_MIN_SINGULAR_VALUE_RATIO = 1e-9  # singular values below this share of the largest are taken as 0
_MIN_PRESSING_SPEED_M_S = 1e-6  # impulse of a pressing pad, at least, times the inverse mass of its points


def settle(problem: ImpactProblem) -> ImpactResult:
    """Velocities of pads and object after the contact has settled.

    Args:
        problem: The impact problem; its restitution is not used.

    Returns:
        The velocities, and impulses L + A n of the whole sequence at the points of the pads' faces and of the support.
        The residual is that of the laws above; its penetration includes rotation of a pad relative to the face.

    Raises:
        InputError: The problem is refused (see :func:`~impact_rs_sim.impact_map.problem.check_problem`).
        ImpactMapError: The answer breaks a law by more than the tolerance of the engine ``exact``.
    """
    start = time.perf_counter()
    models = problem.physics.robot_models()
    touching = [pair for pair in check_problem(problem, models) if pair.separation <= GAP_TOLERANCE]
    system = build_system(problem, models)
    facing = [pair for pair in touching if pair.partner != SUPPORT]
    points_by_face = {_face_name(pair): find_contacts(problem.physics, [pair], MAX_CLOSING_GAP_M) for pair in facing}
    faces = {name: points for name, points in points_by_face.items() if points}
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


def _face_name(pair: ContactPair) -> str:
    """Name of a face: the pad's on the object, else the names of both bodies."""
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
        faces: Points of the pads' faces, by name of the face.
        support: Points of the support.
    """
    # Gap 0: the point of the pad coincides with the point of the object.
    aligned = [replace(point, gap=0.0) for face in faces.values() for point in face]
    terms = ContactTerms.of(system, [*aligned, *support], 0.0)
    ends = np.cumsum([0, *(len(face) for face in faces.values())])
    rows = {name: slice(*pair) for name, pair in zip(faces, itertools.pairwise(ends), strict=True)}
    lasting = tuple(faces)
    iterations = 0
    while True:
        settled = _keep_aligned(system, terms, {name: rows[name] for name in lasting})
        iterations += settled.iterations
        normal, _ = terms.split(settled.impulses)
        speeds = {name: np.sum(normal[face]) * np.mean(terms.inverse_mass[face]) for name, face in rows.items()}
        pressing_pads = tuple(name for name in lasting if speeds[name] > _MIN_PRESSING_SPEED_M_S)
        if pressing_pads == lasting:
            return replace(settled, iterations=iterations)
        lasting = pressing_pads


def _keep_aligned(system: System, terms: ContactTerms, rows: Mapping[str, slice]) -> Settled:
    """The settled contact with these pads aligned; ``rows`` are the rows of their points."""
    count, size = len(terms.contacts), system.velocity.size
    normal = np.einsum("mi,miv->mv", terms.normals, terms.jacobian.reshape(count, 3, size))  # J_n
    centring = np.zeros((count, count))  # points of a pad to their differences from its mean
    for face in rows.values():
        number = face.stop - face.start
        centring[face, face] = np.eye(number) - np.full((number, number), 1.0 / number)
    centred_normal = centring @ normal
    basis = _null_space(centred_normal)
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
    aligning = centring @ np.linalg.lstsq(centred_normal.T, missing, rcond=_MIN_SINGULAR_VALUE_RATIO)[0]  # A
    imbalance = np.linalg.solve(system.inertia, missing - normal.T @ aligning)
    laws = reduced.residual(impulses, moving)
    turning_speed = float(np.max(np.abs(centred_normal @ velocity), initial=0.0))
    residual = replace(
        laws,
        penetration_velocity=max(laws.penetration_velocity, turning_speed),
        momentum=max(laws.momentum, float(np.max(np.abs(imbalance)))),
    )
    return Settled(tuple(rows), impulses + aligning[:, None] * terms.normals, velocity, residual, iterations)


def _null_space(rows: Array) -> Array:
    """Basis of the null space of constraints ``rows`` ``(k, nv)``, which may be redundant, ``(nv, d)``."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, values, motions = np.linalg.svd(rows)
    return np.asarray(motions[int(np.sum(values > _MIN_SINGULAR_VALUE_RATIO * np.max(values))) :].T)
