# SPDX-License-Identifier: Apache-2.0
"""What a user waits for, in this version and in an older one, in turns.

    ./run python benchmarks/versions.py CHECKOUT -o DIR [--turns 3] [--only analyze ...]

CHECKOUT is a checkout of the older version, installed (``./run sync`` there). Every command is run by both, one after
the other, as a user types it: processor time with that of all its processes, and wall time, medians over the turns.
Each version reads the campaign that it made itself; a diagnosis starts without anything in the cache.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

HERE = Path(__file__).resolve().parents[1]
SET = ["push", "--objects", "cat_food", "--cases", "case_2", "--jobs", "2"]


@dataclass(frozen=True)
class Task:
    """One row of the table.

    Attributes:
        name: What it is.
        command: Arguments of ``impact-rs``; ``{out}`` is the folder of the version, ``{turn}`` counts.
        once: Whether one turn has to do.
    """

    name: str
    command: list[str]
    once: bool = False


TASKS = [
    Task("help", ["--help"]),
    Task("map", ["map", "push", "cat_food", "case_2"]),
    Task("trial with bag", ["trial", "push", "cat_food", "case_2", "-o", "{out}/trial{turn}"]),
    Task("campaign of 25 trials", ["campaign", *SET, "-o", "{out}/campaign{turn}"]),
    Task("analysis and report of it", ["analyze", "{out}/campaign0", "-o", "{out}/report{turn}"]),
    Task("campaign of 45 trials, hidden effect", ["blind", "make", "101", "-o", "{out}/blind", "--size", "full"], True),
    Task("its diagnosis", ["diagnose", "{out}/blind/runs", "-o", "{out}/diagnosis.json"], True),
]


def run(checkout: Path, out: Path, command: list[str], turn: int) -> tuple[float, float]:
    """Processor and wall time of one command [s].

    Raises:
        RuntimeError: It failed.
    """
    environment = os.environ | {
        "PATH": f"{checkout / '.venv' / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(checkout / ".venv"),
        "XDG_CACHE_HOME": str(out / "cache"),
        "OMP_NUM_THREADS": "1",
    }
    words = [word.format(out=out, turn=turn) for word in command]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    program = checkout / ".venv" / "bin" / "impact-rs"
    done = subprocess.run([program, *words], env=environment, cwd=out, capture_output=True, text=True, check=False)
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{program} {' '.join(words)}: {done.stderr.strip()[-500:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, took


def main() -> None:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkout", type=Path, help="folder of the older version, installed")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of what the commands write")
    parser.add_argument("--turns", type=int, default=3, help="how often each command is run")
    parser.add_argument("--only", nargs="+", default=[""], help="rows whose name contains one of these")
    arguments = parser.parse_args()
    versions = {"old": arguments.checkout.resolve(), "now": HERE}
    folders = {name: (arguments.output / name).resolve() for name in versions}
    for folder in folders.values():
        folder.mkdir(parents=True, exist_ok=True)
    table = Table("What", "CPU before [s]", "CPU now [s]", "ratio", "wall before [s]", "wall now [s]")
    for task in TASKS:
        if not any(part in task.name for part in arguments.only):
            continue
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name in versions}
        for turn in range(1 if task.once else arguments.turns):
            for name, checkout in versions.items():
                shutil.rmtree(folders[name] / "cache", ignore_errors=True)
                taken[name].append(run(checkout, folders[name], task.command, turn))
                print(f"{task.name}, {name}: {taken[name][-1][0]:.2f} s CPU", file=sys.stderr, flush=True)
        before, now = ([median(column) for column in zip(*taken[name], strict=True)] for name in versions)
        figures = (before[0], now[0], before[0] / now[0], before[1], now[1])
        table.add_row(task.name, *(f"{figure:.2f}" for figure in figures))
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    Console(width=120).print(table)
    print(f"load {load}, {arguments.turns} turns")


if __name__ == "__main__":
    main()
