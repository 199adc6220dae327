# SPDX-License-Identifier: Apache-2.0
"""LeRobot data sets are imported by what meta/info.json says of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from builders import mapping_in
from servo_arm import Servos, servo_log, servo_mapping

from impact_rs_sim.robots.robot import load_facts
from impact_rs_trials.recordings.importing.candidates import SignalCandidate, of_side
from impact_rs_trials.recordings.importing.import_recordings import ImportDraft, ImportOptions, draft_import
from impact_rs_trials.recordings.readers.lerobot import data_set_of
from impact_rs_trials.recordings.readers.run_finder import find_recordings
from impact_rs_trials.recordings.recording import read_recordings

FPS = 50.0
NAMES = ["gripper.pos", "shoulder.pos", "elbow.pos"]  # a gripper first: numbers are taken by their names


def data_set(root: Path, names: object = NAMES, late: int = 0) -> Path:
    """Two episodes of an arm under position servos in one file, and the descriptions beside it."""
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    log = {name: values[::4] for name, values in servo_log(Servos(), 16.0).items()}
    count = len(log["time"]) // 2
    table = {"timestamp": np.tile(np.arange(count) / FPS, 2), "episode_index": np.repeat([0, 1], count)}
    grip = np.full((2 * count, 1), 0.5)
    wanted = np.roll(log["q_desired"], late, axis=0)
    for name, joints in (("observation.state", log["position"]), ("action", wanted)):
        table[name] = np.hstack((grip, joints[: 2 * count])).astype(np.float32).tolist()
    (root / "data/chunk-000").mkdir(parents=True)
    (root / "meta/episodes").mkdir(parents=True)
    pq.write_table(pa.table(table), root / "data/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"task_index": [0]}), root / "meta/episodes/file-000.parquet")
    features = {name: {"dtype": "float32", "names": names} for name in ("observation.state", "action")}
    info = {"codebase_version": "v3.0", "fps": FPS, "features": features | {"timestamp": {"names": None}}}
    (root / "meta/info.json").write_text(json.dumps(info), encoding="utf-8")
    return root


def imported(folder: Path, root: Path) -> ImportDraft:
    servo_mapping(folder)
    return draft_import([root], folder / "lab", ImportOptions(robot=str(folder / "robot.yaml")))


def test_episodes_are_runs_of_servos_without_hand_work(tmp_path: Path) -> None:
    """Kills numbers in the order of the file with a gripper before the joints, and descriptions read as recordings."""
    root = data_set(tmp_path / "set")
    draft = imported(tmp_path, root)
    assert draft.runs == 2
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.joints == ("shoulder.pos", "elbow.pos")
    assert mapping.servo is not None and mapping.signals["q_desired"].entries == (2, 3)
    runs = read_recordings(root, mapping)
    log = servo_log(Servos(), 16.0)["position"][::4]
    np.testing.assert_allclose(runs[0].signals.arms["arm"].position, log[: len(log) // 2], atol=1e-6)
    assert any("frame numbers over 50 Hz" in remark for remark in draft.remarks)


def test_desired_positions_that_show_no_torque_are_taken_because_the_format_says_so(tmp_path: Path) -> None:
    """Targets a fifth of a second late; kills a refusal, and gains that count as found."""
    draft = imported(tmp_path, data_set(tmp_path / "set", late=10))
    assert any("because its format says so" in remark for remark in draft.remarks)
    (said,) = [line for line in draft.lines if line.key == "servo"]
    assert not said.sure


@pytest.mark.parametrize("names", [[NAMES], {"motors": NAMES}])
def test_names_stand_in_lists_of_lists_and_in_dictionaries(tmp_path: Path, names: object) -> None:
    found = data_set_of(data_set(tmp_path / "set", names) / "data/chunk-000/file-000.parquet")
    assert found is not None and found.fps == FPS
    assert found.names["action"] == tuple(NAMES) and found.names["timestamp"] == ()


@pytest.mark.parametrize("text", ["{", "[]", '{"features": 3}'])
def test_another_info_file_describes_no_data_set(tmp_path: Path, text: str) -> None:
    root = data_set(tmp_path / "set")
    (root / "meta/info.json").write_text(text, encoding="utf-8")
    assert data_set_of(root) is None
    (root / "meta/info.json").unlink()
    assert len(find_recordings(root)) == 2  # a folder of this name is like any other


def test_the_arm_is_that_of_the_side_of_the_robot() -> None:
    """Both arms are as wide; names of links decide, and a robot without a side keeps both."""
    arms = [SignalCandidate(side, {}, False, "", 2, (f"{side}_a", f"{side}_b")) for side in ("left", "right")]
    facts = load_facts("ur5e")
    assert of_side(arms, facts) == arms
    links = [link.model_copy(update={"name": f"right_{number}"}) for number, link in enumerate(facts.links)]
    assert of_side(arms, facts.model_copy(update={"links": tuple(links)})) == arms[1:]
