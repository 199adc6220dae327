# SPDX-License-Identifier: Apache-2.0
"""Raw files are described as they are: what was planted in them is found with its evidence, and what is not is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from builders import described, mapping_in
from joint_recordings import Columns, swinging
from refusals import refusal
from ros_messages import message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.experiment import Experiment, load_experiment, read_runs
from impact_rs_trials.recordings.importing.candidates import candidates_of
from impact_rs_trials.recordings.importing.described_runs import _object_in
from impact_rs_trials.recordings.importing.file_groups import group_files, whole_runs
from impact_rs_trials.recordings.importing.import_recordings import ImportDraft, ImportOptions, draft_import
from impact_rs_trials.recordings.importing.table_layout import find_layout
from impact_rs_trials.recordings.laboratory import Laboratory
from impact_rs_trials.recordings.mapping import Mapping, MountedEndEffector, load_mapping
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.recording import read_recordings

TIME = np.arange(0.0, 8.0, 0.01)


def swing(time: np.ndarray) -> Columns:
    """An iiwa that swings about a bent pose."""
    import pinocchio as pin

    model = RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build(), pin.SE3.Identity())
    frequencies = (np.linspace(0.11, 0.23, 7), np.linspace(0.31, 0.47, 7))
    return swinging(model, time, np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1]), frequencies, (0.35, 0.1))


@pytest.fixture(scope="module")
def motion() -> Columns:
    """Of 8 s."""
    return swing(TIME)


def write(
    path: Path, names: list[str] | None, columns: list[np.ndarray], above: str = "", separator: str = ","
) -> Path:
    table = np.column_stack(columns).tolist()
    lines = [above] if above else []
    lines += [separator.join(names)] if names else []
    path.write_text("\n".join([*lines, *(separator.join(f"{value:.12g}" for value in row) for row in table)]))
    return path


def iiwa(path: Path, folder: Path, name: str = "lab", **options: object) -> ImportDraft:
    """What an import of an iiwa's recordings proposes; its files would go into a folder of this name."""
    return draft_import([path], folder / name, ImportOptions(robot="kuka_iiwa7", **options))


def usual(motion: Columns) -> list[np.ndarray]:
    """Columns of a log that has all it needs."""
    return [TIME, motion["position"], motion["velocity"], motion["effort"]]


def numbered(stem: str, first: int = 1) -> list[str]:
    return [f"{stem}{number}" for number in range(first, first + 7)]


NAMES = ["t", *numbered("q"), *numbered("dq"), *numbered("tau")]


def said_of(draft: ImportDraft, key: str) -> str:
    """What is said of a key."""
    return next(f"{line.value} {line.evidence}" for line in draft.lines if line.key == key)


def check_reading(draft: ImportDraft, folder: Path, target: Path, motion: Columns, near: float = 1e-6) -> None:
    """What is written reads the planted motion in SI units, torques within ``near`` [N m]."""
    (run,) = read_recordings(target, load_mapping(described(draft, folder)))
    arm = run.signals.arms["arm"]
    np.testing.assert_allclose(arm.position, motion["position"], atol=1e-9)
    np.testing.assert_allclose(arm.velocity, motion["velocity"], atol=1e-8)
    np.testing.assert_allclose(arm.torque, motion["effort"], atol=near)


def test_units_and_signs_are_found_from_the_numbers(tmp_path: Path, motion: Columns) -> None:
    """Degrees, degrees per second, and torques that point the other way; names that say nothing of it."""
    names = ["stamp", *numbered("q_"), *numbered("dq_"), *numbered("tau_")]
    columns = [1e3 * TIME + 5000.0, np.degrees(motion["position"]), np.degrees(motion["velocity"]), -motion["effort"]]
    file = write(tmp_path / "log.csv", names, columns)
    draft = iiwa(file, tmp_path)
    assert said_of(draft, "signals.position.unit").startswith("deg ")
    assert "not in rad" in said_of(draft, "signals.position.unit")
    assert "1 times the derivative of the position in deg/s" in said_of(draft, "signals.velocity.unit")
    assert "-1 times the torque that gravity and inertia of the arm take" in said_of(draft, "signals.torque.unit")
    assert "{column: stamp, unit: ms} increases; in ms that is 100 Hz" in said_of(draft, "time")
    assert "factor: -1" in draft.texts["mapping.yaml"]
    check_reading(draft, tmp_path / "lab", file, motion)


def test_a_table_without_names_is_read_by_its_numbers_alone(tmp_path: Path, motion: Columns) -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((TIME.size, 2))
    columns = [TIME, noise, motion["velocity"], motion["position"], 1e3 * motion["effort"]]
    file = write(tmp_path / "log.txt", None, columns, separator=" ")
    draft = iiwa(file, tmp_path)
    assert "columns: [c11, c12, c13, c14, c15, c16, c17]" in draft.texts["mapping.yaml"]
    assert said_of(draft, "signals.torque.unit").startswith("mN m")
    assert "no line of 24 names" in said_of(draft, "table (log.txt)")
    check_reading(draft, tmp_path / "lab", file, motion)


@pytest.mark.parametrize("order", [("position", "velocity", "effort"), ("effort", "velocity", "position")])
def test_joints_are_not_taken_out_of_the_blocks_of_a_wider_arm(
    order: tuple[str, ...], tmp_path: Path, motion: Columns
) -> None:
    facts = load_facts("kuka_iiwa7")
    limits = {name: values[:2] for name, values in facts.limits.model_dump().items()}
    small = facts.model_dump(mode="json") | {"joints": facts.joints[:2], "links": facts.links[:2], "limits": limits}
    small = RobotFacts.model_validate({name: value for name, value in small.items() if value is not None})
    (tmp_path / "small.yaml").write_text(small.model_dump_json(exclude_none=True))
    file = write(tmp_path / "log.txt", None, [TIME, *(motion[name] for name in order)], separator=" ")
    said = refusal(draft_import, [file], tmp_path, ImportOptions(robot=str(tmp_path / "small.yaml")))
    assert "hold positions and velocities of 7 joints, and " in said and "has 2" in said


def test_a_desired_signal_is_not_taken_for_a_measured_one(tmp_path: Path, motion: Columns) -> None:
    names = ["t", *numbered("q_des_", 0), *numbered("q_meas_", 0), *numbered("vel_", 0), *numbered("tau_", 0)]
    asked = motion["position"] + 0.01
    file = write(tmp_path / "log.csv", names, [TIME, asked, motion["position"], motion["velocity"], motion["effort"]])
    draft = iiwa(file, tmp_path)
    check_reading(draft, tmp_path / "lab", file, motion)


def test_a_counter_of_milliseconds_is_told_from_seconds_by_the_velocities(tmp_path: Path) -> None:
    """Stamps 0, 1, 2, ... may be in any unit; velocities in rad/s say in which. Computed positions are left alone."""
    counter = np.arange(2000)
    motion = swing(1e-3 * counter)
    names = ["Time", *numbered("PositionCmptd"), *numbered("Position"), *numbered("Velocity"), *numbered("Torque")]
    computed = motion["position"] + 0.01
    columns = [counter, computed, motion["position"], motion["velocity"], motion["effort"]]
    file = write(tmp_path / "log.csv", names, columns)
    draft = iiwa(file, tmp_path)
    assert said_of(draft, "time").startswith("{column: Time, unit: ms} increases; in ms, 1000 Hz, Velocity1 … ")
    assert next(line.sure for line in draft.lines if line.key == "time")
    check_reading(draft, tmp_path / "lab", file, motion)


@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_times_since_the_row_before_are_added_up(ending: str, tmp_path: Path, motion: Columns) -> None:
    """Rows were lost, and none is before the first. Kills steps taken for stamps, a first one added, and a counter."""
    kept = np.arange(TIME.size) % 8 != 5
    steps = np.diff(TIME[kept], prepend=-5.0)
    parts = {"q": motion["position"][kept], "dq": motion["velocity"][kept], "tau": motion["effort"][kept]}
    file = tmp_path / f"log.{ending}"
    if ending == "npz":
        np.savez(file, dt=steps, **parts)
    else:
        names = ["row", "dt", *(name for part in parts for name in numbered(f"{part}_"))]
        write(file, names, [np.arange(steps.size), steps, *parts.values()])
        file.write_text(file.read_text().replace("\n0,5,", "\n0,,", 1))
    mapping = mapping_in(iiwa(file, tmp_path), tmp_path / "lab")
    assert mapping.time.steps and mapping.time.unit == "s"
    found = read_series(file, mapping, ["position"], ["position"])["position"]
    np.testing.assert_allclose(found.time, TIME[kept] - TIME[0], atol=1e-9)


def test_steps_of_a_date_or_of_frames_are_refused() -> None:
    content = {
        "description": "",
        "robot": "none",
        "signals": {"object_pose": {"unit": "m", "columns": list("abcdefg")}},
    }
    for unit in ("date", "frames"):
        with pytest.raises(ValueError, match=f"time.steps has time.unit '{unit}', expected s, ms, us or ns"):
            Mapping.model_validate(content | {"time": {"unit": unit, "steps": True}})


def test_a_low_passed_velocity_is_noticed(tmp_path: Path, motion: Columns) -> None:
    late = np.column_stack([np.interp(TIME - 0.03, TIME, column) for column in motion["velocity"].T])
    file = write(tmp_path / "log.csv", NAMES, [TIME, motion["position"], late, motion["effort"]])
    draft = iiwa(file, tmp_path)
    (said,) = [remark for remark in draft.remarks if "low-passed" in remark]
    assert said.startswith("velocities are 30 ms (+- ")
    assert float(said.rpartition("signals.velocity.delay: ")[2]) == pytest.approx(-0.03, abs=1e-3)


def test_the_joint_of_a_hit_whose_velocity_is_off_is_named(tmp_path: Path, motion: Columns) -> None:
    off = motion | {"velocity": motion["velocity"] * np.where(np.arange(7) == 2, 1.28, 1.0)}
    draft = iiwa(hits(tmp_path / "raw", off), tmp_path)
    assert any(remark.startswith("velocity of joint 3 is 1.2") for remark in draft.remarks)


def test_motor_currents_are_taken_for_what_they_are(tmp_path: Path, motion: Columns) -> None:
    constants = np.linspace(8.0, 14.0, 7)
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("cur")]
    file = write(
        tmp_path / "log.csv", names, [TIME, motion["position"], motion["velocity"], motion["effort"] / constants]
    )
    draft = iiwa(file, tmp_path)
    assert said_of(draft, "signals.torque.unit").startswith("A ")
    text = draft.texts["mapping.yaml"]
    assert "torque_measured_at: motor" in text
    found = mapping_in(draft, tmp_path / "lab").torque_constant
    assert found is not None
    np.testing.assert_allclose(found[1], constants[1], rtol=0.05)
    assert any(line.key == "torque_constant" and not line.sure for line in draft.lines)


def test_measured_currents_are_taken_before_the_torque_that_a_controller_computed(
    tmp_path: Path, motion: Columns
) -> None:
    """Files of unnamed columns, as a UR's i_actual beside m_target; kills the target that fits the model exactly."""
    folder = tmp_path / "run"
    folder.mkdir()
    noise, gears = np.random.default_rng(4), 12.0 * np.tanh(motion["velocity"] / 0.02)
    current = (motion["effort"] + gears) / 11.0 + noise.normal(0.0, 0.05, gears.shape)
    streams = {"q_actual": motion["position"], "qd_actual": motion["velocity"], "i_actual": current}
    for name, values in (streams | {"m_target": motion["effort"]}).items():
        write(folder / f"log_{name}.csv", None, [TIME, values])
    draft = iiwa(folder, tmp_path)
    assert said_of(draft, "signals.torque.unit").startswith("A ")
    assert mapping_in(draft, tmp_path / "lab").signals["torque"].file == "log_i_actual.csv"


@pytest.mark.parametrize(("late", "unit", "said"), [(0, 1.0, "repeats the positions"), (8, 57.3, "positions, in deg")])
def test_commanded_positions_are_no_currents(
    tmp_path: Path, motion: Columns, late: int, unit: float, said: str
) -> None:
    """A log of positions with what was asked of them, as of a leader arm: ahead, in another unit, with an offset."""
    names = ["t", *numbered("q"), *numbered("action")]
    ahead = unit * (np.roll(motion["position"], -late, axis=0) + 0.01)
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"], ahead])
    refused = refusal(iiwa, file, tmp_path)
    assert f"action1 … action7 repeats the {said.removeprefix('repeats the ')}" in refused
    assert "a mapping needs torques or currents" in refused
    everything = [TIME, motion["position"], ahead, motion["velocity"], motion["effort"]]
    whole = write(tmp_path / "whole.csv", [*names, *numbered("speed"), *numbered("load")], everything)
    check_reading(iiwa(whole, tmp_path), tmp_path / "lab", whole, motion)


@pytest.mark.parametrize("factors", [[1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 100.0, 1.0, 1.0, 1.0]])
def test_constants_of_mixed_signs_or_sizes_are_none_of_one_arm(
    tmp_path: Path, motion: Columns, factors: list[float]
) -> None:
    """Numbers that go with the weight joint by joint, and are no currents of one arm."""
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("x")]
    numbers = 100.0 * motion["effort"] * factors
    file = write(tmp_path / "log.csv", names, [TIME, motion["position"], motion["velocity"], numbers])
    said = refusal(iiwa, file, tmp_path)
    assert "nothing goes with the torque that gravity and inertia of kuka_iiwa7 take" in said


def test_another_robot_is_not_believed(tmp_path: Path, motion: Columns) -> None:
    """Positions beyond its limits in every unit."""
    file = write(tmp_path / "log.csv", NAMES, [TIME, motion["position"] + 9e4, motion["velocity"], motion["effort"]])
    said = refusal(iiwa, file, tmp_path)
    assert "no two signals of 7 joints" in said
    assert "--robot" in said


def test_magnitudes_of_currents_are_no_torque(tmp_path: Path, motion: Columns) -> None:
    """A register without sign. Kills factors of any sign per joint, which fit half of such a torque."""
    columns = [TIME, motion["position"], motion["velocity"], np.abs(motion["effort"])]
    with pytest.raises(InputError, match="tau1 … tau7 never changes its sign, although joints reverse"):
        iiwa(write(tmp_path / "log.csv", NAMES, columns), tmp_path)


def test_a_log_of_events_beside_the_signals_is_left_out_and_said(tmp_path: Path, motion: Columns) -> None:
    """Texts without numbers in a folder of tables; alone they are refused."""
    folder = tmp_path / "run"
    folder.mkdir()
    write(folder / "joints.csv", NAMES, usual(motion))
    (folder / "event.csv").write_text("type,event\nEVENT,START\nEVENT,STOP\n")
    draft = iiwa(folder, tmp_path)
    assert any("event.csv: no table of numbers" in remark for remark in draft.remarks)
    check_reading(draft, tmp_path / "lab", folder, motion)
    (folder / "joints.csv").unlink()
    with pytest.raises(InputError, match="no table of numbers"):
        iiwa(folder, tmp_path, "other")


def test_a_urdf_is_no_robot_facts_and_the_command_that_makes_them_is_named(tmp_path: Path, motion: Columns) -> None:
    """Kills a list of the known robots in answer to one's own."""
    file = write(tmp_path / "log.csv", NAMES, usual(motion))
    said = refusal(draft_import, [file], tmp_path / "lab", ImportOptions(robot="arms/mine.urdf"))
    assert "impact-rs robot import" in said and "arms/mine.urdf" in said


def test_joints_of_a_humanoid_are_taken_by_entries_of_a_mapping(tmp_path: Path) -> None:
    """Two arms and two hands in one vector. Kills a refusal without the key that takes one arm."""
    np.savez(tmp_path / "episode.npz", time=TIME, state=np.sin(TIME[:, None] + np.arange(26.0)))
    said = refusal(iiwa, tmp_path / "episode.npz", tmp_path)
    assert "state (800 × 26), of which a mapping takes joints by entries" in said


def test_robot_and_sampling_rate_are_asked_for_where_files_lack_them(tmp_path: Path, motion: Columns) -> None:
    names = [*numbered("q"), *numbered("dq"), *numbered("tau")]
    file = write(tmp_path / "log.csv", names, [motion["position"], motion["velocity"], motion["effort"]])
    assert "--robot is needed" in refusal(draft_import, [file], tmp_path / "lab", ImportOptions())
    assert "--rate says the sampling rate" in refusal(iiwa, file, tmp_path)
    draft = draft_import([file], tmp_path / "lab", ImportOptions(robot="kuka_iiwa7", rate=100.0))
    check_reading(draft, tmp_path / "lab", file, motion)
    (tmp_path / "words.csv").write_text("nothing\nto see\nhere\n")
    assert "no table of numbers begins" in refusal(draft_import, [tmp_path / "words.csv"], tmp_path, ImportOptions())


def test_separators_at_the_ends_of_lines_make_no_columns(tmp_path: Path, motion: Columns) -> None:
    """A spreadsheet writes them below the widest line. Kills columns without a name of which there are two."""
    file = write(tmp_path / "log.csv", NAMES, [TIME, motion["position"], motion["velocity"], motion["effort"]])
    first, *lines = file.read_text().splitlines()
    file.write_text("\n".join([f"{first},,", *(f"{line},," for line in lines)]) + "\n")
    check_reading(iiwa(file, tmp_path), tmp_path, file, motion, 1e-3)


def test_timestamps_that_step_back_are_named(tmp_path: Path, motion: Columns) -> None:
    columns = [motion["position"], motion["velocity"], motion["effort"]]
    back = TIME - 0.5 * (TIME >= 4.0)
    shuffled = write(tmp_path / "log.csv", NAMES, [TIME - 0.5 * (np.arange(TIME.size) // 30), *columns])
    assert "the clock was set, or rows are not in order; sort the rows" in refusal(iiwa, shuffled, tmp_path)
    alone = iiwa(write(tmp_path / "alone.csv", NAMES, [back, *columns]), tmp_path).remarks
    assert any("the clock was set back by 0.5 s at t = 3.990 s" in one for one in alone)
    counter = write(tmp_path / "counted.csv", ["row", *NAMES], [np.arange(TIME.size), back, *columns])
    said = refusal(iiwa, counter, tmp_path)
    assert "'t' steps back from 3.99 to 3.5" in said and "another clock was taken" in said
    german = iiwa(write(tmp_path / "german.csv", ["Zeit", *NAMES[1:]], [back, *columns]), tmp_path)  # even steps tell
    assert any("the clock was set back by 0.5 s at t = 3.990 s" in one for one in german.remarks)
    other = write(tmp_path / "two.csv", ["own", *NAMES], [TIME, back, *columns])
    remarks = iiwa(other, tmp_path).remarks
    assert any("'t' steps back from 3.99 to 3.5" in one and "own is taken for the clock" in one for one in remarks)


def test_an_arm_at_rest_is_said_to_show_nothing(tmp_path: Path, motion: Columns) -> None:
    rng = np.random.default_rng(0)
    still = {name: np.tile(motion[name][:1], (TIME.size, 1)) for name in ("position", "effort")}
    position = still["position"] + 1e-5 * rng.standard_normal(motion["position"].shape)
    velocity = 1e-3 * rng.standard_normal(position.shape)
    torque = still["effort"] + 0.3 * rng.standard_normal(position.shape)
    for heads in (NAMES, None):
        file = write(tmp_path / "rest.csv", heads, [TIME, position, velocity, torque])
        said = refusal(iiwa, file, tmp_path)
        assert "no motion, nothing to identify: joint " in said and "unit" not in said
    write(file, NAMES, usual(motion))
    mapping = load_mapping(described(iiwa(file, tmp_path), tmp_path / "lab"))
    write(file, NAMES, [TIME, position, velocity, torque])
    assert "no motion, nothing to identify" in refusal(read_recordings, file, mapping)


@pytest.mark.parametrize("place", ["reference_runs/log.csv", "runs/offer.csv"])
def test_a_word_that_only_holds_the_name_of_a_robot_names_none(place: str, tmp_path: Path, motion: Columns) -> None:
    file = tmp_path / "xarm7" / place  # of folders further up nothing follows
    file.parent.mkdir(parents=True)
    write(file, NAMES, usual(motion))
    assert "--robot is needed" in refusal(draft_import, [file], tmp_path / "lab", ImportOptions())


@pytest.mark.parametrize("place", ["iiwa7/log.csv", "runs/LBR iiwa 7.csv"])
def test_a_robot_that_file_or_folder_name_is_assumed(place: str, tmp_path: Path, motion: Columns) -> None:
    file = tmp_path / place
    file.parent.mkdir(parents=True)
    write(file, NAMES, usual(motion))
    robot = next(line for line in draft_import([file], tmp_path / "lab", ImportOptions()).lines if line.key == "robot")
    assert robot.value == "kuka_iiwa7" and not robot.sure


def test_repeated_stamps_are_said_and_removed_on_request(tmp_path: Path, motion: Columns) -> None:
    twice = [np.repeat(one, 2, axis=0) for one in (TIME, motion["position"], motion["velocity"], motion["effort"])]
    file = write(tmp_path / "log.csv", NAMES, twice)
    asked = iiwa(file, tmp_path, "one")
    assert any("--dedupe" in remark for remark in asked.remarks)
    draft = draft_import([file], tmp_path / "two", ImportOptions(robot="kuka_iiwa7", dedupe=True))
    check_reading(draft, tmp_path / "two", file, motion)


def test_an_import_passes_on_why_the_reader_refuses_a_file(tmp_path: Path, motion: Columns) -> None:
    """Stamps that hardly change, a cell that is no number, and signals of another width: not another robot."""
    names = ["t", *numbered("q"), *numbered("dq"), *numbered("tau"), "a1", "a2"]
    coarse = [np.floor(TIME), motion["position"], motion["velocity"], motion["effort"], TIME, TIME**2]
    file = write(tmp_path / "log.csv", names, coarse)
    said = refusal(iiwa, file, tmp_path)
    assert "no signal of 7 joints can be read" in said and "--robot" not in said
    assert "q1 … q7, dq1 … dq7, tau1 … tau7: 8 of 800 samples have numbers and a later stamp" in said
    assert "stamps were taken from t [s]; the key time of a mapping names other stamps" in said
    assert "signals of other widths: a1 … a2" in said
    good = [TIME, motion["position"], motion["velocity"], motion["effort"], TIME, TIME**2]
    text = write(tmp_path / "log.csv", names, good).read_text().splitlines()
    cells = text[60].split(",")
    text[60] = ",".join([*cells[:3], "broken", *cells[4:]])
    file.write_text("\n".join(text))
    said = refusal(iiwa, file, tmp_path)
    assert "q1 … q7: " in said and "line 61" in said and "'broken' in column 'q3'" in said


@pytest.mark.parametrize(("start", "mapping"), [(1.7e9, "[sec, nsec]"), (0.0, "[sec, nsec]")])
def test_whole_seconds_and_nanoseconds_are_one_stamp(
    tmp_path: Path, motion: Columns, start: float, mapping: str
) -> None:
    sec, nsec = np.divmod(np.round(1e9 * (TIME + 0.25)).astype(np.int64) + int(start) * 10**9, 10**9)
    names = ["sec", "nsec", *numbered("q"), *numbered("dq"), *numbered("tau")]
    columns = [sec.astype(float), nsec.astype(float), motion["position"], motion["velocity"], motion["effort"]]
    file = write(tmp_path / "log.csv", names, columns)
    draft = iiwa(file, tmp_path)
    assert f"time: {{column: {mapping}, unit: s}}   # whole seconds and nanoseconds" in draft.texts["mapping.yaml"]
    check_reading(draft, tmp_path / "lab", file, motion)
    (run,) = read_recordings(file, load_mapping(tmp_path / "lab" / "mapping.yaml"))
    np.testing.assert_allclose(np.diff(run.signals.time), 0.01, atol=3e-7)


def test_arrays_of_joints_x_samples_are_found(tmp_path: Path, motion: Columns) -> None:
    """As MATLAB has them, with a gripper as eighth row."""
    gripper = 0.02 * np.ones((1, TIME.size))
    arrays = {"q": np.vstack((motion["position"].T, gripper)), "dq": motion["velocity"].T, "tau": motion["effort"].T}
    scipy.io.savemat(tmp_path / "run.mat", {"log": {"t": TIME, **arrays}})
    draft = iiwa(tmp_path / "run.mat", tmp_path)
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["position"].entries == (1, 2, 3, 4, 5, 6, 7)
    assert mapping.signals["velocity"].entries is None
    assert "signals.position: of log/q (8 × 800), the first 7 numbers are taken for the joints" in draft.remarks
    check_reading(draft, tmp_path / "lab", tmp_path / "run.mat", motion)


@pytest.mark.parametrize("first", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_gripper_beside_the_joints_is_cut_off_and_said(tmp_path: Path, motion: Columns, first: int) -> None:
    names, columns = ["t"], [TIME]
    for stem, signal in (("q_", "position"), ("dq_", "velocity"), ("tau_", "effort")):
        names += [f"{stem}{number}" for number in range(first, first + 8)]
        columns.append(np.column_stack((motion[signal], 0.001 * np.sin(TIME))))
    file = write(tmp_path / "log.csv", names, columns)
    draft = iiwa(file, tmp_path)
    assert sum(", the first 7 numbers are taken for the joints" in remark for remark in draft.remarks) == 3
    assert [line.sure for line in draft.lines if line.key == "signals.position"] == [False]
    check_reading(draft, tmp_path / "lab", file, motion)
    said = refusal(draft_import, [file], tmp_path / "lab", ImportOptions(robot="ur10e"))
    assert "nothing goes with the torque" in said


@pytest.mark.parametrize("form", [" vectors.csv", ".npz", pytest.param(".csv", marks=pytest.mark.slow)])
def test_a_gripper_before_the_joints_is_cut_off_and_said(tmp_path: Path, motion: Columns, form: str) -> None:
    """Two numbers stand before the joints, one or none behind them; the numbers show which are the joints."""
    wide = {
        short: np.column_stack((0.02 + 0.001 * np.sin(TIME), 0.001 * np.cos(TIME), motion[signal]))
        for short, signal in (("q", "position"), ("dq", "velocity"), ("tau", "effort"))
    }
    file = tmp_path / f"log{form}"
    if form == ".npz":
        np.savez(file, t=TIME, **wide)
    elif form == ".csv":
        write(file, ["t", *(f"{short}_{n}" for short in wide for n in range(1, 10))], [TIME, *wide.values()])
    else:
        cells = [[" ".join(f"{one:.12g}" for one in row) for row in values] for values in wide.values()]
        rows = [f"{time:.3f},{','.join(row)}" for time, row in zip(TIME, zip(*cells, strict=True), strict=True)]
        file.write_text("\n".join(["t,q,dq,tau", *rows]) + "\n")
    draft = iiwa(file, tmp_path)
    assert sum("the last 7 numbers are taken for the joints" in remark for remark in draft.remarks) == 3
    assert [line.sure for line in draft.lines if line.key == "signals.position"] == [False]
    check_reading(draft, tmp_path / "lab", file, motion)


def test_numbers_with_decimal_commas_are_read(tmp_path: Path, motion: Columns) -> None:
    names = ["Zeit [s]", *numbered("q"), *numbered("dq"), *numbered("tau")]
    columns = usual(motion)
    file = write(tmp_path / "log.csv", names, columns, separator=";")
    file.write_text(file.read_text().replace(".", ","))
    draft = iiwa(file, tmp_path)
    (table,) = (line for line in draft.texts["mapping.yaml"].splitlines() if line.startswith("table:"))
    assert table.startswith('table: {decimal: ","}   # ') and "numbers have a decimal comma" in table
    assert "numbers have a decimal comma" in said_of(draft, "table (log.csv)")
    check_reading(draft, tmp_path / "lab", file, motion)


def two_groups(path: Path, motion: Columns, name: str) -> Path:
    """The motion and, in a second group, its first half with another stamp."""
    with pytest.importorskip("h5py").File(path, "w") as file:
        for number, rows in ((1, slice(None)), (2, slice(0, 400))):
            stamps = TIME[rows] + 100.0 * number
            arrays = {"t": stamps, "q": motion["position"], "dq": motion["velocity"], "tau": motion["effort"]}
            for key, values in arrays.items():
                file[f"{name}_{number:03d}/robot/{key}"] = values[rows]
    return path


def test_every_recording_of_an_hdf5_file_is_a_run(tmp_path: Path, motion: Columns) -> None:
    file = two_groups(tmp_path / "archive.h5", motion, "Rec")
    draft = iiwa(file, tmp_path)
    assert draft.runs == 2
    assert draft.texts["runs.csv"].splitlines()[1:] == [
        "archive.h5/Rec_001,none,free motion", "archive.h5/Rec_002,none,free motion",
    ]  # fmt: skip
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["position"].array == "{run}/robot/q"
    assert not any("refuses" in remark for remark in draft.remarks)
    runs = read_recordings(file, mapping)
    assert [(run.name, run.signals.time.size) for run in runs] == [("Rec_001", 800), ("Rec_002", 400)]
    np.testing.assert_allclose(runs[1].signals.arms["arm"].position, motion["position"][:400], atol=1e-9)
    (alone,) = read_recordings(file / "Rec_002", mapping)
    assert alone.signals.time.size == 400
    experiment = Experiment(scenario="push_iiwa7", mapping=str(tmp_path / "lab" / "mapping.yaml"))
    (tmp_path / "runs.csv").write_text(draft.texts["runs.csv"])
    rows = read_runs(tmp_path, experiment, experiment.load_scenario())
    assert [row.path for row in rows] == [file / "Rec_001", file / "Rec_002"]


def test_groups_that_may_be_robots_are_not_left_out_in_silence(tmp_path: Path, motion: Columns) -> None:
    draft = iiwa(two_groups(tmp_path / "a.h5", motion, "arm"), tmp_path)
    assert draft.runs == 1
    (said,) = [remark for remark in draft.remarks if "hold arrays of the same names" in remark]
    assert "groups arm_001, arm_002" in said and "write {run} for the name of the group" in said


def test_runs_that_no_path_can_name_are_refused_with_the_reason(tmp_path: Path, motion: Columns) -> None:
    """Kills: no run has all of its files, with nothing behind it."""
    file = write(tmp_path / "a.csv", ["time", *numbered("q"), *numbered("dq"), *numbered("tau")],
                 [TIME, motion["position"], motion["velocity"], motion["effort"]])  # fmt: skip
    head, *rows = file.read_text().splitlines()
    named = [f"{row},a/{1 + number // 400}" for number, row in enumerate(rows)]
    file.write_text("\n".join([f"{head},run", *named]) + "\n")
    assert "expected the name of a run in every row, without /" in refusal(iiwa, file, tmp_path)


def test_episodes_of_one_table_are_runs(tmp_path: Path, motion: Columns) -> None:
    names = ["timestamp", "episode_index", "frame_index", *numbered("q"), *numbered("dq"), *numbered("tau")]
    half = [signal.reshape(2, 400, -1) for signal in (motion["position"], motion["velocity"], motion["effort"])]
    frames = np.arange(400.0)
    columns = [np.tile(TIME[:400], 2), np.repeat([3.0, 4.0], 400), np.tile(frames, 2)]
    file = write(tmp_path / "file-000.csv", names, [*columns, *(np.vstack(list(one)) for one in half)])
    draft = iiwa(file, tmp_path)
    assert draft.texts["runs.csv"].splitlines()[1:] == [
        "file-000.csv/3,none,free motion", "file-000.csv/4,none,free motion",
    ]  # fmt: skip
    runs = read_recordings(file, mapping_in(draft, tmp_path / "lab"))
    found = np.vstack([run.signals.arms["arm"].position for run in runs])
    np.testing.assert_allclose(found, motion["position"], atol=1e-9)


def hits(
    folder: Path, motion: Columns, runs: tuple[int, ...] = (8, 11), object_name: str = "1", late: float = 0.0
) -> Path:
    """Hits in the form of another laboratory: vectors in cells, a line above the names, a file for the object.

    After 4 s all joints lose 0.08 rad/s and the object moves; its clock is ``late`` [s].
    """
    folder.mkdir(exist_ok=True, parents=True)
    since = TIME[:, None] - 4.0
    motion = motion | {
        "position": motion["position"] - 0.08 * np.maximum(since, 0.0),
        "velocity": motion["velocity"] - 0.08 * (since > 0.0),
    }

    def cells(values: np.ndarray) -> list[str]:
        return [" ".join(f"{value:.12g}" for value in row) for row in values]

    for run in runs:
        head = "DesiredFlux,1,HitTime,17.5,Pos,0.5 0.3 0.2\nRobotName,RosTime,JointPosition,JointVelocity,JointEffort"
        joints = zip(*(cells(motion[name]) for name in ("position", "velocity")), cells(-motion["effort"]), strict=True)
        stamps = 1.7e9 + 20.0 * run + TIME
        rows = [f"iiwa,{stamp:.6f},{','.join(row)}" for stamp, row in zip(stamps, joints, strict=True)]
        (folder / f"IIWA_7_hit_{run}.csv").write_text("\n".join([head, *rows]))
        place = np.array([0.5, 0.3, 0.2]) + np.outer(np.maximum(TIME - 4.0, 0.0), [0.1, 0.0, 0.0])
        turn = np.tile([0.0, 0.0, 0.0, 1.0], (TIME.size, 1))
        pose = zip(stamps, cells(place), cells(turn), strict=True)
        rows = [f"{stamp + late:.6f},{p},{q}" for stamp, p, q in pose]
        (folder / f"object_{object_name}_hit_{run}.csv").write_text("\n".join(["RosTime,Position,Orientation", *rows]))
    return folder


@pytest.mark.parametrize("word", ["", "goal_"])
def test_the_pose_of_the_robots_own_tool_is_no_object(word: str, tmp_path: Path, motion: Columns) -> None:
    """A tool 0.1 m before the flange; its target is 4 mm off. Kills a free motion that is read as a hit."""
    import pinocchio as pin

    arm = RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build(), pin.SE3.Identity())
    tool = pin.SE3(np.eye(3), np.array([0.0, 0.06, 0.08]))
    poses = np.array([pin.SE3ToXYZQUAT(arm.placement(q) * tool) for q in motion["position"]])
    if word:
        poses[:, :3] += np.random.default_rng(0).normal(0.0, 0.004, (TIME.size, 3))
    names = [f"{word}{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    draft = iiwa(write(tmp_path / "log.csv", [*NAMES, *names], [*usual(motion), poses]), tmp_path)
    assert draft.hits == 0 and "object" not in draft.texts["mapping.yaml"]
    assert any("moves with the tip of the robot, 100 mm from it" in remark for remark in draft.remarks)


def test_a_folder_with_a_file_per_signal_and_run_is_described(tmp_path: Path, motion: Columns) -> None:
    folder = hits(tmp_path / "raw", motion)
    draft = iiwa(folder, tmp_path)
    mapping = mapping_in(draft, tmp_path / "lab")
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
    later = iiwa(folder, tmp_path, "later")
    assert any(remark == "left out, because a file is missing: 11 (object_1_hit_{run}.csv)" for remark in later.remarks)


@pytest.mark.parametrize(("late", "evidence"), [(0.05, "starts to move 50"), (-86400.0, "begin -86400 s after")])
def test_another_clock_of_the_object_is_proposed_with_what_shows_it(
    tmp_path: Path, motion: Columns, late: float, evidence: str
) -> None:
    draft = iiwa(hits(tmp_path / "raw", motion, late=late), tmp_path)
    mapping = mapping_in(draft, tmp_path / "lab")
    assert {mapping.signals[name].clock for name in ("object_position", "object_quaternion")} == {"own"}
    assert mapping.signals["velocity"].clock == "shared"
    for name in ("object_position", "object_quaternion"):
        said = said_of(draft, f"signals.{name}.clock")
        assert evidence in said and said.endswith("so in 2 of 2 compared runs")


def test_another_clock_is_seen_in_files_that_name_session_and_object(tmp_path: Path, motion: Columns) -> None:
    hits(tmp_path / "raw" / "D1_clean", motion, (0, 1), "parcel", late=0.05)
    hits(tmp_path / "raw" / "D1_dirty", motion, (0,), "juice", late=0.05)
    draft = iiwa(tmp_path / "raw", tmp_path, scenario="push_iiwa7")
    assert draft.texts["runs.csv"].splitlines()[1:] == [
        "D1_clean/0,parcel,hit,D1_clean", "D1_clean/1,parcel,hit,D1_clean", "D1_dirty/0,juice,hit,D1_dirty",
    ]  # fmt: skip
    assert said_of(draft, "signals.object_position.clock").endswith("so in 3 of 3 compared runs")


def test_one_clock_is_left_as_it_is(tmp_path: Path, motion: Columns) -> None:
    draft = iiwa(hits(tmp_path / "raw", motion), tmp_path)
    assert "clock" not in draft.texts["mapping.yaml"]


def test_hits_of_sessions_that_count_alike_are_all_kept(tmp_path: Path, motion: Columns) -> None:
    """A folder per session, in each a file per signal and run: a run is known by its folder and its number."""
    hits(tmp_path / "raw" / "D1_clean", motion, (0, 1))
    hits(tmp_path / "raw" / "D1_dirty", motion, (0, 3))
    draft = iiwa(tmp_path / "raw", tmp_path, scenario="push_iiwa7")
    assert draft.texts["runs.csv"].splitlines() == [
        "bag,object,kind,session",
        "D1_clean/0,parcel,hit,D1_clean", "D1_clean/1,parcel,hit,D1_clean",
        "D1_dirty/0,parcel,hit,D1_dirty", "D1_dirty/3,parcel,hit,D1_dirty",
    ]  # fmt: skip
    described(draft, tmp_path / "lab")
    experiment = load_experiment(tmp_path / "lab" / "experiment.yaml")
    rows = read_runs(tmp_path / "raw", experiment, experiment.load_scenario())
    assert [(row.label, row.session) for row in rows] == [
        ("D1_clean/0", "D1_clean"), ("D1_clean/1", "D1_clean"), ("D1_dirty/0", "D1_dirty"), ("D1_dirty/3", "D1_dirty"),
    ]  # fmt: skip
    (mapping,) = experiment.load_mappings(["arm"]).values()
    assert (
        len({float(read_series(row.path, mapping, ["position"], ["position"])["position"].time[0]) for row in rows})
        == 3
    )
    assert len(read_recordings(tmp_path / "raw", mapping)) == 4
    (tmp_path / "raw" / "D1_dirty" / "object_1_hit_3.csv").rename(tmp_path / "raw" / "notes.csv")
    later = iiwa(tmp_path / "raw", tmp_path, "later")
    assert later.runs == 3
    assert "left out, because a file is missing: D1_dirty/3 (object_1_hit_{run}.csv)" in later.remarks
    assert "not read, because the mapping takes no signal from them: notes.csv" in later.remarks


def test_the_object_of_a_run_is_found_in_the_name_of_its_file(tmp_path: Path, motion: Columns) -> None:
    hits(tmp_path / "raw", motion, (0, 1), "parcel")
    hits(tmp_path / "raw", motion, (2,), "juice")
    draft = iiwa(tmp_path / "raw", tmp_path, scenario="push_iiwa7")
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["object_position"].file == "object_{object}_hit_{run}.csv"
    assert draft.texts["runs.csv"].splitlines()[1:] == ["0,parcel,hit", "1,parcel,hit", "2,juice,hit"]
    assert not any("refuses" in remark for remark in draft.remarks)
    experiment = load_experiment(tmp_path / "lab" / "experiment.yaml")
    laboratory = Laboratory.of(experiment)
    for row in read_runs(tmp_path / "raw", experiment, laboratory.scenario):
        assert laboratory.series(row, ["position", "object_position"], ["object_position"])["arm"]["object_position"]
    (tmp_path / "raw" / "object_juice_hit_2.csv").rename(tmp_path / "raw" / "object_cup_hit_2.csv")
    strange = iiwa(tmp_path / "raw", tmp_path, scenario="push_iiwa7")
    assert any("files call the objects parcel, cup, push_iiwa7 has parcel, " in remark for remark in strange.remarks)


def in_folders(raw: Path, lab: Path, objects: dict[int, tuple[str, ...]], name: str) -> Path:
    """Runs of :func:`hits` in a folder each, with files of objects: the first moves, the others lie still."""
    for run, (hit, *still) in objects.items():
        folder = lab / f"run_{run}"
        folder.mkdir(parents=True)
        (raw / f"IIWA_7_hit_{run}.csv").rename(folder / "joints.csv")
        text = (raw / f"object_1_hit_{run}.csv").read_text()
        head, first, *rest = text.splitlines()
        rows = [f"{row.split(',')[0]},{first.split(',', 1)[1]}" for row in (first, *rest)]
        (folder / name.format(hit)).write_text(text)
        for other in still:
            (folder / name.format(other)).write_text("\n".join([head, *rows]))
    return lab


@pytest.mark.parametrize("name", ["object_{}.csv", pytest.param("{}.csv", marks=pytest.mark.slow)])
@pytest.mark.parametrize("objects", [{0: ("1",), 1: ("2",), 2: ("1",)}, {0: ("1", "2"), 1: ("2", "1"), 2: ("1", "2")}])
def test_an_object_whose_files_are_only_numbered_is_the_one_that_is_hit(
    tmp_path: Path, motion: Columns, name: str, objects: dict[int, tuple[str, ...]]
) -> None:
    """A run has the file of its object alone, or those of all objects, of which one moves."""
    raw = hits(tmp_path / "raw", motion, tuple(objects))
    lab = in_folders(raw, tmp_path / "lab", objects, name)
    draft = iiwa(lab, tmp_path, "out", scenario="push_iiwa7")
    mapping = load_mapping(described(draft, tmp_path / "out"))
    assert mapping.signals["object_position"].file == name.format("{object}")
    assert draft.texts["runs.csv"].splitlines()[1:] == ["run_0,1,hit", "run_1,2,hit", "run_2,1,hit"]
    assert not any("refuses" in remark or "not read" in remark for remark in draft.remarks)
    assert any("files call the objects 1, 2" in remark for remark in draft.remarks)


def test_robots_in_one_folder_are_imported_by_themselves(tmp_path: Path, motion: Columns) -> None:
    """Files of joints whose names differ in a word are no files of different objects."""
    hits(tmp_path / "raw", motion, (0, 1))
    (tmp_path / "raw" / "IIWA_7_hit_1.csv").rename(tmp_path / "raw" / "UR_7_hit_1.csv")
    said = refusal(iiwa, tmp_path / "raw", tmp_path)
    assert "of IIWA, UR: import the runs of each robot separately" in said
    hits(tmp_path / "alone", motion, (0,), "box")
    hits(tmp_path / "alone", motion, (1,), "cup")
    for run in (0, 1):  # no robot, but something else of every run
        (tmp_path / "alone" / f"IIWA_7_hit_{run}.csv").write_text("t,count\n0.0,1\n0.1,2\n0.2,3\n")
    said = refusal(draft_import, [tmp_path / "alone"], tmp_path / "lab", ImportOptions(robot="none"))
    assert "of box, cup: import the runs of each object separately" in said


def test_a_word_in_the_name_of_another_file_is_no_object(tmp_path: Path, motion: Columns) -> None:
    hits(tmp_path / "raw", motion, (0, 1))
    for name in ("force_left_0", "force_right_1"):
        (tmp_path / "raw" / f"{name}.csv").write_text("t,count\n0.0,1\n0.1,2\n0.2,3\n")
    draft = iiwa(tmp_path / "raw", tmp_path, scenario="push_iiwa7")
    assert draft.texts["runs.csv"].splitlines()[1:] == ["0,parcel,hit", "1,parcel,hit"]
    assert "not read, because the mapping takes no signal from them: force_{object}_{run}.csv" in draft.remarks


@pytest.mark.parametrize("pattern", ["{kind}_{run}.csv", "{run}-{kind}.csv"])
def test_words_in_names_of_files_tell_runs_apart(tmp_path: Path, motion: Columns, pattern: str) -> None:
    folder = tmp_path / "raw"
    folder.mkdir()
    for run, factor in (("empty", 1.0), ("with_load", 1.2)):
        position, torque = pattern.format(kind="arm_q", run=run), pattern.format(kind="arm_tau", run=run)
        write(folder / position, ["t", *numbered("j")], [TIME, motion["position"]])
        write(folder / torque, ["t", *numbered("j")], [TIME, factor * motion["effort"]])
    draft = iiwa(folder, tmp_path)
    assert draft.texts["runs.csv"].splitlines()[1:] == ["empty,none,free motion", "with_load,none,free motion"]
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["torque"].file == pattern.format(kind="arm_tau", run="{run}")
    (loaded,) = read_recordings(folder / "with_load", mapping)
    np.testing.assert_allclose(loaded.signals.arms["arm"].torque, 1.2 * motion["effort"], atol=1e-6)
    assert "runs that signals.NAME.file finds here: empty, with_load" in refusal(
        read_recordings, folder / "lod", mapping
    )


def test_runs_that_contradict_the_first_are_named(tmp_path: Path, motion: Columns) -> None:
    """Guesses come from one run: a sensor that was turned round later, degrees in place of radians."""
    signals = [motion["position"], motion["velocity"], motion["effort"]]
    (tmp_path / "raw").mkdir()
    write(tmp_path / "raw" / "run_1.csv", NAMES, [TIME, *signals])
    write(
        tmp_path / "raw" / "run_2.csv",
        NAMES,
        [TIME, *(np.flip(signal, axis=0) * sign for signal, sign in zip(signals, (1, -1, 1), strict=True))],
    )
    alike = iiwa(tmp_path / "raw", tmp_path, "one")
    assert said_of(alike, "runs").startswith("1 of 1 others units and signs of run_1.csv hold")
    assert not any("differs from" in remark for remark in alike.remarks)
    write(tmp_path / "raw" / "run_3.csv", NAMES, [TIME, *signals[:2], -signals[2]])
    write(tmp_path / "raw" / "run_4.csv", NAMES, [TIME, np.degrees(signals[0]), *signals[1:]])
    write(tmp_path / "raw" / "run_5.csv", NAMES, [TIME, signals[0], -signals[1], signals[2]])
    write(tmp_path / "raw" / "run_6.csv", NAMES[:8], [TIME, signals[0]])
    draft = iiwa(tmp_path / "raw", tmp_path, "two")
    said = [remark for remark in draft.remarks if "differs from run_1.csv, from which the mapping was made" in remark]
    assert [remark.split(" ")[0] for remark in said] == ["run_3.csv", "run_4.csv", "run_5.csv", "run_6.csv"]
    assert "as described its torques are -1 times the torque that gravity and inertia" in said[0]
    assert "its positions do not lie within the limits of the joints but in deg" in said[1]
    assert "the velocities are -1 times the derivative" in said[2]
    assert "the reader refuses it" in said[3] and "no column 'tau1'" in said[3]


def test_a_clock_lacks_some_stamps_or_is_named(tmp_path: Path, motion: Columns) -> None:
    """Kills: no clock because of one blank stamp, and --rate proposed for times of day, which replaces real stamps."""
    file = write(tmp_path / "a.csv", ["time", *numbered("q"), *numbered("dq"), *numbered("tau")], usual(motion))
    head, *rows = file.read_text().splitlines()
    rows[100] = "," + rows[100].split(",", 1)[1]
    file.write_text("\n".join([head, *rows]))
    draft = iiwa(file, tmp_path)
    assert any("1 of 800 samples have no time stamp: left out" in remark for remark in draft.remarks)
    assert read_recordings(file, mapping_in(draft, tmp_path / "lab"))[0].signals.arms["arm"].position.shape[0] >= 799
    file.write_text("\n".join([head, *(f"01:59:5{row}" for row in rows)]))
    said = refusal(iiwa, file, tmp_path)
    assert "'time' has '01:59:50'" in said and "in row 1, expected" in said and "--rate" not in said


def test_a_file_has_its_own_unit_of_time(tmp_path: Path, motion: Columns) -> None:
    """Kills: the unit of the main file for all files, by which torques in ms lie 1000 times later than positions."""
    (tmp_path / "run").mkdir()
    names = [f"j{joint}" for joint in range(1, 8)]
    for name, time in (("position", TIME), ("velocity", TIME), ("effort", 1e3 * TIME)):
        write(tmp_path / "run" / f"{name}.csv", ["time", *names], [time, motion[name]])
    draft = iiwa(tmp_path / "run", tmp_path)
    mapping = mapping_in(draft, tmp_path / "lab")
    assert {name: source.time_unit for name, source in mapping.signals.items()} == {
        "position": None, "velocity": None, "torque": "ms",
    }  # fmt: skip
    check_reading(draft, tmp_path / "lab", tmp_path / "run", motion)


def test_a_run_that_cannot_be_read_is_named(tmp_path: Path, motion: Columns) -> None:
    hits(tmp_path / "raw", motion, (0, 1))
    (tmp_path / "raw" / "object_1_hit_1.csv").write_text("RosTime,Position,Orientation\n1,none,0 0 0 1\n")
    draft = iiwa(tmp_path / "raw", tmp_path)
    assert draft.texts["runs.csv"].splitlines()[1:] == ["0,OBJECT,hit"]
    assert any(remark.startswith("1 is left out, because the reader refuses it: ") for remark in draft.remarks)


JOINTS = ("lift_joint", "arm_1_joint", "arm_2_joint", "elbow", "arm_4_joint", "wrist_a", "wrist_b")


def signal_files(folder: Path, motion: Columns, velocity: bool, joint: str = "{joint}") -> Path:
    """A file per signal, whose columns are called after the joints."""
    folder.mkdir()
    for signal, column in (("position", "position"), ("velocity", "velocity"), ("effort", "effort")):
        if velocity or signal != "velocity":
            names = ["t", *(joint.format(joint=name, signal=signal) for name in JOINTS)]
            write(folder / f"robot_{signal}.csv", names, [TIME, motion[column]])
    return folder


@pytest.mark.parametrize("joint", ["- {joint}_{signal}", pytest.param("{joint}", marks=pytest.mark.slow)])
def test_one_run_with_a_file_per_signal_is_read_once(tmp_path: Path, motion: Columns, joint: str) -> None:
    """Columns are named after joints; a word of the column's name, or the file's, says which signal it is."""
    folder = signal_files(tmp_path / "run", motion, True, joint)
    draft = iiwa(folder, tmp_path)
    mapping = mapping_in(draft, tmp_path / "lab")
    files = {name: source.file for name, source in mapping.signals.items()}
    assert files == {"position": "robot_position.csv", "velocity": "robot_velocity.csv", "torque": "robot_effort.csv"}
    check_reading(draft, tmp_path / "lab", folder, motion)
    for run in ("run_1", "run_2"):
        (tmp_path / "runs").mkdir(exist_ok=True)
        signal_files(tmp_path / "runs" / run, motion, True, joint)
    assert [run.name for run in read_recordings(tmp_path / "runs", mapping)] == ["run_1", "run_2"]
    (folder / "robot_effort.csv").unlink()
    assert "no run here has the files" in refusal(read_recordings, folder, mapping)


@pytest.mark.parametrize("joint", ["{joint}", pytest.param("{signal}_{joint}", marks=pytest.mark.slow)])
def test_velocities_that_were_not_recorded_are_made_of_the_positions(
    tmp_path: Path, motion: Columns, joint: str
) -> None:
    folder = signal_files(tmp_path / "run", motion, False, joint)
    draft = iiwa(folder, tmp_path)
    assert said_of(draft, "signals.velocity").startswith("none no signal is the derivative of the positions")
    mapping = mapping_in(draft, tmp_path / "lab")
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
    said = refusal(draft_import, [file], tmp_path / "lab", ImportOptions(robot="kuka_iiwa7", rate=400.0))
    assert "b1 … b7 is 0.25 times the derivative of a1 … a7 in all joints" in said
    assert "velocity in rad/s at 100 Hz" in said and "--rate" in said


def test_positions_are_not_taken_for_velocities_that_do_not_fit(tmp_path: Path, motion: Columns) -> None:
    """A signal that is called a velocity and is none: nothing is made of it, or without it."""
    file = write(tmp_path / "log.csv", NAMES, [TIME, motion["position"], motion["velocity"] ** 2, motion["effort"]])
    assert "no two signals of 7 joints" in refusal(iiwa, file, tmp_path)


def test_joints_that_show_nothing_keep_their_sign_where_the_others_contradict_each_other(
    tmp_path: Path, motion: Columns
) -> None:
    """Two joints carry weight, one of them with the other sign; a torque times 0 would be none."""
    weights = np.abs(motion["effort"]).mean(axis=0)
    heavy = np.argsort(weights)[-2:]
    effort = np.random.default_rng(1).standard_normal(motion["effort"].shape)
    effort[:, heavy] = motion["effort"][:, heavy] * [1.0, -1.0]
    file = write(tmp_path / "log.csv", NAMES, [TIME, motion["position"], motion["velocity"], effort])
    draft = iiwa(file, tmp_path)
    factor = np.array(mapping_in(draft, tmp_path / "lab").signals["torque"].factor)
    assert set(np.abs(factor)) == {1.0} and factor[heavy].tolist() == [1.0, -1.0]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("last", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_poses_of_an_archive_are_homogeneous_matrices(tmp_path: Path, last: bool, turned: bool) -> None:
    """Recordings of a box and a tool without stamps, in HDF5: samples first or last, a matrix as it is or turned."""
    import pinocchio as pin

    turns = np.array([pin.rpy.rpyToMatrix(0.3 * t, -0.2 * t, 2.5) for t in TIME])
    matrices = np.tile(np.eye(4), (TIME.size, 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = turns, np.outer(np.sin(TIME), [0.1, 0.2, 0.3])
    stored = np.swapaxes(matrices, 1, 2) if turned else matrices
    stored = np.moveaxis(stored, 0, 2) if last else stored
    file = tmp_path / "archive.h5"
    with pytest.importorskip("h5py").File(file, "w") as archive:
        for run in (1, 2):
            for body in ("Box007", "Gripper"):
                archive[f"Rec_{run:03d}/Mocap/{body}/transforms"] = stored
    draft = draft_import([file], tmp_path / "lab", ImportOptions(robot="none", rate=360.0))
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["object_pose"].array == "{run}/Mocap/Box007/transforms"
    assert "holds homogeneous matrices" in said_of(draft, "signals.object_pose")
    assert any("other poses, which are not used: {run}/Mocap/Gripper/transforms" in one for one in draft.remarks)
    read = read_series(file / "Rec_002", mapping, ["object_pose"], ["object_pose"])["object_pose"]
    np.testing.assert_allclose(read.time, np.arange(TIME.size) / 360.0)
    for pose, matrix in zip(read.values[::50], matrices[::50], strict=True):
        np.testing.assert_allclose(pin.XYZQUATToSE3(pose).homogeneous, matrix, atol=1e-12)


BODIES = {"marker": np.array([0.3, 0.0, 0.1]), "body": np.array([0.5, 0.2, 0.4])}  # m, where each is at first


def tracked(file: Path, names: dict[str, str]) -> Path:
    """Positions of two bodies, and the quaternion of the second, as arrays or as columns x, y, z (, w).

    Args:
        file: What is written, ``.npz`` or ``.csv``.
        names: What ``marker``, ``body`` and ``turn`` are called.
    """
    import pinocchio as pin

    turn = np.array([pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, 0.2 * t)).coeffs() for t in TIME])
    moved = {body: place + np.outer(np.sin(TIME), [0.1, 0.0, 0.0]) for body, place in BODIES.items()}
    signals = {names["marker"]: moved["marker"], names["body"]: moved["body"], names["turn"]: turn}
    if file.suffix == ".npz":
        np.savez(file, time=TIME, **signals)
        return file
    heads = [f"{name}{axis}" for name, one in signals.items() for axis in "xyzw"[: one.shape[1]]]
    return write(file, ["time", *heads], [TIME, *signals.values()])


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("a.npz", {"marker": "marker_pos_xyz", "body": "body_pos_xyz", "turn": "body_rot_xyzw"}),
        ("b.npz", {"marker": "target/position", "body": "box7/position", "turn": "box7/orientation"}),
        ("c.npz", {"marker": "markerPosition", "body": "boxPosition", "turn": "boxQuaternion"}),
        ("d.csv", {"marker": "marker_", "body": "box_pos_", "turn": "box_rot_"}),
    ],
)
def test_a_position_goes_with_the_quaternion_of_the_same_body(file: str, names: dict[str, str], tmp_path: Path) -> None:
    draft = draft_import([tracked(tmp_path / file, names)], tmp_path / "lab", ImportOptions(robot="none"))
    mapping = mapping_in(draft, tmp_path / "lab")
    read = read_series(tmp_path / file, mapping, ["object_position"], ["object_position"])["object_position"]
    np.testing.assert_allclose(read.values[0, :3], BODIES["body"], atol=1e-9)
    lines = {line.key: line for line in draft.lines}
    assert "order alone" not in lines["signals.object_position"].evidence and lines["signals.object_position"].sure


def test_a_position_that_no_name_pairs_with_a_quaternion_is_assumed(tmp_path: Path) -> None:
    file = tracked(tmp_path / "a.npz", {"marker": "first", "body": "second", "turn": "third"})
    draft = draft_import([file], tmp_path / "lab", ImportOptions(robot="none"))
    line = next(line for line in draft.lines if line.key == "signals.object_position")
    assert not line.sure and "by order alone" in line.evidence


def test_matrices_that_are_no_rigid_motion_are_refused(tmp_path: Path) -> None:
    mapping = Mapping.model_validate(
        {
            "description": "",
            "robot": "none",
            "time": {"rate": 100.0},
            "signals": {"object_pose": {"array": "T", "unit": "m"}},
        }
    )
    for number, scale in enumerate((1.5, -1.0)):  # stretched, and a mirror
        np.savez(tmp_path / f"{number}.npz", T=np.tile(np.diag([scale, 1.0, 1.0, 1.0]), (20, 1, 1)))
        said = refusal(read_series, tmp_path / f"{number}.npz", mapping, ["object_pose"], ["object_pose"])
        assert "expected homogeneous transforms, with the last row 0 0 0 1" in said


def test_an_object_alone_needs_no_robot(tmp_path: Path) -> None:
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (TIME.size, 1))
    names = ["time", "pos_x", "pos_y", "pos_z", "quat_w", "quat_x", "quat_y", "quat_z"]
    file = write(tmp_path / "toss_1.csv", names, [TIME, 1e3 * np.outer(np.sin(TIME), [0.1, 0.2, 0.3]), turn])
    draft = draft_import([file], tmp_path / "lab", ImportOptions(robot="none"))
    mapping = mapping_in(draft, tmp_path / "lab")
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
        ("a;b\n1,5;2\n3,5;4\n5,5;6\n", None, None),
        ("a,b;c\n1,2,3;4,5,6\n1,2,3;4,5,6\n1,2,3;4,5,6\n", 0, 2),
    ],
)
def test_where_a_table_begins_is_found_from_its_lines(
    tmp_path: Path, text: str, header: int | None, first: int | None
) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = find_layout(tmp_path / "a.csv").value
    assert (found.header, found.first) == (header, first)


def test_files_are_grouped_by_what_differs_in_their_names(tmp_path: Path) -> None:
    def groups(*names: str) -> tuple[list[str], tuple[str, ...], bool]:
        found = group_files([tmp_path / name for name in names])
        return sorted(found.kinds), found.runs, found.several_files

    assert groups("hit_2.csv", "hit_10.csv") == ([""], ("hit_2.csv", "hit_10.csv"), False)
    two = groups("IIWA_7_hit_2.csv", "IIWA_7_hit_10.csv", "object_1_hit_2.csv", "object_1_hit_10.csv")
    assert two == (["IIWA_7_hit_{run}.csv", "object_1_hit_{run}.csv"], ("2", "10"), True)
    assert groups("hit_3-IIWA_7.csv", "hit_4-IIWA_7.csv", "hit_3-box.csv", "hit_4-box.csv")[0] == [
        "hit_{run}-IIWA_7.csv", "hit_{run}-box.csv",
    ]  # fmt: skip
    folders = groups("a/pose.csv", "a/joints.csv", "b/pose.csv", "b/joints.csv")
    assert folders == (["joints.csv", "pose.csv"], ("a", "b"), True)
    nested = groups(*(f"{day}/run_{run}/{file}.csv" for day in "ab" for run in (1, 2) for file in ("arm", "box")))
    assert nested == (["arm.csv", "box.csv"], ("a/run_1", "a/run_2", "b/run_1", "b/run_2"), True)
    several = groups(
        *(f"{file}_day_{day}_hit_{run}.csv" for file in ("arm", "box") for day in (1, 2) for run in (0, 1))
    )
    assert several[0] == ["arm_day_{run}.csv", "box_day_{run}.csv"]
    assert several[1] == ("1_hit_0", "1_hit_1", "2_hit_0", "2_hit_1")
    words = groups("arm_hit_1.csv", "arm_hit_2.csv", "box_hit_1.csv", "cup_hit_2.csv")
    assert words[0] == ["arm_hit_{run}.csv", "{object}_hit_{run}.csv"]
    boxes = ("box_1_hit_1.csv", "box_1_hit_2.csv", "box_2_hit_2.csv", "box_2_hit_3.csv")  # both are in run 2
    two = groups("arm_hit_1.csv", "arm_hit_2.csv", "arm_hit_3.csv", *boxes)
    assert two[0] == ["arm_hit_{run}.csv", "box_1_hit_{run}.csv", "box_2_hit_{run}.csv"]


def test_files_with_the_same_columns_are_runs_whatever_their_names(tmp_path: Path, motion: Columns) -> None:
    """Kills: only one run described; files of signals, or of several objects, taken for runs."""
    (tmp_path / "raw").mkdir()
    parts = [TIME, motion["position"], motion["velocity"], motion["effort"]]
    for name, rows in (("calm", 800), ("wild", 700), ("sac", 750)):
        write(tmp_path / "raw" / f"{name}.csv", NAMES, [part[:rows] for part in parts])
    draft = iiwa(tmp_path / "raw", tmp_path)
    assert draft.texts["runs.csv"].splitlines()[1:] == [
        f"{name}.csv,none,free motion" for name in ("calm", "sac", "wild")
    ]
    assert "file" not in mapping_in(draft, tmp_path / "lab").signals["position"].model_fields_set
    assert any("hold the same columns: each is taken for a run" in remark for remark in draft.remarks)
    assert len(read_recordings(tmp_path / "raw", mapping_in(draft, tmp_path / "lab"))) == 3


@pytest.mark.parametrize(
    ("names", "columns", "bodies", "whole"),
    [
        (("a.csv", "b.csv"), "t q1 dq1", False, True),
        (("a.csv", "b.csv"), "t x y", True, True),
        (("a.csv", "b.csv"), "t x y", False, False),  # poses of two objects beside a robot
        (("a.csv", "b.csv"), "t q1", True, False),  # joints of two arms, or of one in two files
        (("q.csv", "tau.csv"), "t q1 dq1", True, False),
        (("a_1.csv", "b_1.csv"), "t q1 dq1", True, True),
        (("fast_1.csv", "fast_2.csv", "fast_3.csv", "slow_1.csv", "slow_2.csv"), "t q1 dq1", False, True),
        (("mon/fast.csv", "mon/slow.csv", "tue/fast.csv", "tue/slow.csv"), "t q1 dq1", False, True),
        (("q_1.csv", "q_2.csv", "tau_1.csv", "tau_2.csv"), "t j1 j2", True, False),
        (("measured_1.csv", "measured_2.csv", "desired_1.csv", "desired_2.csv"), "t q1 dq1", False, False),
        (("a.csv", "b.csv"), "", True, False),
    ],
)
def test_whole_runs_have_positions_and_another_signal_in_every_file(
    names: tuple[str, ...], columns: str, bodies: bool, whole: bool, tmp_path: Path
) -> None:
    """Kills: files that share the columns but not the word of their names left out, where numbers recur."""
    found = whole_runs(group_files([tmp_path / name for name in names]), lambda _: frozenset(columns.split()), bodies)
    assert (found is not None) == whole
    if found is not None:
        assert (found.runs, found.several_files) == (names, False)


def test_bodies_that_were_tracked_one_by_one_are_runs(tmp_path: Path) -> None:
    """Columns may stand in another order in each file."""
    time = np.arange(0.0, 0.4, 0.01)
    height = 1.0 - 0.5 * 9.81 * time**2
    write(tmp_path / "black.txt", ["t", "x", "y"], [time, 0.0 * time, height], separator="\t")
    write(tmp_path / "red.txt", ["t", "y", "x"], [time, height, 0.0 * time], separator="\t")
    draft = draft_import([tmp_path], tmp_path / "lab", ImportOptions(robot="none"))
    assert [line.split(",")[0] for line in draft.texts["runs.csv"].splitlines()[1:]] == ["black.txt", "red.txt"]


def test_a_file_beside_those_of_the_mapping_is_not_read_as_one_of_them(tmp_path: Path, motion: Columns) -> None:
    parts = dict(zip(("q", "dq", "tau"), (motion["position"], motion["velocity"], motion["effort"]), strict=True))
    for name, part in parts.items():
        write(tmp_path / f"{name}.csv", ["t", *numbered("j")], [TIME, part])
    mapping = mapping_in(iiwa(tmp_path, tmp_path), tmp_path / "lab")
    assert len(read_recordings(tmp_path, mapping)) == 1
    other = write(tmp_path / "other.csv", ["t", *numbered("j")], [TIME, motion["position"]])
    said = refusal(read_series, other, mapping, ["position"], ["position"])
    assert "takes its signals from dq.csv, q.csv, tau.csv in this folder and none from this file" in said


def test_folders_are_sessions_where_they_hold_several_runs(tmp_path: Path) -> None:
    def sessions(*names: str) -> dict[str, str]:
        return group_files([tmp_path / name for name in names]).sessions

    assert sessions("a/log.csv", "b/log.csv") == {}
    assert sessions("a/run_1.csv", "a/run_2.csv") == {}
    assert sessions("a/run_1.csv", "b/run_1.csv", "b/run_2.csv") == {
        "a/run_1.csv": "a", "b/run_1.csv": "b", "b/run_2.csv": "b",
    }  # fmt: skip


def test_a_bag_with_the_pose_of_an_object_is_a_hit_and_one_without_is_free_motion(
    tmp_path: Path, hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    kept = {topics.joint_states("arm"), topics.OBJECT_POSE}
    hit = next((hidden_campaign / "push").glob("parcel*"))
    rewrite_bag(hit, tmp_path / "raw" / "run_1", kept.__contains__)
    rewrite_bag(hit, tmp_path / "raw" / "run_2", (kept - {topics.OBJECT_POSE}).__contains__)
    draft = draft_import([tmp_path / "raw"], tmp_path / "lab", ImportOptions(robot="franka_fer", scenario="push"))
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["object_pose"].topic == topics.OBJECT_POSE
    assert draft.texts["runs.csv"].splitlines()[1:] == ["run_1,parcel,hit", "run_2,none,free motion"]
    assert not any("refuses" in remark for remark in draft.remarks)


BAG_TIME = np.arange(0.0, 4.0, 0.004)
LATE = 0.15e-3  # s, by which commands are logged after the joint states that they answer


def bag_of(
    path: Path, topics_of: dict[str, Callable[[int], object]], late: dict[str, float], store: Typestore | None = None
) -> Path:
    """A bag with one message a topic and row; all are logged 2 ms after their stamps, some later."""
    store = store or typestore()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {topic: make(0).__msgtype__ for topic, make in topics_of.items()}
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for row, time in enumerate(BAG_TIME):
            for topic, make in topics_of.items():
                data = store.serialize_cdr(make(row), kinds[topic])
                writer.write(connections[topic], round(1e9 * (1e9 + time + 0.002 + late.get(topic, 0.0))), data)
    return path


def numbers(values: np.ndarray) -> Callable[[int], object]:
    """Messages without a header."""
    return lambda row: message("std_msgs/msg/Float64MultiArray", {"data": values[row]})


def states(**values: np.ndarray) -> Callable[[int], object]:
    """Messages with stamps and names."""
    names = [f"fer_joint{joint}" for joint in range(1, 8)]

    def make(row: int) -> object:
        stamp = divmod(round(1e9 * (1e9 + BAG_TIME[row])), 10**9)
        own = {name: rows[row] for name, rows in values.items()}
        return message("sensor_msgs/msg/JointState", {"header.stamp": stamp, "name": names, **own})

    return make


@pytest.fixture(scope="module")
def fer() -> Columns:
    """A FER that swings about a bent pose, with the weight of its links."""
    import pinocchio as pin

    model = RobotModel(load_facts("franka_fer"), MountedEndEffector().build(), pin.SE3.Identity())
    frequencies = (np.linspace(0.31, 0.53, 7), np.linspace(0.71, 0.97, 7))
    own = swinging(model, BAG_TIME, np.array([0.1, -0.3, 0.2, -1.9, 0.3, 1.6, 0.1]), frequencies, (0.2, 0.05))
    return own | {"weight": np.array([model.gravity_torque(q) for q in own["position"]])}


def import_fer(path: Path, folder: Path) -> ImportDraft:
    return draft_import([path], folder, ImportOptions(robot="franka_fer"))


@pytest.mark.parametrize("included", [True, False])
def test_a_commanded_torque_without_stamps_is_taken_with_the_times_of_the_bag(
    tmp_path: Path, fer: Columns, included: bool
) -> None:
    command = 1.02 * fer["effort"] - (0.0 if included else fer["weight"])
    bag = bag_of(
        tmp_path / "run_1",
        {
            "/joint_states": states(position=fer["position"], velocity=fer["velocity"], effort=fer["effort"]),
            "/effort_controller/commands": numbers(command),
        },
        {"/effort_controller/commands": LATE},
    )
    draft = import_fer(bag, tmp_path / "lab")
    mapping = mapping_in(draft, tmp_path / "lab")
    assert mapping.signals["command"].topic == "/effort_controller/commands"
    assert mapping.command_includes_gravity == included
    assert mapping.signals["torque"].field == "effort" and mapping.time.stamp == "header"
    assert "no header: times at which the bag received them" in said_of(draft, "signals.command")
    assert "2 % of the measured torque away" in said_of(draft, "signals.command.unit") or not included
    (run,) = read_recordings(bag, mapping)
    arm = run.signals.arms["arm"]
    later = np.column_stack([np.interp(BAG_TIME - LATE, BAG_TIME, column) for column in command.T])
    assert arm.command is not None
    np.testing.assert_allclose(arm.command, later, atol=1e-4)


STATE = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint {asked}
trajectory_msgs/JointTrajectoryPoint {seen}
trajectory_msgs/JointTrajectoryPoint error
"""


@pytest.mark.parametrize(("asked", "seen"), [("desired", "actual"), ("reference", "feedback")], ids=["ROS 1", "ROS 2"])
def test_fields_of_a_trajectory_controller_are_what_their_definition_says(
    asked: str, seen: str, tmp_path: Path, fer: Columns
) -> None:
    """Planned velocities and accelerations have no noise and fit each other better than what was measured.

    Kills fields without a meaning, joint names that are not found, and a search for servos that forgets the pair that a
    motion leaves over.
    """
    kind, store = "control_msgs/msg/JointTrajectoryControllerState", get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(STATE.format(asked=asked, seen=seen), kind))
    rng, kp = np.random.default_rng(0), np.array([900.0, 900.0, 700.0, 600.0, 200.0, 200.0, 100.0])
    wanted = [fer["position"] + fer["effort"] / kp]
    wanted += [np.gradient(wanted[-1], BAG_TIME, axis=0)]
    wanted += [np.gradient(wanted[-1], BAG_TIME, axis=0)]
    measured = [fer["position"] + rng.normal(0.0, 1e-4, wanted[0].shape), fer["velocity"]]
    measured[1] = measured[1] + rng.normal(0.0, 0.02, wanted[0].shape)
    order = [3, 1, 2, 7, 5, 6, 4]  # as controllers list them

    def state(row: int) -> object:
        content: dict[str, object] = {
            "header.stamp": divmod(round(1e9 * (1e9 + BAG_TIME[row])), 10**9),
            "joint_names": [f"fer_joint{joint}" for joint in order],
        }
        columns = np.array(order) - 1
        for name, signal in zip(("positions", "velocities", "accelerations"), wanted, strict=True):
            content[f"{asked}.{name}"] = signal[row][columns]
        for name, signal, target in zip(("positions", "velocities"), measured, wanted[:2], strict=True):
            content[f"{seen}.{name}"] = signal[row][columns]
            content[f"error.{name}"] = (target - signal)[row][columns]
        return message(kind, content, store)

    bag = bag_of(tmp_path / "run_1", {"/arm/state": state}, {}, store)
    defined = {one.source["field"]: one.guess for one in candidates_of(bag) if one.defined}
    assert defined[f"{asked}.velocities"] == "velocity" and defined[f"{asked}.accelerations"] == "acceleration"
    draft = import_fer(bag, tmp_path / "lab")
    mapping = mapping_in(draft, tmp_path / "lab")
    fields = {name: source.field for name, source in mapping.signals.items()}
    assert fields == {
        "position": f"{seen}.positions", "velocity": f"{seen}.velocities", "q_desired": f"{asked}.positions",
    }  # fmt: skip
    assert mapping.signals["position"].names == "joint_names"
    assert mapping.joints == tuple(f"fer_joint{joint}" for joint in range(1, 8))


def test_commands_that_are_no_torques_are_left_out_with_the_reason(tmp_path: Path, fer: Columns) -> None:
    measured = states(position=fer["position"], velocity=fer["velocity"], effort=fer["effort"])
    late = np.roll(fer["position"], 5, axis=0)
    for name, command, told in (
        ("places", late, "is left out: it repeats the positions"),
        ("others", 3.0 * fer["effort"], "is left out: by its name it was commanded, and it is 200 % of the measured"),
    ):
        bag = bag_of(tmp_path / name, {"/joint_states": measured, "/controller/commands": numbers(command)}, {})
        draft = import_fer(bag, tmp_path / "lab")
        assert "command" not in mapping_in(draft, tmp_path / "lab").signals
        assert any(remark.startswith(f"/controller/commands: data (7) {told}") for remark in draft.remarks)


def test_torques_or_all_signals_without_stamps_are_read(tmp_path: Path, fer: Columns) -> None:
    """Efforts of another topic are put on the stamps; where no signal has any, all have the times of the bag."""
    measured = states(position=fer["position"], velocity=fer["velocity"])
    bag = bag_of(tmp_path / "some", {"/joint_states": measured, "/efforts": numbers(fer["effort"])}, {})
    draft = import_fer(bag, tmp_path / "lab")
    assert "no header" in said_of(draft, "signals.torque")
    check_reading(draft, tmp_path / "lab", bag, fer, 1e-4)  # stamps of this century are floats to 0.2 us
    own = {f"/{name}": numbers(fer[name]) for name in ("position", "velocity", "effort")}
    bag = bag_of(tmp_path / "none", own, {})
    draft = import_fer(bag, tmp_path / "lab")
    assert "stamp: log" in said_of(draft, "time") and "no header" in said_of(draft, "time")
    check_reading(draft, tmp_path / "lab", bag, fer, 1e-4)  # stamps of this century are floats to 0.2 us


def test_a_log_of_rtde_is_read_by_its_own_names(tmp_path: Path, motion: Columns) -> None:
    """As its recorder writes it: spaces, joints from 0 on, targets and currents beside what was measured."""
    zero = {stem: numbered(f"{stem}_", 0) for stem in ("target_q", "actual_q", "actual_qd", "actual_current")}
    names = ["timestamp", *(name for group in zero.values() for name in group)]
    late = np.roll(motion["position"], -8, axis=0)
    columns = [7000.0 + TIME, late, motion["position"], motion["velocity"], motion["effort"] / 9.0]
    draft = iiwa(write(tmp_path / "rtde.csv", names, columns, separator=" "), tmp_path)
    signals = mapping_in(draft, tmp_path / "lab").signals
    assert said_of(draft, "signals.position").startswith("actual_q_0")
    assert said_of(draft, "signals.velocity").startswith("actual_qd_0")
    assert said_of(draft, "signals.torque.unit").startswith("A ") and "torque" in signals


def test_a_log_of_fri_takes_the_torque_that_was_measured(tmp_path: Path, motion: Columns) -> None:
    """Positions without velocities; the external torque beside the measured one is a small part of it."""
    names = ["time", *numbered("MeasuredJointPosition"), *numbered("MeasuredTorque"), *numbered("ExternalTorque")]
    columns = [TIME, motion["position"], motion["effort"], 0.1 * motion["effort"]]
    draft = iiwa(write(tmp_path / "fri.csv", names, columns), tmp_path)
    assert said_of(draft, "signals.torque").startswith("MeasuredTorque1")
    (run,) = read_recordings(tmp_path / "fri.csv", mapping_in(draft, tmp_path / "lab"))
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)


@pytest.mark.parametrize(
    ("run", "name"),
    [("lab/box_large_hit_1.csv", "box_large"), ("toolbox/hit_1.csv", ""), ("lab/box/1.csv", "box"), ("a/Box1", "")],
)
def test_the_object_of_a_run_is_the_longest_name_of_whole_words(run: str, name: str) -> None:
    """Kills: the first name that occurs anywhere in the path, as box in toolbox or box_large."""
    assert _object_in(run, ["box", "box_large"]) == name
