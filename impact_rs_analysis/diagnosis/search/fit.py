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
MAX_STEPS_WITHOUT_REPEATS = 12  # recordings and tables: predictions are cheap
MIN_RELATIVE_DECREASE = 0.02  # of the squared error in one step; below, a fit has converged
DIFFERENCE_STEP_SHARES = (1.0, 0.3)  # of the declared finite-difference steps, far from and near the optimum
MAX_CHORD_ERROR_RATIO = 0.5  # squared error after over before a chord step; above, new sensitivities are computed
MAX_FINAL_CORRECTION = 0.1  # parameter scales; a smaller correction ends the final replays
MAX_FINAL_REPLAYS = 4  # of every run, at the end of a fit
MAX_RANGE_DOUBLINGS = 4  # to sixteen times the declared width
# Trust region (Conn, Gould and Toint 2000); the gain ratio is the actual over the predicted decrease of the error.
TRUST_RADIUS = 4.0  # parameter scales, after a full step with a low gain ratio
TRUST_RADIUS_FACTOR = 4.0  # wider after a step with a high gain ratio, narrower after one without a decrease
MAX_STEP_TRIALS = 4  # steps of decreasing length
MIN_GAIN_RATIO = 0.75  # above, the radius grows
MIN_GAIN_RATIO_OF_FULL_STEP = 0.95  # likewise, for an unlimited step longer than TRUST_RADIUS
VALLEY_FTOL, VALLEY_MAX_EVALUATIONS = 1e-6, 200  # of SciPy's trust-region method; a curved valley has a flat floor
# Downhill simplex (Nelder and Mead 1965)
SIMPLEX_EDGE = 0.3  # parameter scales, of the first simplex
SIMPLEX_EVALUATIONS = 25  # per parameter, at most
UNSIMULATED_ERROR = 1e100  # in place of inf, because inf - inf is nan


@dataclass(frozen=True)
class Evidence:
    """Residuals of some clusters of a source, by the model or by the model with effects.

    Attributes:
        source: The measurements, with the model that predicts them.
        numbers: Indices of the clusters in the source.
        clusters: Residuals.
        budget: Processor time that fits may take.
    """

    source: Source
    numbers: tuple[int, ...]
    clusters: tuple[Cluster, ...]
    budget: Budget = UNLIMITED

    @staticmethod
    def of(source: Source, numbers: Sequence[int] | None = None, budget: Budget = UNLIMITED) -> Evidence:
        """Residuals of the model in some clusters, by index; None: in all clusters."""
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
        """Positions of the neighbours of every cluster in its recording, whose noise is correlated; None for trials."""
        if self.source.repeated:
            return None
        position_of = {number: position for position, number in enumerate(self.numbers)}
        units = [item.unit for item in self.clusters]
        return tuple(
            tuple(
                position_of[neighbour]
                for neighbour in (number - 1, number + 1)
                if neighbour in position_of and units[position_of[neighbour]] == units[position]
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
    def _free_masks(self) -> list[tuple[int, NDArray[np.bool_]]]:
        """Positions of the clusters with free motion, each with the mask of its features before contact."""
        masks = [np.array([not item.contact or f.phase == "free" for f in item.features]) for item in self.clusters]
        return [(position, mask) for position, mask in enumerate(masks) if np.any(mask)]

    @cached_property
    def free_motion_part(self) -> Evidence | None:
        """The evidence of free motion alone; None without free motion, or without contact."""
        if not self._free_masks or not any(item.contact for item in self.clusters):
            return None
        numbers = tuple(self.numbers[position] for position, _ in self._free_masks)
        clusters = tuple(
            self.clusters[position].only(mask.tolist(), contact=False) for position, mask in self._free_masks
        )
        return replace(self, numbers=numbers, clusters=clusters)

    def linearised_in_free_motion(self, candidate: Candidate) -> Candidate:
        """A linearised candidate restricted to the features of :attr:`free_motion_part`."""
        return replace(
            candidate,
            offsets=tuple(candidate.offsets[position][mask] for position, mask in self._free_masks),
            jacobians=tuple(candidate.jacobians[position][mask] for position, mask in self._free_masks),
        )

    def extended_beyond_free_motion(self, candidate: Candidate) -> Candidate:
        """A candidate linearised in :attr:`free_motion_part`, with zero sensitivity of all other features."""
        offsets = [np.zeros(item.sigma.size) for item in self.clusters]
        jacobians = [np.zeros((item.sigma.size, candidate.point.size)) for item in self.clusters]
        for (position, mask), offset, jacobian in zip(
            self._free_masks, candidate.offsets, candidate.jacobians, strict=True
        ):
            offsets[position][mask], jacobians[position][mask] = offset, jacobian
        return replace(candidate, offsets=tuple(offsets), jacobians=tuple(jacobians))

    @cached_property
    def noise_masks(self) -> list[list[NDArray[np.bool_]]]:
        """Masks of features by cluster: one per signal if noise differs between signals, else one of all features."""
        if not self.source.noise_by_joint:
            return [[np.ones(len(item.features), dtype=bool) for item in self.clusters]]
        return self._signal_masks

    @cached_property
    def _signal_masks(self) -> list[list[NDArray[np.bool_]]]:
        """Masks of features by cluster, for every signal."""
        names = dict.fromkeys((f.signal, f.index) for item in self.clusters for f in item.features)
        return [
            [np.array([(f.signal, f.index) == name for f in item.features]) for item in self.clusters] for name in names
        ]

    def lowers_excess(self, before: Sequence[Array], after: Sequence[Array], all_features: bool = False) -> bool:
        """Whether an effect removes enough of the excess error (:meth:`excess`).

        Enough is ``MIN_GAIN_SHARE`` of the excess of all features. If the noise of every joint is unknown,
        ``MIN_GAIN_SHARE_OF_JOINT`` of the excess of one joint is enough as well: residuals are scaled by those of the
        model without effects, so an effect in a well explained joint looks small. In a table of single impacts the gain
        is also compared with the excess of the signals that the effect changes (:meth:`_weighted_gain_share`).

        Args:
            before: Mean residuals without the effect, ``(F,)`` per cluster [-].
            after: Mean residuals with the effect, ``(F,)`` per cluster [-].
            all_features: Whether a table's gain is compared with the excess of all features only: a coarse curve leaves
                a residual in one signal, which is no further dependence.
        """
        excess_before, excess_after = (self.excess(residuals) for residuals in (before, after))
        if float(np.sum(excess_before - excess_after)) > MIN_GAIN_SHARE * float(np.sum(excess_before)) or (
            self.source.noise_by_joint
            and bool(np.any(excess_before - excess_after > MIN_GAIN_SHARE_OF_JOINT * excess_before))
        ):
            return True
        single_impacts = not all_features and not self.source.of_motion and not self.source.repeated
        return single_impacts and self._weighted_gain_share(before, after) > MIN_GAIN_SHARE

    def _weighted_gain_share(self, before: Sequence[Array], after: Sequence[Array]) -> float:
        """Share of a table's excess error that an effect removes, weighted by its change of each signal [-].

        With the excess a_s of signal s and the mean square c_s of its change, the weight is c_s / a_s, the largest
        share that the effect can explain. Signals that the effect does not change have no weight: an effect along the
        normal is not judged by the noise of the spin.
        """
        explained, total_weight = 0.0, 0.0
        for masks in self._signal_masks:
            excess_before, excess_after = (
                np.mean(
                    np.concatenate(
                        [
                            np.square(residual[mask]) - item.expected_squares[mask]
                            for residual, mask, item in zip(residuals, masks, self.clusters, strict=True)
                        ]
                    )
                )
                for residuals in (before, after)
            )
            changes = [(a - b)[mask] for a, b, mask in zip(before, after, masks, strict=True)]
            if excess_before > 0.0:
                weight = float(np.mean(np.square(np.concatenate(changes))) / excess_before)
                explained += weight * float(excess_before - excess_after) / float(excess_before)
                total_weight += weight
        return explained / total_weight if total_weight else 0.0

    def excess(self, residuals: Sequence[Array]) -> Array:
        """Mean square error beyond repeatability and discrepancy, per mask of :attr:`noise_masks`, ``(g,)`` [-]."""
        expected = [item.expected_squares for item in self.clusters]
        return np.array(
            [
                np.mean(
                    [
                        max(np.mean(np.square(r[m]) - e[m]), 0.0)
                        for r, e, m in zip(residuals, expected, masks, strict=True)
                    ]
                )
                for masks in self.noise_masks
            ]
        )

    def size(self, errors: Array) -> float:
        """Size of mean square errors by cluster, in multiples of repeatability [-]."""
        return size_of(errors, self.expected)

    def problem(self, candidate: Candidate) -> Problem:
        """Least-squares problem of a candidate that is linearised in these clusters."""
        noise_known = self.source.of_motion and self.source.repeated
        return Problem(candidate, self.clusters, self.neighbours, noise_unknown=not noise_known)


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
        """Linear fit of a candidate about its point."""
        problem = evidence.problem(candidate)
        return Fit(candidate, evidence, problem, problem.solve())

    @cached_property
    def estimate(self) -> Array:
        """Estimated parameters in their own units, ``(p,)``."""
        candidate = self.candidate
        return np.clip(candidate.point + self.change * candidate.scale, candidate.lower, candidate.upper)

    @property
    def distance_from_nominal(self) -> Array:
        """Distance of the estimate from nominal, in parameter scales, ``(p,)``."""
        return np.asarray((self.estimate - self.candidate.nominal) / self.candidate.scale)

    @cached_property
    def _at_range_ends(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of the estimates at their lower and at their upper bound, where that is not nominal, ``(p,)`` each."""
        candidate = self.candidate
        tolerance = 1e-6 * candidate.scale
        low, high = (
            (np.abs(self.estimate - bound) < tolerance) & (np.abs(bound - candidate.nominal) > tolerance)
            for bound in (candidate.lower, candidate.upper)
        )
        return low, high

    @cached_property
    def at_bound(self) -> NDArray[np.bool_]:
        """Mask of the estimates at a bound that is not nominal, or at the edge of physical consistency, ``(p,)``."""
        return np.asarray(self.at_range_end | self.candidate.at_consistency_boundary(self.estimate))

    @property
    def at_range_end(self) -> NDArray[np.bool_]:
        """Mask of the estimates at an end of their range that is not nominal, ``(p,)``."""
        low, high = self._at_range_ends
        return np.asarray(low | high)

    @cached_property
    def pushed_to_bound(self) -> NDArray[np.bool_]:
        """Mask of the estimates at a bound that differ from nominal by more than their half width, ``(p,)``.

        An estimate that the data do not determine may lie at a bound by chance.
        """
        return np.asarray(
            self.at_bound & (self.candidate.shapes | (np.abs(self.distance_from_nominal) > self.half_widths))
        )

    @cached_property
    def at_search_limit(self) -> NDArray[np.bool_]:
        """Mask of the estimates at a bound of the search that is no bound of physics, ``(p,)``."""
        candidate = self.candidate
        wider = candidate.widened(self.at_range_end, self.evidence.source)
        if wider is None:
            return np.zeros_like(self.at_range_end)
        low, high = self._at_range_ends
        return np.asarray((low & (wider.lower < candidate.lower)) | (high & (wider.upper > candidate.upper)))

    @property
    def leave_one_out_errors(self) -> Array:
        """Leave-one-out mean square error per cluster, ``(c,)`` [-]."""
        return self.problem.leave_one_out_errors

    @property
    def score(self) -> float:
        """Leave-one-out mean square error, mean over clusters [-]."""
        return float(self.leave_one_out_errors.mean())

    @property
    def cost(self) -> int:
        """Number of parameters of all effects, without shapes (:meth:`Effect.complexity`)."""
        return sum(effect.complexity(self.evidence.source.joints) for effect in self.candidate.effects)

    @cached_property
    def half_widths(self) -> Array:
        """Half widths of the 95 % intervals in parameter scales, ``(p,)``, including clock and calibration errors."""
        clock = 0.95 * self.evidence.source.clock  # half width of a uniform distribution
        clocks = np.array([clock if scalar.unit == "s" else 0.0 for scalar in self.candidate.scalars])
        calibrations = scipy.stats.norm.ppf(0.975) * self.problem.calibration_standard_errors()
        squares = self.half_widths_of_noise**2 + calibrations**2 + (clocks / self.candidate.scale) ** 2
        return np.asarray(np.sqrt(squares))

    @cached_property
    def half_widths_of_noise(self) -> Array:
        """Half widths of the 95 % intervals for exact clocks and calibrations, in parameter scales, ``(p,)``."""
        return self.problem.half_widths(self.change, self.evidence.null)

    @property
    def widened_to_intervals(self) -> Candidate:
        """The candidate with ranges as wide as the intervals, within the bounds of physics and of the user."""
        candidate, half_width = self.candidate, self.half_widths * self.candidate.scale
        for _ in range(MAX_RANGE_DOUBLINGS):
            outside = (self.estimate - half_width < candidate.lower) | (self.estimate + half_width > candidate.upper)
            wider = candidate.widened(outside, self.evidence.source) if np.any(outside) else None
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
        """Step to the estimates of free motion, in parameter scales, ``(p,)``; 0 for parameters it leaves undetermined.

        The offset of an encoder, for example, moves the position of the impact. If the pad then starts inside the
        object, sensitivities after the impact are useless; those before the impact still hold.
        """
        free_motion = self.evidence.free_motion_part
        if free_motion is None:
            return np.zeros_like(self.change)
        fitted = Fit.of(self.evidence.linearised_in_free_motion(self.candidate), free_motion)
        return np.where(np.abs(fitted.change) > fitted.half_widths, fitted.change, 0.0)

    @property
    def converged(self) -> bool:
        """Whether the linear model predicts a relative decrease below ``MIN_RELATIVE_DECREASE``."""
        return self.error_at_point - self.misfit < MIN_RELATIVE_DECREASE * self.error_at_point

    @property
    def stalled(self) -> bool:
        """Whether no simulated step has the lower error that the linear model predicts, as with rough features."""
        predicted_decrease = self.error_at_point - self.problem.error(self.problem.solve())
        return not np.any(self.change) and predicted_decrease > MIN_RELATIVE_DECREASE * self.error_at_point

    @property
    def out_of_time(self) -> bool:
        """Whether the processor time is spent; if so, further steps of this fit are listed as not tried."""
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
    def residual_evidence(self) -> Evidence:
        """The evidence with residuals of the fit in place of residuals of the model."""
        pairs = zip(self.evidence.clusters, self.residuals, strict=True)
        clusters = tuple(replace(item, residuals=item.residuals - (item.mean - residual)) for item, residual in pairs)
        return replace(self.evidence, clusters=clusters)

    def lack_of_fit(self) -> float | None:
        """p-value of the lack-of-fit test of the fit; None without repeats."""
        return self.evidence.null.lack_of_fit(self.residuals)


def chord_method(candidate: Candidate, evidence: Evidence, max_error: float = np.inf) -> Fit:
    """Fit by the chord method: simulations at every step, with the sensitivities of the start.

    A fit that ends at a search limit continues with a wider range, within the bounds of physics.

    Args:
        candidate: Start, linearised.
        evidence: The residuals to explain.
        max_error: Mean square error; a fit that the linear model puts above it after the first step stops [-].
    """
    return _with_wider_ranges(lambda start: _chord_steps(start, evidence, max_error), candidate)


def _with_wider_ranges(fit: Callable[[Candidate], Fit], start: Candidate) -> Fit:
    """A fit, repeated with wider ranges while it ends at a search limit within the bounds of physics."""
    fitted = fit(start)
    for _ in range(MAX_RANGE_DOUBLINGS):
        at_end = fitted.at_range_end
        wider = fitted.candidate.widened(at_end, fitted.evidence.source) if np.any(at_end) else None
        if wider is None or fitted.out_of_time:
            break
        fitted = fit(wider)
    return fitted


def _chord_steps(candidate: Candidate, evidence: Evidence, max_error: float) -> Fit:
    """Chord steps within the bounds of the candidate, with new sensitivities where they converge slowly.

    The chord method is cheap for nearly linear features. Its steps are short if sensitivities change on the way to the
    optimum, as with a damping that takes most of the velocity of a trial. Recordings keep the first sensitivities:
    their slow steps belong to parameters that the data hardly determine, or to shapes, which converge after their
    amplitudes (:func:`gauss_newton`).
    """
    fitted, radius, insensitive = Fit.of(candidate, evidence), np.inf, candidate.insensitive
    has_shapes = any(scalar.shape and not scalar.grid for scalar in candidate.scalars)
    may_be_slow = evidence.source.repeated and not has_shapes
    for number in range(_steps(evidence)):
        if fitted.converged or (number >= 1 and (insensitive or fitted.misfit > max_error or fitted.out_of_time)):
            break
        stepped, radius = _trust_region_step(fitted, radius)
        if stepped is None:  # no simulation has the decrease that the sensitivities predict
            return fitted.at_point
        slow_error = max(MAX_CHORD_ERROR_RATIO * fitted.error_at_point, evidence.expected_error)
        slow = may_be_slow and stepped.error_at_point > slow_error
        fitted = Fit.of(_relinearised(stepped.candidate, evidence), evidence) if slow else stepped
    return fitted


def _steps(evidence: Evidence) -> int:
    """Largest number of steps of a fit."""
    return MAX_STEPS_OF_TRIALS if evidence.source.repeated else MAX_STEPS_WITHOUT_REPEATS


def _trust_region_step(fitted: Fit, radius: float) -> tuple[Fit | None, float]:
    """The fit after a step in a box trust region, and the next radius.

    No parameter moves by more than ``radius`` [parameter scales], unless features are linear: a parameter with a wrong
    sensitivity would reach values without any effect, as friction in which a joint sticks, while the other parameters
    lower the error. If no nearby step helps, the whole step is taken, or the step by free motion
    (:meth:`Fit.step_by_free_motion`) if its error is lower. The gain ratio of actual to predicted decrease sets the
    next radius. None if no step lowers the error by the share ``MIN_RELATIVE_DECREASE``.
    """
    error = fitted.error_at_point
    long_step: Fit | None = None
    for _ in range(MAX_STEP_TRIALS):
        step = fitted.problem.solve(radius=radius)
        length = float(np.max(np.abs(step)))
        if length < 1e-6:
            break
        stepped, decrease = _fit_after_step(fitted, step)
        predicted_decrease = error - fitted.problem.error(step)
        unbounded = np.isinf(radius) and length > TRUST_RADIUS
        if np.isinf(radius) and error - decrease > fitted.evidence.expected_error:
            stepped_by_free_motion, decrease_by_free_motion = _fit_after_step(fitted, fitted.step_by_free_motion)
            if decrease_by_free_motion > max(decrease, MIN_RELATIVE_DECREASE * error):
                return stepped_by_free_motion, TRUST_RADIUS
        if decrease > (MIN_GAIN_RATIO_OF_FULL_STEP if unbounded else MIN_GAIN_RATIO) * predicted_decrease:
            return stepped, TRUST_RADIUS_FACTOR * radius
        if decrease > MIN_RELATIVE_DECREASE * error:
            if not unbounded:
                return stepped, max(length, TRUST_RADIUS)
            long_step = stepped
        radius = min(radius / TRUST_RADIUS_FACTOR, length / TRUST_RADIUS_FACTOR, TRUST_RADIUS)
    return long_step, TRUST_RADIUS if long_step is not None else radius


def _fit_after_step(fitted: Fit, step: Array) -> tuple[Fit | None, float]:
    """The fit at a simulated step, and the actual decrease of its error; None and -inf if it cannot be simulated."""
    candidate = fitted.candidate
    candidate_there = (
        evaluate_at(candidate, candidate.point + step * candidate.scale, fitted.evidence) if np.any(step) else None
    )
    refitted = None if candidate_there is None else Fit.of(candidate_there, fitted.evidence)
    return refitted, -np.inf if refitted is None else fitted.error_at_point - refitted.error_at_point


def _relinearised(candidate: Candidate, evidence: Evidence, share: float = 1.0) -> Candidate:
    """The candidate with new sensitivities at its point."""
    fresh = linearise(candidate, evidence.clusters, evidence.numbers, evidence.source, "new sensitivities", share)
    return candidate if fresh is None else replace(candidate, jacobians=fresh.jacobians, share=share)


def has_shape_parameter(candidate: Candidate) -> bool:
    """Whether a nonlinear shape parameter needs several starts of the fit."""
    return any(scalar.grid for scalar in candidate.scalars)


def gauss_newton(fitted: Fit) -> Fit:
    """Continue by Gauss-Newton steps, with new sensitivities at every point, while the error falls.

    The sensitivities of the start are zero for a parameter without effect there, and wrong for interacting parameters,
    such as the size of friction and the speed at which it fades. Finite-difference steps shrink: whole steps reach
    past stiction of joints and contacts, but are too coarse near the optimum.
    """
    evidence = fitted.evidence
    return _with_wider_ranges(lambda start: _gauss_newton_steps(start, evidence), fitted.candidate)


def _gauss_newton_steps(candidate: Candidate, evidence: Evidence) -> Fit:
    """Gauss-Newton steps within the bounds of the candidate."""
    fitted = Fit.of(candidate, evidence)
    for share in DIFFERENCE_STEP_SHARES:
        radius = np.inf
        for _ in range(_steps(evidence)):
            if not fitted.converged and fitted.out_of_time:
                break
            if fitted.candidate.share > share:
                fitted = Fit.of(_relinearised(fitted.candidate, evidence, share), evidence)
            if fitted.converged:
                break
            stepped, radius = _trust_region_step(fitted, radius)
            if stepped is None:
                break
            fitted = stepped
    cheap = not evidence.source.repeated
    return _valley_minimum(fitted) if cheap and any(map(candidate.curved, range(candidate.point.size))) else fitted


def _valley_minimum(fitted: Fit) -> Fit:
    """The fit at the minimum of a curved valley, by SciPy's trust-region reflective method.

    Steps in a box trust region creep along such a valley: single steps hardly lower the error, all of them by a fifth.
    """
    candidate, evidence, scale = fitted.candidate, fitted.evidence, fitted.candidate.scale

    def residuals(vector: Array) -> Array:
        evaluated = evaluate_at(candidate, vector * scale, evidence)
        if evaluated is None:
            return np.full(size, np.inf)
        pairs = zip(evidence.clusters, evaluated.offsets, strict=True)
        return np.concatenate([math.sqrt(item.count) * (item.mean - offset) for item, offset in pairs])

    size = sum(item.sigma.size for item in evidence.clusters)
    ends = candidate.lower / scale, candidate.upper / scale
    start = np.clip(candidate.point / scale, *ends)
    if not np.isfinite(residuals(start)).all():  # some impact map has no solution at the rounded point
        return fitted
    solution = scipy.optimize.least_squares(
        residuals, start, bounds=ends, x_scale="jac", ftol=VALLEY_FTOL, xtol=None,
        gtol=None, max_nfev=VALLEY_MAX_EVALUATIONS,
    )  # fmt: skip
    minimum = evaluate_at(candidate, solution.x * scale, evidence)
    if minimum is None:
        return fitted
    refitted = Fit.of(_relinearised(minimum, evidence, DIFFERENCE_STEP_SHARES[-1]), evidence)
    return refitted if refitted.error_at_point < fitted.error_at_point else fitted


def restart_from_afar(fitted: Fit) -> Fit:
    """Restart a fit whose error exceeds noise from distant points, at which contacts may be in another mode.

    A flat box tips only if its centre of mass lies beyond an edge; up to there the sensitivity is zero.
    """
    scalars = fitted.candidate.scalars
    for _ in scalars:
        evidence = fitted.evidence
        if not fitted.exceeds_noise or fitted.out_of_time:
            break
        starts = []
        for index, scalar in enumerate(scalars):
            for value in scalar.far:
                point = fitted.estimate.copy()
                point[index] = np.clip(value, fitted.candidate.lower[index], fitted.candidate.upper[index])
                if (evaluated := evaluate_at(fitted.candidate, point, evidence)) is not None:
                    starts.append(evaluated)
        if not starts:
            break
        errors = [Fit.of(evaluated, evidence).error_at_point for evaluated in starts]
        if min(errors) >= fitted.misfit:
            break
        restarted = chord_method(_relinearised(starts[int(np.argmin(errors))], evidence), evidence)
        if restarted.misfit >= fitted.misfit:
            break
        fitted = restarted
    return fitted


def nelder_mead(fitted: Fit) -> Fit:
    """The fit at the minimum of a downhill simplex (Nelder and Mead 1965); unchanged if the minimum is no better.

    Stick-slip of joints gives the error many local minima, in which Gauss-Newton steps end.
    """
    candidate, evidence, scale = fitted.candidate, fitted.evidence, fitted.candidate.scale

    def error(vector: Array) -> float:
        evaluated = evaluate_at(candidate, vector * scale, evidence)
        return UNSIMULATED_ERROR if evaluated is None else Fit.of(evaluated, evidence).error_at_point

    def stop_when_spent(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        del intermediate_result  # SciPy passes it to a parameter of this name
        if fitted.out_of_time:
            raise StopIteration

    start, ends = fitted.estimate / scale, (candidate.lower / scale, candidate.upper / scale)
    corners = np.clip(start + np.vstack((np.zeros(start.size), SIMPLEX_EDGE * np.eye(start.size))), *ends)
    solution = scipy.optimize.minimize(
        error, start, method="Nelder-Mead", bounds=np.transpose(ends), callback=stop_when_spent,
        options={"initial_simplex": corners, "maxfev": SIMPLEX_EVALUATIONS * start.size},
    )  # fmt: skip
    minimum = evaluate_at(candidate, solution.x * scale, evidence) if solution.fun < fitted.misfit else None
    return fitted if minimum is None else Fit.of(_relinearised(minimum, evidence, DIFFERENCE_STEP_SHARES[-1]), evidence)


def replay_and_refit(fitted: Fit, at_optimum: bool = False) -> Fit:
    """Fit again to the residuals of the model with the fitted effects, with every run replayed from its own start.

    The final estimate, its interval and the lack-of-fit test use this fit.

    Args:
        fitted: The fit.
        at_optimum: Whether its sensitivities were computed at an optimum.
    """
    first_evidence = fitted.evidence
    best: Fit | None = None  # at a simulated point
    for replay in range(MAX_FINAL_REPLAYS):
        candidate, point = fitted.candidate, fitted.estimate
        added = candidate.effects_at(point)
        clusters = first_evidence.source.residuals_with(
            added, [first_evidence.source.clusters[number] for number in first_evidence.numbers]
        )
        if clusters is None:
            return fitted
        evidence = replace(first_evidence, clusters=tuple(clusters))
        zeros = tuple(np.zeros_like(item.sigma) for item in clusters)
        replayed = replace(candidate, point=point, origin=added, offsets=zeros)
        simulated = Fit(replayed, evidence, evidence.problem(replayed), np.zeros_like(point))
        if (
            best is not None and simulated.misfit > (1.0 + MIN_RELATIVE_DECREASE) * best.misfit
        ):  # the estimate has other contacts
            return best
        best = simulated
        if replay > 0 or not at_optimum:
            replayed = (
                linearise(
                    replayed,
                    clusters,
                    first_evidence.numbers,
                    first_evidence.source,
                    "final sensitivities",
                    central=True,
                )
                or replayed
            )
        fitted = _confirmed_by_simulation(chord_method(replayed, evidence))
        if fitted.out_of_time or np.all(np.abs(fitted.estimate - point) < MAX_FINAL_CORRECTION * candidate.scale):
            break
    return fitted


def _confirmed_by_simulation(fitted: Fit) -> Fit:
    """The fit with its last linear correction if a simulation confirms it, else without: the valley may be curved."""
    evaluated = evaluate_at(fitted.candidate, fitted.estimate, fitted.evidence)
    confirmed = evaluated is not None and Fit.of(evaluated, fitted.evidence).error_at_point <= fitted.error_at_point
    return fitted if confirmed else fitted.at_point


def evaluate_at(candidate: Candidate, point: Array, evidence: Evidence) -> Candidate | None:
    """The candidate with features simulated at another point and the same sensitivities; None if this fails.

    One run of a condition represents its repeats; :func:`replay_and_refit` replays every run.
    """
    changes = evidence.source.differences(evidence.numbers, candidate.origin, candidate.effects_at(point), SEARCH)
    if any(change is None for change in changes):
        return None
    offsets = tuple(np.asarray(change) / item.sigma for change, item in zip(changes, evidence.clusters, strict=True))
    same_point = np.array_equal(point, candidate.point)
    return replace(candidate, point=point, offsets=offsets, share=candidate.share if same_point else np.inf)
