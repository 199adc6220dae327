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

Explained = list[tuple[ChangeExplanation, Hypothesis]]


class Causes:
    """Finds the causes of a change.

    Args:
        hit_model: Predicts hits.
    """

    def __init__(self, hit_model: HitModel) -> None:
        self._hit_model, self._candidate, self._calibration = hit_model, hit_model.candidate, hit_model.calibration

    def of(self, before: Hypothesis, test: ChangeTest, statistics: dict[str, Array]) -> Explained:
        """Explanations of a change that hold after relinearisation, by falling likelihood."""
        tried = test.explanations(statistics)[:MAX_LINEARISED_EXPLANATIONS]
        explained = [pair for explanation in tried if (pair := self._relinearised(before, explanation)) is not None]
        explained.sort(key=lambda pair: -pair[0].log_ratio)
        tie = math.log(DECISIVE_LIKELIHOOD_RATIO)
        promising = any(explanation.effect == tried[0].effect for explanation, _ in explained)
        # The best linear prediction may hold only at a later hit: the others need more evidence.
        if not explained or explained[0][0].log_ratio < test.threshold + (0.0 if promising else tie):
            return []
        return [pair for pair in explained if pair[0].log_ratio > explained[0][0].log_ratio - tie][:MAX_HYPOTHESES]

    def instead_of(self, best: Hypothesis) -> tuple[Hypothesis, Explained, float] | None:
        """Better explanation of the hits since the last change than the effect announced then.

        Returns:
            The hypothesis before that change, the explanations of all hits since, and the log likelihood ratio of the
            likeliest explanation against the announced effect; None: no better explanation.
        """
        origin = best.origin
        if origin is None:
            return None
        before = Hypothesis(origin.point, Posterior(origin.past.copy()))
        for instant in best.posterior.window:
            evidence = [(self._hit_model.evidence(old.hit, before.point), old.weight) for old in instant]
            if predicted := [replace(new, weight=weight) for new, weight in evidence if new is not None]:
                before.posterior.add(predicted)
        test = self._hit_model.test(before)
        explained = self.of(before, test, test.statistics()[1])
        if not explained or explained[0][0].effect == best.effect:
            return None
        lead = self._ratio(before, explained[0][1]) - self._ratio(before, best)
        return None if lead <= 0.0 else (before, explained, lead)

    def _relinearised(
        self, before: Hypothesis, explanation: ChangeExplanation
    ) -> tuple[ChangeExplanation, Hypothesis] | None:
        """A relinearised explanation; None if it misses its predicted improvement, or too few hits support it.

        Robustness against outliers: without the quarter of the hits that supports it most, the others must still
        support it. The likelihood ratio is corrected for the actual improvement and for the information at the new
        point (Laplace approximation).
        """
        fitted = self.about(before, explanation)
        gains = _gains(before, fitted)
        inflation = self._calibration.of(explanation.effect)
        since = before.posterior.since(explanation.start)
        if sum(gain > inflation for gain in gains) < self._calibration.least_hits(self._hit_model.mean_time, since):
            return None
        if sum(gains) <= MIN_KEPT_GAIN_SHARE * explanation.gain or support(gains) <= MIN_OTHER_HITS_GAIN * inflation:
            return None
        change = explanation.change
        promised = explanation.gain / inflation - float(change @ change) / CHANGE_PRIOR_SCALES**2
        first = log_ratio(promised, explanation.determinant, change.size, self._calibration.freedom)
        return replace(explanation, log_ratio=explanation.log_ratio + self._ratio(before, fitted) - first), fitted

    def _ratio(self, before: Hypothesis, fitted: Hypothesis) -> float:
        """Log likelihood ratio of an explanation at its estimate, from the hits since the change."""
        assert fitted.origin is not None
        numbers, inflation = list(fitted.origin.numbers), self._calibration.of(fitted.effect)
        indices, unit = [fitted.posterior.followed.index(number) for number in numbers], np.eye(len(numbers))
        covariance = inflation * fitted.posterior.now.covariance[np.ix_(indices, indices)]
        information = np.linalg.inv(covariance) - unit / (inflation * FOUND_CHANGE_PRIOR_SCALES**2)
        moved = (self._hit_model.values(fitted)[numbers] - fitted.origin.old) / self._candidate.scale[numbers]
        prior = float(moved @ np.linalg.solve(covariance + CHANGE_PRIOR_SCALES**2 * unit, moved))
        determinant = float(np.linalg.slogdet(unit + CHANGE_PRIOR_SCALES**2 * information)[1])
        explained = sum(_gains(before, fitted)) / inflation - prior
        return log_ratio(explained, determinant, len(indices), self._calibration.freedom)

    def about(self, before: Hypothesis, explanation: ChangeExplanation) -> Hypothesis:
        """Hypothesis of an explanation, linearised at its estimate."""
        part = self._candidate.part(explanation.effect)
        numbers = list(range(part.start, part.stop))
        active = [n for n in numbers if n in self._hit_model.active]
        point = before.point.copy()
        old = self._hit_model.values(before)[numbers]
        point[numbers] = old
        point[active] += self._candidate.scale[active] * explanation.change
        past = before.posterior.copy()
        past.absorb_before(explanation.start)
        if len(active) < len(numbers):  # the change makes shape parameters observable
            self._hit_model.look_at(sorted({*self._hit_model.active, *numbers}))
        origin = Origin(before.point, past.before, tuple(numbers), old)
        return self._fitted(origin, past.hits, point, explanation.effect)

    def _fitted(self, origin: Origin, hits: Sequence[Sequence[Hit]], point: Array, effect: str) -> Hypothesis:
        """Gauss-Newton on the hits since a change, with the parameters of its effect free."""
        candidate, numbers = self._candidate, list(origin.numbers)
        scale, lower, upper = candidate.scale[numbers], candidate.lower[numbers], candidate.upper[numbers]
        followed = tuple(dict.fromkeys((*origin.past.parameters, *numbers)))
        indices = [followed.index(n) for n in numbers]
        point = point.copy()
        point[numbers] = np.clip(point[numbers], lower, upper)
        point = candidate.nearest_consistent(point)
        for step in range(MAX_GAUSS_NEWTON_STEPS):
            posterior = self._since(origin, followed, hits, point, followed)
            next_point = point.copy()
            next_point[numbers] = np.clip(point[numbers] + scale * posterior.now.mean[indices], lower, upper)
            next_point = candidate.nearest_consistent(next_point)
            moved = np.abs(next_point - point)[numbers] / scale
            if step == MAX_GAUSS_NEWTON_STEPS - 1 or np.all(moved < MAX_FINAL_CORRECTION):
                break
            point = next_point
        return Hypothesis(point, posterior, effect=effect, origin=origin)

    def complete(self, fitted: Hypothesis) -> Hypothesis:
        """The hypothesis with sensitivities to all active parameters, for the test at the next hits."""
        assert fitted.origin is not None
        posterior, active = fitted.posterior, self._hit_model.active
        whole = self._since(fitted.origin, posterior.followed, posterior.hits, fitted.point, active)
        return replace(fitted, posterior=whole)

    def refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis, relinearised at the present posterior mean of the parameters of its effect.

        All other parameters keep their point: the belief before the change is relative to it.
        """
        assert hypothesis.origin is not None
        point, numbers = hypothesis.origin.point.copy(), list(hypothesis.origin.numbers)
        point[numbers] = self._hit_model.values(hypothesis)[numbers]
        refined = self.complete(self._fitted(hypothesis.origin, hypothesis.posterior.hits, point, hypothesis.effect))
        refined.log_weight, refined.recent = hypothesis.log_weight, hypothesis.recent
        return refined

    def _since(
        self, origin: Origin, followed: tuple[int, ...], hits: Sequence[Sequence[Hit]], point: Array,
        parameters: Sequence[int],
    ) -> Posterior:  # fmt: skip
        """Posterior from the belief before a change and the hits since, linearised at a point."""
        numbers = list(origin.numbers)
        shift = (origin.old - point[numbers]) / self._candidate.scale[numbers]
        posterior = Posterior(origin.past.with_parameters(followed, numbers, shift, FOUND_CHANGE_PRIOR_SCALES))
        for instant in hits:
            evidence = [e for hit in instant if (e := self._hit_model.evidence(hit, point, parameters)) is not None]
            weights = []
            for observation in evidence:
                innovation, covariance = posterior.now.predictive(observation)
                distance = squared_distance(innovation, covariance, self._calibration.of_hits)
                weights.append(huber_weight(distance, innovation.size))
            if evidence:
                posterior.add([replace(e, weight=weight) for e, weight in zip(evidence, weights, strict=True)])
        return posterior


def _gains(before: Hypothesis, fitted: Hypothesis) -> list[float]:
    """Fall of the sum of squared whitened residuals, by hit since a change that both hypotheses predict."""
    past = {evidence.hit.name: evidence for evidence in before.posterior.since()}
    gains = []
    for evidence in fitted.posterior.since():
        if (old := past.get(evidence.hit.name)) is None:
            continue
        first, second = before.posterior.now.residual_of(old), fitted.posterior.now.residual_of(evidence)
        gains.append(old.weight * float(first @ first - second @ second))
    return gains
