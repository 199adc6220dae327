# SPDX-License-Identifier: Apache-2.0
"""Nonlinear least-squares fit of a candidate by simulation: Gauss-Newton steps in a box trust region, within bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.search.budget import UNLIMITED, Budget
from impact_rs_analysis.diagnosis.search.candidate import Candidate, Problem, linearise
from impact_rs_analysis.diagnosis.search.null_distribution import NullDistribution, RotationNull, SignFlipNull
from impact_rs_analysis.diagnosis.thresholds import MIN_GAIN_SHARE, MIN_GAIN_SHARE_OF_JOINT
from impact_rs_analysis.evidence.cluster import Cluster, size_of
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.progress import SEARCH
from impact_rs_sim.robots.robot import Array

# Gauss-Newton steps
MAX_STEPS_OF_TRIALS = 6  # their simulations are expensive
MAX_STEPS_WITHOUT_REPEATS = 12  # of recordings and tables, whose predictions are cheap
MIN_RELATIVE_DECREASE = 0.02  # of the squared error by a step; with less, a fit has converged
DIFFERENCE_STEP_SHARES = (1.0, 0.3)  # of the finite-difference steps, far from and near the optimum
MAX_CHORD_ERROR_RATIO = 0.5  # squared error after over before a step with the first sensitivities; above, new ones
MAX_FINAL_CORRECTION = 0.1  # parameter scales; a smaller one does not depend on where a trial starts
MAX_FINAL_REPLAYS = 4  # of every run, at the end of a fit
MAX_RANGE_DOUBLINGS = 4  # to sixteen times the declared width
# Trust region (Conn, Gould and Toint 2000); the gain ratio is the actual over the predicted decrease of the error.
TRUST_RADIUS = 4.0  # parameter scales, after a full step with a low gain ratio
TRUST_RADIUS_FACTOR = 4.0  # wider after a step with a high gain ratio, narrower after one without a decrease
MAX_STEP_TRIALS = 4  # steps of decreasing length
MIN_GAIN_RATIO = 0.75  # above, the radius grows
MIN_GAIN_RATIO_OF_FULL_STEP = 0.95  # likewise, for a step without a radius that is longer than TRUST_RADIUS
VALLEY_FTOL, VALLEY_MAX_EVALUATIONS = 1e-6, 200  # of SciPy's trust-region method along a curved valley, flat along it
# Downhill simplex (Nelder and Mead 1965)
SIMPLEX_EDGE = 0.3  # parameter scales, of the first simplex
SIMPLEX_EVALUATIONS = 25  # for each parameter, at most
UNSIMULATED_ERROR = 1e100  # stands for inf, whose differences are nan


@dataclass(frozen=True)
class Evidence:
    """Some clusters of a source, with residuals of the model or of the model with effects switched on.

    Attributes:
        source: The measurements, with the model that predicts them.
        numbers: Indices of the clusters in the source.
        clusters: Residuals.
        budget: Processor time that fits to them may take.
    """

    source: Source
    numbers: tuple[int, ...]
    clusters: tuple[Cluster, ...]
    budget: Budget = UNLIMITED

    @staticmethod
    def of(source: Source, numbers: Sequence[int] | None = None, budget: Budget = UNLIMITED) -> Evidence:
        """Residuals of the model in some clusters; None: in all."""
        chosen = tuple(range(len(source.clusters)) if numbers is None else numbers)
        return Evidence(source, chosen, tuple(source.clusters[number] for number in chosen), budget)

    @cached_property
    def null(self) -> NullDistribution:
        """Null distribution of the residuals: by rotations with repeats, by sign flips of blocks without."""
        return (RotationNull if self.source.repeated else SignFlipNull)(self.clusters)

    @property
    def means(self) -> list[Array]:
        """Mean residuals, ``(F,)`` per cluster [-]."""
        return [item.mean for item in self.clusters]

    @cached_property
    def lack_of_fit(self) -> float | None:
        """p-value of the lack-of-fit test of the model; None without repeats."""
        return self.null.lack_of_fit(self.means)

    @cached_property
    def expected(self) -> Array:
        """Mean square error expected from repeatability and discrepancy alone, by cluster, ``(c,)`` [-]."""
        return np.array([item.expected for item in self.clusters])

    @cached_property
    def expected_error(self) -> float:
        """Error of a fit (:meth:`Problem.error`) expected from repeatability and discrepancy alone [-]."""
        counts = np.array([item.count * item.sigma.size for item in self.clusters])
        return float(counts @ self.expected) / float(counts.sum())

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
        """Indices of the clusters with free motion, each with the mask of its features before contact."""
        masks = [np.array([not item.contact or f.phase == "free" for f in item.features]) for item in self.clusters]
        return [(position, mask) for position, mask in enumerate(masks) if np.any(mask)]

    @cached_property
    def free_motion_part(self) -> Evidence | None:
        """The evidence of free motion alone; None without free motion, or without contact."""
        if not self._free or not any(item.contact for item in self.clusters):
            return None
        numbers = tuple(self.numbers[position] for position, _ in self._free)
        clusters = tuple(self.clusters[position].only(mask.tolist(), contact=False) for position, mask in self._free)
        return replace(self, numbers=numbers, clusters=clusters)

    def linearised_in_free_motion(self, candidate: Candidate) -> Candidate:
        """The rows of a linearised candidate that belong to :attr:`free_motion_part`."""
        return replace(
            candidate,
            offsets=tuple(candidate.offsets[position][mask] for position, mask in self._free),
            jacobians=tuple(candidate.jacobians[position][mask] for position, mask in self._free),
        )

    def extended_beyond_free_motion(self, candidate: Candidate) -> Candidate:
        """A candidate linearised in :attr:`free_motion_part`, with zero sensitivity of all other features."""
        offsets = [np.zeros(item.sigma.size) for item in self.clusters]
        jacobians = [np.zeros((item.sigma.size, candidate.point.size)) for item in self.clusters]
        for (position, mask), offset, jacobian in zip(self._free, candidate.offsets, candidate.jacobians, strict=True):
            offsets[position][mask], jacobians[position][mask] = offset, jacobian
        return replace(candidate, offsets=tuple(offsets), jacobians=tuple(jacobians))

    @cached_property
    def signals(self) -> list[list[NDArray[np.bool_]]]:
        """Masks of features by cluster, for every signal with a noise of its own; else one mask of all features."""
        if not self.source.noise_apart:
            return [[np.ones(len(item.features), dtype=bool) for item in self.clusters]]
        return self._each_signal

    @cached_property
    def _each_signal(self) -> list[list[NDArray[np.bool_]]]:
        """Masks of features by cluster, for every signal."""
        names = dict.fromkeys((f.signal, f.index) for item in self.clusters for f in item.features)
        return [
            [np.array([(f.signal, f.index) == name for f in item.features]) for item in self.clusters] for name in names
        ]

    def gains(self, before: Sequence[Array], after: Sequence[Array], whole: bool = False) -> bool:
        """Whether an effect removes enough of the excess error, beyond repeatability and discrepancy.

        Enough is ``MIN_GAIN_SHARE`` of the excess of all features. Where every joint has an unknown noise of its own,
        ``MIN_GAIN_SHARE_OF_JOINT`` of the excess of one joint is enough as well: residuals are scaled by those of the
        model without effects, so that whatever acts in a well explained joint looks small. In a table of single impacts
        the gain is also compared with the excess of the signals that the effect moves (:meth:`_gain_where_it_acts`).

        Args:
            before: Mean residuals without an effect, ``(F,)`` per cluster [-].
            after: The same with it.
            whole: Whether a table's gain is compared with the excess of all features alone: the residual of a coarse
                curve in one signal is no further dependence.
        """
        first, second = (self.excess(rest) for rest in (before, after))
        if float(np.sum(first - second)) > MIN_GAIN_SHARE * float(np.sum(first)) or (
            self.source.noise_apart and bool(np.any(first - second > MIN_GAIN_SHARE_OF_JOINT * first))
        ):
            return True
        single = not whole and not self.source.of_motion and not self.source.repeated
        return single and self._gain_where_it_acts(before, after) > MIN_GAIN_SHARE

    def _gain_where_it_acts(self, before: Sequence[Array], after: Sequence[Array]) -> float:
        """Share of a table's excess error that an effect removes, weighted by its change of each signal [-].

        With the excess a_s of signal s and the mean square c_s of its change, the weight is c_s / a_s, the largest
        share that the effect can explain. The noise of a signal that it does not change has no weight, such as that
        of the spin where an effect acts along the normal.
        """
        gained, weights = 0.0, 0.0
        for masks in self._each_signal:
            first, second = (
                np.mean(
                    np.concatenate(
                        [
                            np.square(own[mask]) - item.expected_squares[mask]
                            for own, mask, item in zip(rest, masks, self.clusters, strict=True)
                        ]
                    )
                )
                for rest in (before, after)
            )
            moved = [(a - b)[mask] for a, b, mask in zip(before, after, masks, strict=True)]
            if first > 0.0:
                weight = float(np.mean(np.square(np.concatenate(moved))) / first)
                gained, weights = gained + weight * float(first - second) / float(first), weights + weight
        return gained / weights if weights else 0.0

    def excess(self, rest: Sequence[Array]) -> Array:
        """Mean square error beyond repeatability and discrepancy, for each mask of :attr:`signals`, ``(g,)`` [-]."""
        expected = [item.expected_squares for item in self.clusters]
        return np.array(
            [
                np.mean(
                    [max(np.mean(np.square(r[m]) - e[m]), 0.0) for r, e, m in zip(rest, expected, own, strict=True)]
                )
                for own in self.signals
            ]
        )

    def size(self, errors: Array) -> float:
        """Size of mean square errors by cluster, in multiples of repeatability [-]."""
        return size_of(errors, self.expected)

    def problem(self, candidate: Candidate) -> Problem:
        """Least squares of a candidate that is linearised in these clusters."""
        known = self.source.of_motion and self.source.repeated
        return Problem(candidate, self.clusters, self.neighbours, noise_unknown=not known)


@dataclass(frozen=True)
class Fit:
    """A candidate fitted to evidence.

    Attributes:
        candidate: Linearised near the estimate.
        evidence: Data of the fit.
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
    def away(self) -> Array:
        """Distance of the estimate from nominal, in parameter scales, ``(p,)``."""
        return np.asarray((self.estimate - self.candidate.nominal) / self.candidate.scale)

    @cached_property
    def _at_ends(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of the estimates at their lower and at their upper bound, where that is not nominal, ``(p,)`` each."""
        candidate = self.candidate
        near = 1e-6 * candidate.scale
        low, high = (
            (np.abs(self.estimate - bound) < near) & (np.abs(bound - candidate.nominal) > near)
            for bound in (candidate.lower, candidate.upper)
        )
        return low, high

    @cached_property
    def at_bound(self) -> NDArray[np.bool_]:
        """Mask of the estimates at a bound that is not nominal, or at the edge of physical consistency, ``(p,)``."""
        return np.asarray(self.at_end | self.candidate.at_consistency_boundary(self.estimate))

    @property
    def at_end(self) -> NDArray[np.bool_]:
        """Mask of the estimates at an end of their range that is not nominal, ``(p,)``."""
        low, high = self._at_ends
        return np.asarray(low | high)

    @cached_property
    def held_at_bound(self) -> NDArray[np.bool_]:
        """Mask of the estimates that the data push to a bound, ``(p,)``; undetermined ones may lie there by chance."""
        return np.asarray(self.at_bound & (self.candidate.shapes | (np.abs(self.away) > self.half_widths)))

    @cached_property
    def at_end_of_range(self) -> NDArray[np.bool_]:
        """Mask of the estimates at a bound of the search that is no bound of physics, ``(p,)``."""
        candidate = self.candidate
        wider = candidate.widened(self.at_end, self.evidence.source)
        if wider is None:
            return np.zeros_like(self.at_end)
        low, high = self._at_ends
        return np.asarray((low & (wider.lower < candidate.lower)) | (high & (wider.upper > candidate.upper)))

    @property
    def held_out(self) -> Array:
        """Leave-one-out mean square error per cluster, ``(c,)`` [-]."""
        return self.problem.held_out

    @property
    def score(self) -> float:
        """Leave-one-out mean square error, mean over clusters [-]."""
        return float(self.held_out.mean())

    @property
    def cost(self) -> int:
        """Number of parameters of all effects, without shapes (:meth:`Effect.complexity`)."""
        return sum(effect.complexity(self.evidence.source.joints) for effect in self.candidate.effects)

    @cached_property
    def half_widths(self) -> Array:
        """Half widths of the 95 % intervals in parameter scales, ``(p,)``, with the uncertainty of the calibrations."""
        clock = 0.95 * self.evidence.source.clock  # half width of a uniform distribution
        unsure = np.array([clock if scalar.unit == "s" else 0.0 for scalar in self.candidate.scalars])
        moved = scipy.stats.norm.ppf(0.975) * self.problem.moved_by_calibrations()
        return np.asarray(np.sqrt(self.half_widths_of_noise**2 + moved**2 + (unsure / self.candidate.scale) ** 2))

    @cached_property
    def half_widths_of_noise(self) -> Array:
        """Half widths if clocks and calibrations are exact, in parameter scales, ``(p,)``."""
        return self.problem.half_widths(self.change, self.evidence.null)

    @property
    def with_room(self) -> Candidate:
        """The candidate with ranges as wide as the intervals, within the bounds of physics and of the user."""
        candidate, half = self.candidate, self.half_widths * self.candidate.scale
        for _ in range(MAX_RANGE_DOUBLINGS):
            beyond = (self.estimate - half < candidate.lower) | (self.estimate + half > candidate.upper)
            wider = candidate.widened(beyond, self.evidence.source) if np.any(beyond) else None
            if wider is None:
                break
            candidate = wider
        return candidate

    @property
    def misfit(self) -> float:
        """Mean square error at the estimate (:meth:`Problem.error`) [-]."""
        return self.problem.error(self.change)

    @property
    def error_at_point(self) -> float:
        """Mean square error at the simulated point of the candidate (:meth:`Problem.error`) [-]."""
        return self.problem.error(np.zeros_like(self.change))

    @property
    def at_point(self) -> Fit:
        """The fit without its linear correction, at the simulated point of the candidate."""
        return replace(self, change=np.zeros_like(self.change))

    @property
    def step_by_free_motion(self) -> Array:
        """Step to the estimates by free motion, in parameter scales, ``(p,)``; 0 where it does not determine them.

        A parameter such as the offset of an encoder moves the position of the impact. If the pad then starts inside
        the object, the replay has no useful sensitivity; before the impact it has.
        """
        free = self.evidence.free_motion_part
        if free is None:
            return np.zeros_like(self.change)
        fitted = Fit.of(self.evidence.linearised_in_free_motion(self.candidate), free)
        return np.where(np.abs(fitted.change) > fitted.half_widths, fitted.change, 0.0)

    @property
    def converged(self) -> bool:
        """Whether the linear model predicts a relative decrease below ``MIN_RELATIVE_DECREASE``."""
        return self.error_at_point - self.misfit < MIN_RELATIVE_DECREASE * self.error_at_point

    @property
    def stalled(self) -> bool:
        """Whether the linear model promises a lower error that no simulated step has, as where features are rough."""
        promised = self.error_at_point - self.problem.error(self.problem.solve())
        return not np.any(self.change) and promised > MIN_RELATIVE_DECREASE * self.error_at_point

    @property
    def out_of_time(self) -> bool:
        """Whether the processor time is spent; further steps of this fit are then listed as not tried."""
        return self.evidence.budget.leaves_out(f"further steps of the fit of {' and '.join(self.candidate.names)}")

    @property
    def exceeds_noise(self) -> bool:
        """Whether the error exceeds noise and discrepancy, so that the fit may have missed the optimum."""
        return self.misfit > self.evidence.expected_error

    @cached_property
    def residuals(self) -> list[Array]:
        """Mean residuals of the fit, ``(F,)`` per cluster [-]."""
        return self.problem.residuals_at(self.change)

    @cached_property
    def left(self) -> Evidence:
        """The evidence with the residuals of the fit in place of those of the model."""
        pairs = zip(self.evidence.clusters, self.residuals, strict=True)
        clusters = tuple(replace(item, residuals=item.residuals - (item.mean - rest)) for item, rest in pairs)
        return replace(self.evidence, clusters=clusters)

    def lack_of_fit(self) -> float | None:
        """p-value of the lack-of-fit test of the fit; None without repeats."""
        return self.evidence.null.lack_of_fit(self.residuals)


def chord_method(candidate: Candidate, evidence: Evidence, give_up: float = np.inf) -> Fit:
    """Fit by the chord method: simulations at every step, with the sensitivities of the start.

    A fit that ends at a bound of the search goes on with a wider range, within the bounds of physics.

    Args:
        candidate: Start, linearised.
        evidence: The residuals to explain.
        give_up: Mean square error; a fit that the linear model puts above it after the first step stops [-].
    """
    return _beyond_bounds(lambda start: _refine(start, evidence, give_up), candidate)


def _beyond_bounds(fit: Callable[[Candidate], Fit], start: Candidate) -> Fit:
    """A fit, repeated with a wider range while it ends at a bound of the search that is no bound of physics."""
    fitted = fit(start)
    for _ in range(MAX_RANGE_DOUBLINGS):
        at = fitted.at_end
        wider = fitted.candidate.widened(at, fitted.evidence.source) if np.any(at) else None
        if wider is None or fitted.out_of_time:
            break
        fitted = fit(wider)
    return fitted


def _refine(candidate: Candidate, evidence: Evidence, give_up: float) -> Fit:
    """Chord steps within the bounds of the candidate, with new sensitivities where they converge slowly.

    The chord method is cheap where features are nearly linear. Where sensitivities change along the way, as for a
    damping that takes most of the velocity from a trial, its steps are short. Recordings keep them: there, slow steps
    belong to parameters that the data hardly determine, or to shapes, which converge after their amplitudes
    (:func:`gauss_newton`).
    """
    fitted, trust, unseen = Fit.of(candidate, evidence), np.inf, candidate.unseen
    shaped = any(scalar.shape and not scalar.grid for scalar in candidate.scalars)
    may_be_slow = evidence.source.repeated and not shaped
    for number in range(_steps(evidence)):
        if fitted.converged or (number >= 1 and (unseen or fitted.misfit > give_up or fitted.out_of_time)):
            break
        moved, trust = _moved(fitted, trust)
        if moved is None:  # no simulation has the decrease that the sensitivities predict
            return fitted.at_point
        least = max(MAX_CHORD_ERROR_RATIO * fitted.error_at_point, evidence.expected_error)
        slow = may_be_slow and moved.error_at_point > least
        fitted = Fit.of(_relinearised(moved.candidate, evidence), evidence) if slow else moved
    return fitted


def _steps(evidence: Evidence) -> int:
    """Largest number of steps of a fit."""
    return MAX_STEPS_OF_TRIALS if evidence.source.repeated else MAX_STEPS_WITHOUT_REPEATS


def _moved(fitted: Fit, trust: float) -> tuple[Fit | None, float]:
    """The fit after a step in a box trust region, and the next radius.

    No parameter moves by more than the radius ``trust``, in scales, unless features are linear: one of many parameters
    with a wrong sensitivity would reach values at which it changes nothing any more, as friction in which a joint
    sticks, while the others lower the error. Where no nearby step helps, the whole step is taken, or the step by free
    motion (:meth:`Fit.step_by_free_motion`) if its error is lower. The gain ratio of actual to predicted decrease sets
    the next radius. None if no step lowers the error by ``MIN_RELATIVE_DECREASE`` of it.
    """
    error = fitted.error_at_point
    far: Fit | None = None
    for _ in range(MAX_STEP_TRIALS):
        step = fitted.problem.solve(within=trust)
        length = float(np.max(np.abs(step)))
        if length < 1e-6:
            break
        moved, gained = _stepped(fitted, step)
        promised = error - fitted.problem.error(step)
        unbounded = np.isinf(trust) and length > TRUST_RADIUS
        if np.isinf(trust) and error - gained > fitted.evidence.expected_error:
            free, gained_there = _stepped(fitted, fitted.step_by_free_motion)
            if gained_there > max(gained, MIN_RELATIVE_DECREASE * error):
                return free, TRUST_RADIUS
        if gained > (MIN_GAIN_RATIO_OF_FULL_STEP if unbounded else MIN_GAIN_RATIO) * promised:
            return moved, TRUST_RADIUS_FACTOR * trust
        if gained > MIN_RELATIVE_DECREASE * error:
            if not unbounded:
                return moved, max(length, TRUST_RADIUS)
            far = moved
        trust = min(trust / TRUST_RADIUS_FACTOR, length / TRUST_RADIUS_FACTOR, TRUST_RADIUS)
    return far, TRUST_RADIUS if far is not None else trust


def _stepped(fitted: Fit, step: Array) -> tuple[Fit | None, float]:
    """The fit simulated after a step, None where it cannot be simulated, and the actual decrease of its error."""
    candidate = fitted.candidate
    there = evaluate_at(candidate, candidate.point + step * candidate.scale, fitted.evidence) if np.any(step) else None
    moved = None if there is None else Fit.of(there, fitted.evidence)
    return moved, -np.inf if moved is None else fitted.error_at_point - moved.error_at_point


def _relinearised(candidate: Candidate, evidence: Evidence, share: float = 1.0) -> Candidate:
    """The candidate with new sensitivities at its point."""
    fresh = linearise(candidate, evidence.clusters, evidence.numbers, evidence.source, "new sensitivities", share)
    return candidate if fresh is None else replace(candidate, jacobians=fresh.jacobians, share=share)


def has_shape_parameter(candidate: Candidate) -> bool:
    """Whether a nonlinear shape parameter needs several starts of the fit."""
    return any(scalar.grid for scalar in candidate.scalars)


def gauss_newton(fitted: Fit) -> Fit:
    """Continue by Gauss-Newton steps, with new sensitivities at every point, while the error falls.

    The sensitivities of the start are zero for a parameter without effect there, and wrong where parameters interact,
    as the size of friction and the speed at which it fades. Finite-difference steps shrink: whole steps reach past
    stiction of joints and contacts, and are too coarse near the optimum.
    """
    evidence = fitted.evidence
    return _beyond_bounds(lambda start: _descended(start, evidence), fitted.candidate)


def _descended(candidate: Candidate, evidence: Evidence) -> Fit:
    """Gauss-Newton steps within the bounds of the candidate."""
    fitted = Fit.of(candidate, evidence)
    for share in DIFFERENCE_STEP_SHARES:
        trust = np.inf
        for _ in range(_steps(evidence)):
            if not fitted.converged and fitted.out_of_time:
                break
            if fitted.candidate.share > share:
                fitted = Fit.of(_relinearised(fitted.candidate, evidence, share), evidence)
            if fitted.converged:
                break
            moved, trust = _moved(fitted, trust)
            if moved is None:
                break
            fitted = moved
    cheap = not evidence.source.repeated
    return _to_the_bottom(fitted) if cheap and any(map(candidate.curved, range(candidate.point.size))) else fitted


def _to_the_bottom(fitted: Fit) -> Fit:
    """The fit at the minimum of a curved valley, by SciPy's trust-region reflective method.

    Steps in a box trust region creep along such a valley: each lowers the error little, all together by a fifth.
    """
    candidate, evidence, scale = fitted.candidate, fitted.evidence, fitted.candidate.scale

    def rest(vector: Array) -> Array:
        there = evaluate_at(candidate, vector * scale, evidence)
        if there is None:
            return np.full(size, np.inf)
        pairs = zip(evidence.clusters, there.offsets, strict=True)
        return np.concatenate([math.sqrt(item.count) * (item.mean - offset) for item, offset in pairs])

    size = sum(item.sigma.size for item in evidence.clusters)
    ends = candidate.lower / scale, candidate.upper / scale
    start = np.clip(candidate.point / scale, *ends)
    if not np.isfinite(rest(start)).all():  # some impact map has no solution at the rounded point
        return fitted
    found = scipy.optimize.least_squares(
        rest, start, bounds=ends, x_scale="jac", ftol=VALLEY_FTOL, xtol=None,
        gtol=None, max_nfev=VALLEY_MAX_EVALUATIONS,
    )  # fmt: skip
    moved = evaluate_at(candidate, found.x * scale, evidence)
    if moved is None:
        return fitted
    there = Fit.of(_relinearised(moved, evidence, DIFFERENCE_STEP_SHARES[-1]), evidence)
    return there if there.error_at_point < fitted.error_at_point else fitted


def restart_from_afar(fitted: Fit) -> Fit:
    """Restart a fit whose error exceeds noise from distant points, where contacts may be in another mode.

    A box that stands flat tips only once its centre of mass lies beyond an edge; before that the sensitivity is zero.
    """
    scalars = fitted.candidate.scalars
    for _ in scalars:
        evidence = fitted.evidence
        if not fitted.exceeds_noise or fitted.out_of_time:
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
        errors = [Fit.of(moved, evidence).error_at_point for moved in places]
        if min(errors) >= fitted.misfit:
            break
        again = chord_method(_relinearised(places[int(np.argmin(errors))], evidence), evidence)
        if again.misfit >= fitted.misfit:
            break
        fitted = again
    return fitted


def nelder_mead(fitted: Fit) -> Fit:
    """The fit at the minimum of a downhill simplex (Nelder and Mead 1965), or unchanged if that is no better.

    Where joints stick and slip, the error has many local minima, in which Gauss-Newton steps end.
    """
    candidate, evidence, scale = fitted.candidate, fitted.evidence, fitted.candidate.scale

    def error(vector: Array) -> float:
        there = evaluate_at(candidate, vector * scale, evidence)
        return UNSIMULATED_ERROR if there is None else Fit.of(there, evidence).error_at_point

    def in_time(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        del intermediate_result  # SciPy passes it to a parameter of this name
        if fitted.out_of_time:
            raise StopIteration

    start, ends = fitted.estimate / scale, (candidate.lower / scale, candidate.upper / scale)
    corners = np.clip(start + np.vstack((np.zeros(start.size), SIMPLEX_EDGE * np.eye(start.size))), *ends)
    found = scipy.optimize.minimize(
        error, start, method="Nelder-Mead", bounds=np.transpose(ends), callback=in_time,
        options={"initial_simplex": corners, "maxfev": SIMPLEX_EVALUATIONS * start.size},
    )  # fmt: skip
    moved = evaluate_at(candidate, found.x * scale, evidence) if found.fun < fitted.misfit else None
    return fitted if moved is None else Fit.of(_relinearised(moved, evidence, DIFFERENCE_STEP_SHARES[-1]), evidence)


def replay_and_refit(fitted: Fit, near: bool = False) -> Fit:
    """Fit again to the residuals of the model with its effects, every run replayed from its own start.

    The last correction of the estimate, its interval and the test of lack of fit use this fit.

    Args:
        fitted: The fit.
        near: Whether its sensitivities were computed at an optimum.
    """
    like = fitted.evidence
    best: Fit | None = None  # at a simulated point
    for look in range(MAX_FINAL_REPLAYS):
        candidate, point = fitted.candidate, fitted.estimate
        added = candidate.split(point)
        clusters = like.source.residuals_with(added, [like.source.clusters[number] for number in like.numbers])
        if clusters is None:
            return fitted
        evidence = replace(like, clusters=tuple(clusters))
        nothing = tuple(np.zeros_like(item.sigma) for item in clusters)
        fresh = replace(candidate, point=point, origin=added, offsets=nothing)
        here = Fit(fresh, evidence, evidence.problem(fresh), np.zeros_like(point))
        if (
            best is not None and here.misfit > (1.0 + MIN_RELATIVE_DECREASE) * best.misfit
        ):  # contacts are others where it led
            return best
        best = here
        if look > 0 or not near:
            fresh = linearise(fresh, clusters, like.numbers, like.source, "final sensitivities", central=True) or fresh
        fitted = _confirmed(chord_method(fresh, evidence))
        if fitted.out_of_time or np.all(np.abs(fitted.estimate - point) < MAX_FINAL_CORRECTION * candidate.scale):
            break
    return fitted


def _confirmed(fitted: Fit) -> Fit:
    """The fit with its last linear correction only if a simulation confirms it: the valley may be curved."""
    there = evaluate_at(fitted.candidate, fitted.estimate, fitted.evidence)
    better = there is not None and Fit.of(there, fitted.evidence).error_at_point <= fitted.error_at_point
    return fitted if better else fitted.at_point


def evaluate_at(candidate: Candidate, point: Array, evidence: Evidence) -> Candidate | None:
    """The candidate with its features evaluated at another point, sensitivities kept; None if it cannot be simulated.

    One run of a condition represents its repeats; :func:`replay_and_refit` replays every run.
    """
    changes = evidence.source.differences(evidence.numbers, candidate.origin, candidate.split(point), SEARCH)
    if any(change is None for change in changes):
        return None
    offsets = tuple(np.asarray(change) / item.sigma for change, item in zip(changes, evidence.clusters, strict=True))
    stays = np.array_equal(point, candidate.point)
    return replace(candidate, point=point, offsets=offsets, share=candidate.share if stays else np.inf)
