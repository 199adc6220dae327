# SPDX-License-Identifier: Apache-2.0
"""Commands that a command prints for the next step look at the same measurements, with the same options."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rs_cli.commands.diagnose import add_command, discover_command, options_of
from impact_rs_cli.main import parser
from impact_rs_cli.parser import PROGRAM
from impact_rs_commands.explaining import DIAGNOSE, DISCOVER
from impact_rs_sim.model import load_model

SHARED = {one.name for one in DIAGNOSE.options} & {one.name for one in DISCOVER.options} - {"report", "output", "json"}
TEXTS = st.from_regex(r"[a-z][a-z '$;\"./_]{0,10}", fullmatch=True)
NOMINAL = load_model("nominal")


def parsed(words: list[str]) -> argparse.Namespace:
    found: argparse.Namespace = parser().parse_args(words)
    return found


def of_line(line: str) -> dict[str, Any]:
    return vars(parsed(shlex.split(line)[len(shlex.split(PROGRAM)) :]))


OPTIONS = st.fixed_dictionaries(
    {"runs": TEXTS},
    optional={
        "minus": TEXTS, "since": TEXTS, "scenario": TEXTS, "experiment": TEXTS, "mapping": TEXTS, "model": TEXTS,
        "impacts": TEXTS, "covariates": st.lists(TEXTS, min_size=1, max_size=3), "no_discrepancy": st.booleans(),
        "contact_tolerance": st.floats(0.0, 1.0, allow_subnormal=False), "jobs": st.integers(1, 99),
        "effects": st.lists(st.sampled_from(sorted(NOMINAL.known_effects)), min_size=1, max_size=3),
        "output": TEXTS, "bounds": st.lists(TEXTS, min_size=1, max_size=2),
    },
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(options=OPTIONS)
def test_discover_gets_the_options_of_the_diagnosis(options: dict[str, Any]) -> None:
    args = parsed(DIAGNOSE.words(options))
    found = of_line(discover_command(args, NOMINAL))
    assert {name: found[name] for name in SHARED} == {name: getattr(args, name) for name in SHARED}


def test_formulas_of_the_diagnosis_are_unknown_to_discover() -> None:
    args = parsed(["diagnose", "runs", "--formulas", "mine.yaml", "--effects", "mine", "restitution"])
    assert of_line(discover_command(args, NOMINAL))["effects"] == ["restitution"]


def test_names_with_blanks_survive_in_the_command_that_adds_effects() -> None:
    found = of_line(add_command(["restitution"], Path("my models/m 2.yaml"), Path("it's.json")))
    assert (found["effect"], found["model"], found["source"]) == (
        ["restitution"], Path("my models/m 2.yaml"), Path("it's.json"),
    )  # fmt: skip


def test_a_document_names_its_measurements_by_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An experiment file may stand in the folder of the runs; names, URLs and what is written stay out of it."""
    monkeypatch.chdir(tmp_path)
    Path("lab").mkdir()
    Path("lab/experiment.yaml").touch()
    words = ["lab", "--experiment", "experiment.yaml", "--since", "row 3", "--jobs", "2", "-o", "d.json", "--json"]
    assert options_of(parsed(["diagnose", *words])) == {
        "runs": str(tmp_path / "lab"), "experiment": str(tmp_path / "lab" / "experiment.yaml"), "since": "row 3",
    }  # fmt: skip
    remote = parsed(["diagnose", "s3://bucket/runs", "--mapping", "joint_state", "--scenario", "push"])
    assert options_of(remote) == {"runs": "s3://bucket/runs", "mapping": "joint_state", "scenario": "push"}
