# SPDX-License-Identifier: Apache-2.0
"""A form is its command: every option, the command line that it becomes, and one line for each mistake."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from impact_rs_cli.main import parser
from impact_rs_workbench.forms import FORMS, order_of
from impact_rs_workbench.workspace import Workspace

CAMPAIGN = {"command": "campaign", "scenario": "push", "output": "campaigns/push"}
TRIAL = {"command": "trial", "scenario": "push", "object": "cat_food", "case": "case_2", "output": "trials"}


def asked(client: TestClient, content: Any) -> list[str]:
    """Words of the command that a form becomes."""
    answer = client.post("/api/command", json=content)
    assert answer.status_code == 200, answer.text
    return shlex.split(answer.json()["command"])[1:]


def refused(client: TestClient, content: Any) -> str:
    """The line that says why a form becomes none."""
    answer = client.post("/api/command", json=content)
    assert answer.status_code == 400, answer.text
    error: str = answer.json()["error"]
    assert "\n" not in error
    return error


@pytest.mark.parametrize("name", FORMS)
def test_a_form_has_every_option_of_its_command(client: TestClient, name: str) -> None:
    fields = {field["name"]: field for field in client.get("/api/forms").json()[name]["fields"]}
    assert [*fields, "json"] == [option.name for option in FORMS[name].options]
    assert all(field["help"] and field["label"] for field in fields.values())


@pytest.mark.parametrize("form", [CAMPAIGN, TRIAL])
def test_null_is_the_default_of_an_option(client: TestClient, form: dict[str, Any]) -> None:
    """Kills: a check that computes with null, an internal error (HTTP 500)."""
    left_out = {option.name: None for option in FORMS[form["command"]].options if option.kind != "json"}
    assert asked(client, left_out | form) == asked(client, form)
    assert refused(client, form | {"output": None}).startswith("output: ")


@pytest.mark.parametrize("name", ["objects", "cases", "scales"])
def test_a_campaign_of_nothing_is_not_one_of_everything(client: TestClient, name: str) -> None:
    assert refused(client, CAMPAIGN | {name: []}).startswith(f"{name} = []: expected at least 1 of them, found 0")
    assert f"--{name}" not in asked(client, CAMPAIGN)  # the scenario's own


RAW = ("Input should", "should match", "should have", "validation", "expected tags", "dictionary", "pattern", "parse")
WRONG: dict[str, tuple[Any, str]] = {
    "an unknown command": (CAMPAIGN | {"command": "analyse"}, "command = 'analyse': expected one of campaign, "),
    "no command": ({}, "command: expected one of campaign, "),
    "no form": ([1], "command: expected one of campaign, "),
    "an option as a name": (CAMPAIGN | {"objects": ["--help"]}, "objects.0 = '--help': expected a name of letters"),
    "an option as a text": (
        {"command": "blind make", "seed": 1, "output": "b", "effect": "--help"},
        "effect = '--help'",
    ),
    "an option as a scenario": (CAMPAIGN | {"scenario": "--help"}, "scenario = '--help': expected the name of a scen"),
    "an option as a setting": (CAMPAIGN | {"settings": ["--seed=3"]}, "settings.0 = '--seed=3': expected KEY=VALUE"),
    "no folder": (CAMPAIGN | {"output": ""}, "output = '': expected a text of at least 1 characters"),
    "no address": (CAMPAIGN | {"scheduler": ""}, "scheduler = '': expected an address such as tcp://10.0.0.1:8786"),
    "another choice": (CAMPAIGN | {"via": "wire"}, "via = 'wire': expected 'inprocess' or 'nodes'"),
    "half a trial": (CAMPAIGN | {"trials": 1.5}, "trials = 1.5: expected a whole number"),
    "a word as a number": (TRIAL | {"scale": "fast"}, "scale = 'fast': expected a number"),
    "an object of another scenario": (CAMPAIGN | {"objects": ["brick"]}, "has no object 'brick'"),
    "a reference beyond the limit": (TRIAL | {"scale": 9.0}, "9.0: expected a number > 0 and <= 3 [-]"),
    "one of several beyond it": (CAMPAIGN | {"scales": [1.0, 9.0]}, "9.0: expected a number > 0 and <= 3 [-]"),
    "no trial": (CAMPAIGN | {"trials": 0}, "trials = 0: expected greater than or equal to 1"),
    "an object that may not be hit": (
        {"command": "rehearse", "scenario": "push", "object": "brick"},
        "has no object 'brick'",
    ),
    "a case of another scenario": ({"command": "limits", "scenario": "push", "cases": ["9"]}, "has no case '9'"),
    "an option as a range": ({"command": "diagnose", "runs": ".", "unsure": ["--help"]}, "unsure.0 = '--help'"),
    "a missing key": ({"command": "trial", "scenario": "push"}, "object: this key is missing"),
    "a misspelt key": (CAMPAIGN | {"sede": 1}, "sede: unknown key; did you mean 'seed'?"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_in_a_form_is_one_line_in_plain_words(client: TestClient, name: str) -> None:
    content, expected = WRONG[name]
    line = refused(client, content)
    assert expected in line
    assert not [word for word in RAW if word in line]


def test_a_form_is_the_command_it_shows(client: TestClient, tmp_path: Path) -> None:
    for name in ("lab", "-o", "models"):
        (tmp_path / name).mkdir()
    (tmp_path / "lab" / "experiment.yaml").write_text("scenario: push\n")
    (tmp_path / "models" / "m.yaml").write_text("name: m\n")
    (tmp_path / "d.json").write_text("{}")
    root = str(tmp_path)
    runs = {"runs": "lab", "experiment": "lab/experiment.yaml", "model": "models/m.yaml"}
    model, own = ["--model", f"{root}/models/m.yaml"], ["--experiment", f"{root}/lab/experiment.yaml"]
    forms = {
        "compare": ["compare", f"{root}/lab", *model, "-o", f"{root}/out", *own],
        "diagnose": ["diagnose", f"{root}/lab", *model, "-o", f"{root}/out", "--effects", "object_mass", *own],
        "discover": ["discover", f"{root}/lab", *model, "-o", f"{root}/out", *own],
        "history": ["history", f"{root}/models/m.yaml", "--runs", f"{root}/lab", "-o", f"{root}/out", *own],
    }
    for name, words in forms.items():
        effects = {"effects": ["object_mass"]} if name == "diagnose" else {}
        assert asked(client, {"command": name, "output": "out"} | runs | effects) == words
        assert parser().parse_args(words).experiment == tmp_path / "lab" / "experiment.yaml"
    adding = {"command": "add", "effect": ["object_mass"], "source": "d.json", "output": "new.yaml"}
    added = ["add", "object_mass", "--from", f"{root}/d.json", "-o", f"{root}/new.yaml"]
    assert asked(client, adding) == added
    assert asked(client, adding | {"force": True}) == [*added, "--force"]
    further = {"settings": ["control.clamp_force=90"], "via": "nodes", "without": ["plant"], "sensitivity": True}
    words = ["--set", "control.clamp_force=90", "--sensitivity", "--via", "nodes", "--without", "plant"]
    assert asked(client, CAMPAIGN | further) == ["campaign", "push", "-o", f"{root}/campaigns/push", *words]


def test_a_form_takes_ranges_and_remarks_as_the_command_does(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("")
    (tmp_path / "d.json").write_text("{}")
    ranges = ["size_z=0.09:0.11", "radius=0.02:0.03"]
    words = asked(client, {"command": "diagnose", "impacts": "t.csv", "unsure": ranges})
    assert words == ["diagnose", "--unsure", *ranges, "--impacts", f"{tmp_path}/t.csv"]
    named = {"laboratory": "north", "robot": "ur5e", "object": "parcel", "note": "after the move"}
    form = {"command": "evidence pack", "diagnosis": "d.json", "data": "t.csv", "output": "p.json"} | named
    words = asked(client, form)
    assert words[:2] == ["evidence", "pack"]
    assert parser().parse_args(words).note == "after the move"


def test_a_folder_called_like_an_option_is_a_folder(
    client: TestClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "--help").mkdir()
    assert asked(client, {"command": "analyze", "directory": "--help"}) == ["analyze", "./--help"]


def test_an_analysis_writes_beside_its_trials(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    order = order_of({"command": "analyze", "directory": "runs"}, Workspace(tmp_path))
    assert order.writes == (tmp_path / "runs" / "report",)
