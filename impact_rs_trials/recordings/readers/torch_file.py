# SPDX-License-Identifier: Apache-2.0
"""PyTorch files (``torch.save`` since version 1.6): tensors of real numbers by name, alone and in dictionaries.

A file is a ZIP archive: ``data.pkl`` is a pickle of the dictionary, whose tensors are a storage with offset, size and
strides; ``data/KEY`` are the raw numbers of a storage, ``byteorder`` their order (PyTorch, serialization semantics).
A pickle can call any function: this reader knows dictionaries, tensors and their storages, and refuses anything else.
"""

from __future__ import annotations

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError, shortened

PICKLE = "data.pkl"
STORED = {
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "?",
}  # fmt: skip
ORDERS: dict[str, Literal["<", ">"]] = {"little": "<", "big": ">"}
MAX_NESTED_DICTIONARIES = 8
REMEDY = "numpy.savez('log.npz', **{name: tensor.numpy() for name, tensor in torch.load(FILE).items()}) makes one"


class _Refused(Exception):
    """A pickle that does not hold tensors by name."""


def read_torch(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays by name, in dictionaries as ``dictionary/name``; other values are left out.

    Raises:
        InputError: It is no such file, or holds objects of other kinds than tensors.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.rpartition("/")[2] == PICKLE]
            if len(names) != 1:
                raise _Refused("no torch.save since version 1.6")
            folder = names[0][: -len(PICKLE)]
            with archive.open(names[0]) as stream:
                content = _Tensors(stream, _storages(archive, folder)).load()
        if not isinstance(content, dict):
            raise _Refused(f"it holds {type(content).__name__}, expected a dictionary of tensors")
        return dict(_arrays_by_path(content, "", MAX_NESTED_DICTIONARIES))
    except Exception as error:  # a damaged archive or pickle fails anywhere inside the libraries
        message = shortened((str(error).splitlines() or [type(error).__name__])[0])  # may hold names that damage made
        raise InputError(
            f"not a readable PyTorch file ({message}); expected arrays in .npz: {REMEDY}", file=path
        ) from None


def _storages(archive: zipfile.ZipFile, folder: str) -> Callable[[str, str], NDArray[Any]]:
    """Reader of the numbers of a storage by type and key."""
    order = (
        archive.read(f"{folder}byteorder").decode("ascii") if f"{folder}byteorder" in archive.namelist() else "little"
    )

    def read(kind: str, key: str) -> NDArray[Any]:
        return np.frombuffer(archive.read(f"{folder}data/{key}"), np.dtype(STORED[kind]).newbyteorder(ORDERS[order]))

    return read


class _Tensors(pickle.Unpickler):
    """Unpickler of dictionaries of tensors."""

    def __init__(self, stream: Any, storage: Callable[[str, str], NDArray[Any]]) -> None:
        super().__init__(stream)
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        """The only functions and types that a pickle may name: those of tensors."""
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module == "torch" and name in STORED:
            return name
        raise _Refused(f"it holds {module}.{name}, which is no tensor of real numbers")

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        """Numbers of a storage: ``("storage", type, key, device, count)``."""
        _, kind, key, _, count = pid
        values = self._storage(kind, key)
        if values.size != count:
            raise _Refused(f"storage {key} has {values.size} numbers, expected {count}")
        return values


def _tensor(
    storage: NDArray[Any], offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> NDArray[Any]:
    """Numbers of a tensor in its storage."""
    last = offset + sum((length - 1) * step for length, step in zip(size, stride, strict=True))
    if min((*size, *stride, offset), default=0) < 0 or 0 not in size and last >= storage.size:
        raise _Refused(f"a tensor {size} goes beyond its storage of {storage.size} numbers")
    steps = tuple(step * storage.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps).copy()


def _arrays_by_path(content: Mapping[Any, Any], prefix: str, depth: int) -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of a dictionary by their path."""
    for name, value in content.items():
        if isinstance(value, np.ndarray):
            yield f"{prefix}{name}", value
        elif isinstance(value, dict) and depth > 0:
            yield from _arrays_by_path(value, f"{prefix}{name}/", depth - 1)
