# SPDX-License-Identifier: Apache-2.0
"""The cell arms nothing while somebody else can move the robot, and leaves no trial with arms in motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from processes import PATIENCE, until
from rclpy.serialization import serialize_message
from robot_bench import MAKER, PUSH, WEIGHT, Robot
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from impact_rs_ros import cell_node
from impact_rs_ros.cell_node import CellNode
from impact_rs_ros.qos import COMMAND, LATCHED
from impact_rs_sim.errors import InputError

COMMANDS = "/arm/effort_controller/commands"
WATCHED = "/watchdog/arm/commands"


class Arms:
    """Arms that come to rest after some looks."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def held(self) -> bool:
        return self.looks <= 0

    def rest(self) -> None:
        self.looks -= 1


@pytest.fixture(scope="module")
def cell(domain_ids: Callable[[], int]) -> Iterator[CellNode]:
    rclpy.init(domain_id=domain_ids())
    node = CellNode()
    node.connect(["arm"])
    yield node
    node._held_arms = None
    node.close()
    node.executor.shutdown(timeout_sec=1.0)
    node.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def other(cell: CellNode) -> Iterator[rclpy.node.Node]:
    node = rclpy.create_node("stranger", context=cell.node.context)
    yield node
    node.destroy_node()


def eventually(cell: CellNode, condition: Callable[[], bool]) -> bool:
    return bool(until(condition, lambda: cell.serve(0.01)))


@pytest.fixture
def watched(cell: CellNode, monkeypatch: pytest.MonkeyPatch) -> Iterator[CellNode]:
    """The cell with the parameter ``watchdog``."""
    with monkeypatch.context() as asked:
        own = cell.parameter
        asked.setattr(cell, "parameter", lambda name: name == "watchdog" or own(name))
        cell.connect(["arm"])
        yield cell
    cell.connect(["arm"])


@pytest.fixture(autouse=True)
def looks_take_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_node, "rest_until", lambda arms, *others: arms.rest())


def test_leaving_a_trial_and_closing_the_node_go_on_until_the_arms_rest(
    cell: CellNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    for leave in (cell._leave, cell.brake):
        cell._held_arms = Arms(5)  # type: ignore[assignment]
        leave()
        assert cell._held_arms.looks == 0  # type: ignore[attr-defined]
    closed: list[str] = []
    cell._held_arms = Arms(5)  # type: ignore[assignment]
    monkeypatch.setattr(cell_node.LeadingNode, "close", lambda self: closed.append("node"))
    for own in (cell._clock, cell._echo):
        monkeypatch.setattr(own, "close", lambda: None)
    cell.close()
    assert cell._held_arms.looks == 0 and closed == ["node"]  # type: ignore[attr-defined]
    cell._held_arms = None


def test_arms_that_do_not_rest_call_for_the_emergency_stop(cell: CellNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_node, "MAX_BRAKING_S", 0.0)
    said: list[str] = []
    monkeypatch.setattr(cell, "log", type("Log", (), {"error": staticmethod(said.append)}))
    cell._held_arms = Arms(10**9)  # type: ignore[assignment]
    cell.brake()
    cell._held_arms = None
    assert said == ["the arms did not come to rest within 0 s: press the emergency stop"]


def test_arms_are_held_between_trials_and_before_one_begins(cell: CellNode) -> None:
    cell._held_arms = held = Arms(10**9)  # type: ignore[assignment]
    for let_pass in (cell.turn, cell.wait):
        before = held.looks
        let_pass()
        assert held.looks < before
    cell._held_arms = None


def test_without_an_effort_controller_nothing_is_armed(
    cell: CellNode, other: rclpy.node.Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patience:
        patience.setattr(cell_node, "DISCOVERY_S", 0.01)
        with pytest.raises(InputError, match=f"^not armed: nothing listens to torques on {COMMANDS}"):
            cell._await_listeners()
    monkeypatch.setattr(cell_node, "DISCOVERY_S", PATIENCE)
    other.create_subscription(Float64MultiArray, COMMANDS, lambda message: None, 10)
    cell._await_listeners()


def test_whoever_else_can_send_torques_is_named_and_nothing_is_armed(cell: CellNode, other: rclpy.node.Node) -> None:
    assert cell._unexpected_publishers() == ""
    other.create_publisher(Float64MultiArray, COMMANDS, COMMAND)
    assert eventually(cell, lambda: cell._unexpected_publishers() != "")
    assert cell._unexpected_publishers().startswith(f"/stranger can send torques on {COMMANDS} as well: stop it")
    with pytest.raises(InputError, match="^not armed: /stranger can send torques"):
        cell.prepare(PUSH, MAKER, None, True)  # type: ignore[arg-type]
    other.destroy_node()
    assert eventually(cell, lambda: cell._unexpected_publishers() == "")


@pytest.fixture
def watchdog(cell: CellNode) -> Iterator[rclpy.node.Node]:
    """A node of this name that can send torques."""
    node = rclpy.create_node("watchdog", context=cell.node.context)
    node.create_publisher(Float64MultiArray, COMMANDS, COMMAND)
    node.create_publisher(Bool, "/watchdog/braking", LATCHED)
    yield node
    node.destroy_node()
    assert eventually(cell, lambda: cell.node.count_publishers("/watchdog/braking") == 0)


def test_with_a_watchdog_it_alone_sends_the_robot_torques_and_the_cell_sends_them_to_it(
    watched: CellNode, watchdog: rclpy.node.Node
) -> None:
    assert eventually(watched, lambda: watched.node.count_publishers(COMMANDS) == 2)  # the cell's own is for its death
    assert watched.node.count_publishers(WATCHED) == 1
    assert eventually(watched, lambda: watched._unexpected_publishers() == "")
    came: list[list[float]] = []
    watchdog.create_subscription(Float64MultiArray, COMMANDS, lambda message: pytest.fail("past the watchdog"), 10)
    watchdog.create_subscription(Float64MultiArray, WATCHED, lambda message: came.append(list(message.data)), 10)

    def send() -> bool:
        watched._send("arm", np.arange(7.0))
        rclpy.spin_once(watchdog, timeout_sec=0.01)
        return bool(came)

    assert eventually(watched, send)
    assert came[0] == list(range(7))
    for topic in (COMMANDS, WATCHED):  # a second watchdog, a second cell
        second = watchdog.create_publisher(Float64MultiArray, topic, COMMAND)
        said = f"/watchdog can send torques on {topic} as well"
        assert eventually(watched, lambda said=said: watched._unexpected_publishers().startswith(said))
        watchdog.destroy_publisher(second)
        assert eventually(watched, lambda: watched._unexpected_publishers() == "")


def test_a_watchdog_that_the_torques_do_not_go_through_is_a_stranger(cell: CellNode, watchdog: rclpy.node.Node) -> None:
    assert eventually(cell, lambda: cell._unexpected_publishers() != "")
    assert eventually(cell, lambda: "UNKNOWN" not in cell._unexpected_publishers())
    assert cell._unexpected_publishers() == (
        f"/watchdog can send torques on {COMMANDS} as well: set the parameter watchdog, so that torques go through it, "
        "or stop it"
    )


def test_a_watchdog_that_passes_no_torques_on_is_passed_over_and_informed(
    watched: CellNode, watchdog: rclpy.node.Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot has the last torque that came out; the cell goes on from it. A pause of its own is no silence."""
    with monkeypatch.context() as patched:
        robot = Robot()
        robot.state()
        robot.arms._send = watched._send
        for name, value in (
            ("_held_arms", robot.arms),
            ("_clock", robot.clock),
            ("_bypassing", False),
            ("_unforwarded_since", None),
        ):
            patched.setattr(watched, name, value)
        patched.setattr(watched, "_forwarded", {})
        patched.setattr(watched, "_echo_checked", 0.0)
        echoes: list[tuple[str, bytes]] = []
        patched.setattr(
            watched, "_echo", SimpleNamespace(gather=lambda: None, take=lambda: [echoes.pop() for _ in echoes[:1]])
        )
        sent: dict[str, list[list[float]]] = {COMMANDS: [], WATCHED: []}
        for topic, own in sent.items():
            publish = SimpleNamespace(publish=lambda message, own=own: own.append(list(message.data)))
            patched.setitem(watched._publishers, topic, publish)

        def send(ticks: int, passed: float | None) -> None:
            for _ in range(ticks):
                robot.state()
                if passed is not None:
                    echoes[:] = [(COMMANDS, serialize_message(Float64MultiArray(data=[passed] * 7)))]
                robot.arms.command("arm", WEIGHT + 5.0)

        send(20, passed=5.0)
        robot.clock.time += 1.0  # the whole machine stood still
        send(90, passed=None)
        assert not sent[COMMANDS] and sent[WATCHED][-1] == pytest.approx([5.0] * 7)
        send(20, passed=None)
        assert watched._bypassing
        np.testing.assert_allclose(sent[COMMANDS][0], 5.0, atol=1e-9)
        assert sent[WATCHED][-1] == []
        trial = Trial()
        watched.work(trial, 0.0)  # type: ignore[arg-type]
        assert trial.failure == "the watchdog passed no torques on for 0.1 s: is it alive?"


def test_without_a_watchdog_that_listens_nothing_is_armed(
    watched: CellNode, other: rclpy.node.Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    other.create_subscription(Float64MultiArray, COMMANDS, lambda message: None, 10)
    monkeypatch.setattr(cell_node, "DISCOVERY_S", 0.01)
    with pytest.raises(InputError, match=f"^not armed: nothing listens to torques on {WATCHED}: does the watchdog"):
        watched._await_listeners()


def test_a_publisher_without_a_name_is_waited_for_and_then_a_stranger(
    watched: CellNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middleware knows a publisher of a node that starts before its name, which may be that of a watchdog."""
    looks: list[str] = []

    def watchdog_after(count: int) -> None:
        looks.clear()

        def found(topic: str) -> list[SimpleNamespace]:
            if topic == WATCHED:
                return []
            looks.append(topic)
            name = "_NODE_NAME_UNKNOWN_" if len(looks) <= count else "watchdog"
            return [SimpleNamespace(node_name=name, node_namespace="/")]

        monkeypatch.setattr(watched.node, "get_publishers_info_by_topic", found)

    monkeypatch.setattr(watched.node, "count_publishers", lambda topic: 1)
    watchdog_after(3)
    watched._await_publisher_names()
    assert len(looks) == 4 and watched._unexpected_publishers() == ""
    watchdog_after(10**9)
    monkeypatch.setattr(cell_node, "DISCOVERY_S", 0.01)
    watched._await_publisher_names()
    assert "can send torques" in watched._unexpected_publishers()


def test_a_second_publisher_of_joint_states_ends_the_trial(cell: CellNode, other: rclpy.node.Node) -> None:
    cell._state_publishers = 1
    other.create_publisher(JointState, "/joint_states", 10)
    assert eventually(cell, lambda: cell.node.count_publishers("/joint_states") == 1)
    assert cell._unexpected_publishers() == ""
    other.create_publisher(JointState, "/joint_states", 10)
    assert eventually(cell, lambda: cell._unexpected_publishers() != "")
    assert cell._unexpected_publishers() == "2 publishers on /joint_states, 1 when the trial was armed"


class Trial:
    """A trial that has begun."""

    begun, over, failure = True, False, ""

    def stop(self, failure: str) -> None:
        self.over, self.failure = True, failure

    def work(self, until: float) -> None:
        """Nothing to do."""


def test_what_is_found_while_a_trial_runs_ends_it(cell: CellNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell, "_unexpected_publishers", lambda: "/stranger can send torques")
    monkeypatch.setattr(cell_node, "PUBLISHER_POLL_S", -1.0)
    trial = Trial()
    cell.work(trial, 0.0)  # type: ignore[arg-type]
    assert trial.failure == "/stranger can send torques"


def test_a_watchdog_that_brakes_or_is_missing_where_one_is_wanted_is_said(
    watched: CellNode, other: rclpy.node.Node
) -> None:
    assert "there is no watchdog" in watched._unexpected_publishers()
    braking = other.create_publisher(Bool, "/watchdog/braking", LATCHED)
    assert eventually(watched, lambda: watched._unexpected_publishers() == "")
    braking.publish(Bool(data=True))
    assert eventually(watched, lambda: watched._unexpected_publishers() != "")
    assert "ros2 service call /watchdog/reset std_srvs/srv/Trigger" in watched._unexpected_publishers()
    braking.publish(Bool(data=False))
    assert eventually(watched, lambda: watched._unexpected_publishers() == "")
