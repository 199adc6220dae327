# SPDX-License-Identifier: Apache-2.0
"""Null distributions of score statistics: rotation tests with repeats, sign flips of blocks without.

An effect with sensitivities J_c in cluster c is judged by its total score and that score's size in the metric of the
information matrix, with W the inverse squared scales of the features:

    s = sum_c n_c J_c^T W rbar_c,        M = sum_c n_c J_c^T W J_c,        T = s^T M^-1 s

the part of the squared residual that the effect explains. With nuisance parameters, fitted before, T is the increase by
the tested parameters. Two tests give the distribution of T under noise alone.

**Repeats** (:class:`RotationNull`). Repeats of a condition are written as a mean row sqrt(n_c) rbar_c and n_c - 1
orthonormal contrasts; if nothing is missing, all N rows of a layout are independent draws of one normal distribution,
whatever its covariance. Given their Gram matrix, every rotation of them is then equally likely (Langsrud 2005,
*Rotation tests*, Statistics and Computing 15; Solari, Finos and Goeman 2014, *Rotation-based multiple testing in the
multivariate linear model*, Biometrics 70). The share of rotations with a T at least as large as the measured one is an
exact p-value for any number of features and repeats, if T is computed from the rotated rows alone, scales included. The
pure error of few repeats is uncertain: features whose contrasts happen to be small have a large weight in the
measurement, and with the same weight in every rotation noise would be significant (3 conditions with 2 repeats:
p < 1 % in 11 to 31 % of all campaigns). So the variance is estimated anew from the contrasts of every rotation,

    1 / W_f = (d_0 v_g + d v_f) / (d_0 + d) + (relevance limit / 2)^2

with v_f the variance of feature f by d contrasts, v_g its mean over the time bins of the signal, and d_0 =
``PRIOR_DEGREES_OF_FREEDOM``: the moderated variance of Smyth (2004, *Linear models and empirical Bayes methods*,
Statistical Applications in Genetics 3), in rotations as in Wu et al. (2010, *ROAST: rotation gene set tests*,
Bioinformatics 26). Where a layout has fewer than ``MIN_DEGREES_OF_FREEDOM`` contrasts, v_g is the mean over all layouts
with the signal. The variance of one layout would have the tails of Student's t with one or two degrees of freedom, in
which 300 times the noise is not rare.
Rows are smaller than noise after q directions were fitted. Rotations of all n numbers are therefore scaled by
sqrt(n / (n - q)); without it p < 1 % in 5 % of the campaigns with 3 conditions, 2 repeats and 2 fitted parameters.
With a single feature and condition the test is Student's t with n - 1 degrees of freedom. Heavy tails make it
conservative rather than wrong: an outlier of one repeat is in the mean row and in the contrasts of its condition.

Where the model discrepancy is known, residuals have a second source: sum_k a_k P_k + u, with patterns P_k in which
simulators differ and a_k standard normal, partly common to all clusters of one kind. Patterns are used instead of
single features because simulators differ in friction or stiffness of a contact, which changes many features at once.
Only mean rows have this source: a share is common to the clusters of one kind, the remainder differs between clusters.
Along its principal directions the means and their sensitivities are scaled to the size of the noise (generalised least
squares), so that all rows may be rotated. The error of a calibration (clock of the commands) is a third source, with
one amplitude in all clusters, and is scaled likewise. Rotations of these rows also give the null distribution of the
lack of fit, sum_c n_c rbar_c^T W rbar_c.

**Blocks** (:class:`SignFlipNull`). A recording has no repeats. Stretches longer than the correlation time of its
noise are independent, and their scores are about symmetric: signs are flipped at random (wild cluster bootstrap of the
score, Cameron, Gelbach and Miller 2008, Review of Economics and Statistics 90). They are scaled by all residuals of a
signal, and no flip changes this scale.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache, reduce

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.thresholds import (
    MAX_CALIBRATION_ERROR,
    MIN_BLOCKS,
    MIN_DEGREES_OF_FREEDOM,
    NULL_DRAWS,
    PRIOR_DEGREES_OF_FREEDOM,
)
from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_sim.robots.robot import Array

RIDGE = 1e-12  # of the trace; keeps a covariance of rank zero invertible
MANY_SIGN_DRAWS = 49999  # if NULL_DRAWS have less than MIN_EXCEEDANCES beyond the observation
MIN_EXCEEDANCES = 10  # draws beyond an observation; with fewer, the Pareto tail gives its p-value
TAIL_DRAWS = 250  # largest draws that the Pareto tail is fitted to (Knijnenburg et al. 2009)
MIN_TAIL_SHAPE = 1e-3  # of the generalised Pareto distribution: exponential, without an end


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
        """Additional data that a verdict needs, for the user; None: there are enough."""

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
    def lack_of_fit(self, residuals: Sequence[Array]) -> float | None:
        """p-value of the lack-of-fit test of mean residuals ``(F,)`` by cluster; None without repeats."""

    @abstractmethod
    def covariance(self, jacobians: Sequence[Array], residuals: Sequence[Array], inverse: Array) -> Array:
        """Covariance of an estimate due to noise (sandwich), ``(p, p)``.

        Args:
            jacobians: Sensitivities by cluster, ``(F, p)`` each.
            residuals: Mean residuals of the fit by cluster, ``(F,)`` each.
            inverse: Inverse of the information, ``(p, p)``.
        """

    def discrepancy(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """Covariance of an estimate due to model discrepancy, ``(p, p)``."""
        shared: dict[str, Array] = {}
        scores = []
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            part, group = item.count * item.shared_discrepancy @ jacobian, item.discrepancy_group
            shared[group] = shared[group] + part if group in shared else part
            scores.append(item.count * item.unshared_discrepancy @ jacobian)
        factor = np.concatenate([*shared.values(), *scores]) @ inverse
        return np.asarray(factor.T @ factor)

    def freedoms(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """Degrees of freedom of the standard errors of :meth:`covariance`, ``(p,)``."""
        del jacobians
        return np.full(inverse.shape[0], float(max(self.freedom, 1)))


def _whitened(clusters: Sequence[Cluster], jacobians: Sequence[Array], fitted: Sequence[Array]) -> list[Array] | None:
    """Sensitivities orthogonal to the fitted ones and whitened (M = 1), ``(F, p)``; None if nothing remains."""
    total = sum(float(np.sum(np.square(j))) for j in jacobians)
    if fitted and fitted[0].shape[1]:
        roots = [np.sqrt(item.count) for item in clusters]
        nuisance, tested = (
            np.vstack([r * j for r, j in zip(roots, sensitivities, strict=True)])
            for sensitivities in (fitted, jacobians)
        )
        coefficients = np.linalg.lstsq(nuisance, tested, rcond=None)[0]
        jacobians = [j - f @ coefficients for j, f in zip(jacobians, fitted, strict=True)]
    information = np.sum([item.count * j.T @ j for item, j in zip(clusters, jacobians, strict=True)], axis=0)
    size = float(np.trace(information))
    if size <= RIDGE * total:
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

    The tail is fitted to the largest draws by probability-weighted moments (Knijnenburg et al. 2009, *Fewer
    permutations, more accurate P-values*, Bioinformatics 25; Hosking and Wallis 1987) and has no upper end. It resolves
    p-values below one over the number of draws; the adjustment for many tests needs such p-values.
    """
    share = monte_carlo_p_value(observed, null)
    if _exceedances(observed, null) >= MIN_EXCEEDANCES:
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
    statistics = np.vstack((observed, null))
    ranks = scipy.stats.rankdata(-statistics, method="max", axis=0)  # number of draws at least as large
    ranks[:, ~np.any(statistics > 0.0, axis=0)] = len(statistics)
    smallest = ranks.min(axis=1)
    return float(np.count_nonzero(smallest <= smallest[0]) / smallest.size)


def _members(item: Cluster, groups: Sequence[tuple[str, str]]) -> NDArray[np.bool_]:
    """Membership of features in groups, and in a last group of all features, ``(G + 1, F)``."""
    members = [[feature.group[:2] == group for feature in item.features] for group in groups]
    return np.array([*members, [True] * len(item.features)])


@lru_cache(maxsize=32)
def _rotations(rows: int, count: int, seed: int) -> Array:
    """First ``count`` rows of the identity and of Haar-distributed rotations, ``(1 + B, count, rows)``."""
    rng = np.random.default_rng([seed, rows, count])
    basis, upper = np.linalg.qr(rng.standard_normal((NULL_DRAWS, rows, count)))
    drawn = np.swapaxes(basis * np.sign(np.einsum("bii->bi", upper))[:, None, :], 1, 2)
    return np.concatenate((np.eye(rows)[None, :count], drawn))


class _Layout:
    """Rows of the clusters of one layout: first the means, then the contrasts.

    Attributes:
        numbers: Indices of these clusters among all clusters.
        clusters: The clusters.
        rows: Means and contrasts, ``(N, F)``, in multiples of ``unit``.
        unit: Unit of the features, ``(F,)``: the scale of the first cluster.
        means: Number of means.
        freedom: Number of contrasts.
        donors: Layouts whose contrasts give the mean variance of a signal: this one, or all if it has few contrasts.
        limit_squares: Square of half the relevance limit, ``(F,)`` in squares of ``unit``.
    """

    def __init__(self, numbers: list[int], clusters: Sequence[Cluster], means: Sequence[Array]) -> None:
        self.numbers, self.clusters = numbers, [clusters[number] for number in numbers]
        self.unit = self.clusters[0].sigma
        scaled_means: list[Array] = []
        contrasts: list[Array] = []
        for number, item in zip(numbers, self.clusters, strict=True):
            scale = item.sigma / self.unit
            scaled_means.append(np.sqrt(item.count) * means[number] * scale)
            contrasts.extend((scipy.linalg.helmert(item.count) @ item.residuals) * scale)
        self.rows = np.array(scaled_means + contrasts)
        self.means, self.freedom = len(scaled_means), len(contrasts)
        self.donors: Sequence[_Layout] = (self,)
        self.limit_squares = np.mean(
            [np.square(item.sigma / self.unit) * item.limit_squares for item in self.clusters], axis=0
        )

    def rotated(self, seed: int) -> Iterator[Array]:
        """Every mean row, as measured and in rotations, ``(1 + B, F)`` each."""
        rotations = _rotations(len(self.rows), self.means, seed)
        return (rotations[:, number] @ self.rows for number in range(self.means))

    def mean_rows(self, columns: Iterable[Array]) -> Array:
        """Columns by cluster, ``(F, p)`` each, scaled like the mean rows of the residuals, ``(means, F, p)``."""
        return np.array(
            [
                np.sqrt(item.count) * column * (item.sigma / self.unit)[:, None]
                for item, column in zip(self.clusters, columns, strict=True)
            ]
        )

    def scaled(self, means: Array) -> Array:
        """Mean rows ``(means, F, p)`` in units of the noise, with the discrepancy scaled to the size of the noise.

        In units of the noise, the mean of n runs has the variance v + n lambda^2 along a principal direction of its
        discrepancy, as has the mean over all runs that share amplitudes; contrasts have the variance v. Both are scaled
        by sqrt(v / (v + n lambda^2)): first every row, then the mean over the rows that share amplitudes.
        """
        operators, shared = self._scalings
        rows = np.array(
            [operator @ mean for operator, mean in zip(operators, means / self.noise[:, None], strict=True)]
        )
        for members, share, operator in shared:
            mean = np.tensordot(share, rows[members], 1)
            rows[members] += np.multiply.outer(share, operator @ mean - mean)
        return rows

    @cached_property
    def noise(self) -> Array:
        """Standard deviation of the noise, moderated, ``(F,)``."""
        squares = [np.sum(np.square(donor.rows[donor.means :]), axis=0)[None] for donor in self.donors]
        contrasts, mean = self.rows[self.means :], self.mean_variance(squares)[0]
        return np.sqrt(_moderated(mean, np.sum(np.square(contrasts), axis=0), self.freedom) + RIDGE)

    def mean_variance(self, contrast_squares: Sequence[Array]) -> Array:
        """Mean variance of the signals in every rotation, ``(1 + B, F)`` in ``unit``, from the donors' contrasts.

        The mean over the bins of a signal is taken in physical units, because ``unit`` depends on the contrasts.

        Args:
            contrast_squares: Sum of squares of the contrasts of every donor, ``(1 + B, F)`` each.
        """
        keys = list(dict.fromkeys(feature.group for feature in self.clusters[0].features))
        members = [donor.signals_of(keys) for donor in self.donors]
        total = sum(
            (squares * np.square(donor.unit)) @ m
            for squares, donor, m in zip(contrast_squares, self.donors, members, strict=True)
        )
        freedom = sum(donor.freedom * m.sum(axis=0) for donor, m in zip(self.donors, members, strict=True))
        signal_index = np.argmax(self.signals_of(keys), axis=1)
        return np.asarray((total / np.maximum(freedom, 1.0))[:, signal_index] / np.square(self.unit))

    @cached_property
    def _scalings(self) -> tuple[list[Array], list[tuple[list[int], Array, Array]]]:
        """Operator ``(F, F)`` of every mean row; rows, their weights in the mean, and operator of every group."""
        operators, groups = list[Array](), dict[str, list[int]]()
        computed = dict[tuple[int, str], Array]()
        for position, item in enumerate(self.clusters):
            groups.setdefault(item.discrepancy_group, []).append(position)
            key = item.count, item.discrepancy_group
            if key not in computed:
                computed[key] = self._operator(np.sqrt(item.count) * self._in_noise(item, item.unshared_discrepancy))
            operators.append(computed[key])
        shared = []
        for members in groups.values():
            roots = np.sqrt([self.clusters[position].count for position in members])
            share = roots / np.linalg.norm(roots)
            scaled = [
                self._in_noise(self.clusters[position], self.clusters[position].shared_discrepancy)
                @ operators[position]
                for position in members
            ]
            shared.append((members, share, self._operator(np.tensordot(share * roots, scaled, 1))))
        return operators, shared

    def _in_noise(self, item: Cluster, factor: Array) -> Array:
        """A factor of the discrepancy covariance of a cluster in units of the noise, ``(k, F)``."""
        return np.asarray(factor * (item.sigma / self.unit / self.noise))

    def _operator(self, factor: Array) -> Array:
        """Operator that scales rows with discrepancy covariance L^T L to noise, all in units of noise, ``(F, F)``."""
        sizes, directions = np.linalg.eigh(factor.T @ factor)
        contrasts = self.rows[self.means :] / self.noise
        noise = _moderated(1.0, np.sum(np.square(contrasts @ directions), axis=0), self.freedom)
        return np.asarray((directions * np.sqrt(noise / (noise + np.maximum(sizes, 0.0)))) @ directions.T)

    def squares(self, seed: int) -> Array:
        """Sum of squares of the mean rows in every rotation, ``(1 + B, F)``."""
        return reduce(np.add, map(np.square, self.rotated(seed)))

    def contrast_squares(self, squares: Array, inflation: float = 1.0) -> Array:
        """Sum of squares of the contrasts in every rotation, from the squares of the mean rows, ``(1 + B, F)``.

        Args:
            squares: Result of :meth:`squares`.
            inflation: Variance of the noise over the variance of the rows, which fitted parameters reduce [-].
        """
        remaining = np.maximum(np.sum(np.square(self.rows), axis=0) - squares, 0.0)
        remaining[1:] *= inflation
        return remaining

    def signals_of(self, keys: Sequence[tuple[str, str, str]]) -> Array:
        """Indicator matrix of features in signals, ``(F, S)``."""
        column_of = {key: number for number, key in enumerate(keys)}
        indicators = np.zeros((self.unit.size, len(keys)))
        for number, feature in enumerate(self.clusters[0].features):
            if feature.group in column_of:
                indicators[number, column_of[feature.group]] = 1.0
        return indicators


def _scaled_to_noise(
    layouts: Sequence[_Layout], means: Sequence[Array], max_amplitude: float = math.inf
) -> list[Array]:
    """Mean rows of every layout, ``(means, F, p)``, with discrepancy and calibrations scaled to the size of noise.

    All rows are exchangeable then. A calibration is one amplitude for the clusters of all layouts.

    Args:
        layouts: The layouts.
        means: Mean rows of residuals, or of sensitivities, ``(means, F, p)`` per layout.
        max_amplitude: Largest amplitude that a calibration explains, in its standard deviations; any excess remains in
            the rows.
    """
    scaled = [layout.scaled(rows) for layout, rows in zip(layouts, means, strict=True)]
    basis, sizes = _calibrations(layouts)
    if sizes.size:
        stacked = np.concatenate([rows.reshape(-1, rows.shape[-1]) for rows in scaled])
        deviations = np.sqrt(1.0 + np.square(sizes))[:, None]
        explained = np.clip(basis.T @ stacked, -max_amplitude * deviations, max_amplitude * deviations)
        stacked -= basis @ ((1.0 - 1.0 / deviations) * explained)
        ends = np.cumsum([rows.shape[0] * rows.shape[1] for rows in scaled])[:-1]
        scaled = [part.reshape(rows.shape) for part, rows in zip(np.split(stacked, ends), scaled, strict=True)]
    return [rows * layout.noise[:, None] for layout, rows in zip(layouts, scaled, strict=True)]


def _calibrations(layouts: Sequence[_Layout]) -> tuple[Array, Array]:
    """Principal directions of the calibrations over all scaled mean rows, ``(N, k)``, and sizes in noise, ``(k,)``."""
    calibrations = [
        item.calibrations for layout in layouts for item in layout.clusters if item.calibrations is not None
    ]
    count = max(map(len, calibrations), default=0)
    rows = [np.zeros((0, count))]
    for layout in layouts if count else ():
        exact = np.zeros((count, layout.unit.size))
        columns = [exact.T if item.calibrations is None else item.calibrations.T for item in layout.clusters]
        rows.append(layout.scaled(layout.mean_rows(columns)).reshape(-1, count))
    basis, sizes, _ = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    return np.asarray(basis), np.asarray(sizes)


def _weights_of(layouts: Sequence[_Layout], squares: Sequence[Array], inflation: float = 1.0) -> Iterator[Array]:
    """Moderated weights W by layout in every rotation, from the squares of the mean rows, ``(1 + B, F)`` each."""
    contrast_squares = {
        id(layout): layout.contrast_squares(mean_squares, inflation)
        for layout, mean_squares in zip(layouts, squares, strict=True)
    }
    for layout in layouts:
        mean = layout.mean_variance([contrast_squares[id(donor)] for donor in layout.donors])
        yield np.asarray(
            1.0 / (_moderated(mean, contrast_squares[id(layout)], layout.freedom) + layout.limit_squares + RIDGE)
        )


def _moderated(prior: Array | float, squares: Array, freedom: int) -> Array:
    """Moderated variance (d_0 v_0 + squares) / (d_0 + d), from the sum of squares of d contrasts (Smyth 2004)."""
    return np.asarray((PRIOR_DEGREES_OF_FREEDOM * prior + squares) / (PRIOR_DEGREES_OF_FREEDOM + freedom))


class RotationNull(NullDistribution):
    """Rotation test with repeats, see the module; arguments as for :class:`NullDistribution`."""

    @cached_property
    def _layouts(self) -> list[_Layout]:
        return self._layouts_of([item.mean for item in self.clusters])

    def _layouts_of(self, means: Sequence[Array]) -> list[_Layout]:
        """Layouts with the rows of some mean residuals, ``(F,)`` per cluster."""
        numbers: dict[str, list[int]] = {}
        for number, item in enumerate(self.clusters):
            numbers.setdefault(item.layout, []).append(number)
        layouts = [_Layout(chosen, self.clusters, means) for chosen in numbers.values()]
        for layout in layouts:
            layout.donors = layouts if layout.freedom < MIN_DEGREES_OF_FREEDOM else (layout,)
        means = [layout.rows[: layout.means, :, None] for layout in layouts]
        scaled = _scaled_to_noise(layouts, means, MAX_CALIBRATION_ERROR)
        for layout, rows in zip(layouts, scaled, strict=True):
            layout.rows[: layout.means] = rows[:, :, 0]
        return layouts

    @cached_property
    def _squares(self) -> list[Array]:
        """Sum of squares of the mean rows of every layout in all rotations, ``(1 + B, F)``."""
        return [layout.squares(seed) for seed, layout in enumerate(self._layouts)]

    def _inflation(self, fitted: Sequence[Array]) -> float:
        """Variance of the noise over the variance of the rows, n / (n - q) with q of n directions fitted [-]."""
        count = sum(layout.rows.size for layout in self._layouts)
        return count / max(count - (fitted[0].shape[1] if fitted else 0), 1)

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
        columns_by_effect = [
            [np.hstack(pair) for pair in zip(fitted, jacobians, strict=True)] if fitted else list(jacobians)
            for jacobians in effects
        ]
        edges = np.cumsum([0, *(columns[0].shape[1] for columns in columns_by_effect)])
        scores = np.zeros((1 + NULL_DRAWS, edges[-1]))
        mean_rows = [
            layout.mean_rows(np.hstack([columns[n] for columns in columns_by_effect]) for n in layout.numbers)
            for layout in self._layouts
        ]
        scaled, inflation = _scaled_to_noise(self._layouts, mean_rows), self._inflation(fitted)
        weights_by_layout = list(_weights_of(self._layouts, self._squares, inflation))
        for seed, (layout, weights) in enumerate(zip(self._layouts, weights_by_layout, strict=True)):
            for rows, sensitivities in zip(layout.rotated(seed), scaled[seed], strict=True):
                scores += (rows * weights) @ sensitivities
        scores[1:] *= math.sqrt(inflation)
        return [
            self._p_value(
                jacobians,
                fitted,
                [sensitivities[:, :, first:last] for sensitivities in scaled],
                scores[:, first:last],
                weights_by_layout,
            )
            for jacobians, first, last in zip(effects, edges[:-1], edges[1:], strict=True)
        ]

    def _p_value(
        self,
        jacobians: Sequence[Array],
        fitted: Sequence[Array],
        scaled: Sequence[Array],
        scores: Array,
        weights_by_layout: Sequence[Array],
    ) -> float:
        """:meth:`p_value` by scaled sensitivities to nuisance and tested parameters, their scores and W by layout."""
        if _whitened(self.clusters, jacobians, fitted) is None:
            return 1.0
        count = scores.shape[1]
        information = np.zeros((1 + NULL_DRAWS, count * count))
        for sensitivities, weights in zip(scaled, weights_by_layout, strict=True):
            information += weights @ np.einsum("cfp,cfq->fpq", sensitivities, sensitivities).reshape(
                sensitivities.shape[1], -1
            )
        information = information.reshape(-1, count, count)
        explained = _score_statistic(scores, information)
        if fitted and (nuisance_count := fitted[0].shape[1]):
            explained -= _score_statistic(scores[:, :nuisance_count], information[:, :nuisance_count, :nuisance_count])
        return p_value_with_pareto_tail(float(explained[0]), explained[1:])

    def lack_of_fit(self, residuals: Sequence[Array]) -> float | None:
        """See :meth:`NullDistribution.lack_of_fit`; by the sum of squares.

        A test of all features at once has little power against a misfit of one signal. So each signal and all signals
        together are tested, and the smallest p-value is compared with the smallest p-value of every rotation (Westfall
        and Young 1993, *Resampling-based multiple testing*). The family-wise level holds for any number of signals and
        any correlation between them.
        """
        if self.shortage is not None:
            return None
        layouts = self._layouts_of(residuals)
        squares = [layout.squares(seed) for seed, layout in enumerate(layouts)]
        total = np.zeros((1 + NULL_DRAWS, len(self._groups) + 1))
        for layout, mean_squares, weights in zip(layouts, squares, _weights_of(layouts, squares), strict=True):
            total += (mean_squares * weights) @ _members(layout.clusters[0], self._groups).T
        return westfall_young_p_value(total[0], total[1:])

    @cached_property
    def _groups(self) -> list[tuple[str, str]]:
        """Signals by phase, of all features."""
        return list(dict.fromkeys(feature.group[:2] for item in self.clusters for feature in item.features))

    def covariance(self, jacobians: Sequence[Array], residuals: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; trials are independent of each other, their features are not.

        A condition without repeats takes the scatter pooled over its layout.
        """
        del residuals  # the scatter of repeats about their mean does not depend on the fit
        score_covariance = np.zeros_like(inverse)
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            pooled = [item] if item.count > 1 else [other for other in self.clusters if other.layout == item.layout]
            freedom = max(sum(other.count - 1 for other in pooled), 1)
            scatter = np.vstack([other.residuals - other.mean for other in pooled]) @ jacobian
            score_covariance += item.count / freedom * scatter.T @ scatter
        return np.asarray(inverse @ score_covariance @ inverse)


@lru_cache(maxsize=4)  # one search uses two
def _signs(draws: int, blocks: int) -> Array:
    """Signs of blocks in draws of the null distribution, ``(draws, blocks)``."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(draws, blocks))
    signs.flags.writeable = False
    return signs


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
        whitened = _whitened(self.clusters, jacobians, fitted)
        if self.shortage is not None or whitened is None:
            return 1.0
        scores = np.array([j.T @ item.mean for item, j in zip(self.clusters, whitened, strict=True)])
        observed = float(np.sum(np.square(scores.sum(axis=0))))
        share = 1.0
        for draws in (NULL_DRAWS, MANY_SIGN_DRAWS):
            null = np.sum(np.square(_signs(draws, len(self.clusters)) @ scores), axis=1)
            share = p_value_with_pareto_tail(observed, null)
            if _exceedances(observed, null) >= MIN_EXCEEDANCES:
                break
        return max(share, 2.0 ** (1 - len(self.clusters)))  # a pattern of signs and its opposite have one statistic

    def lack_of_fit(self, residuals: Sequence[Array]) -> float | None:
        """None: without repeats there is no test of the remaining residuals."""
        del residuals
        return None

    def freedoms(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.freedoms`: effective number of blocks minus one, (sum w)^2 / sum w^2 - 1.

        The weights w are the information of the blocks about a parameter (Satterthwaite 1946; for clusters Imbens and
        Kolesár 2016). A joint that moves in three of twenty stretches has three effective blocks.
        """
        weights = np.array([np.sum(np.square(jacobian @ inverse), axis=0) for jacobian in jacobians])
        squares = np.maximum(np.sum(np.square(weights), axis=0), 1e-300)
        return np.asarray(np.maximum(np.square(weights.sum(axis=0)) / squares - 1.0, 1.0))

    def covariance(self, jacobians: Sequence[Array], residuals: Sequence[Array], inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; blocks are independent, neighbouring samples are not."""
        scores = np.array([j.T @ residual for residual, j in zip(residuals, jacobians, strict=True)])
        count = len(self.clusters)
        return np.asarray(inverse @ (scores.T @ scores) @ inverse * count / max(count - 1.0, 1.0))


def benjamini_hochberg(p_values: Mapping[str, float], tests: int = 0) -> dict[str, float]:
    """p-values adjusted for the false discovery rate (Benjamini and Hochberg 1995).

    Args:
        p_values: By name.
        tests: Number of tests, including tests with larger p-values; 0: the tests of ``p_values``.
    """
    if not p_values:
        return {}
    padded = [*p_values.values(), *[1.0] * (tests - len(p_values))]
    return dict(zip(p_values, scipy.stats.false_discovery_control(padded).tolist(), strict=False))
