"""Candidates: effects, alone or together, with their sensitivities, fitted to the evidence.

In scaled coordinates the mean residual of condition c is

    r_c = J_c (theta - theta_0) + noise,        cov(noise) = pure error / n_c

fitted by bounded least squares with a weak prior of width ``PRIOR`` parameter scales. What the fit is judged by is its
error on conditions it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from impact_rs_analysis.diagnosis.sensitivity import Where, concerns, nominal_vector, steps
from impact_rs_analysis.evidence.clusters import ConditionEvidence
from impact_rs_analysis.evidence.rollouts import Added, Rollout, RolloutStore
from impact_rs_sim.effects import Effect, ScalarParameter
from impact_rs_sim.model import JOINT_COUNT, Model
from impact_rs_sim.robot import Array

PRIOR = 100.0  # parameter scales; only keeps what cannot be seen from running away


@dataclass(frozen=True)
class Candidate:
    """One or several effects, linearised about ``point``.

    Attributes:
        effects: The effects.
        point: Parameter values of the linearisation, all effects after each other, ``(p,)``.
        offsets: Per condition, scaled features at ``point`` minus those at ``origin``, ``(F,)`` each.
        jacobians: Per condition, scaled features per parameter scale, ``(F, p)`` each.
        origin: What was switched on, on top of the model, in the twin that the evidence was held against.
    """

    effects: tuple[Effect, ...]
    point: Array
    offsets: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    origin: Added = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def scalars(self) -> list[ScalarParameter]:
        """All parameters."""
        return [scalar for effect in self.effects for scalar in effect.scalars(JOINT_COUNT)]

    @property
    def scale(self) -> Array:
        """Scale of each parameter, ``(p,)``."""
        return np.array([scalar.scale for scalar in self.scalars])

    @property
    def lower(self) -> Array:
        """Lower bounds, ``(p,)``."""
        return np.array([scalar.lower for scalar in self.scalars])

    @property
    def upper(self) -> Array:
        """Upper bounds, ``(p,)``."""
        return np.array([scalar.upper for scalar in self.scalars])

    @property
    def nominal(self) -> Array:
        """Values at which nothing happens, ``(p,)``."""
        return np.array([scalar.nominal for scalar in self.scalars])

    @property
    def unseen(self) -> bool:
        """Whether some parameter moves nothing here, like the centre of a payload without mass."""
        return bool(np.any(np.all([np.all(jacobian == 0.0, axis=0) for jacobian in self.jacobians], axis=0)))

    def only(self, conditions: list[int]) -> Candidate:
        """The same in some of the conditions, by number."""
        return replace(
            self,
            offsets=tuple(self.offsets[number] for number in conditions),
            jacobians=tuple(self.jacobians[number] for number in conditions),
        )

    def split(self, vector: Array) -> Added:
        """Effect names with their own parameter values."""
        result, start = [], 0
        for effect in self.effects:
            count = len(effect.scalars(JOINT_COUNT))
            result.append((effect.name, tuple(float(value) for value in vector[start : start + count])))
            start += count
        return tuple(result)


def linearise(
    effects: tuple[Effect, ...],
    model: Model,
    evidence: list[ConditionEvidence],
    store: RolloutStore,
    point: Array | None = None,
    what: str = "sensitivities",
    origin: Added = (),
    where: Where = concerns,
) -> Candidate | None:
    """Sensitivities about ``point`` (None: where the effects do nothing); None where the twin misses the object.

    ``origin`` is what was switched on in the twin that the evidence was held against; ``where`` says in which
    conditions an effect is looked at, elsewhere its sensitivities are zero.
    """
    if point is None:
        point = np.concatenate([nominal_vector(effect) for effect in effects])
    empty = Candidate(effects, point, (), (), origin)
    step = np.concatenate([steps(effect, point[part]) for effect, part in _parts(effects)])
    at_nominal = not origin and bool(np.all(point == empty.nominal))
    wanted: list[Rollout] = []
    for item in evidence:
        wanted.append(Rollout(item.condition, model, origin))
        if not at_nominal:
            wanted.append(Rollout(item.condition, model, empty.split(point)))
        for effect, part in _parts(effects):
            if not where(effect, item.condition):
                continue
            for index in range(part.start, part.stop):
                moved = point.copy()
                moved[index] += step[index]
                wanted.append(Rollout(item.condition, model, _moved(empty, moved, at_nominal, effect)))
    results = iter(store(wanted, what))
    offsets, jacobians = [], []
    for item in evidence:
        base = next(results)
        here = base if at_nominal else next(results)
        if base is None or here is None:
            return None
        jacobian = np.zeros((base.size, point.size))
        for effect, part in _parts(effects):
            if not where(effect, item.condition):
                continue
            for index in range(part.start, part.stop):
                there = next(results)
                if there is None:
                    return None
                jacobian[:, index] = (there - here) / item.sigma * empty.scale[index] / step[index]
        offsets.append((here - base) / item.sigma)
        jacobians.append(jacobian)
    return replace(empty, offsets=tuple(offsets), jacobians=tuple(jacobians))


def _moved(candidate: Candidate, moved: Array, at_nominal: bool, effect: Effect) -> Added:
    """What is switched on: at the nominal point the other effects do nothing and are left out: results are shared."""
    parts = candidate.split(moved)
    return tuple(part for part in parts if not at_nominal or part[0] == effect.name)


def _parts(effects: tuple[Effect, ...]) -> list[tuple[Effect, slice]]:
    result, start = [], 0
    for effect in effects:
        count = len(effect.scalars(JOINT_COUNT))
        result.append((effect, slice(start, start + count)))
        start += count
    return result


def combine(first: Candidate, second: Candidate) -> Candidate:
    """Both together, each linearised where it was: exact for small effects, a start for large ones."""
    return Candidate(
        effects=first.effects + second.effects,
        point=np.concatenate((first.point, second.point)),
        offsets=tuple(a + b for a, b in zip(first.offsets, second.offsets, strict=True)),
        jacobians=tuple(np.hstack((a, b)) for a, b in zip(first.jacobians, second.jacobians, strict=True)),
        origin=first.origin,
    )


class NormalEquations:
    """The least-squares problem of a candidate, ready to leave conditions out.

    Args:
        candidate: Effects with sensitivities.
        evidence: Residuals, in the same order of conditions.
    """

    def __init__(self, candidate: Candidate, evidence: list[ConditionEvidence]) -> None:
        self.candidate = candidate
        self.evidence = evidence
        self.targets = [item.mean - offset for item, offset in zip(evidence, candidate.offsets, strict=True)]
        self.information = [
            item.count * jacobian.T @ jacobian for item, jacobian in zip(evidence, candidate.jacobians, strict=True)
        ]
        self.score = [
            item.count * jacobian.T @ target
            for item, jacobian, target in zip(evidence, candidate.jacobians, self.targets, strict=True)
        ]
        self._total = np.sum(self.information, axis=0)
        self._total_score = np.sum(self.score, axis=0)
        scale = candidate.scale
        self._lower = (candidate.lower - candidate.point) / scale
        self._upper = (candidate.upper - candidate.point) / scale
        self._prior = np.full(scale.size, 1.0 / PRIOR**2)
        self._prior_pull = (candidate.nominal - candidate.point) / scale * self._prior

    def solve(self, without: int | None = None) -> Array:
        """Change from the candidate's point in parameter scales, ``(p,)``; ``without`` leaves one condition out."""
        information, score = self._total, self._total_score
        if without is not None:
            information, score = information - self.information[without], score - self.score[without]
        information = information + np.diag(self._prior)
        score = score + self._prior_pull
        change = np.linalg.solve(information, score)
        if np.all(change >= self._lower - 1e-12) and np.all(change <= self._upper + 1e-12):
            return change
        root = np.linalg.cholesky(information).T
        width = np.maximum(self._upper - self._lower, 1e-9)
        return np.asarray(lsq_linear(root, np.linalg.solve(root.T, score), bounds=(self._lower, self._lower + width)).x)

    def errors(self, change: Array, conditions: list[int] | None = None) -> Array:
        """Mean square scaled error per condition at a change from the point, ``(c,)`` [-]."""
        chosen = range(len(self.evidence)) if conditions is None else conditions
        return np.array([np.mean(np.square(self.targets[c] - self.candidate.jacobians[c] @ change)) for c in chosen])

    @cached_property
    def left_out(self) -> Array:
        """Estimates without one condition each, as changes in parameter scales, ``(c, p)``."""
        return np.array([self.solve(without=c) for c in range(len(self.evidence))])

    def held_out(self) -> Array:
        """Mean square scaled error of every condition, predicted from all others, ``(c,)`` [-]."""
        return np.array([self.errors(change, [c])[0] for c, change in enumerate(self.left_out)])

    def spread(self) -> Array:
        """Standard error of each estimate in parameter scales, ``(p,)``.

        The larger of two: what repetition explains (:meth:`covariance`), and how far the conditions disagree
        (delete-one jackknife), which also holds what the model does not get right.
        """
        count = len(self.evidence)
        jackknife = (count - 1) / count * np.square(self.left_out - self.left_out.mean(axis=0)).sum(axis=0)
        return np.sqrt(np.maximum(jackknife, np.diag(self.covariance())))

    def covariance(self) -> Array:
        """Covariance of the estimate in parameter scales, trial by trial (sandwich), ``(p, p)``.

        Trials are independent of each other, their features are not: the spread of the trials' own scores says how
        sure the estimate is, whatever is correlated within a trial.
        """
        inverse = np.linalg.inv(self._total + np.diag(self._prior))
        meat = np.zeros_like(inverse)
        freedom = 0
        for item, jacobian in zip(self.evidence, self.candidate.jacobians, strict=True):
            scores = item.deviations @ jacobian
            meat += scores.T @ scores
            freedom += item.count - 1
        return np.asarray(inverse @ meat @ inverse)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the pure error."""
        return sum(item.count - 1 for item in self.evidence)

    def statistic(self, scores: list[Array] | None = None) -> float:
        """Reduction of the weighted squares by the unbounded fit: large when the effect explains something."""
        total = self._total_score if scores is None else np.sum(scores, axis=0)
        information = self._total + np.diag(self._prior)
        return float(total @ np.linalg.solve(information, total))

    def null_statistics(self, signs: list[Array]) -> Array:
        """:meth:`statistic` when there is nothing but pure error: signs of the repeats flipped at random, ``(B,)``.

        Args:
            signs: Per condition, ``(B, n_c)`` of +1 and -1.
        """
        total = np.zeros((signs[0].shape[0], self._total.shape[0]))
        for item, jacobian, flips in zip(self.evidence, self.candidate.jacobians, signs, strict=True):
            total += flips @ (item.deviations @ jacobian)
        solved = np.linalg.solve(self._total + np.diag(self._prior), total.T)
        return np.asarray(np.einsum("bp,pb->b", total, solved))


def random_signs(evidence: list[ConditionEvidence], count: int = 2000, seed: int = 0) -> list[Array]:
    """Random signs for :meth:`NormalEquations.null_statistics`; the same for every candidate."""
    rng = np.random.default_rng(seed)
    return [rng.choice([-1.0, 1.0], size=(count, item.count)) for item in evidence]


def tail_probability(observed: float, null: Array) -> float:
    """p of ``observed`` under ``null``: counted, and beyond that by a scaled chi-square (Satterthwaite)."""
    from scipy.stats import chi2

    counted = (1.0 + np.count_nonzero(null >= observed)) / (1.0 + null.size)
    if counted > 20.0 / null.size:
        return float(counted)
    mean, variance = float(null.mean()), float(null.var())
    if mean <= 0.0 or variance <= 0.0:
        return float(counted)
    freedom = 2.0 * mean**2 / variance
    return float(min(counted, max(chi2.sf(observed * freedom / mean, freedom), 1e-300)))
