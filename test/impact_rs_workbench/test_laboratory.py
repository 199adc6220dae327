# SPDX-License-Identifier: Apache-2.0
"""A folder of somebody else's recordings: what is in it is found, looked at, and described in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from starlette.testclient import TestClient

from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.experiment import load_experiment, read_runs

JOINTS = 7
STORE = typestore()
MAKE = {name.split("/")[-1]: kind for name, kind in STORE.types.items()}
TIME = np.arange(400) * 1e-3
POSITION = np.outer(np.sin(TIME), np.arange(1, JOINTS + 1) / 10.0)


def write_bag(path: Path) -> None:
    """Joint states out of order, commands without a stamp, and the pose of a parcel."""
    order = [2, 0, 1, 3, 4, 5, 6]
    names = [f"panda_joint{number + 1}" for number in order]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {
            topic: bag.add_connection(topic, kind, typestore=STORE)
            for topic, kind in (
                ("/joint_states", "sensor_msgs/msg/JointState"),
                ("/effort/commands", "std_msgs/msg/Float64MultiArray"),
                ("/mocap/parcel/pose", "geometry_msgs/msg/PoseStamped"),
            )
        }
        for step, q in enumerate(POSITION):
            header = MAKE["Header"](MAKE["Time"](100, step * 1_000_000), "world")
            log = 100 * 10**9 + step * 1_000_000
            command = MAKE["Float64MultiArray"](MAKE["MultiArrayLayout"]([], 0), q)
            pose = MAKE["Pose"](MAKE["Point"](1.0, 2.0, 3.0), MAKE["Quaternion"](0.0, 0.0, 0.0, 1.0))
            messages = {
                "/joint_states": MAKE["JointState"](header, names, q[order], q[order], q[order]),
                "/effort/commands": command,
                "/mocap/parcel/pose": MAKE["PoseStamped"](header, pose),
            }
            for topic, message in messages.items():
                bag.write(topics[topic], log + 300_000, STORE.serialize_cdr(message, message.__msgtype__))


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    folder = tmp_path / "lab"
    folder.mkdir()
    for name in ("run_1", "run_2"):
        write_bag(folder / name)
    return folder


def looked(client: TestClient, path: str = "lab") -> dict[str, Any]:
    answer = client.get("/api/laboratory", params={"path": path})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def sources(found: dict[str, Any], units: dict[str, str]) -> dict[str, Any]:
    """The signals as their names hint at them."""
    by_guess = {stream["guess"]: stream["source"] for stream in found["streams"]}
    return {name: by_guess[name] | {"unit": unit} for name, unit in units.items()}


UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m", "command": "N m", "object_pose": "m"}


def test_a_bag_offers_its_fields_with_the_joints_in_order(client: TestClient, lab: Path) -> None:
    found = looked(client)
    assert found["recording"] == "run_1"
    assert found["joints"] == [f"panda_joint{number}" for number in range(1, 8)]
    labels = [stream["label"] for stream in found["streams"]]
    assert labels == [
        "/joint_states: position (7)", "/joint_states: velocity (7)", "/joint_states: effort (7)",
        "/effort/commands: data (7)", "/mocap/parcel/pose",
    ]  # fmt: skip


def test_a_preview_shows_a_signal_in_si_units_in_the_order_of_the_joints(client: TestClient, lab: Path) -> None:
    found = looked(client)
    position = sources(found, {"position": "deg"})["position"]
    request = {"path": found["path"], "signal": "position", "source": position, "position": position}
    seen = client.post("/api/laboratory/preview", json=request | {"joints": found["joints"]}).json()
    assert (seen["samples"], seen["unit"]) == (400, "rad")
    assert seen["rate"] == pytest.approx(1000.0)
    assert seen["high"] == pytest.approx(np.radians(POSITION.max()))
    assert [column["name"] for column in seen["columns"]] == found["joints"]
    assert max(seen["columns"][6]["values"]) > max(seen["columns"][0]["values"])


def test_a_signal_without_a_stamp_is_brought_to_the_clock_of_the_joints(client: TestClient, lab: Path) -> None:
    found = looked(client)
    chosen = sources(found, UNITS)
    request = {"path": found["path"], "signal": "command", "source": chosen["command"], "position": chosen["position"]}
    seen = client.post("/api/laboratory/preview", json=request | {"joints": found["joints"]}).json()
    assert seen["samples"] == 400


def test_a_signal_taken_for_what_it_is_not_is_refused_in_one_line(client: TestClient, lab: Path) -> None:
    found = looked(client)
    chosen = sources(found, UNITS)
    request = {
        "path": found["path"],
        "signal": "object_pose",
        "position": chosen["position"],
        "joints": found["joints"],
    }
    answer = client.post("/api/laboratory/preview", json=request | {"source": chosen["torque"] | {"unit": "m"}})
    assert answer.status_code == 400
    assert "a field that holds a pose" in answer.json()["error"]


def description(found: dict[str, Any], **other: Any) -> dict[str, Any]:
    runs = [
        {"bag": "run_1", "object": "parcel", "kind": "hit", "condition": "case_1"},
        {"bag": "run_2", "object": "none", "kind": "free motion", "condition": "slow"},
    ]
    signals = sources(found, UNITS)
    return {"path": "lab", "scenario": "push", "joints": found["joints"], "signals": signals, "runs": runs} | other


def test_what_is_written_is_an_experiment_that_can_be_read(client: TestClient, lab: Path) -> None:
    answer = client.post("/api/laboratory", json=description(looked(client)))
    assert answer.status_code == 200, answer.text
    assert answer.json()["written"] == ["lab/experiment.yaml", "lab/mapping.yaml", "lab/runs.csv"]
    assert "compare" in answer.json()["command"]
    experiment = load_experiment(lab / "experiment.yaml")
    rows = read_runs(lab, experiment, experiment.load_scenario())
    assert [(row.name, row.object, row.hit, row.condition) for row in rows] == [
        ("run_1", "parcel", True, "case_1"), ("run_2", None, False, "slow"),
    ]  # fmt: skip
    mapping = experiment.load_mappings(["arm"])["arm"]
    assert mapping.robot == "franka_fer"
    assert mapping.signals["object_pose"].topic == "/mocap/{object}/pose"


BROKEN = {
    "an unknown object": ({"runs": [{"bag": "run_1", "object": "percel", "kind": "hit", "condition": "a"}]}, "parcel"),
    "an unknown kind": ({"runs": [{"bag": "run_1", "object": "parcel", "kind": "kick", "condition": "a"}]}, "'hit'"),
    "no such recording": ({"runs": [{"bag": "run_9", "object": "parcel", "kind": "hit", "condition": "a"}]}, "run_9"),
    "a missing joint": ({"joints": ["panda_joint9"]}, "panda_joint9"),
    "no torque": ({"signals": {}}, "signals.position: this signal is needed"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_mistake_in_the_description_leaves_nothing_behind(client: TestClient, lab: Path, name: str) -> None:
    change, expected = BROKEN[name]
    answer = client.post("/api/laboratory", json=description(looked(client), **change))
    assert answer.status_code == 400
    assert expected in answer.json()["error"]
    assert "\n" not in answer.json()["error"]
    assert sorted(path.name for path in lab.iterdir()) == ["run_1", "run_2"]


def test_a_folder_that_is_described_is_not_overwritten(client: TestClient, lab: Path) -> None:
    (lab / "runs.csv").write_text("mine")
    answer = client.post("/api/laboratory", json=description(looked(client)))
    assert "this file exists already" in answer.json()["error"]
    assert (lab / "runs.csv").read_text() == "mine"


def test_tables_and_arrays_offer_groups_of_columns_and_arrays(client: TestClient, tmp_path: Path) -> None:
    names = [f"{signal}_{joint}" for signal in ("q", "dq", "tau") for joint in range(1, 8)]
    names += [f"box_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    rows = np.column_stack([TIME, *[POSITION] * 3, np.tile([0.0] * 6 + [1.0], (TIME.size, 1))])
    (tmp_path / "csv").mkdir()
    np.savetxt(tmp_path / "csv" / "run.csv", rows, delimiter=",", header=",".join(["time", *names]), comments="")
    found = looked(client, "csv")
    guesses = {stream["guess"]: stream["source"] for stream in found["streams"]}
    assert guesses["position"] == {"column": "q_{joint}"}
    assert guesses["velocity"] == {"column": "dq_{joint}"}
    assert guesses["object_pose"]["columns"][-1] == "box_qw"
    (tmp_path / "npz").mkdir()
    np.savez(tmp_path / "npz" / "run.npz", time=TIME, position=POSITION, object_pose=rows[:, -7:])
    guesses = {stream["guess"]: stream["source"] for stream in looked(client, "npz")["streams"]}
    assert guesses == {"position": {"array": "position"}, "object_pose": {"array": "object_pose"}}
    source = {"array": "position", "unit": "rad"}
    request = {"path": "npz/run.npz", "signal": "position", "source": source, "position": source}
    seen = client.post("/api/laboratory/preview", json=request | {"joints": found["joints"]}).json()
    assert seen["samples"] == 400
