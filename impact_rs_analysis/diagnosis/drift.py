# SPDX-License-Identifier: Apache-2.0
"""Drift: whether repeats of a condition change with the order in which they were measured.

Friction falls as a robot warms up, pads wear, a balance loses its zero. Repeats of a condition differ by time and noise
only. With t the rank of a run in the campaign and r its residuals, both minus their mean over the condition, a drift is
a slope

    beta_f = sum t r_f / sum t^2,        rho_f = (sum t r_f)^2 / (sum t^2 sum r_f^2)

of feature f. The squared correlation rho_f, averaged over the time bins of a signal, is free of scale. Its null
distribution is given by random directions among the repeats: under normal noise every direction is equally likely
(Langsrud 2005, *Rotation tests*), whatever the covariance of the features. The largest standardised rho of all signals
is compared with the largest in every direction, so that the family-wise level holds (Westfall and Young 1993,
*Resampling-based multiple testing*).

All repeats of a condition have one prediction, so a missing effect causes no drift. A drift, however, imitates an
effect unless conditions alternate: conditions measured one after the other are confounded with drift (Fisher 1935, *The
Design of Experiments*: randomise). The measure is the share of the variance of t between conditions: 1 - 1/C^2 for
C conditions one after the other, about (C - 1)/(N - 1) in random order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.document import DriftDocument
from impact_rs_analysis.diagnosis.search.null_distribution import monte_carlo_p_value
from impact_rs_analysis.diagnosis.thresholds import (
    MIN_CONFOUNDED_SHARE,
    MIN_DEGREES_OF_FREEDOM,
    MIN_REPORTED_P,
    NULL_DRAWS,
    SIGNIFICANCE_LEVEL,
)
from impact_rs_analysis.evidence.cluster import Cluster, Feature
from impact_rs_sim.robots.robot import Array


def drift_of(clusters: Sequence[Cluster]) -> DriftDocument | None:
    """The signal that drifts most; None if the order is unknown or there are too few repeats.

    Args:
        clusters: Residuals of any model by condition, with timestamps.
    """
    stamps = [item.timestamps for item in clusters if item.timestamps is not None]
    if len(stamps) < len(clusters) or sum(item.count - 1 for item in clusters) < MIN_DEGREES_OF_FREEDOM:
        return None
    order = scipy.stats.rankdata(np.concatenate(stamps))
    ranks = np.split(order, np.cumsum([item.count for item in clusters])[:-1])
    within = sum(float(np.sum(np.square(rank - rank.mean()))) for rank in ranks)
    if within == 0.0:  # timestamps too coarse to order any repeats
        return None
    repeated = [number for number, item in enumerate(clusters) if item.count > 1]
    groups = list(dict.fromkeys(feature.group for number in repeated for feature in clusters[number].features))
    correlation = np.zeros((1 + NULL_DRAWS, len(groups)))
    changes: dict[tuple[str, str, str], list[tuple[Feature, float]]] = {}
    rng = np.random.default_rng(0)
    for layout in dict.fromkeys(clusters[number].layout for number in repeated):
        chosen = [number for number in repeated if clusters[number].layout == layout]
        features = clusters[chosen[0]].features
        centred_ranks = _centred([ranks[number] for number in chosen])
        rows = _centred([clusters[number].residuals * clusters[number].sigma for number in chosen])
        draws = [rng.standard_normal((clusters[number].count, NULL_DRAWS)) for number in chosen]
        directions = np.column_stack((centred_ranks, _centred(draws)))
        powers = np.outer(np.sum(np.square(directions), axis=0), np.sum(np.square(rows), axis=0))
        rho = np.square(directions.T @ rows) / np.maximum(powers, 1e-300)
        slope = centred_ranks @ rows / max(float(centred_ranks @ centred_ranks), 1e-300) * float(np.ptp(order))
        for number, group in enumerate(groups):
            of_group = np.array([feature.group == group for feature in features])
            correlation[:, number] += rho[:, of_group].sum(axis=1)
            changes.setdefault(group, []).extend(
                (feature, float(value))
                for feature, value, belongs in zip(features, slope, of_group, strict=True)
                if belongs
            )
    standard = (correlation - correlation.mean(axis=0)) / np.maximum(correlation.std(axis=0), 1e-300)
    most = int(np.argmax(standard[0]))
    largest = standard.max(axis=1)
    entries = changes[groups[most]]
    values = np.array([value for _, value in entries])
    feature = entries[0][0]
    return DriftDocument(
        phase=feature.phase,
        signal=feature.signal,
        index=feature.index,
        change=float(np.sqrt(np.mean(np.square(values))) * (1.0 if values.sum() >= 0.0 else -1.0)),
        unit=feature.unit,
        runs=int(order.size),
        p_value=max(monte_carlo_p_value(float(largest[0]), largest[1:]), MIN_REPORTED_P),
        confounded=bool(1.0 - within / float(np.sum(np.square(order - order.mean()))) > MIN_CONFOUNDED_SHARE),
    )


def _centred(parts: Sequence[Array]) -> Array:
    """Concatenated rows, each minus the mean of its part."""
    return np.concatenate([part - part.mean(axis=0) for part in parts])


def low_confidence_sentence(drift: DriftDocument | None) -> str:
    """Sentence of the summary if a drift is confounded with the conditions; else empty."""
    if drift is None or not drift.confounded or drift.p_value >= SIGNIFICANCE_LEVEL:
        return ""
    return (
        f"Confidence is low: the {drift.signal} {drift.index} drifts, and conditions were measured one after the other."
    )


def drift_in_words(drift: DriftDocument | None) -> str:
    """Warning of a drift, or of an order of measurement that would hide one; empty: no warning."""
    if drift is None:
        return ""
    drifts = drift.p_value < SIGNIFICANCE_LEVEL
    change = (
        f"the {drift.signal} {drift.index} ({drift.phase}) {'rises' if drift.change > 0.0 else 'falls'} by "
        f"{abs(drift.change):.2g} {drift.unit} over the {drift.runs} runs of the campaign, in repeats of the same "
        f"condition (p {'<=' if drift.p_value <= MIN_REPORTED_P else '='} {drift.p_value:.2g})"
    )
    order = "conditions were measured one after the other"
    if drifts and drift.confounded:
        return (
            f"low confidence: {change}, and {order}: the drift looks like an effect of the conditions. Measure them in "
            "random order"
        )
    if drifts:
        return f"{change}: a drift of the campaign. Conditions alternate, so estimates are means over it"
    if drift.confounded:
        return (
            f"{order}: a drift between them would look like an effect. No drift is seen within them; random order "
            "would show one"
        )
    return ""
