# SPDX-License-Identifier: Apache-2.0
"""Base classes of physical effects: a few parameters, and the change of the physics that they describe.

One object serves three users: the plant hides the effect, twin and impact map predict with it, the diagnosis fits it.
All call :meth:`Effect.apply` and nothing else.

Most effects change each arm separately (:class:`ArmEffect`) or the scene around the arms (:class:`SceneEffect`) and
consist of a parameter list and a function. All others derive from :class:`Effect`.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import inspect
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_rs_sim.effects.changed_bodies import bodies_differ, check_bodies
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import PINION_RADIUS_M, Array, JointType

if TYPE_CHECKING:
    from impact_rs_sim.proportion import Proportion

# Parameters per joint have units and ranges of a revolute joint. A pinion of this radius converts them for a prismatic
# joint: revolute unit -> prismatic unit, and factor of the range.
PRISMATIC_UNITS = {
    "N m": ("N", 1.0 / PINION_RADIUS_M),
    "N m/s": ("N/s", 1.0 / PINION_RADIUS_M),
    "N m s/rad": ("N s/m", 1.0 / PINION_RADIUS_M**2),
    "N m/rad": ("N/m", 1.0 / PINION_RADIUS_M**2),
    "rad/s": ("m/s", PINION_RADIUS_M),
    "rad": ("m", PINION_RADIUS_M),
    "kg m^2": ("kg", 1.0 / PINION_RADIUS_M**2),
    "rad/(N m)": ("m/N", PINION_RADIUS_M**2),
}

MAX_CACHED_SCALARS = 256  # cached lists of scalars; the library has 60 effects

SINGLE_IMPACT = ("impact",)  # phases of effects that act in tables of impacts only

Joints = int | Sequence[JointType]  # joints of an arm: their number if all are revolute, or the type of each
Values = dict[str, Array]  # by parameter name: (n,) for a parameter per joint, (1,) otherwise, in its unit


def types_of(joints: Joints) -> tuple[JointType, ...]:
    """Types of the joints: revolute or prismatic."""
    turning: JointType = "revolute"
    return (turning,) * joints if isinstance(joints, int) else tuple(joints)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, or one per joint: :meth:`scalars` spells it out.

    Attributes:
        name: Name, for example ``coulomb``; spelled out ``coulomb_joint2``.
        unit: Unit, ``-`` where it has none.
        nominal: Value at which the effect does nothing.
        lower: Smallest meaningful value; a fit that ends there widens the range, unless it is 0.
        upper: Largest meaningful value; a fit that ends there widens the range.
        scale: A noticeable change; unit of the weak prior.
        meaning: Meaning in words, for tables.
        per_joint: Whether there is one per joint.
        except_joint: Joint without this parameter, counted from 0, or from the end as -1; None: every joint has it.
        step: Step of the first finite difference; None: its scale.
        firm: Whether a fit never leaves its range, because physics or a user sets it.
        shape: Whether it has no influence while the effect is off (Stribeck velocity; position of a payload).
        grid: Starting values of a shape parameter.
        far: Starting values for a second fit after a poor one, for parameters that change the contact state.
        hidden: Range of values in blind campaigns; None: some scales away from nominal.
        prior: Prior standard deviation about nominal; None: weakly informative. A parameter with a prior may be missing
            in a model, and is then nominal.
        of_link: Whether it is a property of the link, with the same unit for every joint type.
        joint: Joint of a scalar, counted from 0; None: the effect as a whole.
        arm: Arm of the parameter; empty: all arms share it.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    scale: float
    meaning: str
    per_joint: bool = False
    except_joint: int | None = None
    step: float | None = None
    firm: bool = False
    shape: bool = False
    grid: tuple[float, ...] = ()
    far: tuple[float, ...] = ()
    hidden: tuple[float, float] | None = None
    prior: float | None = None
    of_link: bool = False
    joint: int | None = None
    arm: str = ""

    def scalars(self, joints: Joints) -> list[Parameter]:
        """The parameter as one scalar, or one scalar per joint: ``coulomb_joint1`` ..., in the unit of the joint."""
        if not self.per_joint:
            return [self]
        kinds = types_of(joints)
        without = None if self.except_joint is None else self.except_joint % max(len(kinds), 1)
        return [
            replace(self._of(kind), name=f"{self.name}_joint{joint + 1}", per_joint=False, joint=joint)
            for joint, kind in enumerate(kinds)
            if joint != without
        ]

    @property
    def difference(self) -> float:
        """Step of the first finite difference."""
        return self.scale if self.step is None else self.step

    def difference_at(self, value: float) -> float:
        """Step of a finite difference from ``value``; with a grid at most a fifth of ``value``."""
        return min(self.difference, 0.2 * abs(value)) if self.grid and value != 0.0 else self.difference

    def widened(self) -> Parameter:
        """The parameter with a range twice as wide; a firm range and a (physical) bound at 0 stay.

        A parameter with a grid keeps its range: beyond it, the effect is the limit of a simpler one.
        """
        if self.grid or self.firm:
            return self
        if self.lower > 0.0:
            return replace(self, lower=0.5 * self.lower, upper=2.0 * self.upper)
        lower, upper = (bound and 2.0 * bound - self.nominal for bound in (self.lower, self.upper))
        return replace(self, lower=lower, upper=upper)

    def within(self, lower: float, upper: float) -> Parameter:
        """The parameter with the range given by a user, in its unit."""
        grid = tuple(value for value in self.grid if lower <= value <= upper)
        return replace(self, lower=lower, upper=upper, grid=grid, firm=True)

    @property
    def possible(self) -> tuple[float, float]:
        """Plausible range for any robot: fifty times its range about nominal, on the same side of 0."""
        lower, upper = (self.nominal + 50.0 * (bound - self.nominal) for bound in (self.lower, self.upper))
        return (max(lower, 0.0) if self.lower >= 0.0 else lower, min(upper, 0.0) if self.upper <= 0.0 else upper)

    def times(self, factor: float) -> Parameter:
        """The parameter with all its values, ranges and steps multiplied by a factor."""
        return replace(
            self,
            nominal=factor * self.nominal,
            lower=factor * self.lower,
            upper=factor * self.upper,
            scale=factor * self.scale,
            step=None if self.step is None else factor * self.step,
            grid=tuple(factor * value for value in self.grid),
            far=tuple(factor * value for value in self.far),
            hidden=None if self.hidden is None else (factor * self.hidden[0], factor * self.hidden[1]),
            prior=None if self.prior is None else factor * self.prior,
        )

    @property
    def shared_name(self) -> str:
        """Name of a scalar where arms share it."""
        joint = "" if self.joint is None else f"_joint{self.joint + 1}"
        return self.name if not self.arm else self.name.removesuffix(joint).removesuffix(f"_{self.arm}") + joint

    def _of(self, kind: JointType) -> Parameter:
        """The parameter in the units of a joint type."""
        if kind == "revolute" or self.of_link or self.unit not in PRISMATIC_UNITS:
            return self
        unit, factor = PRISMATIC_UNITS[self.unit]
        return replace(self.times(factor), unit=unit)


class Effect(ABC):
    """A physical effect.

    A user-defined effect derives from this class and sets the attributes below in its class.

    Attributes:
        name: Name in model files and on the command line.
        acts_on: Part on which it acts: motor side, actuation, joint torque, link inertia, contact, object, scene or
            sensing.
        sentence: One sentence for the user.
        parameters: Fitted quantities.
        phases: Motions in which it is observable: ``free``, ``contact``, or both; ``impact``: only tables of impacts.
        calibrates: Whether it describes the bare arm, which recordings of free motion calibrate: a search in trials and
            tables considers it only if it is named. A model that contains it predicts with it everywhere.
        lasting: Whether it is constant within a session, such as the mounting of a cell: a difference of two recordings
            does not show it. Effects that calibrate an arm are lasting too.
        shown_by_load: Whether it is lasting but grows with the load: a difference of recordings with and without a load
            shows it.
        drawn: Whether blind campaigns draw it at random. Later effects are hidden only if named, so that the seeds of
            earlier campaigns hide the same effects.
        family: Common name of candidate laws of one form at several joints; empty for effects of the library or the
            model.
        reading: For an effect of the measurement: clause on the fault of the reading, in which ``{joint}``, ``{size}``,
            ``{more}`` (too much, too little) and ``{late}`` (late, early) are filled in
            (:mod:`impact_rs_analysis.diagnosis.verdicts.measurement`); empty: the meaning of its parameters is used.
        calibration: Experiment that determines it, as an imperative without a full stop; empty: unknown.
    """

    name: str
    acts_on: str
    sentence: str
    parameters: tuple[Parameter, ...]
    phases: tuple[str, ...] = ("free", "contact")
    calibrates: bool = False
    lasting: bool = False
    shown_by_load: bool = False
    drawn: bool = True
    family: str = ""
    reading: str = ""
    calibration: str = ""

    @abstractmethod
    def apply(self, physics: Physics, values: Values) -> Physics:
        """Physics with the effect.

        Args:
            physics: Physics without it.
            values: By parameter name: ``(n,)`` for a parameter per joint, ``(1,)`` otherwise, in its unit.
        """

    @property
    def shown_name(self) -> str:
        """Name in diagnoses and reports."""
        return self.name

    @property
    def of_measurement(self) -> bool:
        """Whether it is a fault of a sensor or clock, not physics of the robot."""
        return self.acts_on == "sensing"

    @property
    def may_change(self) -> bool:
        """Whether its parameters may differ between two recordings of one session."""
        return not (self.calibrates or self.lasting)

    def scalars(self, joints: Joints) -> list[Parameter]:
        """The parameters, joint by joint."""
        return [scalar for _, scalars in self.scalars_by_parameter(joints) for scalar in scalars]

    def scalars_by_parameter(self, joints: Joints) -> list[tuple[str, list[Parameter]]]:
        """Scalars of every parameter, with its name; cached, because a search calls this thousands of times."""
        return _scalars_by_parameter(self.parameters, joints)

    def apply_vector(self, physics: Physics, vector: Array) -> Physics:
        """As :meth:`apply`, with all scalars in one vector ordered as :meth:`scalars`.

        Scalars with a prior may be missing at the end of the vector; they are then nominal.

        Raises:
            InputError: The vector has a wrong length or is not finite; or arms that share a parameter per joint have
                unequal joint counts.
            NotABody: A link, an object or a motor becomes physically inconsistent (:mod:`impact_rs_sim.robots.bodies`).
        """
        by_parameter = self.scalars_by_parameter(self._joints(physics))
        count = sum(len(scalars) for _, scalars in by_parameter)
        vector = np.asarray(vector, dtype=float)
        if vector.ndim == 1 and vector.size < count:
            missing = [scalar for _, scalars in by_parameter for scalar in scalars][vector.size :]
            if all(scalar.prior is not None for scalar in missing):
                vector = np.append(vector, [scalar.nominal for scalar in missing])
        if vector.shape != (count,) or not np.isfinite(vector).all():
            raise InputError(f"effect {self.name!r} needs {count} finite numbers, got {vector.tolist()}")
        values, start = {}, 0
        for name, scalars in by_parameter:
            values[name] = vector[start : start + len(scalars)]
            start += len(scalars)
        changed = self.apply(physics, values)
        check_bodies(physics, changed, self.name)
        return changed

    def nominal(self, joints: Joints) -> Array:
        """Values of all scalars at which the effect does nothing, ``(p,)``."""
        return np.array([scalar.nominal for scalar in self.scalars(joints)])

    def steps(self, joints: Joints, at: Array) -> Array:
        """Finite-difference steps from ``at`` ``(p,)``, backwards at an upper bound, ``(p,)``."""
        steps = []
        for scalar, value in zip(self.scalars(joints), at, strict=True):
            step = scalar.difference_at(float(value))
            steps.append(step if scalar.lower <= value + step <= scalar.upper else -step)
        return np.array(steps)

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """Lower and upper bound of every scalar under ``physics`` (without the effect), ``(p,)`` each."""
        scalars = self.scalars(self._joints(physics))
        return np.array([scalar.lower for scalar in scalars]), np.array([scalar.upper for scalar in scalars])

    def bounds_in(self, worlds: Iterable[Physics]) -> tuple[Array, Array]:
        """Intersection of the bounds under several physics (at least one), ``(p,)`` each."""
        bounds = [self.bounds(physics) for physics in worlds]
        return np.max([low for low, _ in bounds], axis=0), np.min([high for _, high in bounds], axis=0)

    def changes_bodies(self, physics: Physics) -> bool:
        """Whether a step from nominal changes mass or inertia of a link, an end effector, a motor or an object."""
        joints = self._joints(physics)
        start = self.nominal(joints)
        try:
            return bodies_differ(physics, self.apply_vector(physics, start + self.steps(joints, start)))
        except NotABody:
            return True

    def with_parameters(self, change: Callable[[Parameter], Parameter]) -> Effect:
        """The effect with other ranges and steps of its parameters, which keep their names and units."""
        changed = copy.copy(self)
        object.__setattr__(changed, "parameters", tuple(change(parameter) for parameter in self.parameters))
        return changed

    def in_proportion(self, size: Proportion) -> Effect:
        """The effect with ranges and steps for a robot of another size."""
        return self.with_parameters(lambda parameter: parameter.times(size.factor(parameter.unit)))

    def complexity(self, joints: Joints) -> int:
        """Number of scalars without shape parameters; a search prefers the simpler of two equivalent effects."""
        return sum(not scalar.shape for scalar in self.scalars(joints))

    def seen_in(self, contact: bool) -> bool:
        """Whether it is observable in a motion with ``contact`` (which includes free motion), or without."""
        return contact or "free" in self.phases

    @property
    def identity(self) -> str:
        """Digest of class, name, parameters and module source of the effect.

        Cached results of twin runs depend on it, because a user-defined effect changes during its development.
        """
        kind = type(self)
        return digest(kind.__qualname__, self.name, repr(self.parameters), _source(kind.__module__))

    def _joints(self, physics: Physics) -> Joints:
        """Joints of the arms; empty if no parameter is per joint."""
        return physics.joints if any(parameter.per_joint for parameter in self.parameters) else ()


@dataclass(frozen=True)
class LawEffect(Effect):
    """An effect that consists of its parameters and a law; attributes as in :class:`Effect`.

    Attributes:
        law: Function from the arm or the physics without the effect, and values as in :meth:`Effect.apply`, to the arm
            or the physics with it.
    """

    name: str
    acts_on: str
    sentence: str
    parameters: tuple[Parameter, ...]
    law: Callable[[Any, Values], Any]
    phases: tuple[str, ...] = ("free", "contact")
    calibrates: bool = False
    lasting: bool = False
    shown_by_load: bool = False
    drawn: bool = True
    reading: str = ""
    calibration: str = ""

    @property
    def identity(self) -> str:
        """See :attr:`Effect.identity`; includes the law and the source of its module."""
        law = getattr(self.law, "__qualname__", repr(self.law))
        return digest(super().identity, law, _source(self.law.__module__))


@dataclass(frozen=True)
class ArmEffect(LawEffect):
    """An effect that changes every arm by itself: its law takes and returns an arm."""

    def apply(self, physics: Physics, values: Values) -> Physics:
        """See :meth:`Effect.apply`."""
        return replace(physics, arms={name: self.law(arm, values) for name, arm in physics.arms.items()})


@dataclass(frozen=True)
class SceneEffect(LawEffect):
    """An effect on the surroundings of the arms: its law takes and returns the physics."""

    def apply(self, physics: Physics, values: Values) -> Physics:
        """See :meth:`Effect.apply`."""
        changed: Physics = self.law(physics, values)
        return changed


@functools.lru_cache(MAX_CACHED_SCALARS)
def _scalars_by_parameter(parameters: tuple[Parameter, ...], joints: Joints) -> list[tuple[str, list[Parameter]]]:
    """Parameters by name, joint by joint."""
    return [(parameter.name, parameter.scalars(joints)) for parameter in parameters]


def number(values: Values, name: str) -> float:
    """Value of a parameter with one value."""
    return float(values[name][0])


def vector3(values: Values, names: tuple[str, str, str]) -> Array:
    """Values of three parameters with one value each, ``(3,)``."""
    return np.array([number(values, name) for name in names])


@functools.cache
def _source(module: str) -> str:
    """Source of a module; empty where it is not readable."""
    try:
        return inspect.getsource(sys.modules[module])
    except (KeyError, OSError, TypeError):
        return ""


def digest(*parts: str) -> str:
    """Digest of some texts."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()
