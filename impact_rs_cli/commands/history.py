# SPDX-License-Identifier: Apache-2.0
"""``impact-rs history``: how the error fell from model to model."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

from impact_rs_analysis.diagnosis.history import VersionError, history, versions
from impact_rs_analysis.report.history import write_history
from impact_rs_cli.arguments import RUNS, add_jobs, number, on_local_runs
from impact_rs_cli.measurements import add_source, measured
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder

TEXT = f"""\
Show the error of every version of a model, from its first parent to MODEL.yaml.

Two errors: with the parameters of the file, and held out, where the parameters of the added effect are fitted to all
other conditions. Fitting noise does not reduce the held-out error.

example:
  {PROGRAM} history model_3.yaml --runs campaigns/blind/runs
  {PROGRAM} history model_3.yaml --runs campaigns/blind/runs -o report --json
  {PROGRAM} history model_2.yaml --impacts tosses.csv

Units: errors are multiples of repeatability, for recordings of the torque noise; for impacts without repeats m/s."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("model", type=Path, metavar="MODEL.yaml", help="the last model")
    parser.add_argument("--runs", metavar="RUNS", help=f"{RUNS}; leave it out with --impacts")
    parser.add_argument("-o", dest="output", type=Path, metavar="DIR", help="folder for an HTML page with the plot")
    add_source(parser)
    add_jobs(parser)
    add_json(parser)


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    versions(args.model)  # a missing parent is reported before the runs are read
    with measured(args, terminal) as measurements, measurements.progress():
        found = history(args.model, measurements.against)
    terminal.result({"history": [entry.to_json() for entry in found]})
    path = None
    if args.output is not None:
        with output_folder(args.output):
            path = write_history(found, args.output)
    show_history(found, terminal)
    if path is not None:
        terminal.say(f"plot: {path.resolve()}")
    return 0


def show_history(found: list[VersionError], terminal: Terminal) -> None:
    """The table."""
    table = Table(title=f"Error per model version [{found[0].unit}]")
    for heading in ("model", "effect added"):
        table.add_column(heading)
    for heading in ("fit", "held out", "repetition alone"):
        table.add_column(heading, justify="right")
    for entry in found:
        table.add_row(
            entry.version.model.name,
            entry.version.effect_added or "–",
            number(entry.error_fit),
            "–" if entry.error_held_out is None else number(entry.error_held_out),
            "–" if entry.noise_floor is None else number(entry.noise_floor),
        )
    terminal.say(table)
