# SPDX-License-Identifier: Apache-2.0
"""The five nodes and their caller, which runs trials through them.

One rule for every failure in a campaign: a node that ends or freezes is *lost*. When a node is lost or a trial is
aborted, all nodes are stopped and started again, and the trial is repeated once.
"""

from __future__ import annotations

import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import rclpy
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial, ImpactDerivatives, ImpactIntervals, PredictImpact
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from impact_rs_ros.middleware import discovery, set_middleware
from impact_rs_ros.names import full_namespace
from impact_rs_ros.node_processes import NODES, NodeProcesses, nodes_to_start
from impact_rs_ros.presence import Presence
from impact_rs_ros.trial_session import MEMBERS
from impact_rs_sim.model import Model, model_text
from impact_rs_trials.bags.trial_info import Outcome, TrialKey
from impact_rs_trials.campaign import Manifest, TrialReport, record_failure, report_of_bag
from impact_rs_trials.store import open_store

START_TIMEOUT_S = 60.0  # for all nodes to answer; imports take some seconds on a busy machine
MAX_STARTS = 3  # of the nodes, if one is killed or freezes meanwhile
FOREIGN_TIMEOUT_S = 120.0  # for a user's node in place of one of ours, which may have to be started by hand
RESULT_TIMEOUT_S = 10.0  # for the answer of a service or to a goal
MAX_SILENCE_S = 60.0  # without feedback on a trial; longer than the experiment node waits for any other node

SERVICES: dict[str, dict[str, Any]] = {
    name: {f"{name}/configure_trial": ConfigureTrial, f"{name}/finish_trial": FinishTrial} for name in MEMBERS
} | {
    "impact_map": {
        "impact_map/predict": PredictImpact,
        "impact_map/intervals": ImpactIntervals,
        "impact_map/derivatives": ImpactDerivatives,
    }
}
"""Services of every node, with their types. A node of the user in its place must offer them, too."""

ACTIONS: dict[str, dict[str, Any]] = {
    "plant": {"plant/run_trial": RunTrial},
    "experiment": {"run_trial": RunTrial, "run_campaign": RunCampaign},
}
"""Actions of every node, likewise."""

Notify = Callable[[str], None]

log = logging.getLogger(__name__)


class GraphError(RuntimeError):
    """The nodes cannot be run; the message has the reason."""


class Graph:
    """The five nodes, and this process as their caller; :meth:`running` starts them.

    After a restart this process has a new node, too: the middleware lists the services of a killed node for 20 s, and a
    new participant never meets it.

    Methods raise :class:`GraphError` where nodes do not come up, refuse parameters, reject a goal, or do not answer.

    Args:
        nodes: Processes of the nodes.
        started: Names of the nodes to start.
        domain_id: ``ROS_DOMAIN_ID``.
        namespace: ROS namespace of the nodes; empty: the root.
        foreign: Nodes that the user provides, by the name of the node that each replaces.
        notify: Called with a line about the awaited node or trial.
    """

    def __init__(
        self,
        nodes: NodeProcesses,
        started: Sequence[str] = NODES,
        domain_id: int = 0,
        namespace: str = "",
        foreign: Sequence[str] = (),
        notify: Notify = log.info,
    ) -> None:
        self.nodes = nodes
        self.processes = nodes.processes
        self.foreign = list(dict.fromkeys(foreign))
        self._started = started
        self._domain_id = domain_id
        self._namespace = full_namespace(namespace)
        self._notify = notify
        self._last_feedback = 0.0  # time of the last feedback on a trial, on the monotonic clock [s]
        self._connect()

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
            quiet: Nodes write to a file, shown when one ends, and not to the terminal.
            root: Folder below which requests may write bags and name scenarios; None: the working directory.
            without: Nodes that the user provides; they are waited for, not started.
            notify: Called with a line about the awaited node or trial.
            namespace: ROS namespace of the nodes; empty: the root.

        Raises:
            InputError: There is no such scenario, no such node, or no such namespace.
        """
        names = nodes_to_start(without)
        with ExitStack() as stack:
            logs = stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rs_"))
            nodes = NodeProcesses.of(scenario, Path(logs), domain_id, parameters, quiet, root, namespace)
            set_middleware(os.environ)  # this process talks to them
            log.info(discovery(os.environ))
            domain = int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain_id is None else domain_id
            graph = cls(nodes, names, domain, namespace, without, notify)
            stack.callback(graph.close)
            stack.callback(nodes.stop)
            graph.start()
            yield graph

    def _connect(self) -> None:
        """Join the ROS domain with a new node and its clients."""
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self._domain_id)
        self.node = rclpy.create_node(f"runner_{os.getpid()}", context=self._context, namespace=self._namespace)
        self._actions = {
            owner: {name: ActionClient(self.node, kind, name) for name, kind in actions.items()}
            for owner, actions in ACTIONS.items()
        }
        self._services = {
            owner: {name: self.node.create_client(kind, name) for name, kind in services.items()}
            for owner, services in SERVICES.items()
        }
        self.run_trial = self._actions["experiment"]["run_trial"]
        self.run_campaign = self._actions["experiment"]["run_campaign"]
        self.presence = Presence(self.node, NODES)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Destroy the node of this process."""
        self._executor.shutdown(timeout_sec=1.0)
        for client in (client for actions in self._actions.values() for client in actions.values()):
            client.destroy()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def spin(self, timeout: float) -> None:
        """Wait for messages for at most ``timeout`` [s]; returns at the first one."""
        self._executor.spin_once(timeout_sec=timeout)

    def start(self) -> None:
        """Start our nodes, and wait until every node offers its services and actions, the user's own included.

        If a node is killed or freezes meanwhile, all are started again.
        """
        for _ in range(MAX_STARTS):
            for name in self._started:
                self.nodes.start(name)
            if not (cause := self._await_started()):
                self._await_foreign()
                return
            self._stop()
        raise GraphError(cause)

    def restart(self) -> None:
        """Stop all started nodes, and start them again."""
        self._stop()
        self.start()

    def wait_until_ready(self) -> None:
        """Restart all nodes if one is lost, and wait for the user's nodes."""
        if self.lost():
            self.restart()
        else:
            self._await_foreign()

    def replace_lost(self) -> list[str]:
        """Restart the lost nodes only: a campaign requested by another program goes on.

        Returns:
            A line about each.
        """
        lost = self.lost()
        for name, line in lost.items():
            if self.nodes.refused(name):
                raise GraphError(line)
            self.nodes.kill(name)
            self.nodes.start(name)
            self.presence.forget(name)
        return [f"{line}; it is started again" for line in lost.values()]

    def lost(self) -> dict[str, str]:
        """A line about each started node that ended or froze, by its name."""
        endings = dict.fromkeys(self.presence.lost(*self.processes), "froze") | self.nodes.ended()
        return {name: f"node {name} {endings}: {self.nodes.last_line(name)}" for name, endings in endings.items()}

    def _stop(self) -> None:
        """Stop all started nodes, lost ones first: they may react to SIGKILL alone."""
        for name in self.lost():
            self.nodes.kill(name)
        self.nodes.stop()
        self.close()
        self._connect()

    def _await_started(self) -> str:
        """Wait for the services of the started nodes; returns the reason of a failure, or an empty text."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while missing := [service for name in self._started for service in self._missing(name)]:
            self.spin(0.02)
            for name, line in self.lost().items():
                if self.nodes.failed(name):
                    raise GraphError(line)
                return line
            if time.monotonic() > deadline:
                return f"no node offers {', '.join(missing)} within {START_TIMEOUT_S:g} s"
        return ""

    def _await_foreign(self) -> None:
        """Wait for the nodes that the user provides, and notify once about each."""
        for name in self.foreign:
            deadline = time.monotonic() + FOREIGN_TIMEOUT_S
            notified = False
            while missing := self._missing(name):
                interfaces = ", ".join(missing)
                if not notified:
                    self._notify(f"waiting for a {name}: {interfaces}; for {FOREIGN_TIMEOUT_S:g} s at most")
                    notified = True
                for line in self.lost().values():
                    raise GraphError(line)
                if time.monotonic() > deadline:
                    raise GraphError(
                        f"no {name} came within {FOREIGN_TIMEOUT_S:g} s: no node offers {interfaces} in ROS domain "
                        f"{self._domain_id}; {discovery(os.environ)}"
                    )
                self.spin(0.1)

    def _missing(self, name: str) -> list[str]:
        """Services and actions of a node that are not offered."""
        full_name = self.node.resolve_service_name
        services = [
            full_name(interface)
            for interface, client in self._services.get(name, {}).items()
            if not client.service_is_ready()
        ]
        actions = [
            full_name(interface)
            for interface, client in self._actions.get(name, {}).items()
            if not client.server_is_ready()
        ]
        return services + [f"the action {action}" for action in actions]

    def call_trial(self, goal: RunTrial.Goal, feedback: Any = None) -> RunTrial.Result:
        """Run one trial; if the experiment node is silent, it may go on until :meth:`restart`."""

        def hear(message: Any) -> None:
            self._last_feedback = time.monotonic()
            if feedback is not None:
                feedback(message)

        handle = self._wait(self.run_trial.send_goal_async(goal, feedback_callback=hear), RESULT_TIMEOUT_S)
        if not handle.accepted:
            raise GraphError(f"the experiment node rejected the trial: {self.nodes.last_line('experiment')}")
        answer: RunTrial.Result = self._wait(handle.get_result_async(), MAX_SILENCE_S).result
        return answer

    def call(self, kind: Any, name: str, request: Any, timeout: float = RESULT_TIMEOUT_S) -> Any:
        """Call a service of a node, and wait at most ``timeout`` [s] for its answer."""
        client = self.node.create_client(kind, name)
        try:
            deadline = time.monotonic() + RESULT_TIMEOUT_S
            while not client.service_is_ready():
                if time.monotonic() > deadline:
                    raise GraphError(f"there is no service {client.srv_name}")
                self.spin(0.02)
            return self._wait(client.call_async(request), timeout, client.srv_name)
        finally:
            self.node.destroy_client(client)

    def _wait(self, future: Any, timeout: float, awaited: str = "the experiment node") -> Any:
        """Result of a future of ``awaited``; ``timeout`` [s] restarts with every feedback on a trial."""
        self._last_feedback = time.monotonic()
        while not future.done():
            self.spin(0.1)
            if line := self.lost().get("experiment"):
                raise GraphError(line)
            if time.monotonic() > self._last_feedback + timeout:
                raise GraphError(f"{awaited} is silent for {timeout:g} s")
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

    If a node is lost or a trial is aborted, all nodes are started again and the trial is repeated once.

    Args:
        directory: Campaign folder.
        manifest: The campaign.
        keys: Trials to run.
        domain_id: ``ROS_DOMAIN_ID`` of the nodes; None: the environment's.
        plant_model: Effects of the plant unknown to all other nodes; None: not any.
        without: Nodes that the user provides; they are waited for before every trial.
        notify: Called with a line about the awaited node or trial.
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
    graph: Graph,
    directory: Path,
    manifest: Manifest,
    key: TrialKey,
    plant_model: Model | None = None,
    repeated: bool = True,
) -> TrialReport:
    """Run one trial of a campaign; a failure, and every node that was lost, is named in the report.

    If a node is lost or the trial is aborted, all nodes are started again. An aborted trial is then repeated once,
    unless its bag is complete, or ``repeated`` is false: a robot that stopped does not move again by itself.

    Raises:
        GraphError: The nodes cannot be started again.
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
    outcome, message = _attempt(graph, goal)
    remarks = list(graph.lost().values())
    if outcome == "ABORTED" or remarks:
        remarks = [*(remarks or [message]), "all nodes were started again"]
        graph.restart()
        if outcome == "ABORTED":
            bag = directory / key.name
            if bag.exists():  # the recorder had closed it, and only the answer was lost
                bag_report = report_of_bag(key, bag)
                outcome, message = bag_report.outcome, bag_report.message
            elif repeated:
                outcome, message = _attempt(graph, goal)
    trace = graph.nodes.outputs() if outcome == "ABORTED" else ""
    report = TrialReport(key, outcome, "; ".join(filter(None, dict.fromkeys((message, *remarks)))), trace)
    return record_failure(open_store(directory), report)


def _attempt(graph: Graph, goal: RunTrial.Goal) -> tuple[Outcome, str]:
    """Outcome and message of a trial; ABORTED if the experiment node gives no outcome."""
    try:
        result = graph.call_trial(goal)
    except GraphError as error:
        return "ABORTED", str(error)
    return result.outcome, result.message
