# SPDX-License-Identifier: Apache-2.0
"""Practical relevance of effects: the change of every signal against its relevance limit."""

from __future__ import annotations

import numpy as np

from impact_rs_analysis.diagnosis.document import SizeDocument
from impact_rs_analysis.diagnosis.search.fit import Fit
from impact_rs_sim.robots.robot import Array

MAX_SIZES = 3  # signals that are listed for an effect


def changes_of(fitted: Fit, part: slice = slice(None), distance: Array | None = None) -> list[Array]:
    """Absolute change of every feature by some parameters of a fit, ``(F,)`` per cluster, in the features' units.

    To first order, |J_c delta| sigma_c with the sensitivities J_c of cluster c and its scales sigma_c.

    Args:
        fitted: The fit.
        part: The parameters.
        distance: delta, distance from a point without effect, ``(p,)`` [parameter scales]; None: from nominal.
    """
    distance = fitted.distance_from_nominal[part] if distance is None else distance
    pairs = zip(fitted.evidence.clusters, fitted.candidate.jacobians, strict=True)
    return [np.abs(jacobian[:, part] @ distance) * item.sigma for item, jacobian in pairs]


def exceeds_relevance_limit(fitted: Fit, part: slice = slice(None), distance: Array | None = None) -> bool:
    """Whether some parameters of a fit change a feature by more than its relevance limit; see :func:`changes_of`."""
    return any(
        np.any(change > [feature.relevance_limit for feature in item.features])
        for item, change in zip(fitted.evidence.clusters, changes_of(fitted, part, distance), strict=True)
    )


def noticeable(fitted: Fit, first: int = 0) -> bool:
    """Whether some parameter, from index ``first`` on, differs from nominal by ``source.least_change`` at least (95 %).

    An estimate at a bound of physics, such as no friction, is considered. An estimate at a search limit is not: its
    interval is invalid. Calibrations are taken as exact: they affect the size of an effect, not its existence.
    """
    noticed = np.abs(fitted.distance_from_nominal) - fitted.half_widths_of_noise > fitted.evidence.source.least_change
    return bool(np.any((noticed & ~fitted.candidate.shapes & ~fitted.at_search_limit)[first:]))


def sizes_of(fitted: Fit, name: str) -> list[SizeDocument]:
    """Largest changes of signals by one effect of a fit, sorted by the ratio of change to relevance limit."""
    largest: dict[tuple[str, str], SizeDocument] = {}
    for item, change in zip(fitted.evidence.clusters, changes_of(fitted, fitted.candidate.part(name)), strict=True):
        for feature, value in zip(item.features, change.tolist(), strict=True):
            previous = largest.get((feature.phase, feature.signal))
            if value > (0.0 if previous is None else previous.value):
                largest[feature.phase, feature.signal] = SizeDocument(
                    phase=feature.phase,
                    signal=feature.signal,
                    value=value,
                    unit=feature.unit,
                    floor=feature.relevance_limit,
                )
    return sorted(largest.values(), key=lambda size: -size.value / (size.floor or 1.0))[:MAX_SIZES]
