# SPDX-License-Identifier: Apache-2.0
"""Linearised likelihood of hits about a parameter vector, and predictions of a hypothesis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.following.change import Calibration, ChangeTest
from impact_rs_analysis.following.documents import Followed
from impact_rs_analysis.following.hits import Hit, HitSource
from impact_rs_analysis.following.posterior import HitEvidence, Posterior
from impact_rs_analysis.following.recent_residuals import RecentResiduals
from impact_rs_analysis.inference.belief import Belief
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class Origin:
    """Belief at the moment when an effect changed.

    Attributes:
        point: Point of the linearisation before, ``(p,)``.
        past: Belief from all hits before.
        numbers: Parameters of the effect.
        old: Their values before, ``(p_e,)``.
    """

    point: Array
    past: Belief
    numbers: tuple[int, ...]
    old: Array


@dataclass(eq=False)
class Hypothesis:
    """One hypothesis: parameters with their posterior, and its probability.

    Attributes:
        point: Values of all parameters about which it is linearised, ``(p,)``.
        posterior: State of its parameters.
        log_weight: Logarithm of its probability.
        effect: Effect that changed last; empty: none did.
        origin: Belief before that change; None: no change, or one older than the window.
        tried_statistic: Statistic at which the last search for a cause failed; it is repeated once this has grown.
        recent: Residuals of the last hits.
    """

    point: Array
    posterior: Posterior
    log_weight: float = 0.0
    effect: str = ""
    origin: Origin | None = None
    tried_statistic: float = -math.inf
    recent: RecentResiduals = field(default_factory=RecentResiduals)


class HitModel:
    """Predictions of hits under effects, with their sensitivities and scatter.

    Args:
        hit_source: Predicts hits.
        candidate: The effects, at their values at the start.
        joints: Joints of the arms.
        proportion: Size of the measured system, for ranges and scales.
        mean_time: Mean number of hits to a false alarm, at least.

    Attributes:
        whiten: Whitening matrix of the hits of a layout, ``(F, F)``.
        active: Parameters that some hit depends on, by number.
        calibration: Calibration of the scores of the effects.
    """

    def __init__(
        self, hit_source: HitSource, candidate: Candidate, joints: Joints, proportion: Proportion, mean_time: float
    ) -> None:
        self.hit_source, self.candidate, self.joints, self.proportion = hit_source, candidate, joints, proportion
        self.mean_time = mean_time
        self.whiten: dict[str, Array] = {}
        self.calibration = Calibration()
        self._jacobians: dict[tuple[str, bytes, tuple[int, ...]], Array] = {}
        self._plans: dict[tuple[bytes, tuple[int, ...]], tuple[Array, list[Added]]] = {}
        self.look_at(range(candidate.point.size))

    def look_at(self, parameters: Sequence[int]) -> None:
        """Restrict the sensitivities to these parameters."""
        self.active = tuple(parameters)
        self._plans.clear()
        self._jacobians.clear()

    def test(self, hypothesis: Hypothesis) -> ChangeTest:
        """The test for a change, about the point of a hypothesis."""
        candidate = replace(self.candidate, point=hypothesis.point)
        return ChangeTest(hypothesis.posterior, candidate, self.active, self.calibration, self.mean_time)

    def evidence(self, hit: Hit, point: Array, parameters: Sequence[int] | None = None) -> HitEvidence | None:
        """Evidence of a hit, linearised at a point (None: all active parameters); None without a contact."""
        linearised = self.linearised(hit, point, self.active if parameters is None else parameters)
        if linearised is None:
            return None
        predicted, jacobian = linearised
        whiten = self.whiten[hit.layout]
        return HitEvidence(
            whiten @ (hit.measured - predicted), whiten @ jacobian, whiten @ hit.discrepancy.T, hit.group, hit=hit
        )

    def linearised(self, hit: Hit, point: Array, parameters: Sequence[int]) -> tuple[Array, Array] | None:
        """Predicted features ``(F,)`` and sensitivities per scale ``(F, p)`` at a point; None without a contact.

        Sensitivities to other parameters are 0.
        """
        candidate, numbers = replace(self.candidate, point=point), tuple(parameters)
        key = (hit.shared, point.tobytes(), numbers)
        if hit.shared and key in self._jacobians:
            (predicted,) = self.hit_source.predict(hit, [candidate.effects_at(point)])
            return None if predicted is None else (predicted, self._jacobians[key])
        if (plan := self._plans.get(key[1:])) is None:
            steps = candidate.steps(self.joints)
            moved = [point + steps[number] * (np.arange(point.size) == number) for number in numbers]
            plan = self._plans[key[1:]] = steps, [candidate.effects_at(vector) for vector in (point, *moved)]
        steps, points = plan
        predicted, *others_stepped = self.hit_source.predict(hit, points)
        if predicted is None:
            return None
        jacobian = np.zeros((predicted.size, point.size))
        for number, stepped in zip(numbers, others_stepped, strict=True):
            if stepped is not None:
                jacobian[:, number] = (stepped - predicted) * candidate.scale[number] / steps[number]
        if hit.shared:
            self._jacobians[key] = jacobian
        return predicted, jacobian

    def error_at_start(self, evidence: HitEvidence, point: Array) -> float:
        """Error of the given model, in standard deviations of a hit, rms over the features."""
        residual, hit = evidence.residual, evidence.hit
        start = self.candidate.point
        if not np.array_equal(point, start):
            (predicted,) = self.hit_source.predict(hit, [self.candidate.effects_at(start)])
            residual = residual if predicted is None else self.whiten[hit.layout] @ (hit.measured - predicted)
        return math.sqrt(float(np.mean(np.square(residual))))

    def values(self, hypothesis: Hypothesis) -> Array:
        """Posterior means of all parameters, within their ranges, ``(p,)``."""
        candidate, followed = self.candidate, list(hypothesis.posterior.followed)
        values = hypothesis.point.copy()
        values[followed] += candidate.scale[followed] * hypothesis.posterior.now.mean[: len(followed)]
        return candidate.nearest_consistent(np.clip(values, candidate.lower, candidate.upper))

    def followed(self, hypothesis: Hypothesis, numbers: Sequence[int], old: Array) -> tuple[Followed, ...]:
        """Parameters with their intervals and changes."""
        candidate, posterior = self.candidate, hypothesis.posterior
        values, variances = self.values(hypothesis), np.diag(posterior.now.covariance)
        wide = scipy.special.stdtrit(self.calibration.freedom, 0.975)
        names = [effect.name for effect, part in candidate.parts for _ in range(part.start, part.stop)]
        parameters = []
        for number in numbers:
            variance = float(variances[posterior.followed.index(number)]) * self.calibration.of(names[number])
            half, value = wide * candidate.scale[number] * math.sqrt(variance), float(values[number])
            parameters.append(
                Followed(
                    parameter=f"{names[number]}.{candidate.scalars[number].name}",
                    estimate=value,
                    ci95=(value - half, value + half),
                    change=value - float(old[number]),
                    unit=candidate.scalars[number].unit,
                )
            )
        return tuple(parameters)

    def forecast(self, hypothesis: Hypothesis, hit: Hit) -> tuple[Array, Array, Array] | None:
        """Whitened innovation ``(F,)`` of a hit, its covariance, and the whitening ``(F, F)``; None: no contact."""
        evidence = self.evidence(hit, hypothesis.point) if hit.layout in self.whiten else None
        if evidence is None:
            return None
        return (*hypothesis.posterior.now.predictive(evidence), self.whiten[hit.layout])

    def predicted(self, hypothesis: Hypothesis, hit: Hit) -> tuple[Array, Array] | None:
        """Predictive mean and variance of the features of a hit with this initial state, ``(F,)``; None: no contact."""
        if (forecast := self.forecast(hypothesis, hit)) is None:
            return None
        innovation, covariance, whiten = forecast
        innovation = innovation - hypothesis.recent.expected(hit.group, innovation.size)
        unwhiten = np.linalg.inv(whiten)
        return hit.measured - unwhiten @ innovation, np.diag(unwhiten @ covariance @ unwhiten.T)

    def scene(self, values: Array, physics: Physics) -> Physics:
        """Physics with the effects at some values."""
        for effect, part in self.candidate.parts:
            if np.any(values[part] != self.candidate.nominal[part]):
                physics = effect.apply_vector(physics, values[part])
        return physics
