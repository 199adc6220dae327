# SPDX-License-Identifier: Apache-2.0
"""Joint positions, 24 samples at 100 Hz, in every kind of file that is read."""

from __future__ import annotations

import io
import pickle
import sys
import types
import zipfile
from collections import OrderedDict
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


class _Stored:
    """Numbers of a tensor, which a pickle names by their key."""

    def __init__(self, key: str, values: np.ndarray) -> None:
        self.key, self.values = key, values


def torch_file(path: Path, **changes: np.ndarray) -> Path:
    """The same as tensors of ``torch.save``, written without PyTorch: its modules are stand-ins while pickling."""

    def rebuilt(*_: object) -> None:
        raise AssertionError("is named by the pickle, and never called")

    rebuilt.__module__, rebuilt.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    kinds = {"float32": "FloatStorage", "float64": "DoubleStorage", "int64": "LongStorage"}
    storages = {kind: type(kind, (), {"__module__": "torch"}) for kind in kinds.values()}
    stand_ins = {"torch": types.SimpleNamespace(**storages), "torch._utils": types.SimpleNamespace()}
    stand_ins["torch._utils"]._rebuild_tensor_v2 = rebuilt

    class Tensor:
        def __init__(self, key: str, values: np.ndarray) -> None:
            self.stored = _Stored(key, np.ascontiguousarray(values))

        def __reduce__(self) -> tuple[object, ...]:
            values = self.stored.values
            steps = tuple(step // values.itemsize for step in values.strides)
            return rebuilt, (self.stored, 0, values.shape, steps, False, OrderedDict())

    class Pickler(pickle.Pickler):
        def persistent_id(self, one: object) -> object:
            if not isinstance(one, _Stored):
                return None
            return "storage", storages[kinds[str(one.values.dtype)]], one.key, "cpu", one.values.size

    tensors = {"time": TIME, "position": VALUES, **changes}
    named = {name: Tensor(str(key), values) for key, (name, values) in enumerate(tensors.items())}
    content = io.BytesIO()
    with pytest.MonkeyPatch.context() as patch:
        for name, module in stand_ins.items():
            patch.setitem(sys.modules, name, module)
        Pickler(content, 2).dump(named)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", content.getvalue())
        archive.writestr("log/byteorder", "little")
        for key, values in enumerate(tensors.values()):
            archive.writestr(f"log/data/{key}", np.ascontiguousarray(values).tobytes())
    return path
