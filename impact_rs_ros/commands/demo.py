"""``impact-rs demo``: the whole way in one command."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from impact_rs_ros.commands.terminal import PROGRAM, Terminal, add_command, add_json, output_folder

SCENARIO, OBJECT, CASE = "push", "cat_food", "case_2"

TEXT = f"""\
Show the whole way, through the ROS 2 nodes: five trials in which a robot hits and pushes a box ({OBJECT}, {CASE}), each
with another post-impact reference velocity; their bags; the comparison with the impact map's predictions; a report.

example:
  impact-rs demo
  impact-rs demo -o /tmp/impact_demo

Units: speeds in m/s, errors in percent."""


def add(subparsers: Any) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "demo", run, "see everything once: trials, bags, analysis, report", TEXT)
    parser.add_argument(
        "-o", dest="output", type=Path, default=Path("demo_output"), metavar="DIR", help="default: %(default)s"
    )
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    from impact_rs_analysis.campaign import make_manifest
    from impact_rs_ros.commands.analyze import report_on
    from impact_rs_ros.commands.campaign import follow, through_nodes

    manifest = make_manifest(SCENARIO, [OBJECT], [CASE], trials=1)
    terminal.say(f"Running {len(manifest.keys)} trials of '{SCENARIO}' ({OBJECT}, {CASE}) through the ROS 2 nodes.")
    with output_folder(args.output):
        _, failures = follow(through_nodes(args.output, manifest), manifest, args.output, terminal)
    code, report = report_on(args.output, None, terminal)
    terminal.say(
        "",
        "Where the line through the net feedback crosses zero, the robot follows its natural post-impact velocity:",
        "that is the experimental estimate, and the impact map's predictions are measured against it.",
        f"Open {report.resolve()} in a browser, then try:",
        f"  {PROGRAM} map {SCENARIO} {OBJECT} {CASE} --motor-inertia rotor",
        f"  {PROGRAM} campaign {SCENARIO} -o campaigns/{SCENARIO} --jobs 2",
        f"  {PROGRAM} analyze campaigns/{SCENARIO}",
    )
    return 1 if failures else code
