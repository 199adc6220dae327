# SPDX-License-Identifier: Apache-2.0
"""What forms become: the command that does the same, or one line that says what is wrong, in the words of the field."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

CAMPAIGN = {"step": "campaign", "scenario": "push", "output": "campaigns/push"}
TRIAL = {"step": "trial", "scenario": "push", "object": "cat_food", "case": "case_2", "output": "trials"}


def asked(client: TestClient, content: Any) -> list[str]:
    """Arguments of the command that a form becomes."""
    answer = client.post("/api/command", json=content)
    assert answer.status_code == 200, answer.text
    return shlex.split(answer.json()["command"])[1:]


def refused(client: TestClient, content: Any) -> str:
    """Why a form becomes none."""
    answer = client.post("/api/command", json=content)
    assert answer.status_code == 400, answer.text
    error: str = answer.json()["error"]
    assert "\n" not in error
    return error


@pytest.mark.parametrize("name", ["objects", "cases", "scales"])
def test_a_campaign_of_nothing_is_not_one_of_everything(client: TestClient, name: str) -> None:
    assert refused(client, CAMPAIGN | {name: []}).startswith(f"{name} = []: expected at least 1 of them, found 0")
    assert f"--{name}" not in asked(client, CAMPAIGN)  # the scenario's own


@pytest.mark.parametrize("content", [CAMPAIGN | {"scales": [1.0, 9.0]}, TRIAL | {"scale": 9.0}])
def test_a_reference_beyond_the_limit_of_the_command_is_refused_by_the_form(
    client: TestClient, content: dict[str, Any]
) -> None:
    assert "9.0: expected a number > 0 and <= 3 [-]" in refused(client, content)


RAW = ("Input should", "should match", "should have", "validation", "expected tags", "dictionary", "pattern", "parse")
WRONG: dict[str, tuple[Any, str]] = {
    "an unknown step": ({"step": "analyse"}, "step = 'analyse': expected one of campaign, "),
    "no step": ({}, "step: expected one of campaign, "),
    "no form": ([1], "step: expected one of campaign, "),
    "an option as a name": (CAMPAIGN | {"objects": ["--help"]}, "objects.0 = '--help': expected a name of letters"),
    "no folder": (CAMPAIGN | {"output": ""}, "output = '': expected a text of at least 1 characters"),
    "no address": (CAMPAIGN | {"scheduler": ""}, "scheduler = '': expected an address such as tcp://10.0.0.1:8786"),
    "half a trial": (CAMPAIGN | {"trials": 1.5}, "trials = 1.5: expected a whole number"),
    "a word as a number": (TRIAL | {"scale": "fast"}, "scale = 'fast': expected a number"),
    "an object of another scenario": (CAMPAIGN | {"objects": ["brick"]}, "has no object 'brick'"),
    "no trial": (CAMPAIGN | {"trials": 0}, "trials = 0: expected at least 1"),
    "a missing key": ({"step": "trial", "scenario": "push"}, "object: this key is missing"),
    "a misspelt key": (CAMPAIGN | {"sede": 1}, "sede: unknown key; did you mean 'seed'?"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_in_a_form_is_told_without_the_words_of_a_programmer(client: TestClient, name: str) -> None:
    content, expected = WRONG[name]
    told = refused(client, content)
    assert expected in told
    assert not [word for word in RAW if word in told]


def test_a_form_is_the_command_it_shows(client: TestClient, tmp_path: Path) -> None:
    for name in ("lab", "-o", "models"):
        (tmp_path / name).mkdir()
    (tmp_path / "lab" / "experiment.yaml").write_text("scenario: push\n")
    (tmp_path / "models" / "m.yaml").write_text("name: m\n")
    (tmp_path / "d.json").write_text("{}")
    root = str(tmp_path)
    runs = {"runs": "lab", "experiment": "lab/experiment.yaml", "model": "models/m.yaml", "output": "out"}
    own = [f"{root}/lab", "--experiment", f"{root}/lab/experiment.yaml"]
    model = ["--model", f"{root}/models/m.yaml"]
    assert asked(client, {"step": "compare"} | runs) == ["compare", *own, *model, "-o", f"{root}/out"]
    assert asked(client, {"step": "diagnose", "effects": ["object_mass"]} | runs) == [
        *["diagnose", *own, *model, "-o", f"{root}/out/diagnosis.json", "--report", f"{root}/out"],
        *["--effects", "object_mass"],
    ]
    assert asked(client, {"step": "history"} | runs) == [
        *["history", f"{root}/models/m.yaml", "--runs", *own, "-o", f"{root}/out"]
    ]
    adding = {"step": "add", "effect": "object_mass", "source": "d.json", "output": "new.yaml"}
    added = ["add", "object_mass", "--from", f"{root}/d.json", "-o", f"{root}/new.yaml"]
    assert asked(client, adding) == added
    assert asked(client, adding | {"force": True}) == [*added, "--force"]


def test_nothing_that_a_form_names_becomes_an_option(
    client: TestClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "--help").mkdir()
    assert asked(client, {"step": "analyze", "runs": "--help"}) == ["analyze", "./--help"]
    assert refused(client, CAMPAIGN | {"scenario": "--help"}) == (
        "scenario = '--help': expected the name of a scenario"
    )
