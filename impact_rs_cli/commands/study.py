"""``impact-rs study``: the whole published study, from trials to tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.measure.study import analyze_study, study_manifests
from impact_rs_cli.arguments import add_contact, add_jobs, workforce_of
from impact_rs_cli.commands.analyze import publish
from impact_rs_cli.commands.campaign import follow
from impact_rs_cli.terminal import Terminal, add_json, declare, output_folder
from impact_rs_trials.campaign import run_campaign
from impact_rs_trials.store import open_store

TEXT = """\
Run the whole published study, analyse it and write one report: both scenarios (push with one arm, grab with two), three
objects, three cases, five post-impact references, five repeats: 450 trials.

A study that was interrupted goes on where it stopped when the same command is given again. Its two campaigns lie in
DIR/push and DIR/grab, like any campaign; tables, averages and all figures are in DIR/report, beside the published
numbers. Tables have the predictions for the first contact and for the settled one (see impact-rs map --help).

example:
  impact-rs study -o study
  impact-rs study -o study_small --trials 1     # 90 trials

Units: speeds in m/s along each scenario's axis (push y, grab z), errors in percent."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("-o", dest="output", type=Path, required=True, metavar="DIR", help="folder of the study")
    parser.add_argument("--trials", type=int, metavar="N", help="repeats of every reference; default: 5")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the study; default: 0")
    add_contact(parser, "predictions that the figures show; there is a table of each")
    add_jobs(parser)
    add_json(parser)
    parser.set_defaults(resumable=True)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    workforce, failed = workforce_of(args), 0
    with output_folder(args.output) as folder:
        for name, manifest in study_manifests(args.trials, args.seed).items():
            store = open_store(folder / name)
            reports = run_campaign(store, manifest, workforce)
            outcomes, failures = follow(reports, manifest, store, terminal, f"{name}: trials")
            failed += len(failures)
            counted = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
            terminal.say(f"{name}: {counted or 'all trials were there'}")
    with terminal.progress("reading bags") as tell:
        analysis = analyze_study(args.output, tell)
    publish(analysis, args.output / "report", terminal, args.contact)
    return 0 if analysis.sets and not failed and not analysis.missing else 1
