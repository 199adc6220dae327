"""What a physical effect is: a few parameters, and what they do to the physics.

One class serves three: the plant hides the effect, twin and impact map predict with it, the diagnosis fits it. All
three call :meth:`Effect.apply` and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, or one per joint.

    Attributes:
        name: Name, for example ``coulomb``.
        unit: Unit, ``-`` where it has none.
        nominal: Value at which the effect does nothing.
        lower: Smallest value that makes sense.
        upper: Largest value that makes sense.
        scale: A change that an engineer would call noticeable; unit of the weak prior.
        meaning: What it is, for tables.
        per_joint: Whether there is one per joint.
        step: First change that is tried when looking for its influence; None: its scale.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    scale: float
    meaning: str
    per_joint: bool = False
    step: float | None = None

    def names(self, joint_count: int) -> list[str]:
        """Names of the scalars: ``coulomb_joint1`` ... for a parameter per joint."""
        if not self.per_joint:
            return [self.name]
        return [f"{self.name}_joint{index + 1}" for index in range(joint_count)]


@dataclass(frozen=True)
class ScalarParameter:
    """One scalar of an effect, spelled out for one arm; fields as in :class:`Parameter`."""

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    scale: float
    meaning: str
    step: float


class Effect(ABC):
    """A physical effect.

    Class attributes:
        name: Name in model files and on the command line.
        acts_on: Where it acts: motor side, actuation, joint torque, link inertia, contact, object, scene.
        sentence: One sentence that a user understands.
        parameters: What can be fitted.
        phases: Where it can be seen at all: ``free`` motion, ``contact``, or both.
    """

    name: ClassVar[str]
    acts_on: ClassVar[str]
    sentence: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    phases: ClassVar[tuple[str, ...]] = ("free", "contact")

    @abstractmethod
    def apply(self, physics: Physics, values: dict[str, Array]) -> Physics:
        """Physics with the effect.

        Args:
            physics: Physics without it.
            values: By parameter name: ``(n,)`` for a parameter per joint, ``(1,)`` otherwise, in its unit.
        """

    def scalars(self, joint_count: int) -> list[ScalarParameter]:
        """The parameters, joint by joint."""
        return [
            ScalarParameter(
                name,
                parameter.unit,
                parameter.nominal,
                parameter.lower,
                parameter.upper,
                parameter.scale,
                parameter.meaning,
                parameter.scale if parameter.step is None else parameter.step,
            )
            for parameter in self.parameters
            for name in parameter.names(joint_count)
        ]

    def apply_vector(self, physics: Physics, vector: Array) -> Physics:
        """As :meth:`apply`, with all scalars in one vector ordered as :meth:`scalars`.

        Raises:
            InputError: Wrong length or not finite.
        """
        joint_count = next(iter(physics.arms.values())).facts.joint_count
        scalars = self.scalars(joint_count)
        vector = np.asarray(vector, dtype=float)
        if vector.shape != (len(scalars),) or not np.isfinite(vector).all():
            raise InputError(f"effect {self.name!r} needs {len(scalars)} finite numbers, got {vector.tolist()}")
        values, start = {}, 0
        for parameter in self.parameters:
            count = joint_count if parameter.per_joint else 1
            values[parameter.name] = vector[start : start + count]
            start += count
        return self.apply(physics, values)


def change_arms(physics: Physics, change: Callable[[ArmPhysics], ArmPhysics]) -> Physics:
    """Physics with every arm changed in the same way."""
    return replace(physics, arms={name: change(arm) for name, arm in physics.arms.items()})
