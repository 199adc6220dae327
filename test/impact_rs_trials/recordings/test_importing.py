# SPDX-License-Identifier: Apache-2.0
"""Raw files are described as they are: what was planted in them is found with its evidence, and what is not is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, swinging
from refusals import refusal

from impact_rs_sim.robot import load_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.file_groups import group_files
from impact_rs_trials.recordings.importing import ImportDraft, Wishes, draft_import
from impact_rs_trials.recordings.mapping import MountedEndEffector, load_mapping
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.table_layout import find_layout

TIME = np.arange(0.0, 8.0, 0.01)


@pytest.fixture(scope="module")
def motion() -> Columns:
    """An iiwa that swings about a bent pose."""
    import pinocchio as pin

    model = RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build(), pin.SE3.Identity())
    frequencies = (np.linspace(0.11, 0.23, 7), np.linspace(0.31, 0.47, 7))
    return swinging(model, TIME, np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1]), frequencies, (0.35, 0.1))


def write(
    path: Path, names: list[str] | None, columns: list[np.ndarray], above: str = "", separator: str = ","
) -> Path:
    table = np.column_stack(columns).tolist()
    lines = [above] if above else []
    lines += [separator.join(names)] if names else []
    path.write_text("\n".join([*lines, *(separator.join(f"{value:.12g}" for value in row) for row in table)]))
    return path


def numbered(stem: str, first: int = 1) -> list[str]:
    return [f"{stem}{number}" for number in range(first, first + 7)]


def said_of(draft: ImportDraft, key: str) -> str:
    """What is said of a key."""
    return next(f"{line.value} {line.evidence}" for line in draft.lines if line.key == key)


def described(draft: ImportDraft, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in draft.texts.items():
        (folder / name).write_text(text)
    return folder / "mapping.yaml"


def check_reading(draft: ImportDraft, folder: Path, target: Path, motion: Columns) -> None:
    """What is written reads the planted motion in SI units."""
    (run,) = read_recordings(target, load_mapping(described(draft, folder)))
    arm = run.signals.arms["arm"]
    np.testing.assert_allclose(arm.position, motion["position"], atol=1e-9)
    np.testing.assert_allclose(arm.velocity, motion["velocity"], atol=1e-8)
    np.testing.assert_allclose(arm.torque, motion["effort"], atol=1e-6)


def test_units_and_signs_are_found_from_the_numbers(tmp_path: Path, motion: Columns) -> None:
    """Degrees, degrees per second, and torques that point the other way; names that say nothing of it."""
    names = ["stamp", *numbered("q_"), *numbered("dq_"), *numbered("tau_")]
    columns = [1e3 * TIME + 5000.0, np.degrees(motion["position"]), np.degrees(motion["velocity"]), -motion["effort"]]
    file = write(tmp_path / "log.csv", names, columns)
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert said_of(draft, "signals.position.unit").startswith("deg ")
    assert "not in rad" in said_of(draft, "signals.position.unit")
    assert "1 times the derivative of the position in deg/s" in said_of(draft, "signals.velocity.unit")
    assert "-1 times the torque that weight and inertia of the arm take" in said_of(draft, "signals.torque.unit")
    assert "{column: stamp, unit: ms} increases; in ms that is 100 Hz" in said_of(draft, "time")
    assert "factor: -1" in draft.texts["mapping.yaml"]
    check_reading(draft, tmp_path / "lab", file, motion)


def test_a_table_without_names_is_read_by_its_numbers_alone(tmp_path: Path, motion: Columns) -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((TIME.size, 2))
    columns = [TIME, noise, motion["velocity"], motion["position"], 1e3 * motion["effort"]]
    file = write(tmp_path / "log.txt", None, columns, separator=" ")
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert "columns: [c11, c12, c13, c14, c15, c16, c17]" in draft.texts["mapping.yaml"]
    assert said_of(draft, "signals.torque.unit").startswith("mN m")
    assert "no line of 24 names" in said_of(draft, "table (log.txt)")
    check_reading(draft, tmp_path / "lab", file, motion)


def test_a_desired_signal_is_not_taken_for_a_measured_one(tmp_path: Path, motion: Columns) -> None:
    names = ["t", *numbered("q_des_", 0), *numbered("q_meas_", 0), *numbered("vel_", 0), *numbered("tau_", 0)]
    asked = motion["position"] + 0.01
    file = write(tmp_path / "log.csv", names, [TIME, asked, motion["position"], motion["velocity"], motion["effort"]])
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    check_reading(draft, tmp_path / "lab", file, motion)


def test_a_low_passed_velocity_is_noticed(tmp_path: Path, motion: Columns) -> None:
    late = np.column_stack([np.interp(TIME - 0.03, TIME, column) for column in motion["velocity"].T])
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"], late, motion["effort"]])
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    (said,) = [remark for remark in draft.remarks if "low-passed" in remark]
    assert said.startswith("velocities are 30 ms (+- ")
    assert float(said.rpartition("signals.velocity.delay: ")[2]) == pytest.approx(-0.03, abs=1e-3)


def test_the_joint_of_a_hit_whose_velocity_is_off_is_named(tmp_path: Path, motion: Columns) -> None:
    off = motion | {"velocity": motion["velocity"] * np.where(np.arange(7) == 2, 1.28, 1.0)}
    draft = draft_import([hits(tmp_path / "raw", off)], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert any(remark.startswith("velocity of joint 3 is 1.2") for remark in draft.remarks)


def test_motor_currents_are_taken_for_what_they_are(tmp_path: Path, motion: Columns) -> None:
    constants = np.linspace(8.0, 14.0, 7)
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("cur")]
    file = write(
        tmp_path / "log.csv", names, [TIME, motion["position"], motion["velocity"], motion["effort"] / constants]
    )
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert said_of(draft, "signals.torque.unit").startswith("A ")
    text = draft.texts["mapping.yaml"]
    assert "torque_measured_at: motor" in text
    found = load_mapping(described(draft, tmp_path / "lab")).torque_constant
    assert found is not None
    np.testing.assert_allclose(found[1], constants[1], rtol=0.05)
    assert any(line.key == "torque_constant" and not line.sure for line in draft.lines)


def test_another_robot_is_not_believed(tmp_path: Path, motion: Columns) -> None:
    """Positions beyond its limits in every unit."""
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"] + 9e4, motion["velocity"], motion["effort"]])
    said = refusal(draft_import, [file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert "no two signals of 7 joints" in said
    assert "--robot" in said


def test_what_the_files_do_not_say_is_asked_for(tmp_path: Path, motion: Columns) -> None:
    names = [*numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [motion["position"], motion["velocity"], motion["effort"]])
    assert "--robot is needed" in refusal(draft_import, [file], tmp_path / "lab", Wishes())
    assert "--rate says the sampling rate" in refusal(draft_import, [file], tmp_path, Wishes(robot="kuka_iiwa7"))
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7", rate=100.0))
    check_reading(draft, tmp_path / "lab", file, motion)
    (tmp_path / "words.csv").write_text("nothing\nto see\nhere\n")
    assert "no table of numbers begins" in refusal(draft_import, [tmp_path / "words.csv"], tmp_path, Wishes())


def test_repeated_stamps_are_said_and_removed_on_request(tmp_path: Path, motion: Columns) -> None:
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]
    twice = [np.repeat(one, 2, axis=0) for one in (TIME, motion["position"], motion["velocity"], motion["effort"])]
    file = write(tmp_path / "log.csv", names, twice)
    asked = draft_import([file], tmp_path / "one", Wishes(robot="kuka_iiwa7"))
    assert any("--dedupe" in remark for remark in asked.remarks)
    draft = draft_import([file], tmp_path / "two", Wishes(robot="kuka_iiwa7", dedupe=True))
    check_reading(draft, tmp_path / "two", file, motion)


def hits(folder: Path, motion: Columns, late: float = 0.0) -> Path:
    """Two hits in the form of another laboratory: vectors in cells, a line above the names, a file for the object.

    After 4 s all joints lose 0.08 rad/s and the object moves; its clock is ``late`` [s].
    """
    folder.mkdir()
    since = TIME[:, None] - 4.0
    motion = motion | {
        "position": motion["position"] - 0.08 * np.maximum(since, 0.0),
        "velocity": motion["velocity"] - 0.08 * (since > 0.0),
    }

    def cells(values: np.ndarray) -> list[str]:
        return [" ".join(f"{value:.12g}" for value in row) for row in values]

    for run in (8, 11):
        head = "DesiredFlux,1,HitTime,17.5,Pos,0.5 0.3 0.2\nRobotName,RosTime,JointPosition,JointVelocity,JointEffort"
        joints = zip(*(cells(motion[name]) for name in ("position", "velocity")), cells(-motion["effort"]), strict=True)
        stamps = 1.7e9 + 20.0 * run + TIME
        rows = [f"iiwa,{stamp:.6f},{','.join(row)}" for stamp, row in zip(stamps, joints, strict=True)]
        (folder / f"IIWA_7_hit_{run}.csv").write_text("\n".join([head, *rows]))
        place = np.array([0.5, 0.3, 0.2]) + np.outer(np.maximum(TIME - 4.0, 0.0), [0.1, 0.0, 0.0])
        turn = np.tile([0.0, 0.0, 0.0, 1.0], (TIME.size, 1))
        pose = zip(stamps, cells(place), cells(turn), strict=True)
        rows = [f"{stamp + late:.6f},{p},{q}" for stamp, p, q in pose]
        (folder / f"object_1_hit_{run}.csv").write_text("\n".join(["RosTime,Position,Orientation", *rows]))
    return folder


def test_a_folder_with_a_file_per_signal_and_run_is_described(tmp_path: Path, motion: Columns) -> None:
    folder = hits(tmp_path / "raw", motion)
    draft = draft_import([folder], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    mapping = load_mapping(described(draft, tmp_path / "lab"))
    assert mapping.signals["position"].file == "IIWA_7_hit_{run}.csv"
    assert mapping.signals["object_position"].file == "object_1_hit_{run}.csv"
    assert mapping.table.header == 2
    assert mapping.signals["object_position"].table is not None
    assert mapping.signals["torque"].factor == -1.0
    assert (draft.hits, draft.runs) == (2, 2)
    assert draft.texts["runs.csv"].splitlines() == ["bag,object,kind", "8,OBJECT,hit", "11,OBJECT,hit"]
    assert any("scenario.yaml, which is not there" in remark for remark in draft.remarks)
    assert not any("refuses" in remark for remark in draft.remarks)
    (folder / "object_1_hit_11.csv").unlink()
    later = draft_import([folder], tmp_path / "later", Wishes(robot="kuka_iiwa7"))
    assert any(remark == "left out, for a file is missing: 11 (object_1_hit_{run}.csv)" for remark in later.remarks)


@pytest.mark.parametrize(("late", "evidence"), [(0.05, "starts to move 50"), (-86400.0, "begin -86400 s after")])
def test_another_clock_of_the_object_is_proposed_with_what_shows_it(
    tmp_path: Path, motion: Columns, late: float, evidence: str
) -> None:
    draft = draft_import([hits(tmp_path / "raw", motion, late)], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    mapping = load_mapping(described(draft, tmp_path / "lab"))
    assert {mapping.signals[name].clock for name in ("object_position", "object_quaternion")} == {"own"}
    assert mapping.signals["velocity"].clock == "shared"
    for name in ("object_position", "object_quaternion"):
        said = said_of(draft, f"signals.{name}.clock")
        assert evidence in said and said.endswith("so in 2 of 2 runs that were looked at")


def test_one_clock_is_left_as_it_is(tmp_path: Path, motion: Columns) -> None:
    draft = draft_import([hits(tmp_path / "raw", motion)], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert "clock" not in draft.texts["mapping.yaml"]


JOINTS = ("lift_joint", "arm_1_joint", "arm_2_joint", "elbow", "arm_4_joint", "wrist_a", "wrist_b")


def signal_files(folder: Path, motion: Columns, velocity: bool, joint: str = "{joint}") -> Path:
    """A file per signal, whose columns are called after the joints."""
    folder.mkdir()
    for signal, column in (("position", "position"), ("velocity", "velocity"), ("effort", "effort")):
        if velocity or signal != "velocity":
            names = ["t", *(joint.format(joint=name, signal=signal) for name in JOINTS)]
            write(folder / f"robot_{signal}.csv", names, [TIME, motion[column]])
    return folder


@pytest.mark.parametrize("joint", ["{joint}", "- {joint}_{signal}", "{signal}_{joint}"])
def test_one_run_with_a_file_per_signal_is_read_once(tmp_path: Path, motion: Columns, joint: str) -> None:
    """Columns are named after joints; a word of the column's name, or the file's, says which signal it is."""
    folder = signal_files(tmp_path / "run", motion, True, joint)
    draft = draft_import([folder], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    mapping = load_mapping(described(draft, tmp_path / "lab"))
    files = {name: source.file for name, source in mapping.signals.items()}
    assert files == {"position": "robot_position.csv", "velocity": "robot_velocity.csv", "torque": "robot_effort.csv"}
    check_reading(draft, tmp_path / "lab", folder, motion)
    for run in ("run_1", "run_2"):
        (tmp_path / "runs").mkdir(exist_ok=True)
        signal_files(tmp_path / "runs" / run, motion, True, joint)
    assert [run.name for run in read_recordings(tmp_path / "runs", mapping)] == ["run_1", "run_2"]
    (folder / "robot_effort.csv").unlink()
    assert "no run here has the files" in refusal(read_recordings, folder, mapping)


@pytest.mark.parametrize("joint", ["{joint}", "{signal}_{joint}"])
def test_velocities_that_were_not_recorded_are_made_of_the_positions(
    tmp_path: Path, motion: Columns, joint: str
) -> None:
    folder = signal_files(tmp_path / "run", motion, False, joint)
    draft = draft_import([folder], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    assert said_of(draft, "signals.velocity").startswith("none no signal is the derivative of the positions")
    mapping = load_mapping(described(draft, tmp_path / "lab"))
    assert set(mapping.signals) == {"position", "torque"}
    (run,) = read_recordings(folder, mapping)
    arm = run.signals.arms["arm"]
    np.testing.assert_allclose(arm.velocity[1:-1], motion["velocity"][1:-1], atol=1e-3)
    np.testing.assert_allclose(arm.torque, motion["effort"], atol=1e-6)
    assert any("velocities are its derivative, by differences over 20 ms" in remark for remark in run.remarks)


def test_a_sampling_rate_that_velocities_contradict_is_refused_with_the_right_one(
    tmp_path: Path, motion: Columns
) -> None:
    names = [*numbered("a"), *numbered("b"), *numbered("c")]
    file = write(tmp_path / "log.csv", names, [motion["position"], motion["velocity"], motion["effort"]])
    said = refusal(draft_import, [file], tmp_path / "lab", Wishes(robot="kuka_iiwa7", rate=400.0))
    assert "b1 … b7 is 0.25 times the derivative of a1 … a7 in all joints" in said
    assert "velocity in rad/s at 100 Hz" in said and "--rate" in said


def test_positions_are_not_taken_for_velocities_that_do_not_fit(tmp_path: Path, motion: Columns) -> None:
    """A signal that is called a velocity and is none: nothing is made of it, or without it."""
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"], motion["velocity"] ** 2, motion["effort"]])
    assert "no two signals of 7 joints" in refusal(draft_import, [file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))


def test_joints_that_show_nothing_keep_their_sign_where_the_others_contradict_each_other(
    tmp_path: Path, motion: Columns
) -> None:
    """Two joints carry weight, one of them with the other sign; a torque times 0 would be none."""
    weights = np.abs(motion["effort"]).mean(axis=0)
    heavy = np.argsort(weights)[-2:]
    effort = np.random.default_rng(1).standard_normal(motion["effort"].shape)
    effort[:, heavy] = motion["effort"][:, heavy] * [1.0, -1.0]
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"], motion["velocity"], effort])
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="kuka_iiwa7"))
    factor = np.array(load_mapping(described(draft, tmp_path / "lab")).signals["torque"].factor)
    assert set(np.abs(factor)) == {1.0} and factor[heavy].tolist() == [1.0, -1.0]


def test_an_object_alone_needs_no_robot(tmp_path: Path) -> None:
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (TIME.size, 1))
    names = ["time", "pos_x", "pos_y", "pos_z", "quat_w", "quat_x", "quat_y", "quat_z"]
    file = write(tmp_path / "toss_1.csv", names, [TIME, 1e3 * np.outer(np.sin(TIME), [0.1, 0.2, 0.3]), turn])
    draft = draft_import([file], tmp_path / "lab", Wishes(robot="none"))
    mapping = load_mapping(described(draft, tmp_path / "lab"))
    assert mapping.signals["object_position"].unit == "mm"
    assert mapping.signals["object_quaternion"].quaternion_order == "wxyz"
    assert "body:" in draft.texts["experiment.yaml"]


@pytest.mark.parametrize(
    ("text", "header", "first"),
    [
        ("a,b\n1,2\n3,4\n5,6\n", None, None),
        ("made by x\n\na,b\n1,2\n3,4\n5,6\n", 3, None),
        ("a,b\ns,rad\n1,2\n3,4\n5,6\n", 1, 3),
        ("1 2\n3 4\n5 6\n", 0, None),
        ("17 rows\n1;2\n3;4\n5;6\n", 0, 2),
        ("# a b\n1 2\n3 4\n5 6\n", 1, None),
    ],
)
def test_where_a_table_begins_is_found_from_its_lines(
    tmp_path: Path, text: str, header: int | None, first: int | None
) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = find_layout(tmp_path / "a.csv").layout
    assert (found.header, found.first) == (header, first)


def test_files_are_grouped_by_what_differs_in_their_names(tmp_path: Path) -> None:
    def groups(*names: str) -> tuple[list[str], tuple[str, ...], bool]:
        found = group_files([tmp_path / name for name in names])
        return sorted(found.kinds), found.runs, found.spread

    assert groups("hit_2.csv", "hit_10.csv") == ([""], ("hit_2.csv", "hit_10.csv"), False)
    two = groups("IIWA_7_hit_2.csv", "IIWA_7_hit_10.csv", "object_1_hit_2.csv", "object_1_hit_10.csv")
    assert two == (["IIWA_7_hit_{run}.csv", "object_1_hit_{run}.csv"], ("2", "10"), True)
    assert groups("hit_3-IIWA_7.csv", "hit_4-IIWA_7.csv", "hit_3-box.csv", "hit_4-box.csv")[0] == [
        "hit_{run}-IIWA_7.csv", "hit_{run}-box.csv",
    ]  # fmt: skip
    folders = groups("a/pose.csv", "a/joints.csv", "b/pose.csv", "b/joints.csv")
    assert folders == (["joints.csv", "pose.csv"], ("a", "b"), True)
