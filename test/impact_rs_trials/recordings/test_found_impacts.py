# SPDX-License-Identifier: Apache-2.0
"""Impacts of an experiment keep the session that they were measured in, and what was not seen of them is said."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.found_impacts import find_impacts
from impact_rs_trials.recordings.impact_rows import table_text

EXPERIMENT = """\
mapping: mapping.yaml
body: {mass: 0.003, radius: 0.02, shell: true, spin: [0, 0, 0]}
"""
MAPPING = """\
description: a ball
robot: none
time: {column: t}
signals: {object_position: {columns: [x, y, z], unit: m}}
"""


def bounce(path: Path, height: float) -> None:
    """A ball that falls 0.3 s after its release from a height and comes back with half of its speed."""
    path.parent.mkdir(exist_ok=True)
    time = np.arange(0.0, 0.55, 0.004)
    speed = np.sqrt(2.0 * 9.81 * height)
    since = time - 0.25
    up = np.where(since < 0.0, -speed * since, 0.5 * speed * since) - 0.5 * 9.81 * since**2
    rows = [f"{t:.4f},0,{0.1 * t:.6f},{z + 0.02:.6f}" for t, z in zip(time, up, strict=True)]
    path.write_text("\n".join(["t,x,y,z", *rows]) + "\n")


@pytest.mark.parametrize("speed", [None, "fast"])
def test_impacts_of_two_sessions_stay_apart(tmp_path: Path, speed: str | None) -> None:
    """Runs of two folders are called alike; the session alone makes no repeats of what it holds."""
    for number, session in enumerate(("clean", "dirty")):
        bounce(tmp_path / session / "run_1.csv", 0.5 + 0.2 * number)
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    (tmp_path / "experiment.yaml").write_text(EXPERIMENT)
    further = (",speed", f",{speed}") if speed else ("", "")
    rows = [f"{session}/run_1,body,hit,{session}{further[1]}" for session in ("clean", "dirty")]
    (tmp_path / "runs.csv").write_text("\n".join([f"bag,object,kind,session{further[0]}", *rows]) + "\n")
    found = find_impacts(tmp_path, load_experiment(tmp_path / "experiment.yaml"), map)
    table = list(csv.DictReader(table_text(found.impacts, found.constants).splitlines()))
    assert [(row["run"], row["session"]) for row in table] == [("clean/run_1", "clean"), ("dirty/run_1", "dirty")]
    falls = [-float(row["vz_before [m/s]"]) for row in table]
    np.testing.assert_allclose(falls, np.sqrt(2.0 * 9.81 * np.array([0.5, 0.7])), rtol=1e-2)
    assert [row.get("condition") for row in table] == (["clean/fast", "dirty/fast"] if speed else [None, None])


def test_samples_of_a_body_that_are_no_numbers_are_said(tmp_path: Path) -> None:
    """A place with a number that is none is left out, and the impact stays the same."""
    bounce(tmp_path / "lab" / "run_1.csv", 0.5)
    (tmp_path / "lab" / "mapping.yaml").write_text(MAPPING)
    (tmp_path / "lab" / "experiment.yaml").write_text(EXPERIMENT)
    experiment = load_experiment(tmp_path / "lab" / "experiment.yaml")
    clean = find_impacts(tmp_path / "lab", experiment, map)
    lines = (tmp_path / "lab" / "run_1.csv").read_text().splitlines()
    lines[10] = f"{lines[10].rpartition(',')[0]},nan"
    lines[20] = f"{lines[20].rpartition(',')[0]},inf"
    (tmp_path / "lab" / "run_1.csv").write_text("\n".join(lines) + "\n")
    found = find_impacts(tmp_path / "lab", experiment, map)
    assert "column 'x' (object_position): 2 of 138 samples are no finite numbers: left out" in found.remarks
    speeds = [table_text(one.impacts, one.constants).splitlines()[1].split(",")[7:10] for one in (clean, found)]
    np.testing.assert_allclose(np.array(speeds[1], dtype=float), np.array(speeds[0], dtype=float), atol=1e-3)


def test_a_place_that_no_tracker_sees_is_refused(tmp_path: Path) -> None:
    bounce(tmp_path / "lab" / "run_1.csv", 0.5)
    (tmp_path / "lab" / "mapping.yaml").write_text(MAPPING.replace("unit: m}", "unit: m, factor: 1e9}"))
    (tmp_path / "lab" / "experiment.yaml").write_text(EXPERIMENT)
    found = find_impacts(tmp_path / "lab", load_experiment(tmp_path / "lab" / "experiment.yaml"), map)
    assert not found.impacts and "wrong unit or column?" in found.left_out[0].reason


def laboratory(folder: Path, lines: list[str]) -> Path:
    """One run of a ball with its description."""
    folder.mkdir()
    (folder / "run_1.csv").write_text("\n".join(lines) + "\n")
    (folder / "mapping.yaml").write_text(MAPPING)
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    return folder


def remarks_of(folder: Path) -> list[str]:
    return [
        one
        for one in find_impacts(folder, load_experiment(folder / "experiment.yaml"), map).remarks
        if "spin" not in one
    ]


def test_a_coordinate_that_never_changes_is_said(tmp_path: Path) -> None:
    """Zeros are those of a motion in a plane, or of an axis that was not tracked: nothing tells them apart."""
    bounce(tmp_path / "clean" / "run_1.csv", 0.5)
    names, *rows = (tmp_path / "clean" / "run_1.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    plane = laboratory(tmp_path / "plane", [names, *(",".join(row) for row in cells)])
    line = laboratory(tmp_path / "line", [names, *(",".join([*row[:2], "0", row[3]]) for row in cells)])
    space = laboratory(
        tmp_path / "space", [names, *(",".join([row[0], f"{0.2 * float(row[0]):.6f}", *row[2:]]) for row in cells)]
    )
    assert ["x the same in all samples: a motion in a plane" in remark for remark in remarks_of(plane)] == [True]
    assert ["x and y the same in all samples" in remark for remark in remarks_of(line)] == [True]
    assert remarks_of(space) == []


def test_a_jump_between_two_samples_is_no_motion_of_a_body(tmp_path: Path) -> None:
    """From the 30th sample on the place is 50 mm beside, as that of another marker."""
    bounce(tmp_path / "clean" / "run_1.csv", 0.5)
    names, *rows = (tmp_path / "clean" / "run_1.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    moved = [[row[0], f"{0.2 * float(row[0]) + 0.05 * (n >= 30):.6f}", *row[2:]] for n, row in enumerate(cells)]
    lab = laboratory(tmp_path / "lab", [names, *(",".join(row) for row in moved)])
    (remark,) = remarks_of(lab)
    assert "jumps by 5" in remark and "at t = 0.116 s" in remark
