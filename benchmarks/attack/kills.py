# SPDX-License-Identifier: Apache-2.0
"""Kills or freezes nodes in mid-trial: ``./run python -m benchmarks.attack.kills [--count 200] [--seed 0]``.

Every attack hits one of the five nodes at a random time of a trial, with SIGKILL, SIGSTOP, SIGTERM or SIGINT. What
counts: how long the trial lasts from there, whether its bag can be read up to there, and whether the next trial is OK.
Node by node it prints medians, worst cases and what failed; the exit code says whether anything did.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from impact_rs.action import RunTrial

from benchmarks.attack.trials import trial_in
from impact_rs_ros.graph import Graph, GraphError
from impact_rs_ros.node_processes import NODES
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import BagError, TrialBag

SIGNALS = (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM, signal.SIGINT)
ENOUGH = 5.0  # s, within which a trial must have ended
LAST = 1.5  # s of trial time, until which nodes are hit


@dataclass(frozen=True)
class Outcome:
    """What became of one attack.

    Attributes:
        node: Who was hit.
        signal: With what.
        at: Trial time [s].
        seconds: From the hit to the end of the trial [s].
        failures: What must not be.
    """

    node: str
    signal: signal.Signals
    at: float
    seconds: float
    failures: tuple[str, ...]


def bags_in(folder: Path) -> list[Path]:
    """Bags in a folder, whole or not."""
    return [path for path in (*folder.glob("*"), *folder.glob(".partial/*")) if path.is_dir() and path.name[0] != "."]


def attack(graph: Graph, folder: Path, node: str, kind: signal.Signals, at: float) -> Outcome:
    """Hit a node in a trial, mend the graph, and run another trial."""
    hit: list[float] = []

    def strike(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time >= at and not hit:
            graph.processes[node].send_signal(kind)
            hit.append(time.monotonic())

    failures = []
    path = ""
    with suppress(GraphError):  # that it ended is what counts
        path = graph.call_trial(trial_in(folder / "hit"), strike).bag_path
    seconds = time.monotonic() - hit[0] if hit else 0.0
    if seconds > ENOUGH:
        failures.append(f"ended after {seconds:.1f} s")
    if kind is signal.SIGSTOP and graph.processes[node].poll() is None:
        graph.nodes.kill(node)
    graph.revive()
    try:
        graph.wait_until_ready()
        result = graph.call_trial(trial_in(folder / "next"))
        if result.outcome != "OK":
            failures.append(f"next trial: {result.outcome}, {result.message}")
    except GraphError as error:
        failures.append(f"next trial: {error}")
    for bag in [Path(path)] if path else bags_in(folder / "hit"):
        try:
            TrialBag.open(bag)
        except (InputError, BagError) as error:
            failures.append(f"bag: {error}")
    return Outcome(node, kind, at, seconds, tuple(failures))


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
                f"[{number + 1}/{arguments.count}] {node} {kind.name} at {found.at:.2f} s: ended after "
                f"{found.seconds:.2f} s {'; '.join(found.failures)}",
                flush=True,
            )
    by_node = defaultdict(list)
    for found in outcomes:
        by_node[found.node].append(found)
    for node, own in sorted(by_node.items()):
        times = [found.seconds for found in own]
        wrong = sum(bool(found.failures) for found in own)
        print(
            f"{node}: {len(own)} hit, median {statistics.median(times):.2f} s, most {max(times):.2f} s, wrong {wrong}"
        )
    wrong = sum(bool(found.failures) for found in outcomes)
    print(f"{len(outcomes) - wrong} of {len(outcomes)} as they should be")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
