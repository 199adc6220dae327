# SPDX-License-Identifier: Apache-2.0
"""Null distributions of score statistics: rotation tests with repeats, sign flips of blocks without.

An effect with sensitivities J_c in cluster c is judged by its total score and that score's size in the metric of the
information matrix, with W the inverse squared scales of the features:

    s = sum_c n_c J_c^T W rbar_c,        M = sum_c n_c J_c^T W J_c,        T = s^T M^-1 s

the part of the squared residual that it explains. With parameters that were fitted before, T is the increase by the
tested ones. Two tests give the distribution of T under noise alone.

**Repeats** (:class:`RotationNull`). Repeats of a condition are written as a mean row sqrt(n_c) rbar_c and n_c - 1
orthonormal contrasts; if nothing is missing, all N rows of a layout are independent draws of one normal distribution,
whatever its covariance. Given their Gram matrix, every rotation of them is then equally likely (Langsrud 2005,
*Rotation tests*, Statistics and Computing 15; Solari, Finos and Goeman 2014, *Rotation-based multiple testing in the
multivariate linear model*, Biometrics 70). The share of rotations with a T at least as large as the measured one is an
exact p-value for any number of features and repeats, if all that enters T comes from the rotated rows. That includes
the scales. The pure error of few repeats is uncertain: features whose contrasts happen to be small count much in the
measurement, and if they counted as much in every rotation, noise would be significant (3 conditions with 2 repeats:
p < 1 % in 11 to 31 % of all campaigns). So the variance is estimated anew from the contrasts of every rotation,

    1 / W_f = (d_0 v_g + d v_f) / (d_0 + d) + (relevance limit / 2)^2 + discrepancy^2

with v_f the variance of feature f by d contrasts, v_g its mean over the time bins of the signal, and d_0 =
``PRIOR_DEGREES_OF_FREEDOM``: the moderated variance of Smyth (2004, *Linear models and empirical Bayes methods*,
Statistical Applications in Genetics 3), in rotations as in Wu et al. (2010, *ROAST: rotation gene set tests*,
Bioinformatics 26). Where a layout has fewer than ``MIN_DEGREES_OF_FREEDOM`` contrasts, v_g is the mean over all layouts
with the signal. By itself it would have the tails of Student's t with one or two degrees of freedom, in which 300 times
the noise is not rare.
With a single feature and condition the test is Student's t with n - 1 degrees of freedom. Heavy tails make it
conservative rather than wrong: an outlier of one repeat is in the mean row and in the contrasts of its condition.

Where the model discrepancy is known, residuals have a second source: sum_k a_k P_k, with patterns P_k in which
simulators differ and a_k standard normal, the same in all clusters of one kind. Patterns are used instead of single
features because simulators differ in friction or stiffness of a contact, which changes many features at once. T is then
also compared with draws of noise (normal, with the contrasts' covariance and its Student factor) plus discrepancy, and
the larger p-value counts.

**Blocks** (:class:`SignFlipNull`). A recording has no repeats. Stretches longer than the correlation time of its
noise are independent, and their scores are about symmetric: signs are flipped at random (wild cluster bootstrap of the
score, Cameron, Gelbach and Miller 2008, Review of Economics and Statistics 90). Their scale is that of all residuals
of a signal, which no flip changes.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache, reduce

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.thresholds import (
    INDEPENDENT_DISCREPANCY_SHARE,
    MIN_BLOCKS,
    MIN_DEGREES_OF_FREEDOM,
    NULL_DRAWS,
    PRIOR_DEGREES_OF_FREEDOM,
)
from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_sim.robots.robot import Array

FIRST_DRAWS = 999  # of the test of lack of fit
MIN_P_OF_FIRST_DRAWS = 0.05  # above, the first draws are enough
RIDGE = 1e-12  # of the trace; keeps a covariance of rank zero invertible
MANY_SIGN_DRAWS = 49999  # where fewer draws have less than MIN_EXCEEDANCES beyond the observation
MIN_EXCEEDANCES = 10  # draws beyond an observation; with fewer, the Pareto tail gives its p-value
TAIL_DRAWS = 250  # largest draws that the Pareto tail is fitted to (Knijnenburg et al. 2009)
MIN_TAIL_SHAPE = 1e-3  # of the generalised Pareto distribution: exponential, without an end
MIN_SPANNED_SHARE = 0.999  # of the total square of the discrepancy patterns; the rest is rounding


class NullDistribution(ABC):
    """Distribution of statistics under noise (and model discrepancy) alone.

    Args:
        clusters: Residuals of the tested model.

    Attributes:
        by_blocks: Whether clusters are blocks without repeats, whose scatter estimates the noise.
    """

    by_blocks = False

    def __init__(self, clusters: Sequence[Cluster]) -> None:
        self.clusters = tuple(clusters)

    @property
    @abstractmethod
    def freedom(self) -> int:
        """Degrees of freedom of the noise."""

    @property
    @abstractmethod
    def shortage(self) -> str | None:
        """Additional data that a verdict needs, for the user; None if there are enough."""

    def p_value(self, jacobians: Sequence[Array], fitted: Sequence[Array] = ()) -> float:
        """p-value of an effect being absent.

        Args:
            jacobians: Sensitivities by cluster, ``(F, p)`` each.
            fitted: Sensitivities by cluster of the nuisance parameters, already fitted, ``(F, p0)`` each.
        """
        return self.p_values([jacobians], fitted)[0]

    @abstractmethod
    def p_values(self, effects: Sequence[Sequence[Array]], fitted: Sequence[Array] = ()) -> list[float]:
        """:meth:`p_value` of several effects, each tested alone given the fitted parameters."""

    @abstractmethod
    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """p-value of the lack-of-fit test of mean residuals ``(F,)`` by cluster; None without repeats."""

    @abstractmethod
    def covariance(self, jacobians: Sequence[Array], rest: Sequence[Array], inverse: Array) -> Array:
        """Covariance of an estimate due to noise (sandwich), ``(p, p)``.

        Args:
            jacobians: Sensitivities by cluster, ``(F, p)`` each.
            rest: Mean residuals of the fit by cluster, ``(F,)`` each.
            inverse: Inverse of the information, ``(p, p)``.
        """

    def discrepancy(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """Covariance of an estimate due to model discrepancy, ``(p, p)``."""
        factor = self._discrepancy_scores(jacobians) @ inverse
        return np.asarray(factor.T @ factor)

    def _discrepancy_scores(self, jacobians: Sequence[Array]) -> Array:
        """Score of every discrepancy pattern at amplitude 1, over the clusters that share the amplitude, ``(k, p)``."""
        total: dict[str, Array] = {}
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            part = item.count * item.discrepancy_factor @ jacobian
            name = item.discrepancy_group
            total[name] = total[name] + part if name in total else part
        return np.concatenate([part[np.any(part != 0.0, axis=1)] for part in total.values()])

    @cached_property
    def discrepant(self) -> bool:
        """Whether a model discrepancy is known."""
        return any(np.any(item.discrepancy > 0.0) for item in self.clusters)

    def quantile(self, confidence: float = 0.95) -> float:
        """Quantile of Student's t: half width of an interval in standard errors of :meth:`covariance`."""
        return float(scipy.stats.t.ppf(0.5 + confidence / 2.0, max(self.freedom, 1)))

    def freedoms(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """Degrees of freedom of the standard errors of :meth:`covariance`, ``(p,)``."""
        del jacobians
        return np.full(inverse.shape[0], float(max(self.freedom, 1)))


def _whitened(clusters: Sequence[Cluster], jacobians: Sequence[Array], fitted: Sequence[Array]) -> list[Array] | None:
    """Sensitivities orthogonal to the fitted ones and whitened (M = 1), ``(F, p)``; None if none is left."""
    whole = sum(float(np.sum(np.square(j))) for j in jacobians)
    if fitted and fitted[0].shape[1]:
        roots = [np.sqrt(item.count) for item in clusters]
        others, own = (np.vstack([r * j for r, j in zip(roots, some, strict=True)]) for some in (fitted, jacobians))
        share = np.linalg.lstsq(others, own, rcond=None)[0]
        jacobians = [j - other @ share for j, other in zip(jacobians, fitted, strict=True)]
    information = np.sum([item.count * j.T @ j for item, j in zip(clusters, jacobians, strict=True)], axis=0)
    size = float(np.trace(information))
    if size <= RIDGE * whole:
        return None
    root = np.linalg.inv(np.linalg.cholesky(information + RIDGE * size * np.eye(len(information)))).T
    return [j @ root for j in jacobians]


def _score_statistic(scores: Array, information: Array) -> Array:
    """Score statistic T of every draw, ``(B,)``, from scores ``(B, p)`` and information M ``(B, p, p)``."""
    size = np.sqrt(np.maximum(np.einsum("pp->p", information[0]), 0.0))
    size[size == 0.0] = 1.0
    scores, information = scores / size, information / np.outer(size, size) + RIDGE * np.eye(len(size))
    return np.asarray(np.einsum("bp,bp->b", scores, np.linalg.solve(information, scores[..., None])[..., 0]))


def monte_carlo_p_value(observed: float, null: Array) -> float:
    """Monte Carlo p-value (1 + exceedances) / (1 + draws), the observation being one of the draws."""
    return float((1.0 + _exceedances(observed, null)) / (1.0 + null.size))


def p_value_with_pareto_tail(observed: float, null: Array) -> float:
    """Monte Carlo p-value of a continuous statistic, with a generalised Pareto tail beyond nearly all draws.

    The tail has the probability-weighted moments of the largest draws (Knijnenburg et al. 2009, *Fewer permutations,
    more accurate P-values*, Bioinformatics 25; Hosking and Wallis 1987) and no upper end. It resolves p-values below
    one over the number of draws, which the adjustment for many tests needs.
    """
    share = monte_carlo_p_value(observed, null)
    if _exceedances(observed, null) >= MIN_EXCEEDANCES or null.size < 2 * TAIL_DRAWS:
        return share
    largest = np.sort(null)[-TAIL_DRAWS - 1 :]
    excess = largest[1:] - largest[0]
    mean = float(excess.mean())
    weights = 1.0 - (np.arange(1, TAIL_DRAWS + 1) - 0.35) / TAIL_DRAWS
    weighted = float(np.mean(weights * excess))
    if not 0.0 < 2.0 * weighted < mean:
        return share
    shape = max(2.0 - mean / (mean - 2.0 * weighted), MIN_TAIL_SHAPE)
    scale = mean * (1.0 - shape)
    tail = (1.0 + shape * (observed - float(largest[0])) / scale) ** (-1.0 / shape)
    return float(min(TAIL_DRAWS / null.size * tail, share))


def _exceedances(observed: float, null: Array) -> int:
    """Number of draws at least as large as the observation."""
    return int(np.count_nonzero(null >= observed * (1.0 - 1e-12)))


def westfall_young_p_value(observed: Array, null: Array) -> float:
    """Family-wise p-value: the smallest p-value of several statistics against its null (Westfall and Young 1993).

    Args:
        observed: Statistics, ``(G,)``.
        null: Statistics in draws of the null distribution, ``(B, G)``; columns that are never above zero are ignored.
    """
    everything = np.vstack((observed, null))
    below = scipy.stats.rankdata(-everything, method="max", axis=0)  # number of draws at least as large
    below[:, ~np.any(everything > 0.0, axis=0)] = len(everything)
    least = below.min(axis=1)
    return float(np.count_nonzero(least <= least[0]) / least.size)


def _members(item: Cluster, groups: Sequence[tuple[str, str]]) -> NDArray[np.bool_]:
    """Membership of features in groups, of which the last holds all, ``(G + 1, F)``."""
    own = [[feature.group[:2] == group for feature in item.features] for group in groups]
    return np.array([*own, [True] * len(item.features)])


@lru_cache(maxsize=32)
def _rotations(rows: int, count: int, seed: int) -> Array:
    """First ``count`` rows of the identity and of Haar-distributed rotations, ``(1 + B, count, rows)``."""
    rng = np.random.default_rng([seed, rows, count])
    basis, upper = np.linalg.qr(rng.standard_normal((NULL_DRAWS, rows, count)))
    drawn = np.swapaxes(basis * np.sign(np.einsum("bii->bi", upper))[:, None, :], 1, 2)
    return np.concatenate((np.eye(rows)[None, :count], drawn))


class _Rows:
    """Rows of the clusters of one layout: first the means, then the contrasts.

    Attributes:
        numbers: Indices of the clusters among all.
        items: The clusters.
        rows: Means and contrasts, ``(N, F)``, in multiples of ``unit``.
        unit: Unit of the features, ``(F,)``: the scale of the first cluster.
        means: Number of means.
        freedom: Number of contrasts.
        donors: Layouts whose contrasts give the mean variance of a signal: its own, or all if it has few.
        apart: Known variance (relevance limit and discrepancy), ``(F,)`` in squares of ``unit``.
        spanned: Left and right factor of the projector on the removed patterns, ``(k, F)`` each; None: none removed.
    """

    def __init__(self, numbers: list[int], clusters: Sequence[Cluster], means: Sequence[Array]) -> None:
        self.numbers, self.items = numbers, [clusters[number] for number in numbers]
        self.unit = self.items[0].sigma
        firsts: list[Array] = []
        contrasts: list[Array] = []
        for number, item in zip(numbers, self.items, strict=True):
            scale = item.sigma / self.unit
            firsts.append(np.sqrt(item.count) * means[number] * scale)
            contrasts.extend((scipy.linalg.helmert(item.count) @ item.residuals) * scale)
        self.rows = np.array(firsts + contrasts)
        self.means, self.freedom = len(firsts), len(contrasts)
        self.donors: Sequence[_Rows] = (self,)
        apart = [np.square(item.sigma / self.unit) * (1.0 - np.square(item.pure_error)) for item in self.items]
        self.apart = np.maximum(np.mean(apart, axis=0), 0.0)
        self.spanned: tuple[Array, Array] | None = None

    def rotated(self, seed: int, draws: slice = slice(None)) -> Iterator[Array]:
        """Every mean row, as measured and in rotations, ``(1 + B, F)`` each."""
        frames = _rotations(len(self.rows), self.means, seed)[draws]
        return (frames[:, number] @ self.rows for number in range(self.means))

    def squares(self, seed: int, draws: slice = slice(None), added: Sequence[Array] | None = None) -> Array:
        """Sum of squares of the :meth:`rotated` mean rows, ``(1 + B, F)``, after adding ``added`` to each of them."""
        rows = self.rotated(seed, draws)
        return reduce(np.add, map(np.square, rows if added is None else map(np.add, rows, added)))

    def orthogonal_to_patterns(self) -> _Rows:
        """The rows projected on the orthogonal complement of the discrepancy patterns; rotations stay exchangeable.

        The metric is that of relevance limits and discrepancies, which do not depend on the repeats. Patterns of a
        single feature are kept: no joint direction of the simulators is known (:meth:`independent_discrepancy`).
        """
        patterns = np.vstack([item.discrepancy_factor * (item.sigma / self.unit) for item in self.items])
        patterns = patterns[np.count_nonzero(patterns, axis=1) > 1]
        if not len(patterns):
            return self
        scale = np.sqrt(np.where(self.apart > 0.0, self.apart, 1.0))
        _, sizes, directions = np.linalg.svd(patterns / scale, full_matrices=False)
        known = directions[
            : 1 + int(np.searchsorted(np.cumsum(np.square(sizes)), MIN_SPANNED_SHARE * np.sum(np.square(sizes))))
        ]
        found = copy.copy(self)
        found.spanned = known / scale, known * scale
        found.rows = found.orthogonal(self.rows)
        share = np.mean([np.square(item.discrepancy * item.sigma / self.unit) for item in self.items], axis=0)
        found.apart = np.maximum(
            self.apart - (1.0 - INDEPENDENT_DISCREPANCY_SHARE) * share * np.any(patterns, axis=0), 0.0
        )
        return found

    def orthogonal(self, rows: Array) -> Array:
        """Rows ``(n, F)`` without their component along the discrepancy patterns."""
        return rows if self.spanned is None else np.asarray(rows - (rows @ self.spanned[0].T) @ self.spanned[1])

    def independent_discrepancy(self, seed: int, draws: int) -> Sequence[Array] | None:
        """Draws of the discrepancy outside the measured patterns, by mean row; 0 for the measurement, ``(1 + B, F)``.

        None where no discrepancy is known. Clusters of one discrepancy group share the draw.
        """
        if not any(np.any(item.discrepancy) for item in self.items):
            return None
        rng, drawn, found = np.random.default_rng([4, seed]), {}, []
        for item in self.items:
            own = item.discrepancy_factor
            single = np.count_nonzero(own, axis=1) <= 1
            shares = INDEPENDENT_DISCREPANCY_SHARE * np.square(own[~single]).sum(axis=0) + np.square(own[single]).sum(
                axis=0
            )
            size = np.sqrt(shares) * item.sigma / self.unit
            if item.discrepancy_group not in drawn:
                amplitudes = self.orthogonal(rng.standard_normal((draws, size.size)) * size)
                drawn[item.discrepancy_group] = np.vstack((np.zeros(size.size), amplitudes))
            found.append(np.sqrt(item.count) * drawn[item.discrepancy_group])
        return found

    @cached_property
    def noise(self) -> Array:
        """Contrasts; for a layout with few of them also normal draws with the borrowed variance, ``(m, F)``."""
        own = self.rows[self.means :]
        if not self.borrows:
            return own
        drawn = np.random.default_rng(3).standard_normal((PRIOR_DEGREES_OF_FREEDOM, self.unit.size))
        squares = [np.sum(np.square(each.rows[each.means :]), axis=0)[None] for each in self.donors]
        shared = _shared(self, self.donors, squares)
        return np.vstack((own, np.sqrt(shared[0]) * drawn))

    @property
    def borrows(self) -> bool:
        """Whether its contrasts are too few for the size of the noise."""
        return self.freedom < MIN_DEGREES_OF_FREEDOM and len(self.donors) > 1

    def left(self, squares: Array) -> Array:
        """Sum of squares of the contrasts in every rotation, from that of the mean rows, ``(1 + B, F)``."""
        return np.maximum(np.sum(np.square(self.rows), axis=0) - squares, 0.0)

    def signals_of(self, keys: Sequence[tuple[str, str, str]]) -> Array:
        """Indicator matrix of features in signals, ``(F, S)``."""
        place = {key: number for number, key in enumerate(keys)}
        member = np.zeros((self.unit.size, len(keys)))
        for number, feature in enumerate(self.items[0].features):
            if feature.group in place:
                member[number, place[feature.group]] = 1.0
        return member

    def products(self, jacobians: Sequence[Array]) -> Array:
        """Score of every noise row with the sensitivity of every mean, ``(means, m, p)``."""
        return np.array(
            [
                np.sqrt(item.count) * (self.noise @ (jacobians[n] * (self.unit / item.sigma)[:, None]))
                for n, item in zip(self.numbers, self.items, strict=True)
            ]
        )


def _with_donors(layouts: list[_Rows]) -> list[_Rows]:
    """The layouts; those with few contrasts borrow the mean variance of a signal from all."""
    for own in layouts:
        own.donors = layouts if own.freedom < MIN_DEGREES_OF_FREEDOM else (own,)
    return layouts


def _shared(layout: _Rows, donors: Sequence[_Rows], left: Sequence[Array]) -> Array:
    """Mean variance of the signals of a layout in every rotation, ``(1 + B, F)`` in its unit, from donors' contrasts.

    The mean over the bins of a signal is taken in physical units, because ``unit`` depends on the contrasts.
    """
    keys = list(dict.fromkeys(feature.group for feature in layout.items[0].features))
    members = [donor.signals_of(keys) for donor in donors]
    total = sum((each * np.square(own.unit)) @ m for each, own, m in zip(left, donors, members, strict=True))
    number = sum(own.freedom * m.sum(axis=0) for own, m in zip(donors, members, strict=True))
    place = np.argmax(layout.signals_of(keys), axis=1)
    return np.asarray((total / np.maximum(number, 1.0))[:, place] / np.square(layout.unit))


def _weights_of(layouts: Sequence[_Rows], squares: Sequence[Array]) -> Iterator[Array]:
    """Moderated weights W by layout in every rotation, from the squares of the mean rows, ``(1 + B, F)`` each."""
    left = {id(own): own.left(each) for own, each in zip(layouts, squares, strict=True)}
    for own in layouts:
        shared = _shared(own, own.donors, [left[id(donor)] for donor in own.donors])
        variance = (PRIOR_DEGREES_OF_FREEDOM * shared + left[id(own)]) / (PRIOR_DEGREES_OF_FREEDOM + own.freedom)
        yield np.asarray(1.0 / (variance + own.apart + RIDGE))


class RotationNull(NullDistribution):
    """Rotation test with repeats, see the module; arguments as for :class:`NullDistribution`."""

    @cached_property
    def _layouts(self) -> list[_Rows]:
        return self._rows([item.mean for item in self.clusters])

    def _rows(self, means: Sequence[Array]) -> list[_Rows]:
        """Rows of every layout, for some mean residuals."""
        numbers: dict[str, list[int]] = {}
        for number, item in enumerate(self.clusters):
            numbers.setdefault(item.layout, []).append(number)
        return _with_donors([_Rows(chosen, self.clusters, means) for chosen in numbers.values()])

    @cached_property
    def _scales(self) -> list[Array]:
        """W of every layout in all rotations, ``(1 + B, F)``."""
        return list(_weights_of(self._layouts, [own.squares(seed) for seed, own in enumerate(self._layouts)]))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the pure error: runs minus conditions."""
        return sum(item.count - 1 for item in self.clusters)

    @property
    def shortage(self) -> str | None:
        """See :attr:`NullDistribution.shortage`."""
        if self.freedom >= MIN_DEGREES_OF_FREEDOM:
            return None
        return (
            f"{MIN_DEGREES_OF_FREEDOM - self.freedom} more repeat(s) of any of the {len(self.clusters)} conditions "
            f"(runs minus conditions is {self.freedom}, at least {MIN_DEGREES_OF_FREEDOM} are needed)"
        )

    def p_values(self, effects: Sequence[Sequence[Array]], fitted: Sequence[Array] = ()) -> list[float]:
        """See :meth:`NullDistribution.p_values`; all effects share the rotations."""
        if self.shortage is not None or not effects:
            return [1.0] * len(effects)
        every = [
            [np.hstack(both) for both in zip(fitted, own, strict=True)] if fitted else list(own) for own in effects
        ]
        edges = np.cumsum([0, *(own[0].shape[1] for own in every)])
        scores = np.zeros((1 + NULL_DRAWS, edges[-1]))
        for seed, (layout, weights) in enumerate(zip(self._layouts, self._scales, strict=True)):
            for number, item, rows in zip(layout.numbers, layout.items, layout.rotated(seed), strict=True):
                columns = np.hstack([own[number] for own in every])
                scores += (rows * weights) @ (np.sqrt(item.count) * columns * (item.sigma / layout.unit)[:, None])
        return [
            self._p_value(jacobians, fitted, own, scores[:, first:last])
            for jacobians, own, first, last in zip(effects, every, edges[:-1], edges[1:], strict=True)
        ]

    def _p_value(
        self, jacobians: Sequence[Array], fitted: Sequence[Array], every: Sequence[Array], scores: Array
    ) -> float:
        """:meth:`p_value` from the scores of all its parameters in every rotation, ``(1 + B, p0 + p)``."""
        turned = _whitened(self.clusters, jacobians, fitted)
        if turned is None:
            return 1.0
        count = scores.shape[1]
        information = np.zeros((1 + NULL_DRAWS, count * count))
        for layout, weights in zip(self._layouts, self._scales, strict=True):
            pairs = np.zeros((len(layout.unit), count, count))
            for number, item in zip(layout.numbers, layout.items, strict=True):
                jacobian = np.sqrt(item.count) * every[number] * (item.sigma / layout.unit)[:, None]
                pairs += jacobian[:, :, None] * jacobian[:, None, :]
            information += weights @ pairs.reshape(len(pairs), -1)
        information = information.reshape(-1, count, count)
        explained = _score_statistic(scores, information)
        if fitted and (before := fitted[0].shape[1]):
            explained -= _score_statistic(scores[:, :before], information[:, :before, :before])
        p = p_value_with_pareto_tail(float(explained[0]), explained[1:])
        if self.discrepant:
            own = np.sum([j.T @ item.mean * item.count for j, item in zip(turned, self.clusters, strict=True)], axis=0)
            p = max(p, p_value_with_pareto_tail(float(own @ own), self._with_discrepancy(turned)))
        return p

    def _with_discrepancy(self, jacobians: Sequence[Array]) -> Array:
        """Parametric draws of T under noise and discrepancy, ``(B,)``, for :func:`_whitened` sensitivities."""
        weights, rng = self._weights[0], copy.deepcopy(self._weights[1])
        total = np.zeros((NULL_DRAWS, jacobians[0].shape[1]))
        for layout, own in zip(self._layouts, weights, strict=True):
            if own is not None:
                total += own @ layout.products(jacobians).reshape(-1, total.shape[1])
        shared = np.asarray(np.linalg.qr(self._discrepancy_scores(jacobians), mode="r"))
        total += rng.standard_normal((NULL_DRAWS, shared.shape[0])) @ shared
        return np.asarray(np.einsum("bp,bp->b", total, total))

    @cached_property
    def _weights(self) -> tuple[list[Array | None], np.random.Generator]:
        """:meth:`_noise` of every layout, ``(B, means * m)``, None without noise; and the generator."""
        rng = np.random.default_rng(1)
        return [
            self._noise(rng, own, NULL_DRAWS).reshape(NULL_DRAWS, -1) if len(own.noise) else None
            for own in self._layouts
        ], rng

    @staticmethod
    def _noise(rng: np.random.Generator, layout: _Rows, draws: int) -> Array:
        """Weights of the noise rows in draws of mean rows: multivariate t, ``(B, means, m)``."""
        count = len(layout.noise)
        weights = rng.standard_normal((draws, layout.means, count))
        return np.asarray(weights / np.sqrt(rng.chisquare(count, draws))[:, None, None])

    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """See :meth:`NullDistribution.lack_of_fit`; by the sum of squares orthogonal to the discrepancy patterns.

        A test of all features at once has little power against a misfit of one signal. So every signal is tested by
        itself as well as all together, and the smallest p-value is compared with the smallest in every rotation
        (Westfall and Young 1993, *Resampling-based multiple testing*). The family-wise level holds for any number of
        signals and any correlation between them.
        """
        if self.shortage is not None:
            return None
        p = self._lack_of_fit(rest, FIRST_DRAWS)
        return p if p > MIN_P_OF_FIRST_DRAWS else self._lack_of_fit(rest, NULL_DRAWS)

    def _lack_of_fit(self, rest: Sequence[Array], draws: int) -> float:
        """:meth:`lack_of_fit` from a number of rotations."""
        layouts = _with_donors([own.orthogonal_to_patterns() for own in self._rows(rest)])
        chosen = slice(1 + draws)
        every = [own.squares(seed, chosen) for seed, own in enumerate(layouts)]
        total = np.zeros((1 + draws, len(self._groups) + 1))
        for seed, (own, weights) in enumerate(zip(layouts, _weights_of(layouts, every), strict=True)):
            seen = own.squares(seed, chosen, own.independent_discrepancy(seed, draws))
            total += (seen * weights) @ _members(own.items[0], self._groups).T
        return westfall_young_p_value(total[0], total[1:])

    @cached_property
    def _groups(self) -> list[tuple[str, str]]:
        """Signals by phase, of all features."""
        return list(dict.fromkeys(feature.group[:2] for item in self.clusters for feature in item.features))

    def covariance(self, jacobians: Sequence[Array], rest: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; trials are independent of each other, their features are not."""
        del rest  # the scatter of repeats about their mean does not depend on the fit
        meat = np.zeros_like(inverse)
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            if item.count > 1:
                scores = (item.residuals - item.mean) @ jacobian * np.sqrt(item.count / (item.count - 1.0))
                meat += scores.T @ scores
        return np.asarray(inverse @ meat @ inverse)


@lru_cache(maxsize=4)  # one search asks for two
def _signs(draws: int, blocks: int) -> Array:
    """Signs of blocks in draws of the null distribution, ``(draws, blocks)``."""
    found = np.random.default_rng(0).choice([-1.0, 1.0], size=(draws, blocks))
    found.flags.writeable = False
    return found


class SignFlipNull(NullDistribution):
    """Sign-flip test of blocks without repeats, see the module; arguments as for :class:`NullDistribution`."""

    by_blocks = True

    @property
    def freedom(self) -> int:
        """Number of blocks minus one."""
        return len(self.clusters) - 1

    @property
    def shortage(self) -> str | None:
        """See :attr:`NullDistribution.shortage`."""
        if len(self.clusters) >= MIN_BLOCKS:
            return None
        return (
            f"{MIN_BLOCKS - len(self.clusters)} more stretches of motion or impacts: {len(self.clusters)} of "
            f"{MIN_BLOCKS} needed"
        )

    def p_values(self, effects: Sequence[Sequence[Array]], fitted: Sequence[Array] = ()) -> list[float]:
        """See :meth:`NullDistribution.p_values`."""
        return [self._p_value(jacobians, fitted) for jacobians in effects]

    def _p_value(self, jacobians: Sequence[Array], fitted: Sequence[Array]) -> float:
        """See :meth:`NullDistribution.p_value`."""
        turned = _whitened(self.clusters, jacobians, fitted)
        if self.shortage is not None or turned is None:
            return 1.0
        scores = np.array([j.T @ item.mean for item, j in zip(self.clusters, turned, strict=True)])
        observed = float(np.sum(np.square(scores.sum(axis=0))))
        share = 1.0
        for draws in (NULL_DRAWS, MANY_SIGN_DRAWS):
            null = np.sum(np.square(_signs(draws, len(self.clusters)) @ scores), axis=1)
            share = p_value_with_pareto_tail(observed, null)
            if _exceedances(observed, null) >= MIN_EXCEEDANCES:
                break
        return max(share, 2.0 ** (1 - len(self.clusters)))  # a pattern of signs and its opposite have one statistic

    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """None: without repeats there is no test of the remaining residuals."""
        del rest
        return None

    def freedoms(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.freedoms`: effective number of blocks minus one, (sum w)^2 / sum w^2 - 1.

        The weights w are the information of the blocks about a parameter (Satterthwaite 1946; for clusters Imbens and
        Kolesár 2016). A joint that moves in three of twenty stretches has three effective blocks.
        """
        moved = np.array([np.sum(np.square(jacobian @ inverse), axis=0) for jacobian in jacobians])
        squares = np.maximum(np.sum(np.square(moved), axis=0), 1e-300)
        return np.asarray(np.maximum(np.square(moved.sum(axis=0)) / squares - 1.0, 1.0))

    def covariance(self, jacobians: Sequence[Array], rest: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; blocks are independent, neighbouring samples are not."""
        scores = np.array([j.T @ left for left, j in zip(rest, jacobians, strict=True)])
        count = len(self.clusters)
        return np.asarray(inverse @ (scores.T @ scores) @ inverse * count / (count - 1.0))


def combined_half_width(
    noise: Array,
    quantile: float | Array,
    jackknife: Array,
    clusters: float | Array,
    discrepancy: Array,
    confidence: float = 0.95,
) -> Array:
    """Half widths of intervals, ``(p,)``.

    The larger of two estimates, from the noise and from the jackknife over clusters, each with its own quantile; model
    discrepancy is added in quadrature.

    Args:
        noise: Standard errors from noise, ``(p,)``.
        quantile: Of Student's t with the degrees of freedom of the noise, for each parameter or for all.
        jackknife: Jackknife standard errors over clusters, ``(p,)``.
        clusters: Number of clusters that depend on the parameter, for each or for all.
        discrepancy: Standard errors from model discrepancy, ``(p,)``.
        confidence: Confidence level of the intervals.
    """
    tail = 0.5 + confidence / 2.0
    own = np.maximum(quantile * noise, scipy.stats.t.ppf(tail, np.maximum(np.asarray(clusters) - 1, 1)) * jackknife)
    return np.asarray(np.hypot(own, scipy.stats.norm.ppf(tail) * discrepancy))
