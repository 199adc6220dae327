# SPDX-License-Identifier: Apache-2.0
"""``impact-rs impacts``: a table of the impacts in recorded runs."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict

import numpy as np

from impact_rs_analysis.application.observer import MAX_SHOWN_FILES
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.parser import command_line
from impact_rs_cli.reading import experiment_file
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.impacts.found_impacts import FoundImpacts, find_impacts
from impact_rs_trials.recordings.impacts.impact_rows import table_text


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Find and write."""
    if args.output.suffix != ".csv":
        raise InputError("expected a name that ends in .csv", file=args.output)
    if args.output.exists():
        raise InputError("this file exists already; tables are never overwritten", file=args.output)
    file = experiment_file(args.experiment, args.directory, terminal)
    if file is None:
        raise InputError("no experiment file here; name one with --experiment (import writes one)", file=args.directory)
    experiment = load_experiment(file)
    with started_workers(args) as map_tasks:
        search = find_impacts(args.directory.absolute(), experiment, map_tasks)
    if not search.impacts:
        reasons = "; ".join(f"{omitted.name}: {omitted.reason}" for omitted in search.left_out[:MAX_SHOWN_FILES])
        raise InputError(f"no impact was found in {search.runs} runs; {reasons}", file=args.directory)
    write_whole(args.output, table_text(search.impacts, search.constants))
    _show(search, terminal)
    terminal.result(
        {
            "table": str(args.output), "rows": len(search.impacts), "runs": search.runs,
            "left_out": [asdict(omitted) for omitted in search.left_out], "remarks": list(search.remarks),
        }
    )  # fmt: skip
    terminal.say(f"{args.output}: {len(search.impacts)} impacts of {search.runs} runs")
    further = command_line("compare", {"impacts": args.output, "scenario": experiment.scenario})
    terminal.say(f"next: {further}")
    return 0


def _show(search: FoundImpacts, terminal: Terminal) -> None:
    noise = np.median([impact.noise for impact in search.impacts], axis=0)
    terminal.say(f"noise of a change of velocity, median: {noise[0]:.3g} m/s, {noise[1]:.3g} rad/s")
    laws = Counter(impact.model for impact in search.impacts)
    terminal.say("after the impact: " + ", ".join(f"{law} {count}" for law, count in laws.items()))
    for remark in search.remarks:
        terminal.say(f"note: {remark}")
    reasons: dict[str, list[str]] = {}
    for omitted in search.left_out:
        reasons.setdefault(omitted.reason, []).append(omitted.name)
    for reason, names in reasons.items():
        shown = ", ".join(names[:MAX_SHOWN_FILES]) + (" ..." if len(names) > MAX_SHOWN_FILES else "")
        terminal.say(f"left out {len(names)}: {reason} ({shown})")
