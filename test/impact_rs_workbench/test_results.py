# SPDX-License-Identifier: Apache-2.0
"""What a click on a heat map opens, what a plan buys, and how an investigation stands."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import documents
import pytest
from reports import PLAN, SETTINGS, investigated
from starlette.testclient import TestClient

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, write_document
from impact_rs_analysis.evidence.levels import Cell
from impact_rs_analysis.investigation.settings import begin
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_analysis.report.plots import effects_plot
from impact_rs_cli.commands import diagnose as diagnose_command
from impact_rs_cli.terminal import Terminal
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.experiment_plan import write_plan
from impact_rs_workbench.results import diagnosis, estimates, investigation, nearest_signal, plan
from impact_rs_workbench.results import trial as trial_of
from impact_rs_workbench.workspace import Workspace


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
    begin(tmp_path / "begun", SETTINGS)
    assert investigation(tmp_path / "begun") == {"ending": None, "rounds": 0, "trials": 0}
    investigated(tmp_path / "open")
    assert investigation(tmp_path / "open")["ending"] is None
    investigated(tmp_path / "over", "UNDECIDED")
    found = investigation(tmp_path / "over")
    assert (found["ending"]["verdict"], found["rounds"]) == ("UNDECIDED", 1)
    assert "I cannot tell" in found["ending"]["summary"]


def test_an_estimate_stands_at_the_time_of_its_measurement(
    tmp_path: Path, hidden_campaign: Path, diagnosed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever its diagnosis was written, and from the diagnosis alone; an older one stands at the time of its file."""
    shutil.copytree(hidden_campaign, tmp_path / "runs")
    recorded = [
        datetime.fromisoformat(TrialBag.open(bag.parent).metadata["recorded"]).timestamp()
        for bag in hidden_campaign.rglob("metadata.yaml")
    ]
    found = json.loads(diagnosed.read_text())
    for name, runs, written in (("new", found["runs"], 3e9), ("old", found["runs"] | {"recorded": None}, 2e9)):
        (tmp_path / f"{name}.json").write_text(json.dumps(found | {"runs": runs}))
        os.utime(tmp_path / f"{name}.json", (written, written))
    monkeypatch.setattr(TrialBag, "open", None)
    rows = estimates(Workspace(tmp_path))
    assert {(row["diagnosis"], row["when"], row["measured"]) for row in rows} == {
        ("new.json", max(recorded), True),
        ("old.json", 2e9, False),
    }
    assert [row["when"] for row in rows] == sorted(row["when"] for row in rows)


def test_an_estimate_without_an_interval_has_no_ends(tmp_path: Path) -> None:
    """Kills infinite ends, which JSON cannot hold, so that one such diagnosis hides all."""
    shutil.copy(documents.OLD_DIAGNOSIS, tmp_path / "d.json")
    rows = estimates(Workspace(tmp_path))
    (row,) = [row for row in rows if row["parameter"] == "end_effector_payload: com_z"]
    assert (row["low"], row["high"]) == (None, None)
    json.dumps(rows, allow_nan=False)


def test_a_diagnosis_names_the_practice_campaign_of_its_runs_alone(
    tmp_path: Path, hidden_campaign: Path, diagnosed: Path
) -> None:
    shutil.copytree(hidden_campaign, tmp_path / "blind" / "runs")
    shutil.copy(diagnosed, tmp_path / "d.json")
    assert diagnosis(Workspace(tmp_path), "d.json")["practice"] is None  # nothing is hidden in them
    (tmp_path / "blind" / "truth.json").write_text("{}")
    assert diagnosis(Workspace(tmp_path), "d.json")["practice"] == "blind"
    shutil.rmtree(tmp_path / "blind" / "runs" / "excite")
    assert diagnosis(Workspace(tmp_path), "d.json")["practice"] is None


def test_runs_of_a_laboratory_are_listed_and_shown_as_they_are_described(
    tmp_path: Path, client: TestClient, hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    """Its recordings are bags of another program."""
    (trial,) = (hidden_campaign / "push").glob("juice*r0")
    lab = tmp_path / "lab"
    rewrite_bag(trial, lab / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    (lab / "runs.csv").write_text("bag,object,kind,condition\nrun_1,juice,hit,case_1\n")
    assert client.get("/api/run", params={"path": "lab", "run": "run_1"}).status_code == 400  # not described
    (lab / "experiment.yaml").write_text("scenario: push\nmapping: impact_rs\n")
    assert client.get("/api/trials", params={"path": "lab"}).json() == ["run_1"]
    found = client.get("/api/run", params={"path": "lab", "run": "run_1"}).json()
    native = trial_of(trial)
    assert found["title"] == "Run run_1"
    assert [plot["title"] for plot in found["plots"]] == [plot["title"] for plot in native["plots"]]
    assert found["replay"]["runs"][0]["impact"] is not None
    answer = client.get("/api/run", params={"path": "lab", "run": "run_9"})
    assert (answer.status_code, "\n" in answer.json()["error"]) == (400, False)


ERRORS = {"object_mass": (9.5, 1.3), "joint_coulomb_friction": (4.25, 1.3)}  # without and with it, beside the other


def two_effects() -> DiagnosisDocument:
    """A diagnosis that has chosen two effects: each adds to what the other one explains."""
    document = documents.diagnosis()
    changed = {
        name: {"held_out_error_others": own, "held_out_error_after": all_} for name, (own, all_) in ERRORS.items()
    }
    effects = [effect.model_copy(update=changed.get(effect.name, {})) for effect in document.effects]
    return document.model_copy(update={"effects": tuple(effects)})


def test_terminal_report_and_page_show_the_same_held_out_errors_of_two_effects(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    document = two_effects()
    write_document(document, tmp_path / "diagnosis.json")
    write_diagnosis(document, documents.comparison(), (), None, tmp_path)
    html = re.sub(r"<[^>]*>|\s+", " ", (tmp_path / "diagnosis.html").read_text())
    diagnose_command.show(document, Terminal(as_json=False))
    terminal = capsys.readouterr().out
    page = {one["name"]: one for one in diagnosis(Workspace(tmp_path), "diagnosis.json")["effects"]}
    figure = effects_plot(document)
    assert figure is not None
    lines = {trace.y[0]: tuple(trace.x) for trace in figure.data if trace.mode == "lines"}
    for name, (without, error) in ERRORS.items():
        assert (page[name]["without"], page[name]["with"]) == (without, error)
        assert lines[name] == (without, error)
        assert re.search(rf"{name}.*{without:g} → {error:g}", terminal)
        assert re.search(rf"{name}[^%]*?{without:g} *→ *{error:g}", html)


def test_a_law_is_looked_for_in_the_measurements_of_the_diagnosis(tmp_path: Path) -> None:
    """With the options that it was made with; effects of its own formulas are unknown to ``discover``."""
    runs = tmp_path / "lab" / "my runs"
    runs.mkdir(parents=True)
    formula = documents.tied_laws().formulas[0]
    options = {"runs": str(runs), "since": "row 7", "no_discrepancy": True, "effects": ["restitution", formula.name]}
    options |= {"mapping": "joint_state", "bounds": ["restitution.e=0:1"]}
    document = two_effects().model_copy(update={"options": options, "formulas": (formula,)})
    write_document(document, tmp_path / "diagnosis.json")
    found = diagnosis(Workspace(tmp_path), "diagnosis.json")
    assert found["runs"] == "lab/my runs"
    assert found["law"] == {
        "runs": "lab/my runs", "since": "row 7", "no_discrepancy": True, "effects": ["restitution"],
        "mapping": "joint_state",
    }  # fmt: skip
    elsewhere = document.model_copy(update={"options": {"runs": "/somewhere/else"}})
    write_document(elsewhere, tmp_path / "diagnosis.json")
    assert diagnosis(Workspace(tmp_path), "diagnosis.json")["law"] == {}
