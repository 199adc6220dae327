# SPDX-License-Identifier: Apache-2.0
"""Recordings of others are read into SI units, joint by joint, or refused with the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_bag, write_csv, write_npz

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.mapping import Mapping, SignalSource, TimeSource, load_mapping
from impact_rs_trials.recordings.recording import ARM, find_recordings, is_foreign, read_recordings
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


def test_a_table_in_degrees_and_milliseconds_is_read_in_si_units(tmp_path: Path) -> None:
    other = {"time": 1e3 * TIME, "position": DEGREES * POSITION, "velocity": DEGREES * VELOCITY, "effort": -TORQUE}
    changes = {"position": {"unit": "deg"}, "velocity": {"unit": "deg/s"}, "torque": {"factor": -1.0}}
    signals = {name: SignalSource(**PLAIN.signals[name].model_dump() | keys) for name, keys in changes.items()}
    mapping = PLAIN.model_copy(update={"signals": signals, "time": TimeSource(unit="ms")})
    assert_read(read_recording(write_csv(tmp_path / "a.csv", other), mapping))


@pytest.mark.parametrize(("stamp", "start"), [("header", 5.0), ("log", 0.0)])
def test_time_is_that_of_the_header_or_of_the_log_as_the_mapping_says(tmp_path: Path, stamp: str, start: float) -> None:
    bag = write_bag(tmp_path / "bag", COLUMNS, range(7), behind=5.0)
    found = read_recording(bag, PLAIN.model_copy(update={"time": TimeSource(stamp=stamp)}))
    assert found.signals.time[0] == pytest.approx(start, abs=1e-9)


def spoiled(values: np.ndarray, row: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[row, 2] = value
    return changed


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"position": spoiled(POSITION, 7, np.nan)}, "position of joint 3 is not a number at t = 0.070 s"),
        ({"effort": spoiled(TORQUE, 7, np.nan)}, "torque of joint 3 is not a number at t = 0.070 s"),
        ({"position": DEGREES * POSITION}, "wrong unit (now rad)"),
        ({"velocity": -VELOCITY}, "velocity is -1 times the derivative of position, expected 1"),
        ({"velocity": 0.3 * VELOCITY}, "times the derivative of position, expected 1"),
        ({"velocity": DEGREES * VELOCITY}, "wrong unit"),
        ({"effort": 1e3 * TORQUE}, "torque of joint"),
        ({"effort": TORQUE[:, :6]}, "expected 400 samples x 7 joints"),
        ({"time": TIME[::-1]}, "run backwards"),
        ({"time": np.where(TIME > 2.0, TIME - 0.5, TIME)}, "time stamps run backwards"),
        ({"time": np.full(400, 1.0)}, "stand still"),
        ({name: values[:50] for name, values in COLUMNS.items()}, "50 samples, at least 100 are needed"),
    ],
)
def test_what_no_robot_would_measure_is_refused_with_the_place(tmp_path: Path, changes: dict, complaint: str) -> None:
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
