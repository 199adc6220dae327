# SPDX-License-Identifier: Apache-2.0
"""Causes of a change: candidate effects, each refitted by Gauss-Newton to the hits since the change.

The parameters of one effect are free: Gauss-Newton on the hits since the change, with the posterior before it as prior.
Some sensitivities are local (a sticking contact is insensitive to more friction and sensitive to much less), so a
candidate is kept only if the refit achieves the improvement that its linearisation predicted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_rs_analysis.diagnosis.search.fit import MAX_FINAL_CORRECTION
from impact_rs_analysis.following.change import ChangeExplanation, ChangeTest, support
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis, Origin
from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.following.posterior import (
    CHANGE_PRIOR_SCALES,
    FOUND_CHANGE_PRIOR_SCALES,
    Posterior,
    huber_weight,
)
from impact_rs_analysis.inference.student import DECISIVE_LIKELIHOOD_RATIO, log_ratio, squared_distance
from impact_rs_sim.robots.robot import Array

MAX_HYPOTHESES = 4  # at a time
MAX_LINEARISED_EXPLANATIONS = 5  # per hit
MAX_GAUSS_NEWTON_STEPS = 4  # per explanation
MIN_KEPT_GAIN_SHARE = 0.5  # of the promised fall of the squared residuals; an explanation that keeps less is dropped
MIN_OTHER_HITS_GAIN = 4.0  # fall of the squared residuals of the other hits; two standard deviations of one parameter

Held = list[tuple[ChangeExplanation, Hypothesis]]


class Causes:
    """Finds the causes of a change.

    Args:
        hits: Predicts hits.
    """

    def __init__(self, hits: HitModel) -> None:
        self._hits, self._own, self._calibration = hits, hits.candidate, hits.calibration

    def of(self, before: Hypothesis, test: ChangeTest, statistics: dict[str, Array]) -> Held:
        """Explanations of a change that hold after relinearisation, by falling likelihood."""
        tried = test.explanations(statistics)[:MAX_LINEARISED_EXPLANATIONS]
        held = [found for one in tried if (found := self._held(before, one)) is not None]
        held.sort(key=lambda pair: -pair[0].log_ratio)
        tie = math.log(DECISIVE_LIKELIHOOD_RATIO)
        promising = any(one.effect == tried[0].effect for one, _ in held)
        # The best linear prediction may hold only at a later hit: the others need more evidence.
        if not held or held[0][0].log_ratio < test.threshold + (0.0 if promising else tie):
            return []
        return [pair for pair in held if pair[0].log_ratio > held[0][0].log_ratio - tie][:MAX_HYPOTHESES]

    def instead_of(self, best: Hypothesis) -> tuple[Hypothesis, Held, float] | None:
        """Better explanation of the hits since the last change than the effect named then.

        Returns:
            The hypothesis before that change, the explanations of all hits since, and by how much the logarithm of the
            likelihood ratio of the first exceeds that of the effect that was named; None: there is none.
        """
        origin = best.origin
        if origin is None:
            return None
        before = Hypothesis(origin.point, Posterior(origin.past.copy()))
        for instant in best.posterior.window:
            found = [(self._hits.evidence(one.hit, before.point), one.weight) for one in instant]
            if predicted := [replace(own, weight=weight) for own, weight in found if own is not None]:
                before.posterior.add(predicted)
        test = self._hits.test(before)
        held = self.of(before, test, test.statistics()[1])
        if not held or held[0][0].effect == best.effect:
            return None
        lead = self._ratio(before, held[0][1]) - self._ratio(before, best)
        return None if lead <= 0.0 else (before, held, lead)

    def _held(self, before: Hypothesis, one: ChangeExplanation) -> tuple[ChangeExplanation, Hypothesis] | None:
        """A relinearised explanation; None if it misses its predicted improvement, or too few hits support it.

        Robustness against outliers: without the quarter of the hits that supports it most, the others must still
        support it. The likelihood ratio is corrected for the actual improvement and for the information at the new
        point (Laplace approximation).
        """
        fitted = self.about(before, one)
        gains = _gains(before, fitted)
        inflation = self._calibration.of(one.effect)
        since = before.posterior.since(one.start)
        if sum(gain > inflation for gain in gains) < self._calibration.least_hits(self._hits.mean_time, since):
            return None
        if sum(gains) <= MIN_KEPT_GAIN_SHARE * one.gain or support(gains) <= MIN_OTHER_HITS_GAIN * inflation:
            return None
        promised = one.gain / inflation - float(one.change @ one.change) / CHANGE_PRIOR_SCALES**2
        first = log_ratio(promised, one.determinant, one.change.size, self._calibration.freedom)
        return replace(one, log_ratio=one.log_ratio + self._ratio(before, fitted) - first), fitted

    def _ratio(self, before: Hypothesis, fitted: Hypothesis) -> float:
        """Log likelihood ratio of an explanation at its estimate, from the hits since the change."""
        assert fitted.origin is not None
        numbers, inflation = list(fitted.origin.numbers), self._calibration.of(fitted.effect)
        place, unit = [fitted.posterior.followed.index(number) for number in numbers], np.eye(len(numbers))
        covariance = inflation * fitted.posterior.now.covariance[np.ix_(place, place)]
        known = np.linalg.inv(covariance) - unit / (inflation * FOUND_CHANGE_PRIOR_SCALES**2)
        moved = (self._hits.values(fitted)[numbers] - fitted.origin.old) / self._own.scale[numbers]
        prior = float(moved @ np.linalg.solve(covariance + CHANGE_PRIOR_SCALES**2 * unit, moved))
        determinant = float(np.linalg.slogdet(unit + CHANGE_PRIOR_SCALES**2 * known)[1])
        explained = sum(_gains(before, fitted)) / inflation - prior
        return log_ratio(explained, determinant, len(place), self._calibration.freedom)

    def about(self, before: Hypothesis, one: ChangeExplanation) -> Hypothesis:
        """Hypothesis of an explanation, linearised at its estimate."""
        part = self._own.part(one.effect)
        numbers = list(range(part.start, part.stop))
        seen = [n for n in numbers if n in self._hits.active]
        point = before.point.copy()
        old = self._hits.values(before)[numbers]
        point[numbers] = old
        point[seen] += self._own.scale[seen] * one.change
        past = before.posterior.copy()
        past.absorb_before(one.start)
        if len(seen) < len(numbers):  # the change makes shape parameters observable
            self._hits.look_at(sorted({*self._hits.active, *numbers}))
        origin = Origin(before.point, past.before, tuple(numbers), old)
        return self._fitted(origin, past.hits, point, one.effect)

    def _fitted(self, origin: Origin, hits: Sequence[Sequence[Hit]], point: Array, effect: str) -> Hypothesis:
        """Gauss-Newton on the hits since a change, with the parameters of its effect free."""
        own, numbers = self._own, list(origin.numbers)
        scale, lower, upper = own.scale[numbers], own.lower[numbers], own.upper[numbers]
        followed = tuple(dict.fromkeys((*origin.past.parameters, *numbers)))
        place = [followed.index(n) for n in numbers]
        point = point.copy()
        point[numbers] = np.clip(point[numbers], lower, upper)
        point = own.nearest_consistent(point)
        for step in range(MAX_GAUSS_NEWTON_STEPS):
            posterior = self._since(origin, followed, hits, point, followed)
            there = point.copy()
            there[numbers] = np.clip(point[numbers] + scale * posterior.now.mean[place], lower, upper)
            there = own.nearest_consistent(there)
            moved = np.abs(there - point)[numbers] / scale
            if step == MAX_GAUSS_NEWTON_STEPS - 1 or np.all(moved < MAX_FINAL_CORRECTION):
                break
            point = there
        return Hypothesis(point, posterior, effect=effect, origin=origin)

    def complete(self, fitted: Hypothesis) -> Hypothesis:
        """The hypothesis with sensitivities to all parameters, for the test at the next hits."""
        assert fitted.origin is not None
        posterior, active = fitted.posterior, self._hits.active
        whole = self._since(fitted.origin, posterior.followed, posterior.hits, fitted.point, active)
        return replace(fitted, posterior=whole)

    def refined(self, one: Hypothesis) -> Hypothesis:
        """The hypothesis, relinearised at the present posterior mean of the parameters of its effect.

        All other parameters keep their point: the belief before the change is relative to it.
        """
        assert one.origin is not None
        point, numbers = one.origin.point.copy(), list(one.origin.numbers)
        point[numbers] = self._hits.values(one)[numbers]
        found = self.complete(self._fitted(one.origin, one.posterior.hits, point, one.effect))
        found.log_weight, found.recent = one.log_weight, one.recent
        return found

    def _since(
        self, origin: Origin, followed: tuple[int, ...], hits: Sequence[Sequence[Hit]], point: Array,
        parameters: Sequence[int],
    ) -> Posterior:  # fmt: skip
        """Posterior from the belief before a change and the hits since, linearised at a point."""
        numbers = list(origin.numbers)
        shift = (origin.old - point[numbers]) / self._own.scale[numbers]
        posterior = Posterior(origin.past.with_parameters(followed, numbers, shift, FOUND_CHANGE_PRIOR_SCALES))
        for instant in hits:
            found = [e for hit in instant if (e := self._hits.evidence(hit, point, parameters)) is not None]
            weights = []
            for one in found:
                innovation, covariance = posterior.now.predictive(one)
                distance = squared_distance(innovation, covariance, self._calibration.of_hits)
                weights.append(huber_weight(distance, innovation.size))
            if found:
                posterior.add([replace(one, weight=weight) for one, weight in zip(found, weights, strict=True)])
        return posterior


def _gains(before: Hypothesis, fitted: Hypothesis) -> list[float]:
    """Fall of the sum of squared whitened residuals of every hit since a change that both predict."""
    past = {one.hit.name: one for one in before.posterior.since()}
    found = []
    for evidence in fitted.posterior.since():
        if (old := past.get(evidence.hit.name)) is None:
            continue
        first, second = before.posterior.now.rest(old), fitted.posterior.now.rest(evidence)
        found.append(old.weight * float(first @ first - second @ second))
    return found
