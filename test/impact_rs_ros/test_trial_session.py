# SPDX-License-Identifier: Apache-2.0
"""A trial that fails names what lies behind it, also where that shows later than the failure."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from std_srvs.srv import Trigger

from impact_rs_ros import parameters
from impact_rs_ros.presence import announce
from impact_rs_ros.trial_session import MEMBERS, TrialSession
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.spec import TrialSpec

LATE = 0.7  # s, after which the second controller says that it is there


class Spinning:
    """A node in a participant of its own, with an executor that runs."""

    def __init__(self, name: str, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self._executor = MultiThreadedExecutor(num_threads=4, context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def close(self) -> None:
        self._executor.shutdown()
        rclpy.try_shutdown(context=self.context)
        self._thread.join()


class Actors(Spinning):
    """All that a session talks to, played by one node: a trial in which nothing happens and every node is content."""

    def __init__(self, domain: int) -> None:
        super().__init__("actors", domain)
        self._group = ReentrantCallbackGroup()
        self._members = {name: rclpy.create_node(name, context=self.context) for name in MEMBERS}
        self._second = False
        for name, member in self._members.items():
            announce(member)
            self._serve(ConfigureTrial, f"{name}/configure_trial", self._content)
            finish = self._nothing_to_finish if name == "controller" else self._content
            self._serve(FinishTrial, f"{name}/finish_trial", finish)
        self._serve(Trigger, "plant/run_trial", self._content)

    def _serve(self, kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
        self.node.create_service(kind, name, answer, callback_group=self._group)

    def _content(self, request: Any, response: Any) -> Any:
        response.success = True
        return response

    def _nothing_to_finish(self, request: Any, response: Any) -> Any:
        """As a second controller answers, of which the trial knows nothing."""
        response.message = "controller: there is no trial to finish"
        if self._second:
            self._second = False
            threading.Timer(LATE, announce, [self._members["controller"]]).start()
        return response

    def double(self) -> None:
        """Another controller: its service is met, and only when it is asked it begins to say that it is there."""
        self._second = True
        self._serve(FinishTrial, "controller/finish_trial", self._nothing_to_finish)


@pytest.fixture
def stage(domain_ids: Callable[[], int]) -> Iterator[tuple[TrialSession, Actors]]:
    """A session, and those that it talks to."""
    domain = domain_ids()
    experiment, actors = Spinning("experiment", domain), Actors(domain)
    parameters.declare(experiment.node, "experiment")
    session = TrialSession(experiment.node)
    yield session, actors
    experiment.close()
    actors.close()
    session.close()


@pytest.mark.parametrize(
    ("twice", "reason"),
    [(False, "controller: there is no trial to finish"), (True, "two nodes are called /controller")],
)
def test_a_second_controller_that_is_met_at_the_end_of_a_trial_is_what_the_failure_names(
    stage: tuple[TrialSession, Actors], tmp_path: Path, twice: bool, reason: str
) -> None:
    session, actors = stage
    if twice:
        actors.double()
    plan = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
    result = session.run(plan, TrialKey("juice", "case_1", 1.0, 0), 0, tmp_path)
    assert result.outcome == "ABORTED"
    assert reason in result.message
