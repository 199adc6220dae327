# SPDX-License-Identifier: Apache-2.0
"""Robots with one joint, and robots whose axes meet in one point: read, checked and imported like any other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from builders import mapping_in
from joint_recordings import Columns, swinging, write_bag
from measured_data import measured_data

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.importing.measured_limits import measured_limits
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.recording import read_recordings

TIME = np.arange(0.0, 8.0, 0.01)
LIMITS = {"position_min_rad": -3.0, "position_max_rad": 3.0, "velocity_rad_s": 10.0, "torque_Nm": 10.0}
UPRIGHT = (-np.pi / 2.0, 0.0, 0.0)
PENDULUM = [{"xyz": (0, 0, 0), "rpy": UPRIGHT}]
PAN_TILT = [{"xyz": (0, 0, 0), "rpy": (0, 0, 0)}, {"xyz": (0, 0, 0), "rpy": UPRIGHT}]  # axes meet in one point


def robot_of(folder: Path, joints: list[dict[str, object]]) -> str:
    """A robot file of links of 1 kg whose centres lie 0.1 m beside the last axis; the flange lies on all axes."""
    link = {"mass": 1.0, "com": (0.0, 0.1, 0.0), "inertia": (1e-3, 0, 0, 1e-3, 0, 1e-3)}
    content = {
        "source": "by hand",
        "joints": joints,
        "flange": {"xyz": (0, 0, 0)},
        "limits": {name: [value] * len(joints) for name, value in LIMITS.items()},
        "links": [link] * len(joints),
    }
    path = folder / "small.yaml"
    path.write_text(json.dumps(RobotFacts.model_validate(content).model_dump(mode="json")), encoding="utf-8")
    return str(path)


def motion_of(robot: str) -> Columns:
    facts = load_facts(robot)
    number = np.arange(facts.joint_count)
    model = RobotModel(facts, MountedEndEffector().build())
    return swinging(model, TIME, 0.2, (0.21 + 0.1 * number, 0.53 + 0.1 * number), (0.5, 0.1))


def written(form: str, folder: Path, motion: Columns) -> Path:
    """A recording of one joint: columns with a number, with a word or without names, arrays, or a bag."""
    stacked = np.column_stack([motion[name] for name in ("time", "position", "velocity", "effort")])
    heads = {"numbered": "time,q1,dq1,tau1", "named": "time,position,velocity,effort", "nameless": ""}
    if form in heads:
        path = folder / "swing.csv"
        np.savetxt(path, stacked, delimiter=",", fmt="%.15g", header=heads[form], comments="")
        return path
    if form == "bag":
        write_bag(folder / "swing", motion, [0], names=["hinge"])
        return folder / "swing"
    shaped = {"flat": -1, "column": (-1, 1)}[form]
    np.savez(folder / "swing.npz", **{name: values.reshape(shaped) for name, values in motion.items()})
    return folder / "swing.npz"


@pytest.mark.parametrize("form", ["numbered", "named", "nameless", "flat", "column", "bag"])
def test_a_recording_of_one_joint_is_imported(form: str, tmp_path: Path) -> None:
    robot = robot_of(tmp_path, PENDULUM)
    motion = motion_of(robot)
    (tmp_path / "raw").mkdir()
    file = written(form, tmp_path / "raw", motion)
    draft = draft_import([file], tmp_path, ImportOptions(robot=robot))
    (run,) = read_recordings(file, mapping_in(draft, tmp_path))
    arm = run.signals.arms["arm"]
    np.testing.assert_allclose(arm.position, motion["position"], atol=1e-9)
    np.testing.assert_allclose(arm.velocity, motion["velocity"], atol=1e-9)
    np.testing.assert_allclose(arm.torque, motion["effort"], atol=1e-9)
    assert run.remarks == ()


def test_a_recording_of_a_pan_tilt_without_reach_is_imported(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, PAN_TILT)
    motion = motion_of(robot)
    names = ["time", *(f"{name}{joint}" for name in ("q", "dq", "tau") for joint in (1, 2))]
    table = np.column_stack([motion[name] for name in ("time", "position", "velocity", "effort")])
    file = tmp_path / "motion.csv"
    np.savetxt(file, table, delimiter=",", header=",".join(names), comments="", fmt="%.15g")
    draft = draft_import([file], tmp_path, ImportOptions(robot=robot))
    (run,) = read_recordings(file, mapping_in(draft, tmp_path))
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-9)


def test_a_motor_encoder_beside_the_only_joint_is_no_second_torque(tmp_path: Path) -> None:
    """Columns that share a word are no vector of which one number is the joint's."""
    robot = robot_of(tmp_path, PENDULUM)
    motion = motion_of(robot)
    signals = [motion["time"], motion["position"], motion["velocity"], motion["effort"], motion["position"]]
    names = "time,joint_pos,joint_vel,motor_torque,motor_pos"
    np.savetxt(tmp_path / "swing.csv", np.column_stack(signals), delimiter=",", header=names, comments="", fmt="%.15g")
    draft = draft_import([tmp_path / "swing.csv"], tmp_path, ImportOptions(robot=robot))
    torque = next(line for line in draft.lines if line.key == "signals.torque.unit")
    assert torque.sure and "so do" not in torque.evidence


def test_limits_of_one_joint_are_taken_from_a_table(tmp_path: Path) -> None:
    motion = motion_of(robot_of(tmp_path, PENDULUM))
    limits = measured_limits(written("named", tmp_path, motion), ["hinge"])
    assert limits["hinge", "position"] == pytest.approx((motion["position"].min(), motion["position"].max()))
    assert limits["hinge", "velocity"] == pytest.approx((np.abs(motion["velocity"]).max(),))


def test_limits_are_taken_from_a_table_with_gaps(tmp_path: Path) -> None:
    """Kills ends of nan: one sample that is missing made a limit nan."""
    rows = "0,0.1,-2.0\n0.01,nan,1.5\n0.02,-0.3,inf\n"
    (tmp_path / "log.csv").write_text(f"time,position,velocity\n{rows}", encoding="utf-8")
    limits = measured_limits(tmp_path / "log.csv", ["hinge"])
    assert limits["hinge", "position"] == (-0.3, 0.1) and limits["hinge", "velocity"] == (2.0,)


@pytest.mark.parametrize("names", [("shoulder_pan", "pan"), ("joint_10", "joint_1")])
def test_limits_go_to_the_joint_whose_whole_name_the_column_has(tmp_path: Path, names: tuple[str, str]) -> None:
    """Kills the search for a name within a name, after which the order of the columns decided."""
    file = tmp_path / "log.csv"
    heads = ["time", *(f"{quantity}_{name}" for quantity in ("position", "velocity") for name in names)]
    rows = np.column_stack((TIME, *(size * np.sin(TIME) for size in (1.5, 0.1, 15.0, 1.3))))
    np.savetxt(file, rows, delimiter=",", header=",".join(heads), comments="", fmt="%.15g")
    limits = measured_limits(file, names[::-1])
    assert limits[names[0], "velocity"] == pytest.approx((15.0,), rel=1e-3)
    assert limits[names[1], "velocity"] == pytest.approx((1.3,), rel=1e-3)
    with pytest.raises(InputError, match=f"position_{names[1]} none is named after elbow; name every column"):
        measured_limits(file, [names[0], "elbow"])


@pytest.mark.parametrize(
    ("case", "file", "robot"), [("one_joint", "swing", "pendulum"), ("reach_zero", "motion", "pan_tilt")]
)
def test_recordings_of_other_people_are_imported(case: str, file: str, robot: str, tmp_path: Path) -> None:
    folder = measured_data("cases", case)
    draft = draft_import([folder / f"{file}.csv"], tmp_path, ImportOptions(robot=str(folder / f"{robot}.yaml")))
    assert draft.runs == 1 and not [
        line.key for line in draft.lines if line.key.startswith("signals") and not line.sure
    ]
