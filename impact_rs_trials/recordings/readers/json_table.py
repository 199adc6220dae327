# SPDX-License-Identifier: Apache-2.0
r"""Tables in JSON: a list of records, an object of columns, or one record a line.

    [{"t": 0.0, "q": [0.1, 0.2]}, ...]                    records
    {"kp": 8, "entries": [{"t": 0.0, "q": 0.1}, ...]}     records, and values outside of them
    {"t": [0.0, ...], "q": [[0.1, 0.2], ...]}             columns
    {"t": 0.0, "q": 0.1}\n{"t": 0.01, ...}\n             JSON lines

Objects inside a record make columns ``outer.inner``. The numbers of a list are one cell, as in other tables.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.readers.text_file import read_text

JSON_SUFFIXES = (".json", ".jsonl")
MIN_JSON_ROWS = 3  # a shorter list is a description, for example the limits of a joint
MAX_SHOWN_NAMES = 8  # values in a message
EXPECTED = (
    "expected a list of records with a value of each signal, an object with a list of values for each signal, or one "
    "record a line"
)


def read_json_table(path: Path) -> tuple[dict[str, list[str] | NDArray[Any]], tuple[str, ...]]:
    """Columns of a table in JSON, and warnings about values outside of it.

    Raises:
        InputError: It cannot be read, or holds no table or several.
    """
    text = read_text(path)
    try:
        try:
            content = json.loads(text)
        except json.JSONDecodeError as error:
            if error.msg != "Extra data":
                raise
            content = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a readable JSON file ({str(error).splitlines()[0]})", file=path) from None
    tables = list(_tables("", content))
    if len(tables) != 1:
        listed = (
            f"; tables: {', '.join(path_in_file for path_in_file, _ in tables[:MAX_SHOWN_NAMES])}" if tables else ""
        )
        raise InputError(f"{'several tables' if tables else 'no table'} in it, {EXPECTED}{listed}", file=path)
    [(path_in_file, columns)] = tables
    inside = {path_in_file.removesuffix(".")} if isinstance(content, dict) and path_in_file else set()
    inside |= {f"{path_in_file}{name}" for name in columns}
    outside = [name for name, _ in _flat("", content) if name not in inside]
    listed = ", ".join(outside[:MAX_SHOWN_NAMES]) + (" ..." if len(outside) > MAX_SHOWN_NAMES else "")
    remarks = (f"{path.name}: not part of its table, and not read: {listed}",) if outside else ()
    return {name: _cells(column) for name, column in columns.items()}, remarks


def _tables(prefix: str, value: Any) -> list[tuple[str, dict[str, Sequence[Any]]]]:
    """Tables in a JSON value, each with its path, which ends with a dot; an empty path is the value itself."""
    if isinstance(value, list):
        if len(value) < MIN_JSON_ROWS or not all(isinstance(row, dict) for row in value):
            return []
        rows = [dict(_flat("", row)) for row in value]
        names = dict.fromkeys(name for row in rows for name in row)
        return [(prefix, {name: [row.get(name) for row in rows] for name in names})]
    if not isinstance(value, dict):
        return []
    lists = {name: items for name, items in value.items() if isinstance(items, list) and len(items) >= MIN_JSON_ROWS}
    lists = {name: items for name, items in lists.items() if not any(isinstance(item, dict) for item in items)}
    longest = max(map(len, lists.values()), default=0)
    columns: dict[str, Sequence[Any]] = {name: items for name, items in lists.items() if len(items) == longest}
    if len(columns) > 1:
        return [(prefix, columns)]
    return [table for name, items in value.items() for table in _tables(f"{prefix}{name}.", items)]


def _flat(prefix: str, value: Any) -> list[tuple[str, Any]]:
    """Paths and values of the members of a JSON object, at all depths."""
    if not isinstance(value, dict):
        return [(prefix.removesuffix("."), value)] if prefix else []
    return [item for name, inner in value.items() for item in _flat(f"{prefix}{name}.", inner)]


def _cells(column: Sequence[Any]) -> list[str] | NDArray[Any]:
    """Numbers as an array, anything else as text."""
    if all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in column):
        return np.array(column)
    return [cell_text(cell) for cell in column]


def cell_text(cell: Any) -> str:
    """Text of a cell that is no number; the numbers of a list are joined by blanks, ``nan`` for a null among them."""
    if cell is None:
        return ""
    if isinstance(cell, list):
        return " ".join("nan" if item is None else cell_text(item) for item in cell)
    return str(int(cell)) if isinstance(cell, bool) else str(cell)
