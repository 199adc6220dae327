# SPDX-License-Identifier: Apache-2.0
"""NPZ and HDF5 files: an array per signal, samples x joints, and one or several arrays of time stamps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.clock import seconds_of
from impact_rs_trials.recordings.mapping import UNITS, WIDTH, Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.series import MissingSignal, Names, Series
from impact_rs_trials.recordings.table_file import require

UNSEALED = (
    "{} has arrays without checksums (or with blocks of zeros, whose checksum is that of a lost block): accidental "
    "changes of numbers cannot be detected (fletcher32 in h5py)"
)
REAL = "iuf"  # kinds of NumPy types whose numbers are taken: no complex ones, truth values, texts or durations


class ArrayFile:
    """One NPZ or HDF5 file.

    Attributes:
        unsealed: Arrays without checksums that detect a change; those of an NPZ file always have some.

    Args:
        path: The file.
        mapping: Where the signals are.
        names: What the placeholders of the mapping stand for.

    Raises:
        InputError: It is no such file.
    """

    def __init__(self, path: Path, mapping: Mapping, names: Names) -> None:
        self._path, self._mapping, self._names = path, mapping, names
        self.unsealed: frozenset[str] = frozenset()
        if path.suffix == ".npz":
            self._arrays = _read_npz(path)
        else:
            self._arrays, self.unsealed = _read_hdf5(path)

    @staticmethod
    def shapes_of(path: Path) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the arrays of a file.

        Raises:
            InputError: It is no such file.
        """
        arrays = _read_npz(path) if path.suffix == ".npz" else _read_hdf5(path)[0]
        return {name: array.shape for name, array in arrays.items()}

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The file lacks it.
            InputError: It cannot be used.
        """
        if source.array is None:
            raise MissingSignal(f"the mapping says no array for {name}", file=self._path, key=f"signals.{name}")
        values = self._array(self._names.fill(source.array), name)
        stamps = self._names.fill(source.time_array or self._mapping.time.array)
        time = self._stamps(stamps, f"time of {name}")
        if time.ndim != 1:
            raise InputError(f"array {stamps!r} (time) is {time.shape}, expected one number a sample", file=self._path)
        if values.shape != (time.size, self._mapping.width(name)):
            what = "numbers" if name in WIDTH else "joints"
            expected = f"{time.size} samples x {self._mapping.width(name)} {what}"
            raise InputError(f"array {source.array!r} ({name}) is {values.shape}, expected {expected}", file=self._path)
        time = seconds_of(time, UNITS["time"][self._mapping.time.unit]) + source.delay
        place = f"array {source.array!r} ({name})"
        remarks = (UNSEALED.format(self._path.name),) if self.unsealed else ()
        return Series(place, time, self._mapping.to_si(name, values), remarks=remarks).sampled()

    def _stamps(self, name: str, meaning: str) -> NDArray[Any]:
        """An array of time, in whole numbers where it holds those."""
        as_numbers, as_stored = self._array(name, meaning), self._arrays[name.strip("/")]
        return as_stored if np.issubdtype(as_stored.dtype, np.integer) else as_numbers

    def _array(self, name: str, meaning: str) -> Array:
        name = name.strip("/")
        if name not in self._arrays:
            near, found = did_you_mean(name, self._arrays), ", ".join(self._arrays)
            raise MissingSignal(f"no array {name!r} ({meaning}){near}; found: {found}", file=self._path)
        stored = self._arrays[name]
        if stored.dtype.kind not in REAL:
            raise InputError(f"array {name!r} ({meaning}) holds {stored.dtype}, expected real numbers", file=self._path)
        return np.asarray(stored, dtype=float)


def _read_npz(path: Path) -> dict[str, Array]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            names = list(archive.files)
            arrays = {name: np.asarray(archive[name]) for name in names}
    except Exception as error:  # a damaged archive fails in zipfile, in zlib or in NumPy
        raise InputError(f"not a readable NPZ file ({error})", file=path) from None
    if len(arrays) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two arrays are called {twice!r}", file=path)
    return arrays


def _read_hdf5(path: Path) -> tuple[dict[str, Array], frozenset[str]]:
    """Arrays by name, and which of them carry no checksums."""
    require("h5py", path)
    import h5py

    arrays: dict[str, Array] = {}
    unsealed: set[str] = set()

    def keep(name: str | bytes, item: object) -> None:
        if isinstance(name, bytes):  # no text in UTF-8
            raise InputError(f"not a readable HDF5 file (name {name!r})", file=path)
        if not isinstance(item, h5py.Dataset):
            return
        if item.is_virtual or item.external:
            raise InputError(f"array {name!r} is made of other files, expected its numbers in this one", file=path)
        arrays[name] = np.zeros(0) if item.shape is None else np.asarray(item)
        # The checksum of zeros is zero: a block that a disk has lost looks like zeros that were measured.
        if not (item.fletcher32 and all(arrays[name][chunk].any() for chunk in item.iter_chunks())):
            unsealed.add(name)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(keep)
    except InputError:
        raise
    except Exception as error:  # a damaged file can fail anywhere inside the library
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"not a readable HDF5 file ({said})", file=path) from None
    return arrays, frozenset(unsealed)
