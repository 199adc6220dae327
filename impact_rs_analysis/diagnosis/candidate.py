# SPDX-License-Identifier: Apache-2.0
"""Candidates: effects, alone or together, with their sensitivities, fitted to the evidence.

In scaled coordinates the mean residual of cluster c is

    r_c = J_c (theta - theta_0) + noise,        cov(noise) = (pure error + discrepancy) of c

fitted by bounded least squares with a weak normal prior of ``PRIOR_DEVIATION`` parameter scales about nominal. Fits are
compared by their leave-one-out error: the error of each cluster, predicted by a fit to all others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.null_distribution import NullDistribution, combined_half_width
from impact_rs_analysis.diagnosis.thresholds import PRIOR_DEVIATION
from impact_rs_analysis.evidence.cluster import Added, Cluster
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.effects import Effect, Parameter
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.effects.changed_bodies import of_other_bodies
from impact_rs_sim.effects.formula import FormulaEffect
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array

PROBE_SHARES = (0.25, 0.5, 1.0)  # of the distance from nominal to either end of a range
MIN_STEP_ROOM_SHARE = 0.2  # of a finite-difference step; nearer a bound the step goes the other way
# Unfitted share of the squared change by a calibration; with less left, the parameters of a fit stand for it.
MIN_UNFITTED_SHARE = 1e-3
# Mean square residual, scaled [-]: a smaller one would leave parameters that the data do not determine without a prior.
MIN_NOISE_VARIANCE = 1e-4
MIN_BOUND_GAP = 1e-9  # parameter scales, between bounds that coincide
MAX_ACTIVE_SETS = 20  # iterations of the active-set method; three are usual
EDGE_TOLERANCE = 1e-4  # of the distance from nominal: bisection to the last point with bodies, 1/100 of an interval
EDGE_MARGIN = (
    1e-3  # of the distance from nominal: so near the edge of the bodies an estimate lies at it; steps end there
)
DIFFERENCE_STEP_FACTORS = (1.0, -1.0, 0.1, -0.1, 0.01, -0.01)  # tried in this order until there are bodies


def concerns(effect: Effect, cluster: Cluster) -> bool:
    """Whether an effect can change the features of a cluster."""
    return effect.seen_in(cluster.contact)


@dataclass(frozen=True)
class Candidate:
    """One or several effects, linearised about ``point``; clusters are those of a :class:`Problem`, in its order.

    Attributes:
        effects: The effects.
        sizes: Number of parameters of each.
        scalars: All their parameters after each other.
        lower: Bounds of the parameters under the physics at hand, ``(p,)``.
        upper: The same, ``(p,)``.
        point: Parameter values of the linearisation, ``(p,)``.
        offsets: Per cluster, scaled features at ``point`` minus those at ``origin``, ``(F,)`` each.
        jacobians: Per cluster, scaled features per parameter scale, ``(F, p)`` each.
        origin: Effects added to the model when the residuals were computed.
        share: Of the steps of the parameters, with which the sensitivities at ``point`` were computed; infinite: they
            are those of another point.
        of_bodies: Which parameters belong to effects that change bodies, ``(p,)``.
        worlds: Physics without the effects, in which the bodies have to exist.
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
    of_bodies: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    worlds: Sequence[Physics] = ()

    @staticmethod
    def of(effects: tuple[Effect, ...], source: Source, point: Array | None = None, origin: Added = ()) -> Candidate:
        """Effects without sensitivities, at ``point`` (None: nominal values)."""
        joints = source.joints
        bounds = [effect.bounds_in(source.worlds) for effect in effects]
        changing = [effect.changes_bodies(source.worlds[0]) for effect in effects]
        of_bodies = np.repeat(changing, [len(low) for low, _ in bounds])
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
            of_bodies=of_bodies,
            worlds=of_other_bodies(source.worlds) if np.any(of_bodies) else (),
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
    def _shapes(self) -> NDArray[np.bool_]:
        """Which parameters are shapes: they change nothing while the others are nominal, ``(p,)``."""
        return np.array([scalar.shape for scalar in self.scalars], dtype=bool)

    @cached_property
    def nominal(self) -> Array:
        """Nominal values, at which the effects change nothing, ``(p,)``."""
        return np.array([scalar.nominal for scalar in self.scalars])

    @cached_property
    def prior(self) -> Array:
        """Standard deviations of the prior about nominal, in parameter scales, ``(p,)``."""
        return np.array([PRIOR_DEVIATION if one.prior is None else one.prior / one.scale for one in self.scalars])

    def has_bodies(self, vector: Array) -> bool:
        """Whether rigid bodies can have the inertial parameters that effects give them at ``vector``, ``(p,)``."""
        moved = self.of_bodies & (vector != self.nominal)
        own = [(effect, vector[part]) for effect, part in self.parts if np.any(moved[part])]
        try:
            for physics in self.worlds if own else ():
                for effect, values in own:
                    physics = effect.apply_vector(physics, values)
        except NotABody:
            return False
        return True

    def possible(self, vector: Array) -> Array:
        """``vector``, but no further from nominal than there are bodies, ``(p,)``."""
        return vector if self.has_bodies(vector) else self.edges_of_bodies(vector)[0]

    def edges_of_bodies(self, vector: Array) -> list[Array]:
        """Points with bodies nearest to one without, ``(p,)`` each.

        On the way back to nominal, where bodies are those of the model, go all parameters of effects on bodies, or
        their shapes alone (a mass nearer to the rest), or all but the shapes (less mass in the same place).
        """
        found = []
        for moved in (self.of_bodies, self.of_bodies & self._shapes, self.of_bodies & ~self._shapes):
            start = np.where(moved, self.nominal, vector)
            if not self.has_bodies(start):
                continue
            low, high = 0.0, 1.0
            while high - low > EDGE_TOLERANCE:
                middle = 0.5 * (low + high)
                low, high = (middle, high) if self.has_bodies(start + middle * (vector - start)) else (low, middle)
            found.append(start + low * (vector - start))
        return found

    def at_edge_of_bodies(self, vector: Array) -> NDArray[np.bool_]:
        """Which parameters cannot be larger, all those of bodies together, because no body has them, ``(p,)``."""
        away = np.where(self.of_bodies, vector - self.nominal, 0.0)
        edge = not self.has_bodies(vector + EDGE_MARGIN * away)
        return np.asarray((away != 0.0) & edge)

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
    def seen(self) -> bool:
        """Whether some feature depends on some parameter here."""
        return any(np.any(jacobian) for jacobian in self.jacobians)

    @property
    def unseen(self) -> list[int]:
        """Parameters with zero sensitivity here, like the centre of a payload without mass."""
        zero = np.all([np.all(jacobian == 0.0, axis=0) for jacobian in self.jacobians], axis=0)
        return [int(index) for index in np.flatnonzero(zero)]

    def curved(self, index: int) -> bool:
        """Whether the valley of the error is curved along a parameter: its effect has several shapes without a grid.

        The length of a cable and the place of its end, for example, change the error together. The place of a payload
        does not: torques are linear in its mass and first moment, and steps of the fit lead to the bottom.
        """
        effect, part = next(item for item in self.parts if item[1].start <= index < item[1].stop)
        return (
            isinstance(effect, FormulaEffect)
            and sum(scalar.shape and not scalar.grid for scalar in self.scalars[part]) > 1
        )

    def probes(self, index: int) -> list[Array]:
        """Points over the range of one parameter, nearest first, ``(p,)`` each."""
        low, high = self.lower[index], self.upper[index]
        ends = [low, high, *np.clip(self.scalars[index].far, low, high)]
        here = self.point[index]
        values = {here + share * (end - here) for end in ends for share in PROBE_SHARES if end != here}
        points = []
        for value in sorted(values, key=lambda value: abs(value - here)):
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
        """Finite-difference steps, up to a bound under the physics at hand or away from it, ``(p,)``."""
        steps = np.concatenate([effect.steps(joints, self.point[part]) for effect, part in self.parts])
        room = np.clip(self.point + steps, self.lower, self.upper) - self.point
        steps = np.where(np.abs(room) < MIN_STEP_ROOM_SHARE * np.abs(steps), -steps, room)
        return np.array([self.step_with_bodies(self.point, index, step) for index, step in enumerate(steps.tolist())])

    def step_with_bodies(self, vector: Array, index: int, step: float) -> float:
        """A step of one parameter from a point; backwards or shorter where it leaves no bodies."""
        if not self.of_bodies[index]:
            return step
        alone = step * (np.arange(vector.size) == index)
        return step * next((share for share in DIFFERENCE_STEP_FACTORS if self.has_bodies(vector + share * alone)), 1.0)

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
        kept = [number for number, effect in enumerate(self.effects) if effect.name != name]
        keep = np.setdiff1d(np.arange(self.point.size), np.arange(part.start, part.stop))
        return replace(
            self,
            effects=tuple(self.effects[number] for number in kept),
            sizes=tuple(self.sizes[number] for number in kept),
            scalars=tuple(self.scalars[index] for index in keep),
            lower=self.lower[keep],
            upper=self.upper[keep],
            point=self.point[keep],
            jacobians=tuple(jacobian[:, keep] for jacobian in self.jacobians),
            of_bodies=self.of_bodies[keep],
        )

    def fixed(self, *indices: int) -> Candidate:
        """The candidate with some parameters fixed at nominal, to first order."""
        chosen = list(indices)
        off = ((self.nominal - self.point) / self.scale)[chosen]
        frozen = []
        for jacobian in self.jacobians:
            copy = jacobian.copy()
            copy[:, chosen] = 0.0
            frozen.append(copy)
        offsets = tuple(
            offset + jacobian[:, chosen] @ off for offset, jacobian in zip(self.offsets, self.jacobians, strict=True)
        )
        return replace(self, offsets=offsets, jacobians=tuple(frozen))

    def widened(self, at: NDArray[np.bool_], source: Source) -> Candidate | None:
        """The candidate with wider ranges for effects with a parameter at a bound; None if physics sets the bounds.

        Args:
            at: Whether a parameter is at a bound, ``(p,)``.
            source: Knows the bounds of physics.
        """
        effects = tuple(
            effect.with_parameters(Parameter.widened) if np.any(at[part]) else effect for effect, part in self.parts
        )
        wider = Candidate.of(effects, source)
        if np.all((wider.lower == self.lower)[at] & (wider.upper == self.upper)[at]):
            return None
        return replace(self, effects=effects, scalars=wider.scalars, lower=wider.lower, upper=wider.upper)

    def split(self, vector: Array) -> Added:
        """Effect names with their parameter values; effects at nominal are left out, so that replays are shared."""
        return tuple(
            (effect.name, tuple(float(value) for value in vector[part]))
            for effect, part in self.parts
            if np.any(((vector != self.nominal) & ~self._shapes)[part])
        )

    def beside(self, other: Candidate) -> Candidate:
        """Both together, each with its own linearisation: exact for small effects, a start for large ones."""
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
            of_bodies=np.concatenate((self.of_bodies, other.of_bodies)),
            worlds=self.worlds or other.worlds,
        )


def wanted(candidate: Candidate, numbers: Sequence[int], source: Source, share: float = 1.0) -> list[tuple[int, Added]]:
    """Predictions that :func:`linearise` needs, listed so that those of many effects run in one batch."""
    at_nominal = not candidate.origin and bool(np.all(candidate.point == candidate.nominal))
    here, steps = candidate.split(candidate.point), candidate.steps(source.joints)
    moved = [candidate.split(candidate.point + share * row) for row in np.diag(steps)]
    result: list[tuple[int, Added]] = []
    for number in numbers:
        result.append((number, candidate.origin))
        if not at_nominal:
            result.append((number, here))
        for effect, part in candidate.parts:
            if concerns(effect, source.clusters[number]):
                result += [(number, added) for added in moved[part]]
    return result


def linearise(
    candidate: Candidate,
    clusters: Sequence[Cluster],
    numbers: Sequence[int],
    source: Source,
    what: str = "sensitivities",
    share: float = 1.0,
) -> Candidate | None:
    """Sensitivities about the candidate's point by finite differences; None if a replay has no contact.

    Args:
        candidate: Effects and point.
        clusters: Evidence, with the scale of the features.
        numbers: Numbers of these clusters in the source.
        source: Predicts the features.
        what: Purpose, shown as progress.
        share: Of the steps of the parameters. Whole steps see past joints and contacts that stick; near an optimum
            they mislead where features bend.
    """
    at_nominal = not candidate.origin and bool(np.all(candidate.point == candidate.nominal))
    steps = candidate.steps(source.joints)
    results = iter(source.predict(wanted(candidate, numbers, source, share), what))
    offsets, jacobians = [], []
    for item in clusters:
        base = next(results)
        here = base if at_nominal else next(results)
        if base is None or here is None:
            return None
        jacobian = np.zeros((base.size, candidate.point.size))
        for effect, part in candidate.parts:
            if not concerns(effect, item):
                continue
            for index in range(part.start, part.stop):
                there = next(results)
                if there is None:
                    return None
                jacobian[:, index] = (there - here) / item.sigma * candidate.scale[index] / (share * steps[index])
        offsets.append((here - base) / item.sigma)
        jacobians.append(jacobian)
    return replace(candidate, offsets=tuple(offsets), jacobians=tuple(jacobians), share=share)


class Problem:
    """The least-squares problem of a candidate, ready to leave clusters out.

    Args:
        candidate: Effects with sensitivities.
        clusters: Residuals, in the same order.
        neighbours: Per cluster, neighbours left out of the fit together with it, but not counted in its held-out error.
        noise_unknown: Whether residuals are scaled by what the model leaves, as without repeats: what a fit leaves is
            then the noise, beside which the prior is weighed. Else it would pull the estimates of a light arm, whose
            parameter scales are small, to their nominal values.
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
        self._powers = np.array([target @ target / target.size for target in self.targets])
        scale = candidate.scale
        self._lower = (candidate.lower - candidate.point) / scale
        self._upper = np.maximum((candidate.upper - candidate.point) / scale, self._lower + MIN_BOUND_GAP)
        self._nominal = (candidate.nominal - candidate.point) / scale
        self._weigh_prior(1.0)
        if noise_unknown:
            self._weigh_prior(float(np.clip(self.error(self.solve()), MIN_NOISE_VARIANCE, 1.0)))

    def _weigh_prior(self, noise: float) -> None:
        """Weigh the prior as beside residuals of a mean square, scaled like the clusters [-].

        Where the noise is not known, residuals are scaled by what the model leaves. A prior that is weak beside that is
        strong beside a better model.
        """
        self._prior = noise / np.square(self.candidate.prior)
        self.total = self.information.sum(axis=0) + np.diag(self._prior)
        self._total_score = self.scores.sum(axis=0) + self._nominal * self._prior

    def solve(self, without: Sequence[int] = (), within: float = np.inf) -> Array:
        """Change from the candidate's point in parameter scales, ``(p,)``.

        Args:
            without: Clusters that are left out.
            within: Largest change of a parameter, in scales.
        """
        information, score = self.total, self._total_score
        if len(without) > 0:
            chosen = list(without)
            information = information - self.information[chosen].sum(axis=0)
            score = score - self.scores[chosen].sum(axis=0)
        lower, upper = np.clip(self._lower, -within, within), np.clip(self._upper, -within, within)
        upper = np.maximum(upper, lower + MIN_BOUND_GAP)
        return self._with_bodies(bounded(information, score, lower, upper), information, score, lower, upper)

    def _with_bodies(self, change: Array, information: Array, score: Array, lower: Array, upper: Array) -> Array:
        """A change that leaves rigid bodies: at the edge of their set, with all other parameters solved for there."""
        candidate = self.candidate
        wanted = candidate.point + change * candidate.scale
        if candidate.has_bodies(wanted):
            return change
        held, found = candidate.of_bodies, []
        for edge in candidate.edges_of_bodies(wanted):
            ends = (edge - candidate.point) / candidate.scale
            found.append(
                bounded(information, score, np.where(held, ends, lower), np.where(held, ends + MIN_BOUND_GAP, upper))
            )
        return min(found, key=lambda one: 0.5 * one @ information @ one - score @ one, default=np.zeros_like(change))

    def errors(self, change: Array) -> Array:
        """Mean square scaled error per cluster, ``(c,)`` [-], at a change from the point, ``(p,)`` or ``(c, p)``."""
        gains = np.sum((2.0 * self.scores - (self.information @ change[..., None])[..., 0]) * change, axis=-1)
        return np.maximum(self._powers - gains / self._counts, 0.0)

    def error(self, change: Array) -> float:
        """What :meth:`solve` makes least, at a change from the point ``(p,)``: the mean square over all measurements.

            sum_c n_c |r_c|^2 / sum_c n_c F_c

        A condition counts by its repeats n_c and features F_c; the prior is left out.
        """
        return float(self._counts @ self.errors(change)) / float(self._counts.sum())

    def rest(self, change: Array) -> list[Array]:
        """Mean residuals after a change from the point, ``(F,)`` per cluster [-]."""
        return [t - j @ change for t, j in zip(self.targets, self.candidate.jacobians, strict=True)]

    @cached_property
    def left_out_rest(self) -> list[Array]:
        """Mean residuals of every cluster after the fit to all others, ``(F,)`` per cluster [-]."""
        return [
            target - jacobian @ change
            for target, jacobian, change in zip(self.targets, self.candidate.jacobians, self.left_out, strict=True)
        ]

    @cached_property
    def left_out(self) -> Array:
        """Estimates without one cluster each, as changes in parameter scales, ``(c, p)``."""
        neighbours = self._neighbours or [()] * len(self.clusters)
        return self._solved_without([[c, *neighbours[c]] for c in range(len(self.clusters))])

    def _solved_without(self, left_out: Sequence[Sequence[int]]) -> Array:
        """:meth:`solve` without some clusters, for every such choice, ``(k, p)``; most ends lie within the bounds."""
        informations = np.array([self.total - self.information[chosen].sum(axis=0) for chosen in left_out])
        scores = np.array([self._total_score - self.scores[chosen].sum(axis=0) for chosen in left_out])
        changes = bounded(informations, scores, self._lower, self._upper)
        candidate, held = self.candidate, self.candidate.of_bodies
        if not np.any(held):
            return changes
        whole = self.solve()
        for number, change in enumerate(changes):
            if not candidate.has_bodies(candidate.point + change * candidate.scale):  # as in the fit to all clusters
                lower, upper = np.where(held, whole, self._lower), np.where(held, whole + MIN_BOUND_GAP, self._upper)
                changes[number] = bounded(informations[number], scores[number], lower, upper)
        return changes

    @cached_property
    def held_out(self) -> Array:
        """Mean square scaled error of every cluster, predicted from all others, ``(c,)`` [-]."""
        return self.errors(self.left_out)

    def jackknife(self) -> Array:
        """Standard errors from leaving one cluster out, in parameter scales, ``(p,)``."""
        count = len(self.clusters)
        alone = self._solved_without([[c] for c in range(count)]) if self._neighbours else self.left_out
        spread = np.square(alone - alone.mean(axis=0)).sum(axis=0)
        return np.asarray(np.sqrt((count - 1) / count * spread))

    def half_widths(self, change: Array, null: NullDistribution, confidence: float = 0.95) -> Array:
        """Half widths of intervals in parameter scales, ``(p,)``.

        The prior pulls what the data do not determine to its nominal value; for parameters that vary as much as the
        prior allows, with the covariance S, the error of this has the covariance A^-1 P S P A^-1, with A all
        information and P that of the prior.
        """
        noise, jackknife, systematic, freedom = self._errors(change, null)
        clusters: float | Array = sum(bool(np.any(jacobian)) for jacobian in self.candidate.jacobians)
        return combined_half_width(
            noise,
            scipy.stats.t.ppf(0.5 + confidence / 2.0, freedom),
            jackknife,
            np.minimum(clusters, freedom + 1.0) if null.by_blocks else clusters,
            systematic,
            confidence,
        )

    def p_by_interval(self, change: Array, null: NullDistribution, index: int) -> float:
        """p-value of one parameter being nominal, by the error that its interval has; without calibrations.

        Flipped signs of blocks decide nothing where few of them see a parameter, however well these determine it.
        """
        noise, jackknife, systematic, freedom = (part[index] for part in self._errors(change, null))
        error = math.hypot(max(noise, jackknife), systematic)
        distance = abs(float(change[index] - self._nominal[index]))
        return float(2.0 * scipy.stats.t.sf(distance / max(error, 1e-300), freedom))

    def _errors(self, change: Array, null: NullDistribution) -> tuple[Array, Array, Array, Array]:
        """Standard errors from noise, from the clusters, and from discrepancy and prior; degrees of freedom, ``(p,)``.

        See :meth:`half_widths`.
        """
        inverse = np.linalg.inv(self.total)
        jacobians = self.candidate.jacobians
        noise = null.covariance(jacobians, self.rest(change), inverse)
        pulled = inverse @ (np.square(self.candidate.prior * self._prior)[:, None] * inverse)
        systematic = null.discrepancy(jacobians, inverse) + pulled
        from_noise, from_others = (np.sqrt(np.maximum(np.diag(part), 0.0)) for part in (noise, systematic))
        return from_noise, self.jackknife(), from_others, null.freedoms(jacobians, inverse)

    def moved_by_calibrations(self) -> Array:
        """Standard errors of the estimate from calibrations that all clusters share, ``(p,)``.

        A calibration that an effect of the candidate stands for, such as the gain of a torque, is fitted and adds none.
        """
        pairs = [
            (np.sqrt(item.count) * item.calibrations, np.sqrt(item.count) * jacobian)
            for item, jacobian in zip(self.clusters, self.candidate.jacobians, strict=True)
            if item.calibrations is not None
        ]
        if not pairs:
            return np.zeros(self.total.shape[0])
        scores = np.sum([rows @ jacobian for rows, jacobian in pairs], axis=0)
        changes = np.linalg.solve(self.total, scores.T).T
        rests = [(rows, rows - changes @ jacobian.T) for rows, jacobian in pairs]
        whole, left = np.sum([[np.sum(np.square(part), axis=1) for part in both] for both in rests], axis=0)
        changes[left < MIN_UNFITTED_SHARE * whole] = 0.0
        return np.asarray(np.sqrt(np.sum(np.square(changes), axis=0)))

    def p_value(self, null: NullDistribution, tested: slice | Sequence[int]) -> float:
        """p-value of some parameters being nominal while all others of the candidate are fitted (score test).

        Args:
            null: From the residuals of the best fit without the tested parameters, or of the model itself if
                nothing else is fitted.
            tested: Indices of the tested parameters.
        """
        indices = np.arange(self.total.shape[0])
        picked = indices[tested] if isinstance(tested, slice) else np.asarray(tested)
        others = np.setdiff1d(indices, picked)
        return null.p_value(
            [jacobian[:, picked] for jacobian in self.candidate.jacobians],
            [jacobian[:, others] for jacobian in self.candidate.jacobians],
        )


def bounded(information: Array, score: Array, lower: Array, upper: Array) -> Array:
    """Minimise ``b^T information b / 2 - score^T b`` within bounds; of several problems, ``(k, p)``, every one.

    By the primal-dual active set method (Hintermüller, Ito and Kunisch 2002): entries at a bound stay there as long as
    their multipliers keep them. Its few problems that do not settle are left to :func:`scipy.optimize.lsq_linear`.
    """
    change = np.linalg.solve(information, score[..., None])[..., 0]
    matrices = information.reshape(-1, *information.shape[-2:])
    scores, found = np.atleast_2d(score), np.atleast_2d(change)
    low, high = found < lower - 1e-12, found > upper + 1e-12
    left = np.flatnonzero(np.any(low | high, axis=-1))
    for _ in range(MAX_ACTIVE_SETS):
        if left.size == 0:
            break
        held = low[left] | high[left]
        matrix = np.where(held[..., None], np.eye(held.shape[-1]), matrices[left])
        ends = np.where(low[left], lower, np.where(high[left], upper, scores[left]))
        found[left] = np.linalg.solve(matrix, ends[..., None])[..., 0]
        pull = scores[left] - (matrices[left] @ found[left][..., None])[..., 0]
        lower_now = np.where(low[left], pull <= 0.0, found[left] < lower - 1e-12)
        upper_now = np.where(high[left], pull >= 0.0, found[left] > upper + 1e-12)
        moved = np.any((lower_now != low[left]) | (upper_now != high[left]), axis=-1)
        low[left], high[left] = lower_now, upper_now
        left = left[moved]
    for place in left:
        root = np.linalg.cholesky(matrices[place]).T
        target = np.linalg.solve(root.T, scores[place])
        found[place] = scipy.optimize.lsq_linear(root, target, bounds=(lower, upper), method="bvls").x
    return np.clip(found, lower, upper).reshape(score.shape)
