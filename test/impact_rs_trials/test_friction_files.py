# SPDX-License-Identifier: Apache-2.0
"""Friction identification of a scenario: the files that come of it, and the command line."""

import json
from pathlib import Path

import pytest
import yaml

from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.scenario_files import load_scenario, scenario_path
from impact_rs_trials import friction_files
from impact_rs_trials.campaign import make_manifest
from impact_rs_trials.friction_files import identify, prepare_output, write_compensation


@pytest.fixture
def brief(tmp_path: Path) -> Path:
    """A scenario whose trials are short."""
    text = scenario_path("push").read_text(encoding="utf-8")
    for key, old, new in (
        ("nominal_impact", 0.9, 0.2),
        ("approach", 0.75, 0.15),
        ("window_after", 0.6, 0.05),
        ("duration", 1.8, 0.25),
    ):
        assert f"{key}: {old} " in text
        text = text.replace(f"{key}: {old} ", f"{key}: {new} ")
    path = tmp_path / "brief.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def found_on(path: Path, runs: int = 1) -> FrictionCompensation:
    return identify(load_scenario(str(path)), ["cat_food"], ["2"], runs, 0, None, map, lambda done, total: None)


def test_the_command_writes_a_compensation_and_a_scenario_that_uses_it(
    brief: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = brief.parent / "new" / "friction.yaml"
    arguments = ["friction", "identify", str(brief), "-o", str(output), "--objects", "cat_food", "--cases", "2"]
    assert main([*arguments, "--runs", "1", "--jobs", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["file"] == str(output)
    assert [(row["object"], row["case"], row["arm"]) for row in told["sets"]] == [("cat_food", "case_2", "arm")]
    scenario = load_scenario(told["scenario"])
    assert scenario.friction_compensation == found_on(brief)
    assert "# Single-arm hit-and-push" in Path(told["scenario"]).read_text(), "comments were lost"
    make_manifest(told["scenario"], ["cat_food"], ["2"])
    with pytest.raises(InputError, match="not identified for parcel case_1"):
        make_manifest(told["scenario"])
    before = output.read_bytes()
    assert main(arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert output.read_bytes() == before


def test_the_copy_in_another_folder_finds_the_robot_beside_the_scenario(brief: Path) -> None:
    robot = (config_directory() / "robots" / "franka_fer.yaml").read_text(encoding="utf-8")
    brief.with_name("mine.yaml").write_text(robot, encoding="utf-8")
    text = brief.read_text(encoding="utf-8")
    brief.write_text(text.replace("facts: franka_fer", "facts: mine.yaml"), encoding="utf-8")
    copy = write_compensation(found_on(brief), str(brief), brief.parent / "new" / "friction.yaml")
    assert "facts: ../mine.yaml" in copy.read_text(encoding="utf-8")
    assert load_scenario(str(copy)).robots == load_scenario(str(brief)).robots


def with_mesh(path: Path) -> None:
    """Another scenario whose object is a cube from a mesh beside it."""
    corners = [(x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)]
    faces = ["1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4"]
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {face}" for face in faces)]
    path.with_name("box.obj").write_text("\n".join(lines), encoding="utf-8")
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["objects"] = {"box": {"label": "box", "mass": 0.5, "mesh": "box.obj"}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")


def test_the_copy_in_another_folder_finds_the_mesh_beside_the_scenario(brief: Path) -> None:
    """Kills: paths of robots alone; the copy did not load, and the identified compensation was removed with it."""
    with_mesh(brief)
    output = brief.parent / "new" / "friction.yaml"
    assert prepare_output(str(brief), output).name == "brief_compensated.yaml"  # it loads the copy
    assert list(output.parent.iterdir()) == []


def test_a_copy_that_does_not_load_is_refused_before_the_identification(
    brief: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a check of the names of files alone, before an identification that takes minutes to hours."""
    monkeypatch.setattr(friction_files, "_copy_of", lambda *_: "name: none")
    output = brief.parent / "friction.yaml"
    with pytest.raises(InputError, match="brief_compensated.yaml"):
        prepare_output(str(brief), output)
    assert [path.name for path in brief.parent.iterdir()] == ["brief.yaml"]


def test_identifying_again_starts_from_the_uncompensated_plant(brief: Path) -> None:
    first = found_on(brief)
    copy = write_compensation(first, str(brief), brief.with_name("first.yaml"))
    assert found_on(copy) == first
    again = write_compensation(first, str(copy), brief.with_name("second.yaml"))
    assert again.read_text(encoding="utf-8").count("friction_compensation:") == 1
    assert load_scenario(str(again)).friction_compensation == first


def test_a_compensation_that_does_not_load_leaves_nothing(brief: Path) -> None:
    other = found_on(brief).model_copy(update={"scenario_digest": "0123"})
    with pytest.raises(InputError, match="identify it again"):
        write_compensation(other, str(brief), brief.parent / "friction.yaml")
    assert [path.name for path in brief.parent.iterdir()] == ["brief.yaml"]
