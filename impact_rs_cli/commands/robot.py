# SPDX-License-Identifier: Apache-2.0
"""``impact-rs robot``: facts about a robot from its URDF, and checks of them."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from impact_rs_cli.parser import Parser
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.robot import load_facts
from impact_rs_sim.robot_check import check_drives, check_facts
from impact_rs_sim.robot_import import import_urdf, save_facts
from impact_rs_sim.scenario import load_scenario

TEXT = f"""\
Import your own robot from its URDF, and check the result.

import writes robot facts (kinematics, inertias, limits) of the serial chain from --base to --tip. Joints may be
revolute or prismatic, about any axis; mesh files are not needed. Comments in the file name the facts that a URDF does
not hold. Robot facts are never overwritten. check tests robot facts before a simulation uses them, with --scenario also
the drives of the arms that are this robot.

example:
  {PROGRAM} robot import my_robot.urdf --tip flange -o my_robot.yaml
  {PROGRAM} robot check my_robot.yaml
  {PROGRAM} robot check my_robot.yaml --scenario my_push.yaml

Units: SI; angles in rad. Prismatic joints have m, N and kg instead of rad, N m and kg m^2."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, check, TEXT)
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=Parser)
    importer = actions.add_parser("import", help="robot facts from a URDF")
    declare(importer, import_robot, TEXT)
    importer.add_argument("urdf", type=Path, metavar="ROBOT.urdf", help="URDF file; expand xacro first")
    importer.add_argument("-o", dest="output", type=Path, required=True, metavar="FILE.yaml", help="file to write")
    importer.add_argument("--base", metavar="LINK", help="link that is mounted; default: the root of the tree")
    importer.add_argument(
        "--tip", metavar="LINK", help="link whose frame is the flange, +z outwards; default: the only leaf of the tree"
    )
    importer.add_argument("--source", metavar="TEXT", help="where the numbers come from, with their licence")
    add_json(importer)
    checker = actions.add_parser("check", help="check robot facts; exit code 1 if a check fails")
    declare(checker, check, TEXT)
    checker.add_argument("robot", metavar="ROBOT", help="name of a robot in config/robots, or path of its YAML file")
    checker.add_argument(
        "--scenario", metavar="SCENARIO", help="also check the drives of this robot's arms in the scenario"
    )
    add_json(checker)


def import_robot(args: argparse.Namespace, terminal: Terminal) -> int:
    """Import and write."""
    robot = import_urdf(args.urdf, args.base, args.tip, args.source)
    with output_folder(args.output.parent):
        save_facts(robot, f"Facts about a robot, made from {args.urdf.name} by impact-rs robot import.", args.output)
    terminal.result({"file": str(args.output), "joints": list(robot.joints), "notes": list(robot.notes)})
    terminal.say(*robot.notes)
    terminal.say(
        f"{args.output}: {len(robot.joints)} joints ({', '.join(robot.joints)})",
        f"next: {PROGRAM} robot check {args.output}",
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
