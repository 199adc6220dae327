# SPDX-License-Identifier: Apache-2.0
"""Packages that only some files need: the question on a terminal, and one line with the command elsewhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from impact_rs_cli.main import main

TABLE = """\
x [m],y [m],z [m],qx,qy,qz,qw,vx_before [m/s],vy_before [m/s],vz_before [m/s],wx_before [rad/s],wy_before [rad/s],\
wz_before [rad/s],mass [kg],size_x [m],size_y [m],size_z [m],px [m],py [m],pz [m],friction,restitution
0,0,0.05,0,0,0,1,0,0,-1,0,0,0,1,0.1,0.1,0.1,0,0,0,0.2,0.5
"""
RUN = "/somewhere/else/run"


class Situation:
    """A command that needs pyarrow where it is missing, with an answer at the terminal and a stand-in for ``./run``."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[list[str]] = []
        self.exit_code = 0
        self.target = folder / "answers.parquet"
        self._monkeypatch = monkeypatch
        self._package = pytest.importorskip("pyarrow")
        (folder / "cube.csv").write_text(TABLE, encoding="utf-8")
        self.words = ["map", "--table", str(folder / "cube.csv"), "-o", str(self.target)]
        monkeypatch.setenv("IMPACT_RS_RUN", RUN)
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        monkeypatch.setattr("impact_rs_cli.installing.subprocess.run", self._install)
        for stream in ("stdin", "stderr"):
            monkeypatch.setattr(getattr(sys, stream), "isatty", lambda: True)

    def answered(self, line: str) -> int:
        """Exit code of the command."""
        self._monkeypatch.setattr(sys.stdin, "readline", lambda: line)
        return main(self.words)

    def _install(self, command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        self.asked.append(command)
        if self.exit_code == 0:
            self._monkeypatch.setitem(sys.modules, "pyarrow", self._package)
        return subprocess.CompletedProcess(command, self.exit_code)


@pytest.fixture
def situation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Situation:
    return Situation(tmp_path, monkeypatch)


def test_after_a_yes_it_is_installed_and_the_command_goes_on(situation: Situation) -> None:
    assert situation.answered("y\n") == 0
    assert situation.asked == [[RUN, "sync", "export"]]
    assert situation.target.is_file()


@pytest.mark.parametrize("line", ["\n", "no\n", ""])
def test_without_a_yes_nothing_is_installed(
    situation: Situation, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert situation.answered(line) == 2
    assert not situation.asked and not situation.target.exists()
    assert f"this needs pyarrow, which is not installed; {RUN} sync export does it" in capsys.readouterr().err


def test_an_installation_that_fails_ends_the_command(situation: Situation) -> None:
    situation.exit_code = 7
    assert situation.answered("y\n") == 2
    assert len(situation.asked) == 1 and not situation.target.exists()


@pytest.mark.parametrize("where", ["no terminal", "json", "not made by ./run"])
def test_nobody_is_asked_where_nobody_answers_or_nothing_can_be_installed(
    situation: Situation, where: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if where == "no terminal":
        monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
    elif where == "json":
        situation.words.append("--json")
    else:
        monkeypatch.delenv("IMPACT_RS_RUN")
    assert situation.answered("y\n") == 2
    out, said = capsys.readouterr()
    assert not situation.asked and out == "" and len(said.splitlines()) == 1
    assert ("pip install pyarrow" if where == "not made by ./run" else f"{RUN} sync export") in said
