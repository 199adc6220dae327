# SPDX-License-Identifier: Apache-2.0
"""Whether the time left that a diagnosis shows is true.

The share of the last two thirds of a diagnosis in which the time left that the terminal shows is within 30 % of the
true one, and the median of their ratio. All times are processor times of one process, so that other work on the machine
does not count. ``--diagnose`` names the arguments of each command, in quotes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shlex
import time
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_cli.main import main
from impact_rs_sim import progress
from impact_rs_workbench.remaining import STAGES, Remaining, remaining, smoothed

MAX_ERROR = 0.3  # of the true time left
SKIPPED_SHARE = 1.0 / 3.0  # of a diagnosis, at its start
LOOKS = 300  # evenly over the rest


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which diagnoses."""
    parser.add_argument("--diagnose", nargs="+", required=True, metavar="ARGUMENTS", help="of each command, in quotes")


def cases(options: argparse.Namespace) -> list[Case]:
    """Commands, named by their data."""
    return [
        Case(shlex.split(words)[0].rstrip("/").rsplit("/", 1)[-1], shlex.split(words)) for words in options.diagnose
    ]


def run(case: Case, work: Work) -> Row:
    """True and shown time left over a diagnosis."""
    folder = work.folder
    folder.mkdir(parents=True, exist_ok=True)
    reported: list[tuple[float, dict[str, Any]]] = []
    update = progress.ProgressFile.update

    def watched(file: progress.ProgressFile, stage: str, done: int, total: int | None) -> None:
        update(file, stage, done, total)
        if file.document:
            reported.append((time.process_time(), file.document))

    begin = time.process_time()
    with (
        patch.object(progress, "time", SimpleNamespace(time=time.process_time)),
        patch.object(progress.ProgressFile, "update", watched),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        main(["diagnose", *case.inputs, "--jobs", "1", "-o", str(folder / "diagnosis.json")])
    end = time.process_time()
    ratios = _ratios(reported, begin, end)
    stages: dict[str, float] = reported[-1][1]["stages"] if reported else {}
    right = float(np.mean(np.abs(ratios - 1.0) <= MAX_ERROR))
    return {
        "seconds": end - begin,
        "stages": stages,
        "right": right,
        "ratio": float(np.median(ratios)),
        "said": f"{100.0 * right:.0f} % of {end - begin:.1f} s within {100.0 * MAX_ERROR:.0f} %",
    }


def _ratios(reported: list[tuple[float, dict[str, Any]]], begin: float, end: float) -> np.ndarray:
    """Shown over true time left [-]; 0 where no time is shown."""
    looks = begin + (end - begin) * np.linspace(SKIPPED_SHARE, 1.0, LOOKS, endpoint=False)
    ratios, shown, number = np.zeros(LOOKS), None, 0
    for index, now in enumerate(looks):
        while number < len(reported) and reported[number][0] <= now:
            new: Remaining = remaining(reported[number][1], STAGES["diagnose"], reported[number][0])
            shown, number = smoothed(shown, new), number + 1
        if shown is not None and shown.seconds is not None:
            ratios[index] = max(0.0, shown.seconds - (now - shown.time)) / (end - now)
    return ratios


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each diagnosis."""
    del options
    lines = [(r["name"], f"{r['seconds']:.1f}", f"{100.0 * r['right']:.0f}", f"{r['ratio']:.2f}") for r in rows]
    return Table(
        ("Diagnosis", "processor time [s]", "of the last two thirds within 30 % [%]", "shown over true, median"),
        tuple(lines),
    )
