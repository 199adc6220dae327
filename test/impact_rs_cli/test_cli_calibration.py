# SPDX-License-Identifier: Apache-2.0
"""A fault of a reading goes into the calibration beside the data and never into the model: diagnose, add, compare."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from ball_impacts import turned_ball_table
from intervals import assert_covers
from joint_recordings import write_npz
from slender_arm import mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.main import main
from impact_rs_sim.model import load_model

Document = Callable[..., dict[str, Any]]
Refused = Callable[..., str]

DELAY, COULOMB = 0.02, (0.8, 0.4, 0.27)  # s, N m
CONSIDERED = ("joint_coulomb_friction", "joint_viscous_friction", "torque_offset", "torque_delay")
NAMED = ("joint_coulomb_friction", "torque_delay")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm with friction whose torques are recorded 20 ms late, and the diagnosis of it."""
    folder = tmp_path_factory.mktemp("delayed")
    mapping = mapping_of(folder, slender_arm(("revolute",) * 3))
    friction = {f"coulomb_joint{joint}": value for joint, value in enumerate(COULOMB, start=1)}
    planted = {"joint_coulomb_friction": friction, "torque_delay": {"delay": DELAY}}
    write_npz(folder / "run.npz", swung(mapping, planted))
    output = str(folder / "diagnosis.json")
    words = ["diagnose", *map(str, data_of(folder)), "--effects", *CONSIDERED, "-o", output]
    assert main(words) == 0
    return folder


def data_of(folder: Path) -> tuple[object, ...]:
    return (folder / "run.npz", "--mapping", folder / "mapping.yaml", "--jobs", "1")


@pytest.fixture
def laboratory(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the folder, whose diagnosis is of the copy."""
    for name in ("run.npz", "mapping.yaml", "robot.yaml"):
        (tmp_path / name).write_bytes((recorded / name).read_bytes())
    text = (recorded / "diagnosis.json").read_text(encoding="utf-8")
    (tmp_path / "diagnosis.json").write_text(text.replace(str(recorded), str(tmp_path)), encoding="utf-8")
    return tmp_path


def test_a_torque_delay_is_said_first_and_calibrates_the_laboratory(laboratory: Path, document: Document) -> None:
    """The whole loop; kills: add writes the delay into the model, compare or history without the calibration."""
    diagnosis, child = laboratory / "diagnosis.json", laboratory / "model_2.yaml"
    found = read_document(diagnosis)
    assert set(found.named) == set(NAMED)
    assert found.summary.startswith("The measurement: torques are recorded ")
    assert " ms late [" in found.measurement and found.measurement in found.summary
    assert "joint_coulomb_friction is missing in the physics." in found.summary
    assert [one.effect for one in found.calibrate] == ["torque_delay"]

    before = document("compare", *data_of(laboratory))
    added = document("add", *NAMED, "--from", diagnosis, "-o", child)
    assert (added["file"], added["calibration"]) == (str(child), str(laboratory / "calibration.yaml"))
    assert [item.name for item in load_model(child).effects] == ["joint_coulomb_friction"]
    (fault,) = load_model(laboratory / "calibration.yaml").effects
    value = fault.parameters["delay"]
    assert fault.name == "torque_delay" and value.ci95 is not None
    assert_covers(value.ci95, DELAY, 0.00093)

    after = document("compare", *data_of(laboratory), "--model", child)
    assert before["score"] > 0.4 and after["score"] < 1.1 * after["noise_floor"]
    assert (after["model"]["name"], after["calibration"]["effects"]) == ("model_2", ["torque_delay"])
    steps = document("history", child, "--runs", *data_of(laboratory))["history"]
    assert [step["effect_added"] for step in steps] == [None, "torque_delay", "joint_coulomb_friction"]
    errors = [step["error_fit"] for step in steps]
    assert errors == sorted(errors, reverse=True) and errors[-1] == pytest.approx(after["score"], rel=1e-3)
    held_out = [step["error_held_out"] for step in steps]
    assert held_out == pytest.approx(errors, rel=0.05)  # kills: weights of the model without the effect
    uncalibrated = document("compare", *data_of(laboratory), "--model", child, "--calibration", "nominal")
    assert uncalibrated["score"] > 0.1 and "calibration" not in uncalibrated


def test_a_known_fault_is_not_looked_for_again(
    laboratory: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    """Kills: diagnose without the calibration, and a document that does not say what was known."""
    assert main(["add", "torque_delay", "--from", str(laboratory / "diagnosis.json")]) == 0
    found = document("diagnose", *data_of(laboratory), "--effects", "joint_coulomb_friction", "joint_viscous_friction")
    assert found["named"] == ["joint_coulomb_friction"] and "measurement" not in found
    assert found["remarks"][0].startswith("the calibrated faults torque_delay were taken as exact")
    for command in ("diagnose", "discover"):
        assert main([command, *map(str, data_of(laboratory)), "--effects", "torque_delay"]) == 2
        said = capfd.readouterr().err
        assert "calibration.yaml: effects.0.name: torque_delay is calibrated and therefore not diagnosed" in said
    assert found["calibration"]["effects"] == ["torque_delay"] and found["model"]["name"] == "nominal"


def test_a_fault_alone_needs_no_model_file(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    diagnosis, child = laboratory / "diagnosis.json", laboratory / "model_2.yaml"
    assert main(["add", "torque_delay", "--from", str(diagnosis), "-o", str(child)]) == 0
    said = capfd.readouterr().out
    assert f"{laboratory / 'calibration.yaml'}: calibration with torque_delay (CONFIRMED)" in said
    assert "model_2.yaml is not written: no effect of the physics was added to 'nominal'" in said
    assert not child.exists()


def test_additions_that_would_count_twice_or_lose_half_are_refused(laboratory: Path, refused: Refused) -> None:
    """Kills: add without the digest of the calibration; a calibration written although the model cannot be."""
    diagnosis, child, calibration = (laboratory / name for name in ("diagnosis.json", "m.yaml", "calibration.yaml"))
    said = refused("add", "joint_coulomb_friction", "--from", diagnosis)
    assert "joint_coulomb_friction of the physics goes into a new model file; name it with -o FILE.yaml" in said
    child.write_text("name: mine\neffects: []\n", encoding="utf-8")
    assert "model files are never overwritten" in refused("add", *NAMED, "--from", diagnosis, "-o", child)
    assert not calibration.exists()
    new, nowhere = laboratory / "new.yaml", child / "calibration.yaml"  # below a file
    assert "cannot be written" in refused("add", *NAMED, "--from", diagnosis, "-o", new, "--calibration", nowhere)
    assert not new.exists()
    assert main(["add", "torque_delay", "--from", str(diagnosis)]) == 0
    text = calibration.read_text(encoding="utf-8")
    said = refused("add", "torque_delay", "--from", diagnosis)
    assert str(calibration) in said and "its faults would be included twice; diagnose the measurements again" in said
    assert calibration.read_text(encoding="utf-8") == text


def test_measurements_that_are_gone_need_the_name_of_the_calibration(
    laboratory: Path, tmp_path_factory: pytest.TempPathFactory, refused: Refused
) -> None:
    diagnosis, elsewhere = laboratory / "diagnosis.json", tmp_path_factory.mktemp("other") / "mine.yaml"
    (laboratory / "run.npz").unlink()
    assert "run.npz, now gone" in (said := refused("add", "torque_delay", "--from", diagnosis))
    assert "--calibration FOLDER/calibration.yaml" in said
    assert main(["add", "torque_delay", "--from", str(diagnosis), "--calibration", str(elsewhere)]) == 0
    assert load_model(elsewhere).effects[0].name == "torque_delay"
    content = json.loads(diagnosis.read_text(encoding="utf-8"))
    diagnosis.write_text(json.dumps(content | {"options": {}}), encoding="utf-8")
    assert "does not say where its measurements are" in refused("add", "torque_delay", "--from", diagnosis)


def test_a_calibration_with_an_effect_of_the_physics_is_refused(laboratory: Path, refused: Refused) -> None:
    """File, key and remedy; kills: the check of what acts on the reading."""
    physics = {"name": "object_mass", "parameters": {"scale": {"estimate": 1.1, "unit": "-"}}}
    file = laboratory / "calibration.yaml"
    file.write_text(yaml.safe_dump({"name": "mine", "effects": [physics]}), encoding="utf-8")
    said = refused("compare", *data_of(laboratory))
    assert f"{file}: effects.0.name: object_mass is an effect of the physics" in said
    assert "move it to the model file (--model)" in said


def test_a_fault_in_model_and_calibration_counts_once(
    laboratory: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    """A model of an earlier version may hold a delay, and still works; beside a calibration of it, it is refused."""
    delay = {"name": "torque_delay", "parameters": {"delay": {"estimate": DELAY, "unit": "s"}}}
    model = laboratory / "old.yaml"
    model.write_text(yaml.safe_dump({"name": "old", "effects": [delay]}), encoding="utf-8")
    alone = document("compare", *data_of(laboratory), "--model", model)["score"]
    (laboratory / "calibration.yaml").write_text(yaml.safe_dump({"name": "c", "effects": [delay]}), encoding="utf-8")
    assert document("compare", *data_of(laboratory))["score"] == pytest.approx(alone, rel=1e-9)
    assert main(["compare", *map(str, data_of(laboratory)), "--model", str(model)]) == 2
    assert "calibration.yaml: effects.0.name: model 'old' has torque_delay as well" in capfd.readouterr().err


def test_the_library_says_what_calibrates_a_reading(document: Document, capfd: pytest.CaptureFixture) -> None:
    found = {one["name"]: one for one in document("effects")["effects"]}
    assert found["torque_delay"]["of_measurement"] and found["torque_delay"]["calibration"]
    assert not found["object_mass"]["of_measurement"]
    assert main(["effects", "torque_delay"]) == 0
    assert "a fault of a reading; to calibrate it: move every joint" in capfd.readouterr().out


@pytest.mark.slow
def test_turned_axes_of_spins_calibrate_a_table(tmp_path: Path, document: Document) -> None:
    """Kills: a table read without the calibration beside it."""
    table = ("--impacts", turned_ball_table(tmp_path / "balls.csv", 0.0873), "--jobs", "1")
    diagnosis, child = tmp_path / "diagnosis.json", tmp_path / "model_2.yaml"
    effects = ("restitution", "support_friction", "drilling_friction", "spin_axes")
    found = document("diagnose", *table, "--effects", *effects, "-o", diagnosis)
    assert set(found["named"]) == {"restitution", "support_friction", "spin_axes"}
    begin = "The measurement: angular velocities are in axes turned by the rotation vector x 5."
    assert found["summary"].startswith(begin)  # y and z hold 0, and are not said
    assert "restitution and support_friction are missing in the physics." in found["summary"]
    assert main(["add", *found["named"], "--from", str(diagnosis), "-o", str(child)]) == 0
    assert {item.name for item in load_model(child).effects} == {"restitution", "support_friction"}
    after = document("compare", *table, "--model", child)
    assert after["score"] == pytest.approx(found["held_out_error_after"], rel=0.05)
    steps = document("history", child, *table)["history"]
    assert [step["effect_added"] for step in steps][:2] == [None, "spin_axes"]
    assert steps[0]["error_fit"] > steps[1]["error_fit"] > steps[2]["error_fit"]
    now = tmp_path / "now.yaml"  # follow knows the fault, and leaves it out of the model
    followed = document("follow", *table[:2], "--model", child, "-o", now, "--no-diagnosis")["followed"]
    assert "spin_axes.x" in {one["parameter"] for one in followed}
    assert {item.name for item in load_model(now).effects} == {"restitution", "support_friction"}
    assert load_model(now).parent_digest == load_model(child).digest
