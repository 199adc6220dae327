# SPDX-License-Identifier: Apache-2.0
"""Fitting a candidate through the model: Gauss-Newton whose sensitivities learn from every step (Broyden)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.candidate import Candidate, Problem, linearise
from impact_rs_analysis.diagnosis.reference import BlockReference, Reference, RotationReference
from impact_rs_analysis.evidence.cluster import Cluster, Source, size_of
from impact_rs_sim.robot import Array

STEPS = 6
STRAIGHT = 0.75  # of the gain that sensitivities promise; with less, a candidate of few parameters gets new ones
FEW = 4  # parameters
ENOUGH = 0.02  # of the error; a fit that gains less in a step is finished
MUCH = 0.2  # of the error; a fit that gains so much in a step has not arrived
SHORTEST_LESSON = 0.5  # parameter scales
NEAR = 0.1  # parameter scales; a correction below this does not depend on where a trial starts
MOST_LOOKS = 4
POOR = 1.5  # times the squared error that is expected; a fit with less has nothing to look for elsewhere
HOPELESS = 3.0  # a fit whose squared error is so many times that of the best is not followed


@dataclass(frozen=True)
class Evidence:
    """Some clusters of a source, with residuals of the model or of the model with effects switched on.

    Attributes:
        source: Where they come from, and what predicts them.
        numbers: Their numbers in the source.
        clusters: Residuals.
        thrifty: Whether one repeat of every condition tells what a change does to all of them.
    """

    source: Source
    numbers: tuple[int, ...]
    clusters: tuple[Cluster, ...]
    thrifty: bool = False

    @staticmethod
    def of(source: Source, numbers: Sequence[int] | None = None, thrifty: bool = False) -> Evidence:
        """Residuals of the model; None: in all clusters."""
        chosen = tuple(range(len(source.clusters)) if numbers is None else numbers)
        return Evidence(source, chosen, tuple(source.clusters[number] for number in chosen), thrifty)

    @cached_property
    def reference(self) -> Reference:
        """What is due to chance."""
        return (RotationReference if self.source.repeated else BlockReference)(self.clusters)

    @cached_property
    def lack_of_fit(self) -> float | None:
        """p of the residuals being noise and discrepancy; None where nothing tells."""
        return self.reference.lack_of_fit([item.mean for item in self.clusters])

    @cached_property
    def errors(self) -> Array:
        """Mean square of the mean residual by cluster, ``(c,)`` [-]."""
        return np.array([item.error for item in self.clusters])

    @cached_property
    def expected(self) -> Array:
        """What :attr:`errors` are by repetition and discrepancy alone, ``(c,)`` [-]."""
        return np.array([item.expected for item in self.clusters])

    @cached_property
    def guard(self) -> tuple[tuple[int, ...], ...] | None:
        """Neighbours of every cluster on the same recording, which know too much of it; None for trials."""
        if self.source.repeated:
            return None
        place = {number: position for position, number in enumerate(self.numbers)}
        units = [item.unit for item in self.clusters]
        return tuple(
            tuple(
                place[near]
                for near in (number - 1, number + 1)
                if near in place and units[place[near]] == units[position]
            )
            for position, number in enumerate(self.numbers)
        )

    def only(self, positions: Sequence[int]) -> Evidence:
        """The same in some of the clusters, by position."""
        return replace(
            self,
            numbers=tuple(self.numbers[position] for position in positions),
            clusters=tuple(self.clusters[position] for position in positions),
        )

    def excess(self, errors: Array) -> float:
        """Mean square error above what repetition and discrepancy explain [-]."""
        return float(np.mean(np.maximum(errors - self.expected, 0.0)))

    def size(self, errors: Array) -> float:
        """Mean square errors by cluster on the scale on which 1 is what repetition alone leaves."""
        return size_of(errors, self.expected)

    def problem(self, candidate: Candidate) -> Problem:
        """Least squares of a candidate that is linearised in these clusters."""
        return Problem(candidate, self.clusters, self.guard)

    def shifted(self, changes: Sequence[Array]) -> Evidence:
        """The same with something taken off the residuals of every cluster, ``(F,)`` each [-]."""
        clusters = tuple(
            replace(item, residuals=item.residuals - change)
            for item, change in zip(self.clusters, changes, strict=True)
        )
        return replace(self, clusters=clusters)


@dataclass(frozen=True)
class Fit:
    """A candidate fitted to evidence.

    Attributes:
        candidate: Linearised near the estimate.
        evidence: What it was fitted to.
        problem: Its least-squares problem.
        change: From the candidate's point to the estimate, in parameter scales, ``(p,)``.
    """

    candidate: Candidate
    evidence: Evidence
    problem: Problem
    change: Array

    @staticmethod
    def of(candidate: Candidate, evidence: Evidence) -> Fit:
        """Fit a candidate where it is linearised."""
        problem = evidence.problem(candidate)
        return Fit(candidate, evidence, problem, problem.solve())

    @cached_property
    def estimate(self) -> Array:
        """Estimated parameters in their own units, ``(p,)``."""
        candidate = self.candidate
        return np.clip(candidate.point + self.change * candidate.scale, candidate.lower, candidate.upper)

    @property
    def held_out(self) -> Array:
        """Mean square scaled error per cluster, predicted from all others, ``(c,)`` [-]."""
        return self.problem.held_out

    @property
    def score(self) -> float:
        """Mean over clusters of the held-out error [-]."""
        return float(self.held_out.mean())

    @cached_property
    def half_widths(self) -> Array:
        """Half widths of the 95 % intervals in parameter scales, ``(p,)``."""
        return self.widths(0.95)

    def widths(self, confidence: float) -> Array:
        """Half widths of intervals in parameter scales, ``(p,)``, with what the clocks may be off."""
        clock = confidence * self.evidence.source.clock  # of equally likely offsets
        unsure = np.array([clock if scalar.unit == "s" else 0.0 for scalar in self.candidate.scalars])
        own = self.problem.half_widths(self.change, self.evidence.reference, confidence)
        moved = scipy.stats.norm.ppf(0.5 + confidence / 2.0) * self.problem.moved_by_clock()
        return np.asarray(np.sqrt(own**2 + moved**2 + (unsure / self.candidate.scale) ** 2))

    @property
    def misfit(self) -> float:
        """Mean square error at the estimate, all clusters [-]."""
        return float(np.mean(self.problem.errors(self.change)))

    @cached_property
    def rest(self) -> list[Array]:
        """What the fit leaves of the mean residuals, ``(F,)`` per cluster [-]."""
        return self.problem.rest(self.change)

    @cached_property
    def left(self) -> Evidence:
        """The evidence less what the fit explains."""
        return self.evidence.shifted(
            [item.mean - rest for item, rest in zip(self.evidence.clusters, self.rest, strict=True)]
        )

    def lack_of_fit(self) -> float | None:
        """p of what is left being noise and discrepancy; None where nothing tells."""
        return self.evidence.reference.lack_of_fit(self.rest)


def refine(candidate: Candidate, evidence: Evidence, give_up: float = np.inf, steps: int = STEPS) -> Fit:
    """Fit through the model.

    Args:
        candidate: Where to start, linearised.
        evidence: What to explain.
        give_up: After its first step a fit whose held-out error is larger than this ends.
        steps: Most of them that lower the error; as long as each takes much of what is left, there is another.
    """
    best = Fit.of(candidate, evidence)
    nothing = np.zeros_like(best.change)
    best_error = float(np.mean(best.problem.errors(nothing)))
    point, fraction, lowered, falling = best.estimate, 1.0, 0, False
    for number in range(STEPS):
        if (number >= 1 and best_error > give_up) or (lowered >= steps and not falling):
            break
        step = fraction * (point - candidate.point)
        if np.max(np.abs(step / candidate.scale)) < 1e-6:
            break
        expected = best_error - float(np.mean(best.problem.errors(step / candidate.scale)))
        moved = evaluate_at(candidate, candidate.point + step, evidence)
        if moved is None:
            fraction /= 3.0
            continue
        tried = Fit.of(_broyden(candidate, moved), evidence)
        error = float(np.mean(tried.problem.errors(nothing)))
        if error < best_error:
            lowered, falling = lowered + 1, error < (1.0 - MUCH) * best_error
            gained = best_error - error
            bent = gained < STRAIGHT * expected or fraction < 1.0
            if bent and candidate.point.size <= FEW:
                tried = _afresh(tried)
            candidate, best, best_error, fraction = tried.candidate, tried, error, 1.0
            point = best.estimate
            if gained < ENOUGH * best_error:
                break
        elif fraction < 1.0:
            break
        else:
            point, fraction = candidate.point + step, _turning_point(candidate, moved, evidence)
            candidate = replace(candidate, jacobians=tried.candidate.jacobians)
            best = Fit.of(candidate, evidence)
    return best


def _turning_point(before: Candidate, after: Candidate, evidence: Evidence) -> float:
    """Share of a step that went too far after which the error is least, between 0.05 and 0.9.

    Along the step features go from here, with the slope k that the sensitivities know, to there, as
    d k t / (1 + (k - 1) t): exact for what goes with the inverse of a parameter, as deflection does with stiffness.
    Least squares of d gives how far they shall go.
    """
    step = (after.point - before.point) / before.scale
    rows = [
        (item.count, jacobian @ step, there - here, item.mean - here)
        for item, jacobian, here, there in zip(
            evidence.clusters, before.jacobians, before.offsets, after.offsets, strict=True
        )
    ]
    size = sum(count * float(moved @ moved) for count, _, moved, _ in rows)
    slope = sum(count * float(tangent @ moved) for count, tangent, moved, _ in rows)
    wanted = sum(count * float(rest @ moved) for count, _, moved, rest in rows)
    if not 0.0 < wanted < size or slope <= 0.0:
        return 1.0 / 3.0
    k, g = slope / size, wanted / size
    return float(np.clip(g / (k - (k - 1.0) * g), 0.05, 0.9))


def _afresh(fitted: Fit) -> Fit:
    """The same with sensitivities of its point, where those of another led astray: a bounce is nothing linear."""
    return Fit.of(_relinearised(fitted.candidate, fitted.evidence), fitted.evidence)


def _relinearised(candidate: Candidate, evidence: Evidence) -> Candidate:
    """New sensitivities; features stay those of all repeats, of which sensitivities look at one."""
    fresh = linearise(candidate, evidence.clusters, evidence.numbers, evidence.source, "new sensitivities")
    return candidate if fresh is None else replace(candidate, jacobians=fresh.jacobians)


def see_all(fitted: Fit) -> Fit:
    """Go on with new sensitivities where a parameter could not be seen at the nominal point."""
    candidate, evidence = fitted.candidate, fitted.evidence
    if not candidate.unseen:
        return fitted
    moved = evaluate_at(candidate, fitted.estimate, evidence)
    if moved is None:
        return fitted
    again = refine(_relinearised(moved, evidence), evidence)
    return again if again.score < fitted.score else fitted


def look_elsewhere(fitted: Fit) -> Fit:
    """Begin again further away where a fit does not fit, since what is in contact may change on the way there.

    A box that stands flat tips only with its weight beyond some offset; before that nothing tells which way to go.
    """
    scalars = fitted.candidate.scalars
    for _ in scalars:
        evidence = fitted.evidence
        if fitted.misfit <= POOR * float(evidence.expected.mean()):
            break
        glance = replace(evidence, thrifty=True)
        places = []
        for index, scalar in enumerate(scalars):
            for value in scalar.far:
                point = fitted.estimate.copy()
                point[index] = value
                if (moved := evaluate_at(fitted.candidate, point, glance)) is not None:
                    places.append(moved)
        if not places:
            break
        errors = [float(np.mean(evidence.problem(moved).errors(np.zeros_like(moved.point)))) for moved in places]
        if min(errors) >= fitted.misfit:
            break
        best = places[int(np.argmin(errors))]
        best = best if evidence.thrifty else evaluate_at(best, best.point, evidence) or best
        again = refine(_relinearised(best, evidence), evidence)
        if again.misfit >= fitted.misfit:
            break
        fitted = again
    return fitted


def measure_again(fitted: Fit) -> Fit:
    """The fit against residuals taken with its effects switched on, trial by trial.

    Up to here the effects were switched on where a trial should start, not where it did start; the last correction of
    the estimate, its interval and the lack of fit come from here.
    """
    like = fitted.evidence
    for look in range(MOST_LOOKS):
        candidate, point = fitted.candidate, fitted.estimate
        added = candidate.split(point)
        clusters = like.source.measure_again(added, [like.source.clusters[number] for number in like.numbers])
        if clusters is None:
            return fitted
        evidence = replace(like, clusters=tuple(clusters))
        nothing = tuple(np.zeros_like(item.sigma) for item in clusters)
        fresh = replace(candidate, point=point, origin=added, offsets=nothing)
        if look == 0:
            fresh = linearise(fresh, clusters, like.numbers, like.source, "final sensitivities") or fresh
        fitted = refine(fresh, evidence)
        if np.all(np.abs(fitted.estimate - point) < NEAR * candidate.scale):
            break
    return fitted


def evaluate_at(candidate: Candidate, point: Array, evidence: Evidence) -> Candidate | None:
    """The candidate with its features evaluated at another point, sensitivities kept."""
    # Joints are smooth: what many parameters do is the same in all repeats, and a bounce has few.
    every = candidate.point.size <= FEW and not evidence.thrifty
    changes = evidence.source.differences(
        evidence.numbers, candidate.origin, candidate.split(point), "fit of the shortlist", every
    )
    if any(change is None for change in changes):
        return None
    offsets = tuple(np.asarray(change) / item.sigma for change, item in zip(changes, evidence.clusters, strict=True))
    return replace(candidate, point=point, offsets=offsets)


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
