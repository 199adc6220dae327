# SPDX-License-Identifier: Apache-2.0
"""Common parts of the nodes as processes: start, main loop, signals, diagnostics."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.action.server import ServerGoalHandle
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from impact_rs_ros import node_parameters, presence
from impact_rs_ros.managed import ManagedNode
from impact_rs_ros.middleware import discovery, set_middleware
from impact_rs_ros.qos import offered
from impact_rs_ros.roots import below, scenario_below
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.spec import TrialSpec

SUPERVISOR = "IMPACT_RS_SUPERVISOR"  # process id of the runner; a node does not outlive it
OWN_SERVICES = ("impact_rs.", "std_srvs.")  # packages of the service types that rclpy does not offer by itself
HARDWARE = "impact_rs"  # hardware_id on /diagnostics
THROTTLE_S = 5.0  # between two equal lines of the log
IDLE_WAIT_S = 0.25  # of an idle node in one turn: a signal to end is noticed after it, a request at once


class NodeProgram:
    """A node and its main loop.

    Contents of a request are checked at their use; a mistake raises ``InputError``, which the service answers.
    """

    kind: ClassVar[str]
    replaced_node: ClassVar[str] = ""
    """Node that it replaces in trials, and whose names of services it uses; empty: it replaces no other node."""
    background: ClassVar[bool] = True
    """Whether the process has a lower priority: a recorder that wakes up must not interrupt plant or controller."""

    managed: ClassVar[bool] = False
    """Whether it is a lifecycle node, whose transitions call the methods of their names."""

    def __init__(self) -> None:
        self.active = self.over = False
        self._offered = False
        self._scenario: Scenario | None = None  # that it is configured for
        self.node = ManagedNode(self) if self.managed else Node(self.kind)
        self.log = self.node.get_logger()
        node_parameters.declare(self.node, self.kind)
        self.executor = self.make_executor()
        self.executor.add_node(self.node)
        self._alive = presence.announce(self.node, self.role("alive"))
        self._diagnostics = self.node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, offered(topics.DIAGNOSTICS))
        self._diagnosed = time.monotonic()

    def role(self, name: str) -> str:
        """Name of a topic or service of this node, or of the node in whose place it serves."""
        return f"{self.replaced_node}/{name}" if self.replaced_node else f"~/{name}"

    def make_executor(self) -> Executor:
        """Executor of services, actions and parameters."""
        return SingleThreadedExecutor()

    def start(self) -> None:
        """Configure and activate the node; called once, before the first turn. ``autostart`` false: wait for that."""
        self.log.info(discovery(os.environ))
        if not isinstance(self.node, ManagedNode):
            self.configure()
            self.activate()
        elif self.parameter("autostart"):
            self.node.start()

    def configure(self) -> None:
        """Read scenario and parameters, and load the data of the first trial.

        It takes a second, and services are offered afterwards: a caller that discovers a service finds the node ready.

        Raises:
            InputError: The scenario cannot be read.
        """
        self._scenario = scenario = load_scenario(self.parameter("scenario"))
        try:
            self.rehearse(TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases))))
        except InputError as error:
            self.log.error(str(error))

    def activate(self) -> None:
        """Connect to the topics of the scenario's arms, and offer services and actions."""
        assert self._scenario is not None
        self.connect(list(self._scenario.robots), list(self._scenario.neighbours))
        self.active = True
        if not self._offered:
            self.offer()
        self._offered = True
        self.log.info(
            f"ready: serves {', '.join(self.served())} in ROS domain {self.node.context.get_domain_id()}, namespace "
            f"{self.node.get_namespace()}; {node_parameters.text(self.node, self.kind)}"
        )

    def deactivate(self) -> None:
        """End what runs; requests are refused until :meth:`activate`."""
        self.active = False

    def cleanup(self) -> None:
        """Forget what :meth:`configure` read."""
        self._scenario = None

    def finish(self) -> None:
        """End the process."""
        self.over = True

    def check_active(self) -> None:
        """Raise ``InputError`` if requests are refused."""
        if self.managed and not self.active:
            name = self.node.get_fully_qualified_name()
            raise InputError(f"{name} is not active: ros2 lifecycle set {name} activate")

    def rehearse(self, spec: TrialSpec) -> None:
        """Load the data of a trial for this node."""
        _ = spec.scene

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        """Create publishers and subscriptions for arms and neighbours of the object, in place of earlier ones."""

    def offer(self) -> None:
        """Offer services and actions."""

    def served(self) -> list[str]:
        """Full names of the services and actions that the node offers by itself."""
        services = [service for service in self.node.services if service.srv_type.__module__.startswith(OWN_SERVICES)]
        return [self.node.resolve_service_name(service.srv_name) for service in services]

    def trial_time(self) -> int:
        """Trial time [ns], one of the numbers on ``/diagnostics``."""
        return 0

    def parameter(self, name: str) -> Any:
        """Present value of a parameter."""
        return node_parameters.value(self.node, name)

    def scenario_name(self, requested: str) -> str:
        """Name or path of the scenario of a request, below ``config_root``; empty: the node's own."""
        return scenario_below(requested, self.parameter("scenario"), self.parameter("config_root"))

    def scenario(self, requested: str) -> Scenario:
        """The scenario of a request, as :meth:`scenario_name` finds it."""
        return load_scenario(self.scenario_name(requested))

    def output(self, requested: str, key: str) -> Path:
        """Output path of a request, below ``data_root``; ``key`` is its field."""
        return below(requested, self.parameter("data_root"), key, "data_root")

    def serve(self, timeout: float) -> None:
        """Serve one message or request, waiting for it for at most ``timeout`` [s].

        Neither ends a node: the middleware raises where bytes are not a message, and so may a service.
        """
        try:
            self.executor.spin_once(timeout_sec=timeout)
        except ExternalShutdownException:
            raise
        except Exception as error:
            self.log.error(
                f"a message or request could not be served and is dropped: {full_traceback(error)}",
                throttle_duration_sec=THROTTLE_S,
            )

    @contextmanager
    def answering(self, response: Any, task: str) -> Iterator[None]:
        """Answer a failing request with the reason: no request ends a node."""
        try:
            yield
        except InputError as error:
            self.log.error(f"trial refused: {error}")
            response.message = str(error)
        except Exception as error:
            self.log.error(f"cannot {task}: {full_traceback(error)}")
            response.message = f"{self.kind}: {type(error).__name__}: {error}"

    def turn(self) -> None:
        """One turn of the main loop; must return within a fraction of a second."""
        due = self._diagnosed + self.parameter("diagnostics_period") - time.monotonic()
        self.serve(min(IDLE_WAIT_S, max(0.0, due)))
        self.diagnose()

    def status(self) -> tuple[str, Mapping[str, object]]:
        """A line and numbers for ``/diagnostics``; a line that does not begin with ``ok`` is a warning."""
        return "ok", {}

    def failure(self) -> str:
        """Reason of a failed or aborted present or last trial, an error on ``/diagnostics``; empty: no failure."""
        return ""

    def diagnose(self, now: bool = False) -> None:
        """Publish diagnostics if they are due, or ``now``."""
        clock = time.monotonic()
        if not now and clock - self._diagnosed < self.parameter("diagnostics_period"):
            return
        self._diagnosed = clock
        line, numbers = self.status()
        numbers = {**numbers, "trial_time [s]": 1e-9 * self.trial_time()}
        level = DiagnosticStatus.OK if line.startswith("ok") else DiagnosticStatus.WARN
        if failure := self.failure():
            level, line = DiagnosticStatus.ERROR, failure
        message = DiagnosticArray()
        message.header.stamp = self.node.get_clock().now().to_msg()  # aggregators drop old messages
        message.status = [
            DiagnosticStatus(
                level=level,
                name=self.node.get_fully_qualified_name(),
                message=line,
                hardware_id=HARDWARE,
                values=[KeyValue(key=key, value=str(number)) for key, number in numbers.items()],
            )
        ]
        self._diagnostics.publish(message)

    def close(self) -> None:
        """Close open files and subscriptions; the process ends."""


def close_goal(goal: ServerGoalHandle, success: bool) -> None:
    """Close a goal of an action: cancelled where that was requested, otherwise succeeded or aborted."""
    if goal.is_cancel_requested:
        goal.canceled()
    elif success:
        goal.succeed()
    else:
        goal.abort()


def run(program: type[NodeProgram]) -> None:
    """Run a node until SIGINT or SIGTERM, or until its supervisor has ended."""
    stopping = False

    def stop(number: int, frame: object) -> None:
        nonlocal stopping
        del number, frame
        stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    if program.background and hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # before the middleware starts its threads
    supervisor = os.environ.get(SUPERVISOR)
    set_middleware(os.environ)
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    try:
        try:
            if unknown := remove_ros_args(sys.argv)[1:]:
                raise InputError(f"{' '.join(unknown)}: expected --ros-args first, as in --ros-args -p scenario:=push")
            node_parameters.refuse_former_sections(sys.argv, program.kind)
            node = program()
        except (InputError, ParameterException) as error:
            get_logger(program.kind).fatal(f"parameter refused: {error}")
            raise SystemExit(2) from None
        try:
            node.start()
            while not (stopping or node.over) and rclpy.ok():
                if supervisor is not None and os.getppid() != int(supervisor):
                    break
                node.turn()
        except (ExternalShutdownException, KeyboardInterrupt):
            pass
        finally:
            node.close()
            node.executor.shutdown(timeout_sec=1.0)
            node.node.destroy_node()
    finally:
        rclpy.try_shutdown()
