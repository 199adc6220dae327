# SPDX-License-Identifier: Apache-2.0
"""What the trials that are left can decide at best.

The log likelihood ratio r of two normal explanations a squared distance g apart is normal, with mean g / 2 and
variance g if the first one is right (:mod:`impact_rs_analysis.design.discrimination`). A diagnosis tells them apart if
one is 20 times as likely as the other, with the probability

    P(|r| > log 20) = T(sqrt(g) / 2 - log 20 / sqrt(g)) + T(-sqrt(g) / 2 - log 20 / sqrt(g))

where T is the normal distribution if the scatter is known, and Student's with f degrees of freedom if repeats estimate
it. g grows at most in proportion to the trials, and f by one with each of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import scipy

from impact_rs_trials.experiment_plan import ExperimentPlan

WORTHWHILE = 0.5  # probability, with all trials that are left, below which they are not measured
RATIO = 20.0  # of likelihoods, from which a diagnosis tells two explanations apart; strong evidence (Jeffreys 1961)
CERTAIN = 0.9999  # the largest probability of a plan that is extrapolated
FARTHEST = 1e5  # root of the largest squared distance that a plan may state

Probability = Callable[[float, int], float]
"""Of a root of the squared distance, and degrees of freedom of the scatter; 0: it is known."""


def likelier_is_right(root: float, freedom: int) -> float:
    """Probability that the likelier of two explanations is the right one: T(sqrt(g) / 2)."""
    return _distribution(root / 2.0, freedom)


def told_apart(root: float, freedom: int) -> float:
    """Probability that a diagnosis tells two explanations apart (module text)."""
    if root <= 0.0:
        return 0.0
    half, hurdle = root / 2.0, math.log(RATIO) / root
    return _distribution(half - hurdle, freedom) + _distribution(-half - hurdle, freedom)


def promise(plan: ExperimentPlan, left: int, stated: Probability = likelier_is_right) -> float:
    """Probability that all trials left tell the two explanations apart that the plan distinguishes best [-].

    1: the plan is not for rivals.

    Args:
        plan: The next trials.
        left: Trials left, those of the plan among them.
        stated: What the pairs of the plan state: as :mod:`impact_rs_analysis.design.discrimination`.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = min(max(pair.after for pair in plan.pairs), CERTAIN)
    root = scipy.optimize.brentq(lambda root: stated(root, plan.freedom) - best, 0.0, FARTHEST)
    freedom = plan.freedom and plan.freedom + left - plan.trials
    return told_apart(root * math.sqrt(left / plan.trials), freedom)


def _distribution(value: float, freedom: int) -> float:
    return float(scipy.special.stdtr(freedom, value) if freedom else scipy.special.ndtr(value))
