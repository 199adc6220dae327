# SPDX-License-Identifier: Apache-2.0
"""Runs of a laboratory: known signals come back from every kind of file, what is wrong is refused with its place."""

from __future__ import annotations

import pickle
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from mixed_grab import JOINTS as ARM_JOINTS
from mixed_grab import write_experiment
from refusals import lacking

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.recordings.experiment import RunRow, load_experiment
from impact_rs_trials.recordings.joint_clock import with_object
from impact_rs_trials.recordings.laboratory_runs import read_laboratory, read_one
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.recording import TooShort
from impact_rs_trials.recordings.run_pieces import usable_pieces
from impact_rs_trials.runs import Run

from .conftest import FREE

if TYPE_CHECKING:
    from known_recordings import Signals

    from .conftest import LaboratoryFolder

LATE = 150e-6  # s, what the log has of unstamped commands beyond that of the states
WALL_CLOCK = 1_763_500_000  # s
JOINT_COLUMNS = {"position": "position", "velocity": "velocity", "effort": "torque"}
POSE_COLUMNS = [f"object_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
NORMAL_JOINTS = [f"panda_joint{joint}" for joint in range(1, 8)]
NO_POSE = {"/mocap/box/pose": ""}


def assert_known(run: Run, signals: Signals, command_after: float = 0.0) -> None:
    """The signals, whose commands are stamped ``command_after`` [s] after the states that they answer."""
    found, arm = run.signals, run.signals.arms["arm"]
    assert np.ptp(np.diff(found.time)) < 1e-12  # even
    np.testing.assert_allclose(found.time, 1e-9 * signals.time, atol=1e-6)
    np.testing.assert_allclose(arm.command_time, 1e-9 * signals.time + command_after, atol=1e-6)
    np.testing.assert_allclose(found.object_time, 1e-9 * signals.object_time, atol=1e-6)
    for name in ("position", "velocity", "torque", "command"):
        np.testing.assert_allclose(getattr(arm, name), getattr(signals, name), atol=1e-12)
    np.testing.assert_allclose(np.hstack((found.object_position, found.object_quaternion)), signals.pose, atol=1e-12)
    assert not arm.motor_position.size and not arm.motor_velocity.size


# ---- bags -----------------------------------------------------------------------------------------------------------


def test_a_bag_gives_the_known_signals(laboratory: LaboratoryFolder) -> None:
    """Joints are unsorted, commands unstamped; that it lost its metadata does not matter."""
    run = laboratory.run()
    assert_known(run, laboratory.signals, LATE)
    assert (run.name, run.condition_key[1], run.hit, run.condition) == ("run_1", "parcel", True, "parcel/fast/a")
    assert run.remarks == ("/effort_controller/commands: log time, less 0.2 ms to be on the stamps' clock",)
    (laboratory.path / "run_1" / "metadata.yaml").unlink()
    assert_known(laboratory.read()[0], laboratory.signals, LATE)


def test_fingers_on_the_same_topic_are_told_from_joints_of_the_arm(laboratory: LaboratoryFolder) -> None:
    fingers = ["panda_finger_joint1", "panda_finger_joint2"]
    run = laboratory.run(joints=[*fingers, *NORMAL_JOINTS], order=[0, 1, *range(7)])
    assert_known(run, laboratory.signals, LATE)


@pytest.mark.parametrize(
    ("command", "names", "field"),
    [("JointState", "name", "effort"), ("JointTrajectory", "joint_names", "points.0.effort")],
)
def test_a_command_with_stamps_and_names_keeps_its_stamps(
    laboratory: LaboratoryFolder, command: str, names: str, field: str
) -> None:
    laboratory.mapping({"command": {"type": None, "names": names, "field": field}})
    run = laboratory.run(command=command)
    assert_known(run, laboratory.signals)
    assert run.remarks == ()


@pytest.mark.parametrize("pose", ["TransformStamped", "Odometry", "TFMessage"])
def test_a_pose_is_read_from_whatever_message_holds_it(laboratory: LaboratoryFolder, pose: str) -> None:
    laboratory.mapping({"object_pose": {"child_frame": "box"}})
    assert_known(laboratory.run(pose=pose), laboratory.signals, LATE)


def test_a_wrench_is_read_where_there_is_one(laboratory: LaboratoryFolder) -> None:
    laboratory.mapping({"wrench": {"topic": "/wrench", "unit": "N, N m", "factor": -1.0}})
    arm, time = laboratory.run(wrench=True).signals.arms["arm"], laboratory.signals.time[::2]
    np.testing.assert_allclose(arm.wrench_time, 1e-9 * time, atol=1e-6)
    ones = np.ones(time.size)
    np.testing.assert_array_equal(arm.wrench, -np.column_stack((ones, time, 3 * ones, 4 * ones, 5 * ones, 6 * ones)))


def test_on_the_clock_of_the_log_everything_is_as_late_as_it_is_logged(laboratory: LaboratoryFolder) -> None:
    laboratory.mapping({}, time={"stamp": "log"})
    signals = laboratory.run(stamps=False).signals
    assert signals.arms["arm"].command_time[0] == pytest.approx(LATE, abs=1e-6)
    assert signals.object_time[0] == pytest.approx(0.004, abs=1e-6)


@pytest.mark.parametrize(("joints", "pose", "late"), [(20, 60, ""), (10, 80, "+70.0 ms"), (30, 20, "-10.0 ms")])
def test_a_pose_is_late_by_its_log_behind_that_of_the_joints(
    laboratory: LaboratoryFolder, joints: int, pose: int, late: str
) -> None:
    run = laboratory.run(logged_late=joints * 1_000_000, pose_logged_late=pose * 1_000_000)
    remarks = [remark for remark in run.remarks if "after joint states of the same stamp" in remark]
    assert [remark.split()[2:4] for remark in remarks] == ([late.split()] if late else [])


@pytest.mark.parametrize(("rate", "drift"), [(0.99, "-6.3 ms"), (1.01, "6.3 ms"), (1.001, "")])
def test_a_log_that_runs_slower_or_faster_than_the_stamps_is_noticed(
    laboratory: LaboratoryFolder, rate: float, drift: str
) -> None:
    run = laboratory.run(log_rate=rate)
    remark = next(remark for remark in run.remarks if remark.startswith("/effort_controller"))
    assert (f"(which drifts by {drift} during the run)" in remark) is ("drifts" in remark) is bool(drift)


def test_a_name_in_a_topic_may_be_that_of_the_object_or_the_arm(laboratory: LaboratoryFolder) -> None:
    laboratory.mapping({"object_pose": {"topic": "/mocap/{object}/pose"}, "position": {"topic": "/{arm}/joint_states"}})
    run = laboratory.run(topics={"/mocap/box/pose": "/mocap/parcel/pose", "/joint_states": "/arm/joint_states"})
    assert_known(run, laboratory.signals, LATE)


def test_a_bag_of_ours_is_read_as_that_of_a_laboratory(tmp_path: Path, push_bag: Path) -> None:
    shutil.copytree(push_bag, tmp_path / "trial")
    (tmp_path / "runs.csv").write_text("bag,object,kind\ntrial,cat_food,hit\n")
    (tmp_path / "e.yaml").write_text("{scenario: push, mapping: impact_rs}\n")
    ((run,), skipped) = read_laboratory(tmp_path, load_experiment(tmp_path / "e.yaml"), map)
    assert (skipped, run.condition, run.remarks) == ([], "cat_food", ())
    arm = run.signals.arms["arm"]
    assert arm.motor_velocity.shape == arm.command.shape == arm.position.shape == (run.signals.time.size, 7)
    np.testing.assert_array_equal(arm.command_time, run.signals.time)
    moved = run.signals.object_position[-1] - run.signals.object_position[0]
    assert moved[1] < -0.05  # m, pushed along -y


# ---- tables and arrays ----------------------------------------------------------------------------------------------


def columns(signals: Signals) -> dict[str, np.ndarray]:
    """One table: a row per state, NaN where the slower pose has no sample."""
    table = {"time": 1e-9 * signals.time}
    for name, source in {**JOINT_COLUMNS, "command": "command"}.items():
        table |= {f"{name}_{joint + 1}": getattr(signals, source)[:, joint] for joint in range(7)}
    for index, name in enumerate(POSE_COLUMNS):
        table[name] = np.full(signals.time.size, np.nan)
        table[name][np.searchsorted(signals.time, signals.object_time)] = signals.pose[:, index]
    return table


def write_csv(path: Path, table: dict[str, np.ndarray], separator: str = ",") -> None:
    rows = [
        ["" if np.isnan(value) else repr(float(value)) for value in row] for row in zip(*table.values(), strict=True)
    ]
    path.write_text("\n".join(separator.join(cells) for cells in [list(table), *rows]) + "\n")


def arrays(signals: Signals) -> dict[str, np.ndarray]:
    time, object_time = 1e-9 * signals.time, 1e-9 * signals.object_time
    joints = {name: getattr(signals, source) for name, source in JOINT_COLUMNS.items()}
    command, pose = {"command_time": time, "command": signals.command}, {"object_pose": signals.pose}
    return {"time": time, **joints, **command, "object_time": object_time, **pose}


def write_parquet(path: Path, table: dict[str, object]) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(table), path)


@pytest.mark.parametrize("kind", [",", ";", "parquet", "npz"])
def test_tables_and_arrays_give_the_known_signals(laboratory: LaboratoryFolder, kind: str) -> None:
    """The slower pose has empty cells in a table, and its own times as an array."""
    table = columns(laboratory.signals)
    if kind == "parquet":
        write_parquet(laboratory.path / "run_1.parquet", table)
    elif kind == "npz":
        np.savez(laboratory.path / "run_1.npz", **arrays(laboratory.signals))
    else:
        write_csv(laboratory.path / "run_1.csv", table, kind)
    assert_known(laboratory.read()[0], laboratory.signals)


def test_a_parquet_time_with_a_unit_is_believed(laboratory: LaboratoryFolder) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    stamps = pyarrow.array(laboratory.signals.time + WALL_CLOCK * 10**9).cast(pyarrow.timestamp("ns"))
    write_parquet(laboratory.path / "run_1.parquet", {**columns(laboratory.signals), "time": stamps})
    assert_known(laboratory.read()[0], laboratory.signals)


def test_a_slower_signal_of_the_arm_is_interpolated_onto_its_grid(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    motors = {"motor_time": 1e-9 * known.time[::3], "theta": known.torque[::3]}
    np.savez(laboratory.path / "run_1.npz", **arrays(known), **motors)
    laboratory.mapping({"motor_position": {"array": "theta", "time_array": "motor_time", "unit": "rad"}})
    (run,) = laboratory.read()
    np.testing.assert_allclose(run.signals.arms["arm"].motor_position, known.torque, atol=5e-3)
    assert not run.signals.arms["arm"].motor_velocity.size


def test_position_and_quaternion_of_the_object_may_be_two_arrays(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    parts = {"p": 1e3 * known.pose[:, :3], "wxyz": known.pose[:, [6, 3, 4, 5]]}
    np.savez(laboratory.path / "run_1.npz", **arrays(known), **parts)
    position = {"array": "p", "unit": "mm", "time_array": "object_time"}
    quaternion = {"array": "wxyz", "unit": "-", "quaternion_order": "wxyz", "time_array": "object_time"}
    laboratory.mapping({"object_pose": None, "object_position": position, "object_quaternion": quaternion})
    assert_known(laboratory.read()[0], known)


@pytest.mark.parametrize("late", [1e-4, 30.0])
def test_position_and_quaternion_of_other_moments_are_no_pose(late: float) -> None:
    """Kills: a tolerance relative to the stamps, within which all stamps of the wall clock are close."""
    time = WALL_CLOCK + np.arange(0.0, 2.0, 0.002)
    position = Series("p", time, np.zeros((time.size, 3)))
    quaternion = Series("q", time + late, np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)))
    with pytest.raises(InputError, match="p and q have different time stamps"):
        with_object(Path("f"), {"object_position": position, "object_quaternion": quaternion}, [])
    pose = with_object(
        Path("f"), {"object_position": position, "object_quaternion": replace(quaternion, time=time)}, []
    )
    assert pose["object_pose"].values.shape == (time.size, 7)


def test_signals_that_were_never_recorded_together_leave_the_run_out() -> None:
    """Kills: the longest of no pieces, which stops the whole experiment."""
    position, velocity, torque = (
        Series(name, np.arange(*span, 0.01), np.zeros((round(100 * (span[1] - span[0])), 2)))
        for name, span in (("q", (0.0, 3.0)), ("dq", (0.0, 1.0)), ("tau", (2.0, 3.0)))
    )
    run = RunRow(Path("run_1"), None, False, "")
    with pytest.raises(TooShort, match="velocity and torque were never recorded at the same time"):
        usable_pieces(run, {"arm": {"position": position, "velocity": velocity, "torque": torque}}, None, [])


def test_a_folder_per_run_with_a_file_per_group(laboratory: LaboratoryFolder) -> None:
    table, folder, signals = columns(laboratory.signals), laboratory.path / "run_1", laboratory.signals
    folder.mkdir()
    joints = {name: values for name, values in table.items() if name.split("_")[0] in ("time", *JOINT_COLUMNS)}
    write_csv(folder / "joints.csv", joints)
    command = {f"tau_{joint + 1}": signals.command[:, joint] for joint in range(7)}
    write_csv(folder / "command.csv", {"stamp": 1e-9 * signals.time, **command})
    pose = dict(zip(["x", "y", "z", "w", "i", "j", "k"], signals.pose[:, [0, 1, 2, 6, 3, 4, 5]].T, strict=True))
    pose |= {name: 1e3 * pose[name] for name in "xyz"}
    write_csv(folder / "run_1_box.csv", {"time": 1e-6 * signals.object_time, **pose})
    box = {"file": "{run}_box.csv", "columns": list(pose), "quaternion_order": "wxyz", "unit": "mm", "time_unit": "ms"}
    laboratory.mapping(
        {name: {"file": "joints.csv"} for name in ("position", "velocity", "torque")}
        | {"command": {"file": "command.csv", "column": "tau_{joint}", "time_column": "stamp"}, "object_pose": box}
    )
    assert_known(laboratory.read()[0], laboratory.signals)


def test_a_table_may_lie_beside_the_bag_of_a_run(laboratory: LaboratoryFolder) -> None:
    signals = laboratory.signals
    pose = dict(zip(POSE_COLUMNS, signals.pose.T, strict=True))
    write_csv(laboratory.path / "run_1_box.csv", {"time": WALL_CLOCK + 1e-9 * signals.object_time, **pose})
    laboratory.mapping({"object_pose": {"file": "{run}_box.csv", "columns": POSE_COLUMNS}})
    assert_known(laboratory.run(topics=NO_POSE), signals, LATE)


@pytest.mark.parametrize(("package", "name"), [("pyarrow", "run_1.parquet"), ("h5py", "run_1.h5")])
def test_a_missing_library_is_named_with_the_way_to_get_it(
    laboratory: LaboratoryFolder, monkeypatch: pytest.MonkeyPatch, package: str, name: str
) -> None:
    (laboratory.path / name).write_text("not empty")
    monkeypatch.delenv("IMPACT_RS_RUN", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    said = laboratory.refusal()
    assert f"{name}: this needs {package}" in said and f"pip install {package}" in said


# ---- clocks ---------------------------------------------------------------------------------------------------------


def test_a_delay_in_the_mapping_is_added_to_the_stamps(laboratory: LaboratoryFolder) -> None:
    laboratory.mapping({"command": {"delay": -0.003}})
    assert_known(laboratory.run(), laboratory.signals, LATE - 0.003)


def test_stamps_that_jitter_are_interpolated_onto_an_even_grid(laboratory: LaboratoryFolder) -> None:
    rng, known = np.random.default_rng(0), laboratory.signals
    jitter = rng.uniform(-0.2e6, 0.2e6, known.time.size).astype(int)
    jitter[[0, -1]] = 0
    moved = 1e-9 * jitter[:, None] * known.velocity  # where the arm is at those times
    laboratory.change(time=known.time + jitter, position=known.position + moved)
    run = laboratory.run()
    np.testing.assert_allclose(run.signals.time, 1e-9 * known.time, atol=1e-6)
    position = run.signals.arms["arm"].position
    np.testing.assert_allclose(position, known.position, atol=2e-5)  # rad; the kink of the impact
    assert not any("even grid" in remark for remark in run.remarks)


def test_rates_too_low_for_a_question_are_noted(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    slow = {name: getattr(known, name)[::10] for name in ("time", "position", "velocity", "torque", "command")}
    laboratory.change(**slow, object_time=known.object_time[::8], pose=known.pose[::8])
    remarks = "\n".join(laboratory.run().remarks)
    assert "joints at 100 Hz: the jump of an impact is seen, its force is not" in remarks
    assert "object pose at 31 Hz" in remarks


def test_all_gaps_are_listed_and_short_ones_are_bridged(laboratory: LaboratoryFolder) -> None:
    laboratory.signals = laboratory.signals.without(0.1, 0.107).without(0.6, 0.608)
    run = laboratory.run()
    assert run.signals.time[-1] == pytest.approx(0.699)
    assert any("gaps of 0.007 s at t = 0.100 s, 0.008 s at t = 0.600 s" in remark for remark in run.remarks)


def test_a_run_is_cut_to_the_piece_with_the_impact(laboratory: LaboratoryFolder) -> None:
    laboratory.signals = laboratory.signals.known(1.6).without(0.2, 0.22).without(0.7, 0.75)
    run = laboratory.run()  # the piece behind 0.75 s is longer
    signals = run.signals
    assert signals.time[0] == 0.0
    assert signals.time[-1] == pytest.approx(0.479)  # the first command comes right after the first state
    assert {
        "cut to 0.220 ... 0.700 s, because of gaps > 0.01 s",
        "skipped, because it is shorter than 0.3 s: 0.000 ... 0.200 s",
        "skipped, because it comes after the impact and a gap: 0.750 ... 1.599 s",
    } <= set(run.remarks)
    assert run.gaps == ()
    assert -0.1 < signals.arms["arm"].command_time[0] < 0.0  # a command holds until the next: those before are needed
    at_impact = np.argmin(np.abs(signals.object_time - 0.179))  # 0.4 s
    assert signals.object_position[at_impact, 1] == pytest.approx(-0.15)
    assert signals.object_position[at_impact + 2, 1] < -0.15


def test_free_motion_keeps_all_pieces_on_one_grid(laboratory: LaboratoryFolder) -> None:
    whole = laboratory.signals.known(2.0)
    laboratory.signals = whole.without(0.4, 0.45).without(0.9, 0.96).without(1.0, 1.02)
    run = laboratory.run(FREE)
    time = run.signals.time
    assert (time[0], time[-1]) == pytest.approx((0.0, 1.999))
    assert list(run.gaps) == [pytest.approx((0.4, 0.45), abs=2e-3), pytest.approx((0.9, 1.02), abs=2e-3)]
    kept = np.all([(time <= start) | (time >= end) for start, end in run.gaps], axis=0)
    for name in ("position", "velocity", "torque"):
        np.testing.assert_array_equal(getattr(run.signals.arms["arm"], name)[kept], getattr(whole, name)[kept])
    remarks = "\n".join(run.remarks)
    assert "gaps of 0.050 s at t = 0.400 s, 0.060 s at t = 0.900 s, 0.020 s at t = 1.000 s" in remarks
    assert "cut to 0.000 ... 0.400 s, 0.450 ... 0.900 s, 1.020 ... 1.999 s, because of gaps > 0.01 s" in remarks
    assert "skipped, because it is shorter than 0.3 s: 0.960 ... 1.000 s" in remarks


def test_a_hit_keeps_the_free_motion_before_a_gap(laboratory: LaboratoryFolder) -> None:
    laboratory.signals = laboratory.signals.known(1.2).without(0.31, 0.33)
    run = laboratory.run()
    assert run.signals.time[0] == 0.0
    assert run.gaps[0][1] == pytest.approx(0.33, abs=1e-3)


def test_a_run_that_is_left_out_has_its_reason_and_the_others_are_read(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    laboratory.bag("whole")
    laboratory.signals = known.without(0.39, 0.41)
    laboratory.bag("hole")
    laboratory.signals = known.without(0.2, 0.22).without(0.45, 0.47)
    laboratory.bag("short")
    runs, skipped = laboratory.read_all(*(f"{name},parcel,hit,fast,a" for name in ("hole", "whole", "short")))
    assert [run.name for run in runs] == ["whole"]
    reasons = {Path(path).name: reason for path, reason in skipped}
    assert reasons["hole"] == "the impact falls into a gap of 0.020 s at t = 0.390 s"
    assert reasons["short"].startswith("gaps leave 0.230 s with the impact in one piece, at least 0.3 s are needed")
    assert "no run can be used; hole: the impact falls into a gap" in laboratory.refusal("hole,parcel,hit,fast,a")


# ---- what is wrong --------------------------------------------------------------------------------------------------


def changed(name: str, row: int, value: float) -> Callable[[Signals], Signals]:
    def change(signals: Signals) -> Signals:
        values = getattr(signals, name).copy()
        values[row] = value
        return replace(signals, **{name: values})

    return change


def later(row: int, nanoseconds: int, name: str = "time") -> Callable[[Signals], Signals]:
    def change(signals: Signals) -> Signals:
        time = getattr(signals, name).copy()
        time[row:] += nanoseconds
        return replace(signals, **{name: time})

    return change


IMPOSSIBLE = [  # what happens to the signals, and words that the complaint has: signal, value, time, unit, remedy
    (changed("position", 50, np.nan), "/joint_states|(position)|number 1 is nan|t = 0.050 s"),
    (changed("command", 50, np.inf), "/effort_controller/commands|(command)|number 1 is inf|t = 0.050 s"),
    (changed("pose", 9, np.array([np.nan, 0, 0, 0, 0, 0, 1])), "(object_pose)|number 1 is nan|t = 0.036 s"),
    (later(300, 5_000_000_000), "jump by 5.001 s|t = 0.299 s|pause"),
    (later(300, -1_000_000), "stand still|t = 0.299 s|1 of 700"),
    (later(300, -9_000_000), "backwards by 0.008 s|t = 0.299 s|the clock was set"),
    (later(0, 10**12, "object_time"), "1763501000.000 ... 1763501000.696 s"),
    (lambda s: replace(s, torque=-s.torque), "torque|-1.0"),
    (lambda s: replace(s, velocity=-s.velocity), "velocity|-1 times|position"),
    (lambda s: replace(s, position=57.3 * s.position), "unit (now rad)"),
    (lambda s: replace(s, pose=s.pose + np.eye(7)[2]), "+1.000 m|frame or unit"),
    (lambda s: replace(s, pose=s.pose + 3.0 * np.eye(7)[0]), "'arm'|2 m"),
    (lambda s: replace(s, pose=s.pose * np.repeat([1e3, 1.0], [3, 4])), "pose|frame or unit"),
    (lambda s: replace(s, pose=np.roll(s.pose, 1, axis=1)), "quaternions"),
    (lambda s: replace(s, pose=s.pose - 0.4 * np.eye(7)[1]), "pad|'parcel'|0.39"),
]


@pytest.mark.parametrize(("change", "words"), IMPOSSIBLE, ids=[words for _, words in IMPOSSIBLE])
def test_signals_that_cannot_be_are_refused_with_place_and_remedy(
    laboratory: LaboratoryFolder, change: Callable[[Signals], Signals], words: str
) -> None:
    laboratory.signals = change(laboratory.signals)
    laboratory.bag()
    assert not lacking(laboratory.refusal(), "run_1: |" + words)


UNLIKE_THE_MAPPING = [  # how the bag is written
    ({"topics": {"/joint_states": "/joint_state"}}, "*joint_states|sensor_msgs/msg"),
    ({"topics": {"/effort_controller/commands": ""}}, "signals.command"),
    ({"topics": {"/mocap/box/pose": "/box/pose"}}, "object_pose|/mocap/*/pose|/joint"),
    ({"joints": NORMAL_JOINTS[:6], "order": range(6)}, "*joint7|panda_joint1"),
    ({"joints": [f"wheel_{i}" for i in range(7)], "order": range(7)}, "*joint1|wheel_"),
    ({"joints": NORMAL_JOINTS, "order": range(6)}, "6 numbers|7 joint names"),
    ({"topics": {"/joint_states": "/a", "/effort_controller/commands": "/b", "/mocap/box/pose": "/c"}}, "found /a"),
    ({"stamps": False}, "time.stamp to log"),
    ({"pose": "TFMessage"}, "box, table|child_frame"),
]


@pytest.mark.parametrize(("format_", "words"), UNLIKE_THE_MAPPING, ids=[words for _, words in UNLIKE_THE_MAPPING])
def test_bags_that_do_not_fit_the_mapping_are_refused_with_what_was_found(
    laboratory: LaboratoryFolder, format_: dict[str, object], words: str
) -> None:
    laboratory.bag(**format_)
    assert not lacking(laboratory.refusal(), "run_1: |" + words)


def test_a_field_that_is_not_there_is_refused_with_those_that_are(laboratory: LaboratoryFolder) -> None:
    laboratory.bag()
    laboratory.mapping({"torque": {"field": "efort"}})
    assert "has no such field; did you mean 'effort'?; it has: header, name, position" in laboratory.refusal()
    laboratory.mapping({"object_pose": {"field": "poze"}})
    said = laboratory.refusal()
    assert "object_pose" in said and "has no such field; did you mean 'pose'" in said


def test_two_arms_on_one_topic_ask_for_the_names_of_one(laboratory: LaboratoryFolder) -> None:
    both = [f"{side}_joint{joint}" for side in ("left", "right") for joint in range(1, 8)]
    laboratory.bag(joints=both, order=[*range(7), *range(7)])
    assert "joint *joint1 fits several joints" in laboratory.refusal()
    laboratory.mapping({}, joints=[f"right_joint{joint}" for joint in range(1, 8)])
    assert_known(laboratory.read()[0], laboratory.signals, LATE)


def test_free_motion_needs_no_object_and_no_pose(laboratory: LaboratoryFolder) -> None:
    run = laboratory.run(FREE, topics=NO_POSE)
    assert (run.hit, run.signals.object_time.size, run.signals.object_position.shape) == (False, 0, (0, 3))
    assert run.object is not None and run.object.position[0] > 5.0  # out of reach


def test_an_object_that_is_out_of_sight_for_a_while_is_not_needed(laboratory: LaboratoryFolder) -> None:
    pose = laboratory.signals.pose.copy()
    pose[20:25] = 0.0
    laboratory.change(pose=pose)
    run = laboratory.run()
    assert run.signals.object_time.size == pose.shape[0] - 5
    assert any("the object is not seen in 5 of 175 samples" in remark for remark in run.remarks)
    assert any("a gap of 0.024 s at t = 0.076 s" in remark for remark in run.remarks)


# ---- gravity and frames ---------------------------------------------------------------------------------------------


def without_weight(signals: Signals) -> np.ndarray:
    """The commands of a robot that adds the weight of its arm itself."""
    return 0.5 * (signals.command - signals.torque)


def test_a_command_without_the_weight_of_the_arm_gets_it(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    laboratory.change(command=without_weight(known))
    laboratory.mapping({}, command_includes_gravity=False)
    command = laboratory.run().signals.arms["arm"].command
    np.testing.assert_allclose(command, known.command, atol=3e-3)  # the arm moves on until the command


@pytest.mark.parametrize("included", [True, False])
def test_a_mapping_that_is_wrong_about_gravity_is_refused(laboratory: LaboratoryFolder, included: bool) -> None:
    if included:
        laboratory.change(command=without_weight(laboratory.signals))
    laboratory.bag()
    laboratory.mapping({}, command_includes_gravity=included)
    said = laboratory.refusal()
    assert f"command holds {0 if included else 2}.00 times the gravity torque of" in said.replace("-0.00", "0.00")
    assert "command_includes_gravity" in said


def test_the_world_of_the_motion_capture_is_turned_into_that_of_the_robot(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # world seen from A: +90 degrees about z
    pose = known.pose.copy()
    pose[:, :3] = (known.pose[:, :3] - [1.0, 0.2, -0.1]) @ turned.T
    pose[:, 3:] = [0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5)]
    laboratory.change(pose=pose)
    laboratory.experiment["motion_capture"] = {"position": [1.0, 0.2, -0.1], "rpy": [0.0, 0.0, np.pi / 2.0]}
    signals = laboratory.run().signals
    np.testing.assert_allclose(signals.object_position, known.pose[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.abs(signals.object_quaternion[:, 3]), 1.0, atol=1e-12)


def test_a_tracked_frame_need_not_be_the_centre_of_the_object(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals
    laboratory.change(pose=known.pose + 0.08 * np.eye(7)[2])  # markers on the lid
    laboratory.bag()
    assert "+0.080 m off" in laboratory.refusal()
    laboratory.experiment["motion_capture"] = {"bodies": {"parcel": {"position": [0.0, 0.0, -0.08]}}}
    np.testing.assert_allclose(laboratory.read()[0].signals.object_position, known.pose[:, :3], atol=1e-12)


# ---- scenario and mapping -------------------------------------------------------------------------------------------


def test_arms_that_nothing_tells_apart_are_refused(laboratory: LaboratoryFolder) -> None:
    laboratory.bag()
    laboratory.experiment["scenario"] = "grab"
    said = "mapping = 'joint_state_effort_controller': position of arms 'left' and 'right' would be the same "
    assert said in laboratory.refusal()


def test_arms_of_one_topic_are_told_apart_by_the_names_of_their_joints(laboratory: LaboratoryFolder) -> None:
    names = [f"{arm}_{name}" for arm in ("left", "right") for name in NORMAL_JOINTS]
    laboratory.bag(joints=names, order=[*range(7), *reversed(range(7))])
    laboratory.mapping({"command": None}, joints=[f"{{arm}}_{name}" for name in NORMAL_JOINTS])
    laboratory.experiment["scenario"] = "grab"
    assert "arm 'right': position of joint 6" in laboratory.refusal(FREE)  # the other arm's numbers backwards
    laboratory.bag("run_2", joints=names, order=[*range(7), *range(7)])
    (run,) = laboratory.read(FREE.replace("run_1", "run_2"))
    for arm in ("left", "right"):
        np.testing.assert_allclose(run.signals.arms[arm].position, laboratory.signals.position, atol=1e-12)
    assert run.remarks[0].startswith("arm 'left': no command was recorded")


def test_a_slower_arm_with_its_own_clock_comes_on_the_grid_of_the_faster(laboratory: LaboratoryFolder) -> None:
    known = laboratory.signals.known(2.0)
    slow, kept, late = known.without(1.0, 1.02), slice(51, None, 2), 0.0002  # s
    table = {"left_time": 1e-9 * slow.time[kept] + late, "right_time": 1e-9 * known.time}
    for name, source in JOINT_COLUMNS.items():
        moved = late * slow.velocity[kept] if name == "position" else 0.0
        table[f"left_{name}"] = getattr(slow, source)[kept] + moved
        table[f"right_{name}"] = getattr(known, source)
    np.savez(laboratory.path / "run_1.npz", **table)
    own = {signal: {"array": f"{{arm}}_{name}", "time_array": "{arm}_time"} for name, signal in JOINT_COLUMNS.items()}
    laboratory.mapping({**own, "command": None, "object_pose": None})
    laboratory.experiment["scenario"] = "grab"
    (run,) = laboratory.read(FREE)
    time, ((start, end),) = run.signals.time, run.gaps
    assert time[-1] == pytest.approx(1.947, abs=2e-3)  # where both were recorded
    assert (start, end - start) == pytest.approx((0.949, 0.02), abs=3e-3)
    on_both = (time < start) | (time > end)
    both = known.position[52 : 52 + time.size][on_both]  # from the first sample of the faster arm in that time
    np.testing.assert_array_equal(run.signals.arms["right"].position[on_both], both)
    np.testing.assert_allclose(run.signals.arms["left"].position[on_both], both, atol=1e-4)


def test_arms_of_different_kinds_have_a_mapping_each(tmp_path: Path, mixed_trial: Path) -> None:
    experiment = load_experiment(write_experiment(tmp_path, mixed_trial))
    ((run,), skipped) = read_laboratory(tmp_path, experiment, map)
    assert (skipped, run.remarks) == ([], ())
    bag = TrialBag.open(mixed_trial)
    for arm, count in ARM_JOINTS.items():
        own = bag.joints(topics.joint_states(arm))
        assert run.signals.arms[arm].position.shape == (own.time.size, count)
        np.testing.assert_allclose(run.signals.arms[arm].torque, own.effort, atol=1e-12)


@pytest.mark.parametrize(
    ("mapping", "complaint"),
    [
        ({"left": "left.yaml"}, "mapping: no mapping of arm 'right'"),
        ({"left": "left.yaml", "right": "right.yaml", "rigth": "left.yaml"}, "mapping = 'rigth': the scenario has no "),
        ({"left": "left.yaml", "right": "rigt.yaml"}, "rigt.yaml: "),
        ({"left": "right.yaml", "right": "right.yaml"}, "mapping.left = 'right.yaml': the mapping is for robot 'ur5e'"),
    ],
)
def test_arms_without_a_mapping_of_their_own_are_refused(
    tmp_path: Path, mixed_trial: Path, mapping: dict[str, str], complaint: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_laboratory(tmp_path, load_experiment(write_experiment(tmp_path, mixed_trial, mapping)), map)
    assert complaint in str(caught.value)


def test_torque_that_motors_were_asked_for_is_no_joint_torque(laboratory: LaboratoryFolder) -> None:
    laboratory.bag()
    laboratory.mapping({}, torque_measured_at="motor")
    assert "torque_measured_at is 'motor'" in laboratory.refusal()


def test_a_mapping_for_another_robot_is_refused(laboratory: LaboratoryFolder) -> None:
    facts = yaml.safe_load((config_directory() / "robots" / "franka_fer.yaml").read_text())
    facts["links"][0]["mass"] += 1.0
    (laboratory.path / "other.yaml").write_text(yaml.safe_dump(facts))
    laboratory.bag()
    laboratory.mapping({}, robot=str(laboratory.path / "other.yaml"))
    said = laboratory.refusal()
    assert "the mapping is for robot " in said and "other.yaml', arm 'arm' " in said and " is 'franka_fer'" in said


# ---- several runs ---------------------------------------------------------------------------------------------------


def test_one_run_is_read_as_among_all_and_in_other_processes(laboratory: LaboratoryFolder) -> None:
    def elsewhere(function: Callable[..., object], tasks: list[object]) -> Iterator[object]:
        for task in tasks:
            yield pickle.loads(pickle.dumps(pickle.loads(pickle.dumps((function, task)))[0](task)))

    laboratory.bag("run_1")
    laboratory.bag("run_2")
    _, second = laboratory.read("run_1,parcel,hit,fast,a", "run_2,parcel,hit,fast,a")
    (_, other), _ = read_laboratory(laboratory.path, laboratory.load(), elsewhere)
    one = read_one(laboratory.path, laboratory.load(), "run_2", map)
    for run in (second, other, one):
        assert_known(run, laboratory.signals, LATE)
        assert (run.name, run.remarks) == ("run_2", second.remarks)
