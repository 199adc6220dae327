# SPDX-License-Identifier: Apache-2.0
"""Signals read from columns equal those read message by message, to the bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_bag, write_ros1_bag
from known_recordings import BagFormat, Signals
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.mapping import Mapping, SignalName, load_mapping
from impact_rs_trials.recordings.readers import bag_file
from impact_rs_trials.recordings.readers.bag_file import BagFile
from impact_rs_trials.recordings.readers.series import Names

RNG = np.random.default_rng(5)
TIME = np.cumsum(RNG.uniform(0.0008, 0.0012, 60))  # s
COLUMNS = {"time": TIME, **{name: RNG.standard_normal((60, 7)) for name in ("position", "velocity", "effort")}}
LABORATORY = load_mapping("joint_state_effort_controller")


def signals(path: Path, mapping: Mapping, wanted: Sequence[SignalName]) -> tuple[set[bool], dict[str, object]]:
    """Whether topics are read by columns, and bytes, strides and remarks of every signal."""
    bag = BagFile(path, mapping, Names(), tuple(wanted))
    found = {}
    for name in wanted:
        one = bag.series(name, mapping.signals[name])
        arrays = (one.time, one.values, one.log)
        found[name] = ([(a.shape, a.strides, a.tobytes()) for a in arrays], [str(said) for said in one.remarks])
    return {topic.stacked for topic in bag._messages.values()}, found


def assert_alike(monkeypatch: pytest.MonkeyPatch, path: Path, mapping: Mapping, columns: set[bool]) -> None:
    wanted = tuple(mapping.signals)
    kinds, found = signals(path, mapping, wanted)
    assert kinds == columns
    monkeypatch.setattr(bag_file, "stacked", lambda *_: None)
    assert signals(path, mapping, wanted) == ({False}, found)


@pytest.mark.parametrize("pose", ["PoseStamped", "TransformStamped", "Odometry", "TFMessage"])
@pytest.mark.parametrize("command", ["Float64MultiArray", "JointState", "JointTrajectory"])
def test_every_kind_of_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pose: str, command: str) -> None:
    """Kills: a pose whose rows are columns, another order in memory, a header of the first message for all."""
    path = BagFormat(pose=pose, command=command).write(tmp_path / "bag", Signals.known(0.05))
    fields = {"JointState": "effort", "JointTrajectory": "points.0.effort"}
    names = {"JointState": "name", "JointTrajectory": "joint_names"}
    signals = dict(LABORATORY.signals)
    if command != "Float64MultiArray":
        own = {"type": None, "field": fields[command], "names": names[command]}
        signals["command"] = signals["command"].model_copy(update=own)
    signals["object_pose"] = signals["object_pose"].model_copy(update={"type": None, "child_frame": "box"})
    mapping = LABORATORY.model_copy(update={"signals": signals})
    one_by_one = pose == "TFMessage" or command == "JointTrajectory"
    assert_alike(monkeypatch, path, mapping, {True, False} if one_by_one else {True})


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("mode", list(CompressionMode))
def test_every_storage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, storage: StoragePlugin, mode: CompressionMode
) -> None:
    if storage == StoragePlugin.SQLITE3 and mode == CompressionMode.STORAGE:
        pytest.skip("SQLite has no chunks")
    plain = write_bag(tmp_path / "plain", COLUMNS, [3, 1, 0, 2, 6, 5, 4])
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(plain) as reader, writer:
        for connection, log, data in reader.messages():
            if not writer.connections:
                own = writer.add_connection(connection.topic, connection.msgtype, typestore=typestore())
            writer.write(own, log, data)
    mapping = load_mapping("joint_state")
    assert signals(tmp_path / "bag", mapping, tuple(mapping.signals)) == signals(plain, mapping, tuple(mapping.signals))
    assert_alike(monkeypatch, tmp_path / "bag", mapping, {True})


def test_joints_in_another_order_half_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names as long as before. Kills: the order of the first message for all."""
    parts = [{name: values[rows] for name, values in COLUMNS.items()} for rows in (slice(0, 30), slice(30, 60))]
    orders = ([0, 1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1, 0])
    halves = [write_bag(tmp_path / f"half{n}", *both) for n, both in enumerate(zip(parts, orders, strict=True))]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        own = writer.add_connection("/arm/joint_states", "sensor_msgs/msg/JointState", typestore=typestore())
        for half in halves:
            with Reader(half) as reader:
                for _, log, data in reader.messages():
                    writer.write(own, log, data)
    mapping = load_mapping("joint_state")
    bag = BagFile(tmp_path / "bag", mapping, Names(), ("position",))
    found = bag.series("position", mapping.signals["position"]).values
    np.testing.assert_array_equal(found, COLUMNS["position"])
    assert_alike(monkeypatch, tmp_path / "bag", mapping, {False})


def test_bags_of_ros_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_ros1_bag(tmp_path / "one.bag", COLUMNS, [3, 1, 0, 2, 6, 5, 4])
    assert_alike(monkeypatch, path, load_mapping("joint_state"), {False})
