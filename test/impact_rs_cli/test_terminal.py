# SPDX-License-Identifier: Apache-2.0
"""The bar of a command on a terminal, and the check of the paths of its results."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.progress import Progress

from impact_rs_cli import terminal
from impact_rs_cli.main import parser
from impact_rs_cli.terminal import _TimeLeft, check_outputs
from impact_rs_sim.errors import InputError
from impact_rs_sim.progress import ProgressFile


@pytest.mark.parametrize(("command", "left"), [("diagnose", 23.5), ("import", 1.0)])
def test_a_bar_shows_the_time_left_of_the_whole_command(
    monkeypatch: pytest.MonkeyPatch, command: str, left: float
) -> None:
    """Kills: the time left of the stage alone, and a time that does not fall between two estimates.

    Half of the bags are read in 1 s. The usual stages of a diagnosis take 2, 4 and 18.5 s; of an import none is known.
    """
    usual = {"reading bags": 2.0, "replays of the model": 4.0, "hold-out": 18.5}
    monkeypatch.setattr(terminal, "STAGES", {"diagnose": usual})
    monkeypatch.setattr(terminal.time, "time", lambda: 100.0)
    column, file = _TimeLeft(command), ProgressFile()
    file.document = {
        "what": "reading bags", "done": 9, "total": 18, "first": 0, "since": 99.0, "at": 100.0,
        "stages": {"reading bags": 1.0},
    }  # fmt: skip
    progress = Progress()
    progress.add_task("")
    column.look(file)
    for passed in (0.0, 0.6):
        monkeypatch.setattr(terminal.time, "time", lambda passed=passed: 100.0 + passed)
        assert column.render(progress.tasks[0]).plain == f"{left - passed:.0f} s left"


@pytest.mark.parametrize(
    "line",
    [
        "evidence merge north.json south.json -o south.json",
        "evidence merge north.json south.json -o ./north.json",
        "design --scenarios push mine.yaml --budget 6 -o mine.yaml",
        "friction identify mine.yaml -o mine.yaml",
        "diagnose south.json -o new.json --report new.json",
    ],
)
def test_a_result_is_written_neither_over_an_input_nor_over_another_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    """Kills: inputs that an option takes several of are not compared, nor a scenario, nor two results."""
    monkeypatch.chdir(tmp_path)
    for name in ("north.json", "south.json", "mine.yaml"):
        Path(name).touch()
    args = parser().parse_args(line.split())
    with pytest.raises(InputError, match="choose another path"):
        check_outputs(args)


@pytest.mark.parametrize("line", ["trial push juice 2 -o push", "trial push juice 2 -o juice", "compare -o a --mcap a"])
def test_results_may_go_into_a_folder_that_has_a_name_of_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    """Kills: a folder is taken for an input, because a scenario or an object has its name."""
    monkeypatch.chdir(tmp_path)
    for name in ("push", "juice"):
        Path(name).mkdir()
    check_outputs(parser().parse_args(line.split()))
