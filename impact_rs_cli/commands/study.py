# SPDX-License-Identifier: Apache-2.0
"""``impact-rs study``: the whole published study, from trials to tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.measure.study import analyze_study, study_manifests
from impact_rs_cli.arguments import add_contact, add_jobs, workforce_of
from impact_rs_cli.commands.analyze import publish
from impact_rs_cli.commands.campaign import counted, follow, owned_campaigns, warn_wrong
from impact_rs_cli.terminal import Terminal, add_json, declare, output_folder
from impact_rs_trials.campaign import Manifest
from impact_rs_trials.sensitivity import with_sensitivity
from impact_rs_trials.store import Folder, Store
from impact_rs_trials.workers import workers

TEXT = """\
Run the whole published study, analyse it and write one report: both scenarios (push with one arm, grab with two), three
objects, three cases, five post-impact references, five repeats: 450 trials. Then 126 trials for the systematic band of
the estimates: one setting at a time, on which they should not depend, is halved or doubled.

To continue an interrupted study, run the same command again. Its two campaigns are DIR/push and DIR/grab; tables, means
and all figures are in DIR/report, beside the published numbers. The tables have predictions for the first and for the
settled contact (see impact-rs map --help).

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
        help="leave out the 126 trials for the systematic band of the estimates",
    )
    add_contact(parser, "predictions shown in the figures; both have a table")
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
            warn_wrong(ran, terminal)
            terminal.say(f"{name}: {counted(ran) or 'all trials had been recorded'}")
    with terminal.progress("reading bags") as report_progress, workers(workforce) as map_tasks:
        analysis = analyze_study(args.output, report_progress, map_tasks)
    publish(analysis, args.output / "report", terminal, args.contact)
    return 0 if analysis.sets and not failed and not analysis.missing else 1
