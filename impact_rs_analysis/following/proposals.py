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

# Between the predictions of two causes, in standard deviations; above, one measurement decides
MIN_DECISIVE_DISTANCE = 2.0
MAX_EQUAL_DIFFERENCE = 0.02  # between probabilities that are equal in practice


class HitlessCheck(NamedTuple):
    """A measurement without a hit, which may distinguish causes.

    Attributes:
        words: Instruction to the operator.
        unit: Unit of the reading.
        reading: Expected reading in a scene, in the unit.
        resolution: Smallest difference that is read for certain: two standard deviations, in the unit.
    """

    words: str
    unit: str
    reading: Callable[[Physics], float]
    resolution: float


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
        expected: Expected readings, in words.
    """

    words: str
    distances: tuple[float, ...]
    expected: str


def most_decisive(measurements: Iterable[ProposedMeasurement], shares: Sequence[float]) -> ProposedMeasurement | None:
    """Measurement with the largest probability of a correct decision between the likeliest cause and the others.

    Args:
        measurements: Measurements, least effort first; the first of several equally good ones is chosen.
        shares: Probability of each of the other causes.
    """
    decisive = [m for m in measurements if max(m.distances) > MIN_DECISIVE_DISTANCE]
    correct = [float(scipy.special.ndtr(0.5 * np.array(m.distances)) @ np.array(shares)) for m in decisive]
    least = max(correct, default=0.0) - MAX_EQUAL_DIFFERENCE * sum(shares)
    return next((m for m, probability in zip(decisive, correct, strict=True) if probability > least), None)


def measurement_words(measurement: ProposedMeasurement, likeliest: str, causes: Sequence[str]) -> str:
    """Text of a proposal, and the causes that it distinguishes."""
    distances = zip(causes, measurement.distances, strict=True)
    apart = [cause for cause, distance in distances if distance > MIN_DECISIVE_DISTANCE]
    between = "them" if len(apart) == len(causes) else f"{likeliest} from {' and '.join(apart)}"
    return f"{measurement.words} distinguishes {between} ({measurement.expected})"


def distinguishing(
    hit_model: HitModel, hypotheses: Sequence[Hypothesis], shares: Sequence[float], last: Mapping[str, Hit]
) -> str:
    """Text of the measurement that discriminates best between explanations.

    Args:
        hit_model: Predicts hits.
        hypotheses: The explanations, the likeliest first.
        shares: Probability of each of the other explanations.
        last: Last hit of every condition; empty condition: last trial with a contact.
    """
    names = [hypothesis.effect for hypothesis in hypotheses]
    measured = [(name, hit) for name, hit in last.items() if name]
    measured = measured or [(f"the kind of {hit.name}", hit) for hit in last.values()]
    measurements = [_discrimination_of_hit(hit_model, hypotheses, f"one hit of {name}", hit) for name, hit in measured]
    measurements += [
        _discrimination_of_check(hit_model, hypotheses, check, last[""].physics) for check in HITLESS_CHECKS
    ]
    shown_in_free_motion = {effect.name for effect in hit_model.candidate.effects if effect.seen_in(contact=False)}
    free = [name in shown_in_free_motion for name in names]
    if any(free) and last[""].physics.arms:
        apart = tuple(math.inf if shown != free[0] else 0.0 for shown in free[1:])
        showing = " and ".join(name for name in names if name in shown_in_free_motion)
        measurements.append(ProposedMeasurement("a free motion", apart, f"{showing} would show there"))
    best = most_decisive(measurements, shares)
    if best is None or min(best.distances) <= MIN_DECISIVE_DISTANCE:
        for hit in hit_model.hit_source.unmeasured([hit for _, hit in measured]):
            measurements.append(
                _discrimination_of_hit(hit_model, hypotheses, f"a hit of {hit.condition}, not measured yet,", hit)
            )
        best = most_decisive(measurements, shares)
    if best is not None:
        return measurement_words(best, names[0], names[1:])
    return "no hit of these kinds and nothing that can be measured without one distinguishes them"


def _discrimination_of_hit(
    hit_model: HitModel, hypotheses: Sequence[Hypothesis], words: str, hit: Hit
) -> ProposedMeasurement:
    """Discrimination of a hit between the likeliest explanation and the others."""
    first, *forecasts = (hit_model.forecast(hypothesis, hit) for hypothesis in hypotheses)
    distances = []
    for forecast in forecasts:
        if first is None or forecast is None:
            distances.append(0.0)
            continue
        apart, covariance = first[0] - forecast[0], 0.5 * (first[1] + forecast[1])
        distances.append(math.sqrt(squared_distance(apart, covariance, hit_model.calibration.of_hits)))
    return ProposedMeasurement(words, tuple(distances), f"{min(distances):.1f} standard deviations")


def _discrimination_of_check(
    hit_model: HitModel, hypotheses: Sequence[Hypothesis], check: HitlessCheck, physics: Physics
) -> ProposedMeasurement:
    """Discrimination of a check without a hit between the likeliest explanation and the others."""
    readings = [_predicted_reading(hit_model, check, hypothesis, physics) for hypothesis in hypotheses]
    (first, width), *other_readings = readings
    noise = check.resolution / MIN_DECISIVE_DISTANCE
    distances = tuple(abs(first - value) / math.sqrt(noise**2 + width**2 + wide**2) for value, wide in other_readings)
    unit = f" {check.unit}" if check.unit else ""
    expected = (f"{value:.3g}{unit} if {h.effect}" for (value, _), h in zip(readings, hypotheses, strict=True))
    return ProposedMeasurement(f"one measurement, {check.words},", distances, ", ".join(expected))


def _predicted_reading(
    hit_model: HitModel, check: HitlessCheck, hypothesis: Hypothesis, physics: Physics
) -> tuple[float, float]:
    """Predicted reading of a check without a hit, and its standard deviation from the parameter uncertainty."""
    candidate, values = hit_model.candidate, hit_model.values(hypothesis)
    centre = check.reading(hit_model.scene(values, physics))
    slopes = []
    for number in hypothesis.posterior.followed:
        step = 0.1 * candidate.scale[number]
        step = step if values[number] + step <= candidate.upper[number] else -step
        step = candidate.consistent_step(values, number, step)
        moved = values + step * (np.arange(values.size) == number)
        slopes.append((check.reading(hit_model.scene(moved, physics)) - centre) * candidate.scale[number] / step)
    covariance = hypothesis.posterior.now.covariance
    return centre, math.sqrt(max(float(np.array(slopes) @ covariance @ np.array(slopes)), 0.0))
