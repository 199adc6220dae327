# SPDX-License-Identifier: Apache-2.0
"""Bags of which a part is missing say so, and messages without joint names are read by the place of their numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_bag
from refusals import refusal
from ros_messages import message
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.series import Series
from impact_rs_trials.recordings.sources import read_series

TIME = np.round(0.01 * np.arange(200), 6)
MOTION: Columns = {
    "time": TIME,
    "position": np.sin(np.outer(TIME, np.arange(1.0, 8.0))),
    "velocity": np.zeros((200, 7)),
    "effort": np.zeros((200, 7)),
}
ARRAY = "std_msgs/msg/Float64MultiArray"


def position_of(path: Path, mapping: Mapping | None = None) -> Series:
    return read_series(path, mapping or load_mapping("joint_state"), ["position"], ["position"])["position"]


def part_of(motion: Columns, first: int, last: int) -> Columns:
    return {name: values[first:last] for name, values in motion.items()}


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_that_the_metadata_count_and_the_file_lacks_are_said(tmp_path: Path, storage: StoragePlugin) -> None:
    """A file with 150 of 200 messages in the place of the whole one."""
    whole = write_bag(tmp_path / "bag", MOTION, range(7), storage)
    assert position_of(whole).remarks == ()
    less = write_bag(tmp_path / "less" / "bag", part_of(MOTION, 0, 150), range(7), storage)
    (file,) = (one for one in less.iterdir() if one.name != "metadata.yaml")
    file.replace(whole / file.name)
    found = position_of(whole)
    assert found.time.size == 150
    assert "/arm/joint_states: 150 messages, 200 are counted in the bag's metadata" in found.remarks[0]


def test_a_second_file_of_messages_that_the_metadata_do_not_name_is_said(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", part_of(MOTION, 0, 100), range(7))
    second = write_bag(tmp_path / "second", part_of(MOTION, 100, 200), range(7))
    (second / "second.mcap").replace(bag / "bag_1.mcap")
    assert position_of(bag).remarks == ("not read, for metadata.yaml does not name them: bag_1.mcap",)


@pytest.mark.parametrize("bare", [True, False])
def test_a_database_that_was_cut_off_is_refused(tmp_path: Path, bare: bool) -> None:
    """SQLite itself reads what is left of its pages."""
    bag = write_bag(tmp_path / "bag", MOTION, range(7), StoragePlugin.SQLITE3)
    file = bag / "bag.db3"
    assert position_of(file if bare else bag).time.size == 200
    content = file.read_bytes()
    file.write_bytes(content[:-100])
    said = refusal(lambda: position_of(file if bare else bag))
    assert f"cut off: {len(content) - 100} bytes are left of {len(content)}" in said


def mapping_of(**source: object) -> Mapping:
    """By log times, for the messages have no header."""
    shipped = load_mapping("joint_state").model_dump()
    signals = shipped["signals"] | {"position": {"topic": "/arm/state", "field": "data", "unit": "rad", **source}}
    return Mapping.model_validate(shipped | {"time": {"stamp": "log"}, "signals": signals})


def write_arrays(path: Path, rows: list[np.ndarray]) -> Path:
    """Arrays without names, a message each."""
    store = typestore()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/arm/state", ARRAY, typestore=store)
        for time, row in zip(TIME, rows, strict=False):
            content = message(ARRAY, {"data": row})
            writer.write(connection, 10**18 + round(1e9 * time), store.serialize_cdr(content, ARRAY))
    return path


def test_entries_name_the_joints_among_the_numbers_of_a_message(tmp_path: Path) -> None:
    """A gripper's width stands before the seven joints."""
    rows = [np.concatenate(([0.04], row)) for row in MOTION["position"]]
    bag = write_arrays(tmp_path / "bag", rows)
    found = position_of(bag, mapping_of(entries=range(2, 9)))
    np.testing.assert_array_equal(found.values, MOTION["position"])
    assert "entries in the mapping says which of the 8" in refusal(lambda: position_of(bag, mapping_of()))
    beyond = refusal(lambda: position_of(bag, mapping_of(entries=range(3, 10))))
    assert "has 8 numbers, expected at least the 9 of entries" in beyond
    later = write_arrays(tmp_path / "later", [*rows[:50], *(row[1:] for row in rows[50:])])
    said = refusal(lambda: position_of(later, mapping_of(entries=range(2, 9))))
    assert "message 50 has 7 numbers for the 8 of the first message" in said


def test_entries_are_not_for_messages_that_name_their_joints() -> None:
    with pytest.raises(ValueError, match="joints those of messages with names"):
        mapping_of(names="name", entries=range(1, 8))


@pytest.mark.parametrize(
    ("kind", "field"),
    [("sensor_msgs/msg/Imu", "linear_acceleration"), ("geometry_msgs/msg/AccelStamped", "accel.linear")],
)
def test_the_acceleration_of_an_imu_is_read_in_si_units(tmp_path: Path, kind: str, field: str) -> None:
    """Beside the joint states, in multiples of 9.80665 m/s^2."""
    bag, store = tmp_path / "bag", typestore()
    felt = np.column_stack((np.sin(TIME), np.cos(TIME), np.ones(200)))
    state = "sensor_msgs/msg/JointState"
    names = [f"fer_joint{joint}" for joint in range(1, 8)]
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        arm = writer.add_connection("/arm/joint_states", state, typestore=store)
        sensor = writer.add_connection("/tool/imu", kind, typestore=store)
        for row, time in enumerate(np.round(1e9 * TIME).astype(int).tolist()):
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
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)
