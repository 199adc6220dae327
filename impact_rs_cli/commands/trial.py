# SPDX-License-Identifier: Apache-2.0
"""``impact-rs trial``: one trial in-process."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from impact_rs_analysis.measure.net_feedback import MEASURES, net_feedback
from impact_rs_cli.terminal import Terminal, add_json, declare, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import make_manifest, run_one

TEXT = """\
Run one trial of a scenario in this process and record it as a bag.

--scale multiplies the predicted post-impact velocity to give the reference; 1.0 follows the prediction. The trial
equals repeat 0 of a campaign with the same seed.

example:
  impact-rs trial push cat_food case_2 --scale 0.9 --seed 7 -o trials
  impact-rs analyze trials        # needs trials at three scales or more

Units: the scale has none; speeds are in m/s."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")
    parser.add_argument("object", metavar="OBJECT", help="name of an object of the scenario")
    parser.add_argument("case", metavar="CASE", help="name of a case of the scenario; 2 is short for case_2")
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="S", help="post-impact reference over prediction [-]"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of scatter and noise; default: 0")
    parser.add_argument("-o", dest="output", type=Path, required=True, metavar="DIR", help="folder for the bag")
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    manifest = make_manifest(args.scenario, [args.object], [args.case], [args.scale], 1, args.seed)
    key = manifest.keys[0]
    path = args.output / key.name
    if path.exists():
        raise InputError("this bag exists already", file=path)
    with output_folder(args.output), terminal.progress(key.name) as report:
        report(0, 1)
        ended = run_one(args.output, manifest.trial(key))
        report(1, 1)
    bag = TrialBag.open(path)
    info, trial = bag.info, net_feedback(bag) if ended.outcome in MEASURES else None
    times = [bag.impact_time(arm) for arm in info.robots]
    terminal.result(
        {
            "bag": str(path),
            "outcome": ended.outcome,
            "message": ended.message,
            "axis": info.axis,
            "impact_time_s": [None if math.isnan(time) else time for time in times],
            "predicted_post_velocity_m_s": info.predicted_post_velocity,
            "reference_post_velocity_m_s": info.reference_post_velocity,
            "net_feedback_m_s": None if trial is None else trial.net,
        }
    )
    if ended.message:
        terminal.warn(f"{ended.outcome}: {ended.message}")
    if trial is not None:
        terminal.say(
            f"{ended.outcome}: net feedback {trial.net:+.4f} m/s along {info.axis} at a post-impact reference of "
            f"{info.reference_post_velocity:+.4f} m/s"
        )
    terminal.say(f"bag: {path}")
    return 0 if ended.outcome == "OK" else 1
