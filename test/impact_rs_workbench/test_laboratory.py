# SPDX-License-Identifier: Apache-2.0
"""A folder of somebody else's recordings: what is in it is found, looked at, and described in files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from known_recordings import JOINTS, BagFormat, Signals
from mixed_grab import FILE
from starlette.testclient import TestClient

from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.experiment import load_experiment, read_runs
from impact_rs_trials.recordings.laboratory import LaboratoryRun, read_laboratory

KNOWN = Signals.known()
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m", "command": "N m", "object_pose": "m"}


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Joint states out of order and with a finger, commands without a stamp, and the pose of a parcel."""
    joints, topics = ["panda_finger_joint1", *JOINTS], {"/mocap/box/pose": "/mocap/parcel/pose"}
    order = [0, *(int(name[-1]) - 1 for name in JOINTS)]
    return BagFormat(joints=joints, order=order, topics=topics).write(tmp_path_factory.mktemp("lab") / "run", KNOWN)


@pytest.fixture
def lab(tmp_path: Path, recording: Path) -> Path:
    for name in ("run_1", "run_2"):
        shutil.copytree(recording, tmp_path / "lab" / name)
    return tmp_path / "lab"


def looked(client: TestClient, path: str = "lab", scenario: str = "push") -> dict[str, Any]:
    answer = client.get("/api/laboratory", params={"path": path, "scenario": scenario})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def arms_of(found: dict[str, Any]) -> dict[str, Any]:
    """What the names hint at, as the page sends it."""
    return {
        arm: {
            "joints": own["joints"],
            "signals": {
                name: found["streams"][number]["source"] | {"unit": UNITS[name]}
                for name, number in own["signals"].items()
            },
        }
        for arm, own in found["arms"].items()
    }


def pose_of(found: dict[str, Any]) -> dict[str, Any]:
    return found["streams"][found["object_pose"]]["source"] | {"unit": "m"}


def previewed(client: TestClient, found: dict[str, Any], signal: str, **change: Any) -> Any:
    (own,) = arms_of(found).values()
    source = pose_of(found) if signal == "object_pose" else own["signals"][signal]
    request = {"path": found["path"], "scenario": "push", "arm": "arm", "signal": signal, "joints": own["joints"]}
    request |= {"source": source | change.pop("source", {}), "position": own["signals"]["position"]}
    return client.post("/api/laboratory/preview", json=request | change).json()


def test_a_preview_shows_a_signal_in_si_units_in_the_order_of_the_joints(client: TestClient, lab: Path) -> None:
    found = looked(client)
    assert found["recording"] == "run_1"
    seen = previewed(client, found, "position", source={"unit": "mrad"})
    assert (seen["samples"], seen["wrong"]) == (700, "")
    assert seen["rate"] == pytest.approx(1000.0)
    assert seen["ranges"] == [{"unit": "rad", "low": pytest.approx(1e-3 * KNOWN.position.min()), "high": pytest.approx(
        1e-3 * KNOWN.position.max())}]  # fmt: skip
    assert [column["name"] for column in seen["columns"]] == [f"panda_joint{number}" for number in range(1, 8)]
    shown = np.array([column["values"] for column in seen["columns"]]).T
    np.testing.assert_allclose(shown, 1e-3 * KNOWN.position[::3], rtol=1e-4)


def test_a_signal_without_a_stamp_is_brought_to_the_clock_of_the_joints(client: TestClient, lab: Path) -> None:
    assert previewed(client, looked(client), "command")["samples"] == 700


@pytest.mark.parametrize(
    ("signal", "change", "complaint"),
    [
        ("velocity", {"source": {"unit": "deg/s"}}, "velocity is 0.0174 times the derivative of position"),
        ("torque", {"source": {"unit": "mN m"}}, "torque holds 0.00 times the weight of the scenario's arm"),
        ("command", {"source": {"factor": -1.0}}, "command holds -1.00 times the weight"),
        ("position", {"source": {"unit": "m"}}, "joint 1 of franka_fer turns, expected rad or mrad or deg"),
        ("velocity", {"joints": [f"panda_joint{n}" for n in (1, 2, 3)]}, "franka_fer has 7 joints, the mapping names"),
    ],
)
def test_a_signal_that_cannot_be_what_it_is_taken_for_is_shown_with_one_line(
    client: TestClient, lab: Path, signal: str, change: dict[str, Any], complaint: str
) -> None:
    seen = previewed(client, looked(client), signal, **change)
    assert complaint in seen["wrong"]
    assert "\n" not in seen["wrong"]
    assert seen["samples"] == 700


@pytest.mark.parametrize(
    ("signal", "change", "complaint"),
    [
        ("object_pose", {"source": {"topic": "/joint_states", "type": None}}, "a field that holds a pose"),
        ("torque", {"source": {"topic": "/joint_state"}}, "expected topic /joint_state of type"),
        ("position", {"joints": ["panda_joint9"]}, "joint panda_joint9 is missing; the messages name"),
        ("position", {"arm": "amr"}, "scenario 'push' has no arm 'amr'"),
    ],
)
def test_a_signal_that_is_not_there_is_refused_in_one_line(
    client: TestClient, lab: Path, signal: str, change: dict[str, Any], complaint: str
) -> None:
    error = previewed(client, looked(client), signal, **change)["error"]
    assert complaint in error
    assert "\n" not in error


def description(found: dict[str, Any], **other: Any) -> dict[str, Any]:
    runs = [
        {"bag": "run_1", "object": "parcel", "kind": "hit", "condition": "case_1"},
        {"bag": "run_2", "object": "none", "kind": "free motion", "condition": "slow"},
    ]
    content = {"path": "lab", "scenario": "push", "arms": arms_of(found), "object_pose": pose_of(found), "runs": runs}
    return content | other


def test_what_is_written_is_an_experiment_that_can_be_read(client: TestClient, lab: Path) -> None:
    answer = client.post("/api/laboratory", json=description(looked(client)))
    assert answer.status_code == 200, answer.text
    assert answer.json()["written"] == ["lab/experiment.yaml", "lab/mapping.yaml", "lab/runs.csv"]
    assert "compare" in answer.json()["command"]
    assert "run_1: /effort_controller/commands: log time" in answer.json()["remarks"][0]
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
    "no torque": ({"arms": {"arm": {"joints": ["a"], "signals": {}}}}, "signals.position: this signal is needed"),
    "another arm": ({"arms": {}}, "arms.arm: scenario 'push' has this arm"),
    "a pose in mm": ({"object_pose": {"topic": "/mocap/parcel/pose", "unit": "mm"}}, "on the support"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_mistake_in_the_description_leaves_nothing_behind(client: TestClient, lab: Path, name: str) -> None:
    change, expected = BROKEN[name]
    answer = client.post("/api/laboratory", json=description(looked(client), **change))
    assert answer.status_code == 400
    assert expected in answer.json()["error"]
    assert "\n" not in answer.json()["error"]
    assert sorted(path.name for path in lab.iterdir()) == ["run_1", "run_2"]


def test_a_description_is_tried_on_a_hit_wherever_it_stands_in_the_table(client: TestClient, lab: Path) -> None:
    runs = list(reversed(description(looked(client))["runs"]))
    assert [run["kind"] for run in runs] == ["free motion", "hit"]
    in_millimetres = {"topic": "/mocap/parcel/pose", "unit": "mm"}
    answer = client.post("/api/laboratory", json=description(looked(client), runs=runs, object_pose=in_millimetres))
    assert "run_1" in answer.json()["error"]
    assert "on the support" in answer.json()["error"]


def test_a_folder_that_is_described_is_not_overwritten(client: TestClient, lab: Path) -> None:
    (lab / "runs.csv").write_text("mine")
    answer = client.post("/api/laboratory", json=description(looked(client)))
    assert "this file exists already" in answer.json()["error"]
    assert (lab / "runs.csv").read_text() == "mine"


RUNS = "bag,object,kind,condition\nrun_1,parcel,hit,pose_a\nrun_2,none,free motion,slow\n"


def test_the_users_own_table_of_runs_is_read_shown_and_kept(client: TestClient, lab: Path) -> None:
    (lab / "runs.csv").write_text(RUNS)
    found = looked(client)
    assert found["table"] == {
        "name": "runs.csv",
        "rows": [
            {"bag": "run_1", "object": "parcel", "kind": "hit", "condition": "pose_a"},
            {"bag": "run_2", "object": "none", "kind": "free motion", "condition": "slow"},
        ],
        "error": "",
    }
    answer = client.post("/api/laboratory", json=description(found, runs=None))
    assert answer.status_code == 200, answer.text
    assert answer.json()["written"] == ["lab/experiment.yaml", "lab/mapping.yaml"]
    assert (lab / "runs.csv").read_text() == RUNS
    experiment = load_experiment(lab / "experiment.yaml")
    assert [row.condition for row in read_runs(lab, experiment, experiment.load_scenario())] == ["pose_a", "slow"]


def test_what_is_wrong_in_the_users_own_table_is_told_with_its_line(client: TestClient, lab: Path) -> None:
    (lab / "runs.csv").write_text(RUNS.replace("parcel", "percel"))
    assert "line 2, object = 'percel': expected an object of scenario 'push'" in looked(client)["table"]["error"]
    answer = client.post("/api/laboratory", json=description(looked(client), runs=None))
    assert "line 2, object = 'percel'" in answer.json()["error"]
    assert not (lab / "experiment.yaml").exists()


def test_without_a_table_somebody_has_to_say_what_the_runs_are(client: TestClient, lab: Path) -> None:
    assert looked(client)["table"] is None
    assert (
        "no table of runs 'runs.csv'"
        in client.post("/api/laboratory", json=description(looked(client), runs=None)).json()["error"]
    )
    assert sorted(path.name for path in lab.iterdir()) == ["run_1", "run_2"]


def told_run(folder: Path) -> LaboratoryRun:
    ((run,), skipped) = read_laboratory(folder, load_experiment(folder / "experiment.yaml"), map)
    assert skipped == []
    return run


def test_arms_of_different_kinds_get_a_mapping_each(
    client: TestClient, tmp_path: Path, mixed_trial: Path, rewrite_bag: Callable[..., None]
) -> None:
    (tmp_path / "lab").mkdir()
    rewrite_bag(mixed_trial, tmp_path / "lab" / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    shutil.copy(FILE, tmp_path / "mixed.yaml")
    found = looked(client, scenario="mixed.yaml")
    assert {arm: own["robot"] for arm, own in found["arms"].items()} == {"left": "franka_fr3", "right": "ur5e"}
    runs = [{"bag": "run_1", "object": "parcel", "kind": "hit", "condition": "case_1"}]
    content = description(found, scenario="mixed.yaml", runs=runs)
    crossed = {"left": content["arms"]["left"], "right": content["arms"]["left"] | {"joints": ["left_joint1"] * 6}}
    answer = client.post("/api/laboratory", json=content | {"arms": crossed})
    assert answer.status_code == 400
    answer = client.post("/api/laboratory", json=content)
    assert answer.json().get("written") == [
        "lab/experiment.yaml", "lab/mapping_left.yaml", "lab/mapping_right.yaml", "lab/runs.csv",
    ], answer.text  # fmt: skip
    run = told_run(tmp_path / "lab")
    for file in ("experiment.yaml", "mapping_left.yaml", "mapping_right.yaml", "runs.csv"):
        (tmp_path / "lab" / file).unlink()
    answer = client.post("/api/laboratory", json=content | {"world_from_hits": True})
    assert answer.status_code == 200, answer.text
    placed = told_run(tmp_path / "lab")  # the tracker's world is the robots', which the pads of both arms tell
    assert placed.object_position == pytest.approx(run.object_position, abs=0.01)
    assert placed.remarks[0].startswith("motion capture placed from contact in 2 hits")
    assert {arm: own.command.shape[1] for arm, own in run.arms.items()} == {"left": 7, "right": 6}
    assert run.object_time.size > 100


def test_a_robot_of_ones_own_with_a_joint_that_slides_is_described_with_its_file_and_its_units(
    client: TestClient, tmp_path: Path
) -> None:
    facts = yaml.safe_load((config_directory() / "robots" / "franka_fer.yaml").read_text())
    facts["joints"][0]["type"] = "prismatic"
    facts["limits"]["torque_Nm"][0] = 500.0  # N, for the first joint lifts the arm
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "lift.yml").write_text(yaml.safe_dump(facts))
    scenario = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text())
    scenario["robots"]["arm"]["facts"] = "robots/lift.yml"
    (tmp_path / "lift_push.yaml").write_text(yaml.safe_dump(scenario))
    physics = Physics.nominal(load_scenario(str(tmp_path / "lift_push.yaml")), "parcel")
    model = physics.robot_model("arm")
    torque = np.array([model.gravity_torque(q) for q in KNOWN.position])
    factor = np.array([1e3, *[1.0] * 6])  # mm, rad
    (tmp_path / "lab").mkdir()
    np.savez(
        tmp_path / "lab" / "up.npz", time=1e-9 * KNOWN.time, q=KNOWN.position * factor, dq=KNOWN.velocity * factor,
        tau=torque,
    )  # fmt: skip
    found = looked(client, scenario="lift_push.yaml")
    (own,) = found["arms"].values()
    assert (own["robot"], own["slides"]) == ("lift", [True, *[False] * 6])
    units = {"position": ["mm", *["rad"] * 6], "velocity": ["mm/s", *["rad/s"] * 6], "torque": ["N", *["N m"] * 6]}
    signals = {name: found["streams"][own["signals"][name]]["source"] | {"unit": unit} for name, unit in units.items()}
    request = {"path": "lab/up.npz", "scenario": "lift_push.yaml", "arm": "arm", "joints": own["joints"]}
    request |= {"signal": "velocity", "source": signals["velocity"], "position": signals["position"]}
    seen = client.post("/api/laboratory/preview", json=request).json()
    assert seen["wrong"] == ""
    assert [(part["unit"], part["high"]) for part in seen["ranges"]] == [("m/s", pytest.approx(0.2)), ("rad/s", 0.2)]
    wrong = request | {"source": signals["velocity"] | {"unit": "rad/s"}}
    assert "joint 1 of" in client.post("/api/laboratory/preview", json=wrong).json()["wrong"]
    content = {
        "path": "lab", "scenario": "lift_push.yaml", "arms": {"arm": {"joints": own["joints"], "signals": signals}},
        "runs": [{"bag": "up.npz", "object": "none", "kind": "free motion", "condition": "up"}],
    }  # fmt: skip
    answer = client.post("/api/laboratory", json=content)
    assert answer.status_code == 200, answer.text
    assert yaml.safe_load((tmp_path / "lab" / "mapping.yaml").read_text())["robot"] == "../robots/lift.yml"
    np.testing.assert_allclose(told_run(tmp_path / "lab").arms["arm"].position, KNOWN.position, atol=1e-12)
    scenario["robots"]["arm"]["facts"] = facts
    (tmp_path / "lift_push.yaml").write_text(yaml.safe_dump(scenario))
    answer = client.get("/api/laboratory", params={"path": "lab", "scenario": "lift_push.yaml"})
    assert "robots.arm.facts: the robot is described in the scenario itself" in answer.json()["error"]
