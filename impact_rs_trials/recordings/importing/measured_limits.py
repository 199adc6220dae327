# SPDX-License-Identifier: Apache-2.0
"""Limits of joints from a recording, for a URDF without limits.

The range of a motion is no limit of the robot. It suffices to compare a recording with its model, not to plan other
motions.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.urdf_repairs import Limits
from impact_rs_trials.recordings.importing.candidates import (
    COMMANDED,
    SignalCandidate,
    candidates_of,
    single_candidates,
)
from impact_rs_trials.recordings.importing.table_layout import find_layout
from impact_rs_trials.recordings.readers.run_finder import TABLE_SUFFIXES
from impact_rs_trials.recordings.readers.table_columns import Columns, read_columns
from impact_rs_trials.recordings.readers.text_file import suffix_of

QUANTITIES = {"position": "position", "velocity": "velocity", "torque": "effort"}  # of a URDF, by signal
MAX_POSITION_RAD = 4.0 * np.pi  # positions beyond are degrees


def measured_limits(path: Path, joints: Sequence[str]) -> Limits:
    """Ranges of positions, and largest velocities and efforts, by joint and quantity; SI units.

    Args:
        path: A table with columns of the joints, by name or in the order of the joints.
        joints: Names of the joints in the URDF, base to tip.

    Raises:
        InputError: The file is no table, has no such columns, or has positions that are not in rad.
    """
    if not joints:
        return {}
    if suffix_of(path) not in TABLE_SUFFIXES:
        expected = f"expected a table ({', '.join(TABLE_SUFFIXES)}) of positions, velocities and efforts of the joints"
        raise InputError(expected, file=path, key="--measured")
    layout = find_layout(path).value
    table = read_columns(path, layout)
    limits: dict[tuple[str, str], tuple[float, ...]] = {}
    single = single_candidates(table.cells, "column") if len(joints) == 1 else []
    candidates = [
        candidate
        for candidate in (*candidates_of(path, layout), *single)
        if candidate.width == len(joints) == len(set(_columns_of(candidate, len(joints))))  # and no vectors in cells
    ]
    for candidate in sorted(candidates, key=lambda candidate: COMMANDED.search(candidate.label) is not None):
        quantity = QUANTITIES.get(candidate.guess)
        if quantity is None or (joints[0], quantity) in limits:
            continue
        for joint, values in zip(joints, _values(path, table, candidate, joints).T, strict=True):
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            limits[joint, quantity] = (low, high) if quantity == "position" else (max(-low, high),)
    if not limits:
        raise InputError(
            f"no {len(joints)} columns of positions, velocities or efforts; name them after the joints or number them: "
            f"position_{joints[0]} or q1 ... q{len(joints)}",
            file=path,
            key="--measured",
        )
    for (joint, quantity), ends in limits.items():
        if quantity == "position" and max(abs(end) for end in ends) > MAX_POSITION_RAD:
            evidence = f"joint {joint} is at {ends[0]:g} to {ends[1]:g}: expected rad or m, not degrees or mm"
            raise InputError(evidence, file=path, key="--measured")
    return limits


def _values(path: Path, table: Columns, candidate: SignalCandidate, joints: Sequence[str]) -> Array:
    """Numbers of a signal, in the order of the joints, ``(k, n)``; nan for cells without a finite number."""
    names = _columns_of(candidate, len(joints))
    column_of = {joint: column for column in names if (joint := _joint_of(column, joints)) is not None}
    if column_of and len(column_of) < len(joints):
        unnamed = ", ".join(joint for joint in joints if joint not in column_of)
        expected = f"of columns {', '.join(names)} none is named after {unnamed}; name every column after its joint"
        raise InputError(expected, file=path, key="--measured")
    if column_of:
        names = [column_of[joint] for joint in joints]
    try:
        values = np.array([[float(cell) for cell in table.cells[name]] for name in names]).T
    except ValueError as error:
        raise InputError(f"column {candidate.label}: {error}", file=path, key="--measured") from None
    values[~np.isfinite(values)] = np.nan
    if np.isnan(values).all(axis=0).any():
        raise InputError(f"column {candidate.label}: expected a finite number in it", file=path, key="--measured")
    return values


def _columns_of(candidate: SignalCandidate, count: int) -> list[str]:
    """Column of every joint; vectors in the cells of one column have the same column for all joints."""
    pattern = candidate.source.get("column", "")
    return candidate.source.get("columns") or [pattern.replace("{joint}", str(n + 1)) for n in range(count)]


def _joint_of(column: str, joints: Sequence[str]) -> str | None:
    """Longest joint name that consists of whole words of ``column``; ``_`` separates words."""
    matches = [joint for joint in joints if re.search(rf"(?<![^\W_]){re.escape(joint)}(?![^\W_])", column)]
    return max(matches, key=len, default=None)
