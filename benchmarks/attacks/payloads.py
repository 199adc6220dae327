# SPDX-License-Identifier: Apache-2.0
"""Raw bytes for the nodes: ``./run python -m benchmarks.attacks.payloads``.

Every topic that a node subscribes to gets payloads that are random, cut off, of flipped bits, of endless lengths, of
another type, or of 200 kB; most of them during a trial. They come from nodes with the names of those that publish
there, for a trial with another publisher is aborted at once. Afterwards every node must be the same process and
answer, and an undisturbed trial must be OK.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import rclpy
from impact_rs.action import RunTrial
from rcl_interfaces.srv import GetParameters
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from impact_rs_ros.graph import Graph, GraphError
from impact_rs_ros.message_types import available, message_type
from impact_rs_ros.names import on_network
from impact_rs_ros.qos import LATCHED, STREAM
from impact_rs_trials.bags import topics

LARGE = 200_000  # bytes
BURST = 20  # payloads for every feedback of a trial
CONTROLLER = (topics.joint_command("arm"), topics.controller_state("arm"), topics.impact_event("arm"))
SMALL = (topics.CLOCK,)  # the middleware sends no more than the largest message of a type of fixed size


def trial_in(folder: Path) -> RunTrial.Goal:
    """A push, with its bag in a folder."""
    goal = RunTrial.Goal(scenario="push", object_name="juice", case_name="case_1", velocity_scale=1.0)
    goal.output_directory = str(folder)
    return goal


class Payloads:
    """Draws bytes.

    Args:
        seed: Of what is drawn.
    """

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self.sent: Counter[str] = Counter()
        kinds = {kind for kind in topics.recorded(["arm"]).values() if available(kind)}
        self._examples = {kind: _example(kind) for kind in sorted(kinds)}
        generators = (self._random, self._cut, self._flipped, self._endless, self._other, self._large)
        self._generators: dict[str, Callable[[str], bytes]] = {
            generator.__name__.strip("_"): generator for generator in generators
        }

    def draw(self, topic: str, kind: str) -> bytes:
        """A payload for a topic."""
        if topic in SMALL:
            name, data = "random", self._rng.randbytes(self._rng.randrange(12))
        else:
            name = self._rng.choice(list(self._generators))
            data = self._generators[name](kind)
        self.sent[name] += 1
        return data

    def _random(self, kind: str) -> bytes:
        del kind
        return self._rng.randbytes(self._rng.choice((0, 1, 4, 7, 16, 100, 1000)))

    def _cut(self, kind: str) -> bytes:
        example = self._examples[kind]
        return example[: self._rng.randrange(len(example))]

    def _flipped(self, kind: str) -> bytes:
        data = bytearray(self._stamped(kind))
        for _ in range(self._rng.randrange(1, 6)):
            bit = self._rng.randrange(8 * len(data))
            data[bit // 8] ^= 1 << bit % 8
        return bytes(data)

    def _endless(self, kind: str) -> bytes:
        data = bytearray(self._stamped(kind))
        offset = self._rng.randrange(4, max(5, len(data) - 3), 4)
        data[offset : offset + 4] = b"\xff\xff\xff\xff"
        return bytes(data)

    def _other(self, kind: str) -> bytes:
        return self._examples[self._rng.choice([other for other in self._examples if other != kind])]

    def _large(self, kind: str) -> bytes:
        """A large message that is well-formed, or one with as much behind it."""
        if kind == topics.JOINT_STATE and self._rng.random() < 0.7:
            values = [0.0] * (LARGE // 24)
            message = message_type(kind)(name=["arm_joint1"], position=values, velocity=values, effort=values)
            return bytes(serialize_message(message))
        return self._stamped(kind) + bytes(LARGE)

    def _stamped(self, kind: str) -> bytes:
        """A well-formed message; now and then its stamp, where it begins with one, is of a later tick."""
        data = self._examples[kind]
        if len(data) < 12 or self._rng.random() < 0.95:
            return data
        return data[:4] + bytes(4) + (self._rng.randrange(1800) * 1_000_000).to_bytes(4, "little") + data[12:]


def _example(kind: str) -> bytes:
    """A well-formed message; joints as in a trial."""
    message = message_type(kind)()
    if kind == topics.JOINT_STATE:
        message.name = [f"arm_joint{number}" for number in range(1, 8)]
        message.position = message.velocity = message.effort = [0.1] * 7
    return bytes(serialize_message(message))


def main() -> int:
    """Attack and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000, help="payloads")
    parser.add_argument("--seed", type=int, default=0, help="of what is sent")
    parser.add_argument("--domain", type=int, default=88, help="ROS_DOMAIN_ID")
    arguments = parser.parse_args()
    payloads, counts, failures = Payloads(arguments.seed), Counter[str](), []
    rng = random.Random(arguments.seed)
    kinds = {topic: kind for topic, kind in topics.recorded(["arm"]).items() if available(kind)}
    latched = topics.latched(["arm"])
    with tempfile.TemporaryDirectory() as folder, Graph.running("push", arguments.domain, root=Path(folder)) as graph:
        pids = {name: process.pid for name, process in graph.processes.items()}
        owners = {
            name: rclpy.create_node(name, context=graph.node.context, start_parameter_services=False)
            for name in ("plant", "controller", "experiment")
        }
        publishers: list[tuple[Publisher, str, str]] = []
        for topic, kind in kinds.items():
            owner = "experiment" if topic in latched else "controller" if topic in CONTROLLER else "plant"
            qos = LATCHED if topic in latched else STREAM
            publisher = owners[owner].create_publisher(message_type(kind), on_network(topic), qos)
            publishers.append((publisher, topic, kind))

        def throw(count: int) -> None:
            for _ in range(min(count, arguments.count - payloads.sent.total())):
                publisher, topic, kind = rng.choice(publishers)
                publisher.publish(payloads.draw(topic, kind))

        def in_trial(message: RunTrial.Impl.FeedbackMessage) -> None:
            del message
            throw(BURST)

        number = 0
        while payloads.sent.total() < arguments.count:
            number += 1
            throw(arguments.count // 100)  # between trials
            try:
                answer = graph.call_trial(trial_in(Path(folder) / str(number)), in_trial)
                counts[f"disturbed trial {answer.outcome}"] += 1
                print(answer.message)
            except GraphError as error:
                failures.append(f"trial: {error}")
            failures += graph.replace_lost()
            print(f"[{payloads.sent.total()}/{arguments.count}] wrong {len(failures)}", flush=True)
        time.sleep(1.0)
        for owner in owners.values():
            owner.destroy_node()
        for name in graph.processes:
            try:
                graph.call(GetParameters, f"{name}/get_parameters", GetParameters.Request())
            except GraphError as error:
                failures.append(f"{name}: {error}")
        last = graph.call_trial(trial_in(Path(folder) / "last"))
        failures += [] if last.outcome == "OK" else [f"the last trial: {last.outcome}, {last.message}"]
        lost = [name for name, process in graph.processes.items() if process.pid != pids[name]]
    for label, count in sorted((counts + payloads.sent).items()):
        print(f"{label}: {count}")
    for line, count in Counter(failures).most_common(20):
        print(f"WRONG {count} x {line[:300]}")
    print(f"{payloads.sent.total()} payloads, nodes lost: {lost or 'none'}, wrong: {len(failures)}")
    return 1 if failures or lost else 0


if __name__ == "__main__":
    sys.exit(main())
