# SPDX-License-Identifier: Apache-2.0
"""Candidates: one or several effects with their sensitivities, and their least-squares fit to the evidence.

In scaled coordinates the mean residual of cluster c is

    r_c = J_c (theta - theta_0) + noise,        cov(noise) = (pure error + discrepancy) of c

fitted by bounded least squares with a weak normal prior of ``PRIOR_DEVIATION`` parameter scales about nominal. Fits are
compared by their leave-one-out error: each cluster is predicted by a fit to all other clusters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.search.null_distribution import NullDistribution
from impact_rs_analysis.diagnosis.thresholds import PRIOR_DEVIATION
from impact_rs_analysis.evidence.cluster import Added, Cluster
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.effects import Effect, Parameter
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.effects.changed_bodies import of_other_bodies
from impact_rs_sim.effects.formula import FormulaEffect
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array

PROBE_SHARES = (0.25, 0.5, 1.0)  # of the distance from nominal to either end of a range
MIN_STEP_ROOM_SHARE = 0.2  # of a finite-difference step; with less room to a bound the step is reversed
# Share of the squared change by a calibration that a fit leaves; below, its parameters include the calibration.
MIN_UNFITTED_SHARE = 1e-3
# Mean square scaled residual [-]; a smaller one would leave undetermined parameters without a prior.
MIN_NOISE_VARIANCE = 1e-4
MIN_BOUND_GAP = 1e-9  # parameter scales, between bounds that coincide
MIN_INFORMATION_SHARE = 1e-9  # of the information of the prior; less is rounding
MAX_ACTIVE_SETS = 20  # iterations of the active-set method; three are usual
EDGE_TOLERANCE = 1e-4  # of the distance from nominal, in the bisection for the boundary; 1/100 of an interval
EDGE_MARGIN = 1e-3  # of the distance from nominal; nearer to the boundary an estimate lies at it, and steps end there
DIFFERENCE_STEP_FACTORS = (
    1.0,
    -1.0,
    0.1,
    -0.1,
    0.01,
    -0.01,
)  # tried in this order until the point is physically consistent


@dataclass(frozen=True)
class Candidate:
    """One or several effects, linearised about ``point``, in the clusters of a :class:`Problem` and in their order.

    Attributes:
        effects: The effects.
        sizes: Number of parameters of each effect.
        scalars: Parameters of all effects, concatenated.
        lower: Lower bounds of the parameters in the measured physics, ``(p,)``.
        upper: Upper bounds, ``(p,)``.
        point: Parameter values of the linearisation, ``(p,)``.
        offsets: Per cluster, scaled features at ``point`` minus features at ``origin``, ``(F,)`` each.
        jacobians: Per cluster, scaled features per parameter scale, ``(F, p)`` each.
        origin: Effects added to the model when the residuals were computed.
        share: Finite-difference step of the sensitivities over the declared step of each parameter; infinite:
            sensitivities of another point.
        inertial: Mask of the parameters that change inertial parameters of bodies, ``(p,)``.
        worlds: Physics without the effects, for the test of physical consistency.
    """

    effects: tuple[Effect, ...]
    sizes: tuple[int, ...]
    scalars: tuple[Parameter, ...]
    lower: Array
    upper: Array
    point: Array
    offsets: tuple[Array, ...] = ()
    jacobians: tuple[Array, ...] = ()
    origin: Added = ()
    share: float = math.inf
    inertial: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    worlds: Sequence[Physics] = ()

    @staticmethod
    def of(effects: tuple[Effect, ...], source: Source, point: Array | None = None, origin: Added = ()) -> Candidate:
        """A candidate without sensitivities, at ``point`` (None: nominal values)."""
        joints = source.joints
        bounds = [effect.bounds_in(source.worlds) for effect in effects]
        changing = [effect.changes_bodies(source.worlds[0]) for effect in effects]
        inertial = np.repeat(changing, [len(low) for low, _ in bounds])
        if point is None:
            point = np.concatenate([effect.nominal(joints) for effect in effects])
        return Candidate(
            effects=effects,
            sizes=tuple(len(low) for low, _ in bounds),
            scalars=tuple(scalar for effect in effects for scalar in effect.scalars(joints)),
            lower=np.concatenate([low for low, _ in bounds]),
            upper=np.concatenate([high for _, high in bounds]),
            point=point,
            origin=origin,
            inertial=inertial,
            worlds=of_other_bodies(source.worlds) if np.any(inertial) else (),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    @cached_property
    def scale(self) -> Array:
        """Scale of each parameter, ``(p,)``."""
        return np.array([scalar.scale for scalar in self.scalars])

    @cached_property
    def shapes(self) -> NDArray[np.bool_]:
        """Mask of the shape parameters, which change nothing while the amplitudes are nominal, ``(p,)``."""
        return np.array([scalar.shape for scalar in self.scalars], dtype=bool)

    @cached_property
    def nominal(self) -> Array:
        """Nominal values, at which the effects change nothing, ``(p,)``."""
        return np.array([scalar.nominal for scalar in self.scalars])

    @cached_property
    def prior(self) -> Array:
        """Standard deviations of the prior about nominal, in parameter scales, ``(p,)``."""
        return np.array(
            [PRIOR_DEVIATION if scalar.prior is None else scalar.prior / scalar.scale for scalar in self.scalars]
        )

    def physically_consistent(self, vector: Array) -> bool:
        """Whether rigid bodies have the inertial parameters at ``vector``, ``(p,)`` (physical consistency)."""
        if not self.worlds:
            return True
        inertial_changes = self.inertial & (vector != self.nominal)
        acting = [(effect, vector[part]) for effect, part in self.parts if inertial_changes[part].any()]
        try:
            for physics in self.worlds if acting else ():
                for effect, values in acting:
                    physics = effect.apply_vector(physics, values)
        except NotABody:
            return False
        return True

    def nearest_consistent(self, vector: Array) -> Array:
        """``vector``, moved towards nominal until it is physically consistent, ``(p,)``."""
        return vector if self.physically_consistent(vector) else self.consistency_boundary(vector)[0]

    def consistency_boundary(self, vector: Array) -> list[Array]:
        """Physically consistent points nearest to an inconsistent one, ``(p,)`` each.

        Bisection on the line to nominal, the bodies of the model, in three subspaces: all inertial parameters, their
        shapes only (the mass moves towards the body), or all but the shapes (less mass in the same place).
        """
        points = []
        for subspace in (self.inertial, self.inertial & self.shapes, self.inertial & ~self.shapes):
            start = np.where(subspace, self.nominal, vector)
            if not self.physically_consistent(start):
                continue
            low, high = 0.0, 1.0
            while high - low > EDGE_TOLERANCE:
                middle = 0.5 * (low + high)
                low, high = (
                    (middle, high) if self.physically_consistent(start + middle * (vector - start)) else (low, middle)
                )
            points.append(start + low * (vector - start))
        return points

    def at_consistency_boundary(self, vector: Array) -> NDArray[np.bool_]:
        """Mask of inertial parameters at the boundary of physical consistency, ``(p,)``."""
        displacement = np.where(self.inertial, vector - self.nominal, 0.0)
        at_edge = not self.physically_consistent(vector + EDGE_MARGIN * displacement)
        return np.asarray((displacement != 0.0) & at_edge)

    @cached_property
    def parts(self) -> tuple[tuple[Effect, slice], ...]:
        """Every effect with the slice of its parameters."""
        ends = np.cumsum(self.sizes).tolist()
        return tuple(
            (effect, slice(end - size, end)) for effect, size, end in zip(self.effects, self.sizes, ends, strict=True)
        )

    def part(self, name: str) -> slice:
        """Slice of the parameters of one effect."""
        return next(part for effect, part in self.parts if effect.name == name)

    @property
    def has_sensitivity(self) -> bool:
        """Whether some sensitivity at ``point`` is not zero."""
        return any(np.any(jacobian) for jacobian in self.jacobians)

    @property
    def insensitive(self) -> list[int]:
        """Indices of the parameters with zero sensitivity at ``point``, such as the centre of a payload of mass 0."""
        zero = np.all([np.all(jacobian == 0.0, axis=0) for jacobian in self.jacobians], axis=0)
        return [int(index) for index in np.flatnonzero(zero)]

    @property
    def insensitive_shapes(self) -> list[int]:
        """Indices of the insensitive shape parameters of effects that are absent at ``point``."""
        acts = (self.point != self.nominal) & ~self.shapes
        shapes_of_absent_effects = np.repeat([not acts[part].any() for _, part in self.parts], self.sizes) & self.shapes
        return [index for index in self.insensitive if shapes_of_absent_effects[index]]

    def curved(self, index: int) -> bool:
        """Whether the valley of the error is curved along a parameter: its effect has several shapes without a grid.

        The length of a cable and the position of its end are an example. The position of a payload is none: torques are
        linear in mass and first moment, so Gauss-Newton steps reach the minimum.
        """
        effect, part = next(item for item in self.parts if item[1].start <= index < item[1].stop)
        return (
            isinstance(effect, FormulaEffect)
            and sum(scalar.shape and not scalar.grid for scalar in self.scalars[part]) > 1
        )

    def probes(self, index: int) -> list[Array]:
        """Points over the range of one parameter, nearest to ``point`` first, ``(p,)`` each."""
        low, high = self.lower[index], self.upper[index]
        ends = [low, high, *np.clip(self.scalars[index].far, low, high)]
        current = self.point[index]
        values = {current + share * (end - current) for end in ends for share in PROBE_SHARES if end != current}
        points = []
        for value in sorted(values, key=lambda value: abs(value - current)):
            points.append(self.point.copy())
            points[-1][index] = value
        return points

    def with_sensitivity(self, index: int, columns: Sequence[Array]) -> Candidate:
        """The candidate with the sensitivity to one parameter replaced, ``(F,)`` by cluster."""
        jacobians = tuple(jacobian.copy() for jacobian in self.jacobians)
        for jacobian, column in zip(jacobians, columns, strict=True):
            jacobian[:, index] = column
        return replace(self, jacobians=jacobians)

    def steps(self, joints: Joints) -> Array:
        """Finite-difference steps within the bounds, reversed near a bound, ``(p,)``."""
        steps = np.concatenate([effect.steps(joints, self.point[part]) for effect, part in self.parts])
        room = np.clip(self.point + steps, self.lower, self.upper) - self.point
        steps = np.where(np.abs(room) < MIN_STEP_ROOM_SHARE * np.abs(steps), -steps, room)
        return np.array([self.consistent_step(self.point, index, step) for index, step in enumerate(steps.tolist())])

    def difference_ends(self, joints: Joints, share: float, central: bool) -> list[tuple[Array, Array]]:
        """Both points of the finite difference of every parameter, ``(p,)`` each."""
        ends = []
        for index, step in enumerate((share * self.steps(joints)).tolist()):
            low, high = self.point.copy(), self.point.copy()
            high[index] += step
            if central:
                low[index] = np.clip(low[index] - step, self.lower[index], self.upper[index])
                low = low if self.physically_consistent(low) else self.point
            ends.append((low, high))
        return ends

    def consistent_step(self, vector: Array, index: int, step: float) -> float:
        """A step of one parameter from a point, reversed or shortened until it is physically consistent."""
        if not self.inertial[index]:
            return step
        direction = step * (np.arange(vector.size) == index)
        return step * next(
            (share for share in DIFFERENCE_STEP_FACTORS if self.physically_consistent(vector + share * direction)), 1.0
        )

    def only(self, clusters: Sequence[int]) -> Candidate:
        """The candidate restricted to some clusters, by number."""
        return replace(
            self,
            offsets=tuple(self.offsets[number] for number in clusters),
            jacobians=tuple(self.jacobians[number] for number in clusters),
        )

    def without(self, name: str) -> Candidate:
        """The candidate without one of its effects."""
        part = self.part(name)
        remaining = [number for number, effect in enumerate(self.effects) if effect.name != name]
        columns = np.setdiff1d(np.arange(self.point.size), np.arange(part.start, part.stop))
        return replace(
            self,
            effects=tuple(self.effects[number] for number in remaining),
            sizes=tuple(self.sizes[number] for number in remaining),
            scalars=tuple(self.scalars[index] for index in columns),
            lower=self.lower[columns],
            upper=self.upper[columns],
            point=self.point[columns],
            jacobians=tuple(jacobian[:, columns] for jacobian in self.jacobians),
            inertial=self.inertial[columns],
        )

    def fixed(self, *indices: int) -> Candidate:
        """The candidate with some parameters fixed at nominal, to first order."""
        fixed_indices = list(indices)
        to_nominal = ((self.nominal - self.point) / self.scale)[fixed_indices]
        jacobians = []
        for jacobian in self.jacobians:
            copy = jacobian.copy()
            copy[:, fixed_indices] = 0.0
            jacobians.append(copy)
        offsets = tuple(
            offset + jacobian[:, fixed_indices] @ to_nominal
            for offset, jacobian in zip(self.offsets, self.jacobians, strict=True)
        )
        return replace(self, offsets=offsets, jacobians=tuple(jacobians))

    def widened(self, at_bound: NDArray[np.bool_], source: Source) -> Candidate | None:
        """The candidate with wider ranges for effects with a parameter at a bound; None at bounds of physics.

        Args:
            at_bound: Mask of the parameters at a bound, ``(p,)``.
            source: Measurements; their physics bounds parameters.
        """
        effects = tuple(
            effect.with_parameters(Parameter.widened) if np.any(at_bound[part]) else effect
            for effect, part in self.parts
        )
        wider = Candidate.of(effects, source)
        if np.all((wider.lower == self.lower)[at_bound] & (wider.upper == self.upper)[at_bound]):
            return None
        return replace(self, effects=effects, scalars=wider.scalars, lower=wider.lower, upper=wider.upper)

    def effects_at(self, vector: Array) -> Added:
        """Effect names with parameter values; effects at nominal are omitted, so that equal physics share replays."""
        acts = (vector != self.nominal) & ~self.shapes
        return tuple((effect.name, tuple(vector[part].tolist())) for effect, part in self.parts if acts[part].any())

    def joined_with(self, other: Candidate) -> Candidate:
        """Both candidates as one, by superposition: exact for small effects, a start of the fit for large ones."""
        return Candidate(
            effects=self.effects + other.effects,
            sizes=self.sizes + other.sizes,
            scalars=self.scalars + other.scalars,
            lower=np.concatenate((self.lower, other.lower)),
            upper=np.concatenate((self.upper, other.upper)),
            point=np.concatenate((self.point, other.point)),
            offsets=tuple(a + b for a, b in zip(self.offsets, other.offsets, strict=True)),
            jacobians=tuple(np.hstack((a, b)) for a, b in zip(self.jacobians, other.jacobians, strict=True)),
            origin=self.origin,
            share=max(self.share, other.share),
            inertial=np.concatenate((self.inertial, other.inertial)),
            worlds=self.worlds or other.worlds,
        )


def required_predictions(
    candidate: Candidate, numbers: Sequence[int], source: Source, share: float = 1.0, central: bool = False
) -> list[tuple[int, Added]]:
    """Predictions that :func:`linearise` needs; a list, so that predictions for many effects run in one batch."""
    at_nominal = not candidate.origin and bool(np.all(candidate.point == candidate.nominal))
    at_point = candidate.effects_at(candidate.point)
    differences = candidate.difference_ends(source.joints, share, central)
    added_by_parameter = [[candidate.effects_at(end) for end in ends[0 if central else 1 :]] for ends in differences]
    predictions: list[tuple[int, Added]] = []
    for number in numbers:
        predictions.append((number, candidate.origin))
        if not at_nominal:
            predictions.append((number, at_point))
        for effect, part in candidate.parts:
            if effect.seen_in(source.clusters[number].contact):
                predictions += [(number, added) for ends in added_by_parameter[part] for added in ends]
    return predictions


def linearise(
    candidate: Candidate,
    clusters: Sequence[Cluster],
    numbers: Sequence[int],
    source: Source,
    purpose: str = "sensitivities",
    share: float = 1.0,
    central: bool = False,
) -> Candidate | None:
    """The candidate with sensitivities by finite differences about its point; None if a replay has no contact.

    Args:
        candidate: Effects and point.
        clusters: Evidence, with the scale of the features.
        numbers: Indices of these clusters in the source.
        source: Predicts the features.
        purpose: Purpose, shown as progress.
        share: Finite-difference step over the declared step of each parameter. Whole steps reach past stiction of
            joints and contacts; near an optimum curvature biases forward differences over whole steps.
        central: Whether differences are central, at twice the cost. They have no such bias, and whole steps average
            features that are rough on a smaller scale, such as the torques of a pad that meets an edge first.
    """
    at_nominal = not candidate.origin and bool(np.all(candidate.point == candidate.nominal))
    ends = candidate.difference_ends(source.joints, share, central)
    results = iter(source.predict(required_predictions(candidate, numbers, source, share, central), purpose))
    offsets, jacobians = [], []
    for item in clusters:
        at_origin = next(results)
        at_point = at_origin if at_nominal else next(results)
        if at_origin is None or at_point is None:
            return None
        jacobian = np.zeros((at_origin.size, candidate.point.size))
        for effect, part in candidate.parts:
            if not effect.seen_in(item.contact):
                continue
            for index in range(part.start, part.stop):
                low = next(results) if central else at_point
                high = next(results)
                if low is None or high is None:
                    return None
                span = (ends[index][1][index] - ends[index][0][index]) / candidate.scale[index]
                jacobian[:, index] = (high - low) / item.sigma / span
        offsets.append((at_point - at_origin) / item.sigma)
        jacobians.append(jacobian)
    return replace(candidate, offsets=tuple(offsets), jacobians=tuple(jacobians), share=share)


class Problem:
    """Bounded linear least squares of a candidate with a normal prior, and its leave-one-out solutions.

    Args:
        candidate: Effects with sensitivities.
        clusters: Residuals, in the same order.
        neighbours: Per cluster, neighbours with correlated noise, which its leave-one-out fit excludes as well.
        noise_unknown: Whether the noise is unknown and residuals are scaled by residuals of the model, as without
            repeats. The prior is then weighted by the residual of the fit. With a full weight it would pull the
            estimates of a light arm, whose parameter scales are small, to their nominal values.
    """

    def __init__(
        self,
        candidate: Candidate,
        clusters: Sequence[Cluster],
        neighbours: Sequence[Sequence[int]] | None = None,
        noise_unknown: bool = False,
    ) -> None:
        self.candidate = candidate
        self.clusters = tuple(clusters)
        self._neighbours = neighbours
        self.targets = [item.mean - offset for item, offset in zip(clusters, candidate.offsets, strict=True)]
        self.information = np.array(
            [item.count * jacobian.T @ jacobian for item, jacobian in zip(clusters, candidate.jacobians, strict=True)]
        )
        self.scores = np.array(
            [
                item.count * jacobian.T @ target
                for item, jacobian, target in zip(clusters, candidate.jacobians, self.targets, strict=True)
            ]
        )
        self._counts = np.array([item.count * target.size for item, target in zip(clusters, self.targets, strict=True)])
        self._mean_squares = np.array([target @ target / target.size for target in self.targets])
        scale = candidate.scale
        self._lower = (candidate.lower - candidate.point) / scale
        self._upper = np.maximum((candidate.upper - candidate.point) / scale, self._lower + MIN_BOUND_GAP)
        self._nominal = (candidate.nominal - candidate.point) / scale
        self._weigh_prior(1.0)
        if noise_unknown:
            self._weigh_prior(float(np.clip(self.error(self.solve()), MIN_NOISE_VARIANCE, 1.0)))

    def _weigh_prior(self, noise: float) -> None:
        """Weigh the prior for a noise variance in the scale of the clusters [-].

        If the noise is unknown, residuals are scaled by residuals of the model. A prior that is weak against these is
        strong against the smaller residuals of a better model.
        """
        self._prior = noise / np.square(self.candidate.prior)
        information = self.information.sum(axis=0)
        self.total = information + np.diag(self._prior)
        # A parameter without influence at the point, such as the friction of a sticking contact, stays at the point.
        influential = np.diagonal(information) > MIN_INFORMATION_SHARE * self._prior
        self._total_score = self.scores.sum(axis=0) + np.where(influential, self._nominal * self._prior, 0.0)

    def solve(self, excluded: Sequence[int] = (), radius: float = np.inf) -> Array:
        """Least-squares change from the candidate's point in parameter scales, ``(p,)``.

        Args:
            excluded: Indices of the clusters to leave out.
            radius: Radius of the box trust region, in scales.
        """
        information, score = self.total, self._total_score
        if len(excluded) > 0:
            indices = list(excluded)
            information = information - self.information[indices].sum(axis=0)
            score = score - self.scores[indices].sum(axis=0)
        lower, upper = np.clip(self._lower, -radius, radius), np.clip(self._upper, -radius, radius)
        upper = np.maximum(upper, lower + MIN_BOUND_GAP)
        return self._consistent(bounded(information, score, lower, upper), information, score, lower, upper)

    def _consistent(self, change: Array, information: Array, score: Array, lower: Array, upper: Array) -> Array:
        """Physically consistent change: inertial parameters at the boundary, the others solved for given these."""
        candidate = self.candidate
        point = candidate.point + change * candidate.scale
        if candidate.physically_consistent(point):
            return change
        inertial, bounded_changes = candidate.inertial, []
        for edge in candidate.consistency_boundary(point):
            edge_change = (edge - candidate.point) / candidate.scale
            bounded_changes.append(
                bounded(
                    information,
                    score,
                    np.where(inertial, edge_change, lower),
                    np.where(inertial, edge_change + MIN_BOUND_GAP, upper),
                )
            )
        return min(bounded_changes, key=lambda b: 0.5 * b @ information @ b - score @ b, default=np.zeros_like(change))

    def errors(self, change: Array) -> Array:
        """Mean square scaled error per cluster, ``(c,)`` [-], at a change from the point, ``(p,)`` or ``(c, p)``."""
        gains = np.sum((2.0 * self.scores - (self.information @ change[..., None])[..., 0]) * change, axis=-1)
        return np.maximum(self._mean_squares - gains / self._counts, 0.0)

    def error(self, change: Array) -> float:
        """Objective of :meth:`solve` at a change from the point ``(p,)``: the mean square over all measurements.

            sum_c n_c |r_c|^2 / sum_c n_c F_c

        with repeats n_c and features F_c of cluster c; the prior is left out.
        """
        return float(self._counts @ self.errors(change)) / float(self._counts.sum())

    def residuals_at(self, change: Array) -> list[Array]:
        """Mean residuals at a change from the point, ``(F,)`` per cluster [-]."""
        return [t - j @ change for t, j in zip(self.targets, self.candidate.jacobians, strict=True)]

    @cached_property
    def leave_one_out_residuals(self) -> list[Array]:
        """Leave-one-out residuals: residuals of every cluster by the fit to all other clusters, ``(F,)`` each [-]."""
        return [
            target - jacobian @ change
            for target, jacobian, change in zip(
                self.targets, self.candidate.jacobians, self.leave_one_out_changes, strict=True
            )
        ]

    @cached_property
    def leave_one_out_changes(self) -> Array:
        """Leave-one-out estimates, as changes in parameter scales, ``(c, p)``."""
        neighbours = self._neighbours or [()] * len(self.clusters)
        return self._solved_without([[c, *neighbours[c]] for c in range(len(self.clusters))])

    def _solved_without(self, exclusions: Sequence[Sequence[int]]) -> Array:
        """:meth:`solve` for several sets of excluded clusters at once, ``(k, p)``."""
        informations = np.array([self.total - self.information[excluded].sum(axis=0) for excluded in exclusions])
        scores = np.array([self._total_score - self.scores[excluded].sum(axis=0) for excluded in exclusions])
        changes = bounded(informations, scores, self._lower, self._upper)
        candidate, inertial = self.candidate, self.candidate.inertial
        if not np.any(inertial):
            return changes
        change_of_all = self.solve()
        for number, change in enumerate(changes):
            if not candidate.physically_consistent(
                candidate.point + change * candidate.scale
            ):  # as in the fit to all clusters
                lower, upper = (
                    np.where(inertial, change_of_all, self._lower),
                    np.where(inertial, change_of_all + MIN_BOUND_GAP, self._upper),
                )
                changes[number] = bounded(informations[number], scores[number], lower, upper)
        return changes

    @cached_property
    def leave_one_out_errors(self) -> Array:
        """Leave-one-out mean square error of every cluster, ``(c,)`` [-]."""
        return self.errors(self.leave_one_out_changes)

    def jackknife_standard_errors(self) -> Array:
        """Jackknife standard errors over the clusters, in parameter scales, ``(p,)`` (Efron 1982)."""
        count = len(self.clusters)
        replicates = (
            self._solved_without([[c] for c in range(count)]) if self._neighbours else self.leave_one_out_changes
        )
        squares = np.square(replicates - replicates.mean(axis=0)).sum(axis=0)
        return np.asarray(np.sqrt((count - 1) / count * squares))

    def half_widths(self, change: Array, null: NullDistribution) -> Array:
        """Half widths of 95 % intervals in parameter scales, ``(p,)``.

        The larger of two estimates, by the noise and by the jackknife over clusters, each with its own quantile of
        Student's t; model discrepancy is added in quadrature.

        The prior shrinks undetermined parameters to nominal. If true parameters scatter about nominal with the
        covariance S of the prior, this bias has the covariance A^-1 P S P A^-1, with the total information A and the
        information P of the prior.
        """
        noise, jackknife, systematic, freedom = self._standard_errors(change, null)
        informative = sum(bool(np.any(jacobian)) for jacobian in self.candidate.jacobians)
        jackknife_freedom = np.maximum(np.minimum(informative - 1.0, freedom if null.by_blocks else np.inf), 1.0)
        pairs = ((noise, freedom), (jackknife, jackknife_freedom))
        scatter = np.maximum(*(scipy.stats.t.ppf(0.975, degrees) * error for error, degrees in pairs))
        return np.asarray(np.hypot(scatter, scipy.stats.norm.ppf(0.975) * systematic))

    def t_test_p_value(self, change: Array, null: NullDistribution, index: int) -> float:
        """p-value of one parameter being nominal, by Student's t with the standard error of its interval.

        For a parameter on which few blocks depend: there the sign-flip test has no power, even if the blocks determine
        the parameter well. Calibration errors are ignored.
        """
        noise, jackknife, systematic, freedom = (values[index] for values in self._standard_errors(change, null))
        error = math.hypot(max(noise, jackknife), systematic)
        distance = abs(float(change[index] - self._nominal[index]))
        return float(2.0 * scipy.stats.t.sf(distance / max(error, 1e-300), freedom))

    def _standard_errors(self, change: Array, null: NullDistribution) -> tuple[Array, Array, Array, Array]:
        """Standard errors by noise, by jackknife, and by discrepancy and prior; degrees of freedom of the noise.

        ``(p,)`` each, see :meth:`half_widths`.
        """
        inverse = np.linalg.inv(self.total)
        jacobians = self.candidate.jacobians
        noise = null.covariance(jacobians, self.residuals_at(change), inverse)
        shrinkage = inverse @ (np.square(self.candidate.prior * self._prior)[:, None] * inverse)
        systematic = null.discrepancy(jacobians, inverse) + shrinkage
        noise_errors, systematic_errors = (
            np.sqrt(np.maximum(np.diag(covariance), 0.0)) for covariance in (noise, systematic)
        )
        return noise_errors, self.jackknife_standard_errors(), systematic_errors, null.freedoms(jacobians, inverse)

    def calibration_standard_errors(self) -> Array:
        """Standard errors of the estimate due to calibrations that all clusters share, ``(p,)`` [parameter scales].

        A calibration in the span of the candidate's sensitivities, such as the gain of a torque, is fitted and adds no
        error.
        """
        weighted = [
            (np.sqrt(item.count) * item.calibrations, np.sqrt(item.count) * jacobian)
            for item, jacobian in zip(self.clusters, self.candidate.jacobians, strict=True)
            if item.calibrations is not None
        ]
        if not weighted:
            return np.zeros(self.total.shape[0])
        scores = np.sum([rows @ jacobian for rows, jacobian in weighted], axis=0)
        changes = np.linalg.solve(self.total, scores.T).T
        unfitted = [(rows, rows - changes @ jacobian.T) for rows, jacobian in weighted]
        total_squares, unfitted_squares = np.sum(
            [[np.sum(np.square(part), axis=1) for part in pair] for pair in unfitted], axis=0
        )
        changes[unfitted_squares < MIN_UNFITTED_SHARE * total_squares] = 0.0
        return np.asarray(np.sqrt(np.sum(np.square(changes), axis=0)))

    def p_value(self, null: NullDistribution, tested: Sequence[int]) -> float:
        """p-value of some parameters being nominal while all others of the candidate are fitted (score test).

        Args:
            null: Null distribution of the residuals of the fit without the tested parameters, or of the model if
                nothing else is fitted.
            tested: Indices of the tested parameters.
        """
        nuisance = np.setdiff1d(np.arange(self.total.shape[0]), tested)
        return null.p_value(
            [jacobian[:, list(tested)] for jacobian in self.candidate.jacobians],
            [jacobian[:, nuisance] for jacobian in self.candidate.jacobians],
        )


def bounded(information: Array, score: Array, lower: Array, upper: Array) -> Array:
    """Minimiser of ``b^T information b / 2 - score^T b`` within bounds, of one problem or of several, ``(k, p)``.

    Primal-dual active set method (Hintermüller, Ito and Kunisch 2002): entries stay at a bound while their multipliers
    have the sign for it. The few problems that do not converge are solved by :func:`scipy.optimize.lsq_linear`.
    """
    change = np.linalg.solve(information, score[..., None])[..., 0]
    matrices = information.reshape(-1, *information.shape[-2:])
    scores, solutions = np.atleast_2d(score), np.atleast_2d(change)
    low, high = solutions < lower - 1e-12, solutions > upper + 1e-12
    pending = np.flatnonzero(np.any(low | high, axis=-1))
    for _ in range(MAX_ACTIVE_SETS):
        if pending.size == 0:
            break
        fixed = low[pending] | high[pending]
        matrix = np.where(fixed[..., None], np.eye(fixed.shape[-1]), matrices[pending])
        right_sides = np.where(low[pending], lower, np.where(high[pending], upper, scores[pending]))
        solutions[pending] = np.linalg.solve(matrix, right_sides[..., None])[..., 0]
        multipliers = scores[pending] - (matrices[pending] @ solutions[pending][..., None])[..., 0]
        lower_now = np.where(low[pending], multipliers <= 0.0, solutions[pending] < lower - 1e-12)
        upper_now = np.where(high[pending], multipliers >= 0.0, solutions[pending] > upper + 1e-12)
        changed = np.any((lower_now != low[pending]) | (upper_now != high[pending]), axis=-1)
        low[pending], high[pending] = lower_now, upper_now
        pending = pending[changed]
    for index in pending:
        root = np.linalg.cholesky(matrices[index]).T
        target = np.linalg.solve(root.T, scores[index])
        solutions[index] = scipy.optimize.lsq_linear(root, target, bounds=(lower, upper), method="bvls").x
    return np.clip(solutions, lower, upper).reshape(score.shape)
