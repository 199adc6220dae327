# SPDX-License-Identifier: Apache-2.0
"""What a click on a heat map opens, what a plan buys, and how an investigation stands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from impact_rs_analysis.evidence.levels import Cell
from impact_rs_analysis.investigation import RoundDecision, Settings, begin
from impact_rs_sim.model import load_model
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, PlannedPair, write_plan
from impact_rs_workbench.results import investigation, nearest_signal, plan
from impact_rs_workbench.workspace import Workspace

CONDITION = PlannedTrials(
    object="parcel", case="case_1", trials=2, what="push of parcel", buys="2 x push of parcel distinguish a from b"
)
PLAN = ExperimentPlan(
    model="nominal",
    model_digest=load_model("nominal").digest,
    aim="effects",
    method="design",
    budget=4,
    pairs=(PlannedPair(first="a", second="b", before=0.5, after=0.9),),
    campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(CONDITION,)),),
)


@pytest.mark.parametrize(
    ("signal", "index", "expected"),
    [
        ("object velocity", "y", "object velocity y"),
        ("object rotation", "z", "object yaw rate"),
        ("joint velocity jump", "joint3", "velocity of joint 3"),
        ("motor torque balance", "left.joint5", "left: torque of joint 5"),
        ("contact force", "z", "end-effector velocity z"),
        ("end-effector rotation", "right.x", "right: end-effector velocity x"),
    ],
)
def test_a_cell_opens_the_signal_it_is_about(signal: str, index: str, expected: str) -> None:
    cell = Cell.model_construct(signal=signal, index=index)
    assert nearest_signal(cell) == expected


def test_a_plan_says_what_each_condition_adds(tmp_path: Path) -> None:
    write_plan(PLAN, tmp_path / "plan.yaml")
    found = plan(tmp_path / "plan.yaml")
    assert found["trials"] == 2
    assert found["conditions"] == [{"trials": 2, "what": "push of parcel", "adds": "distinguish a from b"}]
    assert found["pairs"] == [{"first": "a", "second": "b", "before": 0.5, "after": 0.9}]
    assert Workspace(tmp_path).contents().plans == ("plan.yaml",)


def test_an_investigation_has_an_ending_once_its_last_round_says_so(tmp_path: Path) -> None:
    begin(tmp_path, Settings(scenarios=("push",), model_digest=PLAN.model_digest))
    assert investigation(tmp_path) == {"ending": None, "rounds": 0, "trials": 0}
    first = tmp_path / "rounds" / "01"
    first.mkdir(parents=True)
    write_plan(PLAN, first / "plan.yaml")
    assert investigation(tmp_path)["ending"] is None
    decision = RoundDecision(action="end", reason="The trials are spent.", verdict="UNDECIDED", spent=True, budget=4)
    (first / "decision.json").write_text(json.dumps(decision.model_dump(mode="json")))
    found = investigation(tmp_path)
    assert (found["ending"]["verdict"], found["rounds"]) == ("UNDECIDED", 1)
    assert "I cannot tell" in found["ending"]["summary"]
