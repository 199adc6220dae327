"""Choosing effects: screen all, refine a shortlist through the twin, accept what predicts unseen conditions better."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import false_discovery_control

from impact_rs_analysis.diagnosis.candidates import (
    Candidate,
    NormalEquations,
    combine,
    linearise,
    random_signs,
    tail_probability,
)
from impact_rs_analysis.diagnosis.evidence import ConditionEvidence
from impact_rs_analysis.diagnosis.sensitivity import Rollout, RolloutStore, concerns, nominal_vector, steps
from impact_rs_sim.effects import Effect
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array

SIGNIFICANT = 0.01  # false-discovery rate at which an effect is accepted
SHORTLIST = 5  # candidates refined through the twin in every round
MOST_EFFECTS = 3
CHORD_STEPS = 5
LEAST_GAIN = 0.10  # share of the excess error that an accepted effect must remove on unseen conditions


@dataclass(frozen=True)
class Fit:
    """A candidate fitted to the evidence.

    Attributes:
        candidate: Linearised at the estimate.
        equations: Its least-squares problem.
        change: From the candidate's point to the estimate, in parameter scales.
        held_out: Mean square scaled error per condition, predicted from all others, ``(c,)``.
    """

    candidate: Candidate
    equations: NormalEquations
    change: Array
    held_out: Array

    @property
    def estimate(self) -> Array:
        """Estimated parameters in their own units, ``(p,)``."""
        candidate = self.candidate
        return np.clip(candidate.point + self.change * candidate.scale, candidate.lower, candidate.upper)

    @property
    def score(self) -> float:
        """Mean over conditions of the held-out error [-]."""
        return float(self.held_out.mean())


def fit(candidate: Candidate, evidence: list[ConditionEvidence]) -> Fit:
    """Fit a candidate where it is linearised."""
    equations = NormalEquations(candidate, evidence)
    return Fit(candidate, equations, equations.solve(), equations.held_out())


class Search:
    """Search over the effects of a library.

    Args:
        effects: Effects to consider.
        model: Model underneath.
        evidence: Scaled residuals of that model.
        store: Twin rollouts.
    """

    def __init__(
        self,
        effects: list[Effect],
        model: Model,
        evidence: list[ConditionEvidence],
        store: RolloutStore,
    ) -> None:
        self.model, self.evidence, self.store = model, evidence, store
        self.signs = random_signs(evidence)
        self.before = np.array([np.mean(np.square(item.mean)) for item in evidence])
        self.noise = np.array([np.mean(np.square(item.pure)) / item.count for item in evidence])
        self._prefetch(effects)
        self.singles: dict[str, Candidate] = {}
        for effect in effects:
            candidate = linearise((effect,), model, evidence, store)
            if candidate is not None:
                self.singles[effect.name] = candidate
        self.fits = {name: fit(candidate, evidence) for name, candidate in self.singles.items()}
        self.p_values = self.p_values_given(None)

    def _prefetch(self, effects: list[Effect]) -> None:
        """Run every rollout of the screening in one parallel batch."""
        wanted: dict[str, Rollout] = {}
        for item in self.evidence:
            base = Rollout(item.condition, self.model)
            wanted.setdefault(base.digest, base)
            for effect in effects:
                if not concerns(effect, item.condition):
                    continue
                point = nominal_vector(effect)
                for index, step in enumerate(steps(effect, point)):
                    moved = point.copy()
                    moved[index] += step
                    rollout = Rollout(item.condition, self.model, ((effect.name, tuple(float(v) for v in moved)),))
                    wanted.setdefault(rollout.digest, rollout)
        self.store(list(wanted.values()), "sensitivities of all effects")

    @property
    def lack_of_fit(self) -> float:
        """p of the residuals being pure error, before any effect is added."""
        return self.lack_of_fit_of(None)

    def lack_of_fit_of(self, chosen: Fit | None) -> float:
        """p of what a fit leaves being pure error."""
        observed, null = 0.0, np.zeros(self.signs[0].shape[0])
        for number, (item, flips) in enumerate(zip(self.evidence, self.signs, strict=True)):
            rest = item.mean
            if chosen is not None:
                rest = chosen.equations.targets[number] - chosen.candidate.jacobians[number] @ chosen.change
            observed += item.count * float(rest @ rest)
            flipped = flips @ item.deviations
            null += np.einsum("bf,bf->b", flipped, flipped) / item.count
        return tail_probability(observed, null)

    def p_values_given(self, chosen: Candidate | None) -> dict[str, float]:
        """p per effect, given effects already chosen; adjusted for looking at all of them (Benjamini-Hochberg)."""
        raw = {}
        base = None if chosen is None else NormalEquations(chosen, self.evidence)
        for name, candidate in self.singles.items():
            if chosen is not None and name in chosen.names:
                continue
            joined = candidate if chosen is None else combine(chosen, candidate)
            equations = NormalEquations(joined, self.evidence)
            observed, null = equations.statistic(), equations.null_statistics(self.signs)
            if base is not None:
                observed, null = observed - base.statistic(), null - base.null_statistics(self.signs)
            raw[name] = tail_probability(observed, np.maximum(null, 0.0))
        if not raw:
            return {}
        return dict(zip(raw, false_discovery_control(list(raw.values())).tolist(), strict=True))

    def excess(self, held_out: Array) -> float:
        """Mean held-out error above what pure error explains [-]."""
        return float(np.mean(np.maximum(held_out - self.noise, 0.0)))

    def refine(self, candidate: Candidate) -> Fit:
        """Fit through the twin: chord iterations with fixed sensitivities, halved where they make it worse."""
        best = fit(candidate, self.evidence)
        best_error = self._error(candidate, np.zeros_like(best.change))
        point, fraction = best.estimate, 1.0
        for _ in range(CHORD_STEPS):
            moved = self._at(candidate, candidate.point + fraction * (point - candidate.point))
            error = np.inf if moved is None else self._error(moved, np.zeros_like(best.change))
            if moved is None or error >= best_error:
                fraction /= 3.0
                if fraction < 0.1:
                    break
                continue
            gained = best_error - error
            candidate, best_error, fraction = moved, error, 1.0
            best = fit(candidate, self.evidence)
            point = best.estimate
            if gained < 0.01 * best_error:
                break
        return best

    def relinearise(self, chosen: Fit) -> Fit:
        """New sensitivities at the estimate, and a last fit."""
        candidate = linearise(
            chosen.candidate.effects, self.model, self.evidence, self.store, chosen.estimate, "final sensitivities"
        )
        if candidate is None:
            return chosen
        fresh = self.refine(candidate)
        return fresh if fresh.score <= chosen.score * 1.05 else chosen

    def _error(self, candidate: Candidate, change: Array) -> float:
        return float(np.mean(NormalEquations(candidate, self.evidence).errors(change)))

    def _at(self, candidate: Candidate, point: Array) -> Candidate | None:
        """The candidate with its features evaluated at another point, sensitivities kept."""
        added = tuple(candidate.split(point))
        base = self.store([Rollout(item.condition, self.model) for item in self.evidence])
        here = self.store(
            [Rollout(item.condition, self.model, added) for item in self.evidence], "fit of the shortlist"
        )
        if any(value is None for value in (*base, *here)):
            return None
        offsets = tuple(
            (there - before) / item.sigma  # type: ignore[operator]
            for there, before, item in zip(here, base, self.evidence, strict=True)
        )
        return replace(candidate, point=point, offsets=offsets)

    def shortlist(self, chosen: Fit | None, count: int = SHORTLIST) -> list[Candidate]:
        """Most promising candidates for one more effect, by their linear held-out error."""
        ranked = []
        for name, candidate in self.singles.items():
            if chosen is not None and name in chosen.candidate.names:
                continue
            joined = candidate if chosen is None else combine(chosen.candidate, candidate)
            ranked.append((fit(joined, self.evidence).score, joined))
        return [candidate for _, candidate in sorted(ranked, key=lambda entry: entry[0])[:count]]

    def best_pairs(self, count: int = 2) -> list[Candidate]:
        """Most promising pairs among the better half of the effects, by their linear held-out error."""
        names = sorted(self.fits, key=lambda name: self.fits[name].score)[:10]
        ranked = []
        for first, second in combinations(names, 2):
            joined = combine(self.singles[first], self.singles[second])
            ranked.append((fit(joined, self.evidence).score, joined))
        return [candidate for _, candidate in sorted(ranked, key=lambda entry: entry[0])[:count]]
