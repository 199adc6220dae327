# SPDX-License-Identifier: Apache-2.0
"""The five nodes and their caller: runs trials through the nodes and restarts a node that dies."""

from __future__ import annotations

import logging
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self

import rclpy
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.srv import ComputeImpactMap, ConfigureTrial, FinishTrial
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from impact_rs_ros.middleware import set_middleware
from impact_rs_ros.names import full_namespace, within
from impact_rs_ros.node_processes import NODES, STOP_TIMEOUT, NodeProcesses, ours
from impact_rs_ros.presence import Presence
from impact_rs_sim.model import Model, model_text
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.campaign import Manifest, TrialReport, keep_failure
from impact_rs_trials.store import open_store

START_TIMEOUT = 60.0  # s, for all nodes to answer; imports take some seconds on a busy machine
FOREIGN_TIMEOUT = 120.0  # s, for the user's own node in place of one of ours; it may have to be started by hand
STARTS = 3  # of a node that is killed, or freezes, while it starts
QUESTIONS = 6  # requests that test whether a node answers; the first may be lost during discovery
ANSWER_TIMEOUT = 0.5  # s, for the answer to one; a longer pause of the machine leaves only one of them unanswered
SILENCE = 1.0  # s without feedback on a trial, after which the experiment node is asked whether it still answers
ATTEMPTS = 3  # of a trial; the next one after a kill may stall as well
RESULT_TIMEOUT = 10.0  # s, for the answer to a goal, beyond what the experiment node may wait itself

_CONFIGURABLE = {"configure_trial": ConfigureTrial, "finish_trial": FinishTrial}
SERVICES: dict[str, dict[str, Any]] = {
    "plant": {f"plant/{name}": kind for name, kind in (_CONFIGURABLE | {"run_trial": Trigger}).items()},
    "impact_map": {"compute_impact_map": ComputeImpactMap},
    "controller": {f"controller/{name}": kind for name, kind in _CONFIGURABLE.items()},
    "recorder": {f"recorder/{name}": kind for name, kind in _CONFIGURABLE.items()},
    "experiment": {},
}
"""Services of every node, with their types. A user's own node in its place has to offer the same."""

Notify = Callable[[str], None]

log = logging.getLogger(__name__)


class GraphError(RuntimeError):
    """The nodes cannot be run; the message says why."""


class NodeHangs(GraphError):
    """A node lives and does not answer."""


class Graph:
    """The five nodes, and this process as their caller; :meth:`running` starts them.

    Args:
        nodes: Processes of the nodes.
        node: Node of this process.
        foreign: Nodes that the user provides, by the name of the node that each replaces.
        notify: Called with a line about what is awaited.
    """

    def __init__(
        self, nodes: NodeProcesses, node: Node, foreign: Sequence[str] = (), notify: Notify = log.info
    ) -> None:
        self.nodes = nodes
        self.foreign = list(dict.fromkeys(foreign))
        self._notify = notify
        self.processes = nodes.processes
        self.node = node
        self.run_trial = ActionClient(node, RunTrial, "run_trial")
        self.run_campaign = ActionClient(node, RunCampaign, "run_campaign")
        self._clients: dict[str, list[Any]] = {
            owner: [node.create_client(kind, name) for name, kind in services.items()]
            for owner, services in SERVICES.items()
        }
        self.presence = Presence(node, NODES)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._revived: list[str] = []
        self._hung: list[str] = []

    @classmethod
    @contextmanager
    def running(
        cls,
        scenario: str,
        domain_id: int | None = None,
        parameters: Path | None = None,
        quiet: bool = True,
        root: Path | None = None,
        without: Sequence[str] = (),
        notify: Notify = log.info,
        namespace: str = "",
    ) -> Iterator[Self]:
        """A context manager with the nodes, which end with it.

        Nodes that run already in the same domain and namespace would answer as well; where that matters, give the graph
        its own domain or namespace.

        Args:
            scenario: Name or path of the scenario the nodes start with.
            domain_id: ``ROS_DOMAIN_ID``; None: the environment's.
            parameters: Parameter file; None: ``config/nodes.yaml``.
            quiet: Nodes write to a file, shown when one dies, and not to the terminal.
            root: Folder below which requests may write bags and name scenarios; None: the working directory.
            without: Nodes that the user provides; they are waited for, not started.
            notify: Called with a line about what is awaited.
            namespace: ROS namespace of the nodes; empty: the root.

        Raises:
            InputError: There is no such scenario, no such node, or no such namespace.
            GraphError: A node ended, or does not come up.
        """
        names = ours(without)
        with ExitStack() as stack:
            logs = stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rs_"))
            nodes = NodeProcesses.of(scenario, Path(logs), domain_id, parameters, quiet, root, namespace)
            stack.callback(nodes.stop)
            for name in names:
                nodes.start(name)
            set_middleware(os.environ)  # this process talks to them
            context = Context()
            rclpy.init(
                context=context, domain_id=int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain_id is None else domain_id
            )
            stack.callback(rclpy.try_shutdown, context=context)
            runner = rclpy.create_node(f"runner_{os.getpid()}", context=context, namespace=full_namespace(namespace))
            graph = cls(nodes, runner, without, notify)
            stack.callback(graph.close)
            graph.wait_until_ready()
            yield graph

    def close(self) -> None:
        """Destroy the clients of the nodes."""
        self._executor.shutdown(timeout_sec=1.0)
        self.run_trial.destroy()
        self.run_campaign.destroy()
        self.node.destroy_node()

    def spin(self, timeout: float) -> None:
        """Let messages arrive for at most ``timeout`` [s]; returns as soon as one did."""
        self._executor.spin_once(timeout_sec=timeout)

    def wait_until_ready(self) -> None:
        """Wait until every node offers its services and actions, the user's own nodes included.

        A node of ours that is killed or freezes meanwhile is started again.

        Raises:
            GraphError: A node ended by itself, or does not come up.
        """
        starts = dict.fromkeys(self.processes, 1)
        deadline = time.monotonic() + START_TIMEOUT
        while waiting := self._not_ready():
            self.end_frozen()
            if time.monotonic() > deadline:
                self._end([waiting])
                deadline = time.monotonic() + START_TIMEOUT
            for name, how in self.nodes.dead().items():
                if not self.nodes.was_ended(name) or starts[name] == STARTS:
                    raise GraphError(f"node {name} ended with {how} while starting: {self.nodes.last_words(name)}")
                starts[name] += 1
            self.revive()
        for name in self.foreign:
            self._await_foreign(name)

    def _not_ready(self) -> str:
        """Name of a node of ours that does not offer its services yet; empty: all do."""
        self.spin(0.02)
        for name in SERVICES:
            if name not in self.foreign and self._missing(name):
                return name
        # The middleware still lists the services of nodes that died.
        while self._revived and self.answers(self._revived[-1]):
            self._revived.pop()
        return self._revived[-1] if self._revived else ""

    def _await_foreign(self, name: str) -> None:
        """Wait for a node that the user provides, and notify once."""
        deadline = time.monotonic() + FOREIGN_TIMEOUT
        notified = False
        while missing := self._missing(name):
            what = "actions" if name == "experiment" else "services"
            if not notified:
                self._notify(f"waiting for a {name}: {what} {', '.join(missing)}; for {FOREIGN_TIMEOUT:g} s at most")
                notified = True
            for dead, how in self.nodes.dead().items():
                raise GraphError(f"node {dead} ended with {how}: {self.nodes.last_words(dead)}")
            if time.monotonic() > deadline:
                raise GraphError(
                    f"no {name} came within {FOREIGN_TIMEOUT:g} s: no node offers the {what} {', '.join(missing)} in "
                    f"ROS domain {self.node.context.get_domain_id()}"
                )
            self.spin(0.1)

    def _missing(self, name: str) -> list[str]:
        """Services and actions of a node that are not offered."""
        if name == "experiment":
            actions = {"run_trial": self.run_trial, "run_campaign": self.run_campaign}
            missing = [action for action, client in actions.items() if not client.server_is_ready()]
        else:
            missing = [client.srv_name for client in self._clients[name] if not client.service_is_ready()]
        return [self.node.resolve_service_name(service) for service in missing]

    def _ended(self, name: str) -> bool:
        """Whether the process of a node of ours has ended; false for the user's own nodes."""
        return name in self.processes and self.processes[name].poll() is not None

    def answers(self, name: str) -> bool:
        """Whether a node answers a request for one of its parameters."""
        client = self.node.create_client(GetParameters, f"{name}/get_parameters")
        try:
            for _ in range(QUESTIONS):
                if not self.is_there(name):
                    break
                future = client.call_async(GetParameters.Request(names=["scenario"]))
                deadline = time.monotonic() + ANSWER_TIMEOUT
                while not future.done() and time.monotonic() < deadline and self.is_there(name):
                    self.spin(0.02)
                if future.done():
                    return True
                client.remove_pending_request(future)
            return False
        finally:
            self.node.destroy_client(client)

    def is_there(self, name: str) -> bool:
        """Whether a node runs and its liveliness has not lapsed."""
        return not self._ended(name) and not self.presence.gone(name)

    def end_frozen(self) -> list[str]:
        """End every node that runs and is frozen; returns their names, which :meth:`revive` starts again."""
        return self._end([name for name in self.presence.gone(*self.processes) if not self._ended(name)])

    def end_hung(self) -> list[str]:
        """End every node that runs and does not answer, frozen or not; returns their names, as :meth:`end_frozen`."""
        running = [name for name, process in self.processes.items() if process.poll() is None]
        return self._end([name for name in running if not self.answers(name)])

    def _end(self, names: list[str]) -> list[str]:
        for name in names:
            self.nodes.kill(name)
        self._hung += names
        return names

    def died(self) -> list[str]:
        """Nodes whose process ended by itself or was killed from outside."""
        return [name for name in self.nodes.dead() if name not in self._hung]

    def revive(self) -> list[str]:
        """Restart every node of ours whose process has ended; returns a line about each."""
        died, lines = self.died(), []
        for name, how in self.nodes.dead().items():
            what = f"died ({how})" if name in died else "did not answer any more"
            lines.append(f"node {name} {what} and is started again: {self.nodes.last_words(name)}")
            self.nodes.start(name)
            self.presence.forget(name)
            if name not in self._revived:
                self._revived.append(name)
        self._hung.clear()
        return lines

    def call_trial(self, goal: RunTrial.Goal, feedback: Any = None) -> RunTrial.Result:
        """Run one trial.

        No trial is left running when this returns. An experiment node of ours that does not answer is killed, because
        it would reject the next trial, or run this one beside it.

        Raises:
            GraphError: The experiment node rejected the goal, or it or the recorder is gone.
        """
        try:
            return self._trial(goal, feedback)
        except NodeHangs:
            if "experiment" in self.processes and not self._ended("experiment"):
                self._end(["experiment"])
            raise

    def _trial(self, goal: RunTrial.Goal, feedback: Any) -> RunTrial.Result:
        heard = [time.monotonic()]

        def hear(message: Any) -> None:
            heard[0] = time.monotonic()
            if feedback is not None:
                feedback(message)

        handle = self._wait(self.run_trial.send_goal_async(goal, feedback_callback=hear), RESULT_TIMEOUT)
        if not handle.accepted:
            raise GraphError(f"the experiment node rejected the trial: {self.nodes.last_words('experiment')}")
        ended = handle.get_result_async()
        try:
            answer: RunTrial.Result = self._wait(ended, None, ("experiment", "recorder"), heard).result
        except (NodeHangs, KeyboardInterrupt):  # no node would answer, or all are stopping
            raise
        except BaseException as error:
            if not self._ended("experiment"):
                self._cancel(handle, ended, error)
            raise
        return answer

    def _cancel(self, handle: Any, ended: Any, error: BaseException) -> None:
        """Cancel a trial because of ``error``, and wait for its end; raises ``NodeHangs`` where it does not end."""
        try:
            self._wait(handle.cancel_goal_async(), STOP_TIMEOUT)
            self._wait(ended, RESULT_TIMEOUT)
        except NodeHangs:
            raise NodeHangs(str(error)) from error
        except GraphError:
            pass  # the node died

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
        """Result of a future; ``heard`` holds the time of the last feedback on the trial [s]."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not future.done():
            self.spin(0.1)
            for name in watched:
                if self._ended(name):
                    raise GraphError(f"node {name} died: {self.nodes.last_words(name)}")
            if not self.is_there("experiment"):
                raise NodeHangs("the experiment node froze")
            if deadline is not None and time.monotonic() > deadline:
                raise NodeHangs(f"no answer within {timeout:g} s")
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
    without: Sequence[str] = (),
    notify: Notify = log.info,
    namespace: str = "",
) -> Iterator[TrialReport]:
    """Run trials of a campaign through the nodes, one after the other; yields a report per trial as it ends.

    A node that dies ends its trial with an error and is started again; the campaign goes on.

    Args:
        directory: Campaign folder.
        manifest: The campaign.
        keys: Trials to run.
        domain_id: ``ROS_DOMAIN_ID`` of the nodes; None: the environment's.
        plant_model: Effects that the plant has and no other node is given; None: none.
        without: Nodes that the user provides; they are waited for before every trial.
        notify: Called with a line about what is awaited.
        namespace: ROS namespace of the nodes; empty: the root.

    Raises:
        InputError: There is no such namespace, or no node of a name in ``without``.
        GraphError: The nodes cannot be started, or a node that the user provides does not appear in time.
    """
    if not keys:
        return
    with Graph.running(
        manifest.scenario, domain_id, root=directory, without=without, notify=notify, namespace=namespace
    ) as graph:
        for key in keys:
            graph.wait_until_ready()
            yield run_trial(graph, directory, manifest, key, plant_model)


def run_trial(
    graph: Graph, directory: Path, manifest: Manifest, key: TrialKey, plant_model: Model | None = None
) -> TrialReport:
    """Run one trial of a campaign; failures are in the report, and nodes that died are started again.

    A trial that was aborted although no node died is repeated, at most twice: shortly after one process is killed,
    messages of the others may come too late. A node that does not answer is started again first.
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
        if outcome == "ABORTED":
            graph.end_hung()
        else:
            graph.end_frozen()
        died = graph.died()
        revived = graph.revive()
        ended += revived
        if revived:
            graph.wait_until_ready()
        if died or outcome != "ABORTED":
            break
    trace = graph.nodes.outputs() if outcome == "ABORTED" else ""
    report = TrialReport(key, outcome, "; ".join(filter(None, (message, *ended))), trace)
    return keep_failure(open_store(directory), report)


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
    known = load_scenario(scenario)
    started = stopping = False

    def stop(number: int, frame: object) -> None:
        nonlocal stopping
        del number, frame
        stopping = True
        if not started:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        notify = partial(print, flush=True)
        with Graph.running(
            scenario, domain_id, quiet=False, without=without, notify=notify, namespace=namespace
        ) as graph:
            started = True
            names = [*graph.processes, *(f"{name} (yours)" for name in graph.foreign)]
            which = known.name, next(iter(known.objects)), next(iter(known.cases))
            print(_instructions(names, *which, full_namespace(namespace)), flush=True)
            while not stopping:
                graph.end_frozen()
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


def _instructions(nodes: Sequence[str], scenario: str, object_name: str, case: str, namespace: str) -> str:
    what = f"{{scenario: {scenario}, object_name: {object_name}, case_name: {case}"
    return "\n".join(
        (
            f"The nodes are up: {', '.join(nodes)}. Ctrl-C stops them.",
            "",
            "Run a trial into the folder trials/:",
            f"  ros2 action send_goal --feedback {within(namespace, 'run_trial')} impact_rs/action/RunTrial \\",
            f'    "{what}, velocity_scale: 1.0, seed: 1, output_directory: trials}}"',
            "Call the impact map:",
            f"  ros2 service call {within(namespace, 'compute_impact_map')} impact_rs/srv/ComputeImpactMap \\",
            f'    "{what}, motor_inertia: reduced, restitution: -1.0}}"',
            "Monitor the nodes:",
            "  ros2 topic echo /diagnostics",
            f"  ros2 param describe {within(namespace, 'plant')} realtime",
        )
    )
