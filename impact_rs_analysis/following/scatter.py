# SPDX-License-Identifier: Apache-2.0
"""Scatter of hits about their condition, from the first of them: covariance, and what it takes to whiten them.

    R = D ((1 - a) C + a I) D + diag((l / 2)^2)

with the standard deviations D of the repeats (no less than the noise that a measurement states), their correlations C,
the relevance limits l, and the share a of Schaefer and Strimmer (2005, *A shrinkage approach to large-scale covariance
matrix estimation*), which is large where hits are few beside features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.robot import Array

LEAST = 1e-9  # of the largest standard deviation of the same unit; a feature that never moves is no certainty


@dataclass(frozen=True)
class HitScatter:
    """Covariance of the hits of one layout.

    Attributes:
        whiten: W with W R W^T = 1, ``(F, F)``.
        sigma: Standard deviation of each feature, relevance limits included, in its unit, ``(F,)``.
    """

    whiten: Array
    sigma: Array


def scatter_of(deviations: Array, freedom: int, stated: Array, limits: Array) -> HitScatter:
    """Scatter of hits, from their deviations.

    Args:
        deviations: Measured minus the mean of the condition, ``(n, F)``.
        freedom: Degrees of freedom of them.
        stated: Standard deviations that measurements state themselves; 0: none, ``(F,)``.
        limits: Relevance limits, ``(F,)``.
    """
    spread = np.sqrt(np.sum(np.square(deviations), axis=0) / max(freedom, 1))
    safe = np.where(spread > 0.0, spread, 1.0)
    correlation = _shrunk(deviations / safe, freedom)
    spread = np.maximum(spread, stated)
    covariance = correlation * np.outer(spread, spread) + np.diag(np.square(limits / 2.0))
    diagonal = np.diag(covariance)
    floor = LEAST * float(diagonal.max() or 1.0)
    covariance = covariance + np.diag(np.where(diagonal < floor, floor, 0.0))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    return HitScatter(whiten, np.sqrt(np.diag(covariance)))


def _shrunk(scaled: Array, freedom: int) -> Array:
    """Correlations of deviations with unit variance, shrunk towards none, ``(F, F)``."""
    size = scaled.shape[1]
    if freedom < 2:
        return np.eye(size)
    found = scaled.T @ scaled / freedom
    squares = np.square(scaled).T @ np.square(scaled)
    # Variance of a mean of n products: their scatter about it over n (n - 1), with n the degrees of freedom.
    variance = np.maximum(squares - freedom * np.square(found), 0.0) / (freedom * (freedom - 1.0))
    apart = ~np.eye(size, dtype=bool)
    total = float(np.sum(np.square(found[apart])))
    share = 1.0 if total <= 0.0 else float(np.clip(np.sum(variance[apart]) / total, 0.0, 1.0))
    shrunk = (1.0 - share) * found
    np.fill_diagonal(shrunk, 1.0)
    return np.asarray(shrunk)


def deviations_of(residuals: Sequence[Array], conditions: Sequence[str]) -> tuple[Array, int]:
    """Residuals minus the mean of their condition, and their degrees of freedom.

    Args:
        residuals: Of every hit, ``(F,)``.
        conditions: Condition of each; those that repeat nothing are taken together.
    """
    rows = np.array(residuals)
    names = np.array(conditions)
    repeated = {name for name in conditions if name and np.sum(names == name) > 1}
    grouped = np.array([name if name in repeated else "" for name in conditions])
    alone = not repeated
    found, freedom = [], 0
    for name in dict.fromkeys(grouped.tolist()):
        own = rows[grouped == name]
        if not name and not alone:
            continue  # hits that repeat nothing, beside hits that do
        found.append(own - own.mean(axis=0))
        freedom += len(own) - 1
    return np.concatenate(found), freedom
