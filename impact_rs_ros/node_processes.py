# SPDX-License-Identifier: Apache-2.0
"""The five nodes as processes: started, monitored and stopped together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from impact_rs_ros.middleware import set_middleware
from impact_rs_ros.names import full_namespace
from impact_rs_ros.process import SUPERVISOR
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.paths import config_directory
from impact_rs_sim.scenarios.scenario_files import scenario_path

NODES = ("plant", "impact_map", "controller", "recorder", "experiment")
REFUSED_EXIT_CODE = 2  # of a node with a parameter that is not allowed; starting it again does not help
STOP_TIMEOUT_S = 10.0  # for all nodes to end after SIGTERM
CLOSING_S = 6.0  # part of that timeout, for the experiment node to end its trial


def nodes_to_start(without: Sequence[str]) -> list[str]:
    """The nodes to start, if the user provides the nodes of ``without``.

    Raises:
        InputError: There is no such node.
    """
    for name in without:
        if name not in NODES:
            expected = f"expected one or more of {', '.join(NODES)}"
            raise InputError(f"no node {name!r}{did_you_mean(name, NODES)}; {expected}", key="without")
    return [name for name in NODES if name not in without]


class NodeProcesses:
    """Processes of the nodes, started by :meth:`start`.

    Args:
        arguments: Arguments of every node, behind ``--ros-args``.
        environment: Environment of every node.
        logs: Folder that they write into.
        quiet: Whether they write to files there, and not to the terminal.

    Attributes:
        processes: The process of every node, by its name.
        environment: Environment of every node.
    """

    def __init__(self, arguments: list[str], environment: Mapping[str, str], logs: Path, quiet: bool) -> None:
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._arguments = arguments
        self.environment = dict(environment)
        self._logs = logs
        self._quiet = quiet

    @classmethod
    def of(
        cls,
        scenario: str,
        logs: Path,
        domain_id: int | None = None,
        parameters: Path | None = None,
        quiet: bool = True,
        root: Path | None = None,
        namespace: str = "",
    ) -> Self:
        """The nodes of a scenario, with the arguments of :meth:`impact_rs_ros.graph.Graph.running`.

        Quiet nodes write only warnings and errors, to files in the folder ``logs``.

        Raises:
            InputError: There is no such scenario, or no such namespace.
        """
        path = scenario_path(scenario)
        scenario_argument = str(path.resolve()) if scenario.endswith((".yaml", ".yml")) else scenario
        arguments = [
            "--params-file",
            str(parameters or config_directory() / "nodes.yaml"),
            "-p",
            f"scenario:={scenario_argument}",
        ]
        arguments += ["-r", f"__ns:={full_namespace(namespace)}"]
        if root is not None:
            for name in ("config_root", "data_root"):  # a node without such a parameter ignores it
                arguments += ["-p", f"{name}:={root.resolve()}"]
        environment = dict(os.environ)
        set_middleware(environment)
        environment.setdefault("OMP_NUM_THREADS", "1")  # the matrices are small; more threads cost time
        environment[SUPERVISOR] = str(os.getpid())
        if domain_id is not None:
            environment["ROS_DOMAIN_ID"] = str(domain_id)
        if quiet:
            arguments += ["--log-level", "warn"]
            environment["ROS_LOG_DIR"] = str(logs)
        return cls(arguments, environment, logs, quiet)

    def start(self, name: str) -> None:
        """Start a node, with an empty log."""
        with open(self._log(name), "wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", f"impact_rs_ros.{name}_node", "--ros-args", *self._arguments],
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log if self._quiet else None,
                stderr=subprocess.STDOUT if self._quiet else None,
                start_new_session=True,  # Ctrl-C reaches only the runner, which stops the nodes in order
            )

    def ended(self) -> dict[str, str]:
        """Descriptions of how nodes ended, by name, of all whose process has ended."""
        return {name: _how(process) for name, process in self.processes.items() if process.poll() is not None}

    def failed(self, name: str) -> bool:
        """Whether a node ended by itself, with an error."""
        return (self.processes[name].poll() or 0) > 0

    def refused(self, name: str) -> bool:
        """Whether a node ended because of a mistake of the user."""
        return self.processes[name].poll() == REFUSED_EXIT_CODE

    def kill(self, name: str) -> None:
        """End a node by force."""
        self.processes[name].kill()
        self.processes[name].wait()

    def output(self, name: str) -> str:
        """Output of a quiet node since its start."""
        return self._log(name).read_text(errors="replace")

    def outputs(self) -> str:
        """Output of quiet nodes, warnings and tracebacks, node by node."""
        written = {name: self.output(name).strip() for name in self.processes}
        return "\n\n".join(f"node {name} wrote:\n{text}" for name, text in written.items() if text)

    def last_line(self, name: str) -> str:
        """Last line that a quiet node wrote."""
        lines = self.output(name).strip().splitlines()
        return lines[-1] if lines else "it wrote nothing" if self._quiet else "see its output above"

    def stop(self) -> None:
        """Stop every node with SIGTERM, and with SIGKILL after a timeout."""
        running = {name: process for name, process in self.processes.items() if process.poll() is None}
        began = time.monotonic()
        # The experiment first: it closes the running trial.
        for name in ("experiment", *self.processes):
            if name in running:
                process = running.pop(name)
                process.terminate()  # SIGTERM: a node that is still importing ends without a traceback
                if name == "experiment":
                    _wait_for(process, began + CLOSING_S)
        deadline = began + STOP_TIMEOUT_S
        for process in self.processes.values():
            _wait_for(process, deadline)

    def _log(self, name: str) -> Path:
        return self._logs / f"{name}.log"


def _wait_for(process: subprocess.Popen[bytes], deadline: float) -> None:
    try:
        process.wait(max(0.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _how(process: subprocess.Popen[bytes]) -> str:
    code = process.returncode
    return f"was killed ({signal.Signals(-code).name})" if code < 0 else f"ended with exit code {code}"
