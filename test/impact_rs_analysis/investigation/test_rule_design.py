# SPDX-License-Identifier: Apache-2.0
"""Trials by rule keep to their budget."""

from __future__ import annotations

import pytest

from impact_rs_analysis.investigation.rounds import WantedTrials
from impact_rs_analysis.investigation.rule_design import rule_design
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.model import load_model

SETTINGS = Settings(scenarios=("push",), model_digest=load_model("nominal").digest)


@pytest.mark.parametrize(("budget", "trials"), [(1, 1), (2, 2), (4, 4), (5, 4), (6, 6), (20, 8)])
def test_the_first_trials_keep_to_the_budget(budget: int, trials: int) -> None:
    """Kills: three conditions with two repeats each, whatever the budget."""
    assert rule_design(SETTINGS, WantedTrials(load_model("nominal"), [], None, budget, 0)).trials == trials
