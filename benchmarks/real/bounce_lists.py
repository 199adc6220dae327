# SPDX-License-Identifier: Apache-2.0
"""Arrays of heights or of times between bounces, in a file of Python, as a table of impacts.

    python benchmarks/real/bounce_lists.py heights data.py ball4_H0 ball4_H1 table.csv      # [cm], a row per height
    python benchmarks/real/bounce_lists.py times data.py ball4_intervals_h table.csv        # [s], a row per bounce

The file is parsed and not run.
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

import numpy as np


def arrays_in(path: Path) -> dict[str, np.ndarray]:
    """Two-dimensional arrays of numbers by the names to which a file assigns them."""
    arrays = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)):
            continue
        if isinstance(node.value, ast.Call) and node.value.args:
            try:
                arrays[node.targets[0].id] = np.array(ast.literal_eval(node.value.args[0]), dtype=float)
            except ValueError:
                continue
    return arrays


def heights(arrays: dict[str, np.ndarray], before: str, after: str) -> tuple[str, np.ndarray]:
    """Mean drop height and every rebound from it."""
    pairs = zip(arrays[before], arrays[after], strict=True)
    rows = [(float(np.mean(drop)), rebound) for drop, rebounds in pairs for rebound in rebounds]
    return "drop_height [cm],rebound_height [cm],condition", np.column_stack((rows, [row[0] for row in rows]))


def times(arrays: dict[str, np.ndarray], prefix: str) -> tuple[str, np.ndarray]:
    """Every time between bounces with the next one of its drop; rows of an array are bounces, columns are drops."""
    chosen = [array for name, array in sorted(arrays.items()) if name.startswith(prefix) and array.ndim == 2]
    return "flight_before [s],flight_after [s]", np.vstack(
        [np.column_stack(pair) for intervals in chosen for drop in intervals.T for pair in [(drop[:-1], drop[1:])]]
    )


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("kind", choices=("heights", "times"))
    parser.add_argument("file", type=Path)
    parser.add_argument("names", nargs="+", help="names of the arrays, or the beginning of their names")
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    kind = {"heights": heights, "times": times}[arguments.kind]
    header, rows = kind(arrays_in(arguments.file), *arguments.names)
    np.savetxt(arguments.output, rows, delimiter=",", header=header, comments="", fmt="%.9g")


if __name__ == "__main__":
    main()
