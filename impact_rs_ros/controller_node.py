"""The controller as a node: answers every measured state with a torque of the same stamp."""

from __future__ import annotations

import time

from impact_rs_control.controller import Controller
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_ros.exchange import Inbox, JointSignals, Outbox, joint_signals
from impact_rs_ros.process import run
from impact_rs_ros.streams import Stream, StreamMaker
from impact_rs_ros.trial_node import LockstepTrial, TrialNode
from impact_rs_sim.sensors import ArmMeasurement
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.trial_info import TrialInfo


class ControllerTrial(LockstepTrial):
    """One trial of a :class:`~impact_rs_control.controller.Controller`.

    Args:
        plan: What to do.
        inbox: Where measured states come in.
        outbox: Where commands go out.
    """

    def __init__(self, plan: TrialPlan, inbox: Inbox, outbox: Outbox) -> None:
        super().__init__(plan)
        self._expects_impact = plan.expects_impact
        self._controller = Controller(plan)
        self._inbox = inbox
        self._outbox = outbox
        self._arm_of = {topics.joint_states(arm): arm for arm in plan.arms}
        self._period_ns = round(plan.scene.scenario.timing.control_period * 1e9)
        self._tick = -1  # the last one that was answered
        self._answers: dict[str, bytes] = {}
        self._gathering = -1
        self._gathered: dict[str, ArmMeasurement] = {}
        self._qp = dict.fromkeys(QpStatus, 0)
        self._skipped = 0

    def work(self, until: float) -> None:
        while (left := until - time.monotonic()) > 0.0:
            self._inbox.wait(left)
            for topic, data in self._inbox.take():
                self._answer(self._arm_of[topic], joint_signals(data))

    def end(self) -> str:
        hit = all(arm.detection is not None for arm in self._controller.arms.values())
        return "OK" if hit or not self._expects_impact else "NO-IMPACT"

    def status(self) -> tuple[str, dict[str, object]]:
        failed, relaxed = self._qp[QpStatus.FAILED], self._qp[QpStatus.RELAXED]
        line = f"{failed} QPs failed" if failed else f"{self._skipped} ticks skipped" if self._skipped else "ok"
        return line, {
            **self.tick_statistics(),
            "qp_failures": failed,
            "qp_relaxations": relaxed,
            "missed_ticks": self._skipped,
        }

    def _answer(self, arm: str, signals: JointSignals) -> None:
        """Take the measured state of one arm; decide for all when the last one of a tick is there."""
        tick = round(signals.stamp / self._period_ns)
        if tick <= self._tick:
            if tick == self._tick:  # the plant asks again
                self._outbox.repeat(topics.joint_command(arm), self._answers[arm])
            return
        if tick < self._gathering:
            return
        if tick > self._gathering:
            self._gathering, self._gathered = tick, {}
        position, velocity, torque = signals.values
        # It does not read the motor's state.
        self._gathered[arm] = ArmMeasurement(position, velocity, torque, position, velocity)
        if len(self._gathered) == len(self._arm_of):
            self._decide(tick)

    def _decide(self, tick: int) -> None:
        started = time.monotonic()
        outbox = self._outbox
        self._skipped += tick - self._tick - 1
        self._tick = tick
        commands = self._controller.update(tick, self._gathered)
        for arm, command in commands.items():
            self._answers[arm] = outbox.now(topics.joint_command(arm), tick, command)
        for arm, command in commands.items():
            outbox.keep(topics.controller_state(arm), tick, command)
            if command.detection is not None:
                outbox.later(topics.impact_event(arm), self._maker.impact_event(tick, arm, command.detection))
            self._qp[command.qp_status] += 1
        if outbox.due or tick == self._last:
            outbox.flush()
        self.now = tick * self._period_ns
        self._tick_times.append(time.monotonic() - started)


class ControllerNode(TrialNode[ControllerTrial]):
    """Runs a :class:`~impact_rs_control.controller.Controller`."""

    kind = "controller"

    def received(self, arms: list[str]) -> dict[str, str]:
        return {topics.joint_states(arm): topics.JOINT_STATE for arm in arms}

    def published(self, arms: list[str]) -> dict[str, str]:
        kinds = topics.recorded(arms)
        return {
            name: kinds[name]
            for arm in arms
            for name in (topics.joint_command(arm), topics.controller_state(arm), topics.impact_event(arm))
        }

    def streams(self, maker: StreamMaker, arms: list[str]) -> dict[str, Stream]:
        found = {}
        for arm in arms:
            found[topics.joint_command(arm)] = maker.joint_command(arm)
            found[topics.controller_state(arm)] = maker.controller_state(arm)
        return found

    def prepare(self, plan: TrialPlan, info: TrialInfo) -> ControllerTrial:
        del info
        return ControllerTrial(plan, self.inbox, self.outbox)


def main() -> None:
    """Run the node."""
    run(ControllerNode)


if __name__ == "__main__":
    main()
