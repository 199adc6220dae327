# SPDX-License-Identifier: Apache-2.0
"""Goodness-of-fit test: is the error of a model consistent with a right model?

The statistic is the sum over conditions c of the mean square of their mean residuals,

    Q = sum_c |r_c|^2 / F_c

with each of the F_c features in units of its tolerance u^2 = (l / 2)^2 + d^2, with the relevance limit l and the
discrepancy d. The unit excludes the scatter, whose estimate from few repeats is often far too small. Under a right
model the mean of n_c repeats has the covariance

    V_c = S / n_c + P_c^T P_c + diag(l^2 / 4 u^2)

with the scatter S and the patterns P of discrepancy and clock; similar conditions share their amplitudes. For a
known S, Q is about E / g times chi square with g degrees of freedom (Box 1954, *Some theorems on quadratic forms*,
Annals of Mathematical Statistics 25),

    E = tr V,    g = E^2 / tr V^2

The part a = tr sum_c S / n_c of E is estimated from m contrasts among repeats. It has the degrees of freedom
f = a^2 m / tr (sum_c S / n_c)^2, so that S is the measured one times c = f / chi_f^2, and

    p = mean over c of P(chi_g(c)^2 > g(c) Q / E(c))

(generalised p-value: Tsui and Weerahandi 1989, Journal of the American Statistical Association 84). With scatter alone
it is Dempster's test (1958, *A high dimensional two sample significance test*, ibid. 29), F with k C and k m degrees of
freedom for C conditions and k = (tr S)^2 / tr S^2 independent directions of the scatter. With one S in numerator and
denominator alike, p < 1 % in 4 to 10 % of right models with limits and few directions. tr S^2 of the measured S is too
large. The estimate without this bias (Bai and Saranadasa 1996, *Effect of high dimension*, Statistica Sinica 6),

    m^2 / ((m - 1) (m + 2)) (tr S^2 - (tr S)^2 / m)

is hardly determined by few contrasts: the first one has the weight 1 / m, the second 1 - 1 / m.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.thresholds import MIN_REPORTED_P
from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_sim.robots.robot import Array

MAX_FREEDOM = 1e6  # degrees of freedom that stand for infinitely many
SCATTER_QUANTILES = (np.arange(400) + 0.5) / 400  # of the scale of the scatter, over which p is averaged


def p_of_error(clusters: Sequence[Cluster], tested_rows: Sequence[Sequence[int]]) -> float | None:
    """p-value of the error of a model under the hypothesis that it is right; None without tested repeats or scatter.

    Args:
        clusters: All conditions, with the residuals of the model.
        tested_rows: Repeats whose error is tested, by condition; the scatter is from the contrasts among all repeats.
    """
    q, expected_systematic, expected_scatter = 0.0, 0.0, 0.0  # Q, and E without and with scatter
    squares = np.zeros(3)  # tr V^2 by powers of the scatter
    scatter_variance = 0.0  # tr (sum_c S / n_c)^2 / m
    by_group: dict[str, list[Array]] = defaultdict(list)  # products of patterns, by conditions that share amplitudes
    for layout in dict.fromkeys(cluster.layout for cluster in clusters):
        of_layout = [
            (cluster, list(rows))
            for cluster, rows in zip(clusters, tested_rows, strict=True)
            if cluster.layout == layout
        ]
        contrasts = np.vstack(
            [scipy.linalg.helmert(cluster.count) @ (cluster.sigma * cluster.residuals) for cluster, _ in of_layout]
        )
        if not (count := len(contrasts)):
            continue
        root_sum = 0.0
        for cluster, rows in of_layout:
            if not rows:
                continue
            systematic_share = np.sqrt(np.maximum(1.0 - np.square(cluster.pure_error), 0.0))  # u / sigma
            weight = np.divide(1.0, systematic_share, out=np.zeros_like(systematic_share), where=systematic_share > 0.0)
            weight /= np.sqrt(systematic_share.size)
            scatter = weight * contrasts / cluster.sigma / np.sqrt(count * len(rows))
            limit = cluster.limit_squares * np.square(weight)
            shared = weight * _shared(cluster)
            square, systematic = _trace_of_square(scatter, count), shared.T @ shared + np.diag(limit)
            q += float(np.sum(np.square(weight * cluster.residuals[rows].mean(axis=0))))
            expected_systematic += float(np.trace(systematic))
            expected_scatter += float(np.sum(np.square(scatter)))
            cross_term = float(np.sum(scatter @ systematic * (2.0 * scatter)))
            squares += (float(np.sum(np.square(systematic))), cross_term, square)
            root_sum += np.sqrt(square)
            by_group[cluster.discrepancy_group].append(shared @ shared.T)
        scatter_variance += root_sum**2 / count
    for group in by_group.values():
        squares[0] += sum(2.0 * float(np.sum(a * b)) for a, b in itertools.combinations(group, 2))
    if not expected_systematic + expected_scatter:
        return None
    freedom = min(expected_scatter**2 / max(scatter_variance, 1e-300), MAX_FREEDOM)
    scale = freedom / scipy.special.chdtri(freedom, SCATTER_QUANTILES) if scatter_variance else np.ones(1)
    expected = expected_systematic + scale * expected_scatter
    directions = np.square(expected) / np.maximum(np.polynomial.polynomial.polyval(scale, squares), 1e-300)  # g
    return float(np.mean(scipy.special.chdtrc(directions, directions * q / expected)))


def _shared(cluster: Cluster) -> Array:
    """Patterns P: changes of the scaled residuals by one standard deviation of each shared amplitude, ``(k, F)``."""
    return (
        cluster.discrepancy_factor
        if cluster.calibrations is None
        else np.vstack((cluster.discrepancy_factor, cluster.calibrations))
    )


def _trace_of_square(rows: Array, count: int) -> float:
    """Unbiased tr S^2 (see the module) of the covariance S = rows^T rows, with rows ``(m, F)``."""
    gram = rows @ rows.T
    measured, trace = float(np.sum(np.square(gram))), float(np.trace(gram))
    if count == 1:
        return measured
    unbiased = count**2 / ((count - 1) * (count + 2)) * (measured - trace**2 / count)
    return measured / count + (1.0 - 1.0 / count) * max(unbiased, 0.0)


def p_in_words(p_value: float) -> str:
    """A p-value in words, with a lower bound: the tails of the noise of a real robot are not known."""
    return f"p = {p_value:.2g}" if p_value >= MIN_REPORTED_P else f"p < {MIN_REPORTED_P}"
