# SPDX-License-Identifier: Apache-2.0
"""``impact-rs robot``: from a URDF to checked facts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from two_joints import URDF

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

CONFIG = config_directory()
Document = Callable[..., dict[str, Any]]


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF, encoding="utf-8")
    return file


def test_a_robot_is_imported_and_passes_its_checks(
    urdf: Path, tmp_path: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    target = tmp_path / "new" / "arm.yaml"
    assert main(["robot", "import", str(urdf), "-o", str(target), "--source", "a maker, BSD"]) == 0
    out, err = capfd.readouterr()
    assert "2 joints (shoulder, elbow)" in out and f"robot check {target}" in out and not err
    assert "a maker, BSD" in target.read_text(encoding="utf-8")
    assert main(["robot", "check", str(target)]) == 0
    assert "limits are sane" in capfd.readouterr().out
    assert document("robot", "import", urdf, "-o", tmp_path / "b.yaml")["joints"] == ["shoulder", "elbow"]
    found = document("robot", "check", target)
    assert found["ok"] and [check["outcome"] for check in found["checks"]] == ["ok"] * 5


def test_meshes_of_a_package_are_found_where_the_user_says(urdf: Path, tmp_path: Path, document: Document) -> None:
    mesh = tmp_path / "src" / "nowhere" / "arm.stl"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    for number, (words, there) in enumerate((((), False), (("--package-path", mesh.parent.parent), True))):
        target = tmp_path / f"{number}.yaml"
        notes = document("robot", "import", urdf, *words, "-o", target)["notes"]
        assert any("--package-path" in note for note in notes) is not there
        assert (mesh.as_uri() in target.read_text(encoding="utf-8")) is there


def test_a_robot_with_a_negative_moment_fails_its_check(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    text, mine = (CONFIG / "robots" / "franka_fer.yaml").read_text(encoding="utf-8"), tmp_path / "mine.yaml"
    mine.write_text(text.replace("0.012516", "-0.012516"), encoding="utf-8")
    assert main(["robot", "check", str(mine)]) == 1
    assert "failed" in capfd.readouterr().out


def test_the_drives_of_a_scenario_are_checked(tmp_path: Path, document: Document) -> None:
    found = document("robot", "check", "franka_fer", "--scenario", "push")
    assert [check["name"] for check in found["checks"]][-2:] == [
        "drive of arm is stable",
        "drive of arm is measured or published",
    ]
    push, mine = (CONFIG / "scenarios" / "push.yaml").read_text(encoding="utf-8"), tmp_path / "mine.yaml"
    mine.write_text(push.replace("franka_fer", "franka_fr3"), encoding="utf-8")
    found = document("robot", "check", "franka_fr3", "--scenario", mine, code=1)
    assert "drive of arm, joint 7" in [check["name"] for check in found["checks"]]
