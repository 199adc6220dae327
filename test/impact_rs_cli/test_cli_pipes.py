# SPDX-License-Identifier: Apache-2.0
"""Whoever reads the output may leave (``| head``): what a command writes into files is there all the same."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv

from impact_rs_cli.main import main

Command = Callable[..., None]


@pytest.fixture(scope="module")
def cubes(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Impacts of cubes with mu = 0.2 that are believed to have 0.5."""
    return str(write_csv(tmp_path_factory.mktemp("cubes") / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 36)))


@pytest.fixture
def unread(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture) -> Command:
    """Runs a command whose output nobody reads; it ends without a word on standard error."""

    def run(*arguments: str) -> None:
        reader, writer = os.pipe()
        os.close(reader)
        with os.fdopen(writer, "w") as pipe, suppress(BrokenPipeError):
            monkeypatch.setattr("sys.stdout", pipe)
            assert main(list(arguments)) == 0
        monkeypatch.undo()
        assert "Error" not in capfd.readouterr().err

    return run


def test_a_diagnosis_and_what_follows_from_it_are_written(cubes: str, tmp_path: Path, unread: Command) -> None:
    diagnosis, child = str(tmp_path / "d.json"), str(tmp_path / "model_2.yaml")
    unread("diagnose", "--impacts", cubes, "-o", diagnosis, "--report", str(tmp_path / "found"), "--jobs", "1")
    unread("add", "support_friction", "--from", diagnosis, "-o", child)
    unread("compare", "--impacts", cubes, "-o", str(tmp_path / "compared"), "--jobs", "1")
    unread("history", child, "--impacts", cubes, "-o", str(tmp_path / "story"), "--jobs", "1")
    unread("map", "--table", cubes, "-o", str(tmp_path / "answers.csv"), "--jobs", "1")
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert {"d.json", "diagnosis.html", "model_2.yaml", "compare.html", "history.html", "answers.csv"} <= written


def test_reports_and_exports_of_a_campaign_are_written(push_campaign: Path, tmp_path: Path, unread: Command) -> None:
    unread("analyze", str(push_campaign), "-o", str(tmp_path / "report"), "--jobs", "1")
    unread("export", str(push_campaign), "-o", str(tmp_path / "push.parquet"), "--jobs", "1")
    unread("export", str(push_campaign), "-o", str(tmp_path / "rows"), "--jobs", "1")
    assert (tmp_path / "report" / "report.html").is_file()
    assert (tmp_path / "push.parquet").is_file()
    assert any((tmp_path / "rows").iterdir())
