# SPDX-License-Identifier: Apache-2.0
"""A plan on the command line: made, run, run again, and changed in between."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from documents import tied_laws
from scene_source import of_scene

from impact_rs_analysis.diagnosis.discovery_document import FOUND, DiscoveryDocument, write_discovery
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
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


def test_a_plan_is_made_for_which_effect_is_missing(document: Document, scenario: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    made = document("design", "--budget", "6", "--scenarios", scenario, "--jobs", "1", "-o", plan)
    assert made["aim"] == "effects"
    written = read_plan(plan)
    assert written.model_dump(mode="json") == made
    assert written.trials == 6
    assert {campaign.folder for campaign in written.campaigns} <= {
        "small_push",
        "small_push_beside",
        "small_push_from_left",
        "small_push_from_right",
    }


def test_a_plan_after_a_discovery_is_for_its_laws(
    document: Document, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The laws are in the document alone, and in no model."""
    found = tied_laws()
    discovery = DiscoveryDocument(verdict=FOUND, summary="", error_unit=found.error_unit, diagnosis=found)
    write_discovery(discovery, tmp_path / "discovery.json")
    world = Physics.nominal(load_scenario("push"), "juice")
    decisions = []

    def design(model: Model, scenarios: Any, budget: int, map_tasks: Any, decide: Any, *rest: Any) -> ExperimentPlan:
        decisions.append(decide(of_scene(model, world)))
        part = PlannedTrials(object="juice", case="case_2", trials=2)
        push = PlannedCampaign(folder="push", scenario="push", conditions=(part,))
        return ExperimentPlan(
            model="nominal", model_digest="0", aim="rivals", method="design", budget=2, seed=0, campaigns=(push,)
        )

    monkeypatch.setattr("impact_rs_cli.commands.design.design", design)
    document("design", "--after", tmp_path / "discovery.json", "--budget", "6", "--jobs", "1")
    (decision,) = decisions
    assert (decision.aim, decision.pairs) == ("rivals", ((0, 1),))
    assert [one.name for one in decision.explanations] == ["object_drag", "object_drag_cube"]


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
