# SPDX-License-Identifier: Apache-2.0
"""The plant's side of a trial: publishes states, and waits for the torques of every tick, matched by their stamps.

If none comes, it publishes the same sample with the same stamp again. Signals that no other participant waits for are
published while the controller computes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from impact_rs_control.closed_loop import ran_away
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import JointReader
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.record import FrameSource, occasional_messages
from impact_rs_trials.lockstep.lockstep_trial import LeadingTrial
from impact_rs_trials.lockstep.wires import Incoming, Outgoing

CONNECTION_TIMEOUT_S = 8.0  # for a newly started controller to receive the first state


@dataclass(frozen=True)
class Pace:
    """Waiting times of the plant for torques; parameters of the node have these names.

    Attributes:
        realtime: Pace the ticks by the wall clock, and hold the last torque if the next is late. A late torque
            acts from the next tick on.
        missed_limit: Largest share of ticks without a torque in time; above it the trial is aborted [-].
        repeat_after: Time after which the sample is published again [s].
        answer_timeout: Time after which the trial is aborted [s].
    """

    realtime: bool
    missed_limit: float
    repeat_after: float
    answer_timeout: float


class PlantTrial(LeadingTrial):
    """One trial of a :class:`~impact_rs_sim.plant.plant.Plant`.

    Args:
        plan: The trial.
        maker: Fills its messages.
        plant: Its plant.
        pace: Waiting times for torques.
        inbox: Subscriptions to torques.
        outbox: Publishers of states.
        frames: Frames of ``/tf``.
    """

    def __init__(
        self,
        plan: TrialPlan,
        maker: MessageMaker,
        plant: Plant,
        pace: Pace,
        inbox: Incoming,
        outbox: Outgoing,
        frames: FrameSource,
    ) -> None:
        super().__init__(plan, maker)
        self._plan = plan
        self._plant = plant
        self._pace = pace
        self._inbox = inbox
        self._outbox = outbox
        self._period = plan.scene.scenario.timing.control_period
        self._frames = frames
        self._states = {arm: topics.joint_states(arm) for arm in plan.arms}
        self._arm_of = {topics.joint_command(arm): arm for arm in plan.arms}
        self._readers = {arm: JointReader(names, ("effort",)) for arm, names in self._maker.joints.items()}
        self._tick = 0
        self._measured = plant.measure()
        self._published: dict[str, bytes] = {}  # published states of this tick, by topic
        self._missing: set[str] = set()  # arms whose torque has not come
        self._torques: dict[str, Array] = {}  # newest torque of every arm [N m]
        self._answered: dict[str, int] = {}  # stamp of that torque, by arm [ns]
        self._others_published = False  # whether the signals that no node waits for are queued
        self._started = 0.0  # when real time began
        self._silent_since = 0.0
        self._missed = 0

    def begin(self) -> None:
        self.begun = True
        self._ask()
        self._started = time.monotonic()

    def work(self, until: float) -> None:
        while not self.over and (now := time.monotonic()) < until:
            self._publish_others()
            if not self._await_torques(now):
                return
            if self._tick == self._last or ran_away(self._plan, self._measured.arms, self._torques):
                self._finish()
                return
            try:
                self._plant.step(self._torques)
            except InputError as error:
                self.stop(f"at t = {self._tick * self._period:.3f} s: {error}")
                return
            self._tick += 1
            self._measured = self._plant.measure()
            self._ask()
            self._tick_times.append(time.monotonic() - now)

    def _finish(self) -> None:
        """End the trial; with too many late torques it is aborted."""
        if self._missed > self._pace.missed_limit * self._tick:
            self.stop(
                f"{self._late()}, {self._missed / self._tick:.1%}, and missed_ticks_limit is "
                f"{self._pace.missed_limit:.1%}: controller or machine is too slow for real time; with realtime false "
                "the plant waits for every torque"
            )
        self.over = True

    def _late(self) -> str:
        return f"{self._missed} of {self._tick} ticks without a torque in time"

    def end(self) -> str:
        self._plant.close()
        return "OK"

    def note(self) -> str:
        return "; ".join(filter(None, (self._late() if self._missed else "", super().note())))

    def status(self) -> tuple[str, dict[str, object]]:
        line = self._late() if self._missed else "ok"
        return line, {**self.tick_statistics(), "missed_ticks": self._missed}

    def _ask(self) -> None:
        """Publish the states that the controller waits for."""
        self._published = {
            topic: self._outbox.now(topic, self._tick, self._measured.arms[arm]) for arm, topic in self._states.items()
        }
        self.now = self._maker.nanoseconds(self._tick)
        self._missing = set(self._states)
        self._others_published = False

    def _publish_others(self) -> None:
        """Queue or publish the signals that no node waits for; once a tick, while the controller computes."""
        if self._others_published:
            return
        self._others_published = True
        keep, tick = self._outbox.keep, self._tick
        truth = self._plant.truth()
        for arm, measured in self._measured.arms.items():
            keep(topics.motor_states(arm), tick, measured)
        for arm, state in truth.arms.items():
            keep(topics.truth_joint_states(arm), tick, state)
            keep(topics.truth_contact_wrench(arm), tick, state)
        for topic, message in occasional_messages(self._maker, tick, self._measured, truth, self._frames):
            self._outbox.later(topic, message)
        if self._outbox.due:
            self._outbox.flush()

    def _await_torques(self, asked_at: float) -> bool:
        """Whether this tick's torques have arrived; aborts the trial after the timeout."""
        pace = self._pace
        paced = pace.realtime and 0 < self._tick < self._last  # the last state has its answer, late or not
        deadline = self._started + self._tick * self._period if paced else asked_at + pace.repeat_after
        while True:
            for topic, data in self._inbox.take():
                arm = self._arm_of[topic]
                command = self._readers[arm].read(data)
                self.unreadable += not command.readable
                if command.readable and self._is_accepted(arm, command.stamp):
                    if command.complaint:
                        self.stop(f"{topic} at t = {1e-9 * command.stamp:.3f} s: {command.complaint}")
                        return False
                    self._torques[arm], self._answered[arm] = command.values[2], command.stamp
                    if command.stamp == self.now:
                        self._missing.discard(arm)
            remaining = deadline - time.monotonic()
            if not self._missing:
                if paced and remaining > 0.0:
                    time.sleep(remaining)
                elif self._tick == 0:
                    self._started = time.monotonic()
                self._silent_since = 0.0
                return True
            if remaining <= 0.0:
                break
            self._inbox.wait(remaining)
        if paced:
            self._missed += 1
            return True
        self._silent_since = self._silent_since or asked_at
        patience = pace.answer_timeout if self._tick else max(CONNECTION_TIMEOUT_S, pace.answer_timeout)
        if time.monotonic() - self._silent_since > patience:
            arms = ", ".join(sorted(self._missing))
            self.stop(
                f"no torque for {arms} at t = {self._tick * self._period:.3f} s within {patience:g} s: "
                "the controller is gone or too slow"
            )
            return False
        for topic, data in self._published.items():
            self._outbox.repeat(topic, data)
        return False

    def _is_accepted(self, arm: str, stamp: int) -> bool:
        """Whether a torque of this timestamp [ns] is used: of this tick, or in real time a newer late one."""
        return stamp == self.now or (self._pace.realtime and self._answered.get(arm, stamp) < stamp < self.now)
