# SPDX-License-Identifier: Apache-2.0
"""The loop on a table of impacts: compare, diagnose, add, history; and every mistake in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from impact_table_cases import CUBE_HEADER, arm_table, cube, cube_rows, write_csv

from impact_rs_cli.main import main


@pytest.fixture(scope="module")
def cubes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cubes with mu = 0.2 that are believed to have 0.5."""
    return write_csv(tmp_path_factory.mktemp("cubes") / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 36))


def _json(capfd: pytest.CaptureFixture, *arguments: str) -> dict:
    capfd.readouterr()
    assert main([*arguments, "--json", "--jobs", "1"]) == 0
    return json.loads(capfd.readouterr().out)


def test_a_table_goes_through_the_whole_loop(cubes: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    diagnosis, child = tmp_path / "diagnosis.json", tmp_path / "model_2.yaml"
    before = _json(capfd, "compare", "--impacts", str(cubes), "-o", str(tmp_path / "report"))
    assert (before["source"], before["trials"], before["score_unit"]) == ("impacts", 36, "m/s")
    found = _json(
        capfd, "diagnose", "--impacts", str(cubes), "-o", str(diagnosis), "--report", str(tmp_path / "report")
    )
    assert found["verdict"] == "support_friction"
    for name in ("compare.html", "diagnosis.html"):
        page = (tmp_path / "report" / name).read_text(encoding="utf-8")
        assert "Measured and predicted, impact by impact" in page
        assert "36 impacts in cubes.csv" in page
    assert main(["add", "support_friction", "--from", str(diagnosis), "-o", str(child)]) == 0
    after = _json(capfd, "compare", "--impacts", str(cubes), "--model", str(child))
    assert after["score"] < 0.2 * before["score"]
    told = _json(capfd, "history", str(child), "--impacts", str(cubes), "-o", str(tmp_path / "report"))["history"]
    assert [entry["error_fit"] for entry in told] == pytest.approx([before["score"], after["score"]])
    assert told[1]["error_held_out"] == pytest.approx(after["score"], rel=0.1)


def test_what_is_shown_says_its_unit(cubes: Path, capfd: pytest.CaptureFixture) -> None:
    assert main(["compare", "--impacts", str(cubes)]) == 0
    shown = capfd.readouterr().out
    assert "Model 'nominal' against 36 impacts: score 0." in shown
    assert " m/s\n" in shown.splitlines()[0] + "\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare"], "nothing to read; expected RUNS"),
        (["compare", "runs", "--impacts", "TABLE"], "takes the place of RUNS; leave runs out"),
        (["diagnose", "--impacts", "nowhere.csv"], "nowhere.csv: cannot be read: No such file or directory"),
        (["diagnose", "--impacts", "TABLE", "--scenario", "push"], "no column 'q1 [rad]'"),
        (["diagnose", "runs", "--scenario", "push"], "--scenario goes with --impacts only"),
        (["compare", "--impacts", "TABLE", "--mapping", "joint_state"], "--mapping is for recordings"),
        (["compare", "--impacts", "TABLE", "--mcap", "DIR"], "--mcap is for trials; for tables of impacts use --json"),
        (["history", "nominal.yaml"], "nothing to read; expected RUNS"),
    ],
)
def test_mistakes_are_told_in_one_line(
    cubes: Path, tmp_path: Path, capfd: pytest.CaptureFixture, arguments: list[str], message: str
) -> None:
    known = {"TABLE": str(cubes), "DIR": str(tmp_path / "mcap")}
    assert main([known.get(word, word) for word in arguments]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert len(captured.err.strip().splitlines()) == 1
    assert not (tmp_path / "mcap").exists()


def test_an_arm_needs_its_scenario(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = write_csv(tmp_path / "pushes.csv", *arm_table({}, 1))
    assert main(["compare", "--impacts", str(path)]) == 2
    assert "column 'q1 [rad]' is of an arm; --scenario NAME says which robot" in capfd.readouterr().err
    assert _json(capfd, "compare", "--impacts", str(path), "--scenario", "push")["trials"] == 6


def test_too_few_rows_can_be_compared_and_not_decided(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 5))
    assert _json(capfd, "compare", "--impacts", str(path))["trials"] == 5
    found = _json(capfd, "diagnose", "--impacts", str(path))
    assert found["verdict"] == "TOO-FEW-REPEATS"
    assert "7 more stretches of motion or impacts: 5 of 12 needed" in found["summary"]
