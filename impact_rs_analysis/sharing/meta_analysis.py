# SPDX-License-Identifier: Apache-2.0
"""Random-effects meta-analysis of one parameter: estimates y_i with standard errors s_i of k studies.

    y_i = mu + u_i + e_i,   u_i ~ N(0, tau^2),   e_i ~ N(0, s_i^2)

    w_i   = 1 / s_i^2,  W = sum w_i,  m = sum w_i y_i / W
    Q     = sum w_i (y_i - m)^2                                          heterogeneity; chi^2 (k - 1) at tau = 0
    tau^2 = max(0, (Q - (k - 1)) / (W - sum w_i^2 / W))                  DerSimonian and Laird 1986
    mu    = sum w*_i y_i / W*,  w*_i = 1 / (s_i^2 + tau^2)
    q     = sum w*_i (y_i - mu)^2 / (k - 1)                              Hartung 1999
    half  = max(t sqrt(q / W*), z / sqrt(W*)), Student's t of k - 1      Knapp and Hartung 2003

The second half width is due to DerSimonian and Laird: a few studies may agree by chance better than their errors allow,
and q alone then gives an interval that is too short. Wiksten, Ruecker and Schwarzer (Statistics in Medicine 35:2503,
2016) ask for the wider of both; with a lower limit of 1 for q instead, the coverage for five studies or fewer is 96 to
100 %.

An outlier has a large studentised leave-one-out residual (Viechtbauer and Cheung 2010),

    r = (y - mu) / sqrt(s^2 + tau^2 + 1 / W*)                            if the others differ (p of Q <= 0.05)
    r = (y - m) / sqrt(h^2 (s^2 + 1 / W))                                otherwise

with mu, tau, W* of the other studies. A few studies determine tau poorly, and it is often 0 by chance; h^2 >= 1 is the
mean of Q / (k - 1) over all parameters in which the others do not differ; their k - 1 add up to the degrees of freedom
of Student's t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from impact_rs_sim.numbers import CONFIDENCE_LEVEL
from impact_rs_sim.robots.robot import Array

MAX_HETEROGENEITY_P = 0.05  # up to this p of Q, a residual uses tau of the others


@dataclass(frozen=True)
class Pooled:
    """Pooled estimate of several studies.

    Attributes:
        mean: mu.
        low: Lower end of its interval at ``CONFIDENCE_LEVEL``.
        high: Upper end.
        tau: Standard deviation between studies.
        q: Heterogeneity Q.
        p_value: p of Q if studies do not differ (tau = 0); 1 for a single study.
        studies: k.
    """

    mean: float
    low: float
    high: float
    tau: float
    q: float
    p_value: float
    studies: int

    @property
    def inconsistency(self) -> float:
        """I^2, share of the variance of the estimates that is due to deviations between studies [-]."""
        return max(0.0, (self.q - (self.studies - 1)) / self.q) if self.q > 0.0 else 0.0


def pool(values: Sequence[float], errors: Sequence[float]) -> Pooled:
    """Pooled mean with its interval; a single study keeps its estimate and interval.

    Args:
        values: y, k numbers.
        errors: s > 0, k numbers.
    """
    y, s = np.asarray(values, dtype=float), np.asarray(errors, dtype=float)
    count = y.size
    if count == 1:
        half = float(scipy.stats.norm.ppf(0.5 + CONFIDENCE_LEVEL / 2.0) * s[0])
        return Pooled(float(y[0]), float(y[0]) - half, float(y[0]) + half, 0.0, 0.0, 1.0, 1)
    q, tau = _heterogeneity(y, s)
    weight = 1.0 / (s**2 + tau**2)
    mean = float(weight @ y / weight.sum())
    dispersion = float(weight @ (y - mean) ** 2) / (count - 1)
    upper = 0.5 + CONFIDENCE_LEVEL / 2.0
    factor = max(scipy.stats.t.ppf(upper, count - 1) * np.sqrt(dispersion), scipy.stats.norm.ppf(upper))
    half = float(factor / np.sqrt(weight.sum()))
    p_value = float(scipy.stats.chi2.sf(q, count - 1))
    return Pooled(mean, mean - half, mean + half, tau, q, p_value, count)


def residual(
    value: float, error: float, others: Sequence[float], errors: Sequence[float], dispersion: float = 1.0
) -> float:
    """Studentised leave-one-out residual of a study [-]; nan with fewer than two other studies.

    Args:
        value: y of the study.
        error: s of the study.
        others: y of the other studies.
        errors: s of the other studies.
        dispersion: h^2.
    """
    y, s = np.asarray(others, dtype=float), np.asarray(errors, dtype=float)
    if y.size < 2:
        return float("nan")
    _, tau, differ = heterogeneity(others, errors)
    weight = 1.0 / (s**2 + tau**2) if differ else 1.0 / s**2
    variance = error**2 + 1.0 / weight.sum()
    variance = variance + tau**2 if differ else max(dispersion, 1.0) * variance
    return float((value - weight @ y / weight.sum()) / np.sqrt(variance))


def heterogeneity(values: Sequence[float], errors: Sequence[float]) -> tuple[float, float, bool]:
    """Q, tau, and whether studies differ."""
    q, tau = _heterogeneity(np.asarray(values, dtype=float), np.asarray(errors, dtype=float))
    return q, tau, len(values) > 1 and float(scipy.stats.chi2.sf(q, len(values) - 1)) <= MAX_HETEROGENEITY_P


def within_groups(values: Sequence[float], errors: Sequence[float], groups: Sequence[str]) -> tuple[float, int]:
    """Heterogeneity within groups of studies, and its degrees of freedom."""
    y, s, names = np.asarray(values, dtype=float), np.asarray(errors, dtype=float), np.asarray(groups)
    q, degrees_of_freedom = 0.0, 0
    for name in np.unique(names):
        in_group = names == name
        if in_group.sum() > 1:
            q += _heterogeneity(y[in_group], s[in_group])[0]
            degrees_of_freedom += int(in_group.sum()) - 1
    return q, degrees_of_freedom


def _heterogeneity(y: Array, s: Array) -> tuple[float, float]:
    """Q and tau."""
    weight = 1.0 / s**2
    total = weight.sum()
    mean = weight @ y / total
    q = float(weight @ (y - mean) ** 2)
    spread = total - (weight @ weight) / total
    return q, float(np.sqrt(max(0.0, (q - (y.size - 1)) / spread))) if y.size > 1 else 0.0
