# SPDX-License-Identifier: Apache-2.0
"""Runs inside of one file: groups of an HDF5 file that hold the same arrays, episodes in the rows of a table.

    Rec_001/robot/q, Rec_002/robot/q        arrays {run}/robot/q of the runs Rec_001 and Rec_002
    episode_index 0 0 0 1 1 1               run_column: episode_index, of the runs 0 and 1

Such a run has the name of a file in a folder: ``recordings.h5/Rec_001``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as AbstractMapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

RUN = "{run}"
RUN_NUMBER = re.compile(r"(^|[_.])(episode|run|trial|rollout|demo|recording)([_.]?(index|idx|id|nr|no|number))?$", re.I)
RECORDING_NAME = re.compile(
    r"^\d[\d_:.T-]*$|rec|run|trial|episode|demo|hit|take|toss|throw|drop|impact|exp|test|shot|sample", re.I
)
MIN_ROWS_OF_RUN = 20


@dataclass(frozen=True)
class RunGroups:
    """Groups of a file with equally named arrays.

    Attributes:
        before: Path of the groups in the file, with a slash at its end.
        names: Names of the groups.
        recorded: Whether the names look like recordings; if not, the groups may be arms or sensors.
    """

    before: str
    names: tuple[str, ...]
    recorded: bool

    def with_placeholder(self, array: str) -> str | None:
        """Name of an array with ``{run}`` for the first group, unchanged outside of groups; None: in another group."""
        for number, name in enumerate(self.names):
            start = f"{self.before}{name}/"
            if array.startswith(start):
                return f"{self.before}{RUN}/{array.removeprefix(start)}" if number == 0 else None
        return array


def run_groups_of(arrays: Iterable[str]) -> RunGroups | None:
    """Groups whose names differ in numbers alone and that have an array in common; None: not found.

    Args:
        arrays: Names of the arrays of a file.
    """
    parts = [name.split("/") for name in arrays]
    for depth in range(max(map(len, parts), default=0) - 1):
        families: dict[tuple[str, str], dict[str, set[str]]] = {}
        for part in parts:
            if len(part) > depth + 1:
                family = "/".join(part[:depth]), re.sub(r"\d+", "0", part[depth])
                families.setdefault(family, {}).setdefault(part[depth], set()).add("/".join(part[depth + 1 :]))
        for (before, _), groups in families.items():
            if len(groups) > 1 and set.intersection(*groups.values()):
                recorded = all(RECORDING_NAME.search(name) for name in groups)
                return RunGroups(f"{before}/" if before else "", tuple(groups), recorded)
    return None


def runs_of(cells: Sequence[str] | NDArray[Any]) -> list[str]:
    """Names of the run of every row."""
    if isinstance(cells, np.ndarray):
        return [f"{cell:.15g}" if isinstance(cell, float) else str(cell) for cell in cells.tolist()]
    return [cell.strip() for cell in cells]


def run_column_of(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> str | None:
    """The column that numbers the runs of a table in consecutive rows; None: the table holds one run."""
    for name, cells in columns.items():
        if RUN_NUMBER.search(name):
            runs = runs_of(cells)
            starts = [row for row, run in enumerate(runs) if row == 0 or run != runs[row - 1]]
            lengths = np.diff([*starts, len(runs)])
            if len(starts) == len(set(runs)) > 1 and min(lengths) >= MIN_ROWS_OF_RUN:
                return name
    return None
