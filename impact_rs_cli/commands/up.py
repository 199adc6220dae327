# SPDX-License-Identifier: Apache-2.0
"""``impact-rs up``: the ROS 2 nodes, until Ctrl-C."""

from __future__ import annotations

import argparse

from impact_rs_cli.arguments import add_namespace, add_without, check_robots
from impact_rs_cli.terminal import Terminal, declare
from impact_rs_ros.graph import up
from impact_rs_sim.scenario import load_scenario

TEXT = """\
Start the ROS 2 nodes (plant, controller, impact map, recorder, experiment) and keep them running until Ctrl-C.

Prints their services and actions. Equivalent to `ros2 launch impact_rs impact_rs.launch.py`, without the ROS 2 command
line.

With --without, a node of your own replaces one of them; docs/foreign_plant.md lists its duties.

example:
  impact-rs up push
  impact-rs up push --namespace cell_a
  impact-rs up push --without plant"""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")
    add_without(parser)
    add_namespace(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    check_robots(load_scenario(args.scenario), terminal)
    return up(args.scenario, namespace=args.namespace, without=args.without)
