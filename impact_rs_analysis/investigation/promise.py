# SPDX-License-Identifier: Apache-2.0
"""What the trials that are left can decide at best.

The squared distance of two explanations grows at most in proportion to the trials, and the degrees of freedom of the
scatter by one with each of them. :mod:`impact_rs_analysis.inference.ahead` says how probably a diagnosis then
distinguishes them, as a plan states it.
"""

from __future__ import annotations

import math

from impact_rs_analysis.inference.ahead import promised
from impact_rs_trials.experiment_plan import ExperimentPlan

WORTHWHILE = 0.5  # probability, with all trials that are left, below which they are not measured
CERTAIN = 0.9999  # the largest probability of a plan that is extrapolated


def promise(plan: ExperimentPlan, left: int) -> float:
    """Probability that a diagnosis of all trials left distinguishes what the plan distinguishes best [-].

    1: the plan is not for rivals.

    Args:
        plan: The next trials.
        left: Trials left, those of the plan among them.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = min(max(pair.after for pair in plan.pairs), CERTAIN)
    return promised(best, plan.freedom or math.inf, left / plan.trials, left - plan.trials)  # 0: the scatter is known
