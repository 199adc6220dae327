"""How parameters are moved to see what they do to the features: finite differences through the twin, in closed loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from impact_rs_analysis.evidence.runs import Condition
from impact_rs_sim.effects import Effect
from impact_rs_sim.model import JOINT_COUNT
from impact_rs_sim.robot import Array


def steps(effect: Effect, at: Array) -> Array:
    """Finite-difference step per parameter, the other way where a bound is in its way."""
    scalars = effect.scalars(JOINT_COUNT)
    return np.array(
        [
            scalar.step if scalar.lower <= value + scalar.step <= scalar.upper else -scalar.step
            for scalar, value in zip(scalars, at, strict=True)
        ]
    )


def nominal_vector(effect: Effect) -> Array:
    """Parameter values at which an effect does nothing."""
    return np.array([scalar.nominal for scalar in effect.scalars(JOINT_COUNT)])


Where = Callable[[Effect, Condition], bool]


def concerns(effect: Effect, condition: Condition) -> bool:
    """Whether an effect can be seen in a condition at all."""
    return condition.plan.expects_impact or "free" in effect.phases


def in_free_motion(effect: Effect, condition: Condition) -> bool:
    """Whether an effect can be seen in a condition in which nothing is hit."""
    return not condition.plan.expects_impact and concerns(effect, condition)
