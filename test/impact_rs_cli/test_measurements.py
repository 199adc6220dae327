# SPDX-License-Identifier: Apache-2.0
"""Which files the commands of the loop read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from impact_rs_analysis.measure.analyze import ExperimentSet
from impact_rs_cli.main import main
from impact_rs_cli.measurements import experiment_file
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError

NAME = Path("experiment.yaml")


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A working directory, and a folder of runs elsewhere."""
    here, runs = tmp_path / "here", tmp_path / "elsewhere" / "lab"
    here.mkdir()
    runs.mkdir(parents=True)
    monkeypatch.chdir(here)
    return here, runs


def test_an_experiment_file_is_found_in_the_folder_of_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    _, runs = places
    (runs / NAME).write_text("scenario: push\n")
    assert experiment_file(NAME, runs, Terminal(as_json=False)) == runs / NAME
    out, err = capsys.readouterr()
    assert (out.strip(), err) == (f"experiment: {runs / NAME}", "")


def test_an_experiment_file_of_the_working_directory_comes_first_and_the_other_is_named(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    here, runs = places
    for folder in places:
        (folder / NAME).write_text("scenario: push\n")
    assert experiment_file(NAME, runs, Terminal(as_json=False)).absolute() == here / NAME
    out, err = capsys.readouterr()
    assert out.strip() == f"experiment: {here / NAME}"
    assert "was not read" in err and str(runs / NAME) in err
    shutil.copy(runs / NAME, runs / "other.yaml")
    assert experiment_file(runs / "other.yaml", runs, Terminal(as_json=False)) == runs / "other.yaml"
    assert capsys.readouterr() == ("", "")  # a whole path leaves nothing open


def test_a_missing_experiment_file_is_told_with_both_folders(places: tuple[Path, Path]) -> None:
    here, runs = places
    with pytest.raises(InputError, match="no such file in .*here or in the folder of the runs, .*lab"):
        experiment_file(NAME, runs, Terminal(as_json=False))
    assert list(here.iterdir()) == list(runs.iterdir()) == []


@pytest.mark.parametrize("command", [["compare"], ["diagnose"], ["analyze"], ["show", "--run", "run_1"]])
def test_every_command_reads_the_experiment_file_in_the_folder_of_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture, command: list[str]
) -> None:
    _, runs = places
    (runs / NAME).write_text("scenari: push\n")
    assert main([*command, str(runs), "--experiment", str(NAME), "--jobs", "1"]) == 2
    assert f"{runs / NAME}: scenari" in capsys.readouterr().err


@pytest.mark.parametrize(("tolerance", "fits"), [(50.0, True), (1e-6, False)])
def test_analyze_says_where_no_prediction_fits_and_shows_equal_contacts_once(
    push_campaign: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    tolerance: float,
    fits: bool,
) -> None:
    monkeypatch.setattr(ExperimentSet, "tolerance", property(lambda _: tolerance))
    assert main(["analyze", str(push_campaign), "-o", str(tmp_path / "report"), "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert ("first contact: no prediction agrees within the 95 % intervals of both: Cat food" in out) == (not fits)
    assert out.count("Experimental estimate") == 1 and "settled contact: the same errors as the first" in out
