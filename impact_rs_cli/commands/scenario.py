# SPDX-License-Identifier: Apache-2.0
"""``impact-rs scenario``: a scenario to start from."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from impact_rs_cli.parser import Parser
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.robot import load_facts
from impact_rs_trials.scenario_draft import KINDS, draft

TEXT = f"""\
Write a scenario for a robot: boxes, an impact pose, and everything else that trials need.

The command searches for a pose whose whole motion is far from joint limits and singularities, and runs the trials of
the file before it writes it. Motor inertia, stiffness and damping that the robot facts lack are assumptions, scaled
from a Franka arm: replace them with yours. Files are never overwritten.

example:
  {PROGRAM} scenario new --robot franka_fr3 -o my_push.yaml
  {PROGRAM} scenario new --robot my_robot.yaml --kind excite -o my_excite.yaml
  {PROGRAM} campaign my_push.yaml -o campaigns/my_push

Units: SI; angles in rad."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, new, TEXT)
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=Parser)
    maker = actions.add_parser("new", help="a working scenario for a robot")
    declare(maker, new, TEXT)
    maker.add_argument(
        "--robot", required=True, metavar="ROBOT", help="name of a robot in config/robots, or path of its YAML file"
    )
    maker.add_argument(
        "--kind",
        choices=KINDS,
        default="push",
        help="push: one arm hits a box; grab: two arms clamp and lift it; excite: free motion; default: push",
    )
    maker.add_argument("-o", dest="output", type=Path, required=True, metavar="FILE.yaml", help="file to write")
    add_json(maker)


def new(args: argparse.Namespace, terminal: Terminal) -> int:
    """Find and write."""
    if args.output.exists():
        raise InputError("this file exists already; scenarios are never overwritten", file=args.output)
    if args.output.suffix not in (".yaml", ".yml"):
        raise InputError("a scenario is a .yaml file", file=args.output)
    facts = load_facts(args.robot)
    name = args.robot
    if name.endswith((".yaml", ".yml")):
        name = os.path.relpath(name, args.output.parent)
    with terminal.stages() as report:
        found = draft(name, facts, args.kind, report)
    with output_folder(args.output.parent):
        write_whole(args.output, found.text)
    terminal.result({"file": str(args.output), "speed_share": found.speed, "poses_simulated": found.tried + 1})
    if found.speed < 1.0:
        terminal.say(f"at {100.0 * found.speed:.0f} % of the shipped speeds, which are too fast for these joints")
    terminal.say(f"{args.output}: next: {PROGRAM} campaign {args.output} -o campaigns/{args.output.stem}")
    return 0
