# SPDX-License-Identifier: Apache-2.0
"""Start-up: observable effects, the scatter of hits, and its degrees of freedom from the first hits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_rs_analysis.diagnosis.diagnose import effects_for
from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis
from impact_rs_analysis.following.hits import Hit, HitSource
from impact_rs_analysis.following.posterior import Posterior
from impact_rs_analysis.inference.belief import Belief
from impact_rs_analysis.inference.noise import Noise, deviations_of, repeats_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array

MIN_SCATTER_FREEDOM = 10  # degrees of freedom; standard deviations are then known to 22 %


class Learning:
    """Collects the first hits of each layout until its scatter is known.

    Args:
        hit_source: Gives hits and predictions; its model is replaced by one without the effects that are followed.
        model: Model at the start.
        only: Effects to follow in addition to the effects of the model; None: all observable effects.
        learnt: Number of hits from which the scatter is estimated.
        mean_time: Mean number of hits to a false alarm, at least.

    Attributes:
        first: First hits of layouts whose scatter is not known yet.
        hit_model: Model of the hits; None: too few hits so far.
    """

    def __init__(
        self, hit_source: HitSource, model: Model, only: Sequence[str] | None, learnt: int, mean_time: float
    ) -> None:
        self.hit_source, self.model, self._only, self.learnt, self._mean_time = (
            hit_source,
            model,
            only,
            learnt,
            mean_time,
        )
        self._followed_items = [item for item in model.effects if _is_current(model, item)]
        effects = tuple(item for item in model.effects if item not in self._followed_items)
        hit_source.model = model.model_copy(update={"effects": effects})
        self.first: list[Hit] = []
        self.hit_model: HitModel | None = None

    def enough(self, layout: str, count: int) -> bool:
        """Whether the first hits of a layout determine its scatter.

        Repeats are awaited until there are twice as many hits as needed.

        Args:
            layout: The layout.
            count: Number of hits of all layouts.
        """
        hits = [hit for hit in self.first if hit.layout == layout]
        if count < self.learnt or len(hits) < self.learnt // 2:
            return False
        least = self._least_freedom if len(hits) >= 2 * self.learnt else 1
        measured, conditions = [hit.measured for hit in hits], [hit.condition for hit in hits]
        return deviations_of(measured, conditions, least)[1] >= self._least_freedom

    @property
    def _least_freedom(self) -> int:
        """Degrees of freedom from which the scatter of a layout is known."""
        return min(MIN_SCATTER_FREEDOM, self.learnt // 2 - 1)

    def begin(self, layout: str, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Learn the scatter of a layout from its first hits, and update the hypotheses with them.

        Raises:
            InputError: The model predicts fewer than half of them.
        """
        first = [hit for hit in self.first if hit.layout == layout]
        hits = self.hit_model
        if hits is None:
            source = self.hit_source.source(first)
            hits, self._stated = self.consider(source, source.proportion)
        active = hits.active if hypotheses else ()
        start = hits.candidate.point
        hits.look_at(range(start.size))
        linearised = [(hit, hits.linearised(hit, start, hits.active)) for hit in first]
        predicted_hits = [(hit, prediction) for hit, prediction in linearised if prediction is not None]
        if len(predicted_hits) < 0.5 * len(first):
            raise InputError(f"model {self.model.name!r} predicts {len(predicted_hits)} of the first {len(first)} hits")
        residuals = [(hit, hit.measured - predicted) for hit, (predicted, _) in predicted_hits]
        jacobians = [jacobian for _, (_, jacobian) in predicted_hits]
        moving = np.max([np.max(np.abs(jacobian), axis=0) for jacobian in jacobians], axis=0) > 0.0
        if not (moving.any() or active):
            names = ", ".join(dict.fromkeys(effect.name for effect in hits.candidate.effects))
            raise InputError(f"the first {len(first)} hits show none of the followed effects: {names}")
        self.hit_model, self.first = hits, [hit for hit in self.first if hit.layout != layout]
        limits = self.hit_source.limits(first, layout)
        hits.whiten[layout], freedom = _scatter(residuals, limits, self._least_freedom)
        calibration, freedom = hits.calibration, max(freedom, 2)
        calibration.freedom = float(freedom) if not hypotheses else min(calibration.freedom, float(freedom))
        hits.look_at(sorted({*active, *np.flatnonzero(moving).tolist()}))
        if not hypotheses:
            stated = [number for number in self._stated if number in hits.active]
            belief = Belief.of(stated, np.array([self._stated[number] for number in stated]))
            hypotheses = [Hypothesis(start, Posterior(belief))]
        for hypothesis in hypotheses:
            evidence = [e for hit, _ in predicted_hits if (e := hits.evidence(hit, hypothesis.point)) is not None]
            hypothesis.posterior.absorb(evidence)
        self._calibrate(hits, hypotheses[0], residuals, jacobians, limits)
        return hypotheses

    def consider(self, source: Source, proportion: Proportion) -> tuple[HitModel, dict[int, float]]:
        """Choose effects and their parameters.

        Args:
            source: Some hits.
            proportion: Size of the measured system, for ranges and scales.

        Returns:
            Model of the hits, and the standard deviations, in scales, of the parameters that the model states with an
            interval, by number.
        """
        believed = [item.name for item in self._followed_items]
        library = source.model.known_effects
        names = [effect.name for effect in effects_for(source, self._only)]
        names += [name for name in believed if name not in names]
        candidate = Candidate.of(tuple(library[name].in_proportion(proportion) for name in names), source)
        point = candidate.nominal.copy()
        stated: dict[int, float] = {}
        for item in self._followed_items:
            part = candidate.part(item.name)
            for number in range(part.start, part.stop):
                value = item.parameters.get(candidate.scalars[number].name)
                if value is None:  # nominal
                    continue
                point[number] = value.estimate
                if value.ci95 is not None:
                    width = (value.ci95[1] - value.ci95[0]) / (2.0 * NORMAL_95)
                    stated[number] = max(width / candidate.scale[number], 1e-6)
        candidate = replace(candidate, point=point)
        return HitModel(self.hit_source, candidate, source.joints, proportion, self._mean_time), stated

    def _calibrate(
        self, hits: HitModel, hypothesis: Hypothesis, residuals: Sequence[tuple[Hit, Array]],
        jacobians: Sequence[Array], limits: Array,
    ) -> None:  # fmt: skip
        """Calibrate the score variance by cross-validation: every first hit with the scatter of the others."""
        test, calibration = hits.test(hypothesis), hits.calibration
        square, expected = calibration.whole
        for index, (hit, residual) in enumerate(residuals):
            others = [*residuals[:index], *residuals[index + 1 :]]
            repeats = [value for other, value in others if other.condition == hit.condition]
            alike = repeats or [value for _, value in others]
            whiten, _ = _scatter(others, limits, self._least_freedom)
            whitened = whiten @ (residual - np.mean(alike, axis=0)) / math.sqrt(1.0 + 1.0 / len(alike))
            square, expected = square + float(whitened @ whitened), expected + whitened.size
            jacobian = whiten @ jacobians[index]
            for name, indices in test.effects.items():
                columns = jacobian[:, [test.active[column] for column in indices]]
                basis, values, _ = np.linalg.svd(columns, full_matrices=False)
                basis = basis[:, values > 1e-6 * max(float(values[0]), 1e-300)]
                calibration.add(name, float(np.sum(np.square(basis.T @ whitened))), float(basis.shape[1]))
        calibration.whole = square, expected


def _scatter(residuals: Sequence[tuple[Hit, Array]], limits: Array, least: int) -> tuple[Array, int]:
    """Whitening matrix of the hits of one layout, ``(F, F)``, and the degrees of freedom of their scatter."""
    values, conditions = [value for _, value in residuals], [hit.condition for hit, _ in residuals]
    deviations, freedom = deviations_of(values, conditions, least)
    stated = np.max([hit.noise for hit, _ in residuals], axis=0)
    return Noise(repeats_of(deviations, freedom, stated), np.square(limits / 2.0)).whitening(), freedom


def _is_current(model: Model, item: ModelEffect) -> bool:
    """Whether an entry has the parameters of the effect in the library; older files may differ."""
    return model.effect_of(item).parameters == model.known_effects[item.name].parameters
