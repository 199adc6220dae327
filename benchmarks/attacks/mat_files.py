# SPDX-License-Identifier: Apache-2.0
"""Attacks on MAT files: what MATLAB stores beside plain matrices, in files of level 4, of level 5 and in HDF5 (7.3)."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse

from benchmarks.attacks.clean_files import Rng

Arrays = dict[str, Any]
HEAD = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Thu Nov 26 10:00:00 2026 HDF5 schema 1.00 ."
CLASSES = {"f": "double", "i": "int32", "u": "uint16", "b": "logical"}  # of MATLAB, by kind of a NumPy type


def level_5(arrays: Arrays, **options: Any) -> bytes:
    """A file as ``save -v7`` writes it."""
    file = io.BytesIO()
    scipy.io.savemat(file, arrays, **options)
    return file.getvalue()


def level_73(arrays: Arrays, change: Callable[[h5py.File], None] = lambda file: None) -> bytes:
    """A file as ``save -v7.3`` writes it: vectors are matrices, and every array lies the other way round."""
    file = io.BytesIO()
    with h5py.File(file, "w", userblock_size=512) as stored:
        for name, value in arrays.items():
            array = np.asarray(value)
            data = stored.create_dataset(name, data=array[None, :] if array.ndim == 1 else array.T)
            data.attrs["MATLAB_class"] = np.bytes_(CLASSES[array.dtype.kind])
        change(stored)
    content = bytearray(file.getvalue())
    content[:128] = HEAD.ljust(124) + b"\x00\x02IM"
    return bytes(content)


def _instead(name: str, value: Any, kind: str, **further: Any) -> Callable[[Arrays, Rng], bytes]:
    """A file of 7.3 in which one array is something else, of another class."""

    def attack(arrays: Arrays, rng: Rng) -> bytes:
        def change(file: h5py.File) -> None:
            del file[name]
            data = file.create_dataset(name, data=value(arrays[name]))
            data.attrs["MATLAB_class"] = np.bytes_(kind)
            for key, value_of_attribute in further.items():
                data.attrs[key] = np.uint8(value_of_attribute)

        return level_73(arrays, change)

    return attack


def _cells_73(arrays: Arrays, rng: Rng) -> bytes:
    def change(file: h5py.File) -> None:
        value = file["q"][()]
        del file["q"]
        inner = [file.create_dataset(f"#refs#/{number}", data=row) for number, row in enumerate(value)]
        cells = file.create_dataset("q", (len(inner), 1), dtype=h5py.ref_dtype)
        cells[:, 0] = [cell.ref for cell in inner]
        cells.attrs["MATLAB_class"] = np.bytes_("cell")

    return level_73(arrays, change)


def _sparse_73(arrays: Arrays, rng: Rng) -> bytes:
    def change(file: h5py.File) -> None:
        columns = scipy.sparse.csc_matrix(file["tau"][()].T)
        del file["tau"]
        group = file.create_group("tau")
        group.attrs["MATLAB_sparse"] = np.uint64(columns.shape[0])
        group.attrs["MATLAB_class"] = np.bytes_("double")
        for name, part in (("data", columns.data), ("ir", columns.indices), ("jc", columns.indptr)):
            group.create_dataset(name, data=part)

    return level_73(arrays, change)


def _structure_73(arrays: Arrays, rng: Rng) -> bytes:
    def change(file: h5py.File) -> None:
        for name in arrays:
            file.move(name, f"log/{name}")
        file["log"].attrs["MATLAB_class"] = np.bytes_("struct")

    return level_73(arrays, change)


def _cell(value: Any, shape: tuple[int, ...] = (1, 1)) -> np.ndarray:
    """A cell array."""
    cells = np.empty(shape, dtype=object)
    for index in np.ndindex(shape):
        cells[index] = value(*index) if callable(value) else value
    return cells


def _doubled(arrays: Arrays, rng: Rng) -> bytes:
    return level_5(arrays) + level_5({"q": 0.5 * arrays["q"]})[128:]


def _marked(offset: int, mark: bytes) -> Callable[[Arrays, Rng], bytes]:
    def attack(arrays: Arrays, rng: Rng) -> bytes:
        content = bytearray(level_5(arrays))
        content[offset : offset + len(mark)] = mark
        return bytes(content)

    return attack


def _whole(value: np.ndarray, scale: float, kind: type) -> np.ndarray:
    return np.asarray(np.round(scale * value), dtype=kind)


def _q(change: Callable[[np.ndarray], Any]) -> Callable[[Arrays, Rng], bytes]:
    """A file of level 5 in which the positions are something else."""
    return lambda arrays, rng: level_5(arrays | {"q": change(arrays["q"])})


def _stamps(change: Callable[[np.ndarray], Any]) -> Callable[[Arrays, Rng], bytes]:
    """A file of level 5 in which the stamps are something else."""
    return lambda arrays, rng: level_5(arrays | {"t": change(arrays["t"])})


def _words(rows: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{number:.6f}" for number in row) for row in rows])


def _complex(rows: np.ndarray) -> np.ndarray:
    """As MATLAB stores complex numbers in HDF5."""
    numbers = np.zeros(rows.T.shape, dtype=[("real", float), ("imag", float)])
    numbers["real"] = numbers["imag"] = rows.T
    return numbers


def _all_in_a_cell(arrays: Arrays, rng: Rng) -> bytes:
    parts = list(arrays.values())
    return level_5({"log": _cell(lambda row, column: parts[column], (1, 4))})


MAT: dict[str, Callable[[Arrays, Rng], bytes]] = {
    "level 4": lambda arrays, rng: level_5(arrays, format="4"),
    "rows": lambda arrays, rng: level_5(arrays, oned_as="row"),
    "columns": lambda arrays, rng: level_5(arrays, oned_as="column"),
    "compressed": lambda arrays, rng: level_5(arrays, do_compression=True),
    "transposed": lambda arrays, rng: level_5({name: value.T for name, value in arrays.items()}),
    "one transposed": lambda arrays, rng: level_5(arrays | {"dq": arrays["dq"].T}),
    "a structure": lambda arrays, rng: level_5({"log": arrays}),
    "structures in structures": lambda arrays, rng: level_5({"lab": {"run": {"log": arrays}}}),
    "an array of structures": lambda arrays, rng: level_5({"log": [arrays, arrays]}),
    "a cell of all": _all_in_a_cell,
    "a cell of one": _q(lambda q: _cell(q)),
    "a cell a joint": _q(lambda q: _cell(lambda row, column: q[:, column], (1, 7))),
    "a cell a sample": _q(lambda q: _cell(lambda row, column: q[row], (400, 1))),
    "a cell a number": _q(lambda q: _cell(lambda row, column: q[row, column], (400, 7))),
    "texts": _q(_words),
    "a remark": lambda arrays, rng: level_5(arrays | {"note": "second try", "operator": "A. B."}),
    "empty": _q(lambda q: np.zeros((0, 0))),
    "empty stamps": _stamps(lambda t: np.zeros((1, 0))),
    "complex": lambda arrays, rng: level_5(arrays | {"q": arrays["q"] + 0.1j * arrays["dq"]}),
    "complex without an imaginary part": _q(lambda q: q + 0j),
    "complex stamps": _stamps(lambda t: t + 0j),
    "sparse": lambda arrays, rng: level_5(arrays | {"tau": scipy.sparse.csc_matrix(arrays["tau"])}),
    "truth values": _q(lambda q: q > 0.0),
    "truth values as stamps": _stamps(lambda t: t > 1.0),
    "int8": _q(lambda q: _whole(q, 50.0, np.int8)),
    "uint8": lambda arrays, rng: level_5(arrays | {"tau": np.abs(arrays["tau"]).astype(np.uint8)}),
    "int16 in mrad": _q(lambda q: _whole(q, 1e3, np.int16)),
    "int32 in mrad": lambda arrays, rng: level_5(arrays | {"dq": _whole(arrays["dq"], 1e3, np.int32)}),
    "int64 stamps in ns": _stamps(lambda t: _whole(t, 1e9, np.int64)),
    "uint64 stamps in ns of the day": _stamps(lambda t: 1_763_500_000 * 10**9 + _whole(t, 1e9, np.uint64)),
    "int32 stamps in ms": _stamps(lambda t: _whole(t, 1e3, np.int32)),
    "stamps in days": _stamps(lambda t: 738_000.0 + t / 86_400.0),
    "stamps of single precision": _stamps(lambda t: (1.7635e9 + t).astype(np.float32)),
    "three axes": _q(lambda q: q[:, None, :]),
    "other lengths": lambda arrays, rng: level_5(arrays | {"tau": arrays["tau"][:-1]}),
    "two of a name": _doubled,
    "other order of bytes": _marked(126, b"MI"),
    "no order of bytes": _marked(126, b"XX"),
    "other level": _marked(124, b"\x00\x03"),
    "7.3": lambda arrays, rng: level_73(arrays),
    "7.3, transposed": lambda arrays, rng: level_73({name: np.atleast_2d(value).T for name, value in arrays.items()}),
    "7.3, one transposed": lambda arrays, rng: level_73(arrays | {"dq": arrays["dq"].T}),
    "7.3, a structure": _structure_73,
    "7.3, cells": _cells_73,
    "7.3, sparse": _sparse_73,
    "7.3, texts": _instead("q", lambda q: _whole(q.T + 10.0, 10.0, np.uint16), "char", MATLAB_int_decode=2),
    "7.3, truth values": _instead("q", lambda value: (value.T > 0.0).astype("u1"), "logical", MATLAB_int_decode=1),
    "7.3, truth values as stamps": _instead("t", lambda t: t[None, :] > 1.0, "logical"),
    "7.3, empty": _instead("q", lambda q: np.array([0, 7], np.uint64), "double", MATLAB_empty=1),
    "7.3, empty stamps": _instead("t", lambda t: np.zeros(2, np.uint64), "double", MATLAB_empty=1),
    "7.3, complex": _instead("q", _complex, "double"),
    "7.3, another head": lambda arrays, rng: b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + level_73(arrays)[128:],
    "7.3, no head": lambda arrays, rng: bytes(512) + level_73(arrays)[512:],
}  # fmt: skip
