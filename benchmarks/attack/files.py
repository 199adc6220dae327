# SPDX-License-Identifier: Apache-2.0
"""Mutants of measurements and robots: is each refused in one line? ``./run python -m benchmarks.attack.files``.

Signals as CSV, Parquet, NPZ and HDF5 (with and without checksums), a table of impacts, a table of runs, and a URDF. A
mutant is refused (``InputError``) in one line that names the file, or read with as many samples as the file has rows.
Of formats with checksums (NPZ, and HDF5 with ``fletcher32`` and ``libver="latest"``) the numbers must be the very same.
"""

from __future__ import annotations

import csv
import io
import random
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.attack.referee import Referee, arguments
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot_import import import_urdf
from impact_rs_trials.recordings.array_file import ArrayFile
from impact_rs_trials.recordings.experiment import Experiment, read_runs
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.series import Names
from impact_rs_trials.recordings.table_file import TableFile

SECONDS = 20.0
ROWS = 24
MAPPING = load_mapping("joint_state")
TIME = 0.01 * np.arange(ROWS)
VALUES = np.outer(np.sin(1.0 + TIME), np.arange(1.0, 8.0))
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
CUBES = (
    [
        "x [m]",
        "y [m]",
        "z [m]",
        "qx",
        "qy",
        "qz",
        "qw",
        "mass [kg]",
        "size_x [m]",
        "size_y [m]",
        "size_z [m]",
        "remark",
    ],
    ["vx", "vy", "vz", "wx", "wy", "wz"],
)


def _csv_of(header: list[str], rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue().encode()


def signals_csv() -> bytes:
    """Time, a remark that is not read, and positions."""
    header = ["time", "remark", *(f"position_{joint}" for joint in range(1, 8))]
    rows = [[repr(float(time)), "fine", *map(repr, row.tolist())] for time, row in zip(TIME, VALUES, strict=True)]
    return _csv_of(header, rows)


def impacts_csv() -> bytes:
    """Cubes that fall."""
    units = {"v": "m/s", "w": "rad/s"}
    twists = [f"{name}_{when} [{units[name[0]]}]" for when in ("before", "after") for name in CUBES[1]]
    body = ["0", "0", "0.05", "0", "0", "0", "1", "0.3", "0.1", "0.1", "0.1", "fine"]
    moving = [*("0.1", "0", "-1", "0", "0", "0"), *("0.05", "0", "0", "0", "0", "0")]
    return _csv_of([*CUBES[0], *twists], [[*body, *moving]] * ROWS)


def signals_parquet() -> bytes:
    """The same as Parquet."""
    import pyarrow
    import pyarrow.parquet

    columns = {f"position_{joint + 1}": VALUES[:, joint] for joint in range(7)}
    text = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table({"time": TIME, **columns}), text)
    return text.getvalue()


def signals_npz() -> bytes:
    """The same as NPZ."""
    data = io.BytesIO()
    np.savez(data, time=TIME, position=VALUES)
    return data.getvalue()


def signals_hdf5(libver: str | None = None, **options: object) -> bytes:
    """The same as HDF5; before the format of version 1.8 nothing protects what says where numbers lie."""
    import h5py

    data = io.BytesIO()
    with h5py.File(data, "w", libver=libver) as file:
        for name, values in (("time", TIME), ("position", VALUES)):
            file.create_dataset(name, data=values, **options)
    return data.getvalue()


def cell(chance: random.Random, data: bytes) -> bytes:
    """Another cell, word or attribute of a text."""
    text = data.decode()
    separators = [place for place, sign in enumerate(text) if sign in ',\n" ']
    place = chance.choice(separators[:-1])
    end = next(stop for stop in separators if stop > place)
    return (text[: place + 1] + chance.choice(CELLS) + text[end:]).encode()


def line(chance: random.Random, data: bytes) -> bytes:
    """A line lost, twice or cut off."""
    lines = data.decode().split("\n")
    place, kind = chance.randrange(len(lines)), chance.randrange(3)
    lines[place : place + 1] = ([], [lines[place]] * 2, [lines[place][: len(lines[place]) // 2]])[kind]
    return "\n".join(lines).encode()


def bit(chance: random.Random, data: bytes) -> bytes:
    """One to three bits."""
    changed = bytearray(data)
    for _ in range(chance.randrange(1, 4)):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def part(chance: random.Random, data: bytes) -> bytes:
    """Cut off, or a part of it once more."""
    place = chance.randrange(len(data))
    return data[:place] if chance.random() < 0.5 else data + data[place:]


def twice(chance: random.Random, data: bytes) -> bytes:
    """An archive with a second array of one name, or of another kind."""
    values = chance.choice((VALUES + 1.0, VALUES * 1j, VALUES.astype(str), np.zeros(0), TIME.astype("m8[s]")))
    array, archive = io.BytesIO(), io.BytesIO(data)
    np.save(array, values)
    with warnings.catch_warnings(), zipfile.ZipFile(archive, "a") as file:
        warnings.simplefilter("ignore")  # of the second one
        file.writestr(chance.choice(("position", "time")) + ".npy", array.getvalue())
    return archive.getvalue()


def _series(path: Path) -> tuple[int, object]:
    """Rows of the file and what was read of it."""
    file = (TableFile if path.suffix in (".csv", ".parquet") else ArrayFile)(path, MAPPING, Names())
    found = file.series("position", MAPPING.signals["position"])
    return found.time.size, (found.time, found.values)


def _lines(path: Path) -> int:
    """Rows of a table by its lines."""
    text = path.read_text(encoding="utf-8-sig")
    return sum(bool(one.strip()) and not one.startswith("#") for one in text.split("\n")) - 1


def _same(found: object) -> bool:
    time, values = found  # type: ignore[misc]
    return bool(np.array_equal(time, TIME) and np.array_equal(values, VALUES))


def _table_of_signals(path: Path) -> bool:
    count, (_, values) = _series(path)  # type: ignore[misc]
    return bool(count == values.shape[0] <= _lines(path))  # rows without any position hold no sample


def _impacts(path: Path) -> bool:
    return len(read_impact_table(path).rows) == _lines(path)


def _runs(path: Path) -> bool:
    scenario = Experiment(scenario="push").load_scenario()
    experiment = Experiment(scenario="push", runs=path.name)
    return len(read_runs(path.parent, experiment, scenario)) == _lines(path)


def _anything(path: Path) -> bool:
    _series(path)
    return True


def main(argv: list[str] | None = None) -> int:
    """Run the campaign."""
    options = arguments(__doc__, 5_000).parse_args(argv)
    chance, referee = random.Random(options.seed), Referee(("refused", "read"))
    Read = Callable[[Path], bool]
    Change = Callable[[random.Random, bytes], bytes]
    texts: tuple[Change, ...] = (cell, cell, cell, line, bit, part)
    binary: tuple[Change, ...] = (bit, bit, part)
    runs = _csv_of(["bag", "object", "kind", "remark"], [[f"run_{n}", "parcel", "hit", "fine"] for n in range(ROWS)])
    kinds: list[tuple[str, bytes, Read, tuple[Change, ...]]] = [
        ("signals.csv", signals_csv(), _table_of_signals, texts),
        ("impacts.csv", impacts_csv(), _impacts, texts),
        ("runs.csv", runs, _runs, texts),
        ("arm.urdf", URDF.encode(), lambda path: len(import_urdf(path).joints) == 1, texts),
        ("signals.parquet", signals_parquet(), _anything, binary),
        ("signals.npz", signals_npz(), lambda path: _same(_series(path)[1]), (*binary, twice)),
        ("signals.h5", signals_hdf5(), _anything, binary),
        (
            "sealed.h5",
            signals_hdf5("latest", fletcher32=True, chunks=True),
            lambda path: _same(_series(path)[1]),
            binary,
        ),
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(ROWS):
            (folder / f"run_{number}").mkdir()
        for file, data, read, _ in kinds:  # what is attacked is read, as it stands
            (folder / file).write_bytes(data)
            assert read(folder / file), file
        for _ in range(options.count):
            file, data, read, changes = chance.choice(kinds)
            change = chance.choice(changes)
            path = folder / file
            path.write_bytes(change(chance, data))

            def attack(path: Path = path, read: Read = read) -> str:
                try:
                    return "read" if read(path) else "other numbers"
                except InputError as error:
                    told = str(error)
                    fine = "\n" not in told and path.name in told  # the command line shortens it
                    return "refused" if fine else f"message: {told[:200]}"

            referee.judge(f"{change.__name__} of {file}: {path.read_bytes()[:300]!r}", attack, SECONDS)
    return referee.end()


if __name__ == "__main__":
    sys.exit(main())
