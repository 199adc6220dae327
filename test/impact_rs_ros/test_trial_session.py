# SPDX-License-Identifier: Apache-2.0
"""A failed trial names its cause, even one that shows only after the failure; viewers get descriptions at any time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from processes import PATIENCE, until
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String

from impact_rs_ros import node_parameters
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.presence import announce
from impact_rs_ros.process import close_goal
from impact_rs_ros.qos import LATCHED
from impact_rs_ros.trial_session import MEMBERS, Progress, TrialError, TrialSession
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.spec import TrialSpec

LATE = 0.7  # s, after which the second controller announces itself
PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan


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
    """All that a session talks to, in one node: a trial in which nothing happens and every node agrees."""

    def __init__(self, domain: int) -> None:
        super().__init__("actors", domain)
        self._group = ReentrantCallbackGroup()
        self._members = {name: rclpy.create_node(name, context=self.context) for name in MEMBERS}
        self._second = False
        for name, member in self._members.items():
            announce(member)
            self._serve(ConfigureTrial, f"{name}/configure_trial", self._agree)
            finish = self._nothing_to_finish if name == "controller" else self._agree
            self._serve(FinishTrial, f"{name}/finish_trial", finish)
        self.endless = False  # whether a goal of the plant ends only when it is cancelled
        self.ended: list[str] = []  # how each ended
        self._runs = ActionServer(
            self.node,
            RunTrial,
            "plant/run_trial",
            self._run,
            callback_group=self._group,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def _serve(self, kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
        self.node.create_service(kind, name, answer, callback_group=self._group)

    def _run(self, goal: Any) -> RunTrial.Result:
        deadline = time.monotonic() + PATIENCE
        while self.endless and not goal.is_cancel_requested and time.monotonic() < deadline:
            time.sleep(0.01)
        self.ended.append("cancelled" if goal.is_cancel_requested else "over")
        close_goal(goal, success=True)
        return RunTrial.Result(success=True, outcome="OK")

    def _agree(self, request: Any, response: Any) -> Any:
        response.success = True
        return response

    def _nothing_to_finish(self, request: Any, response: Any) -> Any:
        """As a second controller answers, which is in no trial."""
        response.message = "controller: there is no trial to finish"
        if self._second:
            self._second = False
            threading.Timer(LATE, announce, [self._members["controller"]]).start()
        return response

    def add_second_controller(self) -> None:
        """Its service is discovered, and it announces itself only after a request."""
        self._second = True
        self._serve(FinishTrial, "controller/finish_trial", self._nothing_to_finish)


@pytest.fixture(scope="module")
def stage(domain_ids: Callable[[], int]) -> Iterator[tuple[TrialSession, Actors]]:
    """A session, and those that it talks to."""
    domain = domain_ids()
    experiment, actors = Spinning("experiment", domain), Actors(domain)
    node_parameters.declare(experiment.node, "experiment")
    session = TrialSession(experiment.node)
    yield session, actors
    experiment.close()
    actors.close()
    session.close()


def test_descriptions_reach_a_viewer_that_comes_later(stage: tuple[TrialSession, Actors]) -> None:
    session, actors = stage
    session.describe(PLAN)
    viewer = Inbox(actors.node, LATCHED)
    viewer.connect({topics.ROBOT_DESCRIPTION: topics.STRING})
    ((_, message),) = until(lambda: list(viewer.take()), lambda: viewer.wait(0.05), "no description")
    assert isinstance(message, String)
    assert "<robot" in message.data
    viewer.close()


def test_a_trial_that_is_cancelled_cancels_the_goal_of_the_plant(
    stage: tuple[TrialSession, Actors], tmp_path: Path
) -> None:
    session, actors = stage
    actors.endless = True
    result = session.run(PLAN, TrialKey("juice", "case_1", 1.0, 0), 0, tmp_path, cancelled=lambda: True)
    until(lambda: actors.ended, lambda: time.sleep(0.01), "the goal goes on")
    actors.endless = False
    assert actors.ended == ["cancelled"]
    assert (result.outcome, result.message) == ("ABORTED", "cancelled")


def test_a_controller_without_a_state_is_said_to_have_none(
    stage: tuple[TrialSession, Actors], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: "no progress after t = nan s"."""
    session, actors = stage
    actors.endless = True
    with monkeypatch.context() as patched, pytest.raises(TrialError, match=r"no state of the controller for 0\.1 s:"):
        patched.setattr(node_parameters, "value", lambda *_: 0.1)
        session._follow(Progress(), PLAN, lambda _: None, lambda: False)
    until(lambda: actors.ended[-1:] == ["cancelled"], lambda: time.sleep(0.01), "the goal goes on")
    actors.endless = False


@pytest.mark.parametrize(  # in this order: the second controller stays
    ("second", "reason"),
    [(False, "controller: there is no trial to finish"), (True, "two nodes are called /controller")],
)
def test_a_failure_names_a_second_controller_met_at_the_end(
    stage: tuple[TrialSession, Actors], tmp_path: Path, second: bool, reason: str
) -> None:
    session, actors = stage
    if second:
        actors.add_second_controller()
    result = session.run(PLAN, TrialKey("juice", "case_1", 1.0, 0), 0, tmp_path)
    assert result.outcome == "ABORTED"
    assert reason in result.message
