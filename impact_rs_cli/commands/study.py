# SPDX-License-Identifier: Apache-2.0
"""``impact-rs study``: the whole published study, from trials to tables."""

from __future__ import annotations

import argparse

from impact_rs_analysis.measure.study import analyze_study, study_manifests
from impact_rs_cli.arguments import workforce_of
from impact_rs_cli.commands.analyze import publish
from impact_rs_cli.commands.campaign import counted, follow, owned_campaigns, warn_wrong
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_trials.campaign import Manifest
from impact_rs_trials.store import Folder, Store
from impact_rs_trials.varied_settings import with_sensitivity
from impact_rs_trials.workers import workers


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    workforce, failed = workforce_of(args), 0
    with output_folder(args.output) as folder:
        for name, manifest in study_manifests(args.trials, args.seed, args.plant).items():
            store = Folder(folder / name)
            campaigns: dict[Store, Manifest] = {store: manifest}
            if not args.no_sensitivity:
                campaigns = with_sensitivity(store, manifest)
            reports = owned_campaigns(store, campaigns, workforce)
            finished = follow(reports, campaigns, terminal, f"{name}: trials")
            failed += sum(report.outcome == "ABORTED" for report in finished)
            warn_wrong(finished, terminal)
            terminal.say(f"{name}: {counted(finished) or 'all trials had been recorded'}")
    with terminal.progress("reading bags") as report_progress, workers(workforce) as map_tasks:
        analysis = analyze_study(args.output, report_progress, map_tasks)
    publish(analysis, args.output / "report", terminal, args.contact)
    return 0 if analysis.sets and not failed and not analysis.missing else 1
