"""The impact carried on until the contact that lasts is closed: pads and object go on together.

The impact map (:mod:`impact_rs_sim.impact_map.problem`) answers for the moment after the first simultaneous impact. A
pad may then slide along the face that it hit, or stand off it with one edge. It comes back, hits again, and so on: a
sequence of impacts whose members nobody knows. Its end is known all the same. Whatever pad and object do to each other
on the way adds up to some impulses L_p at the points of the pad's face, so that

    H (u^+ - u^-) = J_p^T L_p + J_s^T L_s                           momentum balance over arms (M + B) and object
    J_p u^+ = 0                                                     no point of a pad's face moves on the object
    0 <= L_n  perpendicular to  J_n u^+ >= 0,   |L_t| <= mu L_n against J_t u^+              at the support, s

With N a basis of the motions that J_p allows, u^+ = N z^+, that is an impact of the support alone,

    N^T H N (z^+ - z^-) = N^T J_s^T L_s,        z^- = (N^T H N)^-1 N^T H u^-

Without the support it is Gauss' principle of least constraint for velocities (Moreau 1988; Glocker 2001): of all
motions in which pad and object go together, the nearest to u^- in kinetic energy,

    u^+ = u^- - H^-1 J_p^T (J_p H^-1 J_p^T)^+ J_p u^-

Every such sequence ends there, because impulses between pad and object can make J_p u^+ = 0 in no other way; and where
the first impact has ended like this already, the two maps agree. Restitution plays no part: what bounces comes back
until it has lost that motion. Kinetic energy never rises, for L_p does no work in u^+, and the support takes some. The
points of a face are redundant: of all L_p that mean the same the one of least norm is told, and single points of it may
pull where the whole face pushes.

**Which contacts last.** Not every pad that touches holds on. With L_N = sum L_n over the m points of its face, a pad

    sticks     L_N >= 0,   sum |L_t| <= mu L_N               its points closed in all directions
    slides     L_N >= 0,   L_t = -mu L_N / m  v_t / |v_t|    closed along the normal, friction evenly on them
    leaves     J_n u^+ >= 0                                  no impulse

and the first of these that obeys its laws is taken; for several pads, the combination that sticks most.

**The support** takes part as in the first impact, but without restitution: what presses the object down while pads
align is answered at once, with friction in proportion. Friction under the object's weight is finite, and no impulse.

A pad aligns with the face if all of it is within ``REACH`` of the object; of a pad that comes with an edge or a corner
only that closes, as a hinge or a ball joint.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE, SUPPORT, ContactPoint, contact_frame, find_contacts
from impact_rs_sim.impact_map.pinocchio import PinocchioEngine, solve_contacts
from impact_rs_sim.impact_map.problem import (
    ContactImpulse,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_problem,
)
from impact_rs_sim.impact_map.residual import SLIDING, ContactTerms
from impact_rs_sim.impact_map.system import System, build_system
from impact_rs_sim.robot import Array

REACH = 0.01  # m; points of a pad's face that are nearer than this close: a pad of 0.1 m that is tilted by 0.1 rad
STICKS, SLIDES, LEAVES = MODES = ("sticks", "slides", "leaves")

_RANK = 1e-9  # singular values below this share of the largest are none
_NONE = 1e-7  # N s or m/s: what the solver leaves, beside impulses and velocities of an impact
_TURNS = 200  # of the search for the direction of sliding


def settle(problem: ImpactProblem) -> ImpactResult:
    """The velocities with which pads and object go on together.

    Args:
        problem: The question; its restitution is not asked for.

    Returns:
        The answer. Impulses are those of the whole sequence, at the points of the pads' faces and of the support; its
        residual judges the laws above, penetration being any motion at a closed point.

    Raises:
        InputError: The question has no answer (see :func:`~impact_rs_sim.impact_map.problem.check_problem`).
        ImpactMapError: No combination of sticking, sliding and leaving pads obeys the laws.
    """
    start = time.perf_counter()
    models = {name: problem.physics.robot_model(name) for name in problem.arms}
    meetings = [meeting for meeting in check_problem(problem, models) if meeting.separation <= GAP_TOLERANCE]
    system = build_system(problem, models)
    faces = {
        meeting.partner: find_contacts(problem.physics, [meeting], REACH)
        for meeting in meetings
        if meeting.partner != SUPPORT
    }
    support = find_contacts(problem.physics, [meeting for meeting in meetings if meeting.partner == SUPPORT])
    question = _Question.of(system, faces, support)
    count = 0
    for modes in _combinations(faces):
        answer = question.answer(modes)
        count += 1
        if answer is not None and answer.residual.largest <= PinocchioEngine.tolerance:
            break
    else:
        raise ImpactMapError(
            f"no contact that lasts was found: {', '.join(faces)} neither stick nor slide nor leave by the laws to "
            f"{PinocchioEngine.tolerance:.3g} m/s"
        )
    joints, twists, twist = system.split(answer.velocity)
    points = [*itertools.chain.from_iterable(faces.values()), *support]
    return ImpactResult(
        joint_velocity=joints,
        end_effector_twist=twists,
        object_twist=twist,
        contacts=tuple(
            ContactImpulse("object", point.partner, point.position, point.normal, impulse, point.gap)
            for point, impulse in zip(points, answer.impulses, strict=True)
        ),
        residual=answer.residual,
        engine=PinocchioEngine.name,
        iterations=count,
        elapsed=time.perf_counter() - start,
    )


def _combinations(faces: Mapping[str, object]) -> list[dict[str, str]]:
    """Modes by pad, most sticking first."""
    ranked = sorted(itertools.product(range(len(MODES)), repeat=len(faces)), key=sum)
    return [dict(zip(faces, (MODES[index] for index in choice), strict=True)) for choice in ranked]


@dataclass(frozen=True)
class _Settled:
    """Impulses on the object at the points of pads and support ``(m, 3)`` [N s], u^+ ``(nv,)``, and how good it is."""

    impulses: Array
    velocity: Array
    residual: Residual


@dataclass(frozen=True)
class _Question:
    """A problem with the points of the pads' faces, as if they were aligned, and of the support.

    Attributes:
        system: Inertia and kinematics.
        rows: Where the points of each pad stand among those of all pads.
        frames: Two tangents and the normal of every pad point, ``(p, 3, 3)``.
        friction: Coulomb coefficient of every pad point, ``(p,)`` [-].
        pads: J_p in these frames, ``(p, 3, nv)``.
        support: Terms of the support's points, with no restitution.
    """

    system: System
    rows: dict[str, slice]
    frames: Array
    friction: Array
    pads: Array
    support: ContactTerms

    @classmethod
    def of(
        cls, system: System, faces: Mapping[str, Sequence[ContactPoint]], support: Sequence[ContactPoint]
    ) -> _Question:
        """The question with these points."""
        rows: dict[str, slice] = {}
        points: list[ContactPoint] = []
        for name, face in faces.items():
            rows[name] = slice(len(points), len(points) + len(face))
            points += [replace(point, gap=0.0) for point in face]  # aligned: the pad's point is the object's
        frames = np.array([contact_frame(point.normal) for point in points]).reshape(-1, 3, 3)
        return cls(
            system=system,
            rows=rows,
            frames=frames,
            friction=np.array([point.friction for point in points]),
            pads=frames @ system.jacobian(points).reshape(len(points), 3, -1),
            support=ContactTerms.of(system, support, 0.0),
        )

    def answer(self, modes: Mapping[str, str]) -> _Settled | None:
        """The answer in which pads stick, slide or leave as stated; None where it breaks their laws."""
        closed = np.zeros(self.pads.shape[:2], dtype=bool)
        for name, mode in modes.items():
            closed[self.rows[name]] = (mode == STICKS, mode == STICKS, mode != LEAVES)
        ties = _Ties.of(self, closed)
        rubbing = np.zeros(self.pads.shape[:2])  # impulses of friction at its limit
        for _ in range(_TURNS):
            answer = ties.answer(rubbing)
            wanted = self._friction_of_sliding(modes, answer)
            change = 0.5 * (wanted - rubbing)  # half of it: the direction of sliding answers to the friction
            if np.max(np.abs(self._response(change)), initial=0.0) < _NONE:
                return answer.settled if self._lawful(modes, answer) else None
            rubbing = rubbing + change
        return None

    def _response(self, impulses: Array) -> Array:
        """H^-1 J_p^T of impulses ``(p, 3)`` in the frames of their points, ``(nv,)``."""
        return np.asarray(np.linalg.solve(self.system.inertia, np.einsum("pav,pa->v", self.pads, impulses)))

    def _friction_of_sliding(self, modes: Mapping[str, str], answer: _Tied) -> Array:
        """Friction at its limit where pads slide, evenly on the points of a face, ``(p, 3)`` [N s]."""
        friction = np.zeros(self.pads.shape[:2])
        for name, mode in modes.items():
            if mode == SLIDES:
                rows = self.rows[name]
                carried = max(float(np.sum(answer.of_pads[rows, 2])), 0.0) / (rows.stop - rows.start)
                sliding = (self.pads[rows] @ answer.settled.velocity)[:, :2]
                speed = np.linalg.norm(sliding, axis=1, keepdims=True)
                friction[rows, :2] = -self.friction[rows, None] * carried * sliding / np.maximum(speed, SLIDING)
        return friction

    def _lawful(self, modes: Mapping[str, str], answer: _Tied) -> bool:
        """Whether every pad may do what it does."""
        for name, mode in modes.items():
            rows = self.rows[name]
            pressing = float(np.sum(answer.of_pads[rows, 2]))
            if mode == LEAVES:
                if np.min((self.pads[rows] @ answer.settled.velocity)[:, 2], initial=0.0) < -_NONE:
                    return False
            elif pressing < -_NONE:
                return False
            elif mode == STICKS:
                rubbing = np.linalg.norm(answer.of_pads[rows, :2], axis=1)
                if np.sum(rubbing) > float(np.mean(self.friction[rows])) * pressing + _NONE:
                    return False
        return True


@dataclass(frozen=True)
class _Tied:
    """An answer, and its impulses at the pads in the frames of their points, ``(p, 3)`` [N s]."""

    settled: _Settled
    of_pads: Array


@dataclass(frozen=True)
class _Ties:
    """The reduced problem: what is left when some directions of the pads' points are closed.

    Attributes:
        question: The whole.
        closed: Directions that are closed, ``(p, 3)``.
        basis: N, motions that leave them closed, ``(nv, d)``.
        inertia: N^T H N, ``(d, d)``.
    """

    question: _Question
    closed: Array
    basis: Array
    inertia: Array

    @classmethod
    def of(cls, question: _Question, closed: Array) -> _Ties:
        """With these directions closed, however redundant they are."""
        _, values, motions = np.linalg.svd(question.pads[closed])
        rank = int(np.sum(values > _RANK * np.max(values, initial=0.0)))
        basis = motions[rank:].T
        return cls(question, closed, basis, basis.T @ question.system.inertia @ basis)

    def answer(self, rubbing: Array) -> _Tied:
        """What happens with these further impulses at the points of the pads, ``(p, 3)`` in their frames [N s]."""
        question, basis = self.question, self.basis
        system, support = question.system, question.support
        added = np.einsum("pav,pa->v", question.pads, rubbing)
        momentum = system.inertia @ system.velocity + added
        jacobian = support.jacobian @ basis
        response = np.asarray(np.linalg.solve(self.inertia, jacobian.T), dtype=np.float64)
        reduced = replace(
            support,
            before=np.linalg.solve(self.inertia, basis.T @ momentum),
            jacobian=jacobian,
            response=response,
            inverse_mass=np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1),
        )
        of_support, _ = solve_contacts(reduced)
        moving = reduced.before + response @ of_support.ravel()
        velocity = basis @ moving
        missing = system.inertia @ velocity - momentum - support.jacobian.T @ of_support.ravel()
        of_pads = rubbing.copy()
        of_pads[self.closed] += np.linalg.lstsq(question.pads[self.closed].T, missing, rcond=_RANK)[0]
        left = missing + added - np.einsum("pav,pa->v", question.pads, of_pads)
        of_laws = reduced.residual(of_support, moving)
        residual = replace(
            of_laws,
            penetration_velocity=max(
                of_laws.penetration_velocity,
                float(np.max(np.abs(question.pads[self.closed] @ velocity), initial=0.0)),
            ),
            momentum=float(np.max(np.abs(np.linalg.solve(system.inertia, left)))),
        )
        impulses = np.vstack((np.einsum("pai,pa->pi", question.frames, of_pads), of_support))
        return _Tied(_Settled(impulses, velocity, residual), of_pads)
