# SPDX-License-Identifier: Apache-2.0
"""What distinguishes the causes of a change: a hit that was measured, a check without one, or a new trial."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from impact_rs_analysis.following.announcement import (
    APART,
    CHECKS,
    HitlessCheck,
    ProposedMeasurement,
    measurement_words,
    most_decisive,
)
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis
from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.following.posterior import squared_distance
from impact_rs_sim.physics import Physics


def distinguishing(
    own: HitModel, hypotheses: Sequence[Hypothesis], shares: Sequence[float], last: Mapping[str, Hit]
) -> str:
    """What distinguishes explanations best, in words.

    Args:
        own: Predicts hits.
        hypotheses: The explanations, the likeliest first.
        shares: Probability of each of the others.
        last: The last hit of every condition; of none: that of the last trial that hit something.
    """
    names = [one.effect for one in hypotheses]
    measured = [(name, hit) for name, hit in last.items() if name]
    measured = measured or [(f"the kind of {hit.name}", hit) for hit in last.values()]
    found = [_hit(own, hypotheses, f"one hit of {name}", hit) for name, hit in measured]
    found += [_check(own, hypotheses, check, last[""].physics) for check in CHECKS]
    seen = {effect.name for effect in own.candidate.effects if effect.seen_in(contact=False)}
    free = [name in seen for name in names]
    if any(free) and last[""].physics.arms:
        apart = tuple(math.inf if shown != free[0] else 0.0 for shown in free[1:])
        showing = " and ".join(name for name in names if name in seen)
        found.append(ProposedMeasurement("a free motion", apart, f"{showing} would show there"))
    best = most_decisive(found, shares)
    if best is None or min(best.distances) <= APART:
        hits = own.door.unmeasured([hit for _, hit in measured])
        found += [_hit(own, hypotheses, f"a hit of {hit.condition}, not measured yet,", hit) for hit in hits]
        best = most_decisive(found, shares)
    if best is not None:
        return measurement_words(best, names[0], names[1:])
    return "no hit of these kinds and nothing that can be measured without one distinguishes them"


def _hit(own: HitModel, hypotheses: Sequence[Hypothesis], words: str, hit: Hit) -> ProposedMeasurement:
    """How well a hit distinguishes the likeliest explanation from the others."""
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
    """How well a measurement without a hit distinguishes the likeliest explanation from the others."""
    read = [_read(own, check, one, physics) for one in hypotheses]
    (first, width), *others = read
    noise = check.least / APART
    distances = tuple(abs(first - value) / math.sqrt(noise**2 + width**2 + wide**2) for value, wide in others)
    unit = f" {check.unit}" if check.unit else ""
    expected = (f"{value:.3g}{unit} if {one.effect}" for (value, _), one in zip(read, hypotheses, strict=True))
    return ProposedMeasurement(f"one measurement, {check.words},", distances, ", ".join(expected))


def _read(own: HitModel, check: HitlessCheck, hypothesis: Hypothesis, physics: Physics) -> tuple[float, float]:
    """What a measurement without a hit reads, and its standard deviation for the parameters are uncertain."""
    candidate, values = own.candidate, own.values(hypothesis)
    centre = check.of(own.scene(values, physics))
    slopes = []
    for number in hypothesis.posterior.followed:
        step = 0.1 * candidate.scale[number]
        step = step if values[number] + step <= candidate.upper[number] else -step
        step = candidate.step_with_bodies(values, number, step)
        moved = values + step * (np.arange(values.size) == number)
        slopes.append((check.of(own.scene(moved, physics)) - centre) * candidate.scale[number] / step)
    covariance = hypothesis.posterior.now.covariance
    return centre, math.sqrt(max(float(np.array(slopes) @ covariance @ np.array(slopes)), 0.0))
