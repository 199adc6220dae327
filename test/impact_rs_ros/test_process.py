# SPDX-License-Identifier: Apache-2.0
"""Diagnostics as an aggregator wants them: fresh by the node's clock, and an error where a trial failed."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock

from impact_rs_ros.cell_node import CellNode
from impact_rs_ros.controller_node import ControllerNode
from impact_rs_ros.experiment_node import ExperimentNode
from impact_rs_ros.impact_map_node import ImpactMapNode
from impact_rs_ros.node_parameters import defaults_of
from impact_rs_ros.plant_node import PlantNode
from impact_rs_ros.process import NodeProgram
from impact_rs_ros.recorder_node import RecorderNode
from impact_rs_ros.trial_session import Progress, TrialResult


class Offline(NodeProgram):
    """A node without a middleware, at 1.5 s of its trial."""

    kind = "plant"

    def __init__(self, line: str = "ok", failure: str = "") -> None:
        self.node = SimpleNamespace(get_clock=Clock, get_fully_qualified_name=lambda: "/plant")  # type: ignore[assignment]
        self.sent: list[DiagnosticArray] = []
        self._diagnostics = SimpleNamespace(publish=self.sent.append)  # type: ignore[assignment]
        self._line, self._failed = line, failure

    def trial_time(self) -> int:
        return 1_500_000_000

    def status(self) -> tuple[str, dict[str, object]]:
        return self._line, {"ticks": 3}

    def failure(self) -> str:
        return self._failed


def diagnosed(line: str = "ok", failure: str = "") -> DiagnosticArray:
    node = Offline(line, failure)
    node.diagnose(now=True)
    (message,) = node.sent
    return message


def test_diagnostics_have_the_time_of_day_and_the_trial_time_as_a_number() -> None:
    message = diagnosed()
    assert abs(message.header.stamp.sec - time.time()) < 60.0
    numbers = {one.key: one.value for one in message.status[0].values}
    assert numbers == {"ticks": "3", "trial_time [s]": "1.5"}


@pytest.mark.parametrize(
    ("line", "failure", "level", "message"),
    [
        ("ok", "", DiagnosticStatus.OK, "ok"),
        ("3 ticks skipped", "", DiagnosticStatus.WARN, "3 ticks skipped"),
        ("3 ticks skipped", "no torque for arm", DiagnosticStatus.ERROR, "no torque for arm"),
    ],
)
def test_a_failed_trial_is_an_error_and_a_poor_one_a_warning(
    line: str, failure: str, level: bytes, message: str
) -> None:
    (status,) = diagnosed(line, failure).status
    assert (status.level, status.message) == (level, message)


class Experiment(Offline):
    """An experiment node after a trial."""

    status, failure = ExperimentNode.status, ExperimentNode.failure

    def __init__(self, outcome: str, message: str) -> None:
        super().__init__()
        self._trials, self._aborted = 1, 0
        self._last = TrialResult(outcome, message, Path("bag"), Progress())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("outcome", "level"),
    [
        ("OK", DiagnosticStatus.OK),
        ("NO-IMPACT", DiagnosticStatus.WARN),
        ("DIVERGED", DiagnosticStatus.ERROR),
        ("LIMIT", DiagnosticStatus.ERROR),
        ("ABORTED", DiagnosticStatus.ERROR),
    ],
)
def test_the_experiment_node_tells_how_bad_the_last_trial_was(outcome: str, level: bytes) -> None:
    node = Experiment(outcome, "for a reason")
    node.diagnose(now=True)
    (status,) = node.sent[0].status
    assert status.level == level
    assert status.message == ("ok" if outcome == "OK" else f"last trial {outcome}: for a reason")


@pytest.mark.parametrize("program", [PlantNode, ControllerNode, ImpactMapNode, RecorderNode, ExperimentNode, CellNode])
def test_an_idle_node_wakes_up_four_times_a_second(program: type[NodeProgram]) -> None:
    """Kills: a recorder without a trial that looks for its messages a hundred times a second."""
    waits: list[float] = []
    node = object.__new__(program)
    nothing = {"running": False, "trial": None, "_recording": None, "_held_arms": None}
    for name, value in nothing.items():
        setattr(node, name, value)
    node._inbox = SimpleNamespace(clear=lambda: None)  # type: ignore[attr-defined]
    node._diagnosed = float("inf")
    node.parameter = defaults_of(program.kind).__getitem__  # type: ignore[method-assign]
    node.serve = waits.append  # type: ignore[method-assign]
    node.turn()
    assert waits == [0.25]
    node._diagnosed = time.monotonic() - 10.0
    node.diagnose = lambda: waits.append(-1.0)  # type: ignore[method-assign]
    node.turn()
    assert waits[1:] == [0.0, -1.0]  # diagnostics that are due are not waited for
