# SPDX-License-Identifier: Apache-2.0
"""Upper bound on what the remaining trials can decide.

The squared distance of two explanations grows at most in proportion to the trials, and the degrees of freedom of the
scatter by one with each of them. :mod:`impact_rs_analysis.inference.ahead` says how probably a diagnosis then
distinguishes them, as a plan states it.
"""

from __future__ import annotations

import math

from impact_rs_analysis.inference.ahead import promised
from impact_rs_trials.experiment_plan import ExperimentPlan

MIN_WORTHWHILE_PROBABILITY = 0.5  # with all trials left; below, they are not measured


def best_decision_probability(plan: ExperimentPlan, left: int) -> float:
    """Probability that a diagnosis of all trials left distinguishes what the plan distinguishes best [-].

    1: the plan is not for rivals.

    Args:
        plan: The next trials.
        left: Trials left, those of the plan among them.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = max(pair.after for pair in plan.pairs)
    return promised(best, plan.freedom or math.inf, left / plan.trials, left - plan.trials)  # 0: the scatter is known
