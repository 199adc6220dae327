"""``impact-rs campaign``: many trials."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext

from impact_rs_cli.arguments import add_jobs, workforce_of
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_trials.campaign import (
    FAILURES,
    Manifest,
    TrialReport,
    make_manifest,
    open_campaign,
    run_campaign,
    still_to_run,
)
from impact_rs_trials.store import Folder, Store, open_store, owned

TEXT = """\
Run every trial of a scenario, or the part of it that you name, and record a bag of each.

A campaign that was interrupted goes on where it stopped when the same command is given again: finished bags stay, a
half-written one is run again. Trials run in parallel worker processes; results do not depend on their number (--jobs).
The workers of a running dask scheduler do as well (--scheduler); DIR is then a folder that all of them share, or a URL.

example:
  impact-rs campaign push -o campaigns/push
  impact-rs campaign push -o campaigns/quick --objects cat_food --cases 2 --scales 0.8 1.0 1.2 --trials 2
  impact-rs campaign push -o s3://bucket/push --scheduler tcp://10.0.0.1:8786
  impact-rs analyze campaigns/push

Units: scales have none (post-impact reference velocity over predicted velocity)."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")
    parser.add_argument("-o", dest="output", required=True, metavar="DIR", help="folder of the campaign, or URL")
    parser.add_argument("--objects", nargs="+", metavar="NAME", help="default: all of the scenario")
    parser.add_argument("--cases", nargs="+", metavar="NAME", help="default: all of the scenario")
    parser.add_argument("--scales", nargs="+", type=float, metavar="S", help="default: the scenario's [-]")
    parser.add_argument("--trials", type=int, metavar="N", help="repeats of every scale; default: the scenario's")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the campaign; default: 0")
    add_jobs(parser)
    parser.add_argument(
        "--via",
        choices=("inprocess", "nodes"),
        default="inprocess",
        help="run trials in this program, or through the ROS 2 nodes (one at a time); default: %(default)s",
    )
    add_json(parser)
    parser.set_defaults(resumable=True)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.via == "nodes" and (args.jobs not in (None, 1) or args.scheduler is not None):
        raise InputError("--jobs and --scheduler are for --via inprocess: the nodes run one trial at a time")
    store = open_store(args.output)
    workforce = workforce_of(args)
    manifest = make_manifest(args.scenario, args.objects, args.cases, args.scales, args.trials, args.seed)
    with output_folder(store.path) if isinstance(store, Folder) else nullcontext():
        reports = through_nodes(store, manifest) if args.via == "nodes" else run_campaign(store, manifest, workforce)
        outcomes, failures = follow(reports, manifest, store, terminal)
    done = len(manifest.keys) - len(still_to_run(store, manifest))
    terminal.result(
        {
            "directory": args.output,
            "trials": len(manifest.keys),
            "present": done,
            "ran": sum(outcomes.values()),
            "outcomes": dict(outcomes),
            "failures": [{"trial": report.key.name, "message": report.message} for report in failures],
        }
    )
    counted = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "nothing was left to run"
    terminal.say(
        f"{done} of {len(manifest.keys)} trials are there ({counted})", f"next: {PROGRAM} analyze {args.output}"
    )
    return 0 if done == len(manifest.keys) and not failures else 1


def through_nodes(store: Store, manifest: Manifest) -> Iterator[TrialReport]:
    """Run what is missing through the ROS 2 nodes.

    Raises:
        InputError: The campaign does not lie in a folder, or another process works on it.
    """
    # ROS 2 takes part in --via nodes alone: where it is not installed, trials still run in this program.
    from impact_rs_ros.graph import run_trials_through_nodes

    if not isinstance(store, Folder):
        raise InputError("the nodes record in a folder of this machine; expected a path", file=str(store))
    with owned(store):
        yield from run_trials_through_nodes(store.path, manifest, open_campaign(store, manifest))


def follow(
    reports: Iterator[TrialReport], manifest: Manifest, store: Store, terminal: Terminal, what: str = "trials"
) -> tuple[Counter[str], list[TrialReport]]:
    """Show progress while trials run; outcomes by number, and the trials that failed."""
    outcomes: Counter[str] = Counter()
    failures = []
    total = len(still_to_run(store, manifest))
    with terminal.progress(what) as tell:
        tell(0, total)
        for number, report in enumerate(reports, start=1):
            outcomes[report.outcome] += 1
            if report.outcome == "ABORTED":
                failures.append(report)
                terminal.warn(f"{report.key.name}: {report.message or 'aborted'}")
                terminal.trace(report.trace)
            tell(number, total)
    if failures:
        terminal.warn(f"what went wrong, in full: {store}/{FAILURES}")
    return outcomes, failures
