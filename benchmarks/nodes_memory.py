# SPDX-License-Identifier: Apache-2.0
"""Memory of each node over many trials: ``./run python -m benchmarks.nodes_memory [--trials 300] [--every 25]``.

The trials are free motions of the scenario ``excite``. Resident memory of every node is printed now and then, and at
the end the growth per trial of the second half, by which what a node loads once is over.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from impact_rs.action import RunTrial

from impact_rs_ros.graph import Graph
from impact_rs_ros.node_processes import NODES
from impact_rs_sim.scenario import load_scenario

SCENARIO = "excite"
PAGE = 4096  # bytes


def resident(process_id: int) -> float:
    """Resident memory of a process [MB]."""
    return int(Path(f"/proc/{process_id}/statm").read_text().split()[1]) * PAGE / 1e6


def main() -> int:
    """Run and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300, help="how many")
    parser.add_argument("--every", type=int, default=25, help="trials between two lines")
    parser.add_argument("--domain", type=int, default=88, help="ROS_DOMAIN_ID")
    arguments = parser.parse_args()
    scenario = load_scenario(SCENARIO)
    goal = RunTrial.Goal(
        scenario=SCENARIO, object_name=next(iter(scenario.objects)), case_name=next(iter(scenario.cases))
    )
    goal.velocity_scale = 1.0
    rows = []
    print("trial".rjust(6), *(name.rjust(11) for name in NODES), "MB", flush=True)
    with tempfile.TemporaryDirectory() as folder, Graph.running(SCENARIO, arguments.domain, root=Path(folder)) as graph:
        goal.output_directory = folder
        for number in range(1, arguments.trials + 1):
            goal.repeat = number
            result = graph.call_trial(goal)
            if result.outcome != "OK":
                print(f"trial {number}: {result.outcome}, {result.message}", flush=True)
            rows.append([resident(graph.processes[name].pid) for name in NODES])
            if number == 1 or number % arguments.every == 0:
                print(f"{number:6d}", *(f"{value:11.1f}" for value in rows[-1]), flush=True)
    half = np.array(rows[len(rows) // 2 :])
    growth = np.polyfit(np.arange(len(half)), half, 1)[0] * 1e3
    print("kB a trial over the second half:", ", ".join(f"{n} {g:.1f}" for n, g in zip(NODES, growth, strict=True)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
