# SPDX-License-Identifier: Apache-2.0
"""Solution of an impact problem, exact to rounding: Newton's method on the contact laws.

**Newton's law of restitution.** One compiled call (``src/impact.cpp``) goes from the kinematics of the arms to the
velocities: contact points, Delassus operator, contact laws and residuals (:mod:`impact_rs_sim.impact_map.laws`).

**Poisson's law of restitution**: an impact in two phases, compression and expansion. Newton's law sets velocities, and
the impulses that give these velocities may exceed the compression's: with friction u^+ can carry more energy than u^-.
Poisson's law sets impulses. Compression ends when no contact point closes any more,

    u^c = u^- + H^-1 J_c^T L^c,      0 <= L^c_n  perpendicular to  J_n u^c >= 0

and expansion returns the share e of every normal impulse, and more only where a point would close again,

    u^+ = u^c + H^-1 J_c^T L^e,      0 <= L^e_n - e L^c_n  perpendicular to  J_n u^+ >= 0

with Coulomb friction in either phase against the sliding velocity at its end (Glocker and Pfeiffer 1995, Anitescu and
Potra 1997; no tangential restitution). If sliding keeps its direction or ends, this is Routh's diagram; if it reverses
within a phase it is not, because a point slides in one direction per phase. Without friction both laws agree at a
single point. With several points they differ: a point without impulse in the compression has no restitution.

**Energy.** An impact adds (u^+ + u^-)^T J_c^T L / 2 to the kinetic energy. More than 0 is an error.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import (
    ALIGNED,
    GAP_TOLERANCE,
    OBJECT,
    SUPPORT,
    ContactPair,
    ContactPoint,
    find_contacts,
    support_box,
)
from impact_rs_sim.impact_map.laws import (
    COMPLIANCE,
    ContactTerms,
    System,
    build_system,
    harden,
    newton,
    solve_contacts,
)
from impact_rs_sim.impact_map.problem import (
    LIMIT_SLACK,
    PENETRATION_TOLERANCE,
    ContactImpulse,
    EnergyGain,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_physics,
    check_problem,
)
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, EndEffector
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scene import ArmState

ENERGY_TOLERANCE = 1e-9  # of the kinetic energy before the impact, for rounding
SOLVED, REFUSED = 0, 1  # status of a solved problem, and of one with invalid data
STATES = ("open", "stick", "slide")
RULES = (ALIGNED, GAP_TOLERANCE, PENETRATION_TOLERANCE, COMPLIANCE)  # tolerances of the geometry, and rho
# Index of the first point of every problem; partner, position, normal, gap and laws (m, 6) of all points.
Points = tuple[Sequence[int], Sequence[int], Array, Array, Array, Array]


def check_residual(residual: Residual, tolerance: float, engine: str, contacts: int, iterations: int) -> None:
    """Refuse a result that breaks a law.

    Raises:
        ImpactMapError: The largest residual is above ``tolerance`` [m/s], or not a number.
    """
    if not residual.largest <= tolerance:
        law, amount = residual.worst
        raise ImpactMapError(
            f"engine {engine!r} breaks {law} by {amount:.3g} m/s (accepted: {tolerance:.3g} m/s) "
            f"with {contacts} contact points after {iterations} iterations"
        )


def check_energy(
    before: float, gain: float, impulses: Array, residual: Residual, restitution: float, law: str = "newton"
) -> None:
    """Refuse a result that gains more kinetic energy than its residual can explain.

    Args:
        before: Kinetic energy before the impact [J].
        gain: Energy that the impact adds [J].
        impulses: Impulses at the contact points, ``(m, 3)`` [N s].
        residual: Distance from the contact laws.
        restitution: e [-].
        law: Law of restitution.

    Raises:
        EnergyGain: The result gains energy.
    """
    if gain <= ENERGY_TOLERANCE * before:
        return
    if gain > ENERGY_TOLERANCE * before + 2.0 * residual.largest * float(np.sum(np.abs(impulses))):
        hint = "'poisson' sets impulses instead" if law == "newton" else "a smaller e does not"
        raise EnergyGain(
            f"the impact gains {gain:.3g} J, {gain / before:.2%} of the kinetic energy before: restitution e = "
            f"{restitution:g} by the law of {law!r} with several contacts can; restitution_law {hint}"
        )


@dataclass(frozen=True)
class Solution:
    """Impulses and velocities of a solved problem.

    Attributes:
        terms: The problem at its m contact points.
        impulses: Impulses on the object, in axes of A, ``(m, 3)`` [N s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        iterations: Iterations of the engine's outer loop.
        residual: Distance from the laws; None: from Newton's law, and not yet computed.
    """

    terms: ContactTerms
    impulses: Array
    velocity: Array
    iterations: int
    residual: Residual | None = None

    @property
    def energy_gain(self) -> float:
        """Kinetic energy with (M + B) after the impact minus before, ``(u^+ + u^-)^T J_c^T L / 2`` [J]."""
        velocity_sum = self.terms.jacobian @ (self.velocity + self.terms.before)
        return float(0.5 * velocity_sum @ self.impulses.ravel())


def result_of(
    system: System,
    velocity: Array,
    points: Sequence[ContactPoint],
    impulses: Array,
    residual: Residual,
    engine: str,
    iterations: int,
    start: float,
) -> ImpactResult:
    """The result of an impact problem.

    Args:
        system: Inertia and kinematics; splits a velocity by body.
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        points: Contact points of the object.
        impulses: Impulses on the object there, in axes of A, ``(m, 3)`` [N s].
        residual: Distance from the laws.
        engine: Name of the engine.
        iterations: Iterations of its outer loop.
        start: Start of the computation, by ``time.perf_counter`` [s].
    """
    joints, twists, twist = system.split(velocity)
    return ImpactResult(
        joint_velocity=joints,
        end_effector_twist=twists,
        object_twist=twist,
        contacts=tuple(
            ContactImpulse(point.body, point.partner, point.position, point.normal, impulse, point.gap)
            for point, impulse in zip(points, impulses, strict=True)
        ),
        residual=residual,
        engine=engine,
        iterations=iterations,
        elapsed=time.perf_counter() - start,
        neighbour_twists=system.neighbour_twists(velocity),
    )


class Engine(ABC):
    """Solver of impact problems that share one :class:`Physics`.

    Args:
        physics: Parameters of the scene.
    """

    name: str
    tolerance: float  # m/s, largest accepted residual
    laws: tuple[str, ...] = ("newton",)  # of restitution

    def __init__(self, physics: Physics) -> None:
        self.physics = physics
        self.models: Mapping[str, RobotModel] = physics.robot_models()

    def solve(self, problem: ImpactProblem) -> ImpactResult:
        """The post-impact state of ``problem``.

        Raises:
            InputError: The problem is refused (see :func:`check_problem`).
            ImpactMapError: The result breaks a law by more than ``tolerance``, and the message names the law; or it
                gains energy, which Newton's law allows but no real impact does.
        """
        start = time.perf_counter()
        pairs = check_problem(problem, self.models)
        if problem.restitution_law not in self.laws:
            raise InputError(
                f"engine {self.name!r} has only the law of {', '.join(self.laws)}; 'exact' has both laws",
                key="restitution_law",
                value=problem.restitution_law,
            )
        system = build_system(problem, self.models)
        solution = self._solve(problem, system, pairs)
        contacts, impulses = solution.terms.contacts, solution.impulses
        residual = solution.residual or solution.terms.residual(impulses, solution.velocity)
        check_residual(residual, self.tolerance, self.name, len(contacts), solution.iterations)
        energy, gain = system.kinetic_energy, solution.energy_gain
        check_energy(energy, gain, impulses, residual, problem.restitution, problem.restitution_law)
        return result_of(system, solution.velocity, contacts, impulses, residual, self.name, solution.iterations, start)

    def close(self) -> None:
        """Free resources outside Python; does nothing by default."""
        return

    @abstractmethod
    def _solve(self, problem: ImpactProblem, system: System, pairs: Sequence[ContactPair]) -> Solution:
        """Solve the problem, whose object may touch the partners of ``pairs``."""


class Compiled(NamedTuple):
    """Solutions of N problems; their M contact points are concatenated.

    Attributes:
        status: ``SOLVED``, ``REFUSED``, or another number where Newton's method did not converge, ``(N,)``.
        velocity: u^+, ``(N, nv)`` [rad/s, m/s]; nan where the data are invalid.
        twists: Twists of frame E of every pad in E[A] after the impact, ``(N, 6 k)`` [m/s, rad/s].
        residual: In the order of :class:`~impact_rs_sim.impact_map.problem.Residual`, ``(N, 4)`` [m/s].
        energy: Kinetic energy before the impact, and its change by the impact, ``(N, 2)`` [J].
        steps: Steps of the solver, ``(N,)``.
        first: Index of the first contact point, ``(N + 1,)``.
        partner: Index of the partner at every point: pads from 0 on, then the support, then the objects, ``(M,)``.
        state: Index into ``STATES``, ``(M,)``.
        position: Positions on the object in A, ``(M, 3)`` [m].
        normal: Normals into the object, in A, ``(M, 3)``.
        gap: Gaps, ``(M,)`` [m].
        impulse: Impulses on the object, in A, ``(M, 3)`` [N s].
        body: Index of the object: 0, then the neighbours, ``(M,)``.
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
    body: Array


class CompiledMap:
    """The compiled impact map of one scene, with Newton's law of restitution.

    Args:
        physics: Parameters of the scene.
        models: Rigid-body models by arm.

    Raises:
        InputError: The object or a friction is impossible, or the object has a hinge or slide.
    """

    def __init__(self, physics: Physics, models: Mapping[str, RobotModel]) -> None:
        check_physics(physics)
        physics.object.check_free("the compiled map")
        self.physics = physics
        self.models = models
        self._limits = {}
        self._pads = {name: _pad_fields(pad.end_effector) for name, pad in physics.pads.items()}
        self._hands = {name: pad for name, pad in physics.pads.items() if pad.hand}
        for name in physics.arms:
            model = models[name]
            low, high = model.position_min - LIMIT_SLACK, model.position_max + LIMIT_SLACK
            free = np.full(model.joint_count, np.finfo(float).max)
            self._limits[name] = {False: (low, high, model.velocity_max + LIMIT_SLACK), True: (-free, free, free)}
        support = support_box(physics)
        self._support = None if support is None else np.concatenate((support.centre, support.half))

    def solve(self, problem: ImpactProblem, points: Sequence[ContactPoint] | None = None) -> Compiled | None:
        """The solution of one problem of this scene, N = 1; None: the restitution or the shape of an array is invalid.

        Args:
            problem: The problem.
            points: Contact points, with the friction of the scene; None: the points where the bodies touch.
        """
        if problem.restitution_law != "newton" or not 0.0 <= problem.restitution <= 1.0:
            return None
        if problem.arms.keys() != self._limits.keys() or problem.motor_inertia.keys() != self._limits.keys():
            return None
        arms: list[tuple[Any, ...]] = []
        for name, state in problem.arms.items():
            model, motor = self.models[name], problem.motor_inertia[name]
            if not model.takes(state.position, state.velocity, motor):
                return None
            inertia, jacobian, placement = model.at_impact(state.position)
            joints = model.facts.columns_of(model.facts.joints_of(state.position))
            limits = self._limits[name][problem.measured]
            shared = (joints, state.velocity, model.facts.columns_of(motor), *limits, inertia)
            arms.append((*shared, jacobian, placement.translation, placement.rotation, *self._pads[name]))
            arms += self._hands_of(name, state, shared, len(arms) - 1)
        objects = []
        for physical, body in problem.bodies.values():
            if body.position.shape != (3,) or body.rotation.shape != (3, 3) or body.twist.shape != (6,):
                return None
            inertial = (physical.mass, physical.size / 2.0, physical.inertia, physical.com_offset)
            objects.append((body.position, body.rotation, body.twist, *inertial, physical.shape.kernel))
        contact: tuple[float, ...] = (self.physics.pad_friction, self.physics.support_friction, problem.restitution)
        if len(objects) > 1:
            contact = (*contact, self.physics.object_friction)
        kernel_points = None if points is None else self._kernel_points(points, problem.restitution)
        object_, *neighbours = objects
        return Compiled(
            *_kernel.solve_impacts(
                1, arms, object_, contact, self._support, RULES, points=kernel_points, neighbours=neighbours
            )
        )

    def _hands_of(self, arm: str, state: ArmState, shared: tuple[Any, ...], carrier: int) -> list[tuple[Any, ...]]:
        """Further hands of an arm in the form of the kernel; they share its state, limits and inertia."""
        hands = []
        for name, pad in self._hands.items():
            if pad.arm == arm:
                placement = self.models[arm].placement(state.position, pad.hand)
                jacobian = self.models[arm].jacobian(state.position, pad.hand)
                hands.append((*shared, jacobian, placement.translation, placement.rotation, *self._pads[name], carrier))
        return hands

    def _kernel_points(self, points: Sequence[ContactPoint], restitution: float) -> Points:
        """Contact points in the form of the kernel."""
        names = tuple(self._pads)
        partner = [names.index(point.partner) if point.partner in names else len(names) for point in points]
        law = np.zeros((len(points), 6))
        on_pad = np.array(partner) < len(names)
        law[:, 0] = np.where(on_pad, self.physics.pad_friction, self.physics.support_friction)
        law[:, 1] = restitution
        position, normal = (np.array([getattr(point, name) for point in points]) for name in ("position", "normal"))
        return [0, len(points)], partner, position, normal, np.array([point.gap for point in points]), law


def _pad_fields(end_effector: EndEffector) -> tuple[Any, ...]:
    """Centre, axes, half extents and shape of a pad in E, in the form of the kernel."""
    pad, half = end_effector.pad_placement, np.array(end_effector.pad_size) / 2.0
    return np.array(pad.translation), np.array(pad.rotation), half, end_effector.shape.kernel


class ExactEngine(Engine):
    """Impact map by Newton's method on the contact laws.

    Args:
        physics: Parameters of the scene.
    """

    name = "exact"
    tolerance = 1e-5  # m/s; results of Newton's method are below 1e-10
    laws = ("newton", "poisson")

    def __init__(self, physics: Physics) -> None:
        super().__init__(physics)
        self._compiled: CompiledMap | None = None

    def solve(self, problem: ImpactProblem, points: Sequence[ContactPoint] | None = None) -> ImpactResult:
        """See :meth:`Engine.solve`; ``points`` replace the points where bodies touch (Newton's law only)."""
        guided = problem.physics.object.freedom is not None and points is None
        if problem.restitution_law == "poisson" or guided:
            return super().solve(problem)
        start = time.perf_counter()
        if self._compiled is None or problem.physics is not self._compiled.physics:
            self._compiled = CompiledMap(problem.physics, self.models)
        compiled = self._compiled.solve(problem, points)
        if compiled is None or compiled.status[0] == REFUSED:
            check_problem(problem, self.models)
            raise ImpactMapError("the inertia M + B of an arm is not positive definite")
        residual, steps = Residual(*compiled.residual[0].tolist()), int(compiled.steps[0])
        check_residual(residual, self.tolerance, self.name, len(compiled.gap), steps)
        before, gain = compiled.energy[0].tolist()
        check_energy(before, gain, compiled.impulse, residual, problem.restitution)
        return _result(problem, compiled, residual, start)

    def _solve(self, problem: ImpactProblem, system: System, pairs: Sequence[ContactPair]) -> Solution:
        """Poisson's law, or Newton's of an object on a hinge or slide."""
        terms = ContactTerms.of(system, find_contacts(problem.physics, pairs), problem.restitution)
        if problem.restitution_law == "poisson":
            return solve_poisson(terms)
        impulses, steps = solve_contacts(terms)
        return Solution(terms, impulses, terms.before + terms.response @ impulses.ravel(), steps)


def _result(problem: ImpactProblem, compiled: Compiled, residual: Residual, start: float) -> ImpactResult:
    """The result of one problem from its compiled solution."""
    velocity, twists = compiled.velocity[0], compiled.twists[0]
    joints, column = {}, 0
    for name, state in problem.arms.items():
        joints[name] = velocity[column : column + state.velocity.size]
        column += state.velocity.size
    pads, bodies = list(problem.physics.pads), list(problem.bodies)
    of_frames = dict(zip(pads, twists.reshape(-1, 6), strict=True))
    partners = (*pads, SUPPORT, *bodies)
    body_and_partner = compiled.body.tolist(), compiled.partner.tolist()
    points = zip(
        *body_and_partner, compiled.position, compiled.normal, compiled.impulse, compiled.gap.tolist(), strict=True
    )
    after = dict(zip(bodies, velocity[column:].reshape(-1, 6), strict=True))
    return ImpactResult(
        joint_velocity=joints,
        end_effector_twist=of_frames,
        object_twist=after.pop(OBJECT),
        contacts=tuple(
            ContactImpulse(bodies[body], partners[partner], position, normal, impulse, gap)
            for body, partner, position, normal, impulse, gap in points
        ),
        residual=residual,
        engine=ExactEngine.name,
        iterations=int(compiled.steps[0]),
        elapsed=time.perf_counter() - start,
        neighbour_twists=after,
    )


def solve_poisson(terms: ContactTerms) -> Solution:
    """Compression and expansion with the restitution of ``terms``; the residual is the larger one of both phases.

    Raises:
        ImpactMapError: No solution of the expansion was found.
    """
    compression = replace(terms, restitution=0.0, rebound=np.zeros(len(terms.contacts)))
    compressing, iterations = solve_contacts(compression)
    velocity_compressed = terms.before + terms.response @ compressing.ravel()
    residual_compression = compression.residual(compressing, velocity_compressed)
    lower_bound = terms.restitution * np.maximum(compression.split(compressing)[0], 0.0)
    expansion = replace(compression, before=velocity_compressed)
    for guess in (terms.restitution * compressing, lower_bound[:, None] * terms.normals):
        expanding, converged = newton(expansion, guess, lower_bound)
        if converged:
            break
    else:
        raise ImpactMapError(
            f"no answer for the expansion of Poisson's law with {len(terms.contacts)} contact points; "
            "restitution_law 'newton' solves one phase only"
        )
    expanding = harden(expansion, expanding, lower_bound)
    velocity = velocity_compressed + terms.response @ expanding.ravel()
    residual_expansion = expansion.residual(expanding, velocity, lower_bound)
    residual = Residual(
        *(max(vars(residual_compression)[law], vars(residual_expansion)[law]) for law in vars(residual_compression))
    )
    return Solution(terms, compressing + expanding, velocity, iterations, residual)
