# SPDX-License-Identifier: Apache-2.0
"""Attacks on arrays of signals, and the formats that hold them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

from benchmarks.attacks.clean_files import Rng

FORMS = (".npz", ".h5", ".mat", ".parquet", ".npy")


def _first_half(arrays: dict[str, Any]) -> dict[str, Any]:
    return arrays | {"tau": arrays["tau"][:200]}


ARRAYS: dict[str, Callable[[dict[str, Any], Rng], dict[str, Any]]] = {
    "other lengths": lambda arrays, rng: _first_half(arrays),
    "three axes": lambda arrays, rng: arrays | {"q": arrays["q"][:, :, None]},
    "one axis": lambda arrays, rng: arrays | {"q": arrays["q"].ravel()},
    "objects": lambda arrays, rng: arrays | {"q": arrays["q"].astype(object)},
    "all objects": lambda arrays, rng: {name: value.astype(object) for name, value in arrays.items()},
    "texts": lambda arrays, rng: arrays | {"q": arrays["q"].astype(str)},
    "complex": lambda arrays, rng: arrays | {"q": arrays["q"] * 1j},
    "whole numbers": lambda arrays, rng: arrays | {"q": arrays["q"].astype(int)},
    "other bytes": lambda arrays, rng: {name: value.astype(">f8") for name, value in arrays.items()},
    "transposed": lambda arrays, rng: {name: np.asfortranarray(value.T) for name, value in arrays.items()},
    "nan": lambda arrays, rng: arrays | {"tau": np.where(rng.random((400, 7)) < 0.01, np.nan, arrays["tau"])},
    "inf": lambda arrays, rng: arrays | {"dq": np.where(rng.random((400, 7)) < 0.01, np.inf, arrays["dq"])},
    "huge": lambda arrays, rng: arrays | {"q": np.where(rng.random((400, 7)) < 0.01, 1e300, arrays["q"])},
    "no stamps": lambda arrays, rng: {name: arrays[name] for name in ("q", "dq", "tau")},
    "stamps of zero": lambda arrays, rng: arrays | {"t": np.zeros(400)},
    "stamps back": lambda arrays, rng: arrays | {"t": arrays["t"][::-1]},
    "nothing": lambda arrays, rng: {},
    "empty arrays": lambda arrays, rng: {name: value[:0] for name, value in arrays.items()},
    "records": lambda arrays, rng: arrays | {"q": np.zeros(400, dtype=[("a", float), ("b", float)])},
    "swapped columns": lambda arrays, rng: arrays | {"q": arrays["q"][:, [0, 3, 2, 1, 4, 5, 6]]},
}  # fmt: skip


def saved(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays in the format that the suffix says; MATLAB files are of version 5."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".npy":
        parts = [np.asarray(value).reshape(len(value), -1) for value in arrays.values()]
        np.save(path, np.hstack(parts) if len({len(part) for part in parts}) == 1 else parts[0])
    elif path.suffix == ".mat":
        scipy.io.savemat(path, arrays)
    elif path.suffix == ".parquet":
        columns = {}
        for name, value in arrays.items():
            for number, column in enumerate(np.asarray(value).reshape(len(value), -1).T, 1):
                columns[name if name == "t" else f"{name}_{number}"] = pa.array(column.tolist())
        pq.write_table(pa.table(columns), path)
    else:
        with h5py.File(path, "w") as file:
            for name, value in arrays.items():
                file.create_dataset(name, data=value)
