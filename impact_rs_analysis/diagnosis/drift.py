# SPDX-License-Identifier: Apache-2.0
"""Drift: whether repeats of a condition change with the order in which they were measured.

Friction falls as a robot warms up, pads wear, a balance loses its zero. Within a condition nothing but time and noise
distinguishes the repeats, so with t the rank of every run in the campaign and r its residuals, both less their mean
over the condition, a drift is a slope

    beta_f = sum t r_f / sum t^2,        rho_f = (sum t r_f)^2 / (sum t^2 sum r_f^2)

of feature f. The squared correlation rho_f, averaged over the time bins of a signal, needs no scale. Its null
distribution is that along random directions among the repeats: under normal noise every direction is equally likely
(Langsrud 2005, *Rotation tests*), whatever the covariance of the features. The largest standardised rho of all signals
is compared with the largest of every direction, so that the family-wise level holds (Westfall and Young 1993,
*Resampling-based multiple testing*).

The prediction of a condition is the same for all its repeats, so a missing effect is no drift. The converse holds only
if conditions alternate. If they were measured one after the other, drift and conditions are confounded (Fisher 1935,
*The Design of Experiments*: randomise). The share of the variance of t between conditions measures that: 1 - 1/C^2 for
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
    """The signal that drifts most; None if the order is unknown or hardly anything was repeated.

    Args:
        clusters: Residuals of any model by condition, with timestamps.
    """
    stamps = [item.timestamps for item in clusters if item.timestamps is not None]
    if len(stamps) < len(clusters) or sum(item.count - 1 for item in clusters) < MIN_DEGREES_OF_FREEDOM:
        return None
    order = scipy.stats.rankdata(np.concatenate(stamps))
    places = np.split(order, np.cumsum([item.count for item in clusters])[:-1])
    within = sum(float(np.sum(np.square(own - own.mean()))) for own in places)
    if within == 0.0:  # timestamps too coarse to order any repeats
        return None
    groups = list(dict.fromkeys(feature.group for item in clusters for feature in item.features))
    correlation = np.zeros((1 + NULL_DRAWS, len(groups)))
    changes: dict[tuple[str, str, str], list[tuple[Feature, float]]] = {}
    rng = np.random.default_rng(0)
    for layout in dict.fromkeys(item.layout for item in clusters):
        chosen = [number for number, item in enumerate(clusters) if item.layout == layout and item.count > 1]
        if not chosen:
            continue
        features = clusters[chosen[0]].features
        along = _centred([places[number] for number in chosen])
        rows = _centred([clusters[number].residuals * clusters[number].sigma for number in chosen])
        draws = [rng.standard_normal((clusters[number].count, NULL_DRAWS)) for number in chosen]
        directions = np.column_stack((along, _centred(draws)))
        powers = np.outer(np.sum(np.square(directions), axis=0), np.sum(np.square(rows), axis=0))
        rho = np.square(directions.T @ rows) / np.maximum(powers, 1e-300)
        slope = along @ rows / max(float(along @ along), 1e-300) * float(np.ptp(order))
        for number, group in enumerate(groups):
            own = np.array([feature.group == group for feature in features])
            correlation[:, number] += rho[:, own].sum(axis=1)
            changes.setdefault(group, []).extend(
                (feature, float(value)) for feature, value, mine in zip(features, slope, own, strict=True) if mine
            )
    standard = (correlation - correlation.mean(axis=0)) / np.maximum(correlation.std(axis=0), 1e-300)
    most = int(np.argmax(standard[0]))
    largest = standard.max(axis=1)
    moved = changes[groups[most]]
    values = np.array([value for _, value in moved])
    feature = moved[0][0]
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


def low_confidence_sentence(found: DriftDocument | None) -> str:
    """Sentence of the summary if a drift is confounded with the conditions; else empty."""
    if found is None or not found.confounded or found.p_value >= SIGNIFICANCE_LEVEL:
        return ""
    return (
        f"Confidence is low: the {found.signal} {found.index} drifts, and conditions were measured one after the other."
    )


def drift_in_words(found: DriftDocument | None) -> str:
    """Warning on a drift, or on an order of measurement that would hide one; empty: none."""
    if found is None:
        return ""
    drifts = found.p_value < SIGNIFICANCE_LEVEL
    what = (
        f"the {found.signal} {found.index} ({found.phase}) {'rises' if found.change > 0.0 else 'falls'} by "
        f"{abs(found.change):.2g} {found.unit} over the {found.runs} runs of the campaign, in repeats of the same "
        f"condition (p {'<=' if found.p_value <= MIN_REPORTED_P else '='} {found.p_value:.2g})"
    )
    order = "conditions were measured one after the other"
    if drifts and found.confounded:
        return (
            f"low confidence: {what}, and {order}: the drift looks like an effect of the conditions. Measure them in "
            "random order"
        )
    if drifts:
        return f"{what}: a drift of the campaign. Conditions alternate, so estimates are means over it"
    if found.confounded:
        return (
            f"{order}: a drift between them would look like an effect. No drift is seen within them; random order "
            "would show one"
        )
    return ""
