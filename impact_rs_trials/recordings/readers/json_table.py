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
MIN_JSON_ROWS = 3  # fewer are a description, as the limits of a joint
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
            found = json.loads(text)
        except json.JSONDecodeError as error:
            if error.msg != "Extra data":
                raise
            found = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a readable JSON file ({str(error).splitlines()[0]})", file=path) from None
    tables = list(_tables("", found))
    if len(tables) != 1:
        listed = f"; tables: {', '.join(where for where, _ in tables[:MAX_SHOWN_NAMES])}" if tables else ""
        raise InputError(f"{'several tables' if tables else 'no table'} in it, {EXPECTED}{listed}", file=path)
    [(where, columns)] = tables
    inside = {where.removesuffix(".")} if isinstance(found, dict) and where else set()
    inside |= {f"{where}{name}" for name in columns}
    outside = [name for name, _ in _flat("", found) if name not in inside]
    listed = ", ".join(outside[:MAX_SHOWN_NAMES]) + (" ..." if len(outside) > MAX_SHOWN_NAMES else "")
    remarks = (f"{path.name}: not part of its table, and not read: {listed}",) if outside else ()
    return {name: _cells(own) for name, own in columns.items()}, remarks


def _tables(where: str, value: Any) -> list[tuple[str, dict[str, Sequence[Any]]]]:
    """Tables in a value, with the path of each, which ends with a dot; empty: the value itself."""
    if isinstance(value, list):
        if len(value) < MIN_JSON_ROWS or not all(isinstance(row, dict) for row in value):
            return []
        rows = [dict(_flat("", row)) for row in value]
        names = dict.fromkeys(name for row in rows for name in row)
        return [(where, {name: [row.get(name) for row in rows] for name in names})]
    if not isinstance(value, dict):
        return []
    lists = {name: own for name, own in value.items() if isinstance(own, list) and len(own) >= MIN_JSON_ROWS}
    lists = {name: own for name, own in lists.items() if not any(isinstance(one, dict) for one in own)}
    longest = max(map(len, lists.values()), default=0)
    columns: dict[str, Sequence[Any]] = {name: own for name, own in lists.items() if len(own) == longest}
    if len(columns) > 1:
        return [(where, columns)]
    return [table for name, own in value.items() for table in _tables(f"{where}{name}.", own)]


def _flat(where: str, value: Any) -> list[tuple[str, Any]]:
    """Values of an object by their path."""
    if not isinstance(value, dict):
        return [(where.removesuffix("."), value)] if where else []
    return [item for name, own in value.items() for item in _flat(f"{where}{name}.", own)]


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
        return " ".join("nan" if one is None else cell_text(one) for one in cell)
    return str(int(cell)) if isinstance(cell, bool) else str(cell)
