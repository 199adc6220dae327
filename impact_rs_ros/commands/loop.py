"""What the commands of the loop share: reading RUNS and MODEL, and telling what could not be used."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_rs_ros.commands.terminal import Terminal

if TYPE_CHECKING:
    from rich.table import Table

    from impact_rs_analysis.comparison.runs import Runs
    from impact_rs_analysis.diagnosis.document import EstimateDocument
    from impact_rs_analysis.workers import Map

MOST_SHOWN = 5


def add_runs(parser: argparse.ArgumentParser) -> None:
    """The argument RUNS and the option ``--model``."""
    parser.add_argument("runs", type=Path, metavar="RUNS", help="folder with bags of trials, however deep")
    add_model(parser)


def add_model(parser: argparse.ArgumentParser) -> None:
    """The option ``--model``."""
    parser.add_argument(
        "--model", type=Path, default=Path("nominal"), metavar="FILE", help="model file; default: the nominal model"
    )


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """The option ``--jobs``."""
    parser.add_argument("--jobs", type=int, metavar="N", help="worker processes; default: one per core")


@contextmanager
def started(jobs: int | None) -> Iterator[Map]:
    """Worker processes; None: one per core.

    Raises:
        InputError: Fewer than one.
    """
    from impact_rs_analysis.workers import workers

    with workers(job_count(jobs)) as map_tasks:
        yield map_tasks


def job_count(jobs: int | None) -> int:
    """Number of worker processes; None: one per core that we may use.

    Raises:
        InputError: Fewer than one.
    """
    from impact_rs_sim.errors import InputError

    if jobs is not None and jobs < 1:
        raise InputError(f"jobs = {jobs}: expected at least 1 worker process")
    return len(os.sched_getaffinity(0)) if jobs is None else jobs


def read(directory: Path, map_tasks: Map, terminal: Terminal) -> Runs:
    """Read RUNS and tell what was left out."""
    from impact_rs_analysis.comparison.runs import read_runs

    with terminal.progress("reading bags") as tell:

        def counted(function: Any, items: Any) -> Iterator[Any]:
            for number, result in enumerate(map_tasks(function, items), start=1):
                tell(number, len(items))
                yield result

        runs = read_runs(directory, counted)
    for path, reason in runs.skipped[:MOST_SHOWN]:
        terminal.warn(f"left out {Path(path).name}: {reason.removeprefix(f'{path}: ')}")
    if len(runs.skipped) > MOST_SHOWN:
        terminal.warn(f"left out {len(runs.skipped) - MOST_SHOWN} more bags; --json names all")
    return runs


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"


def estimates_table(effect: str, rows: list[tuple[str, EstimateDocument, str]]) -> Table:
    """Estimates of one effect with their intervals: parameter, estimate, and a verdict on it or ``""``."""
    from rich.table import Table

    table = Table(title=effect, title_justify="left")
    table.add_column("parameter", no_wrap=True)
    table.add_column("estimate", justify="right", no_wrap=True)
    table.add_column("95 % interval", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    told = any(verdict for *_, verdict in rows)
    if told:
        table.add_column("verdict", overflow="fold")
    for name, value, verdict in rows:
        interval = "" if value.ci95 is None else f"{number(value.ci95[0])} ... {number(value.ci95[1])}"
        cells = [name, number(value.estimate), interval, value.unit.strip("-")]
        table.add_row(*cells, *([verdict] if told else []))
    return table
