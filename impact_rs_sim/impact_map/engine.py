# SPDX-License-Identifier: Apache-2.0
"""Base class of the engines of the impact map: state kept for one set of physics, one problem at a time."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import ContactPoint, Meeting
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system
from impact_rs_sim.impact_map.problem import (
    ContactImpulse,
    EnergyGain,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_problem,
)
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

ENERGY_TOLERANCE = 1e-9  # of the kinetic energy before, for rounding


@dataclass(frozen=True)
class Answer:
    """Solution found by an engine.

    Attributes:
        terms: The problem at its m contact points.
        impulses: On the object, in axes of A, ``(m, 3)`` [N s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        iterations: Of the engine's outer loop.
        residual: Where the laws are not those of Newton's restitution.
    """

    terms: ContactTerms
    impulses: Array
    velocity: Array
    iterations: int
    residual: Residual | None = None

    @property
    def energy_gain(self) -> float:
        """Kinetic energy with (M + B) after the impact minus before, ``(u^+ + u^-)^T J_c^T L / 2`` [J]."""
        passed = self.terms.jacobian @ (self.velocity + self.terms.before)
        return float(0.5 * passed @ self.impulses.ravel())


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
        impulses: On the object there, in axes of A, ``(m, 3)`` [N s].
        residual: Distance from the laws.
        engine: Name of the engine.
        iterations: Of its outer loop.
        start: Start of the computation, by ``time.perf_counter`` [s].
    """
    joints, twists, twist = system.split(velocity)
    return ImpactResult(
        joint_velocity=joints,
        end_effector_twist=twists,
        object_twist=twist,
        contacts=tuple(
            ContactImpulse("object", point.partner, point.position, point.normal, impulse, point.gap)
            for point, impulse in zip(points, impulses, strict=True)
        ),
        residual=residual,
        engine=engine,
        iterations=iterations,
        elapsed=time.perf_counter() - start,
    )


def check_energy(
    before: float, gain: float, impulses: Array, residual: Residual, restitution: float, law: str = "newton"
) -> None:
    """Refuse a result that gains more kinetic energy than its residual can explain.

    Args:
        before: Kinetic energy before the impact [J].
        gain: What the impact adds [J].
        impulses: Of the answer, ``(m, 3)`` [N s].
        residual: Distance from its laws.
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
            f"the impact gains {gain:.3g} J, {gain / before:.2%} of the kinetic energy there was: restitution e = "
            f"{restitution:g} by the law of {law!r} with several contacts can; restitution_law {hint}"
        )


class Engine(ABC):
    """Solves impact problems that share one :class:`Physics`.

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
            ImpactMapError: The answer breaks a law by more than ``tolerance``; the message names the law. Or it gains
                energy, which Newton's law allows and nature does not.
        """
        start = time.perf_counter()
        meetings = check_problem(problem, self.models)
        if problem.restitution_law not in self.laws:
            raise InputError(
                f"engine {self.name!r} knows no restitution but that of {', '.join(self.laws)}; 'exact' does",
                key="restitution_law",
                value=problem.restitution_law,
            )
        system = build_system(problem, self.models)
        answer = self._solve(problem, system, meetings)
        contacts, iterations = answer.terms.contacts, answer.iterations
        residual = answer.residual or answer.terms.residual(answer.impulses, answer.velocity)
        if not residual.largest <= self.tolerance:
            law, amount = residual.worst
            raise ImpactMapError(
                f"engine {self.name!r} breaks {law} by {amount:.3g} m/s (accepted: {self.tolerance:.3g} m/s) "
                f"with {len(contacts)} contact points after {iterations} iterations"
            )
        before, gain = system.kinetic_energy, answer.energy_gain
        check_energy(before, gain, answer.impulses, residual, problem.restitution, problem.restitution_law)
        return result_of(system, answer.velocity, contacts, answer.impulses, residual, self.name, iterations, start)

    def close(self) -> None:
        """Free resources outside Python; does nothing by default."""
        return

    @abstractmethod
    def _solve(self, problem: ImpactProblem, system: System, meetings: Sequence[Meeting]) -> Answer:
        """Solve the problem; ``meetings`` hold the relative placement of the object and its partners."""
