# SPDX-License-Identifier: Apache-2.0
"""``impact-rs up``: the ROS 2 nodes, until Ctrl-C."""

from __future__ import annotations

import argparse

from impact_rs_cli.arguments import check_robots
from impact_rs_cli.terminal import Terminal
from impact_rs_ros.graph import up
from impact_rs_sim.scenarios.scenario import load_scenario


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    check_robots(load_scenario(args.scenario), terminal)
    return up(args.scenario, namespace=args.namespace, without=args.without)
