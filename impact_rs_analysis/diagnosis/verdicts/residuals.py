# SPDX-License-Identifier: Apache-2.0
"""Residuals in reports: size, test against noise, and breakdown by signal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.document import RestDocument
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.thresholds import MAX_NOISE_RATIO
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.levels import expected_of
from impact_rs_sim.robots.robot import Array

MAX_RESIDUALS = 10  # in a document


def residual_size(evidence: Evidence, rest: Sequence[Array]) -> float:
    """Size of residuals in reports: multiples of repeatability [-], or root mean square in the unit of the source.

    Args:
        evidence: The clusters.
        rest: Mean residual of each, ``(F,)`` [-].
    """
    if evidence.source.repeated:
        return evidence.size(np.array([float(np.mean(np.square(values))) for values in rest]))
    weight = evidence.source.residual_weight
    weighted = [values * weight(item) for item, values in zip(evidence.clusters, rest, strict=True)]
    return float(np.sqrt(np.mean(np.square(np.concatenate(weighted)))))


def noise_size(evidence: Evidence) -> float:
    """:func:`residual_size` of noise alone."""
    if evidence.source.repeated:
        return 1.0
    return residual_size(evidence, [item.pure_error for item in evidence.clusters])


def residual_unit(evidence: Evidence) -> str:
    """Unit of :func:`residual_size`."""
    return TIMES if evidence.source.repeated else evidence.source.residual_unit


def exceeds_noise(evidence: Evidence, rest: Sequence[Array]) -> bool:
    """Whether residuals without repeats exceed noise and calibrations ``MAX_NOISE_RATIO`` times, in some signal.

    A torque of 50 N m whose scale is uncertain by 1 % leaves 0.5 N m that no effect has to explain. A signal of unknown
    noise (0) is not tested.

    Args:
        evidence: The clusters.
        rest: Mean residual of each, ``(F,)`` [-].
    """
    exact = [np.zeros_like(item.sigma) for item in evidence.clusters]
    moved = [
        none if item.calibrations is None else np.sum(np.square(item.calibrations), axis=0)
        for item, none in zip(evidence.clusters, exact, strict=True)
    ]
    for own in evidence.signals:
        squares, noise, unsure = (
            np.mean(np.concatenate([values[mask] for values, mask in zip(rows, own, strict=True)]))
            for rows in ([np.square(row) for row in rest], [item.expected_squares for item in evidence.clusters], moved)
        )
        if noise > 0.0 and squares > MAX_NOISE_RATIO**2 * (noise + unsure):
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


def beyond_stated_noise(evidence: Evidence, rest: Sequence[Array], fitted: int = 0) -> float:
    """p-value of lack of fit with stated noise: chi-square tests of every signal and of all together.

    With the noise p_i and the discrepancy d_i of a residual r_i the statistic is T = sum r_i^2 / (p_i^2 + d_i^2), and
    a_i = p_i^2 / (p_i^2 + d_i^2). Noise is independent; discrepancies may all be one and the same amplitude. So T has
    the mean N and at most the variance 2 (sum a_i^2 + (sum 1 - a_i)^2), and is compared with the scaled chi-square of
    that mean and variance (Satterthwaite 1946, Biometrics Bulletin 2): without discrepancy that of N degrees of
    freedom. The smallest p is multiplied by the number of tests (Bonferroni).

    Args:
        evidence: The clusters of a table.
        rest: Mean residual of each, ``(F,)`` [-].
        fitted: Number of fitted parameters, subtracted from the degrees of freedom in proportion to N of each test.
    """
    signals: list[tuple[str, str]] = []
    squares, shares = [], []
    for item, values in zip(evidence.clusters, rest, strict=True):
        known = item.pure_error > 0.0
        expected = item.expected_squares[known]
        signals += [(f.signal, f.index) for f, own in zip(item.features, known, strict=True) if own]
        squares.append(np.square(values[known]) / expected)
        shares.append(np.square(item.pure_error[known]) / item.count / expected)
    statistic, share = np.concatenate(squares), np.concatenate(shares)
    left = max(1.0 - fitted / statistic.size, 1.0 / statistic.size)
    p_values = []
    for own in (np.ones(statistic.size, dtype=bool), *(np.array([s == one for s in signals]) for one in set(signals))):
        mean = left * np.count_nonzero(own)
        spread = 2.0 * (left * np.sum(np.square(share[own])) + np.sum(1.0 - share[own]) ** 2)
        p_values.append(float(scipy.stats.chi2.sf(2.0 * mean * statistic[own].sum() / spread, 2.0 * mean**2 / spread)))
    return min(1.0, len(p_values) * min(p_values))


def rests_of(evidence: Evidence, rest: Sequence[Array]) -> list[RestDocument]:
    """Remaining residuals by phase, signal and index, largest share first, in the multiples of a comparison."""
    by_limit = evidence.source.kind == "trials" and evidence.source.noise_size() is None
    squares: dict[tuple[str, str, str], list[tuple[float, float, float, float]]] = {}
    facts: dict[tuple[str, str, str], tuple[str, float]] = {}
    for item, values in zip(evidence.clusters, rest, strict=True):
        expected, times = item.expected_squares, values / expected_of(item, by_limit)
        for feature, value, noise, sigma, own in zip(item.features, values, expected, item.sigma, times, strict=True):
            squares.setdefault(feature.group, []).append((float(value**2), float(noise), float(sigma), float(own)))
            facts[feature.group] = (feature.unit, feature.relevance_limit)
    total = sum(row[0] for rows in squares.values() for row in rows)
    found = []
    for (phase, signal, index), rows in squares.items():
        table = np.array(rows)
        excess = float(np.mean((table[:, 0] - table[:, 1]) * table[:, 2] ** 2))
        unit, limit = facts[phase, signal, index]
        found.append(
            RestDocument(
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
    return sorted(found, key=lambda entry: -entry.share)
