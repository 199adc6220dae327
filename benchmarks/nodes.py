# SPDX-License-Identifier: Apache-2.0
"""A trial through the nodes: time per tick and real-time factor, beside a bare rclpy ping-pong.

    python benchmarks/nodes.py [--trials 5] [--domain 77]

The ping-pong is two processes with plain rclpy, reliable, a ``JointState`` of seven joints there and back: what the
middleware alone costs per tick. The in-process trial is what plant, controller and bag cost without it.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from impact_rs_ros.graph import Graph, run_trial
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.campaign import make_manifest, run_one

PINGS = 2000


def main() -> None:
    """Run everything and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--domain", type=int, default=77, help="ROS_DOMAIN_ID; the next one is used, too")
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.answer:
        answer(arguments.domain)
        return
    timing = load_scenario("push").timing
    manifest = make_manifest("push", ["cat_food"], ["1"], [1.0], trials=arguments.trials, seed=1)
    with tempfile.TemporaryDirectory() as folder:
        alone = [timed(lambda key=key: run_one(Path(folder) / "alone", manifest.trial(key))) for key in manifest.keys]
        nodes = []
        with Graph.running("push", arguments.domain, root=Path(folder)) as graph:
            for key in manifest.keys:
                nodes.append(timed(lambda key=key: run_trial(graph, Path(folder) / "nodes", manifest, key)))
    report("trial in one process, set-up and bag included", alone, timing.ticks, timing.duration)
    report("trial through the nodes, set-up and bag included", nodes, timing.ticks, timing.duration)
    pings = ping(arguments.domain + 1)
    print(f"bare rclpy ping-pong: median {1e6 * statistics.median(pings):.0f} us, {spread(pings, 1e6)} us")


def timed(work: object) -> float:
    """Wall-clock time of a trial [s]."""
    started = time.perf_counter()
    result = work()  # type: ignore[operator]
    assert result.outcome == "OK", result.message
    return time.perf_counter() - started


def report(what: str, times: list[float], ticks: int, duration: float) -> None:
    """Print median and spread of wall time, time per tick and real-time factor."""
    median = statistics.median(times)
    print(
        f"{what}: median {median:.2f} s, {spread(times)} s; {1e6 * median / ticks:.0f} us a tick; "
        f"{duration / median:.2f} x real time"
    )


def spread(values: list[float], scale: float = 1.0) -> str:
    """Tenth to ninetieth percentile, or least to greatest of a few."""
    ordered = sorted(values)
    cut = len(ordered) // 10
    return f"{scale * ordered[cut]:.3g} to {scale * ordered[-1 - cut]:.3g}"


def ping(domain: int) -> list[float]:
    """Round trips [s]."""
    command = [sys.executable, __file__, "--answer", "--domain", str(domain)]
    with subprocess.Popen(command) as process:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node("ping", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        received: list[JointState] = []
        node.create_subscription(JointState, "pong", received.append, 10)
        publisher = node.create_publisher(JointState, "ping", 10)
        message = JointState(name=[f"joint_{i}" for i in range(7)], position=[0.0] * 7)
        while not (publisher.get_subscription_count() and node.count_publishers("pong")):
            executor.spin_once(timeout_sec=0.02)
        times = []
        for _ in range(PINGS):
            started = time.perf_counter()
            publisher.publish(message)
            while not received:
                executor.spin_once(timeout_sec=1.0)
            received.clear()
            times.append(time.perf_counter() - started)
        process.terminate()
        rclpy.shutdown(context=context)
    return times[PINGS // 10 :]


def answer(domain: int) -> None:
    """Send back what comes in, until terminated."""
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM just ends it
    node = rclpy.create_node("pong")
    publisher = node.create_publisher(JointState, "pong", 10)
    node.create_subscription(JointState, "ping", publisher.publish, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
