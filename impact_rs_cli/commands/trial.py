# SPDX-License-Identifier: Apache-2.0
"""``impact-rs trial``: one trial in-process."""

from __future__ import annotations

import argparse
import math

from impact_rs_analysis.measure.departure import object_departures
from impact_rs_analysis.measure.net_feedback import ANALYSED_OUTCOMES, net_feedback
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import make_manifest, run_one


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    manifest = make_manifest(args.scenario, [args.object], [args.case], [args.scale], 1, args.seed, plant=args.plant)
    key = manifest.keys[0]
    path = args.output / key.name
    if path.exists():
        raise InputError("this bag exists already", file=path)
    with output_folder(args.output), terminal.progress(key.name) as report:
        report(0, 1)
        trial_report = run_one(args.output, manifest.trial(key))
        report(1, 1)
    bag = TrialBag.open(path)
    info, trial = bag.info, net_feedback(bag) if trial_report.outcome in ANALYSED_OUTCOMES else None
    times = [bag.impact_time(arm) for arm in info.robots]
    terminal.result(
        {
            "bag": str(path),
            "outcome": trial_report.outcome,
            "message": trial_report.message,
            "axis": info.axis,
            "impact_time_s": [None if math.isnan(time) else time for time in times],
            "predicted_post_velocity_m_s": info.predicted_post_velocity,
            "reference_post_velocity_m_s": info.reference_post_velocity,
            "net_feedback_m_s": None if trial is None else trial.net,
        }
    )
    if trial_report.message:
        terminal.warn(f"{trial_report.outcome}: {trial_report.message}")
    if trial is not None:
        terminal.say(
            f"{trial_report.outcome}: net feedback {trial.net:+.4f} m/s along {info.axis} at a post-impact reference "
            f"of {info.reference_post_velocity:+.4f} m/s"
        )
        for departure in object_departures({(info.scenario, info.object, info.case_name): [trial.departures]}):
            terminal.warn(departure.words)
    terminal.say(f"bag: {path}")
    return 0 if trial_report.outcome == "OK" else 1
