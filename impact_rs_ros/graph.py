# SPDX-License-Identifier: Apache-2.0
"""The five nodes and somebody who calls them: trials through the nodes, and what to do when one of them dies."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import rclpy
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.srv import ComputeImpactMap, ConfigureTrial
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_rs_ros.node_processes import NODES, STOP_TIMEOUT, NodeProcesses
from impact_rs_sim.model import Model, model_text
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.campaign import Manifest, TrialReport, keep_failure
from impact_rs_trials.store import open_store

START_TIMEOUT = 60.0  # s, for all nodes to answer; imports take some seconds on a busy machine
ANSWER_TIMEOUT = 3.0  # s, for a node to answer something harmless
SILENCE = 1.0  # s, after which an experiment node that tells nothing of a trial is asked whether it is there
ATTEMPTS = 2  # of a trial
RESULT_TIMEOUT = 10.0  # s, for the answer to a goal, beyond what the experiment node may wait itself


class GraphError(RuntimeError):
    """The nodes cannot be run; the message says why."""


class NodeHangs(GraphError):
    """A node lives and does not answer."""


class Graph:
    """The five nodes, and this process as somebody who calls them; :meth:`running` starts all.

    Args:
        nodes: Processes of the nodes.
        node: Node of this process.
    """

    def __init__(self, nodes: NodeProcesses, node: Node) -> None:
        self.nodes = nodes
        self.processes = nodes.processes
        self.node = node
        self.run_trial = ActionClient(node, RunTrial, "run_trial")
        self.run_campaign = ActionClient(node, RunCampaign, "run_campaign")
        self._services = [
            node.create_client(ConfigureTrial, f"{name}/configure_trial")
            for name in ("plant", "controller", "recorder")
        ]
        self._services.append(node.create_client(ComputeImpactMap, "compute_impact_map"))
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._revived: list[str] = []

    @classmethod
    @contextmanager
    def running(
        cls,
        scenario: str,
        domain_id: int | None = None,
        parameters: Path | None = None,
        quiet: bool = True,
        root: Path | None = None,
    ) -> Iterator[Self]:
        """A context manager with the nodes, which end with it.

        Nodes that run already in the same domain would answer as well; where that matters, give the graph its own
        domain.

        Args:
            scenario: Name or path of the scenario the nodes start with.
            domain_id: ``ROS_DOMAIN_ID``; None: the environment's.
            parameters: Parameter file; None: ``config/nodes.yaml``.
            quiet: Nodes write to a file, shown when one dies, and not to the terminal.
            root: Folder in which requests may have bags written and name scenarios; None: the working directory.

        Raises:
            InputError: There is no such scenario.
            GraphError: A node ended, or does not come up.
        """
        with ExitStack() as stack:
            logs = stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rs_"))
            nodes = NodeProcesses.of(scenario, Path(logs), domain_id, parameters, quiet, root)
            stack.callback(nodes.stop)
            for name in NODES:
                nodes.start(name)
            os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # this process talks to them
            context = Context()
            rclpy.init(
                context=context, domain_id=int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain_id is None else domain_id
            )
            stack.callback(rclpy.try_shutdown, context=context)
            graph = cls(nodes, rclpy.create_node(f"runner_{os.getpid()}", context=context))
            stack.callback(graph.close)
            graph.wait_until_ready()
            yield graph

    def close(self) -> None:
        """Take down what calls the nodes."""
        self._executor.shutdown(timeout_sec=1.0)
        self.run_trial.destroy()
        self.run_campaign.destroy()
        self.node.destroy_node()

    def spin(self, timeout: float) -> None:
        """Let messages arrive for at most ``timeout`` [s]; returns as soon as one did."""
        self._executor.spin_once(timeout_sec=timeout)

    def wait_until_ready(self) -> None:
        """Wait until every node offers its services.

        Raises:
            GraphError: A node ended, or does not come up.
        """
        deadline = time.monotonic() + START_TIMEOUT
        while not (
            self.run_trial.server_is_ready()
            and self.run_campaign.server_is_ready()
            and all(client.service_is_ready() for client in self._services)
        ):
            self._check_starting()
            if time.monotonic() > deadline:
                raise GraphError(f"the nodes did not all come up within {START_TIMEOUT:g} s")
            self.spin(0.02)
        while self._revived:  # the middleware still knows the dead ones and takes their services for ready
            self._check_starting()
            if time.monotonic() > deadline:
                raise GraphError(f"the {self._revived[-1]} node does not answer")
            if self.answers(self._revived[-1]):
                self._revived.pop()

    def _check_starting(self) -> None:
        for name, how in self.nodes.dead().items():
            raise GraphError(f"node {name} ended with {how} while starting: {self.nodes.last_words(name)}")

    def answers(self, name: str) -> bool:
        """Whether a node answers something harmless."""
        client = self.node.create_client(GetParameters, f"{name}/get_parameters")
        deadline = time.monotonic() + ANSWER_TIMEOUT
        try:
            while time.monotonic() < deadline and self.processes[name].poll() is None:
                future = client.call_async(GetParameters.Request(names=["scenario"]))
                attempt = time.monotonic() + 0.5  # a request into the discovery of a new client can be lost
                while not future.done() and time.monotonic() < attempt:
                    self.spin(0.02)
                if future.done():
                    return True
                client.remove_pending_request(future)
            return False
        finally:
            self.node.destroy_client(client)

    def end_hung(self) -> list[str]:
        """End every node that lives and does not answer; returns their names."""
        hung = [name for name, process in self.processes.items() if process.poll() is None and not self.answers(name)]
        for name in hung:
            self.nodes.kill(name)
        return hung

    def revive(self, hung: Sequence[str] = ()) -> list[str]:
        """Start the nodes again that have died, or ``hung``; returns a line about each."""
        lines = []
        for name, how in self.nodes.dead().items():
            what = "did not answer any more" if name in hung else f"died ({how})"
            lines.append(f"node {name} {what} and is started again: {self.nodes.last_words(name)}")
            self.nodes.start(name)
            self._revived.append(name)
        return lines

    def call_trial(self, goal: RunTrial.Goal, feedback: Any = None) -> RunTrial.Result:
        """Run one trial.

        Raises:
            GraphError: The experiment node rejected the goal, or it or the recorder is gone.
        """
        heard = [time.monotonic()]

        def hear(message: Any) -> None:
            heard[0] = time.monotonic()
            if feedback is not None:
                feedback(message)

        handle = self._wait(self.run_trial.send_goal_async(goal, feedback_callback=hear), RESULT_TIMEOUT)
        if not handle.accepted:
            raise GraphError("the experiment node rejected the trial: another one is running")
        ended = handle.get_result_async()
        try:
            answer: RunTrial.Result = self._wait(ended, None, ("experiment", "recorder"), heard).result
        except (NodeHangs, KeyboardInterrupt):  # nobody is left to ask, or all are told to stop
            raise
        except BaseException:
            if self.processes["experiment"].poll() is None:
                with suppress(GraphError):  # what went wrong first is what is told
                    self._wait(handle.cancel_goal_async(), STOP_TIMEOUT)
                    self._wait(ended, RESULT_TIMEOUT)  # else the next goal would be rejected
            raise
        return answer

    def call(self, kind: Any, name: str, request: Any, timeout: float = RESULT_TIMEOUT) -> Any:
        """Call a service of a node, and wait at most ``timeout`` [s] for its answer.

        Raises:
            GraphError: It does not answer.
        """
        client = self.node.create_client(kind, name)
        try:
            deadline = time.monotonic() + RESULT_TIMEOUT
            while not client.service_is_ready():
                if time.monotonic() > deadline:
                    raise GraphError(f"there is no service {client.srv_name}")
                self.spin(0.02)
            return self._wait(client.call_async(request), timeout)
        finally:
            self.node.destroy_client(client)

    def _wait(
        self,
        future: Any,
        timeout: float | None,
        watched: tuple[str, ...] = ("experiment",),
        heard: list[float] | None = None,
    ) -> Any:
        """Result of a future; ``heard`` holds when the experiment node told something of its trial [s]."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not future.done():
            self.spin(0.1)
            for name in watched:
                if self.processes[name].poll() is not None:
                    raise GraphError(f"node {name} died: {self.nodes.last_words(name)}")
            if deadline is not None and time.monotonic() > deadline:
                raise GraphError(f"no answer within {timeout:g} s")
            if heard is not None and time.monotonic() > heard[0] + SILENCE:
                heard[0] = time.monotonic()
                if not self.answers("experiment"):
                    raise NodeHangs("the experiment node does not answer")
        return future.result()


def run_trials_through_nodes(
    directory: Path,
    manifest: Manifest,
    keys: list[TrialKey],
    domain_id: int | None = None,
    plant_model: Model | None = None,
) -> Iterator[TrialReport]:
    """Run trials of a campaign through the nodes, one after the other; yields a report per trial as it ends.

    A node that dies ends its trial with an error and is started again; the campaign goes on.

    Args:
        directory: Campaign folder.
        manifest: The campaign.
        keys: Trials to run.
        domain_id: ``ROS_DOMAIN_ID`` of the nodes; None: the environment's.
        plant_model: Effects that the plant has and nobody else knows; None: none.

    Raises:
        GraphError: The nodes cannot be started.
    """
    if not keys:
        return
    with Graph.running(manifest.scenario, domain_id, root=directory) as graph:
        for key in keys:
            yield run_trial(graph, directory, manifest, key, plant_model)


def run_trial(
    graph: Graph, directory: Path, manifest: Manifest, key: TrialKey, plant_model: Model | None = None
) -> TrialReport:
    """Run one trial of a campaign; whatever goes wrong is told in the report, and what died is started again.

    A trial that was aborted although no node died is run once more, and a node that does not answer any more is started
    again first: after one process was killed, the shared memory between them can trap another one in the middleware.
    """
    goal = RunTrial.Goal(
        scenario=manifest.scenario,
        object_name=key.object,
        case_name=key.case,
        velocity_scale=key.scale,
        seed=key.seed(manifest.seed),
        repeat=key.repeat,
        motor_inertia=manifest.motor_inertia,
        output_directory=str(directory.resolve()),
        plant_model="" if plant_model is None else model_text(plant_model),
    )
    ended: list[str] = []
    for _ in range(ATTEMPTS):
        try:
            result = graph.call_trial(goal)
            outcome, message = result.outcome, result.message
        except GraphError as error:
            outcome, message = "ABORTED", str(error)
        hung = graph.end_hung() if outcome == "ABORTED" else []
        revived = graph.revive(hung)
        ended += revived
        if revived:
            graph.wait_until_ready()
        if len(revived) > len(hung) or outcome != "ABORTED":
            break
    trace = graph.nodes.outputs() if outcome == "ABORTED" else ""
    report = TrialReport(key, outcome, "; ".join(filter(None, (message, *ended))), trace)
    return keep_failure(open_store(directory), report)


def up(scenario: str, domain_id: int | None = None) -> int:
    """Run the nodes until Ctrl-C, and tell how to call them.

    Args:
        scenario: Name or path of the scenario.
        domain_id: ``ROS_DOMAIN_ID``; None: the environment's.

    Returns:
        Exit code of the process.
    """
    known = load_scenario(scenario)
    stopping = False

    def stop(number: int, frame: object) -> None:
        nonlocal stopping
        del number, frame
        stopping = True

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with Graph.running(scenario, domain_id, quiet=False) as graph:
            print(_instructions(known.name, next(iter(known.objects)), next(iter(known.cases))), flush=True)
            while not stopping:
                for line in graph.revive():
                    print(line, file=sys.stderr, flush=True)
                graph.spin(0.2)
            print("stopping the nodes", flush=True)
    except GraphError as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _instructions(scenario: str, object_name: str, case: str) -> str:
    what = f"{{scenario: {scenario}, object_name: {object_name}, case_name: {case}"
    return "\n".join(
        (
            f"The nodes are up: {', '.join(NODES)}. Ctrl-C stops them.",
            "",
            "Run a trial into the folder trials/:",
            "  ros2 action send_goal --feedback /run_trial impact_rs/action/RunTrial \\",
            f'    "{what}, velocity_scale: 1.0, seed: 1, output_directory: trials}}"',
            "Ask the impact map:",
            "  ros2 service call /compute_impact_map impact_rs/srv/ComputeImpactMap \\",
            f'    "{what}, motor_inertia: reduced, restitution: -1.0}}"',
            "Look on:",
            "  ros2 topic echo /diagnostics",
            "  ros2 param describe /plant realtime",
        )
    )
