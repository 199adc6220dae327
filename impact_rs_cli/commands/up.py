"""``impact-rs up``: the ROS 2 nodes, until Ctrl-C."""

from __future__ import annotations

import argparse
from typing import Any

from impact_rs_cli.terminal import Terminal, add_command

TEXT = """\
Start the ROS 2 nodes (plant, controller, impact map, recorder, experiment) and keep them running until Ctrl-C.

Says which services and actions they offer. What `ros2 launch impact_rs impact_rs.launch.py` does where the ROS 2
command line is installed.

example:
  impact-rs up push"""


def add(subparsers: Any) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "up", run, "start the ROS 2 nodes", TEXT)
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    from impact_rs_sim.scenario import load_scenario

    load_scenario(args.scenario)  # a slip of the pen is told before any node starts
    from impact_rs_ros.graph import up

    return up(args.scenario)
