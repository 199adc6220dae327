# SPDX-License-Identifier: Apache-2.0
"""A plan on the command line: made, run, run again, and changed in between."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from documents import tied_laws
from scene_source import of_scene

from impact_rs_analysis.application import plant_bench as bench
from impact_rs_analysis.application.plant_bench import PlantBench
from impact_rs_analysis.design.design import WHICH_EFFECT
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, write_document
from impact_rs_analysis.diagnosis.laws.discovery_document import FOUND, DiscoveryDocument, write_discovery
from impact_rs_analysis.investigation.rounds import Round, WantedTrials
from impact_rs_analysis.investigation.rule_design import rule_design
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_cli.main import main
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, read_plan, write_plan, write_scenario

Document = Callable[..., dict[str, Any]]
Refused = Callable[..., str]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A push of one object in one pose, so that few trials are possible."""
    push = load_scenario("push")
    path = tmp_path_factory.mktemp("scenario") / "small_push.yaml"
    small = push.model_copy(
        update={
            "name": "small_push",
            "objects": {"juice": push.objects["juice"]},
            "cases": {"case_2": push.cases["case_2"]},
        }
    )
    write_scenario(small, path)
    return path


@pytest.mark.slow
def test_a_plan_is_made_for_which_effect_is_missing(document: Document, scenario: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    made = document("design", "--budget", "6", "--scenarios", scenario, "--jobs", "1", "-o", plan)
    written = read_plan(plan)
    assert (written.aim, written.trials, written.model_dump(mode="json")) == ("effects", 6, made)
    variants = {"small_push", "small_push_beside", "small_push_from_left", "small_push_from_right"}
    assert {campaign.folder for campaign in written.campaigns} <= variants


@pytest.mark.parametrize("after", [True, False])
def test_a_plan_after_a_discovery_is_for_its_laws_and_a_first_one_for_which_effect_is_missing(
    document: Document, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    """The laws are in the document alone, and in no model."""
    found = tied_laws()
    discovery = DiscoveryDocument(verdict=FOUND, summary="", error_unit=found.error_unit, diagnosis=found)
    write_discovery(discovery, tmp_path / "discovery.json")
    world = Physics.nominal(load_scenario("push"), "juice")
    decisions = []

    def design(model: Model, scenarios: Any, budget: int, map_tasks: Any, decide: Any, *rest: Any) -> ExperimentPlan:
        decisions.append((decide, model))
        return designed()

    monkeypatch.setattr("impact_rs_cli.commands.design.design", design)
    words = ("--after", tmp_path / "discovery.json") if after else ()
    made = document("design", *words, "--budget", "6", "--jobs", "1", "-o", tmp_path / "plan.yaml")
    assert read_plan(tmp_path / "plan.yaml").model_dump(mode="json") == made
    ((decide, model),) = decisions
    assert (decide is WHICH_EFFECT) is not after
    if after:
        decision = decide(of_scene(model, world))
        assert (decision.aim, decision.pairs) == ("rivals", ((0, 1),))
        assert [one.name for one in decision.explanations] == ["object_drag", "object_drag_cube"]


def test_a_plan_after_a_diagnosis_says_what_calibrates_the_readings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    """Kills: a plan of trials alone, where a fault of a reading explains as much."""
    found = tied_laws()
    effects = tuple(one.model_copy(update={"calibration": f"calibrate {one.name}"}) for one in found.effects)
    write_document(found.model_copy(update={"effects": effects}), tmp_path / "diagnosis.json")
    monkeypatch.setattr("impact_rs_cli.commands.design.design", lambda *_: designed())
    assert main(["design", "--after", str(tmp_path / "diagnosis.json"), "--budget", "6", "--jobs", "1"]) == 0
    said = capfd.readouterr().out
    assert "to calibrate object_drag: calibrate object_drag\n" in said  # named
    assert "to calibrate object_drag_cube: calibrate object_drag_cube\n" in said  # tied with it


def test_a_plan_is_run_and_resumed(document: Document, refused: Refused, scenario: Path, tmp_path: Path) -> None:
    path, runs = tmp_path / "plan.yaml", tmp_path / "runs"
    slow = load_scenario("push").cases["case_1"].model_dump(mode="json")
    slow["robots"]["arm"]["ante_velocity"] = [0.0, -0.3, 0.0]
    part = PlannedCampaign(
        folder="slow_push",
        scenario=str(scenario),
        settings={"name": "slow_push", "cases.slow": slow},
        conditions=(PlannedTrials(object="juice", case="slow", trials=2),),
    )
    plan = ExperimentPlan(
        model="nominal", model_digest="0", aim="effects", method="design", budget=2, seed=0, campaigns=(part,)
    )
    write_plan(plan, path)
    campaign = ("campaign", "--plan", path, "-o", runs, "--plant", "twin", "--jobs", "1")
    assert document(*campaign)["outcomes"] == {"OK": 2}
    assert document(*campaign)["ran"] == 0
    bag = TrialBag.open(runs / "slow_push" / "juice__slow__s1.000__r1")
    assert bag.info.scenario == "slow_push"
    assert bag.info.ante_velocity == pytest.approx(-0.3)

    write_plan(plan.model_copy(update={"seed": 1}), path)
    assert "holds another campaign (it differs in seed)" in refused(*campaign)


# ---- our plant as a bench -------------------------------------------------------------------------------------------


SETTINGS = Settings(scenarios=("push", "excite"), model_digest=load_model("nominal").digest)


def designed() -> ExperimentPlan:
    """A plan with a case of the file, and with two that the file does not have: slower, and beside the centre."""
    push = load_scenario("push")
    slow = push.cases["case_3"].model_dump(mode="json")
    slow["robots"]["arm"]["ante_velocity"] = [0.0, -0.25, 0.0]
    return ExperimentPlan(
        model="nominal",
        model_digest="",
        aim="effects",
        method="design",
        budget=6,
        campaigns=(
            PlannedCampaign(
                folder="push",
                scenario="push",
                settings={"cases.case_3_250mm_s": slow},
                conditions=(
                    PlannedTrials(object="parcel", case="case_3_250mm_s", trials=2),
                    PlannedTrials(object="parcel", case="case_1", trials=2),
                ),
            ),
            PlannedCampaign(
                folder="push_beside",
                scenario="push",
                settings={"name": "push_beside", "object_position": [0.458, -0.139]},
                conditions=(PlannedTrials(object="parcel", case="case_2", trials=2),),
            ),
        ),
    )


def test_a_rule_goes_on_after_trials_that_no_scenario_file_has(tmp_path: Path) -> None:
    """Conditions of the file that were measured least are next: case 2 beside the centre is another than case 2."""
    done = [Round(1, tmp_path, "nominal", designed())]
    count = len(load_scenario("push").objects) * len(load_scenario("push").cases)
    plan = rule_design(SETTINGS, WantedTrials(load_model("nominal"), done, None, count - 1, 1))
    chosen = {(one.object, one.case) for campaign in plan.campaigns for one in campaign.conditions}
    assert ("parcel", "case_2") in chosen and ("parcel", "case_1") not in chosen
    assert plan.trials == count - 1


def test_a_design_after_a_discovery_knows_its_laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The design distinguishes two tied laws; the library has neither."""
    decided, world = list[Any](), Physics.nominal(load_scenario("push"), "juice")

    def design(known: Any, scenarios: Any, budget: int, map_tasks: Any, decide: Any, *_: Any, **__: Any) -> Any:
        decided.append(decide(of_scene(known, world)))
        return designed()

    monkeypatch.setattr(bench, "design", design)
    plant = PlantBench(tmp_path, SETTINGS, map, Terminal(as_json=True))
    plant.design(WantedTrials(load_model("nominal"), [], tied_laws(), 4, 1))
    assert decided[0].aim == "rivals" and decided[0].pairs == ((0, 1),)
    assert [one.name for one in decided[0].explanations] == ["object_drag", "object_drag_cube"]


@pytest.mark.parametrize(("done", "document", "wanted"), [(0, None, False), (1, None, True), (1, tied_laws(), False)])
def test_a_new_model_is_tried_where_any_further_effect_would_show(
    done: int, document: DiagnosisDocument | None, wanted: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No matter which; the first trials, and those after a diagnosis, are to tell effects apart."""
    asked = list[Any]()

    def missing_effect(*names: Any, **options: Any) -> None:
        asked.append((names, options["whether_any"]))

    def design(*_: Any, **__: Any) -> ExperimentPlan:
        return designed()

    monkeypatch.setattr(bench, "design", design)
    monkeypatch.setattr(bench, "missing_effect", missing_effect)
    monkeypatch.setattr(PlantBench, "measured_runs", lambda self: None)
    settings = SETTINGS.model_copy(update={"effects": ("object_mass",)})
    plant = PlantBench(tmp_path, settings, map, Terminal(as_json=True))
    before, model = [Round(1, tmp_path, "nominal", designed())], load_model("nominal")
    plant.design(WantedTrials(model, before * done, document, 4, 1))
    assert asked == ([] if document is not None else [((("object_mass",),), wanted)])
    plant.design(WantedTrials(model, before, None, 2, 1, ("restitution",)))
    assert asked[-1] == ((("restitution",),), True)  # whether this one is there
