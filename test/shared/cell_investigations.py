# SPDX-License-Identifier: Apache-2.0
"""Investigations on a cell, as far as they go without one."""

from __future__ import annotations

from pathlib import Path

from impact_rs_analysis.investigation.settings import Settings, begin
from impact_rs_sim.model import load_model
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, write_plan


def about_to_move(folder: Path, envelope: Path) -> None:
    """An investigation whose last run was stopped, so that it asks before it moves; and a file of its envelope."""
    envelope.write_text("scenarios: [push]\nobjects: [parcel]\nspeed: 0.75\nimpulse: 2.0\n")
    condition = PlannedTrials(object="parcel", case="case_1", trials=2)
    nominal = load_model("nominal")
    plan = ExperimentPlan(
        model="nominal", model_digest=nominal.digest, aim="effects", method="fixed", budget=6,
        campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(condition,)),),
    )  # fmt: skip
    settings = Settings(
        scenarios=("push",), model_digest=nominal.digest, via="cell",
        envelope=CellEnvelope(scenarios=("push",), objects=("parcel",), speed=0.75, impulse=2.0),
    )  # fmt: skip
    begin(folder, settings)
    (folder / "rounds" / "01").mkdir(parents=True)
    write_plan(plan, folder / "rounds" / "01" / "plan.yaml")
    (folder / "stopped.json").write_text('{"trial": "push/r0", "reason": "LIMIT"}')
