# SPDX-License-Identifier: Apache-2.0
"""Fits in competition: whether two explanations are tied, and whether one encompasses the other."""

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
        instead_of: The chosen one.
        fit: All other chosen effects and this one, fitted together.
        tied: Whether it predicts unseen clusters as well, and repeats do not decide between both.
    """

    name: str
    instead_of: str
    fit: Fit
    tied: bool


def simplest(fits: Sequence[Fit]) -> Fit:
    """The fit with the fewest parameters among those within ``TIE_LOG_RATIO`` of the lowest score."""
    limit = min(fitted.score for fitted in fits) * math.exp(TIE_LOG_RATIO)
    return min((fitted for fitted in fits if fitted.score <= limit), key=lambda fitted: (fitted.cost, fitted.score))


def in_the_limit(fitted: Fit, name: str) -> bool:
    """Whether a shape parameter is at a bound, where the effect degenerates to a simpler one."""
    part = fitted.candidate.part(name)
    shapes = np.array([bool(scalar.grid) for scalar in fitted.candidate.scalars[part]])
    return bool(np.any(fitted.at_bound[part] & shapes))


def tied(chosen: Fit, rival: Fit) -> bool:
    """Whether a rival is tied: its leave-one-out errors are as low, in the features that one of both changes.

    The mean log ratio of squared errors is below 5 %, or below two standard errors of it but 25 % at most. Clusters in
    which both predict the same are ignored. The error of a signal that neither changes, such as that of a velocity
    against the derivative of positions, would make different errors alike.
    """
    changed = changed_features(chosen.candidate, rival.candidate)
    squares = [[np.square(rest) for rest in fit.problem.leave_one_out_residuals] for fit in (chosen, rival)]
    squares.append([item.expected_squares / 2.0 for item in chosen.evidence.clusters])
    own, other, noise = (
        np.array([np.mean(one[mask]) if np.any(mask) else 0.0 for one, mask in zip(each, changed, strict=True)])
        for each in squares
    )
    return tied_errors(own, other, noise + 1e-12)


def changed_features(*candidates: Candidate) -> list[NDArray[np.bool_]]:
    """Masks of the features that some candidate changes, by cluster, ``(F,)`` each."""
    return [
        np.any([np.any(jacobian != 0.0, axis=1) for jacobian in jacobians], axis=0)
        for jacobians in zip(*(candidate.jacobians for candidate in candidates), strict=True)
    ]


def j_test_p_value(chosen: Fit, name: str, rival: Fit) -> float:
    """p-value of the J test: an effect of one fit adds nothing to another, non-nested fit.

    The tested direction is the difference of both predictions (Davidson and MacKinnon 1981, Econometrica 49), which
    needs no linearity; for several parameters the sensitivities are tested as well, because the effect was fitted in
    all of these directions (encompassing test, Mizon and Richard 1986, Econometrica 54).

    Args:
        chosen: Some effects.
        name: One of them.
        rival: The others with another effect in its place, fitted to the same clusters.
    """
    part = chosen.candidate.part(name)
    tangent = [jacobian[:, part] for jacobian in chosen.candidate.jacobians]
    columns = [(other - own)[:, None] for own, other in zip(chosen.residuals, rival.residuals, strict=True)]
    if tangent[0].shape[1] > 1:
        columns = [np.hstack(both) for both in zip(columns, tangent, strict=True)]
    return rival.left.null.p_value(columns, rival.candidate.jacobians)


def encompasses(chosen: Fit, name: str, rival: Fit, other: str) -> bool:
    """Whether a chosen effect encompasses its rival: its own J test is significant, the J test of the rival is not.

    With repeats or the rows of a table alone: samples of a recording are not independent.

    Args:
        chosen: The chosen effects.
        name: One of them.
        rival: The others with its rival.
        other: The rival.
    """
    source = chosen.evidence.source
    if (source.of_motion and not source.repeated) or rival.score <= chosen.score:
        return False
    return (
        j_test_p_value(chosen, name, rival) < SIGNIFICANCE_LEVEL
        and j_test_p_value(rival, other, chosen) > UNADJUSTED_LEVEL
    )


def tied_errors(own: Array, other: Array, floor: Array | float) -> bool:
    """Whether leave-one-out errors of two explanations are tied, see :func:`tied`.

    Args:
        own: Squared error of the chosen one by cluster, ``(c,)`` [-].
        other: Squared error of its rival, ``(c,)`` [-].
        floor: Added to both, so that ratios of negligible errors are near 1 [-].
    """
    ratio = np.log((other + floor) / (own + floor))
    moved = np.abs(ratio) > 1e-3
    if not np.any(moved):
        return True
    ratio = ratio[moved]
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size)) if ratio.size > 1 else math.inf
    return float(ratio.mean()) < max(TIE_LOG_RATIO, min(2.0 * spread, MAX_TIE_LOG_RATIO))
