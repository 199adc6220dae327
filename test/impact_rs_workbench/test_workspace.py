# SPDX-License-Identifier: Apache-2.0
"""What lies in a folder: seen as it is, whoever made it; broken files are named and hide nothing."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
import yaml
from evidence_packages import diagnosis_of

from impact_rs_analysis.sharing.evidence_package import EvidencePackage, write_package
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_workbench.workspace import Workspace


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace(tmp_path)


def test_an_empty_folder_has_the_nominal_model_and_shipped_scenarios(workspace: Workspace) -> None:
    found = workspace.contents()
    assert [model.path for model in found.models] == ["nominal"]
    assert {"push", "grab", "excite"} <= set(found.scenarios)
    assert not (found.campaigns or found.runs or found.laboratories or found.diagnoses or found.reports)


def test_a_campaign_counts_its_trials(workspace: Workspace, push_campaign: Path) -> None:
    shutil.copytree(push_campaign, workspace.root / "campaigns" / "push")
    (campaign,) = workspace.contents().campaigns
    assert (campaign.path, campaign.scenario, campaign.present, campaign.trials) == ("campaigns/push", "push", 3, 3)
    shutil.rmtree(workspace.root / "campaigns" / "push" / "cat_food__case_2__0.8__0", ignore_errors=True)
    bag = next(path for path in (workspace.root / "campaigns" / "push").iterdir() if path.is_dir())
    shutil.rmtree(bag)
    assert workspace.contents().campaigns[0].present < 3


def test_trials_without_manifest_are_seen_with_their_common_folder(workspace: Workspace, hidden_campaign: Path) -> None:
    shutil.copytree(hidden_campaign, workspace.root / "blind" / "runs")
    found = workspace.contents()
    assert [(one.path, one.present) for one in found.campaigns] == [("blind/runs/excite", 2), ("blind/runs/push", 4)]
    assert found.runs == ("blind/runs", "blind/runs/excite", "blind/runs/push")


def test_models_are_a_family_with_their_errors(workspace: Workspace, diagnosed: Path) -> None:
    shutil.copy(diagnosed, workspace.root / "diagnosis.json")
    (diagnosis,) = workspace.contents().diagnoses
    target = workspace.root / "models" / "model_2.yaml"
    assert main(["add", *diagnosis.named, "--from", str(diagnosed), "-o", str(target)]) == 0
    digest = workspace.contents().models[1].digest
    (workspace.root / "report").mkdir()
    document = {"model": {"name": "model_2", "digest": digest}, "score": 1.2, "noise_floor": 1.0, "score_unit": "x"}
    document |= {"source": "trials", "conditions": []}
    (workspace.root / "report" / "compare.json").write_text(json.dumps(document))
    child = workspace.contents().models[1]
    assert (child.path, child.parent, child.effects) == ("models/model_2.yaml", "nominal", diagnosis.named)
    assert child.scores[0] == {"report": "report", "fit": 1.2, "held_out": None, "floor": 1.0, "unit": "x"}
    assert child.score == child.scores[0]


def scored(
    workspace: Workspace, report: str, *, digest: str, score: float, condition: str, when: float, runs: str = ""
) -> None:
    """A comparison of a model with one condition, written at some time."""
    folder = workspace.root / report
    folder.mkdir()
    model = {"name": "m", "digest": digest}
    document = {"model": model, "score": score, "noise_floor": 1.0, "score_unit": "", "source": "trials"}
    document["runs_digest"] = runs
    document["conditions"] = [{"name": condition, "repeats": 3, "score": score}]
    (folder / "compare.json").write_text(json.dumps(document))
    os.utime(folder / "compare.json", (when, when))


def test_the_tree_of_models_shows_errors_on_the_same_measurements(workspace: Workspace) -> None:
    for name, mass in (("first", 0.1), ("second", 0.2)):
        estimate = {"scale": {"estimate": 1.0 + mass, "unit": "-"}}
        effects = [{"name": "object_mass", "parameters": estimate}]
        (workspace.root / f"{name}.yaml").write_text(yaml.safe_dump({"name": name, "effects": effects}))
    _, first, second = workspace.contents().models
    assert not first.error
    scored(workspace, "old", digest=first.digest, score=9.0, condition="push", when=1.0)
    scored(workspace, "push_1", digest=first.digest, score=4.0, condition="push", when=2.0)
    scored(workspace, "push_2", digest=second.digest, score=3.0, condition="push", when=3.0)
    scored(workspace, "other", digest=second.digest, score=0.5, condition="grab", when=4.0)
    nominal, first, second = workspace.contents().models
    assert nominal.score is None
    assert first.score is not None
    assert second.score is not None
    assert (first.score["fit"], first.score["report"]) == (4.0, "push_1")  # the newest on these measurements
    assert (second.score["fit"], second.score["report"]) == (3.0, "push_2")  # and not 0.5, of other measurements
    assert [one["report"] for one in second.scores] == ["other", "push_2"]
    assert [one["report"] for one in first.scores] == ["push_1", "old"]


def test_campaigns_of_equal_conditions_are_other_measurements(workspace: Workspace) -> None:
    """Kills measurements known by their conditions, so that a tree shows a fall of the error that nobody measured."""
    effects = [{"name": "object_mass", "parameters": {"scale": {"estimate": 1.1, "unit": "-"}}}]
    (workspace.root / "m.yaml").write_text(yaml.safe_dump({"name": "m", "effects": effects}))
    nominal, own = workspace.contents().models
    scored(workspace, "x", digest=nominal.digest, score=7.0, condition="push", when=1.0, runs="x")
    scored(workspace, "y", digest=own.digest, score=0.9, condition="push", when=2.0, runs="y")
    assert [model.score is None for model in workspace.contents().models] == [True, False]
    (workspace.root / "history").mkdir()
    entry = {"model": "nominal", "digest": nominal.digest, "error_fit": 8.0, "error_held_out": None, "noise_floor": 1.0}
    document = {"history": [entry | {"runs_digest": "y"}]}
    (workspace.root / "history" / "history.json").write_text(json.dumps(document))
    assert [(model.score or {}).get("fit") for model in workspace.contents().models] == [8.0, 0.9]


def test_errors_of_a_history_are_those_of_the_model_as_it_was(workspace: Workspace) -> None:
    (workspace.root / "m.yaml").write_text("name: m\neffects: []\nnote: a\n")
    (workspace.root / "history").mkdir()
    entry = {"model": "nominal", "error_fit": 7.0, "error_held_out": None, "noise_floor": 1.0}
    (workspace.root / "history" / "history.json").write_text(
        json.dumps({"history": [entry, entry | {"model": "m", "digest": "of another text", "error_fit": 2.0}]})
    )
    nominal, changed = workspace.contents().models
    assert nominal.score is not None  # an older history has names alone
    assert nominal.score["fit"] == 7.0
    assert changed.score is None


def test_a_parent_outside_of_the_folder_is_none_here(workspace: Workspace) -> None:
    (workspace.root.parent / "outside.yaml").write_text("name: outside\neffects: []\n")
    (workspace.root / "m.yaml").write_text("name: m\nparent: ../outside.yaml\neffects: []\n")
    assert [model.parent for model in workspace.contents().models] == [None, None]


def test_one_campaign_is_offered_once(workspace: Workspace, push_campaign: Path) -> None:
    shutil.copytree(push_campaign, workspace.root / "a" / "b" / "push")
    assert workspace.contents().runs == ("a/b/push",)


def test_broken_files_are_told_with_their_line_and_hide_no_others(workspace: Workspace, push_campaign: Path) -> None:
    shutil.copytree(push_campaign, workspace.root / "good")
    (workspace.root / "bad").mkdir()
    (workspace.root / "bad" / "manifest.yaml").write_text("scenario: push\n")
    (workspace.root / "model.yaml").write_text("name: mine\neffects:\n- name: nonsense\n  parameters: {}\n")
    (workspace.root / "diagnosis.json").write_text("[]")
    found = workspace.contents()
    assert [(one.path, bool(one.error)) for one in found.campaigns] == [("bad", True), ("good", False)]
    assert "unknown effect" in found.models[1].error
    assert not found.diagnoses


def test_a_file_that_changes_is_read_again(workspace: Workspace) -> None:
    path = workspace.root / "mine.yaml"
    path.write_text("name: mine\neffects: []\n")
    assert [model.name for model in workspace.contents().models] == ["nominal", "mine"]
    path.write_text("name: mine_too\neffects: []\n")
    assert [model.name for model in workspace.contents().models] == ["nominal", "mine_too"]


def test_recordings_of_others_wait_to_be_described(workspace: Workspace) -> None:
    (workspace.root / "lab").mkdir()
    (workspace.root / "lab" / "run_1.csv").write_text("time,q1\n0,1\n")
    (lab,) = workspace.contents().laboratories
    assert (lab.path, lab.experiment, lab.recordings) == ("lab", "", ("run_1.csv",))
    (workspace.root / "lab" / "experiment.yaml").write_text("scenario: push\nrubs: x\n")
    (lab,) = workspace.contents().laboratories
    assert lab.experiment == "lab/experiment.yaml"
    assert "rubs" in lab.error


@pytest.mark.parametrize("name", ["..", "../x", "/etc", "a/../../x", ".workbench", ".workbench/jobs", "", "a\0b"])
def test_no_path_leads_out_of_the_folder(workspace: Workspace, name: str) -> None:
    with pytest.raises(InputError):
        workspace.inside(name)


def test_what_is_not_there_is_told_with_what_is_near(workspace: Workspace) -> None:
    (workspace.root / "campaigns").mkdir()
    with pytest.raises(InputError, match="there is nothing at 'campaign'; did you mean 'campaigns'"):
        workspace.existing("campaign")


def test_the_page_of_an_investigation_is_among_the_reports(workspace: Workspace) -> None:
    page = workspace.root / "inquiry" / "report" / "investigation.html"
    page.parent.mkdir(parents=True)
    page.write_text("<html></html>")
    assert workspace.contents().reports == ("inquiry/report/investigation.html",)


def test_what_commands_have_written_is_no_recording(workspace: Workspace) -> None:
    """Results, tables beside a page, and tables of impacts; a table of anything else may be a recording."""
    for name in ("limits/limits.csv", "designs/designs.csv", "impacts/lab.csv", "lab/run.csv", "found/limits.json"):
        (workspace.root / name).parent.mkdir()
        (workspace.root / name).write_text("a,b\n")
    (workspace.root / "impacts" / "lab.csv").write_text("run,vx_before [m/s],vx_after [m/s]\n")
    found = workspace.contents()
    assert [lab.path for lab in found.laboratories] == ["lab"]
    assert found.tables == ("impacts/lab.csv",)


def test_a_table_of_impacts_may_be_in_parquet(workspace: Workspace) -> None:
    """Kills: the workbench lists a Parquet table of impacts as a recording without a mapping."""
    pyarrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    for name, columns in (("tosses", ["vx_before", "vx_after"]), ("log", ["time", "q1"])):
        table = pyarrow.table({column: [0.1] for column in columns})
        parquet.write_table(table, workspace.root / f"{name}.parquet")
    (workspace.root / "broken.parquet").write_text("PAR1")
    assert workspace.contents().tables == ("tosses.parquet",)


def test_robots_and_packages_of_evidence_are_offered(workspace: Workspace) -> None:
    robot = config_directory() / "robots" / "ur5e.yaml"
    shutil.copy(robot, workspace.root / "my_robot.yaml")
    package = EvidencePackage(
        laboratory="north",
        robot="ur5e",
        object="parcel",
        versions={},
        model=load_model("nominal"),
        diagnosis=diagnosis_of({"law": (1.0, 0.1)}),
        data=(),
    )
    write_package(package.sealed(), workspace.root / "north.json")
    found = workspace.contents()
    assert "ur5e" in found.robots and found.robots[-1] == "my_robot.yaml"
    assert (found.packages, found.diagnoses) == (("north.json",), ())


def test_a_described_laboratory_names_its_scenario_as_a_form_does(workspace: Workspace) -> None:
    (workspace.root / "lab").mkdir()
    for named, expected in (("push", "push"), ("../mine.yaml", "mine.yaml"), ("../../elsewhere.yaml", "")):
        (workspace.root / "lab" / "experiment.yaml").write_text(f"scenario: {named}\nmapping: joint_state\n")
        (lab,) = workspace.contents().laboratories
        assert (lab.scenario, lab.error) == (expected, "")
