# SPDX-License-Identifier: Apache-2.0
"""CSV files with one row a line: no row can vanish in a quoted cell of another row."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.readers.read_once import once
from impact_rs_trials.recordings.readers.text_file import read_text

DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
WITH_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")


def csv_rows(
    path: Path, header: int | None = None, first: int | None = None, point: str = "."
) -> list[tuple[int, list[str]]]:
    """Cells of every row with its line number, counted from 1.

    Cells are separated by commas, semicolons or tabs, whichever the first row has most of, or by blanks if it has
    none of them. Empty lines and lines that begin with # are skipped. A quoted cell ends in its line: with a stray
    quotation mark a cell would go on until the next one and swallow the rows between them.

    Args:
        path: The file, in UTF-8.
        header: Line of the names, which may begin with #; lines above it are skipped. 0: the file has no names; None:
            the first line that is not skipped.
        first: Line of the first row below the names; None: the next.
        point: Decimal sign; a comma then separates no cells, and becomes a point between two digits.

    Raises:
        InputError: It cannot be read, or a line is not a row; the message names the line.
    """
    all_lines = read_lines(path)
    lines = [(number, line) for number, line in all_lines if line.strip() and not line.lstrip().startswith("#")]
    if header:
        names = [(number, line.lstrip("# ")) for number, line in all_lines[header - 1 : header] if line.strip("# \r")]
        if not names:
            raise InputError(
                f"expected the names of the columns there; the file has {len(all_lines)} lines", file=path,
                key="table.header", value=header,
            )  # fmt: skip
        lines = names + [(number, line) for number, line in lines if number > header]
    if first is not None:
        lines = lines[: header != 0] + [(number, line) for number, line in lines[header != 0 :] if number >= first]
    if not lines:
        return []
    separator = separator_of(lines[0][1], point)
    if separator is None:
        rows = [(number, line.split()) for number, line in lines]
    else:
        rows = [(number, _cells(path, number, line, separator)) for number, line in lines]
    if point == ".":
        return rows
    return [(number, [DECIMAL_COMMA.sub(".", cell) for cell in row]) for number, row in rows]


@once
def read_lines(path: Path) -> list[tuple[int, str]]:
    """Lines of a text with their numbers, counted from 1.

    Raises:
        InputError: It cannot be read.
    """
    return list(enumerate(read_text(path).split("\n"), 1))


def decimal_sign(lines: Sequence[str]) -> str:
    """Comma if cells, separated by semicolons or tabs, hold at most one comma each, between digits."""
    rows = [re.split(r"[;\t]", line) for line in lines]
    cells = [cell.strip() for row in rows for cell in row if len(row) > 1]
    with_comma = [bool(WITH_COMMA.fullmatch(cell)) for cell in cells]
    return "," if any(with_comma) and sum(with_comma) == sum("," in cell for cell in cells) else "."


def separator_of(line: str, point: str = ".") -> str | None:
    """Separator of the cells of a line: comma, semicolon or tab, whichever is most frequent; None: blanks."""
    separator = max(";\t" if point == "," else ",;\t", key=line.count)
    return None if separator not in line and len(line.split()) > 1 else separator


def split_line(line: str, point: str = ".") -> list[str]:
    """Cells of any line; split at every separator if its quotation marks do not pair up."""
    separator = separator_of(line, point)
    if separator is None:
        cells = line.split()
    else:
        try:
            (cells,) = csv.reader([line.rstrip("\r")], delimiter=separator, skipinitialspace=True, strict=True)
        except (csv.Error, ValueError):
            cells = line.split(separator)
    return [DECIMAL_COMMA.sub(".", cell) for cell in cells] if point == "," else cells


def _cells(path: Path, number: int, line: str, separator: str) -> list[str]:
    """Cells of one line."""
    try:
        (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True)
    except csv.Error as error:
        if "field limit" in str(error):
            message = f"a cell has more than {csv.field_size_limit()} characters"
        else:
            message = (
                f'quotation marks (") do not pair up in {line[:60]!r}; a quoted cell ends in its line: remove the '
                "stray mark or the line break, or double a mark that belongs to the cell"
            )
        raise InputError(message, file=path, key=f"line {number}") from None
    return cells
