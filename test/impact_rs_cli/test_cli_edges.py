# SPDX-License-Identifier: Apache-2.0
"""Disks that are full and readers that leave (``| head``): one line, and no half-written result."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from impact_rs_cli.main import main

COMMAND = [sys.executable, "-m", "impact_rs_cli.main"]


@pytest.mark.parametrize(
    ("words", "size"),
    [
        ("export RUNS -o OUT --jobs 1", 2000),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("trial push cat_food 2 -o OUT", 200_000),
                ("export RUNS -o OUT/x.h5", 200_000),
                ("export RUNS -o OUT/x.parquet", 2000),
                ("analyze RUNS -o OUT", 200_000),
            )
        ),
    ],
)
def test_a_full_disk_ends_in_one_line_and_leaves_nothing(
    push_campaign: Path, tmp_path: Path, words: str, size: int
) -> None:
    """No file may have more than ``size`` bytes; Python would cut off what it compiles as well."""
    line = words.replace("RUNS", str(push_campaign)).replace("OUT", str(tmp_path / "out"))
    done = subprocess.run(
        [*COMMAND, *line.split()],
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr and "File too large" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not (tmp_path / "out").exists()


def test_standard_output_on_a_full_disk_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([*COMMAND, "effects"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=100)
    assert (done.returncode, done.stderr.strip()) == (2, "impact-rs: No space left on device")


@pytest.fixture
def unread(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture) -> Callable[..., None]:
    """Runs a command whose standard output has no reader; it ends without a word on standard error."""

    def run(*arguments: object) -> None:
        reader, writer = os.pipe()
        os.close(reader)
        with os.fdopen(writer, "w") as pipe, suppress(BrokenPipeError):
            monkeypatch.setattr("sys.stdout", pipe)
            assert main([str(word) for word in arguments]) == 0
        monkeypatch.undo()
        assert "Error" not in capfd.readouterr().err

    return run


@pytest.mark.slow
def test_without_a_reader_the_files_of_the_loop_are_written(
    cubes: Path, tmp_path: Path, unread: Callable[..., None]
) -> None:
    diagnosis, child, jobs = tmp_path / "d.json", tmp_path / "model_2.yaml", ("--jobs", "1")
    unread("diagnose", "--impacts", cubes, "-o", diagnosis, "--report", tmp_path / "found", *jobs)
    unread("add", "support_friction", "--from", diagnosis, "-o", child)
    unread("compare", "--impacts", cubes, "-o", tmp_path / "compared", *jobs)
    unread("history", child, "--impacts", cubes, "-o", tmp_path / "story", *jobs)
    unread("map", "--table", cubes, "-o", tmp_path / "answers.csv", *jobs)
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert {"d.json", "diagnosis.html", "model_2.yaml", "compare.html", "history.html", "answers.csv"} <= written


def test_without_a_reader_the_files_of_a_campaign_are_written(
    push_campaign: Path, tmp_path: Path, unread: Callable[..., None]
) -> None:
    unread("analyze", push_campaign, "-o", tmp_path / "report", "--jobs", "1")
    unread("export", push_campaign, "-o", tmp_path / "push.parquet", "--jobs", "1")
    unread("export", push_campaign, "-o", tmp_path / "rows", "--jobs", "1")
    assert (tmp_path / "report" / "report.html").is_file()
    assert (tmp_path / "push.parquet").is_file()
    assert any((tmp_path / "rows").iterdir())
