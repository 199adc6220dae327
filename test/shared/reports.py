# SPDX-License-Identifier: Apache-2.0
"""Reports of every kind and what lies beside them, written by the library from prepared documents.

Nothing is simulated or fitted, and nothing can go stale: documents are validated when they are read.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import documents
import numpy as np
from scenes import PHYSICS, joints_track

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, ModelIdentity
from impact_rs_analysis.diagnosis.laws.discovery_document import (
    DESCRIBED,
    DiscoveryDocument,
    LawDocument,
    NumberDocument,
)
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track
from impact_rs_analysis.investigation.rounds import Round, RoundDecision
from impact_rs_analysis.investigation.settings import Settings, begin
from impact_rs_analysis.limits.poses import PlacedLimit
from impact_rs_analysis.limits.speed import SpeedLimit
from impact_rs_analysis.measure.design_study import MEASURES, Design, DesignConditions, DesignStudy, Estimate
from impact_rs_analysis.measure.paper import study_paper
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_analysis.report.design_page import write_design_study
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_analysis.report.discovery import write_report
from impact_rs_analysis.report.error_history import write_history
from impact_rs_analysis.report.family_tree import write_investigation
from impact_rs_analysis.report.paper_figures import write_paper
from impact_rs_analysis.report.rehearsal import write_rehearsal
from impact_rs_analysis.report.speed_limits import write_limits
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.checked_bound import CheckedBound
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, PlannedPair, write_plan

NOMINAL = load_model("nominal")
CONDITION = PlannedTrials(
    object="parcel", case="case_1", trials=2, what="push of parcel", buys="2 x push of parcel distinguish a from b"
)
PLAN = ExperimentPlan(
    model="nominal",
    model_digest=NOMINAL.digest,
    aim="effects",
    method="design",
    budget=4,
    pairs=(PlannedPair(first="a", second="b", before=0.5, after=0.9),),
    campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(CONDITION,)),),
)
SETTINGS = Settings(scenarios=("push",), model_digest=NOMINAL.digest)
LIMIT = SpeedLimit(
    "parcel", "case_1", 0.5, 0.4, 0.6, {"speed": 1.0, "torque": 0.4, "reflex": 2.0, "force": 3.0}, "joint 3 torque",
    ("jump",), 200,
)  # fmt: skip
IMPACT, APART = 0.9, 0.02  # s; between measurement and model, rad and m


def diagnosed(**change: object) -> DiagnosisDocument:
    """The diagnosis of ``documents``, of the nominal model as it is now."""
    identity = ModelIdentity(name=NOMINAL.name, digest=NOMINAL.digest)
    return documents.diagnosis().model_copy(update={"model": identity} | change)


def tracks_in_3d() -> tuple[Track, ...]:
    """A hit of two arms with a gap between its stretches, and a free motion; the model's joints are elsewhere."""
    time = np.concatenate((np.linspace(0.0, 0.3, 31), np.linspace(0.8, 1.4, 61)))
    sides = [
        {
            name: np.outer(np.sin(time), np.full(arm.facts.joint_count, 0.3)) + apart
            for name, arm in PHYSICS.arms.items()
        }
        for apart in (0.0, APART)
    ]
    places = np.column_stack((np.sin(time), *np.tile([[0.0], [0.1], [0.0], [0.0], [0.0], [1.0]], time.size)))
    beside = places + np.array([0.0, APART, 0.0, 0.0, 0.0, 0.0, 0.0])
    curve = ComparedSignal("end-effector velocity y", "m/s", np.cos(time), np.cos(time) + 0.1)
    bare = joints_track(time, *sides, starts=(0, 31), impact=IMPACT)
    assert bare.measured and bare.predicted
    measured, predicted = replace(bare.measured, object=places), replace(bare.predicted, object=beside)
    hit = replace(bare, label="juice, case_2", curves=(curve,), measured=measured, predicted=predicted)
    torque = ComparedSignal("torque of joint 3", "N m", np.cos(time), np.sin(time))
    return hit, replace(hit, label="none, slow", impact=None, curves=(torque,))


def comparison(folder: Path) -> Path:
    return write_comparison(documents.comparison(), tracks_in_3d(), None, folder)


def diagnosis(folder: Path, document: DiagnosisDocument | None = None) -> Path:
    compared, tracks = documents.comparison("trials"), documents.tracks()
    return write_diagnosis(document or diagnosed(), compared, tracks, documents.versions(), folder)


def design_study(folder: Path) -> Path:
    own = Estimate(9.0, 4.0, 14.0, (7.0, 12.0))
    designs = tuple(
        Design(robot, 1, (0.0,), "rotor", "wide", dict.fromkeys(MEASURES, own)) for robot in ("franka_fer", "ur5e")
    )
    conditions = DesignConditions(load_scenario("push"), "cat_food")
    return write_design_study(DesignStudy(conditions, designs, {"ur10e/1": "out of reach"}, {}), folder)


def discovery(folder: Path) -> Path:
    law = LawDocument(
        name="drag", sentence="Drag.", place="force on the object", formula="-(c * object_speed)",
        parameters={"c": NumberDocument(estimate=8.0, ci95=(7.5, 8.5), unit="N s/m")}, verdict="CONFIRMED",
        held_out_error_before=12.6, held_out_error_after=0.7, p_value=0.0005,
    )  # fmt: skip
    found = DiscoveryDocument(verdict=DESCRIBED, summary="In words.", laws=(law,), error_unit="times repeatability")
    return write_report(found, folder)


def investigation(folder: Path) -> Path:
    """The page of an investigation in its first round, in the folder of its report."""
    decision = RoundDecision(action="measure", reason="Nothing was measured.", budget=60)
    here = Round(1, folder, "nominal", plan=PLAN, diagnosis=documents.diagnosis(), decision=decision)
    return write_investigation(SETTINGS, [here], folder)


def investigated(folder: Path, verdict: str = "") -> None:
    """The folder of an investigation in its first round; with a verdict it has ended."""
    begin(folder, SETTINGS)
    first = folder / "rounds" / "01"
    first.mkdir(parents=True)
    write_plan(PLAN, first / "plan.yaml")
    if verdict:
        ending = RoundDecision(action="end", reason="The trials are spent.", verdict=verdict, spent=True, budget=4)
        (first / "decision.json").write_text(json.dumps(ending.model_dump(mode="json")))
    investigation(folder / "report")


def limits(folder: Path) -> Path:
    places = [PlacedLimit(x, z, LIMIT if x else None) for x in (0.0, 0.1) for z in (0.0, 0.1)]
    return write_limits(load_scenario("push"), [LIMIT], places, folder)


def rehearsal(folder: Path) -> Path:
    bounds = [
        CheckedBound("arm joint torque", 30.0, 87.0, "N m", "joint 2, at 0.912 s"),
        CheckedBound("arm external force", 120.0, 100.0, "N", "at 0.905 s"),
        CheckedBound("arm distance to joint limits", 0.3, 0.0, "rad", "joint 4, at 1.2 s", at_least=True),
    ]
    said = {
        "scenario": "push", "object": "parcel", "case": "case_1", "passed": False, "verdict": "rehearsal not passed",
        "not_checked": ["arm torque rate"], "log": ["armed: well"],
    }  # fmt: skip
    return write_rehearsal("push, parcel, case_1", "franka_ros2 (its sources)", bounds, said, folder)


REPORTS: dict[str, Callable[[Path], Path]] = {
    "comparison": comparison,
    "comparison_arms": lambda folder: write_comparison(documents.comparison("arms"), (), None, folder),
    "design_study": design_study,
    "diagnosis": diagnosis,
    "diagnosis_joints": lambda folder: diagnosis(folder, documents.diagnosis("joints")),
    "discovery": discovery,
    "history": lambda folder: write_history(documents.versions(), folder),
    "investigation": investigation,
    "limits": limits,
    "rehearsal": rehearsal,
    "paper": lambda folder: write_paper(study_paper(), folder)[0],
}
