# SPDX-License-Identifier: Apache-2.0
"""The bar of a command on a terminal."""

from __future__ import annotations

import pytest
from rich.progress import Progress

from impact_rs_cli import terminal
from impact_rs_cli.terminal import _TimeLeft
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
