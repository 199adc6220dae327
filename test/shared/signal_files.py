# SPDX-License-Identifier: Apache-2.0
"""Joint positions, 24 samples at 100 Hz, in every kind of file that is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

TIME = 0.01 * np.arange(24)  # s
VALUES = np.outer(np.sin(1.0 + TIME), np.arange(1.0, 8.0))  # rad


def csv_file(path: Path, notes: Sequence[str] = ("",) * 24, cells: Mapping[int, str] | None = None) -> Path:
    """A table with a column of notes, which is not read; ``cells`` stand in place of times, by row."""
    lines = ["time,note," + ",".join(f"position_{joint}" for joint in range(1, 8))]
    for row, (time, values) in enumerate(zip(TIME, VALUES, strict=True)):
        first = (cells or {}).get(row, repr(float(time)))
        lines.append(",".join([first, notes[row], *map(repr, values.tolist())]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def parquet_file(path: Path, **columns: object) -> Path:
    """The same in columns."""
    pyarrow = pytest.importorskip("pyarrow")
    values = {f"position_{joint + 1}": VALUES[:, joint] for joint in range(7)}
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table({"time": TIME, **values, **columns}), path)
    return path


def npz_file(path: Path, **changes: object) -> Path:
    """The same as arrays."""
    np.savez(path, **{"time": TIME, "position": VALUES, **changes})
    return path


def hdf5_file(
    path: Path, libver: str = "earliest", names: Sequence[str] = ("time", "position"), **options: object
) -> Path:
    """The same; checksums protect its numbers, and since version 1.8 of the format its addresses as well."""
    with pytest.importorskip("h5py").File(path, "w", libver=libver) as file:
        for name in names:
            file.create_dataset(name, data={"time": TIME, "position": VALUES}[name], **options)
    return path
