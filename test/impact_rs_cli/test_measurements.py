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
    for folder in (here, runs):
        folder.mkdir(parents=True)
    monkeypatch.chdir(here)
    return here, runs


def test_an_experiment_file_here_comes_before_one_beside_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    here, runs = places
    terminal = Terminal(as_json=False)
    with pytest.raises(InputError, match="no such file in .*here or in the folder of the runs, .*lab"):
        experiment_file(NAME, runs, terminal)
    (runs / NAME).write_text("scenario: push\n")
    assert experiment_file(NAME, runs, terminal) == runs / NAME
    assert capsys.readouterr() == (f"experiment: {runs / NAME}\n", "")
    shutil.copy(runs / NAME, here / NAME)
    assert experiment_file(NAME, runs, terminal).absolute() == here / NAME
    out, err = capsys.readouterr()
    assert out == f"experiment: {here / NAME}\n"
    assert "was not read" in err and str(runs / NAME) in err
    shutil.copy(runs / NAME, runs / "other.yaml")
    assert experiment_file(runs / "other.yaml", runs, terminal) == runs / "other.yaml"
    assert capsys.readouterr() == ("", "")  # a whole path leaves nothing open


@pytest.mark.parametrize("command", ["compare", "diagnose", "analyze", "show --run run_1"])
def test_every_command_finds_the_experiment_file_beside_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture, command: str
) -> None:
    _, runs = places
    (runs / NAME).write_text("scenari: push\n")
    assert main([*command.split(), str(runs), "--experiment", str(NAME), "--jobs", "1"]) == 2
    assert f"{runs / NAME}: scenari" in capsys.readouterr().err


@pytest.mark.parametrize(("tolerance", "fits"), [(50.0, True), (1e-6, False)])
def test_analyze_says_that_no_prediction_fits_and_merges_equal_contacts(
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
