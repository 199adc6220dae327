# SPDX-License-Identifier: Apache-2.0
"""``impact-rs export``: a campaign as one file for other tools, or as a data set that grows with it."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from impact_rs_analysis.measure.data_set import extend
from impact_rs_analysis.measure.export import check_target, export
from impact_rs_cli.arguments import add_jobs, started, warn_skipped
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_trials.store import local_copy

TEXT = f"""\
Write a campaign into one file: .parquet has a row per trial, .h5 (or .hdf5) has every measured signal.

A name without suffix is a folder of .parquet files that are read as one table, with the same rows. It grows with its
campaign: run the same command again, also while the campaign runs, and it reads only new or repeated trials. Rows stay
when their bags are removed.

A row holds scenario, object, case, scale, repeat, seed, outcome, predicted and reference velocity, net feedback and
impact times. In HDF5 every trial is a group, with a group per arm (joint states, motor states, commands, controller
state) and one for the object. Ground truth of the simulated plant is not exported. Unreadable bags
are listed and left out.

example:
  {PROGRAM} export campaigns/push -o push.parquet
  {PROGRAM} export s3://bucket/push -o push.h5
  {PROGRAM} export campaigns/push -o push_rows     # folder: push_rows/part-00000.parquet, ...

Needs pyarrow for Parquet and h5py for HDF5 (both are in the extra "export").

Units: a column name ends with its unit; datasets have an attribute units."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument(
        "campaign", metavar="CAMPAIGN", help="folder with bags of trials, searched with its subfolders, or URL"
    )
    parser.add_argument(
        "-o", dest="output", type=Path, required=True, metavar="FILE", help=".parquet, .h5, .hdf5, or a folder"
    )
    add_jobs(parser)
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if not args.output.suffix:
        return _extend(args, terminal)
    check_target(args.output)
    with (
        local_copy(args.campaign) as directory,
        # Signals are read in this process: they would be most of the work to pass on.
        started(args) if args.output.suffix == ".parquet" else nullcontext(map) as map_tasks,
        output_folder(args.output.parent),
        terminal.progress("reading bags") as report_progress,
    ):
        found = export(directory.absolute(), args.output, map_tasks, report_progress)
    warn_skipped([(bag.name, bag.reason) for bag in found.skipped], terminal)
    skipped = [vars(bag) for bag in found.skipped]
    terminal.result({"file": str(args.output), "trials": found.trials, "skipped": skipped})
    terminal.say(f"{found.trials} trials in {args.output}")
    return 0


def _extend(args: argparse.Namespace, terminal: Terminal) -> int:
    """Bring a data set up to date with the campaign."""
    args.resumable = True
    with (
        started(args) as map_tasks,
        output_folder(args.output),
        terminal.progress("reading new bags") as report_progress,
    ):
        found = extend(args.campaign, args.output, map_tasks, report_progress)
    warn_skipped([(bag.name, bag.reason) for bag in found.skipped], terminal)
    skipped = [vars(bag) for bag in found.skipped]
    terminal.result({"folder": str(args.output), "trials": found.trials, "read": found.read, "skipped": skipped})
    terminal.say(f"{found.trials} trials in {args.output}, {found.read} of them read now")
    return 0
