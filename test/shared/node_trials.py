# SPDX-License-Identifier: Apache-2.0
"""Trials through running nodes: goals, waiting, what happens in mid-trial, and nodes beside the graph."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from impact_rs.action import RunTrial
from rclpy.node import Node

from impact_rs_ros.graph import Graph
from impact_rs_trials.campaign import Manifest, make_manifest

PATIENCE = 60.0  # s; never reached on a machine that works
Feedback = Callable[[RunTrial.Impl.FeedbackMessage], None]


def goal(folder: Path, **changes: Any) -> RunTrial.Goal:
    """A push of the parcel."""
    values = {"scenario": "push", "object_name": "parcel", "case_name": "1", "velocity_scale": 1.0, "seed": 5}
    return RunTrial.Goal(**values | {"output_directory": str(folder)} | changes)


def one_trial(scenario: str = "push", seed: int = 0) -> Manifest:
    """A campaign of one push of the parcel."""
    return make_manifest(scenario, ["parcel"], ["1"], [1.0], trials=1, seed=seed)


def until(condition: Callable[[], Any], step: Callable[[], Any], what: str = "nothing comes") -> Any:
    """What the condition returns once it is true; until then ``step`` is called."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        step()
    return found


def spin_until(graph: Graph, condition: Callable[[], Any], what: str = "nothing comes") -> Any:
    """What the condition returns once it is true."""
    return until(condition, lambda: graph.spin(0.05), what)


def result_of(graph: Graph, future: Any) -> Any:
    """Result of a future of the graph's node."""
    spin_until(graph, future.done, "no answer")
    return future.result()


def in_trial(act: Callable[[], object], after: float = 0.2) -> Feedback:
    """Feedback that acts once, when the trial time is beyond ``after`` [s]."""
    done: list[object] = []

    def feedback(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > after and not done:
            done.append(act() or True)

    return feedback


@contextmanager
def beside(graph: Graph, name: str, namespace: str = "") -> Iterator[Node]:
    """A node of another program, in the process of the test; nothing runs it."""
    other = rclpy.create_node(name, namespace=namespace, context=graph.node.context, start_parameter_services=False)
    try:
        yield other
    finally:
        other.destroy_node()
