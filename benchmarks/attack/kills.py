# SPDX-License-Identifier: Apache-2.0
"""Kills or freezes nodes in mid-trial: ``./run python -m benchmarks.attack.kills [--count 200] [--seed 0]``.

Every attack hits one of the five nodes at a random time of a trial, with SIGKILL, SIGSTOP, SIGTERM or SIGINT. What
counts: when the runner notices it, how long the trial lasts from there (without an impact map it goes on, and must be
OK), whether its bag can be read up to there, and whether the next trial is OK. Node by node it prints medians, worst
cases and what failed; the exit code says whether anything did.
"""

from __future__ import annotations

import argparse
import math
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from impact_rs.action import RunTrial

from benchmarks.attack.trials import trial_in
from impact_rs_ros.graph import Graph, GraphError
from impact_rs_ros.node_processes import NODES
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag

SIGNALS = (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM, signal.SIGINT)
SOON = 3.0  # s, within which a hit must be noticed
ENOUGH = 5.0  # s, within which a trial must have ended
LOST = 0.5  # s of trial time, how much of what came before the hit may lack
LAST = 1.5  # s of trial time, until which nodes are hit


@dataclass(frozen=True)
class Outcome:
    """What became of one attack.

    Attributes:
        node: Who was hit.
        signal: With what.
        at: Trial time [s].
        noticed: From the hit until the runner knew of it [s].
        seconds: From the hit to the end of the trial [s].
        lost: Trial time before the hit that is not in the bag [s]; NaN where there is no such bag.
        failures: What must not be.
    """

    node: str
    signal: signal.Signals
    at: float
    noticed: float
    seconds: float
    lost: float
    failures: tuple[str, ...]


def bags_in(folder: Path) -> list[Path]:
    """Bags in a folder, whole or not."""
    return [path for path in (*folder.glob("*"), *folder.glob(".partial/*")) if path.is_dir() and path.name[0] != "."]


def attack(graph: Graph, folder: Path, node: str, kind: signal.Signals, at: float) -> Outcome:
    """Hit a node in a trial, mend the graph, and run another trial."""
    hit: list[float] = []
    noticed: list[float] = []

    def look() -> None:
        while graph.is_there(node) and time.monotonic() < hit[0] + ENOUGH:
            time.sleep(0.01)
        noticed.append(time.monotonic() - hit[0])

    watch = threading.Thread(target=look)

    def strike(message: RunTrial.Impl.FeedbackMessage) -> None:
        nonlocal at
        if message.feedback.time >= at and not hit:
            at = message.feedback.time
            graph.processes[node].send_signal(kind)
            hit.append(time.monotonic())
            watch.start()

    failures = []
    outcome, why, path = "", "", ""
    try:
        result = graph.call_trial(trial_in(folder / "hit"), strike)
        outcome, why, path = result.outcome, result.message, result.bag_path
    except GraphError as error:  # that it ended is what counts
        why = str(error)
    if not hit:
        return Outcome(node, kind, at, math.nan, math.nan, math.nan, (f"ended before the hit: {outcome} {why}",))
    seconds = time.monotonic() - hit[0]
    while watch.is_alive():
        graph.spin(0.01)
    if noticed[0] > SOON:
        failures.append(f"noticed after {noticed[0]:.1f} s")
    if node == "impact_map":
        if outcome != "OK":
            failures.append(f"the trial goes on without it, and ended {outcome}")
    elif seconds > ENOUGH:
        failures.append(f"ended after {seconds:.1f} s")
    graph.end_frozen()
    graph.revive()
    try:
        graph.wait_until_ready()
        result = graph.call_trial(trial_in(folder / "next"))
        if result.outcome != "OK":
            failures.append(f"next trial: {result.outcome}, {result.message}")
    except GraphError as error:
        failures.append(f"next trial: {error}")
    lost = math.nan
    for bag in [Path(path)] if path else bags_in(folder / "hit"):
        try:
            read = TrialBag.open(bag)
            lost = max(0.0, at - float(read.joints(topics.joint_states(read.info.robots[0])).time[-1]))
            if read.outcome == "OK" and outcome != "OK":
                failures.append("the bag says OK")
        except (InputError, BagError) as error:
            failures.append(f"bag: {error}")
    if not lost <= LOST:
        failures.append(f"{lost:.2f} s before the hit are lost")
    return Outcome(node, kind, at, noticed[0], seconds, lost, tuple(failures))


def spread(times: list[float]) -> str:
    """Median and most of some times [s]; NaN counts as none."""
    known = [time for time in times if not math.isnan(time)]
    return f"{statistics.median(known):.2f} s (most {max(known):.2f})" if known else "-"


def main() -> int:
    """Run and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="attacks")
    parser.add_argument("--seed", type=int, default=0, help="of nodes, signals and times")
    parser.add_argument("--domain", type=int, default=88, help="ROS_DOMAIN_ID")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder, Graph.running("push", arguments.domain, root=Path(folder)) as graph:
        for number in range(arguments.count):
            node, kind = str(rng.choice(NODES)), SIGNALS[rng.integers(len(SIGNALS))]
            found = attack(graph, Path(folder) / str(number), node, kind, float(rng.uniform(0.0, LAST)))
            outcomes.append(found)
            print(
                f"[{number + 1}/{arguments.count}] {node} {kind.name} at {found.at:.2f} s: noticed after "
                f"{found.noticed:.2f} s, ended after {found.seconds:.2f} s, {found.lost:.2f} s lost "
                f"{'; '.join(found.failures)}",
                flush=True,
            )
    by_node = defaultdict(list)
    for found in outcomes:
        by_node[found.node].append(found)
    for node, own in sorted(by_node.items()):
        wrong = sum(bool(found.failures) for found in own)
        print(
            f"{node}: {len(own)} hit; noticed after {spread([found.noticed for found in own])}, ended after "
            f"{spread([found.seconds for found in own])}, lost {spread([found.lost for found in own])}; wrong {wrong}"
        )
    wrong = sum(bool(found.failures) for found in outcomes)
    print(f"{len(outcomes) - wrong} of {len(outcomes)} as they should be")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
