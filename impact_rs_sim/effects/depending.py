# SPDX-License-Identifier: Apache-2.0
"""Effects whose parameters depend on a circumstance of the measurement: a session, a surface, a temperature.

A *covariate* is a level (``A``, ``B``) or a number. The parameters of an effect are then

    theta = sum_j w_j theta_j

For levels, w_j is 1 for the present level and 0 for the others; for a level without values of its own, the mean over
all levels is used. For a number x with mean m and standard deviation s over the measurements, w = (1, (x - m) / s): a
value at the mean and a change per standard deviation. For a curve, theta_j are values at knots x_j, and w_j the hat
functions of linear interpolation between them. Shape parameters do not depend on the covariate.

A fit treats such an effect as any other, a list of numbers, like :class:`~impact_rs_sim.effects.each_arm.EachArm`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import Effect, Joints, Parameter, Values, digest
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array


def level_name(value: float | str) -> str:
    """Name of a level; a number becomes text."""
    return value if isinstance(value, str) else f"{value:g}"


@dataclass(frozen=True)
class Levels:
    """A covariate with levels, named or numbers; every level has separate values.

    Attributes:
        names: The levels.
    """

    relation = "by level of"

    names: tuple[str, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the terms, ``k`` of them."""
        return self.names

    @property
    def changes(self) -> tuple[bool, ...]:
        """Whether a term is a change, which is nominally 0, ``k`` of them."""
        return (False,) * len(self.names)

    def weights(self, value: float | str) -> Array:
        """w under a level, ``(k,)``."""
        level = level_name(value)
        if level not in self.names:
            return np.full(len(self.names), 1.0 / len(self.names))
        return np.array([float(name == level) for name in self.names])


@dataclass(frozen=True)
class Slope:
    """A number as covariate; parameters depend linearly on it.

    Attributes:
        mean: Mean over the measurements, in the unit of the covariate.
        spread: Standard deviation over the measurements, in the unit of the covariate.
    """

    relation = "along"

    mean: float
    spread: float

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the terms, ``k`` of them."""
        return "at the mean", "per standard deviation"

    @property
    def changes(self) -> tuple[bool, ...]:
        """Whether a term is a change, which is nominally 0, ``k`` of them."""
        return False, True

    def weights(self, value: float | str) -> Array:
        """w at a number, ``(k,)``."""
        return np.array([1.0, (float(value) - self.mean) / self.spread])


@dataclass(frozen=True)
class Knots:
    """A number as covariate; parameters are piecewise linear in it between knots and constant beyond them.

    Attributes:
        knots: In ascending order, in the unit of the covariate, ``k`` of them.
    """

    knots: tuple[float, ...]

    @property
    def relation(self) -> str:
        """Description of the dependence."""
        return f"as a curve of {len(self.knots)} values over"

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the terms, ``k`` of them."""
        return tuple(map(level_name, self.knots))

    @property
    def changes(self) -> tuple[bool, ...]:
        """Whether a term is a change, which is nominally 0, ``k`` of them."""
        return (False,) * len(self.knots)

    def weights(self, value: float | str) -> Array:
        """w at a number, ``(k,)``."""
        return np.array([np.interp(float(value), self.knots, hat) for hat in np.eye(len(self.knots))])


Terms = Levels | Slope | Knots
"""How parameters depend on a covariate."""


class Depending(Effect):
    """An effect whose parameters depend on a covariate.

    Its scalars are those of the effect except shapes, once per term, and then the shapes.

    Args:
        effect: The effect under one circumstance.
        covariate: Name of the covariate.
        terms: How parameters depend on it.
    """

    def __init__(self, effect: Effect, covariate: str, terms: Terms) -> None:
        self.effect, self.covariate, self.terms = effect, covariate, terms
        self.name = f"{effect.name} {terms.relation} {covariate}"
        self.acts_on, self.sentence, self.phases = effect.acts_on, effect.sentence, effect.phases
        self.reading, self.calibration = effect.reading, effect.calibration
        self.calibrates, self.lasting, self.parameters = effect.calibrates, effect.lasting, effect.parameters
        self.shown_by_load = effect.shown_by_load

    @property
    def shown_name(self) -> str:
        """See :attr:`Effect.shown_name`: name of the effect; the dependence is shown separately."""
        return self.effect.shown_name

    def apply(self, physics: Physics, values: Values) -> Physics:
        """See :meth:`Effect.apply`."""
        return self.apply_vector(physics, np.concatenate(list(values.values())))

    def apply_vector(self, physics: Physics, vector: Array) -> Physics:
        """See :meth:`Effect.apply_vector`; under the circumstances of ``physics``."""
        weights, shapes = self.terms.weights(physics.circumstances[self.covariate]), self._shapes(self._joints(physics))
        scalars = np.empty(shapes.size)
        terms_size = weights.size * np.count_nonzero(~shapes)
        scalars[~shapes] = weights @ np.asarray(vector[:terms_size], dtype=float).reshape(weights.size, -1)
        scalars[shapes] = vector[terms_size:]
        return self.effect.apply_vector(physics, scalars)

    def scalars(self, joints: Joints) -> list[Parameter]:
        """See :meth:`Effect.scalars`."""
        scalars = self.effect.scalars(joints)
        terms = []
        for label, change in zip(self.terms.labels, self.terms.changes, strict=True):
            for scalar in (scalar for scalar in scalars if not scalar.shape):
                term = replace(scalar, name=f"{scalar.name} {label}")
                width = scalar.upper - scalar.lower
                terms.append(replace(term, nominal=0.0, lower=-width, upper=width, far=()) if change else term)
        return terms + [scalar for scalar in scalars if scalar.shape]

    def scalars_by_parameter(self, joints: Joints) -> list[tuple[str, list[Parameter]]]:
        """See :meth:`Effect.scalars_by_parameter`."""
        return [(scalar.name, [scalar]) for scalar in self.scalars(joints)]

    def at(self, values: Array, joints: Joints) -> Array:
        """Scalars with which the effect is the same under all circumstances, ``(p,)``.

        Args:
            values: Scalars of the effect.
            joints: Joints of an arm.
        """
        shapes = self._shapes(joints)
        terms = [np.zeros(int((~shapes).sum())) if change else values[~shapes] for change in self.terms.changes]
        return np.concatenate([*terms, values[shapes]])

    def steps(self, joints: Joints, at: Array) -> Array:
        """See :meth:`Effect.steps`: the steps of the effect, for every term."""
        shapes, count = self._shapes(joints), len(self.terms.labels)
        terms, shape = np.split(np.asarray(at), [count * np.count_nonzero(~shapes)])
        steps = []
        for term in terms.reshape(count, -1):
            scalars = np.empty(shapes.size)
            scalars[~shapes], scalars[shapes] = term, shape
            steps.append(self.effect.steps(joints, scalars))
        return np.concatenate([*(step[~shapes] for step in steps), steps[0][shapes]])

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; a change is bounded by the width of the range."""
        shapes = self._shapes(self._joints(physics))
        lower, upper = self.effect.bounds(physics)
        low, high = [], []
        for change in self.terms.changes:
            low.append(-(upper - lower)[~shapes] if change else lower[~shapes])
            high.append((upper - lower)[~shapes] if change else upper[~shapes])
        return np.concatenate([*low, lower[shapes]]), np.concatenate([*high, upper[shapes]])

    def with_parameters(self, change: Callable[[Parameter], Parameter]) -> Depending:
        """See :meth:`Effect.with_parameters`."""
        return Depending(self.effect.with_parameters(change), self.covariate, self.terms)

    @property
    def identity(self) -> str:
        """See :attr:`Effect.identity`."""
        return digest(super().identity, self.effect.identity, repr(self.terms))

    def _shapes(self, joints: Joints) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Mask of the shape parameters among the scalars."""
        return np.array([scalar.shape for scalar in self.effect.scalars(joints)], dtype=bool)

    def _joints(self, physics: Physics) -> Joints:
        """See the base."""
        return self.effect._joints(physics)
