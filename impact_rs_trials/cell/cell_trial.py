# SPDX-License-Identifier: Apache-2.0
"""One trial of real arms: every usable state of the robot is a tick, every torque that is in time goes to the robot.

The time of tick 0 is chosen ahead, because states, torques and the bag have it in their stamps, which are ROS time:
``start_delay`` after the first state that the controller is sent. Until then the arms are held, so this state stands
for the one of tick 0. The controller answers it; its torque is sent when the robot's states reach that time.

A state that is not usable, a torque that is late or beyond a limit, silence of either, and an arm that rests away from
its references, as after a stop of its own, end the trial with the reason; from then on the arms are braked and held
(:meth:`impact_rs_trials.cell.effort_arms.EffortArms.rest`).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from impact_rs_control.arm_limits import torque_complaint
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import JointReader
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.cell.arming import start_complaint
from impact_rs_trials.cell.effort_arms import MAX_REST_SPEED, EffortArms
from impact_rs_trials.cell.motion_capture import MOCAP, TrackerPoses, serialized
from impact_rs_trials.cell.robot_states import STATES, ArmStates
from impact_rs_trials.lockstep.lockstep_trial import LeadingTrial
from impact_rs_trials.lockstep.wires import Incoming, Outgoing

REPEAT_S = 0.25  # until the first state is sent to the controller again
LATE_WINDOW_TICKS = 100  # the last ones, for the share of late torques
MAX_REST_ERROR_M = 0.03  # from both references; an arm that obeys does not rest beyond it
MAX_REST_AWAY_S = 0.1  # at rest so far from the references


@dataclass(frozen=True)
class TrialLimits:
    """Limits that end a trial; the node's parameters of these names.

    Attributes:
        state_timeout: A state that is older, or did not come for so long [s].
        answer_timeout: A torque that takes longer [s].
        late_torque_share: A larger share of the last ticks whose torque came after the next state, or never.
        start_tolerance: Distance of a joint from the start of the trial before it is led [rad].
        start_delay: From the first state for the controller to trial time 0 [s]; it has to answer within.
    """

    state_timeout: float
    answer_timeout: float
    late_torque_share: float
    start_tolerance: float
    start_delay: float


class CellTrial(LeadingTrial):
    """One trial of real arms.

    Args:
        plan: The trial.
        maker: Fills its messages.
        arms: The robot.
        limits: Limits that end the trial.
        mocap: Reads poses of the object; None: not used.
        inbox: Subscriptions to the robot's states, the object's poses and the controller's torques.
        outbox: Publishers to controller and recorder.
        clock: A clock that never goes back [s].
    """

    def __init__(
        self,
        plan: TrialPlan,
        maker: MessageMaker,
        arms: EffortArms,
        limits: TrialLimits,
        mocap: TrackerPoses | None,
        inbox: Incoming,
        outbox: Outgoing,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(plan, maker)
        self.arms = arms
        self._plan = plan
        self._limits = limits
        self._mocap = mocap
        self._inbox = inbox
        self._outbox = outbox
        self._clock = clock
        self._period_ns = round(plan.scene.scenario.timing.control_period * 1e9)
        self._arm_of = {topics.joint_command(arm): arm for arm in plan.arms}
        self._readers = {arm: JointReader(names, ("effort",)) for arm, names in self._maker.joints.items()}
        self._origin: int | None = None  # robot time of tick 0 [ns]; None: no state came yet
        self._led = False  # whether the robot is sent torques of the controller
        self._tick = 0
        self._first: dict[str, bytes] = {}  # the messages of tick 0, by topic
        self._first_sent = 0.0  # when
        self._heard = clock()  # when the last usable state came
        self._asked: dict[int, float] = {}  # times of states sent to the controller, by unanswered tick
        self._answered = dict.fromkeys(plan.arms, -1)
        self._torques: dict[str, Array] = {}  # the last answer of each arm
        self._late: deque[bool] = deque(maxlen=LATE_WINDOW_TICKS)
        self._astray: dict[str, int] = {}  # first tick of an arm at rest away from its references
        self._lost = self._poses = 0
        self._slowest = 0.0  # s

    def begin(self) -> None:
        self.begun = True
        self._heard = self._first_sent = self._clock()
        self._asked = {0: self._heard}

    def work(self, until: float) -> None:
        while not self.over and (left := until - self._clock()) > 0.0:
            self._inbox.wait(min(left, self._limits.state_timeout, self._limits.answer_timeout))
            for topic, data in self._inbox.take():
                if topic == STATES:
                    before = self.arms.states.unreadable
                    self._measured(self.arms.states.read(data))
                    self.unreadable += self.arms.states.unreadable - before
                elif topic == MOCAP:
                    self._seen(data)
                else:
                    self._commanded(self._arm_of[topic], data)
                if self.over:
                    return
            self._look_at_the_clock()
            if self._outbox.due:
                self._outbox.flush()

    def stop(self, failure: str) -> None:
        """End before the end, and brake."""
        super().stop(failure)
        self.arms.rest()

    def end(self) -> str:
        return "OK"

    def status(self) -> tuple[str, dict[str, object]]:
        line = self.failure or (f"{self._lost} states without a torque" if self._lost else "ok")
        return line, {
            **self.tick_statistics(),
            "oldest_state [s]": f"{self.arms.states.oldest:.6f}",
            "slowest_answer [s]": f"{self._slowest:.6f}",
            "missed_ticks": self._lost,
            "late_torques": sum(self._late),
            "rate_limited_torques": self.arms.limited,
        }

    @property
    def _time(self) -> str:
        return f"at t = {1e-9 * self.now:.3f} s"

    def _measured(self, states: ArmStates | None) -> None:
        """Take a state of the robot, and ask the controller."""
        if states is None:
            return
        if states.complaint:
            self.stop(f"{self._time}: {states.complaint}")
            return
        self._heard = now = self._clock()
        if self._origin is None:
            self._origin = self._maker.origin_ns = states.stamp + round(1e9 * self._limits.start_delay)
            self._outbox.begin(self._origin)
        tick = round((states.stamp - self._origin) / self._period_ns)
        if not self._led and not self._start(tick, states, now):
            return
        if tick <= self._tick:
            return
        if (tick - self._tick) * self._period_ns > 1e9 * self._limits.state_timeout + self._period_ns:
            self.stop(f"{self._time}: {tick - self._tick - 1} states of the robot are missing")
            return
        if tick > self._last:
            if self._tick < self._last:
                self.stop(f"{self._time}: the last state of the trial is missing")
            return
        if self._too_many_late(late=min(self._answered.values()) < self._tick):
            return
        if complaint := self._disobedience(tick, states):
            self.stop(f"{self._time}: {complaint}")
            return
        self._tick, self.now = tick, tick * self._period_ns
        self._asked[tick] = now
        for arm, measured in states.arms.items():
            self._outbox.now(topics.joint_states(arm), tick, measured)
        self._tick_times.append(self._clock() - now)

    def _disobedience(self, tick: int, states: ArmStates) -> str:
        """Message about an arm at rest away from its references with and without an impact; empty: not any."""
        for arm, measured in states.arms.items():
            if (
                np.abs(measured.velocity).max() > MAX_REST_SPEED
                or self._distance(arm, measured.position, tick) <= MAX_REST_ERROR_M
            ):
                self._astray.pop(arm, None)
                continue
            since = self._astray.setdefault(arm, tick)
            if (tick - since) * self._period_ns >= 1e9 * MAX_REST_AWAY_S:
                return (
                    f"{arm} has rested for {MAX_REST_AWAY_S:g} s more than {MAX_REST_ERROR_M:g} m from its "
                    "references: has the robot stopped itself? See the log of its driver"
                )
        return ""

    def _distance(self, arm: str, position: Array, tick: int) -> float:
        """From E at joint positions to the nearer one of its references [m]."""
        plan, place = self._plan.arms[arm], self._plan.scene.models[arm].placement(position).translation
        paths = plan.ante_position, plan.post_position
        return min(float(np.linalg.norm(place - path.position[tick])) for path in paths)

    def _too_many_late(self, late: bool) -> bool:
        """Count torques that came after the next state; end the trial if there are too many."""
        self._late.append(late)
        count, limit = sum(self._late), self._limits.late_torque_share
        if count <= limit * LATE_WINDOW_TICKS:
            return False
        self.stop(
            f"{self._time}: {count} of the last {len(self._late)} torques came after the next state or never, "
            f"late_torque_share is {limit:g}: is the controller fast enough?"
        )
        return True

    def _start(self, tick: int, states: ArmStates, now: float) -> bool:
        """Hold the arms until tick 0, and send its state until it is answered; returns whether they are led."""
        if complaint := start_complaint(self._plan, states, self._limits.start_tolerance):
            self.stop(complaint)
            return False
        if tick >= 0:
            if 0 in self._asked:
                self.stop(f"the controller does not answer the first state within {self._limits.start_delay:g} s")
                return False
            self._led = True
            for arm, torque in self._torques.items():
                self.arms.command(arm, torque)
            return True
        self.arms.rest()
        if not self._first:
            self._first = {
                topics.joint_states(arm): self._outbox.now(topics.joint_states(arm), 0, measured)
                for arm, measured in states.arms.items()
            }
        elif now - self._first_sent > REPEAT_S:
            self._first_sent = now
            for topic, data in self._first.items():
                self._outbox.repeat(topic, data)
        return False

    def _commanded(self, arm: str, data: bytes) -> None:
        """Take a torque of the controller, check it, and send it to the robot."""
        signals = self._readers[arm].read(data)
        if not signals.readable:
            self.unreadable += 1
            return  # as if it had not come: answer_timeout ends the trial if it stays so
        tick = round((signals.stamp - (self._origin or 0)) / self._period_ns)
        torque = signals.values[2]
        repeated = arm in self._torques and np.array_equal(torque, self._torques[arm])
        if tick == self._answered[arm] and not signals.complaint and not repeated:
            self.stop(
                f"{topics.joint_command(arm)} {self._time}: two torques for one state; are there two controllers?"
            )
            return
        if not self._answered[arm] < tick <= self._tick or not self._first:
            return  # of the trial before, or repeated
        model, joints = self._plan.scene.models[arm], self._maker.joints[arm]
        if complaint := signals.complaint or torque_complaint(model, joints, torque):
            self.stop(f"{topics.joint_command(arm)} {self._time}: {complaint}")
            return
        self._answered[arm], self._torques[arm] = tick, torque
        if self._led:
            self.arms.command(arm, torque)
        done = [asked for asked in self._asked if asked <= min(self._answered.values())]
        for asked in done:
            took = self._clock() - self._asked.pop(asked)
            if self._led and asked == tick:
                self._slowest = max(self._slowest, took)
                if took > self._limits.answer_timeout:
                    self._too_slow(took)
                    return
        self._lost += max(0, len(done) - 1)
        if self._last not in self._asked and self._tick == self._last:
            self._complete()

    def _complete(self) -> None:
        """The last tick has its answer."""
        if self._mocap is not None and not self._poses:
            self.stop("no pose of the object came during the trial, and mocap asks for them: does the tracker see it?")
        self.over = True

    def _too_slow(self, took: float) -> None:
        limit = self._limits.answer_timeout
        self.stop(f"{self._time}: no torque of the controller for {took:.4f} s, answer_timeout is {limit:g} s")

    def _look_at_the_clock(self) -> None:
        """Check for missing messages."""
        silent, limit = self._clock() - self._heard, self._limits.state_timeout
        if silent > limit:
            self.stop(f"{self._time}: no state of the robot for {silent:.4f} s, state_timeout is {limit:g} s")
        elif self._asked:
            waited = self._clock() - next(iter(self._asked.values()))
            if self._led and waited > self._limits.answer_timeout:
                self._too_slow(waited)

    def _seen(self, data: bytes) -> None:
        """Forward the pose of the object in the world frame."""
        if self._origin is None or self._mocap is None:
            return
        try:
            pose = self._mocap.read(data)
        except InputError as error:
            self.stop(f"{self._time}: {error}")
            return
        if pose is None:
            return
        stamp = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec - self._origin
        if 0 <= stamp <= self._last * self._period_ns:
            self._poses += 1
            self._outbox.later(topics.OBJECT_POSE, serialized(pose))
