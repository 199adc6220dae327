# SPDX-License-Identifier: Apache-2.0
"""The loop on a table of impacts: compare, diagnose, add, history; and every mistake in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from impact_table_cases import CUBE_HEADER, arm_table, cube, cube_rows, write_csv

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.main import main

Document = Callable[..., dict[str, Any]]


def test_a_table_goes_through_the_whole_loop(
    cubes: Path, tmp_path: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    diagnosis, child, report = tmp_path / "diagnosis.json", tmp_path / "model_2.yaml", tmp_path / "report"
    table = ("--impacts", cubes, "--jobs", "1")
    before = document("compare", *table, "-o", report)
    assert (before["source"], before["trials"], before["score_unit"]) == ("impacts", 36, "m/s")
    assert document("diagnose", *table, "-o", diagnosis, "--report", report)["verdict"] == "support_friction"
    for name in ("compare.html", "diagnosis.html"):
        page = (report / name).read_text(encoding="utf-8")
        assert "Measured and predicted, impact by impact" in page and "36 impacts in cubes.csv" in page
    assert main(["add", "support_friction", "--from", str(diagnosis), "-o", str(child)]) == 0
    after = document("compare", *table, "--model", child)
    assert after["score"] < 0.2 * before["score"]
    history = document("history", child, *table, "-o", report)["history"]
    assert [entry["error_fit"] for entry in history] == pytest.approx([before["score"], after["score"]])
    assert history[1]["error_held_out"] == pytest.approx(after["score"], rel=0.1)
    assert main(["compare", "--impacts", str(cubes)]) == 0
    shown = capfd.readouterr().out
    assert "Model 'nominal' against 36 impacts: score 0." in shown and " m/s\n" in shown
    assert "How large the differences are [times the root mean" in shown
    assert main(["history", str(child), *map(str, table)]) == 0
    assert "Error per model version [m/s]" in capfd.readouterr().out


def test_what_depends_on_a_covariate_is_said_in_text_document_and_page(
    tmp_path: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    rows = [[*row, "A"] for row in cube_rows(cube(0.5, 0.2), 40)]
    rows += [[*row, "B"] for row in cube_rows(cube(0.5, 0.4), 40, seed=1)]
    path = write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "session"], rows)
    table = ("--impacts", str(path), "--covariates", "session", "--jobs", "1")
    (remark,) = (text for text in document("compare", *table)["remarks"] if text.startswith("differences by session"))
    assert "m/s with session A, " in remark
    capfd.readouterr()
    only = ("--effects", "restitution", "support_friction")
    diagnosis, report = tmp_path / "diagnosis.json", tmp_path / "report"
    assert main(["diagnose", *table, *only, "-o", str(diagnosis), "--report", str(report)]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert "restitution depends on session: 0." in shown and "What depends on circumstances" in shown
    found = read_document(diagnosis)
    (one,) = (entry for entry in found.dependences if entry.found)
    estimates = [one.levels[level]["restitution"].estimate for level in "AB"]
    assert estimates == pytest.approx([0.2, 0.4], abs=0.02)
    page = (report / "diagnosis.html").read_text(encoding="utf-8")
    assert "<h2>Circumstances</h2>" in page and "restitution in B: 0." in page
    assert "next: " not in shown  # a model has one value for all sessions
    add = ["add", "restitution", "--from", str(diagnosis), "-o", str(tmp_path / "model_2.yaml")]
    assert main(add) == 2 and "restitution depends on session" in capfd.readouterr().err
    assert main([*add, "--force"]) == 0


def test_an_arm_needs_its_scenario(tmp_path: Path, document: Document, refused: Callable[..., str]) -> None:
    path = write_csv(tmp_path / "pushes.csv", *arm_table({}, 1))
    line = refused("compare", "--impacts", path)
    assert "column 'q1 [rad]' is of an arm; --scenario NAME says which robot" in line
    assert document("compare", "--impacts", path, "--scenario", "push", "--jobs", "1")["trials"] == 6


def test_too_few_rows_can_be_compared_and_not_decided(tmp_path: Path, document: Document) -> None:
    table = ("--impacts", write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 5)), "--jobs", "1")
    assert document("compare", *table)["trials"] == 5
    found = document("diagnose", *table)
    assert found["verdict"] == "TOO-FEW-REPEATS"
    assert "7 more stretches of motion or impacts: 5 of 12 needed" in found["summary"]
