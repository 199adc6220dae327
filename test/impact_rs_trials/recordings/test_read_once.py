# SPDX-License-Identifier: Apache-2.0
"""Files are read once within a block, again after a change, and not kept beyond it or without measure."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import swinging, write_bag

from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing import candidates
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.readers import bag_file, read_once
from impact_rs_trials.recordings.readers.read_once import files_read_once, once

TIME = np.arange(0.0, 6.0, 0.01)
read: list[str] = []


@once
def text_of(path: Path, suffix: str = "") -> str:
    read.append(path.name)
    return path.read_text() + suffix


@pytest.fixture
def file(tmp_path: Path) -> Path:
    read.clear()
    (tmp_path / "a.txt").write_text("a")
    return tmp_path / "a.txt"


def test_a_file_is_read_once_in_a_block_and_each_time_outside(file: Path) -> None:
    """Kills a store that outlives its block: the next import would see numbers of a file that was written anew."""
    with files_read_once():
        assert (text_of(file), text_of(file), text_of(file, suffix="b")) == ("a", "a", "ab")
    assert len(read) == 2
    text_of(file)
    text_of(file)
    assert len(read) == 4


def test_a_file_that_changes_is_read_again(file: Path) -> None:
    """Kills a key of the path alone; same size, later change."""
    with files_read_once():
        text_of(file)
        file.write_text("b")
        os.utime(file, ns=(1, 1))
        assert text_of(file) == "b"


def test_the_oldest_is_given_up_where_files_are_large(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills an import of many runs that keeps all of them in memory."""
    monkeypatch.setattr(read_once, "MAX_CACHED_BYTES", 3)
    others = [file.with_name(f"{number}.txt") for number in range(2)]
    with files_read_once():
        for one in (file, *others):
            one.write_text("ab")
            text_of(one)
        text_of(others[-1])
        text_of(file)
    assert read == ["a.txt", "0.txt", "1.txt", "a.txt"]


def test_an_import_reads_tables_once_and_bags_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Layout, candidates, raw numbers and the run as described; a bag's first messages show what its topics hold."""
    model = RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build())
    centre, joints = np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1]), np.arange(7)
    motion = swinging(model, TIME, centre, (0.11 + 0.02 * joints, 0.31 + 0.03 * joints), (0.35, 0.1))
    names = ["time", *(f"{name}{joint}" for name in ("q", "dq", "tau") for joint in range(1, 8))]
    table = np.column_stack([TIME, motion["position"], motion["velocity"], motion["effort"]])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=",".join(names), comments="")
    opened: list[str] = []
    data = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: opened.append(path.name) or data(path))
    draft_import([tmp_path / "run.csv"], tmp_path / "lab", ImportOptions(robot="kuka_iiwa7"))
    assert opened.count("run.csv") == 1
    write_bag(tmp_path / "bag", motion, list(range(7)), names=[f"joint{joint}" for joint in range(1, 8)])
    bags: list[Path] = []
    reader = bag_file.open_bag

    def counted(path: Path) -> object:
        bags.append(path)
        return reader(path)

    for module in (bag_file, candidates):
        monkeypatch.setattr(module, "open_bag", counted)
    draft_import([tmp_path / "bag"], tmp_path / "lab", ImportOptions(robot="kuka_iiwa7"))
    assert len(bags) == 2
