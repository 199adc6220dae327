# SPDX-License-Identifier: Apache-2.0
"""Proposals to discriminate between causes of a change: a repeated hit, a check without a hit, a new trial."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from impact_rs_analysis.following.announcement import mean_of
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis
from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.inference.student import squared_distance
from impact_rs_sim.physics import Physics

# Between the predictions of two causes, in standard deviations; one measurement then decides
MIN_DECISIVE_DISTANCE = 2.0
MAX_EQUAL_DIFFERENCE = 0.02  # between probabilities that are equal in practice


class HitlessCheck(NamedTuple):
    """A measurement without a hit, which may distinguish causes.

    Attributes:
        words: Instruction to the operator.
        unit: Unit of the reading.
        of: Expected reading in a scene, in the unit.
        least: Difference that is read for certain, two standard deviations, in the unit.
    """

    words: str
    unit: str
    of: Callable[[Physics], float]
    least: float


def _weight(physics: Physics) -> float:
    """Weight of the object [N]; 0 of a fixed one."""
    return 0.0 if physics.object.fixed else float(np.linalg.norm(physics.gravity)) * physics.object.mass


HITLESS_CHECKS = (
    HitlessCheck("lift the object", "N", _weight, 0.5),
    HitlessCheck(
        "pull the object slowly over its support", "N", lambda physics: _weight(physics) * physics.support_friction, 0.5
    ),
    HitlessCheck("pull the object along the pad, by the force on it", "", lambda physics: physics.pad_friction, 0.1),
    HitlessCheck("weigh the tool", "kg", mean_of(lambda arm: arm.end_effector.mass), 0.02),
    HitlessCheck("turn each joint slowly there and back", "N m", mean_of(lambda arm: arm.friction.coulomb), 0.2),
)  # fmt: skip


@dataclass(frozen=True)
class ProposedMeasurement:
    """A hit or another measurement, and how well it distinguishes the likeliest cause from each of the others.

    Attributes:
        words: Instruction to the operator.
        distances: Distance of the expected readings, in standard deviations of their difference, by cause.
        what: Expected readings, in words.
    """

    words: str
    distances: tuple[float, ...]
    what: str


def most_decisive(found: Iterable[ProposedMeasurement], shares: Sequence[float]) -> ProposedMeasurement | None:
    """Measurement with the largest probability of a correct decision between the likeliest cause and the others.

    Args:
        found: Measurements, those that take least effort first; of some that are as good, the first is taken.
        shares: Probability of each of the others.
    """
    found = [one for one in found if max(one.distances) > MIN_DECISIVE_DISTANCE]
    right = [float(scipy.special.ndtr(0.5 * np.array(one.distances)) @ np.array(shares)) for one in found]
    return next(
        (one for one, own in zip(found, right, strict=True) if own > max(right) - MAX_EQUAL_DIFFERENCE * sum(shares)),
        None,
    )


def measurement_words(one: ProposedMeasurement, likeliest: str, others: Sequence[str]) -> str:
    """Text of a proposal, and the causes that it distinguishes."""
    parted = [other for other, distance in zip(others, one.distances, strict=True) if distance > MIN_DECISIVE_DISTANCE]
    between = "them" if len(parted) == len(others) else f"{likeliest} from {' and '.join(parted)}"
    return f"{one.words} distinguishes {between} ({one.what})"


def distinguishing(
    own: HitModel, hypotheses: Sequence[Hypothesis], shares: Sequence[float], last: Mapping[str, Hit]
) -> str:
    """Text of the measurement that discriminates best between explanations.

    Args:
        own: Predicts hits.
        hypotheses: The explanations, the likeliest first.
        shares: Probability of each of the others.
        last: Last hit of every condition; empty condition: last trial with a contact.
    """
    names = [one.effect for one in hypotheses]
    measured = [(name, hit) for name, hit in last.items() if name]
    measured = measured or [(f"the kind of {hit.name}", hit) for hit in last.values()]
    found = [_hit(own, hypotheses, f"one hit of {name}", hit) for name, hit in measured]
    found += [_check(own, hypotheses, check, last[""].physics) for check in HITLESS_CHECKS]
    seen = {effect.name for effect in own.candidate.effects if effect.seen_in(contact=False)}
    free = [name in seen for name in names]
    if any(free) and last[""].physics.arms:
        apart = tuple(math.inf if shown != free[0] else 0.0 for shown in free[1:])
        showing = " and ".join(name for name in names if name in seen)
        found.append(ProposedMeasurement("a free motion", apart, f"{showing} would show there"))
    best = most_decisive(found, shares)
    if best is None or min(best.distances) <= MIN_DECISIVE_DISTANCE:
        hits = own.hit_source.unmeasured([hit for _, hit in measured])
        found += [_hit(own, hypotheses, f"a hit of {hit.condition}, not measured yet,", hit) for hit in hits]
        best = most_decisive(found, shares)
    if best is not None:
        return measurement_words(best, names[0], names[1:])
    return "no hit of these kinds and nothing that can be measured without one distinguishes them"


def _hit(own: HitModel, hypotheses: Sequence[Hypothesis], words: str, hit: Hit) -> ProposedMeasurement:
    """Discrimination of a hit between the likeliest explanation and the others."""
    first, *others = (own.forecast(one, hit) for one in hypotheses)
    distances = []
    for other in others:
        if first is None or other is None:
            distances.append(0.0)
            continue
        apart, covariance = first[0] - other[0], 0.5 * (first[1] + other[1])
        distances.append(math.sqrt(squared_distance(apart, covariance, own.calibration.of_hits)))
    return ProposedMeasurement(words, tuple(distances), f"{min(distances):.1f} standard deviations")


def _check(
    own: HitModel, hypotheses: Sequence[Hypothesis], check: HitlessCheck, physics: Physics
) -> ProposedMeasurement:
    """Discrimination of a check without a hit between the likeliest explanation and the others."""
    read = [_read(own, check, one, physics) for one in hypotheses]
    (first, width), *others = read
    noise = check.least / MIN_DECISIVE_DISTANCE
    distances = tuple(abs(first - value) / math.sqrt(noise**2 + width**2 + wide**2) for value, wide in others)
    unit = f" {check.unit}" if check.unit else ""
    expected = (f"{value:.3g}{unit} if {one.effect}" for (value, _), one in zip(read, hypotheses, strict=True))
    return ProposedMeasurement(f"one measurement, {check.words},", distances, ", ".join(expected))


def _read(own: HitModel, check: HitlessCheck, hypothesis: Hypothesis, physics: Physics) -> tuple[float, float]:
    """Predicted reading of a check without a hit, and its standard deviation from the parameter uncertainty."""
    candidate, values = own.candidate, own.values(hypothesis)
    centre = check.of(own.scene(values, physics))
    slopes = []
    for number in hypothesis.posterior.followed:
        step = 0.1 * candidate.scale[number]
        step = step if values[number] + step <= candidate.upper[number] else -step
        step = candidate.consistent_step(values, number, step)
        moved = values + step * (np.arange(values.size) == number)
        slopes.append((check.of(own.scene(moved, physics)) - centre) * candidate.scale[number] / step)
    covariance = hypothesis.posterior.now.covariance
    return centre, math.sqrt(max(float(np.array(slopes) @ covariance @ np.array(slopes)), 0.0))
