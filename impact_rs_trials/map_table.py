# SPDX-License-Identifier: Apache-2.0
"""The impact map for many impacts: read a table of states before, write a table with the velocities after."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole
from impact_rs_sim.impact_map.measured import solve_measured
from impact_rs_sim.impact_map.problem import ImpactMapError
from impact_rs_sim.optional_packages import require
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.impacts.impact_columns import CONDITION, DQ_AFTER, V_AFTER, W_AFTER, arm_label
from impact_rs_trials.recordings.impacts.impact_table import SUFFIXES, ImpactRow, ImpactTable
from impact_rs_trials.workers import Map

_ROWS_PER_TASK = 50  # one row takes some milliseconds


@dataclass(frozen=True)
class Answers:
    """Velocities after every row's impact.

    Attributes:
        after: u^+, joint velocities of every arm and then the twist of the centre, ``(rows, nv)`` [rad/s, m/s]; NaN
            if there is no answer.
        messages: Reason of a missing result, by row number.
    """

    after: Array
    messages: dict[int, str]


def answer_table(table: ImpactTable, map_tasks: Map = map) -> Answers:
    """Solve all rows of a table that was read as questions.

    Args:
        table: The questions.
        map_tasks: The map of a workforce (:func:`impact_rs_trials.workers.workers`); absent: this process.
    """
    chunks = [table.rows[start : start + _ROWS_PER_TASK] for start in range(0, len(table.rows), _ROWS_PER_TASK)]
    after: list[Array] = []
    messages: dict[int, str] = {}
    for answered, messages_of_chunk in map_tasks(_answer, chunks):
        after.extend(answered)
        messages |= messages_of_chunk
    return Answers(np.array(after), messages)


def _answer(rows: Sequence[ImpactRow]) -> tuple[list[Array], dict[int, str]]:
    after, messages = [], {}
    for row in rows:
        try:
            after.append(solve_measured(row.physics, row.impact)[0])
        except ImpactMapError as error:
            after.append(np.full_like(row.after, np.nan))
            messages[row.number] = str(error)
    return after, messages


def check_answers(target: Path) -> None:
    """Check the file for answers before they are computed.

    Raises:
        InputError: Neither CSV nor Parquet, or pyarrow is missing.
    """
    if target.suffix not in SUFFIXES:
        raise InputError(f"expected a table ({' or '.join(SUFFIXES)})", file=target)
    if target.suffix == ".parquet":
        require("pyarrow", target)


def write_answers(table: ImpactTable, answers: Answers, target: Path) -> None:
    """Write row number, condition and velocities after, in columns named as in tables of impacts.

    Raises:
        InputError: As :func:`check_answers`, or the file cannot be written.
    """
    check_answers(target)
    columns: dict[str, list[object]] = {
        "row": [row.number for row in table.rows],
        CONDITION.header: [row.condition for row in table.rows],
        **{name: values.tolist() for name, values in zip(_headers(table), answers.after.T, strict=True)},
        "message": [answers.messages.get(row.number, "") for row in table.rows],
    }
    with whole(target) as temporary:
        if target.suffix == ".csv":
            with temporary.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(columns)
                writer.writerows(zip(*columns.values(), strict=True))
        else:
            import pyarrow
            import pyarrow.parquet

            pyarrow.parquet.write_table(pyarrow.table(columns), temporary)


def _headers(table: ImpactTable) -> list[str]:
    """Headers of the velocities after, in the order of :attr:`Answers.after`."""
    facts = {arm: physics.facts for arm, physics in table.rows[0].physics.arms.items()}
    joint_columns = [column for arm in table.arms for column in DQ_AFTER.of_arm(arm_label(arm, table.arms), facts[arm])]
    return [header for column in (*joint_columns, V_AFTER, W_AFTER) for header in column.headers]
