# SPDX-License-Identifier: Apache-2.0
"""``impact-rs scenario``: a scenario to start from."""

from __future__ import annotations

import argparse
import os

from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.object_proposal import propose_object
from impact_rs_trials.scenario_draft import draft


def new(args: argparse.Namespace, terminal: Terminal) -> int:
    """Find and write."""
    if args.output.exists():
        raise InputError("this file exists already; scenarios are never overwritten", file=args.output)
    if args.output.suffix not in (".yaml", ".yml"):
        raise InputError("a scenario is a .yaml file", file=args.output)
    if args.object is None and (args.mass, args.density, args.scale) != (None, None, None):
        raise InputError("mass, density and scale belong to a file of an object", key="--object")
    proposed = None if args.object is None else propose_object(args.object, args.mass, args.density, args.scale)
    facts = load_facts(args.robot)
    name = args.robot
    if name.endswith((".yaml", ".yml")):
        name = os.path.relpath(name, args.output.parent)
    with terminal.stages() as report:
        drafted = draft(name, facts, args.kind, report, proposed)
    with output_folder(args.output.parent):
        write_whole(args.output, drafted.text)
    terminal.result(
        {
            "file": str(args.output),
            "speed_share": drafted.speed,
            "poses_simulated": drafted.tried + 1,
            "choices": dict(drafted.choices),
        }
    )
    terminal.say(
        "choices, which the head of the file repeats:", *(f"  {k}: {why}" for k, why in drafted.choices.items())
    )
    if drafted.speed < 1.0:
        terminal.say(f"at {100.0 * drafted.speed:.0f} % of the shipped speeds, which are too fast for these joints")
    further = command_line("campaign", {"scenario": args.output, "output": f"campaigns/{args.output.stem}"})
    terminal.say(f"{args.output}: next: {further}")
    return 0
