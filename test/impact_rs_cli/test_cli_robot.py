# SPDX-License-Identifier: Apache-2.0
"""``impact-rs robot``: from a URDF to checked facts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

BODY = (
    '<inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>'
    '<visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0.1 0 0.2"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="3" effort="{3}"/></joint>'
)
ARM = (
    f'<robot name="arm"><link name="base"/><link name="upper">{BODY}</link><link name="fore">{BODY}</link>'
    f"{JOINT.format('shoulder', 'base', 'upper', 60)}{JOINT.format('elbow', 'upper', 'fore', 40)}</robot>"
)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM, encoding="utf-8")
    return file


def test_a_robot_is_imported_and_passes_its_checks(
    urdf: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "new" / "arm.yaml"
    assert main(["robot", "import", str(urdf), "-o", str(target), "--source", "a maker, BSD"]) == 0
    out, err = capfd.readouterr()
    assert "2 joints (shoulder, elbow)" in out and f"robot check {target}" in out and not err
    assert "a maker, BSD" in target.read_text(encoding="utf-8")
    assert main(["robot", "check", str(target)]) == 0
    assert "limits are sane" in capfd.readouterr().out


def test_json_of_import_and_check_is_one_document(
    urdf: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "arm.yaml"
    assert main(["robot", "import", str(urdf), "-o", str(target), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["joints"] == ["shoulder", "elbow"]
    assert main(["robot", "check", str(target), "--json"]) == 0
    document = json.loads(capfd.readouterr().out)
    assert document["ok"] and [check["outcome"] for check in document["checks"]] == ["ok"] * 4


def test_a_robot_that_fails_a_check_is_exit_code_1(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = (config_directory() / "robots" / "franka_fer.yaml").read_text(encoding="utf-8")
    mine = tmp_path / "mine.yaml"
    mine.write_text(text.replace("0.012516", "-0.012516"), encoding="utf-8")
    assert main(["robot", "check", str(mine)]) == 1
    assert "failed" in capfd.readouterr().out


def test_the_drives_of_a_scenario_are_checked(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "franka_fer", "--scenario", "push", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["checks"][-1]["name"] == "drive of arm is stable"
    push = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    mine = tmp_path / "mine.yaml"
    mine.write_text(push.replace("franka_fer", "franka_fr3"), encoding="utf-8")
    assert main(["robot", "check", "franka_fr3", "--scenario", str(mine), "--json"]) == 1
    assert "drive of arm, joint 7" in [check["name"] for check in json.loads(capfd.readouterr().out)["checks"]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["import", "{}/nothing.urdf", "-o", "{}/new/a.yaml"], "cannot be read"),
        (["import", "{}/arm.urdf", "-o", "{}/new/a.yaml", "--tip", "for"], "did you mean 'fore'"),
        (["import", "{}/arm.urdf", "-o", "{}/new/a.txt"], "ends in .yaml"),
        (["import", "{}/arm.urdf"], "required: -o"),
        (["check", "franka_frr"], "known robots: franka_fer"),
        (["check", "franka_fr3", "--scenario", "push"], "no arm of scenario 'push' is this robot"),
        ([], "required: ACTION"),
    ],
)
def test_a_mistake_is_one_line_exit_code_2_and_leaves_nothing(
    urdf: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main(["robot", *(word.format(tmp_path) for word in arguments)]) == 2
    out, err = capfd.readouterr()
    assert message in err and err.count("\n") == 1 and not out
    assert list(tmp_path.iterdir()) == [urdf]
