# SPDX-License-Identifier: Apache-2.0
"""Columns of a table by name: CSV and other text, Parquet, NPY, JSON.

Columns without names are ``c1``, ``c2`` and so on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.optional_packages import require
from impact_rs_trials.recordings.mapping import TableLayout
from impact_rs_trials.recordings.readers.csv_rows import csv_rows, decimal_sign, read_lines
from impact_rs_trials.recordings.readers.inner_runs import runs_of
from impact_rs_trials.recordings.readers.json_table import JSON_SUFFIXES, cell_text, read_json_table
from impact_rs_trials.recordings.readers.read_once import once
from impact_rs_trials.recordings.readers.text_file import suffix_of

Cells = dict[str, list[str] | NDArray[Any]]

MAX_SHOWN_RUNS = 8  # in a message
DEFAULT_LAYOUT = TableLayout()
MAX_TORN_SHARE = 0.1  # of the lines; with more, the header belongs to another table
HEADER_HINT = "; the names of the columns may stand in another line: table.header in the mapping says in which"


@dataclass(frozen=True)
class Columns:
    """Columns of a table.

    Attributes:
        cells: Texts or numbers by name of a column.
        lines: Line of every row in a text file; empty: not a text file.
        dates: Columns that hold dates or durations, as nanoseconds.
        remarks: Warnings about reading it.
        header: Line of the names in a text file; 0: no names.
    """

    cells: Mapping[str, list[str] | NDArray[Any]]
    lines: tuple[int, ...] = ()
    dates: frozenset[str] = frozenset()
    remarks: tuple[str, ...] = ()
    header: int = 0

    def in_rows(self, rows: NDArray[np.signedinteger]) -> Columns:
        """Some of the rows."""
        cells: dict[str, list[str] | NDArray[Any]] = {
            name: column[rows] if isinstance(column, np.ndarray) else [column[row] for row in rows]
            for name, column in self.cells.items()
        }
        return replace(self, cells=cells, lines=tuple(self.lines[row] for row in rows) if self.lines else ())


@once
def read_columns(path: Path, layout: TableLayout = DEFAULT_LAYOUT, recorded: bool = True) -> Columns:
    """The columns of a table.

    Args:
        path: The file.
        layout: Where a text has its names and rows.
        recorded: Whether it was recorded sample by sample: its last line may be cut off, and it has at least one row.
            In other tables every line has as many cells as the header, rows or header may be missing, and commas in
            all numbers between semicolons or tabs are decimal signs.

    Raises:
        InputError: It cannot be read, a line has another number of cells, or two columns share a name.
    """
    if suffix_of(path) == ".parquet":
        return _read_parquet(path)
    if suffix_of(path) in JSON_SUFFIXES:
        cells, remarks = read_json_table(path)
        return Columns(cells, remarks=remarks)
    return _read_npy(path) if suffix_of(path) == ".npy" else _read_text(path, layout, recorded)


def read_rows(path: Path, layout: TableLayout, column: str, run: str) -> Columns:
    """The columns of a table in the rows of one run.

    Args:
        path: The file.
        layout: Where a text has its names and rows.
        column: Column with the run of each row.
        run: The run.

    Raises:
        InputError: It cannot be read, or has no such column or run.
    """
    run_of_row = run_names(path, layout, column)
    rows = np.flatnonzero([name == run for name in run_of_row])
    if not rows.size:
        runs = list(dict.fromkeys(run_of_row))
        listed = ", ".join(runs[:MAX_SHOWN_RUNS]) + (" ..." if len(runs) > MAX_SHOWN_RUNS else "")
        raise InputError(f"no row is of run {run!r}{did_you_mean(run, runs)}; found: {listed}", file=path, key=column)
    if suffix_of(path) == ".parquet":
        return _read_parquet(path, (int(rows[0]), int(rows[-1]) + 1)).in_rows(rows - rows[0])
    return read_columns(path, layout).in_rows(rows)


def run_names(path: Path, layout: TableLayout, column: str) -> list[str]:
    """Name of the run of every row.

    Raises:
        InputError: The file cannot be read, or has no such column.
    """
    columns = _read_parquet(path, names=[column]) if suffix_of(path) == ".parquet" else read_columns(path, layout)
    if column not in columns.cells:
        headers = ", ".join(columns.cells)
        message = f"no column {column!r}{did_you_mean(column, columns.cells)}; found: {headers}"
        raise InputError(message, file=path, key="run_column of the mapping")
    return runs_of(columns.cells[column])


def _read_text(path: Path, layout: TableLayout, recorded: bool) -> Columns:
    point = layout.decimal if recorded else decimal_sign([line for _, line in read_lines(path)])
    rows = csv_rows(path, layout.header, layout.first, point)
    if layout.header == 0 and rows:
        rows.insert(0, (0, [f"c{number}" for number in range(1, len(rows[0][1]) + 1)]))
    if recorded and len(rows) < 2:
        raise InputError("expected a line of column names and lines of numbers", file=path)
    if not rows:
        return Columns({})
    (header_line, names), *rows = rows
    cell_kind = "numbers" if recorded else "cells"
    header, remarks = [name.strip() for name in names], []
    if recorded and len(rows) > 1 and len(rows[-1][1]) < len(header) and not path.read_bytes().endswith(b"\n"):
        number, row = rows.pop()
        message = f"line {number}, the last, is cut off ({len(row)} of {len(header)} numbers): left out"
        remarks.append(f"{path.name}: {message}")
    count = max((index + 1 for index, name in enumerate(header) if name), default=0)
    if all(_is_blank(row[count:]) for _, row in rows):  # separators at the ends of lines
        header = header[:count]
    rows = [(number, row[: len(header)] if _is_blank(row[len(header) :]) else row) for number, row in rows]
    torn = [index for index, (_, row) in enumerate(rows) if len(row) != len(header)]
    if torn:
        number, row = rows[torn[0]]
        message = (
            f"line {number}: {len(row)} {cell_kind}, expected {len(header)} as in line {header_line or rows[0][0]}"
        )
        if not recorded or len(torn) > MAX_TORN_SHARE * len(rows):
            raise InputError(f"{message}{HEADER_HINT if recorded else ''}", file=path)
        share = f"{len(torn)} of {len(rows)} lines are torn ({100.0 * len(torn) / len(rows):.2g} %)"
        remarks.append(f"{path.name}: {share}, the first in {message}: left out")
        rows = [row for index, row in enumerate(rows) if index not in set(torn)]
    lines = tuple(number for number, _ in rows)
    columns = [list(cells) for cells in zip(*(row for _, row in rows), strict=True)] or [[] for _ in header]
    cells: Cells = dict(zip(header, columns, strict=True))
    return Columns(_without_repeated_names(path, header, cells), lines, remarks=tuple(remarks), header=header_line)


def _is_blank(cells: Sequence[str]) -> bool:
    return not any(cell.strip() for cell in cells)


def _without_repeated_names(path: Path, names: Sequence[str], cells: Cells) -> Cells:
    """Columns of a file; refused if two of them have one name."""
    if len(cells) < len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise InputError(f"column {repeated!r} appears twice", file=path)
    return cells


def _read_npy(path: Path) -> Columns:
    try:
        array = np.load(path, allow_pickle=False)
    except Exception as error:  # a damaged file can fail anywhere inside the library
        raise InputError(f"not a readable NPY file ({(str(error).splitlines() or [''])[0]})", file=path) from None
    if not isinstance(array, np.ndarray):
        raise InputError("several arrays where one is expected; is it an .npz file?", file=path)
    if array.size == 0:
        raise InputError(f"an array of {array.shape} has no sample", file=path)
    if array.dtype.names is not None and array.ndim == 1:
        cells = {name: array[name] for name in array.dtype.names}
    elif array.ndim in (1, 2):
        columns = array.reshape(len(array), -1).T
        cells = {f"c{number}": column for number, column in enumerate(columns, start=1)}
    else:
        raise InputError(f"an array of {array.shape}, expected samples x columns", file=path)
    for name, column in cells.items():
        if column.dtype.kind not in "iuf" or column.ndim != 1:
            message = f"column {name!r} holds {column.dtype} {column.shape}, expected real numbers, one a sample"
            raise InputError(message, file=path)
    return Columns(cells)


def _read_parquet(path: Path, rows: tuple[int, int] | None = None, names: list[str] | None = None) -> Columns:
    """Read selected columns and a row range (default: all)."""
    require("pyarrow", path)
    import pyarrow
    import pyarrow.parquet

    try:
        if names is not None:
            names = [name for name in names if name in pyarrow.parquet.read_schema(path).names] or None
        table = pyarrow.parquet.read_table(path, columns=names)
        table = table if rows is None else table.slice(rows[0], rows[1] - rows[0])
        names = [str(name) for name in table.column_names]
    except Exception as error:  # a damaged file can fail anywhere inside the library
        text = (str(error).splitlines() or [""])[0]
        raise InputError(f"not a readable Parquet file ({type(error).__name__}: {text})", file=path) from None
    cells: Cells = {}
    dates = set()
    for name, column in zip(names, table.columns, strict=True):
        if pyarrow.types.is_timestamp(column.type) or pyarrow.types.is_duration(column.type):
            kind = pyarrow.timestamp if pyarrow.types.is_timestamp(column.type) else pyarrow.duration
            try:
                nanoseconds = column.cast(kind("ns")).cast(pyarrow.int64())
            except pyarrow.ArrowInvalid:
                message = (
                    f"column {name!r} has a stamp outside the years 1678 to 2262, which 64 bits of nanoseconds hold"
                )
                raise InputError(message, file=path) from None
            cells[name] = nanoseconds.to_numpy(zero_copy_only=False)
            dates.add(name)
        elif pyarrow.types.is_integer(column.type) or pyarrow.types.is_floating(column.type):
            cells[name] = column.to_numpy(zero_copy_only=False)
        else:
            cells[name] = [cell_text(cell) for cell in column.to_pylist()]
    return Columns(_without_repeated_names(path, names, cells), dates=frozenset(dates))
