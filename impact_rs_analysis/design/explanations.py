# SPDX-License-Identifier: Apache-2.0
"""Explanations (rival hypotheses) that a plan shall distinguish, with their parameter uncertainty.

    centre      effects added to the model, at their estimates; empty: the unchanged model
    varied      the centre with one parameter a standard deviation off, one entry per parameter

An effect without an estimate has the unchanged model as centre, and the parameter's scale (a noticeable change) as
standard deviation: a hidden effect may be absent, or of either sign.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.base import SINGLE_IMPACT, Joints
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.experiment_plan import Aim

AS_IS = "the model as it is"


@dataclass(frozen=True)
class Explanation:
    """An explanation.

    Attributes:
        name: Its name.
        centre: Effects added to the model at their estimates.
        varied: The centre with one parameter a standard deviation off, by parameter.
    """

    name: str
    centre: Added = ()
    varied: tuple[Added, ...] = ()

    @property
    def estimated(self) -> bool:
        """Whether it says how large its effects are."""
        return bool(self.centre)

    @property
    def all_added(self) -> tuple[Added, ...]:
        """Its centre, then its varied entries."""
        return (self.centre, *self.varied)

    @property
    def effects(self) -> frozenset[str]:
        """Names of its effects."""
        return frozenset(name for added in self.all_added for name, _ in added)


@dataclass(frozen=True)
class Decision:
    """Decision that a plan supports.

    Attributes:
        aim: ``rivals``: which of the estimated explanations is right; ``effects``: which effect is missing, if any;
            ``parameters``: how large the effects of the only explanation are.
        explanations: The explanations.
        pairs: Indices of the explanations to be distinguished; empty for parameters.
    """

    aim: Aim
    explanations: tuple[Explanation, ...]
    pairs: tuple[tuple[int, int], ...] = ()

    @staticmethod
    def between(explanations: Sequence[Explanation], aim: Aim) -> Decision:
        """All pairs of explanations."""
        count = len(explanations)
        return Decision(aim, tuple(explanations), tuple((i, j) for i in range(count) for j in range(i + 1, count)))


def which_effect(
    effects: Sequence[Effect], joints: Joints, worlds: Sequence[Physics], whether_any: bool = False
) -> Decision:
    """Decision which effect is missing, if any: noticeable effects against each other and the unchanged model.

    Args:
        effects: The effects, with ranges for a robot of this size.
        joints: Joints of an arm.
        worlds: Physics under the model, for bounds.
        whether_any: Compare every effect with the unchanged model only: is any effect missing, no matter which?

    Raises:
        InputError: There is no effect to look for.
    """
    noticed = [noticeable(effect, joints, worlds) for effect in effects if effect.phases != SINGLE_IMPACT]
    if not noticed:
        raise InputError("no effect is left to look for: the model has all that trials show")
    decision = Decision.between([Explanation(AS_IS), *noticed], "effects")
    return replace(decision, pairs=tuple(pair for pair in decision.pairs if 0 in pair)) if whether_any else decision


def noticeable(effect: Effect, joints: Joints, worlds: Sequence[Physics]) -> Explanation:
    """An effect of a noticeable size: one scale of each parameter, its shapes in the middle of their grids."""
    scalars = effect.scalars(joints)
    lower, upper = effect.bounds_in(worlds)
    at = np.array([s.grid[len(s.grid) // 2] if s.shape and s.grid else s.nominal for s in scalars])
    steps = np.array([s.scale for s in scalars])
    return Explanation(
        effect.name,
        varied=tuple(
            ((effect.name, tuple(map(float, moved))),)
            for moved, scalar in zip(_moved(at, steps, lower, upper), scalars, strict=True)
            if not scalar.shape
        ),
    )


def estimated(
    name: str, centre: Added, deviations: Mapping[str, Array], bounds: Mapping[str, tuple[Array, Array]]
) -> Explanation:
    """An explanation with estimates.

    Args:
        name: Its name.
        centre: Its effects at their estimates.
        deviations: Standard deviations of their parameters by effect, ``(p,)``; 0: known.
        bounds: Their bounds by effect, ``(p,)`` each.
    """
    varied = []
    for number, (effect, values) in enumerate(centre):
        steps = deviations[effect]
        for step, moved in zip(steps, _moved(np.array(values), steps, *bounds[effect]), strict=True):
            if step > 0.0 and np.any(moved != values):
                effects = list(centre)
                effects[number] = (effect, tuple(map(float, moved)))
                varied.append(tuple(effects))
    return Explanation(name, centre, tuple(varied))


def _moved(at: Array, steps: Array, lower: Array, upper: Array) -> list[Array]:
    """Parameter vectors with one step each, away from the nearer bound."""
    vectors = []
    for index, step in enumerate(steps):
        moved = at.copy()
        up, down = at[index] + step, at[index] - step
        inside = up <= upper[index] or upper[index] - at[index] >= at[index] - lower[index]
        moved[index] = np.clip(up if inside else down, lower[index], upper[index])
        vectors.append(moved)
    return vectors
