# SPDX-License-Identifier: Apache-2.0
"""CSV and Parquet files: a column per joint.

A row may hold some signals only: where all cells of a signal are empty (or NaN) it has no sample.
"""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.clock import seconds_of
from impact_rs_trials.recordings.csv_rows import csv_rows
from impact_rs_trials.recordings.mapping import UNITS, Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.series import MissingSignal, Names, Series

SHOWN = 8  # column names in a message


def require(package: str, path: Path) -> None:
    """Say how to get a library that reading this file takes.

    Raises:
        InputError: It is not installed.
    """
    if find_spec(package) is None:
        raise InputError(f"{path.suffix} files need {package}: pip install 'impact-rs[export]'", file=path)


class TableFile:
    """One CSV or Parquet file.

    Args:
        path: The file.
        mapping: Where the signals are.
        names: What the placeholders of the mapping stand for.

    Raises:
        InputError: It is no such file.
    """

    def __init__(self, path: Path, mapping: Mapping, names: Names) -> None:
        self._path, self._mapping, self._names = path, mapping, names
        self._columns: AbstractMapping[str, list[str] | NDArray[Any]] = (
            _read_csv(path) if path.suffix == ".csv" else _read_parquet(path, UNITS["time"][mapping.time.unit])
        )

    @staticmethod
    def columns_of(path: Path) -> list[str]:
        """Names of the columns of a file.

        Raises:
            InputError: It is no such file.
        """
        return list(_read_csv(path) if path.suffix == ".csv" else _read_parquet(path, 1.0))

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The file lacks it.
            InputError: It cannot be used.
        """
        columns = self._named(name, source)
        if not columns:
            raise MissingSignal(f"the mapping says no column for {name}", file=self._path, key=f"signals.{name}")
        stamps = self._stamps(self._names.fill(source.time_column or self._mapping.time.column))
        values = np.column_stack([self._numbers(column, name) for column in columns])
        time = seconds_of(stamps, UNITS["time"][self._mapping.time.unit]) + source.delay
        return Series(f"column {columns[0]!r} ({name})", time, self._mapping.to_si(name, values)).sampled()

    def _named(self, name: SignalName, source: SignalSource) -> list[str]:
        if source.columns is not None:
            return [self._names.fill(column) for column in source.columns]
        if source.column is None:
            return []
        column = self._names.fill(source.column)
        return [column.replace("{joint}", str(index + 1)) for index in range(self._mapping.width(name))]

    def _stamps(self, column: str) -> NDArray[Any]:
        """A column of time, in whole numbers where it holds nothing else."""
        cells = self._columns.get(column, [])
        if isinstance(cells, list) and cells and all(cell.isascii() and cell.isdecimal() for cell in cells):
            longest = max(cells, key=len)
            try:
                return np.array([int(cell) for cell in cells], dtype=np.int64)
            except (ValueError, OverflowError):  # more digits than Python reads, or than 64 bits hold
                said = f"column {column!r} (time) has a stamp of {len(longest)} digits, expected at most 64 bits"
                raise InputError(said, file=self._path) from None
        if isinstance(cells, np.ndarray) and np.issubdtype(cells.dtype, np.integer):
            return cells
        return self._numbers(column, "time")

    def _numbers(self, column: str, name: str) -> Array:
        if column not in self._columns:
            near, found = did_you_mean(column, self._columns), list(self._columns)
            more = " ..." if len(found) > SHOWN else ""
            message = f"no column {column!r} ({name}){near}; found: {', '.join(found[:SHOWN])}{more}"
            raise MissingSignal(message, file=self._path)
        cells = self._columns[column]
        if isinstance(cells, np.ndarray):
            return np.asarray(cells, dtype=float)
        try:
            return np.array([decimal(cell or "nan") for cell in cells])
        except ValueError as error:
            raise InputError(f"not a table of numbers: {error} in column {column!r}", file=self._path) from None


def _read_csv(path: Path) -> dict[str, list[str] | NDArray[Any]]:
    rows = csv_rows(path)
    if len(rows) < 2:
        raise InputError("expected a line of column names and lines of numbers", file=path)
    header = [name.strip() for name in rows[0][1]]
    for number, row in rows:
        if len(row) != len(header):
            raise InputError(f"line {number}: {len(row)} numbers, expected {len(header)} as in the header", file=path)
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise InputError(f"two columns are called {twice!r}", file=path)
    columns = zip(*(row for _, row in rows[1:]), strict=True)
    return {name: list(cells) for name, cells in zip(header, columns, strict=True)}


def _read_parquet(path: Path, time_unit: float) -> dict[str, list[str] | NDArray[Any]]:
    require("pyarrow", path)
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
        names = [str(name) for name in table.column_names]
    except Exception as error:  # a damaged file can fail anywhere inside the library
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"not a readable Parquet file ({said})", file=path) from None
    columns: dict[str, list[str] | NDArray[Any]] = {}
    for name, column in zip(names, table.columns, strict=True):
        if pyarrow.types.is_timestamp(column.type):  # its type has a unit, which overrides the mapping
            try:
                nanoseconds = column.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
            except pyarrow.ArrowInvalid:
                said = f"column {name!r} has a stamp outside the years 1678 to 2262, which 64 bits of nanoseconds hold"
                raise InputError(said, file=path) from None
            columns[name] = seconds_of(nanoseconds.to_numpy(zero_copy_only=False), 1e-9) / time_unit
        elif pyarrow.types.is_integer(column.type) or pyarrow.types.is_floating(column.type):
            columns[name] = column.to_numpy(zero_copy_only=False)
        else:
            columns[name] = ["" if cell is None else str(cell) for cell in column.to_pylist()]
    return columns
