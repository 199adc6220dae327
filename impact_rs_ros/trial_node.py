# SPDX-License-Identifier: Apache-2.0
"""Common part of plant, cell and controller: a trial is configured, runs, and is finished."""

from __future__ import annotations

import gc
import time
from abc import abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future
from std_srvs.srv import Trigger

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.exchange import Inbox, Outbox
from impact_rs_ros.message_types import RosidlTypes
from impact_rs_ros.process import THROTTLE_S, close_goal
from impact_rs_ros.qos import AWAITED
from impact_rs_ros.trial_services import TrialServices
from impact_rs_sim.errors import full_traceback
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.lockstep.lockstep_trial import LeadingTrial, LockstepTrial
from impact_rs_trials.spec import TrialSpec

TRIAL_SLICE_S = 0.02  # of a running trial between two services of its node
FEEDBACK_S = 0.1  # wall clock, between two feedbacks on a running trial
SUBSCRIBER_POLL_S = 0.002  # between two checks whether all topics have subscribers


AnyTrial = TypeVar("AnyTrial", bound=LockstepTrial)


class TrialNode(TrialServices, Generic[AnyTrial]):
    """A node that takes part in the lockstep.

    Attributes:
        trial: The current trial, or the last one; None before the first.
        running: Whether a trial is configured and not finished.
    """

    background = False
    ros_time = False  # whether this node stamps states in ROS time

    def __init__(self) -> None:
        super().__init__()
        self.arms: list[str] = []
        self.neighbours: tuple[str, ...] = ()
        self.trial: AnyTrial | None = None
        self.running = False
        self._name = ""
        self.inbox = Inbox(self.node, AWAITED, raw=True)
        self.outbox = Outbox(self.node)

    @abstractmethod
    def received(self, arms: list[str]) -> dict[str, str]:
        """Topics that the node subscribes to, with their types."""

    @abstractmethod
    def published(self, arms: list[str]) -> dict[str, str]:
        """Topics that the node publishes, with their types."""

    def published_of(self, neighbours: Sequence[str]) -> dict[str, str]:
        """Topics about neighbours of the object that the node publishes, with their types."""
        del neighbours
        return {}

    @abstractmethod
    def streams(self, maker: StreamMaker) -> dict[str, Stream]:
        """Published signals of every tick, by topic."""

    @abstractmethod
    def prepare(self, plan: TrialPlan, maker: MessageMaker, info: TrialInfo, ros_time: bool) -> AnyTrial:
        """A trial that is ready to begin and independent of earlier ones.

        Args:
            plan: The trial.
            maker: Fills its messages.
            info: Its identity.
            ros_time: Whether the plant's timestamps are ROS time, as the request says.
        """

    def start(self) -> None:
        super().start()
        gc.collect()
        gc.freeze()  # the collection before a trial then considers only newer objects

    def rehearse(self, spec: TrialSpec) -> None:
        self.streams(StreamMaker(spec.plan))

    def turn(self) -> None:
        if not self.running or self.trial is None:
            super().turn()
            return
        unreadable = self.trial.unreadable
        self.work(self.trial, time.monotonic() + TRIAL_SLICE_S)
        if self.trial.unreadable != unreadable:
            self.log.warning(
                f"{self.trial.note()} on {', '.join(self.received(self.arms))}: who else publishes?",
                throttle_duration_sec=THROTTLE_S,
            )
        self.serve(0.0)
        self.diagnose()

    def work(self, trial: AnyTrial, until: float) -> None:
        """Run a trial until ``until`` on the monotonic clock [s], or a little longer."""
        trial.work(until)

    def trial_time(self) -> int:
        return 0 if self.trial is None else self.trial.now

    def status(self) -> tuple[str, dict[str, object]]:
        if self.trial is None:
            return "ok", {"ticks": 0}
        line, numbers = self.trial.status()
        if line == "ok" and self.trial.unreadable:
            line = f"{self.trial.note()}: who else publishes?"
        return line, {**numbers, "unreadable_messages": self.trial.unreadable}

    def failure(self) -> str:
        return "" if self.trial is None else self.trial.failure

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        if (arms, tuple(neighbours)) != (self.arms, self.neighbours):
            self.arms = []  # until it has succeeded: a name of an arm may not be valid in a topic
            self.inbox.connect(self.received(arms))
            self.outbox.connect(self.published(arms) | self.published_of(neighbours))
            self.arms, self.neighbours = arms, tuple(neighbours)

    @property
    def in_trial(self) -> bool:
        return self.running

    def begin_trial(self, request: ConfigureTrial.Request, response: ConfigureTrial.Response) -> None:
        response.ros_time = self.ros_time
        if self.running:
            self._leave()
        info = TrialInfo.from_message(request.trial)
        plan = info.spec.plan
        self.connect(list(plan.arms), [neighbour.name for neighbour in plan.scene.physics.neighbours])
        self.inbox.clear()
        self.outbox.reset(self.streams(StreamMaker(plan)))
        self.trial = self.prepare(plan, MessageMaker(RosidlTypes(), plan), info, request.ros_time)
        self.running = True
        self._name = f"{info.scenario}/{info.key.name}"
        gc.collect()
        gc.disable()  # a collection takes longer than a tick
        self.log.debug(f"configured {self._name}, seed {info.seed}")

    def finish_trial(self, request: FinishTrial.Request, response: FinishTrial.Response) -> None:
        trial = self.trial
        assert trial is not None
        self.outbox.flush()
        self.diagnose(now=True)
        outcome, failure = self._leave(), trial.failure
        response.success = not failure
        response.message = failure or (f"{self.kind}: {note}" if (note := trial.note()) else "")
        response.outcome = "ABORTED" if request.aborted or failure else outcome
        response.messages = sum(self.outbox.counts.values())
        response.topics = list(self.outbox.counts)
        response.counts = list(self.outbox.counts.values())
        after = f"after {1e-9 * trial.now:.3f} s, {response.messages} messages published"
        text = f"{self._name}: {response.outcome} {after}"
        if response.outcome == "ABORTED" or response.message:
            self.log.warning(f"{text}: {response.message or request.reason}")
        else:
            self.log.info(text)

    def break_off(self, why: str) -> None:
        """End a running trial early; ``~/finish_trial`` then answers that it was ABORTED, and why."""
        if self.running and self.trial is not None:
            self.trial.stop(f"{self.kind} was {why} at t = {1e-9 * self.trial.now:.3f} s")
            self._finished = FinishTrial.Response()
            self.finish_trial(FinishTrial.Request(aborted=True), self._finished)

    def deactivate(self) -> None:
        """End a running trial, and disconnect."""
        super().deactivate()
        self.break_off("deactivated")
        self.disconnect()

    def disconnect(self) -> None:
        """Destroy publishers and subscriptions."""
        self.arms = []
        self.inbox.close()
        self.outbox.connect({})

    def cleanup(self) -> None:
        super().cleanup()
        self.trial = None

    def _leave(self) -> str:
        gc.enable()
        self.running = False
        return "" if self.trial is None else self.trial.end()

    def close(self) -> None:
        if self.running:
            self._leave()
        self.inbox.close()


AnyLeadingTrial = TypeVar("AnyLeadingTrial", bound=LeadingTrial)


class LeadingNode(TrialNode[AnyLeadingTrial]):
    """The node that runs trials: each is a goal of its action ``~/run_trial``.

    A goal runs the trial that ``~/configure_trial`` has prepared. Its result comes when the trial is over. To cancel it
    ends the trial as :meth:`deactivate` does; the node stays active.
    """

    def __init__(self) -> None:
        super().__init__()
        self._goal: ServerGoalHandle | None = None  # that runs the trial
        self._over = Future()  # reason of a failure of this goal, or an empty text
        self._reported = 0.0  # when the last feedback was sent, on the monotonic clock [s]

    def offer(self) -> None:
        super().offer()
        self._runs = ActionServer(
            self.node,
            RunTrial,
            self.role("run_trial"),
            execute_callback=self._on_run,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.node.create_service(Trigger, self.role("run_trial"), self._on_former_run)

    def wait(self) -> None:
        """Serve requests for some milliseconds, before or after the ticks of a trial."""
        self.serve(SUBSCRIBER_POLL_S)

    def work(self, trial: AnyLeadingTrial, until: float) -> None:
        if self._goal is None:
            self.wait()
            return
        if self._goal.is_cancel_requested:
            self.break_off("cancelled")
            return
        if not trial.begun:
            if self.outbox.unmatched():
                self.wait()
                return
            self.log.debug("the trial begins")
            trial.begin()
        try:
            trial.work(until)
        except Exception as error:  # no trial ends a node
            self.log.error(f"the trial cannot go on: {full_traceback(error)}")
            trial.stop(f"{self.kind} at t = {1e-9 * trial.now:.3f} s: {type(error).__name__}: {error}")
        if trial.over:
            self._conclude(trial.failure)
        elif (now := time.monotonic()) > self._reported + FEEDBACK_S:
            self._reported = now
            self._goal.publish_feedback(RunTrial.Feedback(time=1e-9 * trial.now))

    async def _on_run(self, goal: ServerGoalHandle) -> RunTrial.Result:
        result = RunTrial.Result(outcome="ABORTED", detected_time=float("nan"))
        if self._goal is not None or not self.running:
            obstacle = "the trial runs already" if self.running else "configure a trial first"
            result.message = f"{self.kind}: {obstacle}"
            goal.abort()
            return result
        self._goal, self._over = goal, Future(executor=self.executor)
        result.message = await self._over
        result.success = not result.message
        if result.success:
            result.outcome = "OK"
        close_goal(goal, result.success)
        return result

    def _on_former_run(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer a client of the service that the action has replaced."""
        del request
        name = self.node.resolve_service_name(self.role("run_trial"))
        response.message = f"{name} is an action now: ros2 action send_goal {name} impact_rs/action/RunTrial {{}}"
        return response

    def _conclude(self, failure: str) -> None:
        """The trial of the goal is over."""
        if self._goal is not None:
            self._goal = None
            self._over.set_result(failure)

    def _leave(self) -> str:
        trial = self.trial
        if trial is not None and self._goal is not None:
            trial.stop(trial.failure or "the trial was aborted")
            self._conclude(trial.failure)
        return super()._leave()

    def close(self) -> None:
        super().close()
        if self._offered:
            self._runs.destroy()
