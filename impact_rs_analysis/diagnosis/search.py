"""Choosing effects: screen all, refine a shortlist through the twin, accept what predicts unseen conditions better."""

from __future__ import annotations

from collections.abc import Callable
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
from impact_rs_analysis.diagnosis.sensitivity import Where, concerns, in_free_motion, nominal_vector, steps
from impact_rs_analysis.evidence.clusters import ConditionEvidence
from impact_rs_analysis.evidence.rollouts import Added, Rollout, RolloutStore
from impact_rs_sim.effects import Effect
from impact_rs_sim.model import JOINT_COUNT, Model
from impact_rs_sim.robot import Array

SIGNIFICANT = 0.01  # false-discovery rate at which an effect is accepted
NOTHING = 0.1  # p in free motion above which an effect is ruled out
SHORTLIST = 5  # candidates refined through the twin in every round
MOST_EFFECTS = 3
FIT_STEPS = 4
ENOUGH = 0.02  # of the error; a fit that gains less in a step is finished trial by trial
LEAST_GAIN = 0.10  # share of the excess error that an accepted effect must remove on unseen conditions
HOPELESS = 3.0  # a fit whose squared error is so many times that of the best is not followed, or ruled out
SHORTEST_LESSON = 0.5  # parameter scales
MOST_LOOKS = 4
NEAR = 0.1  # parameter scales; a correction below this does not depend on where a trial starts
LEAST_EXCESS = 0.05  # mean square error in units of the scale of repetition; less concerns nobody


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

    @property
    def evidence(self) -> list[ConditionEvidence]:
        """What it was fitted to."""
        return self.equations.evidence


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
        measure_again: Scaled residuals with effects switched on, every trial's twin started where the trial started;
            None where the twin then hits nothing.
    """

    def __init__(
        self,
        effects: list[Effect],
        model: Model,
        evidence: list[ConditionEvidence],
        store: RolloutStore,
        measure_again: Callable[[Added], list[ConditionEvidence] | None],
    ) -> None:
        self.model, self.evidence, self.store, self._measure_again = model, evidence, store, measure_again
        self.signs = random_signs(evidence)
        self.before = np.array([np.mean(np.square(item.mean)) for item in evidence])
        self.noise = np.array([np.mean(np.square(item.pure)) / item.count for item in evidence])
        absent = self._absent(effects)
        self.ruled_out = set(absent)
        self._prefetch([effect for effect in effects if effect.name not in self.ruled_out], concerns)
        self.singles: dict[str, Candidate] = {}
        for effect in effects:
            known = absent.get(effect.name)
            candidate = linearise((effect,), model, evidence, store) if known is None else known
            if candidate is not None:
                self.singles[effect.name] = candidate
        self.fits = {name: fit(candidate, evidence) for name, candidate in self.singles.items()}
        self.p_values = self.p_values_given(None)

    def _absent(self, effects: list[Effect]) -> dict[str, Candidate]:
        """Effects that free motion there and back rules out, with their sensitivities there.

        Those with several parameters, up to two for every joint, are dear to look at in every push as well. What shows
        nothing in free motion is not there. Nor is what cannot explain it, where a single other effect does.
        """
        free = [number for number, item in enumerate(self.evidence) if not item.condition.plan.expects_impact]
        evidence = [self.evidence[number] for number in free]
        seen = [effect for effect in effects if any(in_free_motion(effect, item.condition) for item in evidence)]
        dear = {effect.name for effect in seen if len(effect.scalars(JOINT_COUNT)) > 1}
        if not dear:
            return {}
        self._prefetch(seen, in_free_motion)
        alone: dict[str, Candidate] = {}
        for effect in seen:
            candidate = linearise((effect,), self.model, self.evidence, self.store, where=in_free_motion)
            if candidate is not None:
                alone[effect.name] = candidate
        absent = {
            name for name in dear & alone.keys() if self._p_value(NormalEquations(alone[name], self.evidence)) > NOTHING
        }
        rest = {name: alone[name].only(free) for name in alone.keys() - absent}
        if dear & rest.keys():
            absent |= dear & self._cannot_explain(rest, free)
        return {name: alone[name] for name in absent}

    def _cannot_explain(self, candidates: dict[str, Candidate], conditions: list[int]) -> set[str]:
        """Candidates that are far from explaining what is measured in some conditions, where one of them does."""
        evidence, enough = [self.evidence[number] for number in conditions], 2.0 * LEAST_EXCESS
        noise = float(self.noise[conditions].mean())
        if float(self.before[conditions].mean()) - noise < enough:
            return set()
        fits = {name: self._see_all(self.refine(candidate, evidence)) for name, candidate in sorted(candidates.items())}
        errors = {name: _error(fitted, fitted.change) for name, fitted in fits.items()}
        best = min(errors.values(), default=np.inf)
        if best - noise > enough:
            return set()
        return {name for name, error in errors.items() if error > HOPELESS * max(best, enough)}

    def _p_value(self, equations: NormalEquations, base: tuple[float, Array | float] = (0.0, 0.0)) -> float:
        """p of an effect, not adjusted; ``base``: statistic and null statistics of what it is added to."""
        observed, null = equations.statistic() - base[0], equations.null_statistics(self.signs) - base[1]
        return tail_probability(observed, np.maximum(null, 0.0))

    def _prefetch(self, effects: list[Effect], where: Where) -> None:
        """Run rollouts of the screening in one parallel batch."""
        wanted: list[Rollout] = []
        for item in self.evidence:
            wanted.append(Rollout(item.condition, self.model))
            for effect in effects:
                if not where(effect, item.condition):
                    continue
                point = nominal_vector(effect)
                for index, step in enumerate(steps(effect, point)):
                    moved = point.copy()
                    moved[index] += step
                    wanted.append(Rollout(item.condition, self.model, ((effect.name, tuple(map(float, moved))),)))
        self.store(wanted, "sensitivities of all effects")

    @property
    def lack_of_fit(self) -> float:
        """p of the residuals being pure error, before any effect is added."""
        return self.lack_of_fit_of(None)

    def lack_of_fit_of(self, chosen: Fit | None) -> float:
        """p of what a fit leaves being pure error."""
        observed, null = 0.0, np.zeros(self.signs[0].shape[0])
        evidence = self.evidence if chosen is None else chosen.evidence
        for number, (item, flips) in enumerate(zip(evidence, self.signs, strict=True)):
            rest = item.mean
            if chosen is not None:
                rest = chosen.equations.targets[number] - chosen.candidate.jacobians[number] @ chosen.change
            observed += item.count * float(rest @ rest)
            flipped = flips @ item.deviations
            null += np.einsum("bf,bf->b", flipped, flipped) / item.count
        return tail_probability(observed, null)

    def p_values_given(self, chosen: Fit | None) -> dict[str, float]:
        """p per effect, given effects already chosen; adjusted for looking at all of them (Benjamini-Hochberg)."""
        raw = {}
        evidence = self.evidence if chosen is None else chosen.evidence
        base: tuple[float, Array | float] = (0.0, 0.0)
        if chosen is not None:
            base = chosen.equations.statistic(), chosen.equations.null_statistics(self.signs)
        for name, candidate in self._joined(chosen):
            raw[name] = self._p_value(NormalEquations(candidate, evidence), base)
        if not raw:
            return {}
        return dict(zip(raw, false_discovery_control(list(raw.values())).tolist(), strict=True))

    def _joined(self, chosen: Fit | None) -> list[tuple[str, Candidate]]:
        """Every effect that is not chosen yet, together with those that are."""
        if chosen is None:
            return list(self.singles.items())
        return [
            (name, combine(chosen.candidate, candidate))
            for name, candidate in self.singles.items()
            if name not in chosen.candidate.names
        ]

    def excess(self, held_out: Array) -> float:
        """Mean held-out error above what pure error explains [-]."""
        return float(np.mean(np.maximum(held_out - self.noise, 0.0)))

    def proposals(self, shortlist: list[Fit]) -> list[Fit]:
        """The shortlist fitted through the twin, best first; what falls far behind is not followed to its end."""
        found: list[Fit] = []
        for entry in shortlist:
            beat = min((proposal.score for proposal in found), default=np.inf)
            found.append(self.refine(entry.candidate, entry.evidence, HOPELESS * beat))
        best = min(proposal.score for proposal in found)
        seen = [self._see_all(proposal) if proposal.score <= HOPELESS * best else proposal for proposal in found]
        return sorted(seen, key=lambda proposal: proposal.score)

    def _see_all(self, fitted: Fit) -> Fit:
        """Go on with new sensitivities where a parameter could not be seen at the nominal point."""
        candidate = fitted.candidate
        if not candidate.unseen:
            return fitted
        fresh = linearise(
            candidate.effects,
            self.model,
            fitted.evidence,
            self.store,
            fitted.estimate,
            "sensitivities",
            candidate.origin,
        )
        if fresh is None:
            return fitted
        again = self.refine(fresh, fitted.evidence)
        return again if again.score < fitted.score else fitted

    def refine(
        self, candidate: Candidate, evidence: list[ConditionEvidence] | None = None, give_up: float = np.inf
    ) -> Fit:
        """Fit through the twin: Gauss-Newton whose sensitivities learn from every step (Broyden's good update).

        Args:
            candidate: Where to start.
            evidence: What to explain; None: that of the model.
            give_up: After its first step a fit whose error is larger than this ends.
        """
        evidence = self.evidence if evidence is None else evidence
        best = fit(candidate, evidence)
        nothing = np.zeros_like(best.change)
        best_error = _error(best, nothing)
        point, fraction = best.estimate, 1.0
        for number in range(FIT_STEPS):
            if number >= 1 and best_error > give_up:
                break
            step = fraction * (point - candidate.point)
            if np.max(np.abs(step / candidate.scale)) < 1e-6:
                break
            moved = self._at(candidate, candidate.point + step, evidence)
            if moved is None:
                fraction /= 3.0
                continue
            tried = fit(_broyden(candidate, moved), evidence)
            error = _error(tried, nothing)
            if error < best_error:
                gained = best_error - error
                candidate, best, best_error, fraction = tried.candidate, tried, error, 1.0
                point = best.estimate
                if gained < ENOUGH * best_error:
                    break
            else:
                candidate = replace(candidate, jacobians=tried.candidate.jacobians)
                best = fit(candidate, evidence)
                if fraction < 1.0:
                    break
                fraction, point = 1.0 / 3.0, best.estimate
        return best

    def measure_again(self, chosen: Fit) -> Fit:
        """The fit against residuals of the twin with the chosen effects, trial by trial.

        Up to here the effects were switched on where a trial should start, not where it did start; the last correction
        of the estimate, its interval and the lack of fit come from here.
        """
        for look in range(MOST_LOOKS):
            candidate, point = chosen.candidate, chosen.estimate
            added = candidate.split(point)
            evidence = self._measure_again(added)
            if evidence is None:
                return chosen
            fresh = None
            if look == 0:
                fresh = linearise(
                    candidate.effects, self.model, evidence, self.store, point, "final sensitivities", added
                )
            if fresh is None:
                nothing = tuple(np.zeros_like(item.sigma) for item in evidence)
                fresh = replace(candidate, point=point, origin=added, offsets=nothing)
            chosen = self.refine(fresh, evidence)
            if np.all(np.abs(chosen.estimate - point) < NEAR * candidate.scale):
                break
        return chosen

    def _at(self, candidate: Candidate, point: Array, evidence: list[ConditionEvidence]) -> Candidate | None:
        """The candidate with its features evaluated at another point, sensitivities kept."""
        added = candidate.split(point)
        conditions = [item.condition for item in evidence]
        both = self.store(
            [
                Rollout(condition, self.model, values)
                for values in (candidate.origin, added)
                for condition in conditions
            ],
            "fit of the shortlist",
        )
        offsets = []
        for before, there, item in zip(both[: len(evidence)], both[len(evidence) :], evidence, strict=True):
            if before is None or there is None:
                return None
            offsets.append((there - before) / item.sigma)
        return replace(candidate, point=point, offsets=tuple(offsets))

    def shortlist(self, chosen: Fit | None, count: int = SHORTLIST) -> list[Fit]:
        """Most promising candidates for one more effect, by their linear held-out error."""
        evidence = self.evidence if chosen is None else chosen.evidence
        ranked = [fit(candidate, evidence) for name, candidate in self._joined(chosen) if name not in self.ruled_out]
        return sorted(ranked, key=lambda entry: entry.score)[:count]

    def best_pairs(self, count: int = 2) -> list[Candidate]:
        """Most promising pairs among the better half of the effects, by their linear held-out error."""
        likely = (name for name in self.fits if name not in self.ruled_out)
        names = sorted(likely, key=lambda name: self.fits[name].score)[:10]
        ranked = []
        for first, second in combinations(names, 2):
            joined = combine(self.singles[first], self.singles[second])
            ranked.append((fit(joined, self.evidence).score, joined))
        return [candidate for _, candidate in sorted(ranked, key=lambda entry: entry[0])[:count]]


def _error(fitted: Fit, change: Array) -> float:
    return float(np.mean(fitted.equations.errors(change)))


def _broyden(before: Candidate, after: Candidate) -> Candidate:
    """Sensitivities that give the step just made exactly, and change as little as they can otherwise.

    A short step teaches nothing: when an impact falls into another control tick, features jump a little.
    """
    step = (after.point - before.point) / before.scale
    if np.max(np.abs(step)) < SHORTEST_LESSON:
        return replace(after, jacobians=before.jacobians)
    jacobians = tuple(
        jacobian + np.outer(there - here - jacobian @ step, step) / (step @ step)
        for jacobian, here, there in zip(before.jacobians, before.offsets, after.offsets, strict=True)
    )
    return replace(after, jacobians=jacobians)
