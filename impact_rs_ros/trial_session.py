# SPDX-License-Identifier: Apache-2.0
"""One trial through the nodes, from configuring them to closing the bag; the experiment node runs it in a thread."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from impact_rs.action import RunTrial
from impact_rs.msg import TrialInfo as TrialInfoMessage
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from impact_msgs_py.conversions import joint_state_to_message, pose_to_message
from impact_rs_control.plan import TrialPlan
from impact_rs_ros import node_parameters
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import RosidlTypes
from impact_rs_ros.names import on_network, resolved
from impact_rs_ros.presence import LEASE_GRACE_S, Presence
from impact_rs_ros.qos import EVENT, LATCHED, LEASE_S, WATCH
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, joints_of
from impact_rs_trials.bags.record import descriptions
from impact_rs_trials.bags.trial_info import Outcome, TrialInfo, TrialKey
from impact_rs_trials.bags.writer import partial_path

ATTEMPT_S = 1.0  # after which a request is repeated; it can be lost while a restarted node is being discovered
ALIVE_POLL_S = 0.1  # between two checks whether the answering node is alive
MEMBERS = ("recorder", "controller", "plant")
ALL = (*MEMBERS, "experiment")  # nodes of a trial, whose names must be unique
LAST_SAMPLE_TIMEOUT_S = 0.5  # for the last controller state
FINISH_TIMEOUT_S = 1.0  # for plant or controller to end a trial


class TrialError(RuntimeError):
    """A trial was aborted; the message has reason and remedy."""


@dataclass
class Progress:
    """State of a running trial.

    Attributes:
        time: Trial time of the newest controller state [s]; NaN before the first.
        mode: Least controller mode of the arms.
        net_feedback: Mean over the arms, ``(3,)`` [m/s].
        detected_time: First detected impact [s]; NaN without one.
    """

    time: float = math.nan
    mode: int = 0
    net_feedback: Array = field(default_factory=lambda: np.zeros(3))
    detected_time: float = math.nan


@dataclass(frozen=True)
class TrialResult:
    """How a trial ended.

    Attributes:
        outcome: One of ``OUTCOMES``.
        message: The reason, in one line; empty for ``OK``.
        bag_path: Path of its bag.
        progress: State of the trial when it ended.
    """

    outcome: Outcome
    message: str
    bag_path: Path
    progress: Progress


class SharedActionClient(ActionClient):
    """An action client whose requests come from another thread than the executor's.

    rclpy 7.1.6 drops an answer that comes before the sending thread has noted its request; a lock prevents that.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._sending = threading.Lock()
        super().__init__(*arguments, **options)

    def send_goal_async(self, *arguments: Any, **options: Any) -> Future:
        with self._sending:
            return super().send_goal_async(*arguments, **options)

    def _get_result_async(self, goal_handle: ClientGoalHandle) -> Future:
        with self._sending:
            return super()._get_result_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        with self._sending:  # the request of this answer is noted
            pass
        await super().execute(taken_data)


class TrialSession:
    """Runs trials with plant, controller and recorder.

    Args:
        node: The node whose executor, in another thread, serves the clients.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        group = ReentrantCallbackGroup()

        def client(kind: Any, name: str) -> Client:
            return node.create_client(kind, name, callback_group=group)

        self._presence = Presence(node, ALL)
        self._configure = {name: client(ConfigureTrial, f"{name}/configure_trial") for name in MEMBERS}
        self._finish = {name: client(FinishTrial, f"{name}/finish_trial") for name in MEMBERS}
        self._run = SharedActionClient(node, RunTrial, "plant/run_trial", callback_group=group)
        self._trial_info = node.create_publisher(TrialInfoMessage, on_network(topics.TRIAL_INFO), LATCHED)
        self._descriptions: dict[str, Publisher] = {}  # by topic
        self._arms: list[str] = []
        self._states = Inbox(node, WATCH)
        self._events = Inbox(node, EVENT)
        self._newest: dict[str, Any] = {}  # controller states by topic
        self._attempt = 0  # number of the attempt at a trial, in its requests

    def watch(self, arms: list[str]) -> None:
        """Subscribe to the controller states and impact events of these arms."""
        if arms != self._arms:
            kinds = topics.recorded(arms)
            for inbox, name in ((self._states, topics.controller_state), (self._events, topics.impact_event)):
                inbox.connect({name(arm): kinds[name(arm)] for arm in arms})
            self._arms = arms

    def describe(self, plan: TrialPlan) -> None:
        """Publish the URDFs of the arms and the object of a trial, in place of earlier ones, for viewers."""
        urdfs = descriptions(plan.scene.physics)
        for topic in self._descriptions.keys() - urdfs.keys():
            self._node.destroy_publisher(self._descriptions.pop(topic))
        for topic, urdf in urdfs.items():
            if topic not in self._descriptions:
                self._descriptions[topic] = self._node.create_publisher(String, on_network(topic), LATCHED)
            self._descriptions[topic].publish(String(data=urdf))

    def close(self) -> None:
        """Destroy the subscriptions."""
        self._states.close()
        self._events.close()
        self._run.destroy()

    def run(
        self,
        plan: TrialPlan,
        key: TrialKey,
        seed: int,
        directory: Path,
        feedback: Callable[[Progress], None] = lambda progress: None,
        cancelled: Callable[[], bool] = lambda: False,
        plant_model: str = "",
    ) -> TrialResult:
        """Run one trial; failures are in the result.

        Args:
            plan: The trial.
            key: Its object, case, velocity scale and repeat.
            seed: Seed of scatter and noise.
            directory: Folder of the bag.
            feedback: Progress callback, called every ``feedback_period``.
            cancelled: Returns whether to stop.
            plant_model: Text of a model file with effects of the plant; may be empty.
        """
        self._presence.forget(*self._presence.absent())  # discovered late, or started again by another program
        info = TrialInfo.of(plan, key, seed, "nodes")
        path = directory / key.name
        maker = MessageMaker(RosidlTypes(), plan)
        self.watch(list(plan.arms))
        self._states.clear()
        self._events.clear()
        self._newest.clear()
        self._attempt = time.time_ns()  # also unlike an earlier process's
        progress = Progress()
        reason = ""
        try:
            trial = maker.trial_info(info)
            secret = replace(info, model_yaml=plant_model)
            if plant_model and not node_parameters.value(self._node, "hide_model"):
                trial = maker.trial_info(secret)
            self._check_alone()
            self._configure_all(plan, trial, maker.trial_info(secret), path)
            self._check_publishers()
            self._trial_info.publish(trial)
            self.describe(plan)
            self._follow(progress, plan, feedback, cancelled)
            self._check_alone()
            self._check_publishers()
        except (TrialError, InputError) as error:
            reason = self._cause(str(error))
        return self._finish_all(progress, reason, path)

    def _cause(self, reason: str) -> str:
        """The cause of a failure: a second node of the same name, which may be discovered only after it disturbed.

        Its services can answer before its ``~/alive`` is discovered, which takes up to a lease.
        """
        deadline = time.monotonic() + LEASE_S
        while self._has_duplicate_servers() and not self._presence.duplicates() and time.monotonic() < deadline:
            time.sleep(ALIVE_POLL_S)
        try:
            self._check_alone()
        except TrialError as duplicate:
            return str(duplicate)
        return reason

    def _has_duplicate_servers(self) -> bool:
        """Whether a service of a trial has several servers; a killed node's is counted for 20 s."""
        return any(self._node.count_services(client.srv_name) > 1 for client in self._finish.values())

    def _call(self, name: str, client: Client, request: Any, timeout: float) -> Any:
        """Answer of a service, with repeated requests; any answer is accepted, and a node acts only once."""
        began = time.monotonic()
        deadline = began + timeout

        def check() -> None:
            if time.monotonic() > began + LEASE_GRACE_S:  # a restarted node is discovered late
                self._check_present(name)

        answered = threading.Event()
        futures = []
        try:
            while (remaining := deadline - time.monotonic()) > 0.0:
                check()
                if not client.service_is_ready():
                    time.sleep(min(remaining, 0.01))
                    continue
                futures.append(client.call_async(request))
                futures[-1].add_done_callback(lambda _: answered.set())
                attempt = time.monotonic() + min(remaining, max(ATTEMPT_S, timeout / 4.0))
                while time.monotonic() < attempt:
                    if answered.wait(ALIVE_POLL_S):
                        return next(future.result() for future in futures if future.done())
                    check()
        finally:
            for future in futures:
                client.remove_pending_request(future)
        service = self._node.resolve_service_name(client.srv_name)
        raise TrialError(f"{name} does not answer {service}; is the node running?")

    def _call_all(self, calls: dict[str, tuple[Client, Any]], timeout: float) -> tuple[dict[str, Any], dict[str, str]]:
        """Answers and failures of several services that are called at once, by node."""
        answers: dict[str, Any] = {}
        failures: dict[str, str] = {}

        def call_node(name: str) -> None:
            try:
                answers[name] = self._call(name, *calls[name], timeout)
            except TrialError as error:
                failures[name] = str(error)

        with ThreadPoolExecutor() as pool:
            list(pool.map(call_node, calls))
        return answers, failures

    def _check_present(self, *names: str) -> None:
        """Raise ``TrialError`` if one of these nodes was killed or froze."""
        for name in self._presence.lost(*names):
            raise TrialError(f"node {self._presence.full_name(name)} was killed or froze")

    def _check_alone(self) -> None:
        """Raise ``TrialError`` if two nodes share a name; waits until it is certain that neither of them has ended."""
        while (duplicates := self._presence.duplicates()) and not any(duplicates.values()):
            time.sleep(ALIVE_POLL_S)
        for name in (name for name, certain in duplicates.items() if certain):
            raise TrialError(
                f"two nodes are called {self._presence.full_name(name)}: stop one of them, or give one another "
                "namespace or ROS_DOMAIN_ID"
            )

    def _check_publishers(self) -> None:
        """Raise ``TrialError`` if several nodes publish the measured states or the torques of an arm."""
        for arm in self._arms:
            for topic in (topics.joint_states(arm), topics.joint_command(arm)):
                publishers = self._presence.publishers(on_network(topic))
                if len(publishers) > 1:
                    full = resolved(self._node, topic)
                    raise TrialError(f"{full} is published by {' and '.join(publishers)}: stop all but one")

    def _configure_all(self, plan: TrialPlan, trial: Any, secret: Any, path: Path) -> None:
        """Configure the nodes; only the plant gets the ``secret`` trial with hidden effects, and the initial state."""
        requests = {name: ConfigureTrial.Request(attempt=self._attempt, trial=trial) for name in self._configure}
        requests["plant"].trial = secret
        requests["plant"].start = starting_joints(plan)
        object_state = plan.scene.object
        requests["plant"].object_pose = pose_to_message(
            np.concatenate((object_state.position, quaternion_of(object_state.rotation)))
        )
        requests["recorder"].bag_path = str(path)
        ros_time = self._configured(["plant"], requests)["plant"].ros_time
        for name in ("controller", "recorder"):
            requests[name].ros_time = ros_time
            self._configured([name], requests)  # the recorder looks for the publishers of the others

    def _configured(self, names: list[str], requests: dict[str, Any]) -> dict[str, Any]:
        """Answers of nodes that are configured at once; raises ``TrialError`` with the reasons of those that refuse."""
        calls = {name: (self._configure[name], requests[name]) for name in names}
        answers, failures = self._call_all(calls, node_parameters.value(self._node, "service_timeout"))
        failures |= {name: answer.message for name, answer in answers.items() if not answer.success}
        if failures:
            raise TrialError("; ".join(failures.values()))
        return answers

    def _follow(
        self,
        progress: Progress,
        plan: TrialPlan,
        feedback: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> None:
        """Give the plant the goal, and report progress until the trial is over; a failure cancels the goal."""
        period = node_parameters.value(self._node, "feedback_period")
        patience = node_parameters.value(self._node, "service_timeout")  # until time passes: discovery takes its own
        over = threading.Event()
        goal = self._accepted()
        future = goal.get_result_async()
        future.add_done_callback(lambda _: over.set())
        alive = time.monotonic()
        try:
            while not over.wait(period):
                if cancelled():
                    raise TrialError("cancelled")
                self._check_present(*MEMBERS)
                self._check_alone()
                self._check_publishers()
                before = progress.time
                self._look(progress)
                if progress.time != before and not math.isnan(progress.time):
                    alive = time.monotonic()
                    if progress.time > 0.0:
                        patience = node_parameters.value(self._node, "progress_timeout")
                    feedback(progress)
                elif time.monotonic() - alive > patience:
                    since = "" if math.isnan(progress.time) else f" after t = {progress.time:.3f} s"
                    what = "progress" if since else "state of the controller"
                    raise TrialError(f"no {what} for {patience:g} s{since}: the plant or the controller is gone")
        finally:
            if not over.is_set():
                goal.cancel_goal_async()
        answer = future.result().result
        if not answer.success:
            raise TrialError(answer.message)
        end = plan.scene.scenario.timing.ticks * plan.scene.scenario.timing.control_period
        deadline = time.monotonic() + LAST_SAMPLE_TIMEOUT_S
        while not progress.time >= end - 1e-9 and time.monotonic() < deadline:
            time.sleep(0.001)
            self._look(progress)
        feedback(progress)

    def _accepted(self) -> ClientGoalHandle:
        """The goal of the plant, accepted."""
        answered = threading.Event()
        future = self._run.send_goal_async(RunTrial.Goal())
        future.add_done_callback(lambda _: answered.set())
        deadline = time.monotonic() + node_parameters.value(self._node, "service_timeout")
        while not answered.wait(ALIVE_POLL_S):
            self._check_present("plant")
            if time.monotonic() > deadline:
                raise TrialError(f"plant does not answer {self._node.resolve_service_name('plant/run_trial')}")
        goal: ClientGoalHandle = future.result()
        if not goal.accepted:
            raise TrialError("plant rejected the trial: see its log")
        return goal

    def _look(self, progress: Progress) -> None:
        self._events.gather()
        for _, message in self._events.take():
            progress.detected_time = float(np.fmin(progress.detected_time, message.detected_time))
        self._states.gather()
        self._newest.update(self._states.take())
        if len(self._newest) == len(self._arms):
            newest = list(self._newest.values())
            progress.time = min(state.trial_time for state in newest)
            progress.mode = min(state.mode for state in newest)
            progress.net_feedback = np.mean([state.net_feedback for state in newest], axis=0)

    def _finish_all(self, progress: Progress, reason: str, path: Path) -> TrialResult:
        aborted = bool(reason)
        request = FinishTrial.Request(attempt=self._attempt, aborted=aborted, reason=reason)
        lost = self._presence.lost("plant", "controller")
        calls = {name: (self._finish[name], request) for name in ("plant", "controller") if name not in lost}
        answers, failures = self._call_all(calls, FINISH_TIMEOUT_S)
        failures |= {name: answer.message for name, answer in answers.items() if not answer.success}
        if not aborted:
            reason = self._cause("; ".join(failures.values())) if failures else ""
        elif (
            (controller_answer := answers.get("controller"))
            and controller_answer.outcome == "ABORTED"
            and controller_answer.message not in reason
        ):
            reason = f"{reason} ({controller_answer.message})"  # the plant only knows that no torque came
        last = FinishTrial.Request(attempt=self._attempt, aborted=bool(reason), reason=reason)
        if not reason:
            last.reason = "; ".join(answer.message for answer in answers.values() if answer.message)  # a note
            last.topics = [topic for answer in answers.values() for topic in answer.topics]
            last.counts = [count for answer in answers.values() for count in answer.counts]
        try:
            closed = self._close_bag(last)
            if not reason and not (closed.success or closed.outcome):  # for the recorder the trial is not over
                reason = self._cause(closed.message)
                self._close_bag(FinishTrial.Request(attempt=self._attempt, aborted=True, reason=reason))
        except TrialError as error:
            return TrialResult("ABORTED", reason or str(error), partial_path(path), progress)
        if reason:
            return TrialResult("ABORTED", reason, partial_path(path), progress)
        if closed.outcome == "ABORTED" or not closed.success:
            return TrialResult("ABORTED", self._cause(closed.message), partial_path(path), progress)
        return TrialResult(closed.outcome, closed.message, path, progress)

    def _close_bag(self, request: FinishTrial.Request) -> FinishTrial.Response:
        """Let the recorder close the bag; raises ``TrialError`` if it does not answer."""
        # The recorder may wait for late messages.
        patience = FINISH_TIMEOUT_S if request.aborted else node_parameters.value(self._node, "finish_timeout")
        self._check_present("recorder")
        answer: FinishTrial.Response = self._call("recorder", self._finish["recorder"], request, patience)
        return answer


def starting_joints(plan: TrialPlan) -> JointState:
    """Joints of all arms at trial time 0, at rest."""
    names = [joint for joint_names in joints_of(plan.scene.physics).values() for joint in joint_names]
    return joint_state_to_message(names, np.concatenate([arm.initial for arm in plan.arms.values()]))
