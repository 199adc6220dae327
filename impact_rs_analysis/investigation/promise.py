# SPDX-License-Identifier: Apache-2.0
"""What the trials that are left can decide at best."""

from __future__ import annotations

import math
from statistics import NormalDist

import scipy

from impact_rs_trials.experiment_plan import ExperimentPlan

CERTAIN = 0.9999  # the largest probability that is counted with
WORTHWHILE = 0.75  # probability of the right decision that all trials left must promise


def promise(plan: ExperimentPlan, left: int) -> float:
    """Largest probability of the right decision between two explanations that all trials left can promise [-].

    The squared distance of two explanations grows at most in proportion to the trials, and every further one is a
    degree of freedom of the scatter. 1: the plan is not for rivals.

    Args:
        plan: The next trials.
        left: Trials left, those of the plan among them.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = min(max(pair.after for pair in plan.pairs), CERTAIN)
    if not plan.freedom:
        return NormalDist().cdf(NormalDist().inv_cdf(best) * math.sqrt(left / plan.trials))
    half = scipy.special.stdtrit(plan.freedom, best) * math.sqrt(left / plan.trials)
    return float(scipy.special.stdtr(plan.freedom + left - plan.trials, half))
