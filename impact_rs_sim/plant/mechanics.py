# SPDX-License-Identifier: Apache-2.0
"""Interface of the mechanics of a plant: arms with drives, object and support, without sensors, scatter and clock.

Two simulators implement it: Bullet with separate drives (:mod:`impact_rs_sim.plant.bullet_mechanics`), and the compiled
twin (:mod:`impact_rs_sim.plant.twin_mechanics`). They share the parameters (:class:`~impact_rs_sim.physics.Physics`),
and solve contacts by different methods.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Literal, Self

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState

Simulator = Literal["bullet", "twin"]


class Mechanics(ABC):
    """Arms with drives, object and support; :meth:`load` makes them, :meth:`start` puts them in place.

    Attributes:
        physics: Parameters of the scene.
    """

    physics: Physics

    @classmethod
    @abstractmethod
    def load(cls, physics: Physics, period: float) -> Self:
        """Arms, object and support.

        Args:
            physics: Parameters of the scene.
            period: Period of the torque loop [s].

        Raises:
            NotABody: Mass and inertia of an end effector are physically inconsistent.
        """

    @abstractmethod
    def start(self, arms: Mapping[str, ArmState], drives: Mapping[str, DriveStart], object_: BodyState) -> None:
        """Set the state of arms, drives and object.

        Args:
            arms: Joint states by arm.
            drives: State of the drives by arm.
            object_: State of the object.
        """

    @abstractmethod
    def step(self, desired: Mapping[str, Array], periods: int, time: float) -> None:
        """Advance by periods of the torque loop with constant torques.

        Args:
            desired: Desired torque by arm, ``(n,)`` [N m].
            periods: Number of periods.
            time: Present time, for time-dependent loads [s].

        Raises:
            InputError: A load is not finite.
        """

    @abstractmethod
    def arm(self, name: str) -> ArmMotion:
        """Present motion of an arm."""

    @abstractmethod
    def object_state(self, number: int = 0) -> BodyState:
        """State of the object at its geometric centre, or of one of its neighbours, counted from 1."""

    @abstractmethod
    def pad_force(self, name: str) -> Array:
        """Force of the object on an arm's pad in the last step, in A, ``(3,)`` [N]."""

    @abstractmethod
    def close(self) -> None:
        """Release resources."""
