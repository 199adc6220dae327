# SPDX-License-Identifier: Apache-2.0
"""A damaged file of measurements is refused in one line, or read with a row for every line and its own numbers."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from damage import damaged, edited, repeatable
from hypothesis import given
from hypothesis import strategies as st
from impact_table_cases import write_csv
from signal_files import TIME, VALUES, csv_file, hdf5_file, npz_file, parquet_file

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot_import import import_urdf
from impact_rs_trials.recordings.array_file import ArrayFile
from impact_rs_trials.recordings.experiment import Experiment, read_runs
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.series import Names
from impact_rs_trials.recordings.table_file import TableFile

MAPPING, ROWS = load_mapping("joint_state"), TIME.size
CELLS = (
    *(
        '"',
        '""',
        '"slow',
        'a"',
        "3_7",
        "\uff11",
        "0x1p3",
        "1d3",
        "infinity",
        "-inf",
        "nan",
        "",
        " ",
        "1,5",
        "1;5",
        "--1",
    ),
    *("9" * 5000, "1e400", "x" * 140_000, "#", "\0", "\u2028", "=1+1", "True", "1+2j", "2026-01-01T00:00:00"),
)
URDF = """<robot name="arm">
<link name="base"/>
<link name="one"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.2" rpy="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="1.5" velocity="3" effort="40"/></joint>
</robot>
"""


def impacts(path: Path) -> Path:
    """Cubes that fall."""
    body = [*(f"{axis} [m]" for axis in "xyz"), "qx", "qy", "qz", "qw", "mass [kg]", *(f"size_{i} [m]" for i in "xyz")]
    units = {"v": "m/s", "w": "rad/s"}
    twists = [f"{k}{axis}_{when} [{units[k]}]" for when in ("before", "after") for k in "vw" for axis in "xyz"]
    row = ["0", "0", "0.05", "0", "0", "0", "1", "0.3", "0.1", "0.1", "0.1", "fine"]
    moving = ["0.1", "0", "-1", "0", "0", "0", "0.05", "0", "0", "0", "0", "0"]
    return write_csv(path, [*body, "remark", *twists], [[*row, *moving]] * ROWS)


def runs(path: Path) -> Path:
    rows = [[f"run_{number}", "parcel", "hit", "fine"] for number in range(ROWS)]
    for name, *_ in rows:
        path.with_name(name).mkdir()
    return write_csv(path, ["bag", "object", "kind", "remark"], rows)


@st.composite
def with_a_second_array(draw: st.DrawFn, data: bytes) -> bytes:
    """An archive with a second array of one name, or of another kind."""
    kinds = (VALUES + 1.0, VALUES * 1j, VALUES.astype(str), np.zeros(0), TIME.astype("m8[s]"))
    array, archive = io.BytesIO(), io.BytesIO(data)
    np.save(array, draw(st.sampled_from(kinds)))
    with warnings.catch_warnings(), zipfile.ZipFile(archive, "a") as file:
        warnings.simplefilter("ignore")  # of the second one
        file.writestr(draw(st.sampled_from(("position", "time"))) + ".npy", array.getvalue())
    return archive.getvalue()


def lines_of(path: Path) -> int:
    text = path.read_text(encoding="utf-8-sig")
    return sum(bool(line.strip()) and not line.startswith("#") for line in text.split("\n")) - 1


def positions(path: Path) -> tuple[int, np.ndarray, np.ndarray]:
    """Rows of the file, time and position."""
    file = (TableFile if path.suffix in (".csv", ".parquet") else ArrayFile)(path, MAPPING, Names())
    found = file.series("position", MAPPING.signals["position"])
    return found.time.size, found.time, found.values


def every_row(path: Path) -> bool:
    count, _, values = positions(path)
    return count == values.shape[0] <= lines_of(path)  # rows without any position hold no sample


def every_run(path: Path) -> bool:
    experiment = Experiment(scenario="push", runs=path.name)
    return len(read_runs(path.parent, experiment, experiment.load_scenario())) == lines_of(path)


def same_numbers(path: Path) -> bool:
    """Or it is said that a change of them could not be detected."""
    file = ArrayFile(path, MAPPING, Names())
    found = file.series("position", MAPPING.signals["position"])
    return bool(file.unsealed) or (np.array_equal(found.time, TIME) and np.array_equal(found.values, VALUES))


FILES: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "signals.csv": (lambda path: csv_file(path, ["fine"] * ROWS), every_row),
    "impacts.csv": (impacts, lambda path: len(read_impact_table(path).rows) == lines_of(path)),
    "runs.csv": (runs, every_run),
    "arm.urdf": (lambda path: path.write_text(URDF), lambda path: len(import_urdf(path).joints) == 1),
    "signals.parquet": (parquet_file, positions),
    "signals.npz": (npz_file, same_numbers),
    "plain.h5": (hdf5_file, positions),
    "sealed.h5": (lambda path: hdf5_file(path, "latest", fletcher32=True, chunks=True), same_numbers),
}


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_refused_or_read_right(name: str, tmp_path: Path) -> None:
    (make, read), file = FILES[name], tmp_path / name
    make(file)
    data = file.read_bytes()
    changes = [damaged(data)]
    if name.endswith((".csv", ".urdf")):
        changes += [edited(data.decode(), CELLS, ',"')] * 3
    if name.endswith(".npz"):
        changes.append(with_a_second_array(data))
    assert read(file)  # what is damaged is read as it stands

    @repeatable(60)
    @given(st.one_of(changes))
    def check(change: bytes) -> None:
        file.write_bytes(change)
        try:
            assert read(file)
        except InputError as error:
            assert "\n" not in str(error)
            assert name in str(error)

    check()
