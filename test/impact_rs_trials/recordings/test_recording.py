# SPDX-License-Identifier: Apache-2.0
"""Recordings of others are read into SI units, joint by joint, or refused with the place."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from builders import mapping_of, read_positions
from hypothesis import given
from hypothesis import strategies as st
from joint_recordings import Columns, write_bag, write_csv, write_npz, write_ros1_bag
from mcap.writer import Writer as McapWriter
from refusals import refusal
from ros_messages import message
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.importing.candidates import candidates_of
from impact_rs_trials.recordings.mapping import Mapping, TimeSource, load_mapping
from impact_rs_trials.recordings.readers.run_finder import find_recordings, natural_key
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.recording import ARM, is_foreign, read_recordings
from impact_rs_trials.recordings.remarks import Amount, Remark, joined, merged
from impact_rs_trials.runs import Run

PLAIN = load_mapping("joint_state")
TIME = np.arange(400) * 0.01  # s
PHASE = np.arange(7)
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
POSITION = CENTRE + 0.3 * np.sin(2.0 * TIME[:, None] + PHASE)
VELOCITY = 0.6 * np.cos(2.0 * TIME[:, None] + PHASE)
TORQUE = 3.0 * np.sin(TIME[:, None] + PHASE)
COLUMNS = {"time": TIME, "position": POSITION, "velocity": VELOCITY, "effort": TORQUE}
DEGREES = 180.0 / np.pi


def read_recording(path: Path, mapping: Mapping = PLAIN) -> Run:
    """The one piece that a file without faults has."""
    (whole,) = read_recordings(path, mapping)
    return whole


def assert_read(run: Run) -> None:
    np.testing.assert_allclose(run.signals.time, TIME, atol=1e-9)
    arm = run.signals.arms[ARM]
    assert arm.measured == ("position", "velocity", "torque")
    for name, values in (("position", POSITION), ("velocity", VELOCITY), ("torque", TORQUE)):
        np.testing.assert_allclose(getattr(arm, name), values, atol=1e-12)


def test_bag_table_and_arrays_are_read_alike(tmp_path: Path) -> None:
    assert_read(read_recording(write_npz(tmp_path / "a.npz", COLUMNS)))
    assert_read(read_recording(write_csv(tmp_path / "a.csv", COLUMNS)))
    assert_read(read_recording(write_bag(tmp_path / "bag", COLUMNS, [6, 0, 2, 1, 3, 5, 4])))  # ordered by their names


def test_a_bag_of_ros_1_is_read_as_one_of_ros_2_is(tmp_path: Path) -> None:
    """Kills messages that are taken for those of ROS 2: the header of ROS 1 has a field before the stamp."""
    path = write_ros1_bag(tmp_path / "run.bag", COLUMNS, [6, 0, 2, 1, 3, 5, 4])
    assert is_foreign(path) and find_recordings(tmp_path) == [path]
    assert_read(read_recording(path))
    (tmp_path / "cut.bag").write_bytes(path.read_bytes()[:5000])
    assert "not a readable bag" in refusal(read_recordings, tmp_path / "cut.bag", PLAIN)


def test_two_nodes_of_ros_1_publish_one_topic(tmp_path: Path) -> None:
    """Kills: `len(matches) > 1` as the sign of several topics; in bags of ROS 1 every publisher is a connection."""
    run = read_recording(write_ros1_bag(tmp_path / "run.bag", COLUMNS, range(7), gripper="finger"))
    assert_read(run)
    assert not [remark for remark in run.remarks if "counted in the bag's metadata" in remark]


def test_a_folder_whose_file_is_not_of_ros_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """Kills the words of a library, which name a profile and no remedy."""
    bag = write_bag(tmp_path / "bag", COLUMNS, range(7))
    (path,) = bag.glob("*.mcap")
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="")
        writer.finish()
    for read in (lambda: read_recordings(bag, PLAIN), lambda: candidates_of(bag)):
        said = refusal(read)
        assert "Profile" not in said and "JSON or Protobuf" in said and "give the .mcap file itself" in said


@pytest.mark.parametrize("kind", ["geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Pose"])
def test_a_bag_of_poses_beside_a_table_of_joints_is_read(tmp_path: Path, kind: str) -> None:
    """Kills: the delay of joint states that lie in another file, for which the poses were missing without a word."""
    write_csv(tmp_path / "joints.csv", COLUMNS)
    store, field = typestore(), "pose." if kind.endswith("Stamped") else ""
    with Writer(tmp_path / "poses", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/pose", kind, typestore=store)
        for time in TIME:
            stamp = {"header.stamp": divmod(round(1e9 * time), 10**9)} if field else {}
            pose = message(kind, {f"{field}position": (time, 0.0, 0.0), f"{field}orientation": (0, 0, 0, 1), **stamp})
            writer.write(connection, round(1e9 * time), store.serialize_cdr(pose, kind))
    content = PLAIN.model_dump()
    signals = {name: {**source, "file": "joints.csv"} for name, source in content["signals"].items()}
    signals["object_pose"] = {"topic": "/pose", "unit": "m", "file": "poses"}
    series = read_series(tmp_path, Mapping.model_validate({**content, "signals": signals}), signals, ["position"])
    np.testing.assert_allclose(series["object_pose"].time, TIME, atol=1e-9)
    np.testing.assert_allclose(series["object_pose"].values[:, 0], TIME, atol=1e-9)


@pytest.mark.parametrize(("stamp", "start"), [("header", 5.0), ("log", 0.0)])
def test_time_is_that_of_the_header_or_of_the_log_as_the_mapping_says(tmp_path: Path, stamp: str, start: float) -> None:
    bag = write_bag(tmp_path / "bag", COLUMNS, range(7), behind=5.0)
    found = read_recording(bag, PLAIN.model_copy(update={"time": TimeSource(stamp=stamp)}))
    assert found.signals.time[0] == pytest.approx(start, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"position": np.where(PHASE == 2, np.nan, POSITION)}, "position of joint 3 is not a number at t = 0.000 s"),
        ({"effort": np.where(PHASE == 2, np.nan, TORQUE)}, "torque of joint 3 is not a number at t = 0.000 s"),
        ({"position": DEGREES * POSITION}, "wrong unit (now rad)"),
        ({"velocity": -VELOCITY}, "velocity is -1 times the derivative of position, expected 1"),
        ({"velocity": 0.3 * VELOCITY}, "times the derivative of position, expected 1"),
        ({"velocity": DEGREES * VELOCITY}, "wrong unit"),
        ({"effort": 1e3 * TORQUE}, "torque of joint"),
        ({"effort": TORQUE[:, :6]}, "expected 400 samples x 7 joints"),
        ({"time": TIME[::-1]}, "run backwards"),
        ({"time": TIME - 0.5 * (np.arange(400) // 30)}, "time stamps run backwards"),
        ({"time": np.full(400, 1.0)}, "stand still"),
        ({name: values[:50] for name, values in COLUMNS.items()}, "50 samples, at least 100 are needed"),
    ],
)
def test_impossible_measurements_are_refused_with_the_place(tmp_path: Path, changes: dict, complaint: str) -> None:
    path = write_npz(tmp_path / "a.npz", COLUMNS | changes)
    with pytest.raises(InputError, match=str(path)) as caught:
        read_recording(path)
    assert complaint in str(caught.value)


def test_folders_files_and_strangers_are_told_apart(tmp_path: Path) -> None:
    write_bag(tmp_path / "one", COLUMNS, range(7))
    write_npz(tmp_path / "two.npz", COLUMNS)
    assert find_recordings(tmp_path) == [tmp_path / "one", tmp_path / "two.npz"]
    assert is_foreign(tmp_path)
    (tmp_path / "notes.md").write_text("no recording")
    (tmp_path / "notes.txt").write_text("no recording, and not looked for")
    for name, complaint in (("notes.md", "expected a recording"), ("three", "no such file")):
        with pytest.raises(InputError, match=complaint):
            find_recordings(tmp_path / name)


def test_a_table_of_runs_is_no_recording_and_notes_are_some_only_where_nothing_else_is(tmp_path: Path) -> None:
    """Kills a walk that reads ``runs.csv`` as a table of signals, or a README beside bags as a recording."""
    (tmp_path / "runs.csv").write_text("bag,object,kind\none,none,free motion\n")
    (tmp_path / "readme.txt").write_text("how it was recorded")
    with pytest.raises(InputError, match="no recording here"):
        find_recordings(tmp_path)
    assert find_recordings(tmp_path, notes=True) == [tmp_path / "readme.txt"]
    write_bag(tmp_path / "one", COLUMNS, range(7))
    assert find_recordings(tmp_path) == find_recordings(tmp_path, notes=True) == [tmp_path / "one"]


def test_hidden_files_and_folders_are_no_recordings(tmp_path: Path) -> None:
    """Kills: `path.rglob("*")` unfiltered, which counts a checkpoint of an editor as a run of its own."""
    folder = tmp_path / ".data"  # named by the user: what is hidden counts below it
    for name in ("hit.csv", "._hit.csv", ".ipynb_checkpoints/hit-checkpoint.csv", ".half/metadata.yaml"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")
    assert find_recordings(folder) == [folder / "hit.csv"]


def test_a_run_is_read_from_the_one_file_of_its_folder_that_is_not_hidden(tmp_path: Path) -> None:
    """Kills: `path.iterdir()` unfiltered in the search for the file of a run."""
    write_csv(tmp_path / "log.csv", COLUMNS)
    (tmp_path / "._log.csv").write_bytes(bytes(100))
    assert read_series(tmp_path, PLAIN, ["position"], ["position"])["position"].time.size == TIME.size


def test_natural_order_counts_numbers_in_names() -> None:
    """Kills the order of letters, in which run 10 comes before run 9."""
    assert sorted(["run_10", "run_9", "a_2/run_1", "run"], key=natural_key) == ["a_2/run_1", "run", "run_9", "run_10"]


# ---- bags of which a part is missing say so, and messages without joint names are read by the place of --------------


STAMPS = np.round(0.01 * np.arange(200), 6)
MOTION: Columns = {
    "time": STAMPS,
    "position": np.sin(np.outer(STAMPS, np.arange(1.0, 8.0))),
    "velocity": np.zeros((200, 7)),
    "effort": np.zeros((200, 7)),
}
ARRAY = "std_msgs/msg/Float64MultiArray"


def part_of(motion: Columns, first: int, last: int) -> Columns:
    return {name: values[first:last] for name, values in motion.items()}


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_that_the_metadata_count_and_the_file_lacks_are_said(tmp_path: Path, storage: StoragePlugin) -> None:
    """A file with 150 of 200 messages in the place of the whole one."""
    whole = write_bag(tmp_path / "bag", MOTION, range(7), storage)
    assert read_positions(whole).remarks == ()
    less = write_bag(tmp_path / "less" / "bag", part_of(MOTION, 0, 150), range(7), storage)
    (file,) = (one for one in less.iterdir() if one.name != "metadata.yaml")
    file.replace(whole / file.name)
    found = read_positions(whole)
    assert found.time.size == 150
    assert "/arm/joint_states: 150 messages, 200 are counted in the bag's metadata" in found.remarks[0]


def test_a_second_file_of_messages_that_the_metadata_do_not_name_is_said(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", part_of(MOTION, 0, 100), range(7))
    second = write_bag(tmp_path / "second", part_of(MOTION, 100, 200), range(7))
    (second / "second.mcap").replace(bag / "bag_1.mcap")
    assert read_positions(bag).remarks == ("not read, for metadata.yaml does not name them: bag_1.mcap",)


@pytest.mark.parametrize("bare", [True, False])
def test_a_database_that_was_cut_off_is_refused(tmp_path: Path, bare: bool) -> None:
    """SQLite itself reads what is left of its pages."""
    bag = write_bag(tmp_path / "bag", MOTION, range(7), StoragePlugin.SQLITE3)
    file = bag / "bag.db3"
    assert read_positions(file if bare else bag).time.size == 200
    content = file.read_bytes()
    file.write_bytes(content[:-100])
    said = refusal(lambda: read_positions(file if bare else bag))
    assert f"cut off: {len(content) - 100} bytes are left of {len(content)}" in said


def array_mapping(**source: object) -> Mapping:
    """By log times, for the messages have no header."""
    return mapping_of({"stamp": "log"}, topic="/arm/state", field="data", **source)


def write_arrays(path: Path, rows: list[np.ndarray]) -> Path:
    """Arrays without names, a message each."""
    store = typestore()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/arm/state", ARRAY, typestore=store)
        for time, row in zip(STAMPS, rows, strict=False):
            content = message(ARRAY, {"data": row})
            writer.write(connection, 10**18 + round(1e9 * time), store.serialize_cdr(content, ARRAY))
    return path


def test_entries_name_the_joints_among_the_numbers_of_a_message(tmp_path: Path) -> None:
    """A gripper's width stands before the seven joints."""
    rows = [np.concatenate(([0.04], row)) for row in MOTION["position"]]
    bag = write_arrays(tmp_path / "bag", rows)
    found = read_positions(bag, array_mapping(entries=range(2, 9)))
    np.testing.assert_array_equal(found.values, MOTION["position"])
    assert "entries in the mapping says which of the 8" in refusal(lambda: read_positions(bag, array_mapping()))
    beyond = refusal(lambda: read_positions(bag, array_mapping(entries=range(3, 10))))
    assert "has 8 numbers, expected at least the 9 of entries" in beyond
    later = write_arrays(tmp_path / "later", [*rows[:50], *(row[1:] for row in rows[50:])])
    said = refusal(lambda: read_positions(later, array_mapping(entries=range(2, 9))))
    assert "message 50 has 7 numbers for the 8 of the first message" in said


def test_entries_are_not_for_messages_that_name_their_joints() -> None:
    with pytest.raises(ValueError, match="for messages with names joints"):
        array_mapping(names="name", entries=range(1, 8))


@pytest.mark.parametrize(
    ("kind", "field"),
    [("sensor_msgs/msg/Imu", "linear_acceleration"), ("geometry_msgs/msg/AccelStamped", "accel.linear")],
)
def test_the_acceleration_of_an_imu_is_read_in_si_units(tmp_path: Path, kind: str, field: str) -> None:
    """Beside the joint states, in multiples of 9.80665 m/s^2."""
    bag, store = tmp_path / "bag", typestore()
    felt = np.column_stack((np.sin(STAMPS), np.cos(STAMPS), np.ones(200)))
    state = "sensor_msgs/msg/JointState"
    names = [f"fer_joint{joint}" for joint in range(1, 8)]
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        arm = writer.add_connection("/arm/joint_states", state, typestore=store)
        sensor = writer.add_connection("/tool/imu", kind, typestore=store)
        for row, time in enumerate(np.round(1e9 * STAMPS).astype(int).tolist()):
            stamp = divmod(time, 10**9)
            content = {"header.stamp": stamp, "name": names, "position": MOTION["position"][row]}
            writer.write(arm, time, store.serialize_cdr(message(state, content), state))
            writer.write(
                sensor, time, store.serialize_cdr(message(kind, {"header.stamp": stamp, field: felt[row]}), kind)
            )
    shipped = load_mapping("joint_state").model_dump()
    source = {"topic": "/tool/imu", "unit": "g"}
    mapping = Mapping.model_validate(shipped | {"signals": shipped["signals"] | {"acceleration": source}})
    found = read_series(bag, mapping, ["acceleration"], ["acceleration"])["acceleration"]
    np.testing.assert_allclose(found.values, 9.80665 * felt, rtol=1e-12)
    np.testing.assert_allclose(found.time, STAMPS, atol=1e-9)


# ---- a remark on many runs is printed once, with the range of its numbers -------------------------------------------


WORDS = st.text(max_size=5)
PARTS = st.lists(
    st.one_of(WORDS, st.builds(Amount, st.floats(-1e3, 1e3), st.sampled_from([".3g", "+.1f"]))), max_size=6
)


def late(ms: float) -> Remark:
    return Remark("/commands: log time, less ", Amount(ms, ".1f"), " ms to be on the stamps' clock")


def test_sixteen_runs_whose_last_digit_differs_make_one_remark() -> None:
    runs = [(f"run_{number:02d}", late(0.15 + 0.01 * number)) for number in range(16)]
    assert len({remark for _, remark in runs}) > 1
    assert merged(runs) == ["16 runs: /commands: log time, less 0.1 to 0.3 ms to be on the stamps' clock"]
    assert merged(runs, 20) == ["16 of 20 runs: /commands: log time, less 0.1 to 0.3 ms to be on the stamps' clock"]


def test_a_few_runs_are_named_and_other_words_stay_apart() -> None:
    found = merged([("a", late(0.2)), ("b", late(0.2)), ("a", "no command"), ("", "on all runs")])
    assert found == [
        "a, b: /commands: log time, less 0.2 ms to be on the stamps' clock",
        "a: no command",
        "on all runs",
    ]


@given(parts=PARTS, other=st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6))
def test_other_numbers_make_no_other_kind(parts: list[str | Amount], other: list[float]) -> None:
    changed = [
        part._replace(value=new) if isinstance(part, Amount) else part for part, new in zip(parts, other, strict=False)
    ]
    assert len(merged([("a", Remark(*parts)), ("b", Remark(*changed))])) == 1
    assert merged([("", Remark(*parts))]) == ["".join(map(str, parts))]


@given(parts=PARTS)
def test_a_remark_comes_back_from_another_process_with_its_numbers(parts: list[str | Amount]) -> None:
    remark = Remark("arm: ", joined(", ", [Remark(*parts), "a"]))
    again = pickle.loads(pickle.dumps(remark))
    assert (again, again.parts) == (remark, remark.parts)
