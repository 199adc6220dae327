# SPDX-License-Identifier: Apache-2.0
"""Upper bound on what the remaining trials can decide.

The squared distance of two explanations grows at most in proportion to the number of trials, and every trial adds at
most one degree of freedom of the scatter. :mod:`impact_rs_analysis.inference.ahead` gives the probability that a
diagnosis then distinguishes them.
"""

from __future__ import annotations

import math

from impact_rs_analysis.inference.ahead import promised
from impact_rs_trials.experiment_plan import ExperimentPlan

MIN_WORTHWHILE_PROBABILITY = 0.5  # with all remaining trials; below, they are not measured


def best_decision_probability(plan: ExperimentPlan, remaining: int) -> float:
    """Probability that a diagnosis of all remaining trials distinguishes the two best distinguishable explanations [-].

    It is 1 for a plan that does not compare rival explanations.

    Args:
        plan: The next trials.
        remaining: Number of remaining trials, including the trials of the plan.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = max(pair.after for pair in plan.pairs)
    return promised(
        best, plan.freedom or math.inf, remaining / plan.trials, remaining - plan.trials
    )  # 0: the scatter is known
