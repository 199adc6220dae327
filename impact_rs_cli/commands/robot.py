# SPDX-License-Identifier: Apache-2.0
"""``impact-rs robot``: facts about a robot from its URDF, and checks of them."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from functools import partial

from rich.table import Table

from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.robot_check import check_drives, check_facts
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_import import import_urdf, save_facts
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.importing.measured_limits import measured_limits


def import_robot(args: argparse.Namespace, terminal: Terminal) -> int:
    """Import and write."""
    measured = {} if args.measured is None else {"measured": partial(measured_limits, args.measured)}
    robot = import_urdf(
        args.urdf,
        args.base,
        args.tip,
        args.source,
        args.limits,
        args.inertia_at,
        args.lock,
        packages=args.package_path,
        move=args.move,
        floating=args.floating,
        hands=args.hand,
        **measured,
    )
    with output_folder(args.output.parent):
        save_facts(robot, f"Facts about a robot, made from {args.urdf.name} by impact-rs robot import.", args.output)
    terminal.result({"file": str(args.output), "joints": list(robot.joints), "notes": list(robot.notes)})
    terminal.say(*robot.notes)
    terminal.say(
        f"{args.output}: {len(robot.joints)} joints ({', '.join(robot.joints)})",
        f"next: {command_line('robot check', {'robot': args.output})}",
    )
    return 0


def check(args: argparse.Namespace, terminal: Terminal) -> int:
    """Check; 1 if a check fails."""
    facts = load_facts(args.robot)
    checks = check_facts(facts)
    if args.scenario is not None:
        checks += check_drives(facts, load_scenario(args.scenario))
    failed = any(item.outcome == "failed" for item in checks)
    terminal.result({"robot": args.robot, "ok": not failed, "checks": [asdict(item) for item in checks]})
    table = Table(title=f"{args.robot}: {facts.joint_count} joints")
    for heading in ("check", "result", "found"):
        table.add_column(heading)
    for item in checks:
        table.add_row(item.name, item.outcome, item.found)
    terminal.say(table)
    return 1 if failed else 0
