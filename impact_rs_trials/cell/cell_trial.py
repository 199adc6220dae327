# SPDX-License-Identifier: Apache-2.0
"""One trial of real arms: every usable state of the robot is a tick, every torque that is in time goes to the robot.

Tick 0 is ``start_delay`` after the first state that is sent to the controller. Its time is fixed in advance, because
it is the origin of the stamps (ROS time) of states, torques and bag. Until then the arms are held, so that the first
state represents tick 0. The controller answers it; the torque is sent when the robot's states reach the time of tick 0.

The trial ends with a reason if a state is not usable, a torque is late or beyond a limit, states or torques stop
coming, or an arm rests away from its references (it has stopped itself). From then on the arms are braked and held
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
LATE_WINDOW_TICKS = 100  # newest ticks, of which the share of late torques is computed
MAX_REST_ERROR_M = 0.03  # from both references; an arm under control does not rest farther away
MAX_REST_AWAY_S = 0.1  # at rest beyond that distance


@dataclass(frozen=True)
class TrialLimits:
    """Limits that end a trial; the node's parameters of these names.

    Attributes:
        state_timeout: Largest age of a state, and largest time without a state [s].
        answer_timeout: Largest time until the torque for a state comes [s].
        late_torque_share: Largest share of the last ticks whose torque came after the next state, or never [-].
        start_tolerance: Largest distance of a joint from the start of the trial before tick 0 [rad].
        start_delay: Time from the first state for the controller to trial time 0, within which it has to answer [s].
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
        self._controlled = False  # whether torques of the controller are sent to the robot
        self._tick = 0
        self._first: dict[str, bytes] = {}  # the messages of tick 0, by topic
        self._first_sent = 0.0  # time at which they were sent [s]
        self._last_state_at = clock()  # arrival of the last usable state [s]
        self._sent_at: dict[int, float] = {}  # time at which a state was sent to the controller, by unanswered tick [s]
        self._answered = dict.fromkeys(plan.arms, -1)
        self._torques: dict[str, Array] = {}  # the last answer of each arm
        self._late: deque[bool] = deque(maxlen=LATE_WINDOW_TICKS)
        self._away_since: dict[str, int] = {}  # first tick of an arm at rest away from its references
        self._missed_ticks = self._poses = 0
        self._slowest_answer = 0.0  # s

    def begin(self) -> None:
        self.begun = True
        self._last_state_at = self._first_sent = self._clock()
        self._sent_at = {0: self._last_state_at}

    def work(self, until: float) -> None:
        while not self.over and (remaining := until - self._clock()) > 0.0:
            self._inbox.wait(min(remaining, self._limits.state_timeout, self._limits.answer_timeout))
            for topic, data in self._inbox.take():
                if topic == STATES:
                    before = self.arms.states.unreadable
                    self._take_states(self.arms.states.read(data))
                    self.unreadable += self.arms.states.unreadable - before
                elif topic == MOCAP:
                    self._forward_pose(data)
                else:
                    self._take_torque(self._arm_of[topic], data)
                if self.over:
                    return
            self._check_timeouts()
            if self._outbox.due:
                self._outbox.flush()

    def stop(self, failure: str) -> None:
        """End the trial early, and brake."""
        super().stop(failure)
        self.arms.rest()

    def end(self) -> str:
        return "OK"

    def status(self) -> tuple[str, dict[str, object]]:
        line = self.failure or (f"{self._missed_ticks} states without a torque" if self._missed_ticks else "ok")
        return line, {
            **self.tick_statistics(),
            "oldest_state [s]": f"{self.arms.states.oldest:.6f}",
            "slowest_answer [s]": f"{self._slowest_answer:.6f}",
            "missed_ticks": self._missed_ticks,
            "late_torques": sum(self._late),
            "rate_limited_torques": self.arms.limited,
        }

    @property
    def _time(self) -> str:
        return f"at t = {1e-9 * self.now:.3f} s"

    def _take_states(self, states: ArmStates | None) -> None:
        """Take a state of the robot, and ask the controller."""
        if states is None:
            return
        if states.complaint:
            self.stop(f"{self._time}: {states.complaint}")
            return
        self._last_state_at = now = self._clock()
        if self._origin is None:
            self._origin = self._maker.origin_ns = states.stamp + round(1e9 * self._limits.start_delay)
            self._outbox.begin(self._origin)
        tick = round((states.stamp - self._origin) / self._period_ns)
        if not self._controlled and not self._start(tick, states, now):
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
        if complaint := self._not_following(tick, states):
            self.stop(f"{self._time}: {complaint}")
            return
        self._tick, self.now = tick, tick * self._period_ns
        self._sent_at[tick] = now
        for arm, measured in states.arms.items():
            self._outbox.now(topics.joint_states(arm), tick, measured)
        self._tick_times.append(self._clock() - now)

    def _not_following(self, tick: int, states: ArmStates) -> str:
        """Message about an arm at rest away from its ante- and post-impact reference; empty: no such arm."""
        for arm, measured in states.arms.items():
            if (
                np.abs(measured.velocity).max() > MAX_REST_SPEED
                or self._distance(arm, measured.position, tick) <= MAX_REST_ERROR_M
            ):
                self._away_since.pop(arm, None)
                continue
            since = self._away_since.setdefault(arm, tick)
            if (tick - since) * self._period_ns >= 1e9 * MAX_REST_AWAY_S:
                return (
                    f"{arm} has rested for {MAX_REST_AWAY_S:g} s more than {MAX_REST_ERROR_M:g} m from its "
                    "references: has the robot stopped itself? See the log of its driver"
                )
        return ""

    def _distance(self, arm: str, position: Array, tick: int) -> float:
        """Distance of E from the nearer of its two references [m]."""
        plan, position_of_pad = self._plan.arms[arm], self._plan.scene.models[arm].placement(position).translation
        paths = plan.ante_position, plan.post_position
        return min(float(np.linalg.norm(position_of_pad - path.position[tick])) for path in paths)

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
        """Hold the arms until tick 0, and send its state until it is answered; whether the controller takes over."""
        if complaint := start_complaint(self._plan, states, self._limits.start_tolerance):
            self.stop(complaint)
            return False
        if tick >= 0:
            if 0 in self._sent_at:
                self.stop(f"the controller does not answer the first state within {self._limits.start_delay:g} s")
                return False
            self._controlled = True
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

    def _take_torque(self, arm: str, data: bytes) -> None:
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
        if self._controlled:
            self.arms.command(arm, torque)
        answered_ticks = [
            answered_tick for answered_tick in self._sent_at if answered_tick <= min(self._answered.values())
        ]
        for answered_tick in answered_ticks:
            answer_time = self._clock() - self._sent_at.pop(answered_tick)
            if self._controlled and answered_tick == tick:
                self._slowest_answer = max(self._slowest_answer, answer_time)
                if answer_time > self._limits.answer_timeout:
                    self._too_slow(answer_time)
                    return
        self._missed_ticks += max(0, len(answered_ticks) - 1)
        if self._last not in self._sent_at and self._tick == self._last:
            self._complete()

    def _complete(self) -> None:
        """The last tick has its answer."""
        if self._mocap is not None and not self._poses:
            self.stop("no pose of the object came during the trial, and mocap asks for them: does the tracker see it?")
        self.over = True

    def _too_slow(self, answer_time: float) -> None:
        limit = self._limits.answer_timeout
        self.stop(f"{self._time}: no torque of the controller for {answer_time:.4f} s, answer_timeout is {limit:g} s")

    def _check_timeouts(self) -> None:
        """Check for missing messages."""
        silent, limit = self._clock() - self._last_state_at, self._limits.state_timeout
        if silent > limit:
            self.stop(f"{self._time}: no state of the robot for {silent:.4f} s, state_timeout is {limit:g} s")
        elif self._sent_at:
            waited = self._clock() - next(iter(self._sent_at.values()))
            if self._controlled and waited > self._limits.answer_timeout:
                self._too_slow(waited)

    def _forward_pose(self, data: bytes) -> None:
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
