# SPDX-License-Identifier: Apache-2.0
"""Plant, controller, recorder and cell are managed nodes; an inactive one is at rest and refuses trials."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetState
from node_trials import configuration
from rclpy.action import ActionClient
from robot_bench import PUSH

from impact_rs_ros import cell_node
from impact_rs_ros.cell_node import CellNode
from impact_rs_ros.controller_node import ControllerNode
from impact_rs_ros.managed import ERROR, FAILURE, SUCCESS
from impact_rs_ros.plant_node import PlantNode
from impact_rs_ros.process import NodeProgram
from impact_rs_ros.recorder_node import RecorderNode
from impact_rs_sim.errors import InputError

KINDS = {"plant": PlantNode, "controller": ControllerNode, "recorder": RecorderNode, "cell": CellNode}


@pytest.fixture(scope="module")
def context(domain_ids: Callable[[], int]) -> Iterator[None]:
    rclpy.init(domain_id=domain_ids())
    yield
    rclpy.try_shutdown()


@pytest.fixture
def made(context: None) -> Iterator[Callable[[str], Any]]:
    """Makes nodes; they are closed at the end."""
    programs: list[NodeProgram] = []

    def make(kind: str) -> NodeProgram:
        programs.append(KINDS[kind]())
        return programs[-1]

    yield make
    for program in programs:
        program.close()
        program.executor.shutdown(timeout_sec=1.0)
        program.node.destroy_node()


def published(program: NodeProgram) -> int:
    """Number of publishers of joint signals and states that a node has."""
    return sum(publisher.topic_name.startswith("/arm/") for publisher in program.node.publishers)


@pytest.mark.parametrize("kind", KINDS)
def test_a_node_is_led_from_outside_by_the_services_of_ros(made: Callable[[str], Any], kind: str) -> None:
    """``ros2 lifecycle`` calls these services."""
    program = made(kind)
    caller = rclpy.create_node("lifecycle_of_" + kind)
    try:
        change = caller.create_client(ChangeState, f"/{kind}/change_state")
        state = caller.create_client(GetState, f"/{kind}/get_state")

        def asked(client: Any, request: Any) -> Any:
            future = client.call_async(request)
            until = time.monotonic() + 60.0
            while not future.done() and time.monotonic() < until:
                program.serve(0.01)
                rclpy.spin_once(caller, timeout_sec=0.01)
            return future.result()

        for transition, label in (
            ("configure", "inactive"),
            ("activate", "active"),
            ("deactivate", "inactive"),
            ("activate", "active"),
            ("deactivate", "inactive"),
            ("cleanup", "unconfigured"),
            ("shutdown", "finalized"),
        ):
            request = ChangeState.Request()
            request.transition.label = transition
            assert asked(change, request).success, transition
            assert asked(state, GetState.Request()).current_state.label == label
            assert program.active == (label == "active")
        assert program.over  # the process ends
        names = [name for name, _ in caller.get_node_names_and_namespaces()]  # some of earlier tests
        assert names.count(kind) == 1
        assert {name.removeprefix("lifecycle_of_") for name in names} <= set(KINDS)  # no program has a second node
    finally:
        caller.destroy_node()


def test_configure_reads_the_scenario_and_a_wrong_one_leaves_the_node_unconfigured(
    made: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    program = made("plant")
    own = program.parameter
    with monkeypatch.context() as changed:
        changed.setattr(program, "parameter", lambda name: "no_such" if name == "scenario" else own(name))
        assert program.node.trigger_configure() == FAILURE
        assert program.node._state_machine.current_state[0] == State.PRIMARY_STATE_UNCONFIGURED
        with pytest.raises(InputError, match="no_such"):
            program.start()
    assert program.node.trigger_configure() == SUCCESS


def test_an_error_in_a_transition_leaves_the_node_unconfigured_and_it_can_be_used_again(
    made: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a node that is active for ROS, and refuses every trial because it is not."""
    program = made("controller")
    program.start()
    with monkeypatch.context() as changed:
        changed.setattr(program, "break_off", lambda why: 1 // 0)
        assert program.node.trigger_deactivate() == ERROR
    assert program.node._state_machine.current_state[0] == State.PRIMARY_STATE_UNCONFIGURED
    assert not program.active
    program.node.start()
    assert program.active


@pytest.mark.parametrize("autostart", [True, False])
def test_a_node_activates_itself_unless_autostart_is_false(
    made: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, autostart: bool
) -> None:
    program = made("controller")
    own = program.parameter
    monkeypatch.setattr(program, "parameter", lambda name: autostart if name == "autostart" else own(name))
    program.start()
    assert program.active == autostart
    assert program.node._state_machine.current_state[1] == ("active" if autostart else "unconfigured")


@pytest.mark.parametrize("kind", ["plant", "controller"])
def test_activate_connects_and_deactivate_disconnects(made: Callable[[str], Any], kind: str) -> None:
    program = made(kind)
    assert program.node.trigger_configure() == SUCCESS
    assert published(program) == 0
    assert program.node.trigger_activate() == SUCCESS
    assert published(program) > 0
    assert program.node.trigger_deactivate() == SUCCESS
    assert published(program) == 0


@pytest.mark.parametrize("kind", ["plant", "controller", "recorder"])
def test_an_inactive_node_refuses_a_trial_and_says_how_to_activate_it(
    made: Callable[[str], Any], tmp_path: Path, kind: str
) -> None:
    program = made(kind)
    program.node.trigger_configure()
    answer = program._on_configure(configuration(PUSH, tmp_path / "bag"), ConfigureTrial.Response())
    assert not answer.success
    assert answer.message == f"/{kind} is not active: ros2 lifecycle set /{kind} activate"


def test_a_repeated_request_gets_the_answer_of_the_first_whether_it_was_accepted_or_refused(
    made: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a refusal that is worked out again, while the next trial's request waits behind it."""
    program, begun = made("recorder"), []
    program.start()
    begin = program.begin_trial
    monkeypatch.setattr(program, "begin_trial", lambda *request: (begun.append(request), begin(*request)))
    request = configuration(PUSH, attempt=7)
    request.bag_path = ""
    first, second = (program._on_configure(request, ConfigureTrial.Response()) for _ in range(2))
    assert (first.success, "ConfigureTrial.bag_path is empty" in first.message) == (False, True)
    assert second == first
    assert len(begun) == 1

    monkeypatch.setattr(program, "begin_trial", lambda _, response: setattr(response, "ros_time", True))
    request.attempt = 8
    first, second = (program._on_configure(request, ConfigureTrial.Response()) for _ in range(2))
    assert first.success
    assert first.ros_time
    assert second == first


def test_a_controller_that_is_deactivated_in_a_trial_ends_it_and_says_so(made: Callable[[str], Any]) -> None:
    program = made("controller")
    program.start()
    assert program._on_configure(configuration(PUSH, attempt=7), ConfigureTrial.Response()).success
    assert program.node.trigger_deactivate() == SUCCESS
    assert not program.running
    end = FinishTrial.Request(attempt=7, aborted=True)
    answer = program._on_finish(end, FinishTrial.Response())
    assert (answer.success, answer.outcome) == (False, "ABORTED")
    assert answer.message == "controller was deactivated at t = 0.000 s"
    program.node.trigger_activate()
    assert program._on_configure(configuration(PUSH, attempt=8), ConfigureTrial.Response()).success


class Arms:
    """Arms that come to rest after so many states."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def held(self) -> bool:
        return self.looks <= 0

    def rest(self) -> None:
        self.looks -= 1


class CellTrial:
    """A trial at 1.2 s of its time that goes on until it is stopped."""

    now, failure, begun, over = 1_200_000_000, "", True, False
    unreadable = 0

    def __init__(self) -> None:
        self.stopped: list[str] = []

    def work(self, until: float) -> None:
        """Nothing to do."""

    def stop(self, failure: str) -> None:
        self.failure = failure
        self.stopped.append(failure)

    def end(self) -> str:
        return "OK"


@pytest.fixture
def led(made: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> CellNode:
    """A cell in a trial, with arms that need five states to come to rest."""
    monkeypatch.setattr(cell_node, "rest_until", lambda arms, *others: arms.rest())
    program: CellNode = made("cell")
    program.start()
    program.trial, program.running, program._held_arms = CellTrial(), True, Arms(5)  # type: ignore[assignment]
    monkeypatch.setattr(program, "diagnose", lambda now=False: None)
    return program


def is_held_on(program: CellNode) -> bool:
    """Whether arms that rest are braked in every turn."""
    assert isinstance(program._held_arms, Arms)
    looks = program._held_arms.looks
    program.turn()
    return looks <= 0 and program._held_arms.looks < looks


def test_a_cell_that_is_deactivated_in_a_trial_brakes_until_the_arms_rest_and_holds_them(led: CellNode) -> None:
    assert led.node.trigger_deactivate() == SUCCESS
    assert led.trial.stopped[0] == "cell was deactivated at t = 1.200 s"
    assert is_held_on(led)
    assert led.node.trigger_cleanup() == SUCCESS
    assert led._held_arms is None


def test_a_cell_whose_trial_is_cancelled_brakes_until_the_arms_rest_and_holds_them(led: CellNode) -> None:
    """The caller of the action has the result when they rest; the cell stays active."""
    caller = rclpy.create_node("canceller")
    client = ActionClient(caller, RunTrial, "/plant/run_trial")

    def served(future: Any) -> Any:
        until = time.monotonic() + 60.0
        while not future.done() and time.monotonic() < until:
            led.turn()
            rclpy.spin_once(caller, timeout_sec=0.01)
        return future.result()

    try:
        until = time.monotonic() + 60.0
        while not client.server_is_ready() and time.monotonic() < until:
            rclpy.spin_once(caller, timeout_sec=0.01)
        goal = served(client.send_goal_async(RunTrial.Goal()))
        led._held_arms = Arms(500)  # type: ignore[assignment]
        result = goal.get_result_async()
        cancelled = goal.cancel_goal_async()
        answer = served(result)
        assert led._held_arms.held
        assert len(served(cancelled).goals_canceling) == 1
    finally:
        client.destroy()
        caller.destroy_node()
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.message == led.trial.stopped[0] == "cell was cancelled at t = 1.200 s"
    assert is_held_on(led)
    assert led.active and not led.running
    end = led._on_finish(FinishTrial.Request(aborted=True), FinishTrial.Response())
    assert (end.success, end.outcome) == (False, "ABORTED")
