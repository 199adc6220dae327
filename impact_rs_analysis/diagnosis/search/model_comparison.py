# SPDX-License-Identifier: Apache-2.0
"""Comparison of non-nested fits: whether two explanations are tied, and whether one encompasses the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.search.fit import Fit
from impact_rs_analysis.diagnosis.thresholds import (
    MAX_TIE_LOG_RATIO,
    SIGNIFICANCE_LEVEL,
    TIE_LOG_RATIO,
    UNADJUSTED_LEVEL,
)
from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class Rival:
    """An effect in place of a chosen one.

    Attributes:
        name: The effect.
        instead_of: The chosen effect that it replaces.
        fit: This effect and all other chosen effects, fitted together.
        tied: Whether it predicts left-out clusters as well, and repeats do not decide between the two.
    """

    name: str
    instead_of: str
    fit: Fit
    tied: bool


def simplest(fits: Sequence[Fit]) -> Fit:
    """The fit with the fewest parameters among those within ``TIE_LOG_RATIO`` of the lowest score."""
    limit = min(fitted.score for fitted in fits) * math.exp(TIE_LOG_RATIO)
    return min((fitted for fitted in fits if fitted.score <= limit), key=lambda fitted: (fitted.cost, fitted.score))


def is_degenerate(fitted: Fit, name: str) -> bool:
    """Whether a shape parameter of an effect is at a bound, at which the effect degenerates to a simpler one."""
    part = fitted.candidate.part(name)
    shapes = np.array([bool(scalar.grid) for scalar in fitted.candidate.scalars[part]])
    return bool(np.any(fitted.at_bound[part] & shapes))


def tied(chosen: Fit, rival: Fit) -> bool:
    """Whether a rival is tied: its leave-one-out errors are as low, over the features that one of the two changes.

    The mean log ratio of squared errors is below 5 %, or below two of its standard errors but at most 25 %. Clusters
    with equal predictions are ignored, and so are signals that neither changes, such as velocities against derivatives
    of positions: their common error would level different errors.
    """
    changed = changed_features(chosen.candidate, rival.candidate)
    squares = [[np.square(residual) for residual in fit.problem.leave_one_out_residuals] for fit in (chosen, rival)]
    squares.append([item.expected_squares / 2.0 for item in chosen.evidence.clusters])
    chosen_errors, rival_errors, noise = (
        np.array(
            [np.mean(values[mask]) if np.any(mask) else 0.0 for values, mask in zip(by_cluster, changed, strict=True)]
        )
        for by_cluster in squares
    )
    return tied_errors(chosen_errors, rival_errors, noise + 1e-12)


def changed_features(*candidates: Candidate) -> list[NDArray[np.bool_]]:
    """Masks of the features that any candidate changes, by cluster, ``(F,)`` each."""
    return [
        np.any([np.any(jacobian != 0.0, axis=1) for jacobian in jacobians], axis=0)
        for jacobians in zip(*(candidate.jacobians for candidate in candidates), strict=True)
    ]


def j_test_p_value(chosen: Fit, name: str, rival: Fit) -> float:
    """p-value of the J test: an effect of one fit adds nothing to another, non-nested fit.

    The tested direction is the difference of both predictions (Davidson and MacKinnon 1981, Econometrica 49), which
    needs no linearity. With several parameters the sensitivities are tested as well, because the effect was fitted in
    all of these directions (encompassing test, Mizon and Richard 1986, Econometrica 54).

    Args:
        chosen: Fit of some effects.
        name: The tested effect of this fit.
        rival: Fit of the other effects with another effect in its place, to the same clusters.
    """
    part = chosen.candidate.part(name)
    tangent = [jacobian[:, part] for jacobian in chosen.candidate.jacobians]
    columns = [
        (of_rival - of_chosen)[:, None] for of_chosen, of_rival in zip(chosen.residuals, rival.residuals, strict=True)
    ]
    if tangent[0].shape[1] > 1:
        columns = [np.hstack(pair) for pair in zip(columns, tangent, strict=True)]
    return rival.residual_evidence.null.p_value(columns, rival.candidate.jacobians)


def encompasses(chosen: Fit, name: str, rival: Fit, rival_name: str) -> bool:
    """Whether a chosen effect encompasses its rival: its own J test is significant, the J test of the rival is not.

    Only for repeats and tables: samples of a recording are not independent.

    Args:
        chosen: Fit of the chosen effects.
        name: One of these effects.
        rival: Fit with its rival in its place.
        rival_name: The rival.
    """
    source = chosen.evidence.source
    if (source.of_motion and not source.repeated) or rival.score <= chosen.score:
        return False
    return (
        j_test_p_value(chosen, name, rival) < SIGNIFICANCE_LEVEL
        and j_test_p_value(rival, rival_name, chosen) > UNADJUSTED_LEVEL
    )


def tied_errors(chosen: Array, rival: Array, floor: Array | float) -> bool:
    """Whether leave-one-out errors of two explanations are tied, see :func:`tied`.

    Args:
        chosen: Squared error of the chosen explanation by cluster, ``(c,)`` [-].
        rival: Squared error of its rival by cluster, ``(c,)`` [-].
        floor: Added to both, so that ratios of negligible errors are near 1 [-].
    """
    ratio = np.log((rival + floor) / (chosen + floor))
    differ = np.abs(ratio) > 1e-3
    if not np.any(differ):
        return True
    ratio = ratio[differ]
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size)) if ratio.size > 1 else math.inf
    return float(ratio.mean()) < max(TIE_LOG_RATIO, min(2.0 * spread, MAX_TIE_LOG_RATIO))
