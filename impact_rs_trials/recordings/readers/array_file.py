# SPDX-License-Identifier: Apache-2.0
"""NPZ, HDF5, MAT and PyTorch files: an array per signal, samples x joints, and one or several arrays of timestamps.

MATLAB writes vectors as matrices, structures as ``data.q`` (here ``data/q``), and since version 7.3 an HDF5 file in
which every array is transposed.
"""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.optional_packages import require
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.mapping import WIDTHS, Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.readers.clock import seconds_by, seconds_of_dates, seconds_of_pair
from impact_rs_trials.recordings.readers.mat_file import read_mat
from impact_rs_trials.recordings.readers.read_once import once
from impact_rs_trials.recordings.readers.series import MissingSignal, Names, Series
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.readers.torch_file import read_torch
from impact_rs_trials.recordings.readers.transforms import are_transforms, poses_of

UNSEALED = (
    "{} has arrays without checksums (or with blocks of zeros, whose checksum equals a lost block's): accidental "
    "changes of numbers cannot be detected (fletcher32 in h5py)"
)
TIME_KEY = "time.array"
HDF5 = (".h5", ".hdf5")
DATES = "mM"  # kinds of NumPy types that are durations and dates, which have their own unit
REAL = "iuf"  # kinds of NumPy types that are real numbers: neither complex numbers, booleans, texts nor durations


class ArrayFile:
    """One NPZ, HDF5, MAT or PyTorch file.

    Attributes:
        unsealed: Names of arrays without checksums; arrays of an NPZ or PyTorch file always have one.

    Args:
        path: The file.
        mapping: Where the signals are.
        names: Values of the placeholders of the mapping.

    Raises:
        InputError: It is no such file.
    """

    def __init__(self, path: Path, mapping: Mapping, names: Names) -> None:
        self._path, self._mapping, self._names = path, mapping, names
        self.unsealed: frozenset[str] = frozenset()
        array_names = [array for source in mapping.signals.values() for array in _arrays_of(source, mapping)]
        loaded = {names.fill(array).strip("/") for array in array_names} if mapping.holds_runs else None
        self._arrays, self.unsealed = _read(path, loaded)

    @staticmethod
    def arrays_of(path: Path) -> dict[str, NDArray[Any]]:
        """Names and arrays of a file, vectors of MATLAB with one axis.

        Raises:
            InputError: It is no such file.
        """
        arrays = _read(path)[0]
        return {
            name: array.ravel() if array.ndim == 2 and 1 in array.shape else array for name, array in arrays.items()
        }

    @staticmethod
    def shapes_of(path: Path) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the arrays of a file.

        Raises:
            InputError: It is no such file.
        """
        return {name: array.shape for name, array in _read(path)[0].items()}

    @staticmethod
    def names_of(path: Path) -> list[str]:
        """Names of the arrays of a file.

        Raises:
            InputError: It is no such file.
        """
        return list(_read(path, set())[0]) if suffix_of(path) in HDF5 else list(_read(path)[0])

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The file lacks it.
            InputError: It cannot be used.
        """
        if source.array is None:
            raise MissingSignal(
                f"signals.{name}.array is missing in the mapping", file=self._path, key=f"signals.{name}"
            )
        label, width = f"array {source.array!r} ({name})", self._mapping.width(name)
        values = self._array(self._names.fill(source.array), name, f"signals.{name}.array")
        if width == 1 and values.ndim == 1:
            values = values[:, None]
        if name == "object_pose" and are_transforms(values.shape):
            poses = poses_of(values)
            if poses is None:
                text = f"{label} is {values.shape}, expected homogeneous transforms, with the last row 0 0 0 1"
                raise InputError(text, file=self._path)
            values = poses
        time = self._time(source, name, values)
        arrays = {self._names.fill(array).strip("/") for array in _arrays_of(source, self._mapping)}
        remarks: tuple[str, ...] = (UNSEALED.format(self._path.name),) if self.unsealed & arrays else ()
        numbers = values.shape[1] if source.entries is not None and values.ndim == 2 else width
        if values.ndim == 2 and values.shape[0] != time.size == values.shape[1]:
            numbers, values = values.shape[0] if source.entries is not None else width, values.T
            remarks += (f"{label} has its samples in columns: transposed",)
        if values.shape != (time.size, numbers):
            expected = f"{time.size} samples x {width} {'numbers' if name in WIDTHS else 'joints'}"
            hint = ""
            if values.ndim == 2 and values.shape[0] == time.size and values.shape[1] > width:
                hint = f"; entries in the mapping says which of the {values.shape[1]} numbers"
            raise InputError(f"{label} is {values.shape}, expected {expected}{hint}", file=self._path)
        if source.entries is not None:
            if numbers < max(source.entries):
                text = f"{label} has {numbers} numbers a sample, expected at least the {max(source.entries)} of entries"
                raise InputError(text, file=self._path, key=f"signals.{name}.entries")
            values = values[:, [entry - 1 for entry in source.entries]]
        return Series(label, time + source.delay, self._mapping.to_si(name, values), remarks=remarks).sampled()

    def _time(self, source: SignalSource, name: SignalName, values: Array) -> Array:
        """Timestamps of the samples of a signal [s]."""
        clock = self._mapping.clock(source)
        if clock.rate is not None and clock.unit != "frames":
            width = self._mapping.width(name)
            width_in_shape = source.entries is None and values.ndim == 2 and width in values.shape
            # A recording has more samples than numbers a sample.
            count = values.size // width if width_in_shape else max(values.shape, default=0)
            return np.asarray(np.arange(count) / clock.rate)
        if clock.unit == "date":
            text = "dates in arrays need no unit (datetime64); expected the unit of numbers: s, ms, us or ns"
            raise InputError(text, file=self._path, key="time.unit", value=clock.unit)
        clock_array = clock.array
        key = f"signals.{name}.time_array" if source.time_array else TIME_KEY
        if not isinstance(clock_array, str):
            pair = [self._names.fill(array_name) for array_name in clock_array]
            seconds, nanoseconds = (self._stamps(array_name, f"time of {name}", key) for array_name in pair)
            return seconds_of_pair(self._path, f"arrays {pair[0]!r} and {pair[1]!r} (time)", seconds, nanoseconds)
        array = self._names.fill(clock_array)
        stamps = self._stamps(array, f"time of {name}", key)
        if stamps.ndim != 1:
            raise InputError(f"array {array!r} (time) is {stamps.shape}, expected one number a sample", file=self._path)
        if stamps.dtype.kind in DATES:
            return seconds_of_dates(stamps)
        return seconds_by(self._path, clock, stamps)

    def _stamps(self, name: str, meaning: str, key: str) -> NDArray[Any]:
        """An array of time: integers and dates unchanged, other numbers as floats; a vector of MATLAB with one axis."""
        stored = self._stored(name, meaning, key)
        stamps = stored if stored.dtype.kind in "iu" + DATES else self._array(name, meaning, key)
        return stamps.ravel() if stamps.ndim == 2 and 1 in stamps.shape else stamps

    def _stored(self, name: str, meaning: str, key: str) -> NDArray[Any]:
        name = name.strip("/")
        if name not in self._arrays:
            suggestion, names = did_you_mean(name, self._arrays), ", ".join(self._arrays)
            text = f"no array {name!r} ({meaning}){suggestion}; found: {names}"
            raise MissingSignal(text, file=self._path, key=f"{key} of the mapping")
        return self._arrays[name]

    def _array(self, name: str, meaning: str, key: str) -> Array:
        stored = self._stored(name, meaning, key)
        if stored.dtype.kind not in REAL:
            raise InputError(f"array {name!r} ({meaning}) holds {stored.dtype}, expected real numbers", file=self._path)
        return np.asarray(stored, dtype=float)


def _arrays_of(source: SignalSource, mapping: Mapping) -> list[str]:
    """Names of the arrays of a signal and of its timestamps."""
    time = mapping.clock(source).array
    return [*([source.array] if source.array else []), *([time] if isinstance(time, str) else time)]


@once
def _read(path: Path, loaded: set[str] | None = None) -> tuple[dict[str, Array], frozenset[str]]:
    """Arrays by name, and the names without checksums; HDF5 arrays not in ``loaded`` are not loaded (left empty)."""
    if suffix_of(path) == ".npz":
        return _read_npz(path), frozenset()
    if suffix_of(path) == ".pt":
        return read_torch(path), frozenset()
    if suffix_of(path) in HDF5:
        return _read_hdf5(path, loaded)
    with path.open("rb") as file:
        is_hdf5 = file.read(128).startswith(b"MATLAB 7.3")
    if not is_hdf5:
        arrays = read_mat(path)
        return arrays, frozenset(arrays)
    arrays, unsealed = _read_hdf5(path)
    return {name: array.T for name, array in arrays.items()}, unsealed


def _read_npz(path: Path) -> dict[str, Array]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            names = list(archive.files)
            arrays = {name: np.asarray(archive[name]) for name in names}
    except Exception as error:  # a damaged archive fails in zipfile, in zlib or in NumPy
        raise InputError(f"not a readable NPZ file ({error})", file=path) from None
    if len(arrays) < len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two arrays are called {repeated!r}", file=path)
    return arrays


def _read_hdf5(path: Path, loaded: set[str] | None = None) -> tuple[dict[str, Array], frozenset[str]]:
    """Arrays by name, and the names without checksums."""
    require("h5py", path)
    import h5py

    arrays: dict[str, Array] = {}
    unsealed: set[str] = set()

    def visit(name: str | bytes, item: object) -> None:
        if isinstance(name, bytes):  # no text in UTF-8
            raise InputError(f"not a readable HDF5 file (name {name!r})", file=path)
        if not isinstance(item, h5py.Dataset):
            return
        if not _holds_numbers(item.attrs):
            return
        if loaded is not None and name not in loaded:
            arrays[name] = np.zeros(0)
            return
        if item.is_virtual or item.external:
            raise InputError(f"array {name!r} is made of other files, expected its numbers in this one", file=path)
        arrays[name] = np.zeros(0) if item.shape is None else np.asarray(item)
        # The checksum of zeros is zero: a lost block of the disk looks like measured zeros.
        if not (item.fletcher32 and all(arrays[name][chunk].any() for chunk in item.iter_chunks())):
            unsealed.add(name)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except InputError:
        raise
    except Exception as error:  # a damaged file can fail anywhere inside the library
        text = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"not a readable HDF5 file ({text})", file=path) from None
    return arrays, frozenset(unsealed)


def _holds_numbers(attributes: AbstractMapping[str, Any]) -> bool:
    """Whether an array holds numbers; MATLAB stores texts, booleans and the size of empty arrays as integers, too."""
    kind = attributes.get("MATLAB_class", b"double")
    return kind not in (b"char", b"logical", b"cell") and not attributes.get("MATLAB_empty", 0)
