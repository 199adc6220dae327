"""What plant and controller have in common: a trial is configured, runs, and is finished."""

from __future__ import annotations

import gc
import time
from abc import abstractmethod

from impact_rs.srv import ConfigureTrial, FinishTrial

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.exchange import Inbox, Outbox
from impact_rs_ros.message_types import RosidlTypes
from impact_rs_ros.process import NodeProgram
from impact_rs_ros.qos import AWAITED, STREAM
from impact_rs_ros.streams import Stream, StreamMaker
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.trial_info import TrialInfo

SLICE = 0.02  # s, how long a running trial may keep a node from its services


class TrialNode(NodeProgram):
    """A node that takes part in the lockstep."""

    background = False

    def __init__(self) -> None:
        super().__init__()
        self.arms: list[str] = []
        self.plan: TrialPlan | None = None
        self.maker: MessageMaker | None = None
        self.tick_times: list[float] = []
        self.failure = ""
        self.inbox: Inbox
        self.outbox: Outbox
        self.node.create_service(ConfigureTrial, "~/configure_trial", self._on_configure)
        self.node.create_service(FinishTrial, "~/finish_trial", self._on_finish)
        try:
            self._connect(list(load_scenario(self.parameter("scenario")).robots))
        except InputError as error:
            self.node.get_logger().error(str(error))

    @abstractmethod
    def received(self, arms: list[str]) -> dict[str, str]:
        """Topics that are awaited, with their types."""

    @abstractmethod
    def published(self, arms: list[str]) -> dict[str, str]:
        """Topics that are published, with their types."""

    @abstractmethod
    def streams(self, maker: StreamMaker, arms: list[str]) -> dict[str, Stream]:
        """Published signals of every tick, by topic."""

    @abstractmethod
    def prepare(self, plan: TrialPlan, info: TrialInfo) -> None:
        """Make ready for a trial, as if there had been none before."""

    @abstractmethod
    def end(self) -> str:
        """Leave the trial; returns its outcome as this node sees it."""

    @abstractmethod
    def work(self, until: float) -> None:
        """Do what there is to do in a trial, at least until ``until`` on the monotonic clock."""

    def turn(self) -> None:
        if self.plan is None:
            super().turn()
            return
        self.work(time.monotonic() + SLICE)
        self.executor.spin_once(timeout_sec=0.0)
        self.diagnose()

    def tick_statistics(self) -> dict[str, object]:
        """Wall-clock time per tick since the last time this was asked for."""
        times, self.tick_times = sorted(self.tick_times), []
        if not times:
            return {"ticks": 0}
        return {
            "ticks": len(times),
            "tick_time_median [s]": f"{times[len(times) // 2]:.6f}",
            "tick_time_largest [s]": f"{times[-1]:.6f}",
        }

    def _connect(self, arms: list[str]) -> None:
        """Publish and subscribe for these arms; what is there already stays, and stays matched."""
        if arms == self.arms:
            return
        if self.arms:
            self.inbox.close()
            self.outbox.close()
        self.inbox = Inbox(self.node, self.received(arms), AWAITED, raw=True)
        self.outbox = Outbox(self.node, self.published(arms), STREAM)
        self.arms = arms

    def _on_configure(
        self, request: ConfigureTrial.Request, response: ConfigureTrial.Response
    ) -> ConfigureTrial.Response:
        try:
            if self.plan is not None:
                self._leave()
            info = TrialInfo.from_message(request.trial)
            plan = info.spec.plan
            self._connect(list(plan.arms))
            self.inbox.clear()
            self.outbox.reset(self.streams(StreamMaker(plan), list(plan.arms)))
            self.failure = ""
            self.maker = MessageMaker(RosidlTypes(), plan)
            self.prepare(plan, info)
            self.plan = plan
        except InputError as error:
            response.message = str(error)
            return response
        except Exception as error:  # a node outlives every trial
            self.node.get_logger().error(f"cannot prepare the trial: {full_traceback(error)}")
            response.message = f"{self.kind}: {type(error).__name__}: {error}"
            return response
        gc.collect()
        gc.freeze()  # the next trial's collection looks at what is new, and no more
        gc.disable()  # a collection takes longer than a tick
        response.success = True
        return response

    def _on_finish(self, request: FinishTrial.Request, response: FinishTrial.Response) -> FinishTrial.Response:
        if self.plan is None:
            response.message = f"{self.kind}: there is no trial to finish"
            return response
        self.outbox.flush()
        self.diagnose(now=True)
        outcome = self._leave()
        response.success = not self.failure
        response.message = self.failure
        response.outcome = "ABORTED" if request.aborted or self.failure else outcome
        response.messages = sum(self.outbox.counts.values())
        response.topics = list(self.outbox.counts)
        response.counts = list(self.outbox.counts.values())
        return response

    def _leave(self) -> str:
        gc.enable()
        self.plan = None
        return self.end()

    def close(self) -> None:
        if self.plan is not None:
            self._leave()
