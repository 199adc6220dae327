# SPDX-License-Identifier: Apache-2.0
"""Wall time of a tick through the nodes, and its jitter, while services are called and while not.

Trials run through the five nodes, in lockstep and in real time. A tick is the time between two states of the
plant, by the source timestamps of its middleware, so that delays of the subscriber are excluded. In turns another
process calls, one after the other, the impact map, and parameters and lifecycle states of plant, controller and
recorder. In real time the jitter is the difference of a tick from the control period.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import Any

import numpy as np
import rclpy
from impact_rs.action import RunTrial
from impact_rs.msg import ImpactProblem
from impact_rs.srv import PredictImpact
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_ros.graph import Graph
from impact_rs_ros.middleware import set_middleware
from impact_rs_ros.qos import RECORD
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario

DOMAIN_ID = 94
CALLED = "services called"
TRIAL = {"scenario": "push", "object_name": "cat_food", "case_name": "case_2", "velocity_scale": 1.0}
REQUESTS = {
    "impact_map/predict": (
        PredictImpact,
        PredictImpact.Request(problem=ImpactProblem(scenario="push", object_name="cat_food", case_name="case_2")),
    ),
    **{
        f"{node}/{name}": (kind, request)
        for node in ("plant", "controller", "recorder")
        for name, kind, request in (
            ("get_parameters", GetParameters, GetParameters.Request(names=["scenario"])),
            ("get_state", GetState, GetState.Request()),
        )
    },
}


def call() -> None:
    """Call services one after the other, ``argv[1]`` [1/s] at most, and print how many were answered."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    node = rclpy.create_node("caller")
    clients = {name: node.create_client(kind, name) for name, (kind, _) in REQUESTS.items()}
    while not all(client.service_is_ready() for client in clients.values()):
        rclpy.spin_once(node, timeout_sec=0.05)
    print("ready", flush=True)
    answered, due = 0, time.monotonic()
    for name in cycle(REQUESTS):
        future = clients[name].call_async(REQUESTS[name][1])
        while not (future.done() or stopped):
            rclpy.spin_once(node, timeout_sec=0.05)
        answered += future.done()
        due = max(due + 1.0 / float(sys.argv[1]), time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        if stopped:
            break
    print(answered, flush=True)


@contextmanager
def caller(rate: float) -> Iterator[subprocess.Popen[str] | None]:
    """The process that calls services, at work; None at the rate 0."""
    if rate == 0.0:
        yield None
        return
    command = [sys.executable, "-m", __name__, str(rate)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process
        process.terminate()


def answered(process: subprocess.Popen[str]) -> int:
    """End the process that calls services; returns the number of answers."""
    process.terminate()
    assert process.stdout is not None
    return int(process.stdout.readline())


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many trials, and how many calls."""
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--rate", type=float, default=100.0, help="of the calls, one after the other [1/s]")


def cases(options: argparse.Namespace) -> list[Case]:
    """In lockstep and in real time."""
    del options
    return [Case("lockstep", False), Case("real time", True)]


def ticks(graph: Graph, work: Work, seed: int) -> tuple[Array, str]:
    """Times between the states of one trial [s], and its outcome: in real time late torques may end it."""
    stamps: list[int] = []

    def state(message: bytes, about: Any) -> None:
        del message
        stamps.append(about["source_timestamp"])

    subscription = graph.node.create_subscription(JointState, "arm/joint_states", state, RECORD, raw=True)
    while subscription.get_publisher_count() == 0:
        graph.spin(0.05)
    folder = work.folder / f"{time.monotonic_ns()}"
    folder.mkdir(parents=True)
    result = graph.call_trial(RunTrial.Goal(**TRIAL, seed=seed, output_directory=str(folder)))
    graph.node.destroy_subscription(subscription)
    if result.outcome == "ABORTED":
        raise RuntimeError(f"the trial ended {result.outcome}: {result.message}")
    return 1e-9 * np.diff(stamps), result.outcome


def run(case: Case, work: Work) -> Row:
    """Times of all ticks with and without calls, in turns [s], and answers per second."""
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN_ID)
    set_middleware(os.environ)
    tick_times: dict[str, list[float]] = {"no service called": [], CALLED: []}
    ok_counts = dict.fromkeys(tick_times, 0)
    answers, call_duration = 0, 0.0
    work.folder.mkdir(parents=True, exist_ok=True)
    with Graph.running("push", DOMAIN_ID, root=work.folder) as graph:
        realtime = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=case.inputs)
        limit = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.0)  # late ticks are what is measured
        chosen = [Parameter(name="realtime", value=realtime), Parameter(name="missed_ticks_limit", value=limit)]
        graph.call(SetParameters, "plant/set_parameters", SetParameters.Request(parameters=chosen))
        ticks(graph, work, 0)  # the first trial loads what later ones have
        for seed in range(1, 1 + work.options.trials):
            for name, durations in tick_times.items():
                with caller(work.options.rate if name == CALLED else 0.0) as process:
                    began = time.monotonic()
                    times, outcome = ticks(graph, work, seed)
                    durations += times.tolist()
                    ok_counts[name] += outcome == "OK"
                    if process is not None:
                        answers += answered(process)
                        call_duration += time.monotonic() - began
    return {"ticks": tick_times, "good": ok_counts, "answers": answers / call_duration}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Quantiles of ticks and of their jitter."""
    del options
    period, lines = load_scenario("push").timing.control_period, []
    for row in rows:
        for name, durations in row["ticks"].items():
            times = np.array(durations)
            jitter = np.abs(times - (period if row["name"] == "real time" else np.median(times)))
            numbers = [*np.quantile(times, (0.5, 0.99)), times.max(), *np.quantile(jitter, (0.5, 0.99))]
            label = f"{row['name']}, {name}" + (f", {row['answers']:.0f} a second" if name == CALLED else "")
            lines.append(
                (label, *(f"{1e3 * number:.3f}" for number in numbers), str(times.size), str(row["good"][name]))
            )
    columns = (
        "median [ms]",
        "99 % [ms]",
        "longest [ms]",
        "jitter, median [ms]",
        "jitter, 99 % [ms]",
        "ticks",
        "trials OK",
    )
    return Table(("Tick", *columns), tuple(lines))


if __name__ == "__main__":  # the process that calls
    set_middleware(os.environ)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    call()
