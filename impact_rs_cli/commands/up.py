# SPDX-License-Identifier: Apache-2.0
"""``impact-rs up``: the ROS 2 nodes, until Ctrl-C."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from functools import partial

from impact_rs_cli.arguments import check_robots
from impact_rs_cli.terminal import Terminal
from impact_rs_ros.graph import Graph, GraphError
from impact_rs_ros.names import full_namespace, within
from impact_rs_sim.scenarios.scenario_files import load_scenario


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    check_robots(load_scenario(args.scenario), terminal)
    return up(args.scenario, namespace=args.namespace, without=args.without)


def up(scenario: str, domain_id: int | None = None, without: Sequence[str] = (), namespace: str = "") -> int:
    """Run the nodes until Ctrl-C, and print how to call them.

    Args:
        scenario: Name or path of the scenario.
        domain_id: ``ROS_DOMAIN_ID``; None: the environment's.
        without: Nodes that the user provides; they are waited for, not started.
        namespace: ROS namespace of the nodes; empty: the root.

    Returns:
        Exit code of the process.

    Raises:
        InputError: There is no such scenario, no such node, or no such namespace.
        KeyboardInterrupt: SIGINT or SIGTERM came before the nodes were up.
    """
    loaded = load_scenario(scenario)
    started = stopping = False

    def stop(number: int, frame: object) -> None:
        nonlocal stopping
        del number, frame
        stopping = True
        if not started:
            raise KeyboardInterrupt

    previous_handlers = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        notify = partial(print, flush=True)
        with Graph.running(
            scenario, domain_id, quiet=False, without=without, notify=notify, namespace=namespace
        ) as graph:
            started = True
            names = [*graph.processes, *(f"{name} (yours)" for name in graph.foreign)]
            first_trial = next(iter(loaded.objects)), next(iter(loaded.cases))
            print(_instructions(names, *first_trial, full_namespace(namespace)), flush=True)
            while not stopping:
                for line in graph.replace_lost():
                    print(line, file=sys.stderr, flush=True)
                graph.spin(0.2)
            print("stopping the nodes", flush=True)
    except GraphError as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
    return 0


def _instructions(nodes: Sequence[str], object_name: str, case: str, namespace: str) -> str:
    """How to call the nodes; requests without a scenario are for that of the nodes."""
    trial_fields = f"{{object_name: {object_name}, case_name: {case}"
    return "\n".join(
        (
            f"The nodes are up: {', '.join(nodes)}. Ctrl-C stops them.",
            "",
            "Run a trial into the folder trials/:",
            f"  ros2 action send_goal --feedback {within(namespace, 'run_trial')} impact_rs/action/RunTrial \\",
            f'    "{trial_fields}, velocity_scale: 1.0, seed: 1, output_directory: trials}}"',
            "Call the impact map:",
            f"  ros2 service call {within(namespace, 'impact_map/predict')} impact_rs/srv/PredictImpact \\",
            f'    "{{problem: {trial_fields}}}}}"',
            "Monitor the nodes:",
            "  ros2 topic echo /diagnostics",
            f"  ros2 param describe {within(namespace, 'plant')} realtime",
        )
    )
