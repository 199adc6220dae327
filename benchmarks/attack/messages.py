# SPDX-License-Identifier: Apache-2.0
"""Nonsense for the nodes: ``./run python -m benchmarks.attack.messages [--count 5000] [--seed 0]``.

Services and actions get requests whose numbers, names, lengths and texts are drawn from what nobody should send; the
topics of the lockstep get such joint states, half of them in mid-trial. Afterwards every node must be there and answer,
no answer that says success may hold a number that is none, and a trial that nobody disturbs must be OK.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from impact_rs.action import RunTrial
from impact_rs.srv import ComputeImpactMap, ConfigureTrial, FinishTrial
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from benchmarks.attack.trials import trial_in
from impact_rs_ros.graph import Graph, GraphError
from impact_rs_ros.node_processes import NODES
from impact_rs_ros.qos import STREAM
from impact_rs_trials.bags import topics

NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e308, -1e308, 5e-324, 1e-9, 0.3, 1e6)
TEXTS = (
    *("", "push", "juice", "cat_food", "case_1", "1", "nonsense", "../../etc/passwd", "/etc/shadow", "a" * 10_000),
    *("\N{SNOWMAN}", "<script>", "{", "[[[[", "null", "effects: []", "name: x\neffects: [{name: gremlins}]", "%s%n"),
    *(
        "reduced",
        "rotor",
        "diagonal",
        "exact",
        "bullet",
        "pinocchio",
        "settled",
        "{}",
        '{"name": "push"}',
        "&a [*a]",
        "push\n",
    ),
)
TRIALS = 60  # messages per trial that is disturbed


class Nonsense:
    """Draws messages."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)

    def fill(self, message: Any, usual: float = 0.5) -> Any:
        """Put values nobody should send into the fields of a message; with ``usual`` a field stays as it is."""
        for name, kind in message.get_fields_and_field_types().items():
            if self._rng.random() < usual:
                continue
            value = getattr(message, name)
            if hasattr(value, "get_fields_and_field_types"):
                self.fill(value, 0.3)
            elif kind in ("float64", "double"):
                setattr(message, name, self.number())
            elif kind == "string":
                setattr(message, name, self.text())
            elif kind == "boolean":
                setattr(message, name, self._rng.random() < 0.5)
            elif kind.startswith(("uint", "int")) and "[" not in kind:
                setattr(message, name, self._rng.choice((0, 1, 2**31 - 1)))
            elif kind.startswith("sequence<double"):
                setattr(message, name, self.numbers())
            elif kind == "sequence<string>":
                setattr(message, name, [self.text() for _ in range(self._rng.randrange(9))])
        return message

    def number(self) -> float:
        return self._rng.choice(NUMBERS)

    def numbers(self) -> list[float]:
        return [self.number() for _ in range(self._rng.choice((0, 1, 3, 6, 7, 8, 100)))]

    def text(self) -> str:
        return self._rng.choice(TEXTS)

    def joint_state(self, names: list[str]) -> JointState:
        """One with the right names half the time, and a stamp within the trial."""
        shown = names if self._rng.random() < 0.5 else [self.text() for _ in range(self._rng.randrange(9))]
        fields = {name: self.numbers() for name in ("position", "velocity", "effort")}
        message = JointState(name=shown, **fields)
        nanoseconds = self._rng.choice((0, 1_000_000, 500_000_000, self._rng.randrange(1_800) * 1_000_000))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        return message

    def request(self) -> tuple[Any, str, Any]:
        """A service, by type and name, and a request to it."""
        kind, name = self._rng.choice(
            (
                *((ComputeImpactMap, "compute_impact_map"),) * 3,
                *((ConfigureTrial, f"{node}/configure_trial") for node in ("plant", "controller", "recorder")),
                *((FinishTrial, f"{node}/finish_trial") for node in ("plant", "controller", "recorder")),
            )
        )
        wanted = kind.Request()
        if kind is ComputeImpactMap:
            wanted.scenario, wanted.object_name, wanted.case_name = "push", "juice", "case_1"
            wanted.restitution = -1.0
        return kind, name, self.fill(wanted, 0.7)


def numbers_of(message: Any) -> list[float]:
    """All floating-point numbers of a message."""
    found: list[float] = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        for item in value if hasattr(value, "__len__") and not isinstance(value, str) else [value]:
            if hasattr(item, "get_fields_and_field_types"):
                found += numbers_of(item)
            elif isinstance(item, float):
                found.append(item)
    return found


def disturb(graph: Graph, nonsense: Nonsense, folder: Path, publishers: list[Publisher], names: list[str]) -> str:
    """A trial into which messages are thrown; returns how it ended."""

    def throw(message: RunTrial.Impl.FeedbackMessage) -> None:
        del message
        for publisher in publishers:
            publisher.publish(nonsense.joint_state(names))

    return str(graph.call_trial(trial_in(folder), throw).outcome)


def main() -> int:
    """Attack and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000, help="requests and messages")
    parser.add_argument("--seed", type=int, default=0, help="of what is sent")
    parser.add_argument("--domain", type=int, default=89, help="ROS_DOMAIN_ID")
    arguments = parser.parse_args()
    nonsense, told, wrong = Nonsense(arguments.seed), Counter[str](), []
    names = [f"arm_joint{number}" for number in range(1, 8)]
    with tempfile.TemporaryDirectory() as folder, Graph.running("push", arguments.domain, root=Path(folder)) as graph:
        pids = {name: process.pid for name, process in graph.processes.items()}
        awaited = (topics.joint_states("arm"), topics.joint_command("arm"))
        publishers = [graph.node.create_publisher(JointState, topic, STREAM) for topic in awaited]
        for number in range(arguments.count):
            try:
                name = "run_trial"
                if number % TRIALS == 0:
                    told[f"trial {disturb(graph, nonsense, Path(folder) / str(number), publishers, names)}"] += 1
                kind, name, request = nonsense.request()
                try:
                    answer = graph.call(kind, name, request, timeout=20.0)
                except GraphError:  # a request into the discovery of a new client can be lost
                    told[f"{name} asked again"] += 1
                    answer = graph.call(kind, name, request, timeout=20.0)
                told[f"{name} {'answered' if answer.success else 'refused'}"] += 1
                if answer.success and not all(map(math.isfinite, numbers_of(answer))):
                    wrong.append(f"{name}: success with a number that is none")
                for publisher in publishers:
                    publisher.publish(nonsense.joint_state(names))
            except GraphError as error:
                wrong.append(f"{name}: {error}")
            dead = graph.nodes.dead()
            wrong += [f"node {name} ended with {how}: {graph.nodes.last_words(name)}" for name, how in dead.items()]
            if dead:
                graph.revive()
                graph.wait_until_ready()
            if number % 500 == 499:
                print(f"[{number + 1}/{arguments.count}] wrong {len(wrong)}", flush=True)
        time.sleep(1.0)
        for publisher in publishers:
            graph.node.destroy_publisher(publisher)
        wrong += [f"node {name} does not answer" for name in NODES if not graph.answers(name)]
        last = graph.call_trial(trial_in(Path(folder) / "last"))
        wrong += [] if last.outcome == "OK" else [f"the last trial: {last.outcome}, {last.message}"]
        lost = [name for name, process in graph.processes.items() if process.pid != pids[name]]
    for what, count in sorted(told.items()):
        print(f"{what}: {count}")
    for line, count in Counter(wrong).most_common(20):
        print(f"WRONG {count} x {line[:300]}")
    print(f"{arguments.count} requests and rounds of messages, nodes lost: {lost or 'none'}, wrong: {len(wrong)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
