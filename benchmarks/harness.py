# SPDX-License-Identifier: Apache-2.0
"""Common parts of all benchmarks: cases, the loop that resumes, the table, and the file of results.

A benchmark is a module in ``boards`` (the program has to find a hidden truth), ``accuracy`` (against draws, brute force
or other simulators) or ``timing`` (processor time). It has

* ``cases(options)``: cases to measure, the most informative ones first, should time run out,
* ``run(case, work)``: measures one case and returns its row, which JSON can hold,
* ``table(rows, options)``: the table of all rows,
* ``add_options(parser)``, if it has options of its own.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import shlex
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from benchmarks.results import Results, Table
from impact_rs_sim.files import write_whole
from impact_rs_trials.workers import Map, Workforce, workers

HERE = Path(__file__).parent
KINDS = ("boards", "accuracy", "timing")
ROW = "row.json"

Row = dict[str, Any]


class Named(Protocol):
    """A case; its name is that of its folder."""

    @property
    def name(self) -> str: ...


@dataclass(frozen=True)
class Case:
    """A case with a name and arbitrary inputs."""

    name: str
    inputs: Any = None


@dataclass(frozen=True)
class Work:
    """Where and how a case is measured.

    Attributes:
        folder: Of the case.
        options: Of the command line.
        map_tasks: Worker processes.
    """

    folder: Path
    options: argparse.Namespace
    map_tasks: Map


def names() -> dict[str, str]:
    """Module of every benchmark by name."""
    kinds = {path.stem: kind for kind in KINDS for path in sorted((HERE / kind).glob("[!_]*.py"))}
    return {name: f"benchmarks.{kind}.{name}" for name, kind in kinds.items()}


def parser_of(name: str) -> argparse.ArgumentParser:
    """Options of a benchmark."""
    module = importlib.import_module(names()[name])
    parser = argparse.ArgumentParser(
        prog=f"./run python -m benchmarks {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="folder of the cases, which resumes; none: a temporary one"
    )
    parser.add_argument("--jobs", type=int, default=1, help="worker processes")
    parser.add_argument("--only", default="", help="cases whose name starts so")
    parser.add_argument("--seconds", type=float, default=math.inf, help="begin no further case after this time [s]")
    parser.add_argument("--save", nargs="?", const=name, metavar="NAME", help="write benchmarks/results/NAME.json")
    getattr(module, "add_options", lambda _: None)(parser)
    return parser


def run(name: str, words: Sequence[str]) -> Table:
    """Run a benchmark as the command line asks, print and return its table."""
    module, options = importlib.import_module(names()[name]), parser_of(name).parse_args(words)
    if options.output is None:
        with tempfile.TemporaryDirectory() as folder:
            rows = rows_of(module, options, Path(folder))
    else:
        rows = rows_of(module, options, options.output)
    table: Table = module.table(rows, options)
    print(f"\n{table.markdown}")
    if options.save:
        Results.measured(f"./run python -m benchmarks {name}{_shown(words)}", table).save(options.save)
    return table


def rows_of(module: ModuleType, options: argparse.Namespace, output: Path) -> list[Row]:
    """Rows of all cases that are there already or are measured in time."""
    cases = [case for case in module.cases(options) if case.name.startswith(options.only)]
    rows, began = [], time.monotonic()
    with workers(Workforce(options.jobs)) as map_tasks:
        for number, case in enumerate(cases, start=1):
            folder = output / case.name
            if (folder / ROW).exists():
                row = dict(json.loads((folder / ROW).read_text(encoding="utf-8")))
            elif time.monotonic() - began > options.seconds:
                continue
            else:
                folder.mkdir(parents=True, exist_ok=True)
                row = {"name": case.name, **module.run(case, Work(folder, options, map_tasks))}
                write_whole(folder / ROW, json.dumps(row, default=_plain) + "\n")
            rows.append(row)
            print(f"[{number}/{len(cases)}] {case.name}: {row.get('said', 'done')}", flush=True)
    return rows


def _plain(value: Any) -> Any:
    """A value that JSON does not know, as lists and numbers."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else list(value)


def _shown(words: Sequence[str]) -> str:
    """Options as the docs print them: without ``--save`` and with DIR for the folder."""
    shown, remaining = "", iter(words)
    for word in remaining:
        if word in ("-o", "--output"):
            next(remaining)
            shown += " -o DIR"
        elif word.startswith("--save"):
            break  # the last option
        else:
            shown += f" {shlex.quote(word)}"
    return shown


def share(values: Iterable[Any]) -> str:
    """How many of them are true: ``19 of 23``; a dash where there is none."""
    truths = [bool(value) for value in values if value is not None]
    return f"{sum(truths)} of {len(truths)}" if truths else "–"


def percent(values: Iterable[Any]) -> float:
    """Share of true values [%]; NaN where there is none."""
    truths = [bool(value) for value in values if value is not None]
    return 100.0 * sum(truths) / len(truths) if truths else math.nan


def quantiles(values: Sequence[float]) -> str:
    """Median, and in parentheses the quantiles at 10 and 90 %; three digits."""
    low, middle, high = (f"{float(f'{value:.3g}'):,g}" for value in np.percentile(values, (10, 50, 90)))
    return f"{middle} ({low} to {high})"


def median_and_largest(values: Sequence[float]) -> str:
    """Both, the largest in parentheses."""
    return f"{np.median(values):.3g} ({max(values):.3g})"


def map_draws(draw: Callable[..., Any], case: Any, options: argparse.Namespace, map_tasks: Map) -> list[Any]:
    """Results of ``draw(case, options, seed)`` for ``options.draws`` seeds from ``options.first`` on."""
    return list(map_tasks(partial(draw, case, options), range(options.first, options.first + options.draws)))


def draw_options(parser: argparse.ArgumentParser, draws: int) -> None:
    """Options of random draws: their number, and the first seed."""
    parser.add_argument("--draws", type=int, default=draws, help="draws of every case")
    parser.add_argument("--first", "--first-seed", dest="first", type=int, default=0, help="seed of the first one")


def in_turns(calls: Mapping[str, Callable[[], object]], turns: int) -> dict[str, list[float]]:
    """Processor time of calls that take turns [s]: what slows the machine for a while slows all of them."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(turns):
        for name, call in calls.items():
            began = time.process_time()
            call()
            seconds[name].append(time.process_time() - began)
    return seconds
