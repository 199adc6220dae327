"""What every engine of the impact map is: warm state for one set of physics, and one question at a time."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import pinocchio as pin

from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.problem import (
    ContactImpulse,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    check_problem,
)
from impact_rs_sim.impact_map.residual import ContactTerms
from impact_rs_sim.impact_map.system import System, build_system
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel


class Engine(ABC):
    """Solves impact problems that share one :class:`Physics`.

    Args:
        physics: Parameters of the scene.
    """

    name: str
    tolerance: float  # m/s, largest accepted residual

    def __init__(self, physics: Physics) -> None:
        self.physics = physics
        self.models: Mapping[str, RobotModel] = {name: physics.robot_model(name) for name in physics.arms}

    def solve(self, problem: ImpactProblem) -> ImpactResult:
        """The post-impact state of ``problem``.

        Raises:
            InputError: The question has no answer (see :func:`check_problem`).
            ImpactMapError: The answer breaks a law by more than ``tolerance``; the message names the law.
        """
        start = time.perf_counter()
        check_problem(problem, models=self.models)
        system = build_system(problem, self.models)
        contacts, impulses, velocity, iterations = self._solve(problem, system)
        residual = ContactTerms(system, contacts, problem.restitution).residual(impulses, velocity)
        if not residual.largest <= self.tolerance:
            law, amount = residual.worst
            raise ImpactMapError(
                f"engine {self.name!r} breaks {law} by {amount:.3g} m/s (accepted: {self.tolerance:.3g} m/s) "
                f"with {len(contacts)} contact points after {iterations} iterations"
            )
        joints, twists, twist = system.split(velocity)
        return ImpactResult(
            joint_velocity=joints,
            end_effector_twist=twists,
            object_twist=twist,
            contacts=tuple(
                ContactImpulse("object", point.partner, point.position, point.normal, impulse, point.gap)
                for point, impulse in zip(contacts, impulses, strict=True)
            ),
            residual=residual,
            engine=self.name,
            iterations=iterations,
            elapsed=time.perf_counter() - start,
        )

    def close(self) -> None:
        """Give back what the engine holds outside Python; nothing by default."""
        return

    def _placements(self, problem: ImpactProblem) -> dict[str, pin.SE3]:
        return {name: self.models[name].placement(state.position) for name, state in problem.arms.items()}

    @abstractmethod
    def _solve(self, problem: ImpactProblem, system: System) -> tuple[Sequence[ContactPoint], Array, Array, int]:
        """Contact points (m), impulses on the object ``(m, 3)`` [N s], u^+ ``(nv,)``, and outer iterations."""
