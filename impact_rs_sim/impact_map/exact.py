# SPDX-License-Identifier: Apache-2.0
"""The default engine: Newton's method on the contact laws, exact to rounding.

One compiled call goes from the kinematics of the arms to velocities, for one problem or many (:class:`CompiledMap`,
``src/impact.cpp``): contact points, Delassus operator, laws and residuals (:mod:`impact_rs_sim.impact_map.laws`). It
takes problems with valid data and Newton's law of restitution. The rest is solved, or refused with a reason, in Python:
Poisson's law, invalid data, and the few problems for which the compiled call does not converge (6 of 100,000
random pushes). There Pinocchio's ADMM solver gives Newton's method another first guess
(:mod:`impact_rs_sim.impact_map.cones`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.contacts import (
    ALIGNED,
    GAP_TOLERANCE,
    SUPPORT,
    ContactPoint,
    Meeting,
    find_contacts,
    support_box,
)
from impact_rs_sim.impact_map.engine import Answer, Engine, check_energy
from impact_rs_sim.impact_map.laws import COMPLIANCE, ContactTerms, System
from impact_rs_sim.impact_map.problem import (
    LIMIT_SLACK,
    PENETRATION_TOLERANCE,
    ContactImpulse,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_physics,
)
from impact_rs_sim.impact_map.restitution import solve_poisson
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState

SOLVED = 0  # status of a solved problem
STATES = ("open", "stick", "slide")

RULES = (ALIGNED, GAP_TOLERANCE, PENETRATION_TOLERANCE, COMPLIANCE)
_ANYTHING = np.finfo(float).max
# Number of the first point of every problem; partner, position, normal and gap of all points, and their laws (m, 6).
Parts = tuple[Sequence[int], Sequence[int], Array, Array, Array, Array]


class Compiled(NamedTuple):
    """Solutions of N problems; their M contact points are concatenated.

    Attributes:
        status: ``SOLVED``, or another number, ``(N,)``.
        velocity: u^+, ``(N, nv)`` [rad/s, m/s]; nan where the data are invalid.
        twists: Of frame E of every arm in E[A] after the impact, ``(N, 6 k)`` [m/s, rad/s].
        residual: In the order of :class:`~impact_rs_sim.impact_map.problem.Residual`, ``(N, 4)`` [m/s].
        energy: Kinetic energy before, and what the impact adds, ``(N, 2)`` [J].
        steps: Of the solver, ``(N,)``.
        first: Number of the first contact point, ``(N + 1,)``.
        partner: Number of the arm at every point, or of arms where it is the support, ``(M,)``.
        state: Index into ``STATES``, ``(M,)``.
        position: On the object in A, ``(M, 3)`` [m].
        normal: Into the object, in A, ``(M, 3)``.
        gap: ``(M,)`` [m].
        impulse: On the object, in A, ``(M, 3)`` [N s].
    """

    status: Array
    velocity: Array
    twists: Array
    residual: Array
    energy: Array
    steps: Array
    first: Array
    partner: Array
    state: Array
    position: Array
    normal: Array
    gap: Array
    impulse: Array


class CompiledMap:
    """The compiled map of one scene.

    Args:
        physics: Parameters of the scene.
        models: Rigid-body models by arm.

    Raises:
        InputError: The object or a friction cannot be.
    """

    def __init__(self, physics: Physics, models: Mapping[str, RobotModel]) -> None:
        check_physics(physics)
        self.physics = physics
        self.models = models
        self._limits, self._pads = {}, {}
        for name, arm in physics.arms.items():
            model, pad = models[name], arm.end_effector.pad_placement
            slack = LIMIT_SLACK
            bounds = (model.position_min - slack, model.position_max + slack, model.velocity_max + slack)
            free = np.full(model.joint_count, _ANYTHING)
            self._limits[name] = {False: bounds, True: (-free, free, free)}
            half = np.array(arm.end_effector.pad_size) / 2.0
            self._pads[name] = (np.array(pad.translation), np.array(pad.rotation), half)
        object_ = physics.object
        self._object = (object_.mass, object_.size / 2.0, object_.inertia, object_.com_offset)
        self._kept: tuple[Sequence[ContactPoint], tuple[str, ...], Parts] | None = None
        support = support_box(physics)
        self._support = None if support is None else np.concatenate((support.centre, support.half))

    def answer(self, problem: ImpactProblem, points: Sequence[ContactPoint] | None = None) -> Compiled | None:
        """The solution of one problem of this scene, N = 1; None: not a problem for the compiled map.

        Args:
            problem: The problem.
            points: Contact points, whose friction is that of the scene all the same; None: where bodies touch.
        """
        if problem.restitution_law != "newton" or not 0.0 <= problem.restitution <= 1.0:
            return None
        if problem.arms.keys() != self._pads.keys() or problem.motor_inertia.keys() != self._pads.keys():
            return None
        arms = []
        for name, state in problem.arms.items():
            model, motor = self.models[name], problem.motor_inertia[name]
            shape = (model.joint_count,)
            if not state.position.shape == state.velocity.shape == motor.shape == shape:
                return None
            inertia, jacobian, place = model.at_impact(state.position)
            arms.append(
                self.arm(
                    name, state, motor, inertia, jacobian, place.translation, place.rotation, measured=problem.measured
                )
            )
        body, physics = problem.object, self.physics
        if body.position.shape != (3,) or body.rotation.shape != (3, 3) or body.twist.shape != (6,):
            return None
        contact = (physics.pad_friction, physics.support_friction, problem.restitution)
        given = None if points is None else self._given(points, tuple(problem.arms), problem.restitution)
        return self.solve(1, arms, (body.position, body.rotation, body.twist), contact, given)

    def _given(self, points: Sequence[ContactPoint], names: tuple[str, ...], restitution: float) -> Parts:
        """Contact points as the kernel takes them; kept, because one set is mostly asked about again and again."""
        if self._kept is None or self._kept[0] is not points or self._kept[1] != names:
            self._kept = (points, names, parts_of(points, names))
        parts = self._kept[2]
        on_pad, law = np.array(parts[1]) < len(names), parts[-1]
        law[:, 0] = np.where(on_pad, self.physics.pad_friction, self.physics.support_friction)
        law[:, 1] = restitution
        return parts

    def arm(
        self,
        name: str,
        state: ArmState,
        motor: Array,
        inertia: Array,
        jacobian: Array,
        position: Array,
        rotation: Array,
        measured: bool = False,
    ) -> tuple[Array, ...]:
        """One arm as :func:`impact_rs_sim._kernel.solve_impacts` takes it."""
        limits = self._limits[name][measured]
        of_frame = (inertia, jacobian, position, rotation)
        return (state.position, state.velocity, motor, *limits, *of_frame, *self._pads[name])

    def solve(
        self,
        count: int,
        arms: Sequence[Sequence[Array]],
        body: tuple[Array, Array, Array],
        contact: tuple[Array | float, Array | float, Array | float],
        points: Parts | None = None,
    ) -> Compiled:
        """Solutions of ``count`` problems; arguments as :func:`impact_rs_sim._kernel.solve_impacts` takes them."""
        object_ = (*body, *self._object)
        return Compiled(*_kernel.solve_impacts(count, arms, object_, contact, self._support, RULES, points=points))


def parts_of(points: Sequence[ContactPoint], names: Sequence[str]) -> Parts:
    """Contact points of one problem as the kernel takes them, without laws; ``names`` are those of the arms."""
    return (
        [0, len(points)],
        [names.index(point.partner) if point.partner in names else len(names) for point in points],
        np.array([point.position for point in points]),
        np.array([point.normal for point in points]),
        np.array([point.gap for point in points]),
        np.zeros((len(points), 6)),
    )


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

    def solve(self, problem: ImpactProblem) -> ImpactResult:
        """See :meth:`Engine.solve`."""
        return self._compiled_result(problem, time.perf_counter()) or super().solve(problem)

    def _compiled_result(self, problem: ImpactProblem, start: float) -> ImpactResult | None:
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
