# SPDX-License-Identifier: Apache-2.0
"""Fit of a candidate by simulation: Gauss-Newton with secant updates of the sensitivities (Broyden)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.candidate import Candidate, Problem, linearise
from impact_rs_analysis.diagnosis.null_distribution import NullDistribution, RotationNull, SignFlipNull
from impact_rs_analysis.diagnosis.thresholds import LEAST_GAIN, LEAST_GAIN_IN_ONE
from impact_rs_analysis.evidence.cluster import Cluster, size_of
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.robot import Array

STEPS = 6
STRAIGHT = 0.75  # of the predicted gain; below, sensitivities of a candidate of few parameters are computed anew
FEW = 4  # parameters
ENOUGH = 0.02  # of the error; a fit that gains less in a step has converged
NEAR_STEPS = (0.3, 0.1)  # shares of the steps of finite differences, as a fit comes near its optimum
HALVES = (1.0, 0.5, 0.25)  # shares of a step that are tried
SHORTEST_LESSON = 0.5  # parameter scales; shorter steps update no sensitivities
NEAR = 0.1  # parameter scales; a correction below this does not depend on where a trial starts
MOST_LOOKS = 4
DOUBLINGS = 8  # of the half width of an interval
BENT = 0.5  # of the rise of the squares in a straight model; below, an end of an interval lies further out
POOR = 1.5  # times the expected squared error; a fit below it needs no other start
WIDENINGS = 4  # of the range of a parameter, to sixteen times its declared width
HOPELESS = 3.0  # times the squared error of the best fit; a fit above it is dropped


@dataclass(frozen=True)
class Evidence:
    """Some clusters of a source, with residuals of the model or of the model with effects switched on.

    Attributes:
        source: The measurements, with the model that predicts them.
        numbers: Their numbers in the source.
        clusters: Residuals.
    """

    source: Source
    numbers: tuple[int, ...]
    clusters: tuple[Cluster, ...]

    @staticmethod
    def of(source: Source, numbers: Sequence[int] | None = None) -> Evidence:
        """Residuals of the model; None: in all clusters."""
        chosen = tuple(range(len(source.clusters)) if numbers is None else numbers)
        return Evidence(source, chosen, tuple(source.clusters[number] for number in chosen))

    @cached_property
    def null(self) -> NullDistribution:
        """Distribution of statistics of the residuals under noise alone."""
        return (RotationNull if self.source.repeated else SignFlipNull)(self.clusters)

    @cached_property
    def lack_of_fit(self) -> float | None:
        """p-value of the residuals being noise and discrepancy; None without repeats."""
        return self.null.lack_of_fit([item.mean for item in self.clusters])

    @cached_property
    def expected(self) -> Array:
        """Mean square error expected from repeatability and discrepancy alone, by cluster, ``(c,)`` [-]."""
        return np.array([item.expected for item in self.clusters])

    @cached_property
    def neighbours(self) -> tuple[tuple[int, ...], ...] | None:
        """Neighbours of every cluster on the same recording, with correlated noise; None for trials."""
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
        """The evidence of some clusters, by position."""
        return replace(
            self,
            numbers=tuple(self.numbers[position] for position in positions),
            clusters=tuple(self.clusters[position] for position in positions),
        )

    @cached_property
    def _free(self) -> list[tuple[int, NDArray[np.bool_]]]:
        """Positions of the clusters with free motion, each with the mask of its features before contact."""
        masks = [np.array([not item.contact or f.phase == "free" for f in item.features]) for item in self.clusters]
        return [(position, mask) for position, mask in enumerate(masks) if np.any(mask)]

    @cached_property
    def before_contact(self) -> Evidence | None:
        """The features of free motion alone; None without them, or if there are no others."""
        if not self._free or not any(item.contact for item in self.clusters):
            return None
        numbers = tuple(self.numbers[position] for position, _ in self._free)
        clusters = tuple(self.clusters[position].only(mask.tolist(), contact=False) for position, mask in self._free)
        return replace(self, numbers=numbers, clusters=clusters)

    def seen_before_contact(self, candidate: Candidate) -> Candidate:
        """A candidate linearised in these clusters, as linearised in those of :attr:`before_contact`."""
        return replace(
            candidate,
            offsets=tuple(candidate.offsets[position][mask] for position, mask in self._free),
            jacobians=tuple(candidate.jacobians[position][mask] for position, mask in self._free),
        )

    @cached_property
    def _signals(self) -> list[list[NDArray[np.bool_]]]:
        """Features by cluster, for every joint with a noise of its own; a single group of all where there is none."""
        if not self.source.noise_apart:
            return [[np.ones(len(item.features), dtype=bool) for item in self.clusters]]
        names = dict.fromkeys(feature.index for item in self.clusters for feature in item.features)
        return [[np.array([f.index == name for f in item.features]) for item in self.clusters] for name in names]

    def gains(self, before: Sequence[Array], after: Sequence[Array], of_enough: float = 1.0) -> bool:
        """Whether enough of the error in excess of repeatability and discrepancy goes.

        Enough is ``LEAST_GAIN`` of the whole. Where every joint has a noise of its own that is not known, a gain counts
        against what is left of the joint, and ``LEAST_GAIN_IN_ONE`` of it is enough: on the scale of what the model
        without effects leaves, whatever acts in a well explained joint is small.

        Args:
            before: Mean residuals without an effect, ``(F,)`` per cluster [-].
            after: The same with it.
            of_enough: Share of it that is asked for.
        """
        first, second = (self.excess(rest) for rest in (before, after))
        least, in_one = of_enough * LEAST_GAIN, of_enough * LEAST_GAIN_IN_ONE
        whole = float(np.sum(first - second)) > least * float(np.sum(first))
        return whole or (self.source.noise_apart and bool(np.any(first - second > in_one * first)))

    def excess(self, rest: Sequence[Array]) -> Array:
        """Mean square error beyond repeatability and discrepancy, by joint with a noise of its own, ``(g,)`` [-]."""
        expected = [item.expected_squares for item in self.clusters]
        return np.array(
            [
                np.mean(
                    [max(np.mean(np.square(r[m]) - e[m]), 0.0) for r, e, m in zip(rest, expected, own, strict=True)]
                )
                for own in self._signals
            ]
        )

    def size(self, errors: Array) -> float:
        """Size of mean square errors by cluster, in multiples of repeatability [-]."""
        return size_of(errors, self.expected)

    def problem(self, candidate: Candidate) -> Problem:
        """Least squares of a candidate that is linearised in these clusters."""
        return Problem(candidate, self.clusters, self.neighbours, independent=not self.source.of_motion)

    def shifted(self, changes: Sequence[Array]) -> Evidence:
        """The evidence with ``changes`` subtracted from the residuals of every cluster, ``(F,)`` each [-]."""
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

    @cached_property
    def _at_ends(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether estimates lie at the lower and at the upper bound, other than their nominal value, ``(p,)`` each."""
        candidate = self.candidate
        near = 1e-6 * candidate.scale
        low, high = (
            (np.abs(self.estimate - bound) < near) & (np.abs(bound - candidate.nominal) > near)
            for bound in (candidate.lower, candidate.upper)
        )
        return low, high

    @cached_property
    def at_bound(self) -> NDArray[np.bool_]:
        """Whether estimates lie at a bound other than their nominal value, ``(p,)``."""
        low, high = self._at_ends
        return np.asarray(low | high)

    @cached_property
    def held_at_bound(self) -> NDArray[np.bool_]:
        """Whether the data put estimates at a bound, ``(p,)``; one that they leave open may lie there by chance."""
        away = np.abs(self.estimate - self.candidate.nominal) / self.candidate.scale
        shapes = np.array([scalar.shape for scalar in self.candidate.scalars], dtype=bool)
        return np.asarray(self.at_bound & (shapes | (away > self.half_widths)))

    @cached_property
    def at_end_of_range(self) -> NDArray[np.bool_]:
        """Whether estimates lie at a bound that is not one of physics, ``(p,)``."""
        candidate = self.candidate
        wider = candidate.widened(self.at_bound, self.evidence.source)
        if wider is None:
            return np.zeros_like(self.at_bound)
        low, high = self._at_ends
        return np.asarray((low & (wider.lower < candidate.lower)) | (high & (wider.upper > candidate.upper)))

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

    @cached_property
    def half_widths_of_noise(self) -> Array:
        """Half widths if clocks and calibrations are exact, in parameter scales, ``(p,)``."""
        return self.problem.half_widths(self.change, self.evidence.null)

    def widths(self, confidence: float) -> Array:
        """Half widths of intervals in parameter scales, ``(p,)``, with the uncertainty of clocks and calibrations."""
        clock = confidence * self.evidence.source.clock  # of equally likely offsets
        unsure = np.array([clock if scalar.unit == "s" else 0.0 for scalar in self.candidate.scalars])
        own = self.problem.half_widths(self.change, self.evidence.null, confidence)
        moved = scipy.stats.norm.ppf(0.5 + confidence / 2.0) * self.problem.moved_by_calibrations()
        return np.asarray(np.sqrt(own**2 + moved**2 + (unsure / self.candidate.scale) ** 2))

    @cached_property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 95 % intervals in units of the parameters, ``(p,)`` each, with the half widths of :meth:`widths`.

        Where features bend (a box tips, a contact slips), sensitivities at the estimate are not those at the end of the
        interval. So each end is simulated, with the other parameters moved along (profile of the squares of residuals),
        and is moved out until the squares rise as much as they would in a straight model.
        """
        candidate, inverse = self.candidate, np.linalg.inv(self.problem.total)
        half, least = self.half_widths, self._squares_at([self.estimate])[0]
        if not np.isfinite(least):
            least = 0.0  # nothing to compare with: the ends stay where they are
        ends = {}
        for side in (-1.0, 1.0):
            reach, left = half.copy(), list(range(half.size))
            for _ in range(DOUBLINGS):
                steps = [side * reach[i] * inverse[:, i] / inverse[i, i] * candidate.scale for i in left]
                points = [np.clip(self.estimate + step, candidate.lower, candidate.upper) for step in steps]
                squares = self._squares_at(points)
                left = [
                    i
                    for i, point, there in zip(left, points, squares, strict=True)
                    if there - least < BENT * half[i] ** 2 / inverse[i, i]
                    and candidate.lower[i] < point[i] < candidate.upper[i]
                ]
                if not left:
                    break
                reach[left] *= 2.0
            ends[side] = np.clip(self.estimate + side * reach * candidate.scale, candidate.lower, candidate.upper)
        return np.minimum(ends[-1.0], self.estimate), np.maximum(ends[1.0], self.estimate)

    def _squares_at(self, points: Sequence[Array]) -> Array:
        """Sums of squared scaled residuals at other parameters, ``(k,)``; infinite where they cannot be simulated."""
        candidate, evidence, count = self.candidate, self.evidence, len(self.evidence.numbers)
        wanted = [(n, added) for added in (candidate.origin, *map(candidate.split, points)) for n in evidence.numbers]
        found = evidence.source.predict(wanted, "ends of intervals")
        sums = []
        for start in range(count, len(found), count):
            pairs = zip(evidence.clusters, found[:count], found[start : start + count], strict=True)
            rests = [None if a is None or b is None else item.mean - (b - a) / item.sigma for item, a, b in pairs]
            whole = zip(evidence.clusters, rests, strict=True)
            sums.append(sum(np.inf if rest is None else item.count * float(rest @ rest) for item, rest in whole))
        return np.array(sums)

    @property
    def misfit(self) -> float:
        """Mean square error at the estimate, all clusters [-]."""
        return float(np.mean(self.problem.errors(self.change)))

    @property
    def converged(self) -> bool:
        """Whether the linear fit gains little over the candidate's point."""
        here = float(np.mean(self.problem.errors(np.zeros_like(self.change))))
        return here - self.misfit < ENOUGH * here

    @property
    def poor(self) -> bool:
        """Whether more than noise and discrepancy is left, so that the fit may have missed the optimum."""
        return self.misfit > POOR * float(self.evidence.expected.mean())

    @cached_property
    def rest(self) -> list[Array]:
        """Mean residuals of the fit, ``(F,)`` per cluster [-]."""
        return self.problem.rest(self.change)

    @cached_property
    def left(self) -> Evidence:
        """The evidence with the residuals of the fit."""
        return self.evidence.shifted(
            [item.mean - rest for item, rest in zip(self.evidence.clusters, self.rest, strict=True)]
        )

    def lack_of_fit(self) -> float | None:
        """p-value of the remaining residuals being noise and discrepancy; None without repeats."""
        return self.evidence.null.lack_of_fit(self.rest)


def refine(candidate: Candidate, evidence: Evidence, give_up: float = np.inf) -> Fit:
    """Fit by repeated simulation; where it ends at a bound that is not one of physics, it goes on beyond.

    Args:
        candidate: Start, linearised.
        evidence: The residuals to explain.
        give_up: A fit whose held-out error exceeds this after the first step stops.
    """
    fitted = _refine(candidate, evidence, give_up)
    for _ in range(WIDENINGS):
        wider = fitted.candidate.widened(fitted.at_bound, evidence.source) if np.any(fitted.at_bound) else None
        if wider is None:
            break
        fitted = _refine(wider, evidence, give_up)
    return fitted


def _refine(candidate: Candidate, evidence: Evidence, give_up: float) -> Fit:
    """:func:`refine` within the bounds of the candidate."""
    best = Fit.of(candidate, evidence)
    nothing = np.zeros_like(best.change)
    best_error = float(np.mean(best.problem.errors(nothing)))
    point, fraction = best.estimate, 1.0
    for number in range(STEPS):
        if number >= 1 and best_error > give_up:
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
    """Share of an overshooting step at which the error is least, between 0.05 and 0.9.

    Along the step, t from 0 to 1, features change by d k t / (1 + (k - 1) t), with d the change over the whole step and
    k the slope at its start (from the sensitivities) over d. This is exact for features that vary with the inverse of a
    parameter, as deflection varies with stiffness. Least squares gives t.
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
    """The fit with new sensitivities at its point: secant updates fail across contact changes."""
    return Fit.of(_relinearised(fitted.candidate, fitted.evidence), fitted.evidence)


def _relinearised(candidate: Candidate, evidence: Evidence, share: float = 1.0) -> Candidate:
    """New sensitivities at the candidate's point."""
    fresh = linearise(candidate, evidence.clusters, evidence.numbers, evidence.source, "new sensitivities", share)
    return candidate if fresh is None else replace(candidate, jacobians=fresh.jacobians)


def has_shape_parameter(candidate: Candidate) -> bool:
    """Whether a nonlinear shape parameter needs several starts of the fit."""
    return any(scalar.grid for scalar in candidate.scalars)


def refine_again(fitted: Fit) -> Fit:
    """Continue a poor fit with sensitivities of every point, while that helps.

    Secant updates do not reach a parameter that had zero sensitivity at the start, and go astray where parameters act
    through each other, as the size of friction and the speed at which it fades do. Finite differences shrink: whole
    steps see past joints and contacts that stick, and mislead near the optimum.
    """
    for share in NEAR_STEPS:
        for _ in range(STEPS):
            further = _gauss_newton(fitted, share) if fitted.poor else None
            if further is None:
                break
            fitted = further
    return fitted


def _gauss_newton(fitted: Fit, share: float) -> Fit | None:
    """The fit one step further, with sensitivities of the point where it is; None if the error hardly falls."""
    evidence, candidate = fitted.evidence, fitted.candidate
    here = min(
        (moved for moved in (candidate, evaluate_at(candidate, fitted.estimate, evidence)) if moved is not None),
        key=lambda moved: _error_at(moved, evidence),
    )
    fresh = Fit.of(_relinearised(here, evidence, share), evidence)
    if fresh.converged:
        return None
    for fraction in HALVES:
        point = here.point + fraction * (fresh.estimate - here.point)
        moved = evaluate_at(fresh.candidate, point, evidence)
        if moved is not None and _error_at(moved, evidence) < (1.0 - ENOUGH) * _error_at(here, evidence):
            return Fit.of(moved, evidence)
    return None


def _error_at(candidate: Candidate, evidence: Evidence) -> float:
    """Mean square error at the candidate's point [-]."""
    return float(np.mean(evidence.problem(candidate).errors(np.zeros_like(candidate.point))))


def look_elsewhere(fitted: Fit) -> Fit:
    """Restart a poor fit from points further away, because contacts may change between there and here.

    A box that stands flat tips only once its centre of mass lies beyond an edge; before that the sensitivity is zero.
    """
    scalars = fitted.candidate.scalars
    for _ in scalars:
        evidence = fitted.evidence
        if not fitted.poor:
            break
        places = []
        for index, scalar in enumerate(scalars):
            for value in scalar.far:
                point = fitted.estimate.copy()
                point[index] = np.clip(value, fitted.candidate.lower[index], fitted.candidate.upper[index])
                if (moved := evaluate_at(fitted.candidate, point, evidence)) is not None:
                    places.append(moved)
        if not places:
            break
        errors = [_error_at(moved, evidence) for moved in places]
        if min(errors) >= fitted.misfit:
            break
        again = refine(_relinearised(places[int(np.argmin(errors))], evidence), evidence)
        if again.misfit >= fitted.misfit:
            break
        fitted = again
    return fitted


def measure_again(fitted: Fit, near: bool = False) -> Fit:
    """The fit against residuals of the model with its effects, every run replayed from its own start.

    The last correction of the estimate, its interval and the lack of fit come from here.

    Args:
        fitted: The fit.
        near: Whether its sensitivities are those at an optimum already.
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
        if look == 0 and not near:
            fresh = linearise(fresh, clusters, like.numbers, like.source, "final sensitivities", NEAR_STEPS[0]) or fresh
        fitted = refine_again(refine(fresh, evidence))
        if np.all(np.abs(fitted.estimate - point) < NEAR * candidate.scale):
            break
    return fitted


def evaluate_at(candidate: Candidate, point: Array, evidence: Evidence) -> Candidate | None:
    """The candidate with its features evaluated at another point, sensitivities kept; None if it cannot be simulated.

    One run of a condition stands for its repeats; :func:`measure_again` looks at every run.
    """
    changes = evidence.source.differences(
        evidence.numbers, candidate.origin, candidate.split(point), "fit of the shortlist"
    )
    if any(change is None for change in changes):
        return None
    offsets = tuple(np.asarray(change) / item.sigma for change, item in zip(changes, evidence.clusters, strict=True))
    return replace(candidate, point=point, offsets=offsets)


def _broyden(before: Candidate, after: Candidate) -> Candidate:
    """Secant update (Broyden): sensitivities that reproduce the last step and otherwise change least.

    Short steps are ignored: features jump a little when an impact falls into another control tick.
    """
    step = (after.point - before.point) / before.scale
    if np.max(np.abs(step)) < SHORTEST_LESSON:
        return replace(after, jacobians=before.jacobians)
    jacobians = tuple(
        jacobian + np.outer(there - here - jacobian @ step, step) / (step @ step)
        for jacobian, here, there in zip(before.jacobians, before.offsets, after.offsets, strict=True)
    )
    return replace(after, jacobians=jacobians)
