# SPDX-License-Identifier: Apache-2.0
"""The controller's side of a trial: answers every measured state with a torque that has its timestamp."""

from __future__ import annotations

import time

import numpy as np

from impact_rs_control.controller import ArmCommand, Controller, fallback_command
from impact_rs_control.fallback import braked_state
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import JointReader, JointSignals
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.lockstep.lockstep_trial import LockstepTrial
from impact_rs_trials.lockstep.wires import Incoming, Outgoing


class ControllerTrial(LockstepTrial):
    """One trial of a :class:`~impact_rs_control.controller.Controller`.

    Args:
        plan: The trial.
        maker: Fills its messages.
        inbox: Subscriptions to measured states.
        outbox: Publishers of commands.
        ros_time: Whether stamps are ROS time, and the first state is tick 0; otherwise they are trial time.
    """

    def __init__(
        self, plan: TrialPlan, maker: MessageMaker, inbox: Incoming, outbox: Outgoing, ros_time: bool = False
    ) -> None:
        super().__init__(plan, maker)
        self._expects_impact = plan.expects_impact
        self._controller = Controller(plan)
        self._inbox = inbox
        self._outbox = outbox
        self._arm_of = {topics.joint_states(arm): arm for arm in plan.arms}
        self._readers = {arm: JointReader(names) for arm, names in self._maker.joints.items()}
        # Last valid position and velocity; without valid states, the prediction for a braked arm.
        self._last_states = {
            arm: (arm_plan.initial, np.zeros_like(arm_plan.initial)) for arm, arm_plan in plan.arms.items()
        }
        self._plan = plan
        self._period_ns = round(plan.scene.scenario.timing.control_period * 1e9)
        self._origin_ns: int | None = None if ros_time else 0  # stamp of tick 0
        self._tick = -1  # the last answered tick
        self._answers: dict[str, bytes] = {}
        self._gathering = -1
        self._gathered: dict[str, ArmMeasurement] = {}
        self._qp_counts = dict.fromkeys(QpStatus, 0)
        self._skipped = 0
        self._out_of_trial = 0  # messages with a timestamp outside the trial

    def work(self, until: float) -> None:
        while (remaining := until - time.monotonic()) > 0.0:
            self._inbox.wait(remaining)
            for topic, data in self._inbox.take():
                arm = self._arm_of[topic]
                signals = self._readers[arm].read(data)
                if self._is_of_trial(signals):
                    self._answer(arm, signals)

    def end(self) -> str:
        hit = all(arm.detection is not None for arm in self._controller.arms.values())
        return "OK" if hit or not self._expects_impact else "NO-IMPACT"

    def status(self) -> tuple[str, dict[str, object]]:
        failed, relaxed = self._qp_counts[QpStatus.FAILED], self._qp_counts[QpStatus.RELAXED]
        line = f"{failed} QPs failed" if failed else f"{self._skipped} ticks skipped" if self._skipped else "ok"
        if self._out_of_trial:
            line = f"{self._out_of_trial} states with a stamp outside the trial: who else publishes?"
        line = self.failure or line
        return line, {
            **self.tick_statistics(),
            "qp_failures": failed,
            "qp_relaxations": relaxed,
            "missed_ticks": self._skipped,
        }

    def _is_of_trial(self, signals: JointSignals) -> bool:
        """Whether a state belongs to this trial; others are counted and not answered."""
        if not signals.readable:
            self.unreadable += 1
            return False
        if self._origin_ns is None:
            self._origin_ns = self._maker.origin_ns = signals.stamp
            self._outbox.begin(signals.stamp)
        inside = 0 <= self._tick_of(signals) <= self._last
        self._out_of_trial += not inside
        return inside

    def _tick_of(self, signals: JointSignals) -> int:
        return round((signals.stamp - (self._origin_ns or 0)) / self._period_ns)

    def _answer(self, arm: str, signals: JointSignals) -> None:
        """Take the measured state of one arm; compute torques once all arms have one."""
        tick = self._tick_of(signals)
        if tick <= self._tick:
            if tick == self._tick:  # the plant repeats its request
                self._outbox.repeat(topics.joint_command(arm), self._answers[arm])
            return
        if tick < self._gathering:
            return
        if tick > self._gathering:
            self._gathering, self._gathered = tick, {}
        if signals.complaint:
            self._fail(f"{topics.joint_states(arm)} at t = {1e-9 * tick * self._period_ns:.3f} s: {signals.complaint}")
            position, velocity = braked_state(*self._last_states[arm], 1e-9 * (tick - self._tick) * self._period_ns)
            torque = np.zeros_like(position)
        else:
            position, velocity, torque = signals.values
        self._last_states[arm] = position, velocity
        # The controller does not use the state of the motor; the state of the joint fills its place.
        self._gathered[arm] = ArmMeasurement(position, velocity, torque, position, velocity)
        if len(self._gathered) == len(self._arm_of):
            self._decide(tick)

    def _decide(self, tick: int) -> None:
        started = time.monotonic()
        outbox = self._outbox
        self._skipped += tick - self._tick - 1
        self._tick = tick
        commands = self._commands(tick)
        for arm, command in commands.items():
            self._answers[arm] = outbox.now(topics.joint_command(arm), tick, command)
        for arm, command in commands.items():
            outbox.keep(topics.controller_state(arm), tick, command)
            if command.detection is not None:
                outbox.later(topics.impact_event(arm), self._maker.impact_event(tick, arm, command.detection))
            self._qp_counts[command.qp_status] += 1
        if outbox.due or tick == self._last:
            outbox.flush()
        self.now = tick * self._period_ns
        self._tick_times.append(time.monotonic() - started)

    def _commands(self, tick: int) -> dict[str, ArmCommand]:
        """Commands of the controller; after a failure, commands that hold the arms."""
        if not self.failure:
            moment = f"at t = {1e-9 * tick * self._period_ns:.3f} s"
            try:
                commands = self._controller.update(tick, self._gathered)
                for arm, command in commands.items():
                    if command.qp_status is QpStatus.FAILED:
                        self._fail(f"the QP of {arm} {moment} has failed")
                    elif not np.isfinite(command.torque).all():
                        self._fail(f"the torque for {arm} {moment} is not finite")
                if not self.failure:
                    return commands
            except Exception as error:  # the arms need a torque in any case
                self._fail(f"the controller {moment}: {type(error).__name__}: {error}")
        scene, plans = self._plan.scene, self._plan.arms
        return {
            arm: fallback_command(
                scene.models[arm],
                scene.physics.arms[arm].motor_inertia_reduced,
                *state,
                6 + len(plans[arm].posture),
            )
            for arm, state in self._last_states.items()
        }

    def _fail(self, failure: str) -> None:
        """Keep the first failure, which is the result of the trial."""
        self.failure = self.failure or f"{failure}; the arms were held from there on"
