"""How a trial ended is judged by what was measured, not by its rounding."""

from __future__ import annotations

import pytest

from impact_rs_control.plan import plan_trial
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags.outcome import LEAST_LIFT, outcome_of

PUSH = plan_trial(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
GRAB = plan_trial(Scene.resolve(load_scenario("grab"), "cat_food", "case_2"))


@pytest.mark.parametrize("lift", [-1e-3, -1e-12, 0.0, 1e-12, 1e-3])
def test_what_is_pushed_cannot_be_dropped_whichever_way_its_height_is_rounded(lift: float) -> None:
    assert outcome_of(PUSH, hit=True, lift=lift) == "OK"


def test_what_is_clamped_is_dropped_when_it_rises_too_little() -> None:
    enough = LEAST_LIFT * GRAB.expected_lift
    assert outcome_of(GRAB, hit=True, lift=1.01 * enough) == "OK"
    assert outcome_of(GRAB, hit=True, lift=0.99 * enough) == "DROPPED"


def test_without_impact_nothing_else_is_said() -> None:
    assert outcome_of(GRAB, hit=False, lift=0.0) == "NO-IMPACT"
