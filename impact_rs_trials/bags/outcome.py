"""How a trial ended, judged by what was measured."""

from __future__ import annotations

from impact_rs_control.plan import TrialPlan
from impact_rs_trials.bags.trial_info import Outcome

LEAST_LIFT = 0.5  # of the lift that the reference asks for; less, and the object slipped or fell


def outcome_of(plan: TrialPlan, hit: bool, lift: float) -> Outcome:
    """Outcome of a trial that ran to its end.

    Args:
        plan: What was meant to happen.
        hit: Whether every arm detected an impact.
        lift: How far the tracked object rose from first to last sample [m].
    """
    if plan.expects_impact and not hit:
        return "NO-IMPACT"
    meant_to_lift = plan.expected_lift > 0.0
    return "DROPPED" if meant_to_lift and lift < LEAST_LIFT * plan.expected_lift else "OK"
