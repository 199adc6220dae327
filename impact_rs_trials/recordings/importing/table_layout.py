# SPDX-License-Identifier: Apache-2.0
"""Lines of names and rows of a text table, found from the text.

Rows begin at the first of several consecutive lines with equally many cells that hold numbers (or vectors, dates,
additional words). The names are in the nearest line above with as many cells; units and remarks may lie between.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.file_units import is_unit
from impact_rs_trials.recordings.importing.candidates import numbers_in
from impact_rs_trials.recordings.mapping import TableLayout
from impact_rs_trials.recordings.readers.csv_rows import decimal_sign, read_lines, separator_of, split_line
from impact_rs_trials.recordings.readers.guesses import Guess
from impact_rs_trials.recordings.readers.json_table import JSON_SUFFIXES
from impact_rs_trials.recordings.readers.text_file import suffix_of

MAX_HEADER_LINES = 60  # before the first row of numbers
MIN_TABLE_ROWS = 3  # consecutive lines of numbers that make a table
MIN_NUMERIC_SHARE = 0.5  # of the cells of a row


class NoTable(InputError):
    """A text without a table of numbers."""


def find_layout(path: Path) -> Guess:
    """The :class:`~impact_rs_trials.recordings.mapping.TableLayout` of a table; default: the format names columns.

    Raises:
        NoTable: No table begins in its first lines.
    """
    if suffix_of(path) in (".parquet", ".npy", *JSON_SUFFIXES):
        return Guess(TableLayout(), "")
    lines = [(number, line) for number, line in read_lines(path)[:MAX_HEADER_LINES] if line.strip()]
    texts = dict(lines)
    point = decimal_sign([line for _, line in lines])
    cells = {number: split_line(line.lstrip("# "), point) for number, line in lines}
    data = [number for number, line in lines if not line.startswith("#") and _is_row(cells[number])]
    for index, first in enumerate(data):
        rows = data[index : index + MIN_TABLE_ROWS]
        shapes = {(len(cells[number]), separator_of(texts[number], point)) for number in rows}
        if len(shapes) == 1 and (len(rows) == MIN_TABLE_ROWS or index == 0):
            guess = _named(cells, first, {number for number, line in lines if line.startswith("#")})
            if point == ".":
                return guess
            evidence = f"{guess.evidence}; numbers have a decimal comma"
            return replace(guess, value=guess.value.model_copy(update={"decimal": point}), evidence=evidence)
    raise NoTable(f"no table of numbers begins in its first {MAX_HEADER_LINES} lines", file=path)


def _named(cells: dict[int, list[str]], first: int, comments: set[int]) -> Guess:
    """The layout of a table whose numbers begin in line ``first``."""
    width = len(cells[first])
    above = [number for number in cells if number < first]
    if above and len(cells[above[-1]]) == width and all(map(is_unit, cells[above[-1]])):
        units, above = above[-1], above[:-1]
    else:
        units = None
    between = [number for number in above if len(cells[number]) == width and not _is_row(cells[number])]
    names = between[-1] if between else None  # a remark may stand below the names
    if names is None:
        layout = TableLayout(header=0, first=first if first > 1 else None)
        return Guess(layout, f"no line of {width} names stands above the numbers in line {first}")
    evidence = f"line {names} has {width} names, as many as the rows have cells"
    if units is not None:
        evidence += f"; units stand in line {units}"
    if len(above) > 1:
        evidence += f"; {len(above) - 1} other line{'s' if len(above) > 2 else ''} above the numbers skipped"
    next_line = above[-1] == names and units is None
    plain = names not in comments and set(above[:-1]) <= comments and next_line
    layout = TableLayout() if plain else TableLayout(header=names, first=None if next_line else first)
    return Guess(layout, evidence)


def _is_row(cells: list[str]) -> bool:
    """Whether a line holds numbers: half of its non-empty cells, and its first or second cell."""
    filled = [cell for cell in cells if cell.strip()]
    numeric = [bool(numbers_in(cell)) for cell in filled]
    return bool(filled) and sum(numeric) >= MIN_NUMERIC_SHARE * len(filled) and not all(map(_is_name, filled[:2]))


def _is_name(cell: str) -> bool:
    return not numbers_in(cell)
