# SPDX-License-Identifier: Apache-2.0
"""Goodness-of-fit test: is the error of a model consistent with a right model?

The statistic is the sum over conditions c of the mean square of their mean residuals,

    Q = sum_c |r_c|^2 / F_c

with each of the F_c features in units of its tolerance u^2 = (l / 2)^2 + d^2, with the relevance limit l and the
discrepancy d. The unit excludes the scatter, whose estimate from few repeats is often far too small. Under a right
model the mean of n_c repeats has the covariance

    V_c = S / n_c + P_c^T P_c + diag(l^2 / 4 u^2)

with the scatter S and the patterns P of discrepancy and clock, whose amplitudes conditions share that are alike. For a
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


def p_of_error(clusters: Sequence[Cluster], tested: Sequence[Sequence[int]]) -> float | None:
    """p-value of the error of a model, if it is right; None: nothing is tested, or no repeats say what scatter is.

    Args:
        clusters: All conditions, with the residuals of the model.
        tested: By condition, the repeats whose error is tested; contrasts among all of them count.
    """
    error, fixed, scattered = 0.0, 0.0, 0.0  # Q, and E without and with scatter
    squares = np.zeros(3)  # tr V^2 by powers of the scatter
    uncertain = 0.0  # tr (sum_c S / n_c)^2 / m
    together: dict[str, list[Array]] = defaultdict(list)  # products of patterns, by conditions that share amplitudes
    for layout in dict.fromkeys(item.layout for item in clusters):
        own = [(item, list(rows)) for item, rows in zip(clusters, tested, strict=True) if item.layout == layout]
        contrasts = np.vstack([scipy.linalg.helmert(item.count) @ (item.sigma * item.residuals) for item, _ in own])
        if not (count := len(contrasts)):
            continue
        spread = 0.0
        for item, rows in own:
            if not rows:
                continue
            own_share = np.sqrt(np.maximum(1.0 - np.square(item.pure_error), 0.0))  # u / sigma
            weight = np.divide(1.0, own_share, out=np.zeros_like(own_share), where=own_share > 0.0)
            weight /= np.sqrt(own_share.size)
            scatter = weight * contrasts / item.sigma / np.sqrt(count * len(rows))
            limit = item.limit_squares * np.square(weight)
            shared = weight * _shared(item)
            square, systematic = _trace_of_square(scatter, count), shared.T @ shared + np.diag(limit)
            error += float(np.sum(np.square(weight * item.residuals[rows].mean(axis=0))))
            fixed += float(np.trace(systematic))
            scattered += float(np.sum(np.square(scatter)))
            mixed = float(np.sum(scatter @ systematic * (2.0 * scatter)))
            squares += (float(np.sum(np.square(systematic))), mixed, square)
            spread += np.sqrt(square)
            together[item.discrepancy_group].append(shared @ shared.T)
        uncertain += spread**2 / count
    for group in together.values():
        squares[0] += sum(2.0 * float(np.sum(a * b)) for a, b in itertools.combinations(group, 2))
    if not fixed + scattered:
        return None
    freedom = min(scattered**2 / max(uncertain, 1e-300), MAX_FREEDOM)
    scale = freedom / scipy.special.chdtri(freedom, SCATTER_QUANTILES) if uncertain else np.ones(1)
    expected = fixed + scale * scattered
    directions = np.square(expected) / np.maximum(np.polynomial.polynomial.polyval(scale, squares), 1e-300)  # g
    return float(np.mean(scipy.special.chdtrc(directions, directions * error / expected)))


def _shared(item: Cluster) -> Array:
    """Changes of its scaled residuals by one standard deviation of what conditions share, ``(k, F)``."""
    return (
        item.discrepancy_factor
        if item.calibrations is None
        else np.vstack((item.discrepancy_factor, item.calibrations))
    )


def _trace_of_square(rows: Array, count: int) -> float:
    """tr S^2 of the module for a covariance that is the sum of the products of rows, ``(m, F)``."""
    gram = rows @ rows.T
    measured, trace = float(np.sum(np.square(gram))), float(np.trace(gram))
    if count == 1:
        return measured
    unbiased = count**2 / ((count - 1) * (count + 2)) * (measured - trace**2 / count)
    return measured / count + (1.0 - 1.0 / count) * max(unbiased, 0.0)


def p_in_words(p_value: float) -> str:
    """A p-value, bounded where the tails of a real robot's noise are not known."""
    return f"p = {p_value:.2g}" if p_value >= MIN_REPORTED_P else f"p < {MIN_REPORTED_P}"
