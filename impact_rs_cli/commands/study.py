# SPDX-License-Identifier: Apache-2.0
"""``impact-rs study``: the whole published study, from trials to tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.measure.study import analyze_study, study_manifests
from impact_rs_cli.arguments import add_contact, add_jobs, workforce_of
from impact_rs_cli.commands.analyze import publish
from impact_rs_cli.commands.campaign import counted, follow, owned_campaigns, tell_wrong
from impact_rs_cli.terminal import Terminal, add_json, declare, output_folder
from impact_rs_trials.campaign import Manifest
from impact_rs_trials.sensitivity import with_sensitivity
from impact_rs_trials.store import Folder, Store
from impact_rs_trials.workers import workers

TEXT = """\
Run the whole published study, analyse it and write one report: both scenarios (push with one arm, grab with two), three
objects, three cases, five post-impact references, five repeats: 450 trials. Then, for the systematic band of the
estimates, 126 trials in which one setting at a time is halved or doubled that they should not depend on.

A study that was interrupted goes on where it stopped when the same command is given again. Its two campaigns lie in
DIR/push and DIR/grab, like any campaign; tables, averages and all figures are in DIR/report, beside the published
numbers. Tables have the predictions for the first contact and for the settled one (see impact-rs map --help).

example:
  impact-rs study -o study
  impact-rs study -o study_small --trials 1 --no-sensitivity    # 90 trials

Units: speeds in m/s along each scenario's axis (push y, grab z), errors in percent."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("-o", dest="output", type=Path, required=True, metavar="DIR", help="folder of the study")
    parser.add_argument("--trials", type=int, metavar="N", help="repeats of every reference; default: 5")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the study; default: 0")
    parser.add_argument(
        "--no-sensitivity",
        dest="sensitivity",
        action="store_false",
        help="leave out the 126 trials that tell the systematic band of the estimates",
    )
    add_contact(parser, "predictions that the figures show; there is a table of each")
    add_jobs(parser)
    add_json(parser)
    parser.set_defaults(resumable=True)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    workforce, failed = workforce_of(args), 0
    with output_folder(args.output) as folder:
        for name, manifest in study_manifests(args.trials, args.seed).items():
            store = Folder(folder / name)
            campaigns: dict[Store, Manifest] = {store: manifest}
            if args.sensitivity:
                campaigns = with_sensitivity(store, manifest)
            reports = owned_campaigns(store, campaigns, workforce)
            ran = follow(reports, campaigns, terminal, f"{name}: trials")
            failed += sum(report.outcome == "ABORTED" for report in ran)
            tell_wrong(ran, terminal)
            terminal.say(f"{name}: {counted(ran) or 'all trials were there'}")
    with terminal.progress("reading bags") as tell, workers(workforce) as map_tasks:
        analysis = analyze_study(args.output, tell, map_tasks)
    publish(analysis, args.output / "report", terminal, args.contact)
    return 0 if analysis.sets and not failed and not analysis.missing else 1
