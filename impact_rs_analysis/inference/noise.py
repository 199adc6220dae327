# SPDX-License-Identifier: Apache-2.0
"""Noise covariance of residuals, and its whitening transform.

The mean of n repeats has the covariance

    R_n = R / n + diag(o)

with the covariance R of a repeat about its condition and the variance o of each feature that repeats do not average:
half the relevance limit, and the part of the model discrepancy that no measured pattern spans. From few repeats

    R = D ((1 - a) C + a I) D

with their standard deviations D, their correlations C, and the shrinkage intensity a of Schaefer and Strimmer (2005, *A
shrinkage approach to large-scale covariance matrix estimation*), which is large for few repeats of many features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_analysis.evidence.cluster import INDEPENDENT_DISCREPANCY_SHARE, Cluster
from impact_rs_sim.robots.robot import Array

MIN_VARIANCE_SHARE = 1e-9  # of the largest variance; a feature without scatter is not known exactly


@dataclass(frozen=True)
class Noise:
    """Noise of the measurements of one layout.

    Attributes:
        repeats: Covariance of a repeat about its condition, ``(F, F)``, or its diagonal, ``(F,)``.
        unaveraged: Variance of each feature that repeats do not average, ``(F,)``.
    """

    repeats: Array
    unaveraged: Array

    def whitening(self, count: int = 1) -> Array:
        """W with W R_n W^T = 1, ``(F, F)``.

        Args:
            count: Number n of repeats.
        """
        diagonal = (self.repeats if self.repeats.ndim == 1 else np.diag(self.repeats)) / count + self.unaveraged
        floor = MIN_VARIANCE_SHARE * float(diagonal.max(initial=0.0) or 1.0)
        diagonal = np.where(diagonal < floor, diagonal + floor, diagonal)
        if self.repeats.ndim == 1:
            return np.diag(1.0 / np.sqrt(diagonal))
        covariance = self.repeats / count
        np.fill_diagonal(covariance, diagonal)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def noise_of(item: Cluster) -> Noise:
    """Noise of the scaled features of a condition, with the part of the discrepancy outside its patterns."""
    outside = 1.0 if item.patterns is None else INDEPENDENT_DISCREPANCY_SHARE
    return Noise(np.square(item.pure_error), item.limit_squares + outside * np.square(item.discrepancy))


def repeats_of(deviations: Array, freedom: int, stated: Array) -> Array:
    """Covariance R of repeats, ``(F, F)``.

    Args:
        deviations: Measured minus the mean of the condition, ``(n, F)``.
        freedom: Their degrees of freedom.
        stated: Standard deviations stated with the measurements, a lower limit; 0: not stated, ``(F,)``.
    """
    spread = np.sqrt(np.sum(np.square(deviations), axis=0) / max(freedom, 1))
    scaled = deviations / np.where(spread > 0.0, spread, 1.0)
    spread = np.maximum(spread, stated)
    return _shrunk(scaled, freedom) * np.outer(spread, spread)


def _shrunk(scaled: Array, freedom: int) -> Array:
    """Shrinkage estimate of the correlations of standardised deviations, ``(F, F)`` (Schaefer and Strimmer 2005)."""
    size = scaled.shape[1]
    if freedom < 2:
        return np.eye(size)
    correlations = scaled.T @ scaled / freedom
    squares = np.square(scaled).T @ np.square(scaled)
    # Variance of a mean of n products: their scatter about it over n (n - 1), with n the degrees of freedom.
    variance = np.maximum(squares - freedom * np.square(correlations), 0.0) / (freedom * (freedom - 1.0))
    apart = ~np.eye(size, dtype=bool)
    total = float(np.sum(np.square(correlations[apart])))
    share = 1.0 if total <= 0.0 else float(np.clip(np.sum(variance[apart]) / total, 0.0, 1.0))
    shrunk = (1.0 - share) * correlations
    np.fill_diagonal(shrunk, 1.0)
    return np.asarray(shrunk)


def deviations_of(residuals: Sequence[Array], conditions: Sequence[str], least: int = 1) -> tuple[Array, int]:
    """Residuals minus the mean of their condition, ``(n, F)``, and their degrees of freedom.

    Args:
        residuals: Residuals of every measurement, ``(F,)``.
        conditions: Condition of each; empty: it repeats nothing.
        least: Minimum degrees of freedom. If repeats have fewer, measurements without a repeat form one more group.
    """
    rows, names = np.array(residuals), np.array(conditions)
    repeated = [name for name in dict.fromkeys(conditions) if name and np.sum(names == name) > 1]
    groups = [rows[names == name] for name in repeated]
    single = rows[~np.isin(names, repeated)]
    if not groups or sum(len(group) - 1 for group in groups) < least and len(single):
        groups.append(single)
    return np.concatenate([group - group.mean(axis=0) for group in groups]), sum(len(group) - 1 for group in groups)
