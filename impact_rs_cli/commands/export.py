# SPDX-License-Identifier: Apache-2.0
"""``impact-rs export``: a campaign as one file for other tools, or as a data set that grows with it."""

from __future__ import annotations

import argparse
from contextlib import nullcontext

from impact_rs_analysis.measure.data_set import extend
from impact_rs_analysis.measure.export import check_target, export
from impact_rs_cli.arguments import started, warn_skipped
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_trials.store import local_copy


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
