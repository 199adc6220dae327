# SPDX-License-Identifier: Apache-2.0
"""A command line made from values of options is read back as the same values, whatever they are."""

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
from impact_rs_cli.parser import PROGRAM, command_line
from impact_rs_commands import COMMANDS, command_named
from impact_rs_commands.declaration import Option
from impact_rs_commands.explaining import DIAGNOSE, DISCOVER
from impact_rs_sim.model import load_model

WORDS = st.from_regex(
    r"[A-Za-z0-9_.ä][-A-Za-z0-9_./ä '\"$&;*]{0,12}", fullmatch=True
)  # what begins with - is an option


RUN = [action for command in COMMANDS.values() for action in command.actions or (command,)]


def values_of(option: Option) -> st.SearchStrategy[Any]:
    """Values that a terminal accepts for an option."""
    if option.kind in ("switch", "json"):
        return st.booleans()
    low = 0.0 if option.many else -1000.0 if option.least is None else option.least  # argparse reads no list of -1e-9
    one: st.SearchStrategy[Any] = WORDS
    if option.kind == "whole":
        one = st.integers(int(low), int(low) + 2000)
    if option.kind == "number":
        one = st.floats(low, low + 2000.0, allow_subnormal=False)
    if option.choices:
        one = st.sampled_from(option.choices)
    return st.lists(one, min_size=1, max_size=3) if option.many else one


def parsed(line: str) -> dict[str, Any]:
    return vars(parser().parse_args(shlex.split(line)[len(shlex.split(PROGRAM)) :]))


@pytest.mark.parametrize("name", [command.name for command in RUN])
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_a_command_line_is_read_back_as_the_values_it_was_made_of(name: str, data: st.DataObject) -> None:
    command = command_named(name)
    wanted: dict[str, Any] = {}
    for option in command.options:
        left_out = [one for one in command.options if not one.flags and not one.required and one.name not in wanted]
        after = not option.flags and left_out[:1] not in ([], [option])  # a position comes after those before it
        if option.required or (not after and data.draw(st.booleans(), label=f"{option.name} is given")):
            wanted[option.name] = data.draw(values_of(option), label=option.name)
    found = parsed(command_line(name, wanted))
    for key, value in wanted.items():
        assert found[key] == (_paths(value) if _paths(found[key]) == found[key] else value), key
    again = parsed(command_line(name, found))
    assert {one.name: again[one.name] for one in command.options} == {
        one.name: found[one.name] for one in command.options
    }


def _paths(value: Any) -> Any:
    """A text or several as paths."""
    if isinstance(value, list):
        return [_paths(one) for one in value]
    return Path(value) if isinstance(value, (str, Path)) else None


# ---- commands that a command prints for the next step look at the same measurements, with the same ------------------


SHARED = {one.name for one in DIAGNOSE.options} & {one.name for one in DISCOVER.options} - {"report", "output", "json"}
TEXTS = st.from_regex(r"[a-z][a-z '$;\"./_]{0,10}", fullmatch=True)
NOMINAL = load_model("nominal")


def arguments_of(words: list[str]) -> argparse.Namespace:
    found: argparse.Namespace = parser().parse_args(words)
    return found


def of_line(line: str) -> dict[str, Any]:
    return vars(arguments_of(shlex.split(line)[len(shlex.split(PROGRAM)) :]))


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
    args = arguments_of(DIAGNOSE.words(options))
    found = of_line(discover_command(args, NOMINAL))
    assert {name: found[name] for name in SHARED} == {name: getattr(args, name) for name in SHARED}


def test_formulas_of_the_diagnosis_are_unknown_to_discover() -> None:
    args = arguments_of(["diagnose", "runs", "--formulas", "mine.yaml", "--effects", "mine", "restitution"])
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
    assert options_of(arguments_of(["diagnose", *words])) == {
        "runs": str(tmp_path / "lab"), "experiment": str(tmp_path / "lab" / "experiment.yaml"), "since": "row 3",
    }  # fmt: skip
    remote = arguments_of(["diagnose", "s3://bucket/runs", "--mapping", "joint_state", "--scenario", "push"])
    assert options_of(remote) == {"runs": "s3://bucket/runs", "mapping": "joint_state", "scenario": "push"}
