# SPDX-License-Identifier: Apache-2.0
"""A folder of recordings of another controller: what is in it is found, looked at, and described in files."""

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
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.experiment import load_experiment, read_runs
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.runs import Run

KNOWN = Signals.known()
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m", "command": "N m"}
HIT = {"bag": "run_1", "object": "parcel", "kind": "hit", "condition": "case_1"}
FREE = {"bag": "run_2", "object": "none", "kind": "free motion", "condition": "slow"}


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


class Folder:
    """A folder of recordings as the page asks about it; what names hint at is chosen."""

    def __init__(self, client: TestClient, scenario: str = "push") -> None:
        answer = client.get("/api/laboratory", params={"path": "lab", "scenario": scenario})
        assert answer.status_code == 200, answer.text
        self.found: dict[str, Any] = answer.json()
        self.client, self.scenario, streams = client, scenario, self.found["streams"]
        self.pose = None
        if self.found["object_pose"] is not None:
            self.pose = streams[self.found["object_pose"]]["source"] | {"unit": "m"}
        self.arms = {
            arm: {
                "joints": own["joints"],
                "signals": {name: streams[at]["source"] | {"unit": UNITS[name]} for name, at in own["signals"].items()},
            }
            for arm, own in self.found["arms"].items()
        }

    def preview(self, signal: str, source: dict[str, Any] | None = None, **change: Any) -> Any:
        """A signal of the only arm, or the object's pose."""
        ((arm, own),) = self.arms.items()
        chosen = (self.pose or {}) if signal == "object_pose" else own["signals"][signal]
        request = {"path": self.found["path"], "scenario": self.scenario, "arm": arm, "joints": own["joints"]}
        request |= {"signal": signal, "source": chosen | (source or {}), "position": own["signals"]["position"]}
        return self.client.post("/api/laboratory/preview", json=request | change).json()

    def describe(self, **change: Any) -> Any:
        """Write the files; what is given instead of the first choices is in ``change``."""
        content = {"path": "lab", "scenario": self.scenario, "arms": self.arms, "object_pose": self.pose}
        return self.client.post("/api/laboratory", json=content | {"runs": [HIT, FREE]} | change).json()


def read(folder: Path) -> Run:
    ((run,), skipped) = read_laboratory(folder, load_experiment(folder / "experiment.yaml"), map)
    assert skipped == []
    return run


def test_a_preview_is_in_si_units_and_in_the_order_of_the_joints(client: TestClient, lab: Path) -> None:
    folder = Folder(client)
    assert folder.found["recording"] == "run_1"
    seen = folder.preview("position", {"unit": "mrad"})
    assert (seen["samples"], seen["wrong"], seen["rate"]) == (700, "", pytest.approx(1000.0))
    low, high = 1e-3 * KNOWN.position.min(), 1e-3 * KNOWN.position.max()
    assert seen["ranges"] == [{"unit": "rad", "low": pytest.approx(low), "high": pytest.approx(high)}]
    assert [column["name"] for column in seen["columns"]] == [f"panda_joint{number}" for number in range(1, 8)]
    shown = np.array([column["values"] for column in seen["columns"]]).T
    np.testing.assert_allclose(shown, 1e-3 * KNOWN.position[::3], rtol=1e-4)
    assert folder.preview("command")["samples"] == 700  # without a stamp of its own


IMPLAUSIBLE: list[tuple[str, dict[str, Any], str]] = [
    ("velocity", {"source": {"unit": "deg/s"}}, "velocity is 0.0174 times the derivative of position"),
    ("torque", {"source": {"unit": "mN m"}}, "torque holds 0.00 times the gravity torque of the scenario's arm"),
    ("command", {"source": {"factor": -1.0}}, "command holds -1.00 times the gravity torque"),
    ("position", {"source": {"unit": "m"}}, "joint 1 of franka_fer turns, expected rad or mrad or deg"),
    ("velocity", {"joints": [f"panda_joint{n}" for n in (1, 2, 3)]}, "franka_fer has 7 joints, the mapping names"),
]
ABSENT: list[tuple[str, dict[str, Any], str]] = [
    ("object_pose", {"source": {"topic": "/joint_states", "type": None}}, "a field that holds a pose"),
    ("torque", {"source": {"topic": "/joint_state"}}, "expected topic /joint_state of type"),
    ("position", {"joints": ["panda_joint9"]}, "joint panda_joint9 is missing; the messages name"),
    ("position", {"arm": "amr"}, "scenario 'push' has no arm 'amr'"),
]


@pytest.mark.parametrize(("signal", "change", "complaint"), [*IMPLAUSIBLE, *ABSENT])
def test_an_implausible_signal_is_shown_and_an_absent_one_refused(
    client: TestClient, lab: Path, signal: str, change: dict[str, Any], complaint: str
) -> None:
    seen = Folder(client).preview(signal, **change)
    line = seen["wrong"] if (signal, change, complaint) in IMPLAUSIBLE else seen["error"]
    assert complaint in line and "\n" not in line
    assert seen.get("samples", 700) == 700


def test_a_written_description_is_an_experiment_that_can_be_read(client: TestClient, lab: Path) -> None:
    done = Folder(client).describe()
    assert done["written"] == ["lab/experiment.yaml", "lab/mapping.yaml", "lab/runs.csv"]
    assert "--experiment" in done["command"]
    assert "run_1: /effort_controller/commands: log time" in done["remarks"][0]
    experiment = load_experiment(lab / "experiment.yaml")
    rows = [(row.name, row.object, row.hit, row.condition) for row in read_runs(lab, experiment, load_scenario("push"))]
    assert rows == [("run_1", "parcel", True, "case_1"), ("run_2", None, False, "slow")]
    mapping = experiment.load_mappings(["arm"])["arm"]
    assert (mapping.robot, mapping.signals["object_pose"].topic) == ("franka_fer", "/mocap/{object}/pose")


IN_MILLIMETRES = {"topic": "/mocap/parcel/pose", "unit": "mm"}
BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown object": ({"runs": [HIT | {"object": "percel"}]}, "parcel"),
    "an unknown kind": ({"runs": [HIT | {"kind": "kick"}]}, "'hit'"),
    "no such recording": ({"runs": [HIT | {"bag": "run_9"}]}, "run_9"),
    "no table of runs": ({"runs": None}, "no table of runs 'runs.csv'"),
    "no torque": ({"arms": {"arm": {"joints": ["a"], "signals": {}}}}, "signals.position: this signal is needed"),
    "another arm": ({"arms": {}}, "arms.arm: scenario 'push' has this arm"),
    "a pose in mm": ({"object_pose": IN_MILLIMETRES}, "on the support"),
    "a pose in mm, the hit last": ({"object_pose": IN_MILLIMETRES, "runs": [FREE, HIT]}, "run_1: the centre"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_mistake_in_a_description_leaves_nothing_behind(client: TestClient, lab: Path, name: str) -> None:
    change, expected = BROKEN[name]
    error = Folder(client).describe(**change)["error"]
    assert expected in error and "\n" not in error
    assert sorted(path.name for path in lab.iterdir()) == ["run_1", "run_2"]


def test_a_table_of_runs_of_the_user_is_read_shown_and_kept(client: TestClient, lab: Path) -> None:
    assert Folder(client).found["table"] is None
    text, table = "bag,object,kind,condition\nrun_1,parcel,hit,case_1\nrun_2,none,free motion,slow\n", lab / "runs.csv"
    table.write_text(text.replace("parcel", "percel"))
    wrong = Folder(client)
    line = "line 2, object = 'percel': expected an object of scenario 'push'"
    assert line in wrong.found["table"]["error"] and line in wrong.describe(runs=None)["error"]
    assert not (lab / "experiment.yaml").exists()
    table.write_text(text)
    folder = Folder(client)
    assert folder.found["table"] == {"name": "runs.csv", "rows": [HIT, FREE], "error": ""}
    assert "this file exists already" in folder.describe()["error"]
    assert folder.describe(runs=None)["written"] == ["lab/experiment.yaml", "lab/mapping.yaml"]
    assert table.read_text() == text


def test_arms_of_different_kinds_get_a_mapping_each(
    client: TestClient, tmp_path: Path, mixed_trial: Path, rewrite_bag: Callable[..., None]
) -> None:
    """The tracker's world is that of the robots, which the pads of both arms show."""
    lab = tmp_path / "lab"
    rewrite_bag(mixed_trial, lab / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    shutil.copy(FILE, tmp_path / "mixed.yaml")
    folder = Folder(client, "mixed.yaml")
    assert {arm: own["robot"] for arm, own in folder.found["arms"].items()} == {"left": "franka_fr3", "right": "ur5e"}
    crossed = folder.arms | {"right": folder.arms["right"] | {"joints": ["left_joint1"] * 6}}
    assert "error" in folder.describe(runs=[HIT], arms=crossed)
    written = folder.describe(runs=[HIT])["written"]
    assert written == [
        f"lab/{name}" for name in ("experiment.yaml", "mapping_left.yaml", "mapping_right.yaml", "runs.csv")
    ]
    run = read(lab)
    for file in written:
        (tmp_path / file).unlink()
    assert "written" in folder.describe(runs=[HIT], world_from_hits=True)
    placed = read(lab)
    assert placed.signals.object_position == pytest.approx(run.signals.object_position, abs=0.01)
    assert placed.remarks[0].startswith("motion capture placed from contact in 2 hits")
    assert {arm: own.command.shape[1] for arm, own in run.signals.arms.items()} == {"left": 7, "right": 6}
    assert run.signals.object_time.size > 100


def test_a_robot_with_a_sliding_joint_is_described_with_its_units(client: TestClient, tmp_path: Path) -> None:
    facts = yaml.safe_load((config_directory() / "robots" / "franka_fer.yaml").read_text())
    facts["joints"][0]["type"] = "prismatic"
    facts["limits"]["torque_Nm"][0] = 500.0  # N, for the first joint lifts the arm
    scenario = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text())
    scenario["robots"]["arm"]["facts"] = "robots/lift.yml"
    for name in ("robots", "lab"):
        (tmp_path / name).mkdir()
    (tmp_path / "robots" / "lift.yml").write_text(yaml.safe_dump(facts))
    (tmp_path / "lift.yaml").write_text(yaml.safe_dump(scenario))
    model = Physics.nominal(load_scenario(str(tmp_path / "lift.yaml")), "parcel").robot_model("arm")
    arrays = {"time": 1e-9 * KNOWN.time, "tau": np.array([model.gravity_torque(q) for q in KNOWN.position])}
    factor = np.array([1e3, *[1.0] * 6])  # mm, rad
    np.savez(tmp_path / "lab" / "up.npz", q=KNOWN.position * factor, dq=KNOWN.velocity * factor, **arrays)

    folder = Folder(client, "lift.yaml")
    own = folder.found["arms"]["arm"]
    assert (own["robot"], own["slides"]) == ("lift", [True, *[False] * 6])
    assert folder.found["units"]["velocity"] == [["rad/s", "mrad/s", "deg/s", "rpm"], ["m/s", "mm/s"]]
    units = {"position": ["mm", *["rad"] * 6], "velocity": ["mm/s", *["rad/s"] * 6], "torque": ["N", *["N m"] * 6]}
    signals = folder.arms["arm"]["signals"]
    for name, unit in units.items():
        signals[name]["unit"] = unit
    seen = folder.preview("velocity")
    assert seen["wrong"] == ""
    assert [(part["unit"], part["high"]) for part in seen["ranges"]] == [("m/s", pytest.approx(0.2)), ("rad/s", 0.2)]
    assert "joint 1 of" in folder.preview("velocity", {"unit": "rad/s"})["wrong"]
    run = {"bag": "up.npz", "object": "none", "kind": "free motion", "condition": "up"}
    assert "written" in folder.describe(runs=[run])
    assert yaml.safe_load((tmp_path / "lab" / "mapping.yaml").read_text())["robot"] == "../robots/lift.yml"
    np.testing.assert_allclose(read(tmp_path / "lab").signals.arms["arm"].position, KNOWN.position, atol=1e-12)
    scenario["robots"]["arm"]["facts"] = facts
    (tmp_path / "lift.yaml").write_text(yaml.safe_dump(scenario))
    answer = client.get("/api/laboratory", params={"path": "lab", "scenario": "lift.yaml"})
    assert "robots.arm.facts: the robot is described in the scenario itself" in answer.json()["error"]


def test_the_page_takes_units_signs_and_stamps_as_import_finds_them(client: TestClient, tmp_path: Path) -> None:
    """A log in ms, degrees and with torques turned round, whose columns are named a, b and c: names hint at nothing."""
    (tmp_path / "lab").mkdir()
    time = np.arange(0.0, 6.0, 0.005)
    model = Physics.nominal(load_scenario("push"), "parcel").robot_model("arm")
    speed = 2.0 * np.pi * np.linspace(0.2, 0.5, 7)
    q = KNOWN.position[0] + 0.2 * np.sin(np.outer(time, speed))
    dq, ddq = 0.2 * speed * np.cos(np.outer(time, speed)), -0.2 * speed**2 * np.sin(np.outer(time, speed))
    tau = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    names = ["stamp_ms", *(f"{letter}{joint}" for letter in "abc" for joint in range(1, 8))]
    rows = np.column_stack((1e3 * time, np.degrees(q), np.degrees(dq), -tau))
    np.savetxt(tmp_path / "lab" / "up.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.12g")

    folder = Folder(client)
    own = folder.found["arms"]["arm"]
    assert own["units"] == {"position": "deg", "velocity": "deg/s", "torque": "N m"}
    assert own["time"] == {"column": "stamp_ms", "unit": "ms"}
    assert any("derivative of the position in deg" in line for line in own["said"])
    first, following = own["readings"]["torque"][:2]  # the list that import compares, the likeliest first
    assert first["stream"].startswith("c1") and first["unit"] == "N m" and first["behind"] == 0.0
    assert following["behind"] > 0.0 and any(line.startswith("signals.torque: next ") for line in own["said"])
    layout = {"time": own["time"]}
    for name, unit in own["units"].items():
        folder.arms["arm"]["signals"][name]["unit"] = unit
    folder.arms["arm"] |= layout
    assert folder.arms["arm"]["signals"]["torque"]["factor"] == -1.0
    for name in ("position", "velocity", "torque"):
        assert folder.preview(name, **layout)["wrong"] == ""
    run = {"bag": "up.csv", "object": "none", "kind": "free motion", "condition": "up"}
    assert "written" in folder.describe(runs=[run])
    arm = read(tmp_path / "lab").signals.arms["arm"]
    np.testing.assert_allclose(arm.position, q, atol=1e-9)
    np.testing.assert_allclose(arm.torque, tau, atol=1e-8)


def test_where_import_refuses_the_page_says_why_and_goes_by_names(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    at_rest = {"time": 1e-9 * KNOWN.time, "q": np.tile(KNOWN.position[0], (700, 1)), "dq": np.zeros((700, 7))}
    np.savez(tmp_path / "lab" / "rest.npz", **at_rest, tau=np.zeros((700, 7)))
    own = Folder(client).found["arms"]["arm"]
    assert own["signals"] == {"position": 0, "velocity": 1, "torque": 2} and own["units"] == {}
    assert "Chosen by names alone, for impact-rs import says" in own["said"][0]
