# SPDX-License-Identifier: Apache-2.0
"""Residuals in reports: size, test against noise, and breakdown by signal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.document import ResidualDocument
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.thresholds import MAX_NOISE_RATIO
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.levels import expected_of
from impact_rs_sim.robots.robot import Array

MAX_RESIDUALS = 10  # in a document


def residual_size(evidence: Evidence, residuals: Sequence[Array]) -> float:
    """Size of residuals in reports: multiples of repeatability [-], or root mean square in the unit of the source.

    Args:
        evidence: The clusters.
        residuals: Mean residual of each cluster, ``(F,)`` [-].
    """
    if evidence.source.repeated:
        return evidence.size(np.array([float(np.mean(np.square(values))) for values in residuals]))
    weight = evidence.source.residual_weight
    weighted = [values * weight(item) for item, values in zip(evidence.clusters, residuals, strict=True)]
    return float(np.sqrt(np.mean(np.square(np.concatenate(weighted)))))


def noise_size(evidence: Evidence) -> float:
    """:func:`residual_size` of noise alone."""
    if evidence.source.repeated:
        return 1.0
    return residual_size(evidence, [item.pure_error for item in evidence.clusters])


def residual_unit(evidence: Evidence) -> str:
    """Unit of :func:`residual_size`."""
    return TIMES if evidence.source.repeated else evidence.source.residual_unit


def exceeds_noise(evidence: Evidence, residuals: Sequence[Array]) -> bool:
    """Whether residuals without repeats exceed ``MAX_NOISE_RATIO`` times noise and calibrations in some signal.

    A torque of 50 N m with a scale uncertain by 1 % has a residual of 0.5 N m that no effect needs to explain. A signal
    of unknown noise (0) is not tested.

    Args:
        evidence: The clusters.
        residuals: Mean residual of each cluster, ``(F,)`` [-].
    """
    zeros = [np.zeros_like(item.sigma) for item in evidence.clusters]
    calibration_squares = [
        zero if item.calibrations is None else np.sum(np.square(item.calibrations), axis=0)
        for item, zero in zip(evidence.clusters, zeros, strict=True)
    ]
    for masks in evidence.noise_masks:
        squares, noise, calibration = (
            np.mean(np.concatenate([values[mask] for values, mask in zip(rows, masks, strict=True)]))
            for rows in (
                [np.square(row) for row in residuals],
                [item.expected_squares for item in evidence.clusters],
                calibration_squares,
            )
        )
        if noise > 0.0 and squares > MAX_NOISE_RATIO**2 * (noise + calibration):
            return True
    return False


def stated_signals(evidence: Evidence) -> set[tuple[str, str]]:
    """Signals of a table without repeats whose noise is stated, each with its axis or joint.

    Args:
        evidence: The clusters.
    """
    if evidence.source.repeated or evidence.source.of_motion:
        return set()
    pairs = ((f, pure) for item in evidence.clusters for f, pure in zip(item.features, item.pure_error, strict=True))
    return {(feature.signal, feature.index) for feature, pure in pairs if pure > 0.0}


def beyond_stated_noise(evidence: Evidence, residuals: Sequence[Array], fitted: int = 0) -> float:
    """p-value of lack of fit with stated noise: chi-square tests of every signal and of all together.

    With the noise p_i and the discrepancy d_i of a residual r_i the statistic is T = sum r_i^2 / (p_i^2 + d_i^2), and
    a_i = p_i^2 / (p_i^2 + d_i^2). Noise is independent; discrepancies may have one common amplitude. So T has the mean
    N and at most the variance 2 (sum a_i^2 + (sum 1 - a_i)^2), and is compared with a scaled chi-square of this mean
    and variance (Satterthwaite 1946, Biometrics Bulletin 2), which has N degrees of freedom without discrepancy. The
    smallest p-value is multiplied by the number of tests (Bonferroni).

    Args:
        evidence: The clusters of a table.
        residuals: Mean residual of each cluster, ``(F,)`` [-].
        fitted: Number of fitted parameters, subtracted from the degrees of freedom in proportion to N of each test.
    """
    signals: list[tuple[str, str]] = []
    squares, shares = [], []
    for item, values in zip(evidence.clusters, residuals, strict=True):
        stated = item.pure_error > 0.0
        expected = item.expected_squares[stated]
        signals += [(f.signal, f.index) for f, is_stated in zip(item.features, stated, strict=True) if is_stated]
        squares.append(np.square(values[stated]) / expected)
        shares.append(np.square(item.pure_error[stated]) / item.count / expected)
    statistic, share = np.concatenate(squares), np.concatenate(shares)
    freedom_share = max(1.0 - fitted / statistic.size, 1.0 / statistic.size)
    p_values = []
    for tested in (
        np.ones(statistic.size, dtype=bool),
        *(np.array([s == name for s in signals]) for name in set(signals)),
    ):
        mean = freedom_share * np.count_nonzero(tested)
        spread = 2.0 * (freedom_share * np.sum(np.square(share[tested])) + np.sum(1.0 - share[tested]) ** 2)
        p_values.append(
            float(scipy.stats.chi2.sf(2.0 * mean * statistic[tested].sum() / spread, 2.0 * mean**2 / spread))
        )
    return min(1.0, len(p_values) * min(p_values))


def residuals_by_signal(evidence: Evidence, residuals: Sequence[Array]) -> list[ResidualDocument]:
    """Residuals by phase, signal and index, largest share first; multiples of noise are as in a comparison."""
    by_limit = evidence.source.kind == "trials" and evidence.source.noise_size() is None
    squares: dict[tuple[str, str, str], list[tuple[float, float, float, float]]] = {}
    unit_and_limit: dict[tuple[str, str, str], tuple[str, float]] = {}
    for item, values in zip(evidence.clusters, residuals, strict=True):
        expected, times = item.expected_squares, values / expected_of(item, by_limit)
        for feature, value, noise, sigma, multiple in zip(
            item.features, values, expected, item.sigma, times, strict=True
        ):
            squares.setdefault(feature.group, []).append((float(value**2), float(noise), float(sigma), float(multiple)))
            unit_and_limit[feature.group] = (feature.unit, feature.relevance_limit)
    total = sum(row[0] for rows in squares.values() for row in rows)
    documents = []
    for (phase, signal, index), rows in squares.items():
        table = np.array(rows)
        excess = float(np.mean((table[:, 0] - table[:, 1]) * table[:, 2] ** 2))
        unit, limit = unit_and_limit[phase, signal, index]
        documents.append(
            ResidualDocument(
                phase=phase,
                signal=signal,
                index=index,
                value=math.sqrt(max(excess, 0.0)),
                unit=unit,
                floor=limit,
                share=float(table[:, 0].sum()) / max(total, 1e-300),
                times_noise=float(np.sqrt(np.mean(np.square(table[:, 3])))),
            )
        )
    return sorted(documents, key=lambda entry: -entry.share)
