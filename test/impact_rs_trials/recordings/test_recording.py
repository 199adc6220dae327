# SPDX-License-Identifier: Apache-2.0
"""Recordings of others are read into SI units, joint by joint, or refused with the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.mapping import Mapping, SignalSource, TimeSource, load_mapping
from impact_rs_trials.recordings.recording import Recording, find_recordings, is_foreign, read_recordings

STORE = typestore()
PLAIN = load_mapping("joint_state")
TIME = np.arange(400) * 0.01  # s
PHASE = np.arange(7)
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
POSITION = CENTRE + 0.3 * np.sin(2.0 * TIME[:, None] + PHASE)
VELOCITY = 0.6 * np.cos(2.0 * TIME[:, None] + PHASE)
TORQUE = 3.0 * np.sin(TIME[:, None] + PHASE)


def read_recording(path: Path, mapping: Mapping) -> Recording:
    """The one piece that a file without faults has."""
    (whole,) = read_recordings(path, mapping)
    return whole


def units(**changes: object) -> Mapping:
    """The plain mapping with other signals or times."""
    return PLAIN.model_copy(update=changes)


def signals(**changes: dict) -> dict:
    return {
        name: SignalSource(**{**source.model_dump(), **changes.get(name, {})}) for name, source in PLAIN.signals.items()
    }


def npz(path: Path, **changes: np.ndarray) -> Path:
    np.savez(path, **{"time": TIME, "position": POSITION, "velocity": VELOCITY, "effort": TORQUE, **changes})
    return path


def csv(path: Path, time: np.ndarray, scale: dict[str, float]) -> Path:
    names = ["time"] + [f"{name}_{joint}" for name in ("position", "velocity", "effort") for joint in range(1, 8)]
    table = np.hstack(
        (time[:, None], POSITION * scale["position"], VELOCITY * scale["velocity"], TORQUE * scale["torque"])
    )
    lines = [",".join(names)] + [",".join(repr(float(value)) for value in row) for row in table]
    path.write_text("# made up\n" + "\n".join(lines) + "\n")
    return path


def bag(path: Path, order: list[int], offset: float = 0.0) -> Path:
    """JointState messages with joints in some order; stamps are ``offset`` [s] behind the log."""
    kind = topics.JOINT_STATE
    header, stamp = STORE.types["std_msgs/msg/Header"], STORE.types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/arm/joint_states", kind, typestore=STORE)
        for row, time in enumerate(TIME):
            nanoseconds = round((time + offset) * 1e9)
            message = STORE.types[kind](
                header=header(stamp=stamp(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9), frame_id=""),
                name=[f"fer_joint{joint + 1}" for joint in order],
                position=POSITION[row, order],
                velocity=VELOCITY[row, order],
                effort=TORQUE[row, order],
            )
            writer.write(connection, round(time * 1e9), STORE.serialize_cdr(message, kind))
    return path


def test_a_table_in_degrees_and_milliseconds_is_read_in_si_units(tmp_path: Path) -> None:
    file = csv(tmp_path / "a.csv", 1e3 * TIME, {"position": 180.0 / np.pi, "velocity": 180.0 / np.pi, "torque": -1.0})
    mapping = units(
        signals=signals(position={"unit": "deg"}, velocity={"unit": "deg/s"}, torque={"factor": -1.0}),
        time=TimeSource(unit="ms"),
    )
    found = read_recording(file, mapping)
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    np.testing.assert_allclose(found.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(found.velocity, VELOCITY, atol=1e-12)
    np.testing.assert_allclose(found.torque, TORQUE, atol=1e-12)


def test_joints_of_a_bag_are_put_in_order_by_their_names(tmp_path: Path) -> None:
    found = read_recording(bag(tmp_path / "bag", [6, 0, 2, 1, 3, 5, 4]), PLAIN)
    np.testing.assert_array_equal(found.position, POSITION)
    np.testing.assert_array_equal(found.torque, TORQUE)
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)


@pytest.mark.parametrize(("stamp", "start"), [("header", 5.0), ("log", 0.0)])
def test_time_is_that_of_the_header_or_of_the_log_as_the_mapping_says(tmp_path: Path, stamp: str, start: float) -> None:
    found = read_recording(bag(tmp_path / "bag", list(range(7)), 5.0), units(time=TimeSource(stamp=stamp)))
    assert found.time[0] == pytest.approx(start, abs=1e-9)


def test_an_array_file_is_read_as_it_is(tmp_path: Path) -> None:
    found = read_recording(npz(tmp_path / "a.npz"), PLAIN)
    np.testing.assert_array_equal(found.velocity, VELOCITY)
    assert found.others == {}


def spoiled(values: np.ndarray, row: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[row, 2] = value
    return changed


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"position": spoiled(POSITION, 7, np.nan)}, "position of joint 3 is not a number at t = 0.070 s"),
        ({"position": POSITION * 180.0 / np.pi}, "wrong unit"),
        ({"velocity": -VELOCITY}, "velocity is -1 times the derivative of position"),
        ({"velocity": VELOCITY * 180.0 / np.pi}, "wrong unit"),
        ({"effort": 1e3 * TORQUE}, "torque of joint"),
        ({"effort": TORQUE[:, :6]}, "expected 400 samples x 7 joints"),
        ({"time": TIME[::-1]}, "run backwards"),
        ({"time": np.where(TIME > 2.0, TIME + 3.0, TIME)}, "gap of"),
        ({"time": np.full(400, 1.0)}, "stand still"),
    ],
)
def test_what_no_robot_would_measure_is_refused_with_the_place(tmp_path: Path, changes: dict, complaint: str) -> None:
    with pytest.raises(InputError, match="a.npz") as caught:
        read_recording(npz(tmp_path / "a.npz", **changes), PLAIN)
    assert complaint in str(caught.value)


def test_folders_files_and_strangers_are_told_apart(tmp_path: Path) -> None:
    bag(tmp_path / "one", list(range(7)))
    npz(tmp_path / "two.npz")
    assert find_recordings(tmp_path) == [tmp_path / "one", tmp_path / "two.npz"]
    assert is_foreign(tmp_path)
    (tmp_path / "notes.txt").write_text("no recording")
    with pytest.raises(InputError, match="expected a recording"):
        find_recordings(tmp_path / "notes.txt")
    with pytest.raises(InputError, match="no such file"):
        find_recordings(tmp_path / "three")
