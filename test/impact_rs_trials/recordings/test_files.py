# SPDX-License-Identifier: Apache-2.0
"""Files of signals say exactly what they hold: what a reader could take for something else is refused in one line."""

from __future__ import annotations

import os
import pickle
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal
from signal_files import TIME, VALUES, csv_file, hdf5_file, npz_file, parquet_file, torch_file

from impact_rs_sim.decimals import decimal
from impact_rs_trials.recordings.mapping import SignalSource, load_mapping
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.csv_rows import csv_rows
from impact_rs_trials.recordings.readers.series import DIFFERENCE_S, Names, Series
from impact_rs_trials.recordings.readers.table_file import TableFile


def read(path: Path, **source: object) -> Series:
    """Joint positions of a file."""
    mapping = load_mapping("joint_state")
    position = SignalSource(**{**mapping.signals["position"].model_dump(), **source})
    file = (TableFile if path.suffix in (".csv", ".parquet") else ArrayFile)(path, mapping, Names())
    return file.series("position", position)


def refused(path: Path) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        said = refusal(read, path)
    assert str(path) in said
    return said


# ---- tables ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("last", [None, 18])
def test_a_stray_quotation_mark_does_not_swallow_rows(tmp_path: Path, last: int | None) -> None:
    """Alone, and with a second one further down that would close the cell."""
    notes = ["" if row != 4 else '"slow' for row in range(24)]
    if last is not None:
        notes[last] = '"'
    assert 'line 6: quotation marks (") do not pair up' in refused(csv_file(tmp_path / "a.csv", notes))


def test_quoted_cells_keep_separators_and_marks(tmp_path: Path) -> None:
    file = csv_file(tmp_path / "a.csv", ['"a, ""b"""', '5" box', "\u2028 next"] + [""] * 21)
    np.testing.assert_array_equal(read(file).values, VALUES)
    rows = csv_rows(file)
    assert [row[1][1] for row in rows[1:4]] == ['a, "b"', '5" box', "\u2028 next"]
    assert [line for line, _ in rows] == list(range(1, 26))


def test_lines_are_counted_as_an_editor_counts_them(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbf# made up\r\n\r\ntime\tx\r\n 1\t2\r\n")
    assert csv_rows(tmp_path / "a.csv") == [(3, ["time", "x"]), (4, ["1", "2"])]


def test_a_cell_that_is_longer_than_any_number_is_refused(tmp_path: Path) -> None:
    file = csv_file(tmp_path / "a.csv", ["x" * 131_073] + [""] * 23)
    assert "line 2: a cell has more than 131072 characters" in refused(file)


@pytest.mark.parametrize(
    "cell", ["3_7", "\uff11\uff12", "0x10", "1d3", "infinity", "1,5", "--1", "1 2", "1e", "\u0661"]
)
def test_only_decimal_notation_is_a_number(tmp_path: Path, cell: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        decimal(cell)
    quoted = f'"{cell}"'
    assert "not a table of numbers" in refused(csv_file(tmp_path / "a.csv", cells={3: quoted}))


@pytest.mark.parametrize(
    ("cell", "value"),
    [("37", 37.0), (" +1.5e-3 ", 1.5e-3), (".5", 0.5), ("-2.", -2.0), ("1E3", 1e3), ("-Inf", -np.inf)],
)
def test_decimal_notation_is_read_as_it_is_written(cell: str, value: float) -> None:
    assert decimal(cell) == value
    assert np.isnan(decimal("NaN"))


@pytest.mark.parametrize("digits", [20, 5000])
def test_a_stamp_beyond_64_bits_is_refused(tmp_path: Path, digits: int) -> None:
    lines = ["time," + ",".join(f"position_{joint}" for joint in range(1, 8))]
    lines += [",".join([str(time), *["0"] * 7]) for time in range(23)] + [",".join(["9" * digits, *["0"] * 7])]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert f"column 'time' (time) has a stamp of {digits} digits" in refused(tmp_path / "a.csv")


def test_a_parquet_stamp_outside_of_what_nanoseconds_hold_is_refused(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    stamps = pyarrow.array([0] * 23 + [10**12]).cast(pyarrow.timestamp("s"))
    said = refused(parquet_file(tmp_path / "a.parquet", time=stamps))
    assert "column 'time' has a stamp outside the years 1678 to 2262" in said


def test_two_columns_of_a_parquet_file_with_one_name_are_refused(tmp_path: Path) -> None:
    io = pytest.importorskip("pyarrow.parquet")
    whole = io.read_table(parquet_file(tmp_path / "a.parquet"))
    io.write_table(whole.append_column("position_3", [VALUES[:, 0]]), tmp_path / "b.parquet")
    assert "position_3" in refused(tmp_path / "b.parquet")


# ---- arrays ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"position": VALUES + 1j}, "complex128"),
        ({"position": VALUES > 0.0}, "bool"),
        ({"position": VALUES.astype(str)}, "<U"),
        ({"position": np.ones((24, 7)).astype("m8[ms]")}, "timedelta64[ms]"),
        ({"position": np.ones((24, 7)).astype("M8[ms]")}, "datetime64[ms]"),
    ],
)
def test_arrays_hold_real_numbers(tmp_path: Path, changes: dict[str, object], kind: str) -> None:
    said = refused(npz_file(tmp_path / "a.npz", **changes))
    assert f"holds {kind}" in said and "expected real numbers" in said


@pytest.mark.parametrize("kind", ["M8[ms]", "m8[ms]"])
@pytest.mark.parametrize("write", [npz_file, parquet_file])
def test_dates_and_durations_have_their_own_unit(tmp_path: Path, write: Callable[..., Path], kind: str) -> None:
    """Kills: refused dates of NumPy and durations of Arrow, and the unit of the mapping for them."""
    stamps = (10 * np.arange(24)).astype(kind)
    stamps[5] = "NaT"
    found = read(write(tmp_path / f"a.{write.__name__.split('_')[0]}", time=stamps))
    np.testing.assert_allclose(found.time, np.delete(TIME, 5), atol=1e-12)
    assert any("1 of 24 samples have no time stamp: left out" in one for one in found.remarks)


def rated(path: Path, unit: str, **source: object) -> Series:
    """Joint positions of arrays at a rate of 100 Hz."""
    mapping = load_mapping("joint_state")
    clock = mapping.time.model_copy(update={"rate": 100.0, "unit": unit})
    position = SignalSource(**{**mapping.signals["position"].model_dump(), **source})
    file = ArrayFile(path, mapping.model_copy(update={"time": clock}), Names())
    return file.series("position", position)


@pytest.mark.parametrize("entries", [None, list(range(1, 8))])
def test_arrays_of_joints_by_samples_are_transposed_at_a_rate_too(tmp_path: Path, entries: list[int] | None) -> None:
    """Kills a count of the rows, with which joints were samples where entries choose among them."""
    path = npz_file(tmp_path / "a.npz", position=VALUES.T)
    found = rated(path, "s", entries=entries)
    np.testing.assert_array_equal(found.values, VALUES)
    np.testing.assert_allclose(found.time, 0.01 * np.arange(len(VALUES)))


def test_frame_numbers_of_arrays_count_dropped_frames(tmp_path: Path) -> None:
    """Kills even times of arrays whose frames have numbers."""
    frames = np.delete(np.arange(len(VALUES) + 1), 5)
    found = rated(npz_file(tmp_path / "a.npz", time=frames), "frames")
    np.testing.assert_allclose(found.time, 0.01 * frames)


def test_a_wrong_width_at_a_rate_names_the_remedy(tmp_path: Path) -> None:
    path = npz_file(tmp_path / "a.npz", position=np.hstack((VALUES, VALUES)))
    said = refusal(rated, path, "s")
    assert "expected 24 samples x 7 joints; entries in the mapping says which of the 14 numbers" in said


@pytest.mark.parametrize("kind", ["f4", "i4", "u2"])
def test_real_numbers_of_any_kind_are_read(tmp_path: Path, kind: str) -> None:
    values = np.round(10.0 * np.abs(VALUES)).astype(kind)
    np.testing.assert_array_equal(read(npz_file(tmp_path / "a.npz", position=values)).values, values)


@pytest.mark.parametrize("kind", ["f4", "f8", "i8"])
def test_tensors_of_pytorch_are_read_without_it(tmp_path: Path, kind: str) -> None:
    """Kills one type for all storages."""
    values = np.round(10.0 * VALUES).astype(kind)
    np.testing.assert_array_equal(read(torch_file(tmp_path / "a.pt", position=values)).values, values)


def test_a_pytorch_file_calls_nothing(tmp_path: Path) -> None:
    """A pickle can run any command. Kills a search of names in modules."""

    class Command:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(tmp_path / "called"),)

    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("log/data.pkl", pickle.dumps({"position": Command()}))
    said = refused(tmp_path / "a.pt")
    assert "mkdir, which is no tensor of real numbers" in said and "numpy.savez" in said
    assert not (tmp_path / "called").exists()


def test_a_tensor_beyond_its_storage_is_refused(tmp_path: Path) -> None:
    file = torch_file(tmp_path / "a.pt")
    with zipfile.ZipFile(file) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    content["log/data/1"] = content["log/data/1"][:-8]
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    assert "storage 1 has 167 numbers, expected 168" in refused(file)


def test_two_arrays_of_one_name_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "other.npy", VALUES + 1.0)
    with warnings.catch_warnings(), zipfile.ZipFile(npz_file(tmp_path / "a.npz"), "a") as archive:
        warnings.simplefilter("ignore")
        archive.write(tmp_path / "other.npy", "position.npy")
    assert "two arrays are called 'position'" in refused(tmp_path / "a.npz")


def test_a_delay_is_added_to_the_stamps_of_arrays_and_tables(tmp_path: Path) -> None:
    for file in (npz_file(tmp_path / "a.npz"), csv_file(tmp_path / "a.csv")):
        np.testing.assert_allclose(read(file, delay=0.25).time, TIME + 0.25)


def test_an_hdf5_file_says_where_it_carries_no_checksums(tmp_path: Path) -> None:
    (remark,) = read(hdf5_file(tmp_path / "a.h5")).remarks
    assert remark.startswith("a.h5 has arrays without checksums")
    sealed = {"fletcher32": True, "chunks": True}
    assert read(hdf5_file(tmp_path / "b.h5", **sealed)).remarks == ()


def test_zeros_of_an_hdf5_file_may_be_a_block_that_was_lost(tmp_path: Path) -> None:
    """The checksum of zeros is zero, so that a block of a disk that reads as zeros is one with its checksum."""
    h5py = pytest.importorskip("h5py")
    file = hdf5_file(tmp_path / "a.h5", fletcher32=True, chunks=(12, 7), names=("position",))
    with h5py.File(file) as opened:
        lost = opened["position"].id.get_chunk_info(1)
    data = bytearray(file.read_bytes())
    data[lost.byte_offset : lost.byte_offset + lost.size] = bytes(lost.size)
    file.write_bytes(data)
    assert not ArrayFile(file, load_mapping("joint_state"), Names())._arrays["position"][12:].any()
    assert ArrayFile(file, load_mapping("joint_state"), Names()).unsealed == {"position"}


def test_a_changed_byte_of_an_hdf5_file_with_checksums_is_noticed(tmp_path: Path) -> None:
    file = hdf5_file(tmp_path / "a.h5", fletcher32=True, chunks=True)
    data = bytearray(file.read_bytes())
    place = bytes(data).index(VALUES.tobytes()[8:64])
    data[place + 20] ^= 1
    file.write_bytes(data)
    assert "not a readable HDF5 file" in refused(file)


def test_numbers_of_other_files_are_not_those_of_this_one(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    other = hdf5_file(tmp_path / "other.h5")
    VALUES.tofile(tmp_path / "raw")
    layout = h5py.VirtualLayout(VALUES.shape, float)
    layout[:] = h5py.VirtualSource(str(other), "position", VALUES.shape)
    raw = [(str(tmp_path / "raw"), 0, VALUES.nbytes)]

    def folder(file: Any) -> None:
        file["far"] = h5py.ExternalLink(str(other), "/")
        file["position"] = h5py.SoftLink("/far/position")

    for name, add, complaint in (
        ("virtual", lambda file: file.create_virtual_dataset("position", layout), "is made of other files"),
        (
            "raw",
            lambda file: file.create_dataset("position", VALUES.shape, float, external=raw),
            "is made of other files",
        ),
        ("link", lambda file: file.update(position=h5py.ExternalLink(str(other), "position")), "no array 'position'"),
        ("folder", folder, "no array 'position'"),
    ):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["time"] = TIME
            add(file)
        assert complaint in refused(tmp_path / f"{name}.h5")


def test_an_empty_hdf5_array_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["position"] = TIME, h5py.Empty("f8")
    assert "array 'position' (position) is (0,), expected 24 samples x 7 joints" in refused(tmp_path / "a.h5")


# ---- a derivative by differences is that of the motion, whatever the sampling; an encoder's steps are ---------------


@pytest.mark.parametrize("rate", [50.0, 1000.0, 5000.0])
def test_the_derivative_of_a_sine_is_its_cosine(rate: float) -> None:
    """Up to sinc(2 f h) of central differences over 2 h, and one-sided at the ends."""
    time = np.arange(0.0, 2.0, 1.0 / rate)
    series = Series("column q", time, np.sin(2.0 * np.pi * time)[:, None])
    half = max(1.0 / rate, DIFFERENCE_S / 2.0)
    inner = slice(int(half * rate) + 1, -int(half * rate) - 1)
    exact = 2.0 * np.pi * np.cos(2.0 * np.pi * time) * np.sinc(2.0 * half)
    np.testing.assert_allclose(series.derivative().values[inner, 0], exact[inner], atol=1e-9)
    assert np.abs(series.derivative().values[:, 0] - exact).max() < 2.0 * np.pi * 2.0 * np.pi * half


def test_uneven_stamps_and_a_straight_line_give_its_slope() -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.5e-3, 2e-3, 400))
    np.testing.assert_allclose(Series("q", time, 0.7 * time[:, None] - 2.0).derivative().values, 0.7, rtol=1e-9)


def test_the_steps_of_an_encoder_are_divided_by_the_baseline_and_not_by_the_period() -> None:
    time = np.arange(0.0, 1.0, 1e-4)
    steps = np.round(0.3 * time / 1e-4) * 1e-4  # 0.1 mrad at 10 kHz: 1 rad/s from sample to sample
    speed = Series("q", time, steps[:, None]).derivative().values
    assert np.abs(speed - 0.3)[10:-10].max() < 1.01 * 1e-4 / DIFFERENCE_S
    assert np.abs(speed - 0.3).max() < 2.02 * 1e-4 / DIFFERENCE_S  # one-sided at the ends
