# SPDX-License-Identifier: Apache-2.0
"""Log likelihood ratios with an estimated scale of the noise: Student's t in place of the normal distribution.

The scale of the noise is estimated with nu degrees of freedom. With the squared Mahalanobis distance T of p numbers
from their prediction, and the determinant of their covariance, in units of the estimated noise, the log density is, up
to a constant,

    log t = -1/2 log det - (nu + p) / 2 log(1 + T / nu)

With information I and score S of parameters that change by eta ~ N(0, W^2), the log likelihood ratio against no change
is

    log LR = -1/2 log det(1 + W I W) + (nu + p) / 2 [log(1 + T_0 / nu) - log(1 + T_1 / nu)]
    T_0 = S^T I^-1 S,        T_1 = T_0 - S^T (I + W^-2)^-1 S

(Student 1908; for a normal density nu is infinite). The mean of LR without a change is 1.
"""

from __future__ import annotations

import math

import numpy as np

from impact_rs_sim.robots.robot import Array

DECISIVE_LIKELIHOOD_RATIO = 20.0  # likelihood ratio beyond which one explanation stands and the other does not
MIN_INFORMATION_SHARE = 1e-9  # of the largest information; smaller eigenvalues are rounding errors


def log_density(square: float, log_determinant: float, size: int, freedom: float) -> float:
    """Log density of p numbers, up to a constant.

    Args:
        square: T [-].
        log_determinant: Log of the determinant of their covariance.
        size: p.
        freedom: nu.
    """
    return -0.5 * log_determinant - 0.5 * (freedom + size) * math.log1p(square / freedom)


def squared_distance(residual: Array, covariance: Array, inflation: float = 1.0) -> float:
    """Squared Mahalanobis distance T of a residual ``(F,)`` with a covariance ``inflation`` times ``(F, F)`` [-]."""
    return float(residual @ np.linalg.solve(covariance, residual)) / inflation


def log_ratio(explained: float, log_determinant: float, size: int, freedom: float) -> float:
    """Log likelihood ratio of p parameters at their best fit, from the fall of the squared residuals.

    Args:
        explained: T_0 - T_1 [-].
        log_determinant: log det(1 + W I W).
        size: p.
        freedom: nu.
    """
    return log_density(0.0, log_determinant, size, freedom) - log_density(max(explained, 0.0), 0.0, size, freedom)


def log_ratios(information: Array, score: Array, width: float, freedom: float) -> Array:
    """Log LR of several cases, ``(s,)``.

    Args:
        information: I, ``(s, p, p)``.
        score: S, ``(s, p)``.
        width: W.
        freedom: nu.
    """
    before, after, log_determinant, rank = squares(information, score, width)
    ratio = np.log1p(before / freedom) - np.log1p(after / freedom)
    return np.asarray(0.5 * (freedom + rank) * ratio - 0.5 * log_determinant)


def squares(information: Array, score: Array, width: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """T_0, T_1, log det(1 + W I W) and the rank of I of several cases, ``(s,)`` each; as :func:`log_ratios`."""
    values, vectors = np.linalg.eigh(width**2 * information)
    along = np.square(width * np.einsum("spq,sp->sq", vectors, score))
    values = np.maximum(values, 0.0)
    informative = values > MIN_INFORMATION_SHARE * np.maximum(values[:, -1:], 1.0)
    before = np.sum(np.divide(along, values, out=np.zeros_like(along), where=informative), axis=1)
    after = np.sum(np.divide(along, values * (1.0 + values), out=np.zeros_like(along), where=informative), axis=1)
    return before, after, np.sum(np.log1p(values * informative), axis=1), informative.sum(axis=1)
