# SPDX-License-Identifier: Apache-2.0
"""Tables (CSV, text, Parquet, NPY, JSON): a column per joint, or one column with all joints in a cell, ``0.1 0.2 0.3``.

A row may hold some signals only: a signal whose cells are all empty (or NaN) has no sample there.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.mapping import Mapping, SignalName, SignalSource, TableLayout
from impact_rs_trials.recordings.readers.clock import seconds_by, seconds_of, seconds_of_pair
from impact_rs_trials.recordings.readers.series import MissingSignal, Names, Series
from impact_rs_trials.recordings.readers.table_columns import read_columns, read_rows

MAX_SHOWN_COLUMNS = 8  # in a message
BRACKETS = "[](){} \t"  # around the numbers of a cell
BETWEEN = re.compile(r"[\s,;]+")
DATE = re.compile(
    r"(\d{4})[-/](\d\d)[-/](\d\d)[T ](\d\d):(\d\d):(\d\d)(?:[.,](?P<fraction>\d{1,9}))?"
    r" ?(?P<zone>Z|(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d))?",
    re.ASCII,
)


class TableFile:
    """One table.

    Args:
        path: The file.
        mapping: Where the signals are.
        names: Values of the placeholders of the mapping.

    Raises:
        InputError: It is no such file.
    """

    def __init__(self, path: Path, mapping: Mapping, names: Names) -> None:
        self._path, self._mapping, self._names = path, mapping, names
        sources = [
            source for source in mapping.signals.values() if source.file and names.fill(source.file) == path.name
        ]
        layouts = [source.table for source in sources if source.table is not None]
        layout = layouts[0] if layouts else mapping.table
        if mapping.run_column is None:
            self._columns = read_columns(path, layout)
        else:
            self._columns = read_rows(path, layout, mapping.run_column, names.run)

    @staticmethod
    def columns_of(path: Path, layout: TableLayout | None = None) -> list[str]:
        """Names of the columns of a file.

        Raises:
            InputError: It is no such file.
        """
        return list(read_columns(path, layout or TableLayout()).cells)

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The file lacks it.
            InputError: It cannot be used.
        """
        columns = self._column_names(name, source)
        if not columns:
            raise MissingSignal(f"the mapping says no column for {name}", file=self._path, key=f"signals.{name}")
        key = f"signals.{name}.{'column' if source.columns is None else 'columns'}"
        if source.column is not None and "{joint}" not in source.column and self._mapping.width(name) > 1:
            values = self._vectors(columns[0], name, key, source.entries)
        else:
            values = np.column_stack([self._numbers(column, name, key) for column in columns])
        time = self._seconds(source, name, len(values)) + source.delay
        label, remarks = f"column {columns[0]!r} ({name})", self._columns.remarks
        return Series(label, time, self._mapping.to_si(name, values), remarks=remarks).sampled()

    def _column_names(self, name: SignalName, source: SignalSource) -> list[str]:
        if source.columns is not None:
            return [self._names.fill(column) for column in source.columns]
        if source.column is None:
            return []
        column = self._names.fill(source.column)
        return [column.replace("{joint}", str(index + 1)) for index in range(self._mapping.width(name))]

    def _seconds(self, source: SignalSource, name: SignalName, samples: int) -> Array:
        """Stamps of a signal [s]."""
        clock = self._mapping.clock(source)
        if clock.rate is not None and clock.unit != "frames":
            return np.asarray(np.arange(samples) / clock.rate)
        clock_column = clock.column
        key = "time.column" if source.time_column is None else f"signals.{name}.time_column"
        if not isinstance(clock_column, str):
            pair = [self._names.fill(column_name) for column_name in clock_column]
            for column_name in pair:
                self._cells(column_name, "time", key)
            seconds, nanoseconds = (self._stamps(column_name, key) for column_name in pair)
            return seconds_of_pair(self._path, f"columns {pair[0]!r} and {pair[1]!r} (time)", seconds, nanoseconds)
        column = self._names.fill(clock_column)
        cells = self._cells(column, "time", key)
        if column in self._columns.dates:
            return seconds_of(np.asarray(cells), 1e-9)
        if clock.unit == "date":
            if not isinstance(cells, list):
                message = f"column {column!r} holds numbers, expected their unit: s, ms, us or ns"
                raise InputError(message, file=self._path, key="time.unit", value=clock.unit)
            return seconds_of(np.array([self._date(cell, row, column) for row, cell in enumerate(cells)]), 1e-9)
        return seconds_by(self._path, clock, self._stamps(column, key))

    def _stamps(self, column: str, key: str) -> NDArray[Any]:
        """A column of time, as integers if all its cells are integers."""
        cells = self._columns.cells[column]
        if isinstance(cells, list) and cells and all(cell.isascii() and cell.isdecimal() for cell in cells):
            longest = max(cells, key=len)
            try:
                return np.array([int(cell) for cell in cells], dtype=np.int64)
            except (ValueError, OverflowError):  # more digits than Python reads, or than 64 bits hold
                message = f"column {column!r} (time) has a stamp of {len(longest)} digits, expected at most 64 bits"
                raise InputError(message, file=self._path) from None
        if isinstance(cells, np.ndarray) and np.issubdtype(cells.dtype, np.integer):
            return cells
        return self._numbers(column, "time", key)

    def _date(self, cell: str, row: int, column: str) -> int:
        """Nanoseconds from 1970 to a date, UTC without a zone."""
        match = DATE.fullmatch(cell.strip())
        if match is None:
            message = f"{shortened(cell, 40)!r}, expected a date as 2026-11-25 12:00:00.5 or an instant with its zone"
            raise self._wrong(message, row, column)
        try:
            year, month, day, hour, minute, second = map(int, match.groups()[:6])
            local = int(datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp())
        except ValueError as error:
            raise self._wrong(f"{cell.strip()!r} is no date: {error}", row, column) from None
        zone_offset = int(f"{match['sign'] or '+'}1") * (
            3600 * int(match["hours"] or 0) + 60 * int(match["minutes"] or 0)
        )
        return (local - zone_offset) * 10**9 + int((match["fraction"] or "0").ljust(9, "0"))

    def _cells(self, column: str, name: str, key: str) -> list[str] | NDArray[Any]:
        if column not in self._columns.cells:
            suggestion, names = did_you_mean(column, self._columns.cells), list(self._columns.cells)
            more = " ..." if len(names) > MAX_SHOWN_COLUMNS else ""
            message = f"no column {column!r} ({name}){suggestion}; found: {', '.join(names[:MAX_SHOWN_COLUMNS])}{more}"
            raise MissingSignal(message, file=self._path, key=f"{key} of the mapping")
        return self._columns.cells[column]

    def _numbers(self, column: str, name: str, key: str) -> Array:
        cells = self._cells(column, name, key)
        if isinstance(cells, np.ndarray):
            return np.asarray(cells, dtype=float)
        return np.array([self._number(cell or "nan", row, column) for row, cell in enumerate(cells)])

    def _vectors(self, column: str, name: SignalName, key: str, entries: tuple[int, ...] | None) -> Array:
        """Numbers of cells that hold a whole sample each, ``(k, width)``; nan for an empty cell."""
        cells, width = self._cells(column, name, key), self._mapping.width(name)
        rows, count = np.full((len(cells), width), np.nan), 0
        for row, cell in enumerate(cells):
            parts = [part for part in BETWEEN.split(str(cell).strip(BRACKETS)) if part]
            if entries is not None and parts:
                count = count or max(len(parts), max(entries))
                if len(parts) != count:
                    message = f"{len(parts)} numbers in a cell, expected {count}"
                    raise self._wrong(f"{message}, as many in all rows and all that entries names", row, column)
                parts = [parts[entry - 1] for entry in entries]
            if len(parts) not in (0, width):
                message = (
                    f"{len(parts)} numbers in a cell, expected {width} with blanks between them; where each number has "
                    "a column of its own, {joint} in the name stands for 1, 2, ...; where there are more, entries in "
                    "the mapping says which"
                )
                raise self._wrong(message, row, column)
            rows[row, : len(parts)] = [self._number(part, row, column) for part in parts]
        return rows

    def _number(self, cell: str, row: int, column: str) -> float:
        try:
            return decimal(cell)
        except ValueError as error:
            remedy = "; table.decimal: ',' in the mapping reads decimal commas" if "," in cell else ""
            raise self._wrong(f"{error}{remedy}", row, column) from None

    def _wrong(self, message: str, row: int, column: str) -> InputError:
        """Error in a cell."""
        lines = self._columns.lines
        where = f"line {lines[row]}" if lines else f"row {row + 1}"
        return InputError(f"not a table of numbers: {message} in column {column!r}", file=self._path, key=where)
