# SPDX-License-Identifier: Apache-2.0
"""``impact-rs friction``: what the controller feeds forward against joint friction."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from impact_rs_cli.arguments import add_jobs, started
from impact_rs_cli.parser import Parser
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.model import load_model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials import friction

TEXT = f"""\
Identify a feedforward for joint friction, so that the net feedback shows the impact alone.

identify runs the scenario's plant in free motion, one arm at a time: along the ante-impact reference with the
ante-impact controller, and from rest along the post-impact reference with the post-impact controller. The mean
feedback of these runs is the feedforward. Two more turns with it correct the remaining feedback. Writes FILE and
beside it SCENARIO_compensated.yaml, a copy of the scenario that uses it. Existing files are never overwritten.

example:
  {PROGRAM} friction identify my_push.yaml -o friction/push_friction.yaml
  {PROGRAM} campaign friction/my_push_compensated.yaml -o campaigns/compensated

Units: accelerations of the end effector [m/s^2, rad/s^2] and of joint 1 [rad/s^2], over the time of the trial [s]."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, identify, TEXT)
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=Parser)
    identifier = actions.add_parser("identify", help="identify the feedforward from runs in free motion")
    declare(identifier, identify, TEXT)
    identifier.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")
    identifier.add_argument("-o", dest="output", type=Path, required=True, metavar="FILE", help="file to write, .yaml")
    identifier.add_argument("--objects", nargs="+", metavar="NAME", help="default: all of the scenario")
    identifier.add_argument("--cases", nargs="+", metavar="NAME", help="default: all of the scenario")
    identifier.add_argument(
        "--runs", type=int, default=5, metavar="N", help="runs per mean, in each of three turns; default: %(default)s"
    )
    identifier.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of scatter and noise; default: %(default)s"
    )
    identifier.add_argument(
        "--effects", type=Path, metavar="MODEL", help="model file with effects of the plant beyond the scenario"
    )
    add_jobs(identifier)
    add_json(identifier)


def identify(args: argparse.Namespace, terminal: Terminal) -> int:
    """Identify and write."""
    scenario = load_scenario(args.scenario)
    effects = None if args.effects is None else load_model(args.effects)
    with output_folder(args.output.parent):
        friction.prepare_output(args.scenario, args.output)
        with started(args) as map_tasks, terminal.progress("arms") as report_progress:
            found = friction.identify(
                scenario, args.objects, args.cases, args.runs, args.seed, effects, map_tasks, report_progress
            )
        copy = friction.write_compensation(found, args.scenario, args.output)
    largest = [
        {
            "object": name,
            "case": case,
            "arm": arm,
            "largest_ante_m_s2": float(np.linalg.norm(entry.ante.rows[:, :3], axis=1).max()),
            "largest_post_m_s2": float(np.linalg.norm(entry.post.rows[:, :3], axis=1).max()),
        }
        for name, cases in found.sets.items()
        for case, arms in cases.items()
        for arm, entry in arms.items()
    ]
    terminal.result({"file": str(args.output), "scenario": str(copy), "runs": found.runs, "sets": largest})
    for row in largest:
        terminal.say(
            f"{row['object']} {row['case']} {row['arm']}: up to {row['largest_ante_m_s2']:.2f} m/s^2 before and "
            f"{row['largest_post_m_s2']:.2f} m/s^2 after the impact"
        )
    terminal.say(
        f"{args.output}: averages of {found.runs} runs", f"next: {PROGRAM} campaign {copy} -o campaigns/compensated"
    )
    return 0
