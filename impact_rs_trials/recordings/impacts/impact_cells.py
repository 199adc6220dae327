# SPDX-License-Identifier: Apache-2.0
"""Cells of a table of impacts as numbers in SI units; errors name row, column, found and expected value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.file_units import FACTORS
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup, Range, name_and_unit, with_unit
from impact_rs_trials.recordings.readers import table_columns

Absent = TypeVar("Absent", float, None)

MAX_NUMBER = 1e12  # in any unit: larger than any measured number, and its square is finite


@dataclass(frozen=True)
class FileColumn:
    """A known column of a file.

    Attributes:
        header: Header.
        unit: Unit in the header; empty for text.
        factor: Factor from that unit to SI.
        range: Range of the numbers.
    """

    header: str
    unit: str
    factor: float
    range: Range


@dataclass(frozen=True)
class ImpactCells:
    """The cells of a table of impacts.

    Attributes:
        path: The file.
        columns: Cells by header.
        by_name: Known columns by name.
        unknown: Headers of unknown columns.
        scale: Factors by name of a column, for variants of the table [-].
        assumed: Assumptions by which columns were computed, as text.
    """

    path: Path
    columns: Mapping[str, list[str] | NDArray[Any]]
    by_name: Mapping[str, FileColumn]
    unknown: tuple[str, ...]
    scale: Mapping[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))

    def __contains__(self, column: object) -> bool:
        """Whether the table has a column, by name, or some of the columns of a quantity."""
        if isinstance(column, ColumnGroup):
            return any(name in self.by_name for name in column.names)
        return column in self.by_name

    def header(self, column: ColumnGroup) -> str:
        """Header of the first existing column of a quantity."""
        return next(self.by_name[name].header for name in column.names if name in self.by_name)

    def error(self, row: int, where: str, value: object, message: str) -> InputError:
        """Error in a row.

        Args:
            row: Position of the row.
            where: The column, or a quantity from several columns.
            value: Value of the cell.
            message: Expected value.
        """
        return InputError(message, file=self.path, key=f"{name_of_row(row + 1)}, {where}", value=value)

    def column_error(self, row: int, name: str, value: object, message: str) -> InputError:
        """Error in the cell of a known column."""
        return self.error(row, f"column {self.by_name[name].header!r}", value, message)

    def text(self, row: int, name: str) -> str:
        """A cell as text; empty if it is empty, or the table has no such column."""
        return _text(self.columns[self.by_name[name].header][row]) if name in self.by_name else ""

    def value(self, row: int, name: str) -> float:
        """The number in a cell, in SI units.

        Raises:
            InputError: The cell is empty, holds no finite number, or one outside the range of the column.
        """
        column = self.by_name[name]
        unit, cell = column.unit, self.columns[column.header][row]
        if not _text(cell):
            raise self.column_error(row, name, None, f"this cell is empty; expected a number [{unit}]")
        try:
            number = decimal(cell) if isinstance(cell, str) else float(cell)
        except ValueError:
            raise self.column_error(row, name, cell, f"expected a number [{unit}]") from None
        if not np.isfinite(number):
            raise self.column_error(row, name, number, f"expected a finite number [{unit}]")
        if abs(number) > MAX_NUMBER:
            raise self.column_error(row, name, number, f"expected a number up to {MAX_NUMBER:g} [{unit}]")
        number *= self.scale.get(name, 1.0)
        if not column.range.holds(number * column.factor):
            raise self.column_error(row, name, number, f"expected {column.range.words} [{unit}]")
        return number * column.factor

    def value_or(self, row: int, column: ColumnGroup, absent: Absent) -> float | Absent:
        """The number in a cell; ``absent`` in a table without the column."""
        return self.value(row, column.first) if column in self else absent

    def values(self, row: int, names: Sequence[str]) -> Array:
        """Numbers in several cells, in SI units, ``(k,)``."""
        return np.array([self.value(row, name) for name in names])

    def circumstances(self, covariates: Mapping[str, str]) -> list[dict[str, float | str]]:
        """Covariates of every row: numbers if all cells of the column are numbers, else names of levels.

        Args:
            covariates: Headers by name.

        Raises:
            InputError: A cell is empty, or a number is not finite.
        """
        rows: list[dict[str, float | str]] = [{} for _ in range(len(self))]
        for name, header in covariates.items():
            levels = [_text(cell) for cell in self.columns[header]]
            for row, level in enumerate(levels):
                if not level:
                    message = "this cell is empty; a covariate has a value"
                    raise self.error(row, f"column {header!r}", None, message)
            values: Sequence[float | str] = _numbers(levels) or levels
            for row, value in enumerate(values):
                if isinstance(value, float) and not np.isfinite(value):
                    raise self.error(row, f"column {header!r}", value, "expected a finite number")
                rows[row][name] = value
        return rows


def name_of_row(number: int) -> str:
    """Name of a row, counted from 1 without the header."""
    return f"row {number}"


def read_cells(path: Path, groups: Iterable[ColumnGroup]) -> ImpactCells:
    """Read a table of impacts.

    Args:
        path: CSV or Parquet file.
        groups: Known columns.

    Raises:
        InputError: It is no table, has no row, or a column has an unknown unit.
    """
    table = table_columns.read_columns(path, recorded=False)
    if not table.cells:
        raise InputError("no header; expected names of columns with their units", file=path)
    columns = {
        header: [str(stamp) for stamp in np.asarray(cells).astype("datetime64[ns]")] if header in table.dates else cells
        for header, cells in table.cells.items()
    }
    groups_by_name = {name: group for group in groups for name in group.names}
    by_name: dict[str, FileColumn] = {}
    unknown: list[str] = []
    for header in columns:
        name, unit = name_and_unit(header)
        if name in by_name:
            message = f"columns {by_name[name].header!r} and {header!r}: expected one of them"
            raise InputError(message, file=path)
        if name in groups_by_name:
            by_name[name] = _file_column(path, header, name, unit, groups_by_name[name])
        else:
            unknown.append(header)
    cells = ImpactCells(path, columns, by_name, tuple(unknown))
    if not len(cells):
        raise InputError("no rows; expected one per impact", file=path)
    return cells


def _file_column(path: Path, header: str, name: str, unit: str, column: ColumnGroup) -> FileColumn:
    """A known column, with the factor of the unit in its header."""
    factors = FACTORS[column.unit] if column.unit else FACTORS["-"]
    if not unit and column.unit in ("", "-"):
        return FileColumn(header, column.unit, 1.0, column.range)
    if unit not in factors:
        message = f"unit {unit!r}" if "[" in header else "no unit"
        expected = " or ".join(f"'{with_unit(name, alternative)}'" for alternative in factors)
        raise InputError(f"column {header!r} has {message}; expected {expected}", file=path)
    return FileColumn(header, unit, factors[unit], column.range)


def _text(cell: object) -> str:
    """A cell as text; a missing number of a Parquet file is an empty cell."""
    return "" if isinstance(cell, float | np.floating) and np.isnan(cell) else str(cell).strip()


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """Numbers of all cells of a column; None: some cell holds no number."""
    try:
        return [decimal(text) for text in texts]
    except ValueError:
        return None
