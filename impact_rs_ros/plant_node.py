"""The plant as a node: measured state out, torque in, and the truth below ``/truth``.

In lockstep the plant waits for the torque of every tick, matched by its stamp. An answer that does not come is asked
for again: the same sample with the same stamp, which the recorder stores once. Whatever nobody waits for is published
while the controller computes.
"""

from __future__ import annotations

import time

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import TrialPlan
from impact_rs_ros.exchange import joint_signals
from impact_rs_ros.process import run
from impact_rs_ros.streams import Stream, StreamMaker
from impact_rs_ros.trial_node import TrialNode
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import parse_model
from impact_rs_sim.plant import Plant
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.record import FrameSource, occasional_messages
from impact_rs_trials.bags.trial_info import TrialInfo

MATCHING = 0.002  # s, between two looks whether everybody listens
CONNECTING = 8.0  # s, that a controller which was just started may take to hear the first state


class PlantNode(TrialNode):
    """Steps a :class:`~impact_rs_sim.plant.Plant`."""

    kind = "plant"

    def __init__(self) -> None:
        self._plant: Plant | None = None
        self._over: Future | None = None  # present from the start of the ticks to their end
        self._missed = 0
        super().__init__()
        # The answer comes when the trial is over; meanwhile the other services stay open.
        self.node.create_service(Trigger, "~/run_trial", self._on_run, callback_group=MutuallyExclusiveCallbackGroup())

    def received(self, arms: list[str]) -> dict[str, str]:
        return {topics.joint_command(arm): topics.JOINT_STATE for arm in arms}

    def published(self, arms: list[str]) -> dict[str, str]:
        names = [topics.CLOCK, topics.TF, topics.OBJECT_POSE]
        names += [topics.TRUTH_MODEL, topics.TRUTH_OBJECT_POSE, topics.TRUTH_OBJECT_TWIST]
        for arm in arms:
            names += [topics.joint_states(arm), topics.motor_states(arm)]
            names += [topics.truth_joint_states(arm), topics.truth_contact_wrench(arm)]
        kinds = topics.recorded(arms)
        return {name: kinds[name] for name in names}

    def streams(self, maker: StreamMaker, arms: list[str]) -> dict[str, Stream]:
        found = {}
        for arm in arms:
            found[topics.joint_states(arm)] = maker.joint_states(arm)
            found[topics.motor_states(arm)] = maker.motor_states(arm)
            found[topics.truth_joint_states(arm)] = maker.joint_states(arm)
            found[topics.truth_contact_wrench(arm)] = maker.contact_wrench(arm)
        return found

    def prepare(self, plan: TrialPlan, info: TrialInfo) -> None:
        self._close_plant()
        physics = plan.scene.physics
        if info.model_yaml:
            physics = parse_model(info.model_yaml, "TrialInfo.model_yaml").apply(physics)
            self.outbox.later(topics.TRUTH_MODEL, String(data=info.model_yaml))
        self._plant = make_plant(plan, info.seed, physics)
        self._frames = FrameSource(plan.scene)
        self._states = {arm: topics.joint_states(arm) for arm in plan.arms}
        self._arm_of = {topics.joint_command(arm): arm for arm in plan.arms}
        self._last = plan.scene.scenario.timing.ticks
        self._period = plan.scene.scenario.timing.control_period
        self._torques: dict[str, Array] = {}
        self._tick = 0
        self._begun = False
        self._silent_since = 0.0
        self._missed = 0
        self._realtime = self.parameter("realtime")
        self._repeat_after = self.parameter("repeat_after")
        self._answer_timeout = self.parameter("answer_timeout")

    def end(self) -> str:
        self._close_plant()
        if self._over is not None:
            self._stop("the trial was aborted")
        return "OK"

    def status(self) -> tuple[str, dict[str, object]]:
        line = "ok" if self._missed == 0 else f"{self._missed} ticks without a torque in time"
        return line, {**self.tick_statistics(), "missed_ticks": self._missed}

    async def _on_run(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if self.plan is None or self._over is not None:
            response.message = f"plant: {'configure a trial first' if self.plan is None else 'the trial runs already'}"
            return response
        self._over = Future(executor=self.executor)
        self.failure = await self._over
        response.success = not self.failure
        response.message = self.failure
        return response

    def _stop(self, failure: str) -> None:
        if self._over is not None:
            self._over.set_result(failure)
            self._over = None
            self.failure = failure

    def work(self, until: float) -> None:
        plant = self._plant
        if self._over is None or plant is None:
            self.executor.spin_once(timeout_sec=MATCHING)
            return
        if not self._begun:
            if self.outbox.unmatched():
                time.sleep(MATCHING)
                return
            self._begun = True
            self._measure(plant)
            self._started = time.monotonic()
        while (now := time.monotonic()) < until:
            self._rest()
            if not self._await_torques(now):
                return
            if self._tick == self._last:
                self._stop("")
                return
            try:
                plant.step(self._torques)
            except InputError as error:
                self._stop(f"at t = {self._tick * self._period:.3f} s: {error}")
                return
            self._tick += 1
            self._measure(plant)
            self.tick_times.append(time.monotonic() - now)

    def _measure(self, plant: Plant) -> None:
        """Publish what the controller waits for."""
        self._measured = plant.measure()
        self._asked = {
            topic: self.outbox.now(topic, self._tick, self._measured.arms[arm]) for arm, topic in self._states.items()
        }
        assert self.maker is not None
        self.now = self.maker.nanoseconds(self._tick)
        self._missing = set(self.arms)
        self._told = False

    def _rest(self) -> None:
        """Put aside, or publish, what nobody waits for; once a tick, while the controller computes."""
        plant, keep, tick = self._plant, self.outbox.keep, self._tick
        if self._told or plant is None:
            return
        self._told = True
        assert self.maker is not None
        truth = plant.truth()
        for arm, measured in self._measured.arms.items():
            keep(topics.motor_states(arm), tick, measured)
        for arm, state in truth.arms.items():
            keep(topics.truth_joint_states(arm), tick, state)
            keep(topics.truth_contact_wrench(arm), tick, state)
        for topic, message in occasional_messages(self.maker, tick, self._measured, truth, self._frames):
            self.outbox.later(topic, message)
        if self.outbox.due:
            self.outbox.flush()

    def _await_torques(self, asked: float) -> bool:
        """Whether this tick's torques are there; gives up for this turn, or for good, when they do not come."""
        paced = self._realtime and self._tick > 0
        deadline = self._started + self._tick * self._period if paced else asked + self._repeat_after
        assert self.maker is not None
        stamp = self.maker.nanoseconds(self._tick)
        while True:
            for topic, data in self.inbox.take():
                command = joint_signals(data)
                if command.stamp == stamp:
                    arm = self._arm_of[topic]
                    self._torques[arm] = command.values[2]
                    self._missing.discard(arm)
            left = deadline - time.monotonic()
            if not self._missing:
                if paced and left > 0.0:
                    time.sleep(left)
                elif self._tick == 0:
                    self._started = time.monotonic()
                self._silent_since = 0.0
                return True
            if left <= 0.0:
                break
            self.inbox.wait(left)
        if paced:
            self._missed += 1
            return True
        self._silent_since = self._silent_since or asked
        patience = self._answer_timeout if self._tick else max(CONNECTING, self._answer_timeout)
        if time.monotonic() - self._silent_since > patience:
            who = ", ".join(sorted(self._missing))
            self._stop(
                f"no torque for {who} at t = {self._tick * self._period:.3f} s within {patience:g} s: "
                "the controller is gone or too slow"
            )
            return False
        for topic, data in self._asked.items():
            self.outbox.repeat(topic, data)
        return False

    def _close_plant(self) -> None:
        if self._plant is not None:
            self._plant.close()
            self._plant = None


def main() -> None:
    """Run the node."""
    run(PlantNode)


if __name__ == "__main__":
    main()
