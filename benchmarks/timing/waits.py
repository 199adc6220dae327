# SPDX-License-Identifier: Apache-2.0
"""What a user waits for: processor and wall time of commands, of this version and, in turns, of another one.

Every command is run as a user types it: processor time with that of all its processes, and wall time, medians over the
turns. ``--beside CHECKOUT`` names a checkout of another version, installed (``./run sync`` there); each version reads
the campaign that it made itself. A diagnosis starts without anything in the cache.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table

HERE = Path(__file__).resolve().parents[2]
SET = ["push", "--objects", "cat_food", "--cases", "case_2", "--jobs", "2"]
COMMANDS = {  # {out} is the folder of the version, {turn} counts
    "--help": ["--help"],
    "map push cat_food case_2": ["map", "push", "cat_food", "case_2"],
    "trial push cat_food case_2, with bag": ["trial", "push", "cat_food", "case_2", "-o", "{out}/trial{turn}"],
    "campaign of 25 trials on 2 workers": ["campaign", *SET, "-o", "{out}/campaign{turn}"],
    "analyze of 25 trials, with report": ["analyze", "{out}/campaign0", "-o", "{out}/report{turn}"],
    "blind make 7 --size small, 18 trials on 2 workers": [
        "blind", "make", "7", "-o", "{out}/blind", "--size", "small", "--jobs", "2",
    ],
    "diagnose of them, on 2 workers": [
        "diagnose", "{out}/blind/runs", "-o", "{out}/diagnosis.json", "--jobs", "2",
    ],
}  # fmt: skip
ONCE = ("blind", "diagnose")  # commands of which one turn has to do


def add_options(parser: argparse.ArgumentParser) -> None:
    """Beside what, and how often."""
    parser.add_argument("--beside", type=Path, metavar="CHECKOUT", help="folder of another version, installed")
    parser.add_argument("--turns", type=int, default=3, help="how often each command is run")


def cases(options: argparse.Namespace) -> list[Case]:
    """Commands."""
    del options
    return [Case(name, command) for name, command in COMMANDS.items()]


def seconds(checkout: Path, out: Path, command: list[str], turn: int) -> tuple[float, float]:
    """Processor and wall time of one command [s].

    Raises:
        RuntimeError: It failed.
    """
    environment = os.environ | {
        "PATH": f"{checkout / '.venv' / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(checkout / ".venv"),
        "XDG_CACHE_HOME": str(out / "cache"),
    }
    out.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(out / "cache", ignore_errors=True)
    words = [word.format(out=out, turn=turn) for word in command]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    program = checkout / ".venv" / "bin" / "impact-rs"
    completed = subprocess.run([program, *words], env=environment, cwd=out, capture_output=True, text=True, check=False)
    wall_time, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if completed.returncode:
        raise RuntimeError(f"{program} {' '.join(words)}: {completed.stderr.strip()[-500:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_time


def run(case: Case, work: Work) -> Row:
    """Times of one command, by version."""
    versions = {"now": HERE} | ({} if work.options.beside is None else {"beside": work.options.beside.resolve()})
    shared, times = work.folder.parent.absolute(), {name: [] for name in versions}
    for turn in range(1 if case.inputs[0] in ONCE else work.options.turns):
        for name, checkout in versions.items():
            times[name].append(seconds(checkout, shared / "made" / name, case.inputs, turn))
    medians = {name: list(np.median(values, axis=0)) for name, values in times.items()}
    return {"taken": medians, "said": f"{medians['now'][0]:.2f} s of processor time, {medians['now'][1]:.2f} s"}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each command."""
    lines = [(f"`{row['name']}`", *(f"{value:.2f}" for value in row["taken"]["now"])) for row in rows]
    present = Table(("What", "processor time [s]", "wall time [s]"), tuple(lines))
    if options.beside is None:
        return present
    ratios = [
        (
            f"`{row['name']}`",
            f"{row['taken']['beside'][0]:.2f}",
            f"{row['taken']['beside'][0] / row['taken']['now'][0]:.2f}",
        )
        for row in rows
    ]
    return present.with_(Table(("What", "the other version [s]", "over this one"), tuple(ratios)))
