# SPDX-License-Identifier: Apache-2.0
"""Models out and evidence in, on the command line; and every mistake in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import pytest
from evidence_packages import diagnosis_of

from impact_rs_analysis.diagnosis.document import write_document
from impact_rs_cli.main import main

Document = Callable[..., dict[str, Any]]
Refused = Callable[..., str]
SCENE = ("--scenario", "push", "--object", "cat_food", "--case", "2")


def test_a_scene_is_written_for_every_simulator(tmp_path: Path, document: Document) -> None:
    files = {flag: tmp_path / f"push{end}" for flag, end in (
        ("mjcf", ".xml"), ("drake", ".sdf"), ("urdf", ".urdf"), ("usd-params", ".usda"),
    )}  # fmt: skip
    flags = [word for flag, path in files.items() for word in (f"--{flag}", path)]
    found = document("export", *flags, *SCENE)
    assert set(found) == {"mjcf", "drake", "urdf", "usd_params"}
    assert mujoco.MjModel.from_xml_path(str(files["mjcf"])).nu == 7
    assert any("motor inertia B" in text for text in found["urdf"]["left_out"])
    assert not any("motor inertia B" in text for text in found["mjcf"]["left_out"])


def measured(folder: Path, value: float) -> Path:
    """Measurements of a laboratory."""
    folder.mkdir()
    (folder / "one.csv").write_text(f"{value}\n", encoding="utf-8")
    return folder


def test_evidence_is_packed_checked_and_merged(
    tmp_path: Path, document: Document, refused: Refused, capfd: pytest.CaptureFixture
) -> None:
    packages = []
    for laboratory, value in (("north", 1.0), ("south", 1.05), ("west", 0.98), ("middle", 1.01), ("east", 2.0)):
        diagnosis, package = tmp_path / f"{laboratory}_diagnosis.json", tmp_path / f"{laboratory}.json"
        runs = measured(tmp_path / laboratory, value)
        write_document(diagnosis_of({"law": (value, 0.1)}), diagnosis)
        who = ("--laboratory", laboratory, "--robot", "arm", "--object", "box")
        assert document("evidence", "pack", diagnosis, "--data", runs, *who, "-o", package)["files"] == 1
        packages.append(package)
    runs = tmp_path / "north"
    assert document("evidence", "check", packages[0], "--data", runs)["passed"]
    merged = document("evidence", "merge", *packages, "-o", tmp_path / "merged.json")
    assert list(merged["odd"]) == ["east"]
    assert main(["evidence", "merge", *map(str, packages)]) == 0
    assert "ODD: east does not agree with the others in law.size" in capfd.readouterr().out
    assert (tmp_path / "merged.json").is_file()
    (runs / "one.csv").write_text("2\n", encoding="utf-8")
    assert not document("evidence", "check", packages[0], "--data", runs, code=1)["passed"]
    assert "expected two or more" in refused("evidence", "merge", packages[0])
    assert "not an evidence package" in refused("evidence", "check", tmp_path / "merged.json")


def test_measurements_that_were_packed_under_two_names_are_refused(
    tmp_path: Path, document: Document, refused: Refused
) -> None:
    runs, packages = measured(tmp_path / "runs", 1.0), []
    write_document(diagnosis_of({"law": (6.08, 0.5)}), tmp_path / "diagnosis.json")
    for laboratory in ("north", "south"):
        who = ("--laboratory", laboratory, "--robot", "arm", "--object", "box")
        packages.append(tmp_path / f"{laboratory}.json")
        document("evidence", "pack", tmp_path / "diagnosis.json", "--data", runs, *who, "-o", packages[-1])
    said = refused("evidence", "merge", *packages, "-o", tmp_path / "merged.json")
    assert "hold the same measurements (100% of their bytes, by SHA-256)" in said
    assert not (tmp_path / "merged.json").exists()


def test_designs_are_ranked_in_a_table_and_a_page(tmp_path: Path, document: Document) -> None:
    words = ("study-design", "-o", tmp_path / "design", "--robots", "ur5e", "--poses", "2", "--pads", "narrow")
    found = document(*words, "--draws", "4", "--jobs", "1")
    assert len(found["ranked"]["impulse"]) == 2
    assert {path.name for path in (tmp_path / "design").iterdir()} == {"design_study.html", "designs.csv"}
