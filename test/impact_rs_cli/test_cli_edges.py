# SPDX-License-Identifier: Apache-2.0
"""Nothing from outside stops the command line, and nothing is written where it should not be."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

BAG = "cat_food__case_2__s1.000__r0"
PUSH = config_directory() / "scenarios" / "push.yaml"


def fails(arguments: list[str], capfd: pytest.CaptureFixture, *, code: int = 2) -> str:
    """The one line that a command says when it fails."""
    capfd.readouterr()
    assert main(arguments) == code
    err = capfd.readouterr().err
    assert "Traceback" not in err
    assert len(err.strip().splitlines()) == 1, err
    return err


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (PermissionError(13, "Permission denied", "/there"), "/there: Permission denied"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed"), "surrogates not allowed"),
        (RecursionError("maximum recursion depth exceeded"), "nested too deeply"),
        (MemoryError(), "memory"),
    ],
)
def test_what_nobody_else_catches_is_one_line_and_a_traceback_with_debug(
    error: Exception, told: str, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("impact_rs_cli.commands.effects.run", broken)
    monkeypatch.setattr("impact_rs_cli.terminal.check_outputs", broken)
    assert told in fails(["effects"], capfd)
    assert main(["effects", "--debug"]) == 2
    assert "Traceback" in capfd.readouterr().err


def test_results_go_neither_into_a_bag_nor_over_their_source(
    push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    bag = push_campaign / BAG
    before = sorted(path for path in push_campaign.rglob("*"))
    for arguments in (
        ["trial", "push", "cat_food", "case_2", "-o", str(bag)],
        ["campaign", "push", "-o", str(bag / "new" / "place")],
        ["analyze", str(push_campaign), "-o", str(bag)],
        ["export", str(push_campaign), "-o", str(bag / "x.parquet")],
        ["compare", str(push_campaign), "--mcap", str(bag)],
        ["diagnose", str(push_campaign), "--report", str(bag)],
    ):
        assert "lies inside the bag" in fails(arguments, capfd)
    assert "is an input of this command" in fails(["analyze", str(push_campaign), "-o", str(push_campaign)], capfd)
    model = shutil.copy(config_directory() / "models" / "nominal.yaml", tmp_path / "model.yaml")
    text = Path(model).read_text()
    arguments = ["diagnose", str(push_campaign), "--model", str(model), "-o", str(tmp_path / "." / "model.yaml")]
    assert "is an input of this command" in fails(arguments, capfd)
    assert Path(model).read_text() == text
    assert sorted(path for path in push_campaign.rglob("*")) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["trial", "push", "cat_food", "2", "-o", ""],
        ["compare", "runs", "--mcap="],
        ["analyze", ""],
        ["campaign", "push", "-o", "x", "--objects", ""],
    ],
)
def test_an_argument_that_is_empty_is_no_path(arguments: list[str], capfd: pytest.CaptureFixture) -> None:
    assert "an argument is empty" in fails(arguments, capfd)


@pytest.mark.parametrize("name", ["../../escaped/o", ".hidden", '"><script>document.title=1</script>'])
def test_an_object_of_such_a_name_is_refused_before_anything_is_written(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(PUSH.read_text().replace("  cat_food:", f"  '{name}':"))
    told = fails(["campaign", str(scenario), "-o", str(tmp_path / "a" / "b" / "out")], capfd)
    assert "mine.yaml: objects." in told
    assert "expected a name of letters" in told
    assert os.listdir(tmp_path) == ["mine.yaml"]


def test_scales_that_differ_little_have_a_bag_each(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    scope = ["--objects", "cat_food", "--cases", "2", "--trials", "1", "--jobs", "1"]
    scope += ["--scales", "1.0001", "1.0002", "1"]
    assert main(["campaign", "push", "-o", str(tmp_path / "out"), *scope]) == 0
    assert "3 of 3 trials are there" in capfd.readouterr().out
    bags = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert bags == {f"cat_food__case_2__s{scale}__r0" for scale in ("1.000", "1.0001", "1.0002")}


def limited(arguments: list[str], size: int) -> subprocess.CompletedProcess:
    """A command that may write no file beyond so many bytes, as on a disk that is full.

    Python would cut off what it compiles as well, which no later process could import.
    """
    return subprocess.run(
        [sys.executable, "-m", "impact_rs_cli.main", *arguments],
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
        capture_output=True,
        text=True,
        timeout=200,
    )


@pytest.mark.parametrize(
    ("command", "size"),
    [
        (lambda runs, out: ["trial", "push", "cat_food", "2", "-o", str(out)], 200_000),
        (lambda runs, out: ["export", str(runs), "-o", str(out / "x.h5")], 200_000),
        (lambda runs, out: ["export", str(runs), "-o", str(out / "x.parquet")], 2000),
        (lambda runs, out: ["export", str(runs), "-o", str(out)], 2000),
        (lambda runs, out: ["analyze", str(runs), "-o", str(out)], 200_000),
    ],
    ids=["trial", "h5", "parquet", "data set", "analyze"],
)
def test_a_full_disk_ends_in_one_line_and_leaves_nothing(
    push_campaign: Path, tmp_path: Path, command: Callable, size: int
) -> None:
    done = limited(command(push_campaign, tmp_path / "out"), size)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "File too large" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not (tmp_path / "out").exists()


def test_standard_output_on_a_full_disk_is_told(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "impact_rs_cli.main", "effects"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=100,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip() == "impact-rs: No space left on device"
