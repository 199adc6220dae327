# SPDX-License-Identifier: Apache-2.0
"""A screen reader and a keyboard can read every kind of report; its first line says what it is and what comes next."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import documents
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, sync_playwright

from impact_rs_analysis.diagnosis.discovery_document import DESCRIBED, DiscoveryDocument, LawDocument, NumberDocument
from impact_rs_analysis.investigation import Round, RoundDecision, Settings
from impact_rs_analysis.limits.poses import PlacedLimit
from impact_rs_analysis.limits.speed import SpeedLimit
from impact_rs_analysis.measure.design_study import MEASURES, Design, DesignQuestion, DesignStudy, Estimate
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
from impact_rs_analysis.report.trial import write_trial
from impact_rs_cli.main import main
from impact_rs_sim.model import load_model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.checked_bound import CheckedBound
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
BY_KIND = {"speed": 1.0, "torque": 0.4, "reflex": 2.0, "force": 3.0}  # m/s
BAG = "cat_food__case_2__s1.000__r0"


def analysis(folder: Path, campaign: Path) -> Path:
    assert main(["analyze", str(campaign), "-o", str(folder), "--jobs", "1"]) == 0
    return folder / "report.html"


def design_study(folder: Path, _: Path) -> Path:
    own = Estimate(9.0, 4.0, 14.0, (7.0, 12.0))
    designs = tuple(
        Design(robot, 1, (0.0,), "rotor", "wide", dict.fromkeys(MEASURES, own)) for robot in ("franka_fer", "ur5e")
    )
    question = DesignQuestion(load_scenario("push"), "cat_food")
    return write_design_study(DesignStudy(question, designs, {"ur10e/1": "out of reach"}, {}), folder)


def discovery(folder: Path, _: Path) -> Path:
    law = LawDocument(
        name="drag", sentence="Drag.", place="force on the object", formula="-(c * object_speed)",
        parameters={"c": NumberDocument(estimate=8.0, ci95=(7.5, 8.5), unit="N s/m")}, verdict="CONFIRMED",
        held_out_error_before=12.6, held_out_error_after=0.7, p_value=0.0005,
    )  # fmt: skip
    found = DiscoveryDocument(verdict=DESCRIBED, summary="In words.", laws=(law,), error_unit="times repeatability")
    return write_report(found, folder)


def investigation(folder: Path, _: Path) -> Path:
    digest = load_model("nominal").digest
    campaign = PlannedCampaign(
        folder="push", scenario="push", conditions=(PlannedTrials(object="parcel", case="case_1", trials=8),)
    )
    plan = ExperimentPlan(
        model="nominal", model_digest=digest, aim="effects", method="fixed", budget=8, campaigns=(campaign,)
    )
    decision = RoundDecision(action="measure", reason="Nothing was measured.", budget=60)
    here = Round(1, folder, "nominal", plan=plan, diagnosis=documents.diagnosis(), decision=decision)
    return write_investigation(Settings(scenarios=("push",), model_digest=digest), [here], folder)


def limits(folder: Path, _: Path) -> Path:
    found = SpeedLimit("parcel", "case_1", 0.5, 0.4, 0.6, BY_KIND, "joint 3 torque", ("jump",), 200)
    places = [PlacedLimit(x, z, found if x else None) for x in (0.0, 0.1) for z in (0.0, 0.1)]
    return write_limits(load_scenario("push"), [found], places, folder)


def rehearsal(folder: Path, _: Path) -> Path:
    bounds = [
        CheckedBound("arm joint torque", 30.0, 87.0, "N m", "joint 2, at 0.912 s"),
        CheckedBound("arm external force", 120.0, 100.0, "N", "at 0.905 s"),
        CheckedBound("arm distance to joint limits", 0.3, 0.0, "rad", "joint 4, at 1.2 s", at_least=True),
    ]
    said = {
        "passed": False, "verdict": "rehearsal not passed", "not_checked": ["arm torque rate"], "log": ["armed: well"]
    }  # fmt: skip
    return write_rehearsal("push, parcel, case_1", "franka_ros2 (its sources)", bounds, said, folder)


def diagnosis(name: str) -> Callable[[Path, Path], Path]:
    return lambda folder, _: write_diagnosis(
        documents.diagnosis(name), documents.comparison("trials"), documents.tracks(), documents.versions(), folder
    )


REPORTS: dict[str, Callable[[Path, Path], Path]] = {
    "analysis": analysis,
    "comparison": lambda folder, _: write_comparison(documents.comparison(), documents.tracks(), None, folder),
    "comparison_arms": lambda folder, _: write_comparison(documents.comparison("arms"), (), None, folder),
    "design_study": design_study,
    "diagnosis": diagnosis("trials"),
    "diagnosis_joints": diagnosis("joints"),
    "discovery": discovery,
    "history": lambda folder, _: write_history(documents.versions(), folder),
    "investigation": investigation,
    "limits": limits,
    "rehearsal": rehearsal,
    "paper": lambda folder, _: write_paper(study_paper(), folder)[0],
    "trial": lambda folder, campaign: write_trial(TrialBag.open(campaign / BAG), folder / "trial.html"),
}


DARK = ("analysis", "diagnosis", "trial")  # together they have every colour of a page


@pytest.fixture(scope="module")
def report(push_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes a kind of report, once for all tests."""
    written: dict[str, Path] = {}

    def write(kind: str) -> Path:
        if kind not in written:
            written[kind] = REPORTS[kind](tmp_path_factory.mktemp(kind), push_campaign)
        return written[kind]

    return write


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield found
        found.close()


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium or chrome on this machine")
@pytest.mark.parametrize(
    ("kind", "scheme"), [*((kind, "light") for kind in REPORTS), *((kind, "dark") for kind in DARK)]
)
def test_a_report_is_accessible_with_every_section_open(
    kind: str, scheme: Literal["light", "dark"], report: Callable[[str], Path], browser: Browser
) -> None:
    """The rules of axe-core (landmarks, headings, tables, contrast, keyboard) on a phone, where wide tables scroll."""
    page = browser.new_page(
        reduced_motion="reduce", color_scheme=scheme, viewport={"width": 390, "height": 844}, bypass_csp=True
    )
    page.goto(report(kind).as_uri())
    for details in page.locator("details").all():
        details.evaluate("node => { node.open = true; }")
    found = Axe().run(page).response["violations"]
    page.close()
    assert [(one["id"], one["nodes"][0]["html"][:200]) for one in found] == []


@pytest.mark.parametrize("kind", REPORTS)
def test_the_first_line_says_what_a_report_is_and_what_comes_next(kind: str, report: Callable[[str], Path]) -> None:
    text = report(kind).read_text(encoding="utf-8")
    lead = text.partition("</h1>")[2].partition("</p>")[0].partition('<p class="note">')[2]
    assert 30 < len(lead) < 400
    assert "Next: " in lead
