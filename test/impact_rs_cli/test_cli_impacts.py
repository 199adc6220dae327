# SPDX-License-Identifier: Apache-2.0
"""The loop on a table of impacts: compare, diagnose, add, history; and every mistake in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from impact_table_cases import CUBE_HEADER, arm_table, cube, cube_rows, write_csv
from measured_data import measured_data

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.main import main
from impact_rs_sim.impact_map.measured import MeasuredImpact, points_that_touch, solve_measured
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.scene import BodyState
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

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


def test_a_dependence_on_a_covariate_is_in_text_document_and_page(
    tmp_path: Path, document: Document, capfd: pytest.CaptureFixture
) -> None:
    rows = [[*row, "A"] for row in cube_rows(cube(0.5, 0.2), 24)]
    rows += [[*row, "B"] for row in cube_rows(cube(0.5, 0.4), 24, seed=1)]
    path = write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "session"], rows)
    table = ("--impacts", str(path), "--covariates", "session", "--jobs", "1")
    (remark,) = (text for text in document("compare", *table)["remarks"] if text.startswith("differences by session"))
    assert "m/s with session A, " in remark
    capfd.readouterr()
    only = ("--effects", "restitution", "support_friction")
    diagnosis, report = tmp_path / "diagnosis.json", tmp_path / "report"
    assert main(["diagnose", *table, *only, "-o", str(diagnosis), "--report", str(report)]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert "restitution depends on session: 0." in shown and "Dependences on circumstances" in shown
    found = read_document(diagnosis)
    (one,) = (entry for entry in found.dependences if entry.accepted)
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
    assert "column 'q1 [rad]' belongs to an arm; give robot, pad and support with --scenario NAME" in line
    assert document("compare", "--impacts", path, "--scenario", "push", "--jobs", "1")["trials"] == 6


def test_too_few_rows_can_be_compared_and_not_decided(tmp_path: Path, document: Document) -> None:
    table = ("--impacts", write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 5)), "--jobs", "1")
    assert document("compare", *table)["trials"] == 5
    found = document("diagnose", *table)
    assert found["verdict"] == "TOO-FEW-REPEATS"
    assert "7 more stretches of motion or impacts: 5 of 12 needed" in found["summary"]


# ---- from raw files to a verdict ------------------------------------------------------------------------------------


RATE = 200.0  # Hz
SIZE, MASS = 0.1, 0.4  # m, kg
TRUTH_E = 0.4


def tossed_cube() -> Physics:
    moments = np.full(3, MASS * SIZE**2 / 6.0)
    body = ObjectPhysics(MASS, np.full(3, SIZE), moments, np.zeros(3))
    return Physics({}, body, None, (np.inf, np.inf), 0.25, 0.0, TRUTH_E)


def toss(path: Path, rng: np.random.Generator) -> None:
    """A cube that lands on a corner, in the millimetres of its tracker, w x y z, without stamps or names."""
    rotation = pin.rpy.rpyToMatrix(*rng.uniform([0.4, 0.4, 0.0], [0.8, 0.7, 3.0]))
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    height = float(-np.min(0.5 * SIZE * signs @ rotation[2]))
    twist = np.concatenate((rng.uniform([-0.5, -0.5, -1.6], [0.5, 0.5, -1.0]), rng.uniform(-3.0, 3.0, 3)))
    body = BodyState(np.array([0.1, 0.2, height]), rotation, twist)
    impact = MeasuredImpact({}, body, points_that_touch(body, np.full(3, SIZE), np.array([0.0, 0.0, 1.0])))
    after, _ = solve_measured(tossed_cube(), impact)
    rows = []
    for sample in range(-15, 16):
        t = (sample + 0.4) / RATE
        own = twist if t < 0.0 else after
        place = body.position + own[:3] * t - [0.0, 0.0, 4.905 * t**2]
        x, y, z, w = pin.Quaternion(pin.exp3(own[3:] * t) @ rotation).coeffs()
        rows.append([*(1e3 * (place + 2e-5 * rng.standard_normal(3))), w, x, y, z])
    np.savetxt(path, rows, delimiter=",", header="mx,my,mz,qw,qx,qy,qz", comments="", fmt="%.9g")


def test_tosses_go_from_raw_files_to_a_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw, lab = tmp_path / "raw", tmp_path / "lab"
    raw.mkdir()
    rng = np.random.default_rng(0)
    for number in range(8):
        toss(raw / f"toss_{number}.csv", rng)
    assert main(["import", str(raw), "--robot", "none", "--rate", "200", "-o", str(lab)]) == 0
    assert "ASSUMED" in (lab / "experiment.yaml").read_text()
    assert main(["impacts", str(raw), "--experiment", str(lab / "experiment.yaml"), "-o", str(tmp_path / "t.csv")]) == 2
    assert "body" in capsys.readouterr().err
    experiment = yaml.safe_load((lab / "experiment.yaml").read_text())
    experiment["body"] = {"mass": MASS, "size": [SIZE] * 3}
    (lab / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    table = tmp_path / "tosses.csv"
    command = ["impacts", str(raw), "--experiment", str(lab / "experiment.yaml"), "-o", str(table), "--jobs", "1"]
    capsys.readouterr()
    assert main([*command, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["runs"] == 8
    assert said["rows"] + len(said["left_out"]) == 8
    assert said["rows"] >= 6
    rows = read_impact_table(table).rows
    ratios = []
    for row in rows:
        (point,) = row.impact.points
        arm = point.position - row.impact.object.position
        before, after = (twist[2] + np.cross(twist[3:], arm)[2] for twist in (row.impact.object.twist, row.after))
        ratios.append(-after / before)
    assert np.mean(ratios) == pytest.approx(TRUTH_E, abs=0.02)
    assert main(command) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert main(["import", str(raw), "--robot", "none", "--rate", "200", "-o", str(lab)]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert main(["compare", "--impacts", str(table)]) == 0


def test_mistakes_of_import_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("t,q1\n0,1\n1,2\n2,3\n")
    for arguments, said in (
        ([str(tmp_path / "b.csv")], "no such file or folder"),
        ([str(tmp_path / "a.csv")], "--robot is needed"),
        ([str(tmp_path / "a.csv"), "--robot", "franka_fr3", "--rate", "0"], "expected a sampling rate > 0 Hz"),
    ):
        assert main(["import", *arguments, "-o", str(tmp_path / "lab")]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "lab").exists()


BALL_RADIUS, BALL_E, BALL_FRICTION = 0.02, 0.87, 0.14  # m


def bounce(path: Path, rng: np.random.Generator) -> None:
    """A hollow ball without spin that slides through its bounce, seen to a millimetre, without its turn.

    In closed form: dv_n = (1 + e) v_n, dv_t = -mu dv_n as long as the slip lasts, of which the spin takes 3/2.
    """
    angle, speed, fall = rng.uniform(0.0, 6.3), rng.uniform(2.5, 4.0), rng.uniform(1.0, 2.5)
    time = (np.arange(-60, 61) + rng.uniform(0.2, 0.8)) / 250.0
    rise = (1.0 + BALL_E) * fall
    assert 2.5 * BALL_FRICTION * rise < speed
    before = np.array([speed * np.cos(angle), speed * np.sin(angle), -fall])
    after = before + np.array([-BALL_FRICTION * np.cos(angle), -BALL_FRICTION * np.sin(angle), 1.0]) * rise
    place = np.where(time[:, None] < 0.0, before, after) * time[:, None] - np.outer(4.905 * time**2, [0.0, 0.0, 1.0])
    place += [0.3, -0.2, BALL_RADIUS] + 1e-3 * rng.standard_normal(place.shape)
    np.savetxt(path, np.column_stack((time + 5.0, place)), delimiter=";", header="t;x;y;z", comments="", fmt="%.6f")


def test_balls_whose_turn_was_not_tracked_give_restitution_and_friction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw, lab, table = tmp_path / "raw", tmp_path / "lab", tmp_path / "balls.csv"
    raw.mkdir()
    rng = np.random.default_rng(4)
    for number in range(30):
        bounce(raw / f"ball_{number}.csv", rng)
    assert main(["import", str(raw), "--robot", "none", "-o", str(lab)]) == 0
    assert "no column is its orientation" in capsys.readouterr().out
    experiment = yaml.safe_load((lab / "experiment.yaml").read_text())
    experiment["body"] = {"mass": 0.0027, "radius": BALL_RADIUS, "shell": True}
    command = ["impacts", str(raw), "--experiment", str(lab / "experiment.yaml"), "-o", str(table), "--jobs", "1"]
    (lab / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    assert main(command) == 2
    assert "for a ball give body.spin, [0, 0, 0] if it was dropped without spin" in capsys.readouterr().err
    experiment["body"]["spin"] = [0, 0, 0]
    (lab / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    assert main(command) == 0
    assert "the rotation of the ball was not tracked" in capsys.readouterr().out
    assert "wx_after" not in table.read_text()
    assert main(["diagnose", "--impacts", str(table), "--json", "--jobs", "1"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["named"] == ["restitution", "support_friction"]
    effects = {effect["name"]: effect["parameters"] for effect in found["effects"]}
    for values, truth in (
        (effects["restitution"]["restitution"], BALL_E),
        (effects["support_friction"]["friction"], BALL_FRICTION - 0.3),
    ):
        low, high = values["ci95"]
        assert low <= truth <= high and high - low < 0.05


def test_a_pendulum_of_another_laboratory_goes_from_its_table_to_a_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its model describes it up to a noise of 0.001 N m."""
    case = measured_data("cases", "one_joint")
    lab = tmp_path / "lab"
    assert main(["import", str(case / "swing.csv"), "--robot", str(case / "pendulum.yaml"), "-o", str(lab)]) == 0
    for mapping in (case / "mapping_motor.yaml", lab / "mapping.yaml"):
        capsys.readouterr()
        assert main(["compare", str(case / "swing.csv"), "--mapping", str(mapping), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["score"] == pytest.approx(0.001, abs=0.0005)
