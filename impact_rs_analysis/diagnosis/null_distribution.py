# SPDX-License-Identifier: Apache-2.0
"""Null distributions of score statistics, with the degrees of freedom of the data.

An effect with sensitivities J_c in cluster c is judged by its total score and that score's size in the metric of the
information matrix,

    s = sum_c n_c J_c^T rbar_c,        M = sum_c n_c J_c^T J_c,        T = s^T M^-1 s

which is the part of the squared residual that it explains. Two references give the distribution of T under noise alone.

**Repeats** (:class:`RotationNull`). Repeats of a condition are written as a mean row sqrt(n_c) rbar_c and n_c - 1
orthonormal contrasts; if nothing is missing, all rows of a layout are independent draws of one normal distribution,
whatever its covariance. Given their Gram matrix, every rotation of them is then equally likely (Langsrud 2005,
*Rotation tests*, Statistics and Computing 15), so the distribution of

    (s^T M^-1 s) / (the same of the contrasts)

under random rotations is exact for any number of features, however correlated, and for any number of repeats. With one
parameter and one condition it is Student's t with n - 1 degrees of freedom.

Where the model discrepancy is known, residuals have a second source: sum_k a_k P_k, with patterns P_k in which
simulators differ and a_k standard normal, the same in all clusters of one kind. Patterns are used instead of single
features because simulators differ in friction or stiffness of a contact, which changes many features at once. T is then
also compared with draws of noise (normal, with the contrasts' covariance and its Student factor) plus discrepancy, and
the larger p-value counts.

**Blocks** (:class:`SignFlipNull`). A recording has no repeats. Stretches longer than the correlation time of its
noise are independent, and their scores are about symmetric: signs are flipped at random (wild cluster bootstrap of the
score, Cameron, Gelbach and Miller 2008, Review of Economics and Statistics 90).
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.thresholds import DRAWS, LEAST_FREEDOM, LEAST_OWN, UNMEASURED
from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_sim.robot import Array

TINY = 1e-12  # keeps a zero covariance invertible


class NullDistribution(ABC):
    """Distribution of statistics under noise (and model discrepancy) alone.

    Args:
        clusters: Residuals of the tested model.
    """

    def __init__(self, clusters: Sequence[Cluster]) -> None:
        self.clusters = tuple(clusters)

    @property
    @abstractmethod
    def freedom(self) -> int:
        """Degrees of freedom of the noise."""

    @property
    @abstractmethod
    def shortage(self) -> str | None:
        """Data that are missing for a verdict, for the user; None if there are enough."""

    @abstractmethod
    def p_value(self, jacobians: Sequence[Array], information: Array) -> float:
        """p-value of an effect being absent.

        Args:
            jacobians: Sensitivities by cluster, ``(F, p)`` each, orthogonal to what was fitted before.
            information: Metric M in which scores are measured, ``(p, p)``.
        """

    @abstractmethod
    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """p-value of mean residuals ``(F,)`` by cluster being noise and discrepancy; None without repeats."""

    @abstractmethod
    def covariance(self, jacobians: Sequence[Array], change: Array, inverse: Array) -> Array:
        """Covariance of an estimate due to noise (sandwich), ``(p, p)``.

        Args:
            jacobians: Sensitivities by cluster, ``(F, p)`` each.
            change: Estimate, from the point of the residuals, ``(p,)``.
            inverse: Inverse of the information, ``(p, p)``.
        """

    def discrepancy(self, jacobians: Sequence[Array], inverse: Array) -> Array:
        """Covariance of an estimate due to model discrepancy, ``(p, p)``."""
        factor = self._discrepancy_scores(jacobians) @ inverse
        return np.asarray(factor.T @ factor)

    def _discrepancy_scores(self, jacobians: Sequence[Array]) -> Array:
        """Score of one standard deviation of every pattern of discrepancy, where clusters share their amplitudes."""
        total: dict[str, Array] = {}
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            part = item.count * item.moved_together @ jacobian
            name = alike(item)
            total[name] = total[name] + part if name in total else part
        return np.concatenate([part[np.any(part != 0.0, axis=1)] for part in total.values()])

    @cached_property
    def discrepant(self) -> bool:
        """Whether a model discrepancy is known."""
        return any(np.any(item.discrepancy > 0.0) for item in self.clusters)

    def quantile(self, confidence: float = 0.95) -> float:
        """Half width of an interval in standard errors of :meth:`covariance`."""
        return float(scipy.stats.t.ppf(0.5 + confidence / 2.0, max(self.freedom, 1)))


def _discrepancy(item: Cluster) -> Array:
    """Covariance of the discrepancy: partly along measured patterns, partly feature by feature, ``(F, F)`` [-]."""
    patterns = item.moved_together
    return (1.0 - UNMEASURED) * patterns.T @ patterns + UNMEASURED * np.diag(np.square(item.discrepancy))


def alike(item: Cluster) -> str:
    """Key of the discrepancy: clusters with the same key share its amplitudes."""
    return item.layout if item.alike is None else item.alike


def rarity(observed: float, null: Array) -> float:
    """Share of a null distribution, including the observation, that is at least as large: the p-value."""
    return float((1.0 + np.count_nonzero(null >= observed * (1.0 - 1e-12))) / (1.0 + null.size))


def smallest(observed: Array, null: Array) -> float:
    """p-value of the smallest p-value of several statistics.

    Args:
        observed: Statistics, ``(G,)``.
        null: Statistics in draws of the null distribution, ``(B, G)``; one that never exceeds zero is ignored.
    """
    everything = np.vstack((observed, null))
    below = scipy.stats.rankdata(-everything, method="max", axis=0)  # number of draws at least as large
    below[:, ~np.any(everything > 0.0, axis=0)] = len(everything)
    least = below.min(axis=1)
    return float(np.count_nonzero(least <= least[0]) / least.size)


def _even(both: Array) -> Array:
    """Scaling that whitens noise plus discrepancy, ``both`` ``(F, F)``, as ``(F, F)``.

    Discrepancy changes many features at once. Where it is as large as the noise, it would dominate a plain sum of
    squares.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(both)).T)


def _members(item: Cluster, groups: Sequence[tuple[str, str]]) -> NDArray[np.bool_]:
    """Membership of features in groups, of which the last holds all, ``(G + 1, F)``."""
    own = [[feature.group[:2] == group for feature in item.features] for group in groups]
    return np.array([*own, [True] * len(item.features)])


@lru_cache(maxsize=32)
def _frames(rows: int, count: int, seed: int) -> Array:
    """Random orthonormal frames, uniform over all: the first ``count`` rows of rotations, ``(B, count, rows)``."""
    rng = np.random.default_rng([seed, rows, count])
    basis, upper = np.linalg.qr(rng.standard_normal((DRAWS, rows, count)))
    return np.ascontiguousarray(np.swapaxes(basis * np.sign(np.einsum("bii->bi", upper))[:, None, :], 1, 2))


def _squares(frames: Array, rows: Array) -> Array:
    """Squared norms of the rows transformed by each frame, computed in the smaller dimension, ``(B,)``.

    Args:
        frames: ``(B, count, n)``.
        rows: ``(n, f)``.
    """
    if rows.shape[1] < len(rows):
        turned = frames @ rows
        return np.asarray(np.einsum("bcf,bcf->b", turned, turned))
    return np.asarray(np.einsum("bcn,bcn->b", frames @ (rows @ rows.T), frames))


class _Rows:
    """Rows of the clusters of one layout: first the means, then the contrasts."""

    def __init__(self, numbers: list[int], clusters: Sequence[Cluster]) -> None:
        self.numbers = numbers
        self.counts = np.array([clusters[number].count for number in numbers])
        rows: list[Array] = []
        contrasts: list[Array] = []
        for number in numbers:
            turned = _contrasts(clusters[number].count) @ clusters[number].residuals
            rows.append(turned[0])
            contrasts.extend(turned[1:])
        self.rows = np.array(rows + contrasts)
        self.means = len(numbers)
        self.freedom = len(contrasts)

    def products(self, jacobians: Sequence[Array], root: Array) -> Array:
        """Scores of every row with every mean's sensitivity in the metric, ``(means, rows, p)``."""
        return np.array(
            [
                np.sqrt(count) * (self.rows @ (jacobians[number] @ root))
                for number, count in zip(self.numbers, self.counts, strict=True)
            ]
        )


def _contrasts(count: int) -> Array:
    """Orthonormal rows, the first one constant (Helmert), ``(n, n)``."""
    result = np.zeros((count, count))
    result[0] = 1.0 / np.sqrt(count)
    for row in range(1, count):
        result[row, :row], result[row, row] = 1.0, -row
        result[row] /= np.sqrt(row * (row + 1.0))
    return result


class RotationNull(NullDistribution):
    """NullDistribution from repeats, see the module; arguments as for :class:`NullDistribution`."""

    @cached_property
    def _layouts(self) -> list[_Rows]:
        numbers: dict[str, list[int]] = {}
        for number, item in enumerate(self.clusters):
            numbers.setdefault(item.layout, []).append(number)
        return [_Rows(chosen, self.clusters) for chosen in numbers.values()]

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the pure error: repeats less conditions."""
        return sum(item.count - 1 for item in self.clusters)

    @property
    def shortage(self) -> str | None:
        """See :attr:`NullDistribution.shortage`."""
        if self.freedom >= LEAST_FREEDOM:
            return None
        return (
            f"{LEAST_FREEDOM - self.freedom} more repeat(s) of any of the {len(self.clusters)} conditions (runs minus "
            f"conditions is {self.freedom}, at least {LEAST_FREEDOM} are needed)"
        )

    def p_value(self, jacobians: Sequence[Array], information: Array) -> float:
        """See :meth:`NullDistribution.p_value`."""
        if self.shortage is not None:
            return 1.0
        root = np.linalg.inv(np.linalg.cholesky(information)).T
        count = root.shape[0]
        observed, null = np.zeros(count), np.zeros((DRAWS, count))
        noise, noise_null = 0.0, np.zeros(DRAWS)
        for number, layout in enumerate(self._layouts):
            products = layout.products(jacobians, root)
            rows = np.swapaxes(products, 0, 1).reshape(len(layout.rows), -1)
            frames = _frames(len(layout.rows), layout.means, number)
            observed += np.einsum("ccp->p", products[:, : layout.means])
            null += frames.reshape(DRAWS, -1) @ products.reshape(-1, count)
            noise += float(np.sum(np.square(rows[layout.means :])))
            noise_null += np.sum(np.square(rows)) - _squares(frames, rows)
        size, sizes = float(observed @ observed), np.einsum("bp,bp->b", null, null)
        if size <= 0.0:
            return 1.0
        p = rarity(size / max(noise, 1e-300), sizes / np.maximum(noise_null, 1e-300))
        if self.discrepant:
            p = max(p, rarity(size, self._with_discrepancy(jacobians, root)))
        return p

    def _with_discrepancy(self, jacobians: Sequence[Array], root: Array) -> Array:
        """Draws of T under noise and discrepancy, ``(B,)``."""
        weights, rng = self._weights[0], copy.deepcopy(self._weights[1])
        total = np.zeros((DRAWS, root.shape[1]))
        for layout, own in zip(self._layouts, weights, strict=True):
            if own is not None:
                contrasts = layout.products(jacobians, root)[:, layout.means :]
                total += own @ contrasts.reshape(-1, root.shape[1])
        shared = np.asarray(np.linalg.qr(self._discrepancy_scores(jacobians) @ root, mode="r"))
        total += rng.standard_normal((DRAWS, shared.shape[0])) @ shared
        return np.asarray(np.einsum("bp,bp->b", total, total))

    @cached_property
    def _weights(self) -> tuple[list[Array | None], np.random.Generator]:
        """:meth:`_noise` of every layout, ``(B, means * contrasts)``, None without contrasts; and the generator."""
        rng = np.random.default_rng(1)
        return [self._noise(rng, own).reshape(DRAWS, -1) if own.freedom else None for own in self._layouts], rng

    @staticmethod
    def _noise(rng: np.random.Generator, layout: _Rows) -> Array:
        """Weights of the contrasts in draws of mean rows, ``(B, means, contrasts)``."""
        weights = rng.standard_normal((DRAWS, layout.means, layout.freedom))
        return np.asarray(weights / np.sqrt(rng.chisquare(layout.freedom, DRAWS))[:, None, None])

    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """See :meth:`NullDistribution.lack_of_fit`; as :meth:`p_value`, with every feature a parameter of its own.

        A test of all features at once has little power against a misfit of one signal. So every signal is tested by
        itself as well as all together, and the smallest p-value is compared with the smallest in every draw of the same
        noise (Westfall and Young 1993, *Resampling-based multiple testing*). The level holds for any number of signals
        and any correlation between them.
        """
        if self.shortage is not None:
            return None
        groups = self._groups
        observed, noise = np.zeros((2, len(groups) + 1))
        null, noise_null = np.zeros((2, DRAWS, len(groups) + 1))
        for number, (layout, members, scales) in enumerate(self._scaled):
            means = np.array([np.sqrt(self.clusters[c].count) * rest[c] for c in layout.numbers])
            rows = np.vstack((means, layout.rows[layout.means :]))
            frames = _frames(len(rows), layout.means, number)
            for place, (own, scale) in enumerate(zip(members, scales, strict=True)):
                if not scale.size:
                    continue
                scaled = rows[:, own] @ scale
                inside = _squares(frames, scaled)
                observed[place] += float(np.sum(np.square(scaled[: layout.means])))
                noise[place] += float(np.sum(np.square(scaled[layout.means :])))
                null[:, place] += inside
                noise_null[:, place] += np.sum(np.square(scaled)) - inside
        p = smallest(observed / np.maximum(noise, 1e-300), null / np.maximum(noise_null, 1e-300))
        return max(p, smallest(observed, self._by_chance)) if self.discrepant else p

    @cached_property
    def _groups(self) -> list[tuple[str, str]]:
        """Signals by phase, of all features."""
        return list(dict.fromkeys(feature.group[:2] for item in self.clusters for feature in item.features))

    @cached_property
    def _scaled(self) -> list[tuple[_Rows, NDArray[np.bool_], list[Array]]]:
        """Per layout: membership of features in groups, and the scaling of each group."""
        result = []
        for layout in self._layouts:
            members = _members(self.clusters[layout.numbers[0]], self._groups)
            both = self._noise_and_discrepancy(layout)
            result.append((layout, members, [_even(both[np.ix_(own, own)]) for own in members]))
        return result

    @cached_property
    def _by_chance(self) -> Array:
        """Squares of scaled mean rows under noise and discrepancy, for any residuals, by group, ``(B, G)``."""
        rng = np.random.default_rng(2)
        return np.asarray(sum(self._rest_by_chance(rng, *scaled) for scaled in self._scaled))

    def _rest_by_chance(
        self, rng: np.random.Generator, layout: _Rows, members: NDArray[np.bool_], scales: Sequence[Array]
    ) -> Array:
        """Squares of scaled mean rows under noise and discrepancy, by group of features, ``(B, G)``."""
        contrasts = layout.rows[layout.means :]
        squares = np.zeros((DRAWS, len(members)))
        noise = self._noise(rng, layout) if layout.freedom else np.zeros((DRAWS, layout.means, 0))
        off: dict[str, tuple[Array, Array]] = {}
        for number in layout.numbers:
            item = self.clusters[number]
            if alike(item) not in off:
                root = np.linalg.cholesky(_discrepancy(item) + TINY * np.eye(len(item.features)))
                off[alike(item)] = rng.standard_normal((DRAWS, len(root))), np.asarray(root)
        for group, (own, scale) in enumerate(zip(members, scales, strict=True)):
            if not scale.size:
                continue
            turned = contrasts[:, own] @ scale
            moved = {name: drawn @ (root[own].T @ scale) for name, (drawn, root) in off.items()}
            for place, number in enumerate(layout.numbers):
                seen = noise[:, place] @ turned + np.sqrt(layout.counts[place]) * moved[alike(self.clusters[number])]
                squares[:, group] += np.einsum("bf,bf->b", seen, seen)
        return squares

    def _noise_and_discrepancy(self, layout: _Rows) -> Array:
        """Covariance of a mean row of a layout with independent noise, ``(F, F)`` [-]."""
        items = [self.clusters[number] for number in layout.numbers]
        alone = [np.maximum(1.0 - np.square(item.discrepancy), LEAST_OWN) for item in items]
        return np.asarray(
            sum(np.diag(own) + item.count * _discrepancy(item) for own, item in zip(alone, items, strict=True))
            / len(items)
        )

    def covariance(self, jacobians: Sequence[Array], change: Array, inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; trials are independent of each other, their features are not."""
        del change  # the scatter of repeats about their mean does not depend on the fit
        meat = np.zeros_like(inverse)
        for item, jacobian in zip(self.clusters, jacobians, strict=True):
            if item.count > 1:
                scores = (item.residuals - item.mean) @ jacobian * np.sqrt(item.count / (item.count - 1.0))
                meat += scores.T @ scores
        return np.asarray(inverse @ meat @ inverse)


class SignFlipNull(NullDistribution):
    """NullDistribution from stretches of recordings, see the module; arguments as for :class:`NullDistribution`."""

    LEAST = 12  # blocks: 2^11 patterns of signs resolve p = 0.0005

    @property
    def freedom(self) -> int:
        """Blocks less one."""
        return len(self.clusters) - 1

    @property
    def shortage(self) -> str | None:
        """See :attr:`NullDistribution.shortage`."""
        if len(self.clusters) >= self.LEAST:
            return None
        return (
            f"{self.LEAST - len(self.clusters)} more stretches of motion or impacts: {len(self.clusters)} of "
            f"{self.LEAST} needed"
        )

    @cached_property
    def _signs(self) -> Array:
        return np.random.default_rng(0).choice([-1.0, 1.0], size=(DRAWS, len(self.clusters)))

    def p_value(self, jacobians: Sequence[Array], information: Array) -> float:
        """See :meth:`NullDistribution.p_value`."""
        if self.shortage is not None:
            return 1.0
        root = np.linalg.inv(np.linalg.cholesky(information)).T
        scores = np.array([j.T @ item.mean for item, j in zip(self.clusters, jacobians, strict=True)]) @ root
        observed = scores.sum(axis=0)
        size = float(observed @ observed)
        if size <= 0.0:
            return 1.0
        null = self._signs @ scores
        return rarity(size, np.einsum("bp,bp->b", null, null))

    def lack_of_fit(self, rest: Sequence[Array]) -> float | None:
        """None: without repeats there is no test of the remaining residuals."""
        del rest
        return None

    def covariance(self, jacobians: Sequence[Array], change: Array, inverse: Array) -> Array:
        """See :meth:`NullDistribution.covariance`; blocks are independent, neighbouring samples are not."""
        scores = np.array([j.T @ (item.mean - j @ change) for item, j in zip(self.clusters, jacobians, strict=True)])
        count = len(self.clusters)
        return np.asarray(inverse @ (scores.T @ scores) @ inverse * count / (count - 1.0))


def combined_half_width(
    noise: Array, quantile: float, jackknife: Array, clusters: int, discrepancy: Array, confidence: float = 0.95
) -> Array:
    """Half width of intervals, ``(p,)``.

    The larger of two estimates, from the noise and from the disagreement of the clusters, each with its own quantile;
    model discrepancy is added in squares.

    Args:
        noise: Standard errors from noise, ``(p,)``.
        quantile: Of Student's t with the degrees of freedom of the noise.
        jackknife: Standard errors from leaving one cluster out, ``(p,)``.
        clusters: Number of clusters left out in turn.
        discrepancy: Standard errors from model discrepancy, ``(p,)``.
        confidence: Of the intervals.
    """
    tail = 0.5 + confidence / 2.0
    own = np.maximum(quantile * noise, scipy.stats.t.ppf(tail, max(clusters - 1, 1)) * jackknife)
    return np.asarray(np.hypot(own, scipy.stats.norm.ppf(tail) * discrepancy))
