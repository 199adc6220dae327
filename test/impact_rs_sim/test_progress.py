# SPDX-License-Identifier: Apache-2.0
"""Progress for programs: one whole document, or nothing where nobody asked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from impact_rs_sim.progress import VARIABLE, ProgressFile


def test_a_stage_is_told_from_its_first_step_to_its_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "progress.json"
    monkeypatch.setenv(VARIABLE, str(path))
    progress = ProgressFile()
    progress.update("trials", 0, 3)
    first = json.loads(path.read_text())
    assert (first["what"], first["done"], first["total"], first["ranking"]) == ("trials", 0, 3, [])
    progress.rank("second", 2.0)
    progress.rank("first", 1.0)
    progress.update("trials", 3, 3)
    last = json.loads(path.read_text())
    assert (last["done"], last["since"]) == (3, first["since"])
    assert last["ranking"] == [["first", 1.0], ["second", 2.0]]
    assert last["first"] == 0
    progress.update("other trials", 2, 8)  # some were done by an earlier run
    progress.update("other trials", 8, 8)
    assert json.loads(path.read_text())["first"] == 2
    progress.update("more trials", 0, None)
    assert json.loads(path.read_text())["since"] >= last["at"]


def test_progress_is_optional_and_a_full_disk_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    ProgressFile().update("trials", 0, 3)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file" / "progress.json"))  # a place that cannot be written
    ProgressFile().update("trials", 0, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
