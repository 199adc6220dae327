# SPDX-License-Identifier: Apache-2.0
"""Arming before a trial on a real arm: observe the robot, then hold it, and refuse with the reason."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import median

import numpy as np
import pinocchio as pin

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.messages import pose_values
from impact_rs_trials.bags.topics import CLOCK
from impact_rs_trials.cell.effort_arms import MAX_REST_SPEED, EffortArms
from impact_rs_trials.cell.motion_capture import MOCAP, TrackedPose, TrackerPoses
from impact_rs_trials.cell.robot_states import STATES, ArmStates
from impact_rs_trials.lockstep.wires import Incoming

MIN_OBSERVED_S = 0.5  # for which the robot is observed before it is held
MIN_OBSERVED_STATES = 50  # in that time
ARMING_TIMEOUT_S = 3.0
HOLDING_S = 0.2  # of robot time, in which the held robot must not move before the controller takes over
PERIOD_TOLERANCE_SHARE = 0.02  # of the period, by which the robot's states may come faster or slower
MAX_POSE_AGE_S = 0.5  # of the object
ARMING_POLL_S = 0.002


@dataclass(frozen=True)
class ArmingLimits:
    """Limits of a robot for arming.

    Attributes:
        start: Largest distance of a joint from the start of the trial [rad].
        jitter: Largest difference between the periods of the states by arrival and by timestamps [s].
    """

    start: float
    jitter: float


class Arming:
    """Arms a robot for one trial: :meth:`look`, then :meth:`hold`.

    Args:
        plan: The trial.
        arms: The robot, to which nothing was sent yet in this trial.
        mocap: Reads poses of the object; None: not used.
        inbox: Subscriptions to the robot's states and the object's poses.
        limits: Limits of the robot.
        holder: Holds the arms since the previous trial, also while they are observed; None: not yet.
        monotonic: A clock that never goes back [s].
    """

    def __init__(
        self,
        plan: TrialPlan,
        arms: EffortArms,
        mocap: TrackerPoses | None,
        inbox: Incoming,
        limits: ArmingLimits,
        holder: EffortArms | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._plan = plan
        self._arms = arms
        self._mocap = mocap
        self._inbox = inbox
        self._limits = limits
        self._holder = holder
        self._monotonic = monotonic
        self._timeless = False  # whether states of unknown age came
        self._pose: TrackedPose | None = None  # last pose of the object

    def look(self) -> str:
        """Observe the robot's states for a while without new commands; returns the result in one line.

        Raises:
            InputError: The robot is not at rest at the start of the trial, or its states have another period than the
                trial, or too much jitter.
        """
        period = self._plan.scene.scenario.timing.control_period
        arrivals, stamps = [], []
        for states in self._states(self._holder):
            if complaint := start_complaint(self._plan, states, self._limits.start):
                raise InputError(f"not armed: {complaint}")
            arrivals.append(self._monotonic())
            stamps.append(states.stamp)
            if arrivals[-1] > arrivals[0] + MIN_OBSERVED_S and len(stamps) >= MIN_OBSERVED_STATES:
                break
        if not stamps and self._timeless:
            raise InputError(f"not armed: no time on {CLOCK}, which use_sim_time asks for")
        if not stamps:
            first = ", ".join(names[0] for names in self._arms.states.joints.values())
            raise InputError(f"not armed: no state of {first} and the other joints on {STATES}: is the robot running?")
        if len(stamps) < MIN_OBSERVED_STATES:
            raise InputError(
                f"{STATES}: {len(stamps)} states in {ARMING_TIMEOUT_S:g} s, expected {MIN_OBSERVED_STATES}"
            )
        steps = 1e-9 * np.diff(np.array(stamps))
        if abs(median(steps.tolist()) - period) > PERIOD_TOLERANCE_SHARE * period:
            raise InputError(
                f"{STATES}: a state every {1e3 * median(steps.tolist()):.3f} ms; timing.control_period of the scenario "
                f"is {1e3 * period:g} ms"
            )
        jitter = float(np.abs(np.diff(np.array(arrivals)) - steps).max())
        if jitter > self._limits.jitter:
            raise InputError(
                f"not armed: states come with a jitter of {1e3 * jitter:.3f} ms, arm_jitter_limit is "
                f"{1e3 * self._limits.jitter:g} ms"
            )
        return (
            f"jitter {1e3 * jitter:.3f} ms, oldest state {1e3 * self._arms.states.oldest:.3f} ms, {len(stamps)} states"
        )

    def hold(self) -> str:
        """Hold the arms for a moment; returns the position of the object in words, if its poses are used.

        Raises:
            InputError: The arms move, or no pose came. The arms stay held: with a gravity torque wrong by dtau a braked
                arm moves at T (M + B)^-1 dtau, with T the time constant of the brake; a released arm accelerates.
        """
        latest = self._arms.states.latest
        assert latest is not None
        end_of_holding = latest.stamp + round(1e9 * HOLDING_S)
        self._arms.rest()
        for states in self._states(self._arms):
            if complaint := start_complaint(self._plan, states, self._limits.start):
                adds = "adds" if self._arms.adds_gravity else "does not add"
                raise InputError(
                    f"not armed: {complaint}, while it was held; this node assumes that the robot {adds} gravity "
                    "(robot_adds_gravity)"
                )
            if states.stamp >= end_of_holding:
                return self._object()
        raise InputError(
            f"not armed: less than {HOLDING_S:g} s of states in {ARMING_TIMEOUT_S:g} s while the robot was held"
        )

    def _object(self) -> str:
        if self._mocap is None:
            return ""
        if self._pose is None or self._age_of(self._pose) > MAX_POSE_AGE_S:
            raise InputError(f"not armed: no pose of the object on {MOCAP} in the last {MAX_POSE_AGE_S:g} s")
        return f", object {distance_from_scenario(self._plan, self._pose)}"

    def _states(self, holder: EffortArms | None) -> Iterator[ArmStates]:
        """Usable states as they come, until the timeout; poses of the object are read, too."""
        deadline, first = self._monotonic() + ARMING_TIMEOUT_S, True
        while self._monotonic() < deadline:
            self._inbox.wait(ARMING_POLL_S)
            for topic, data in self._inbox.take():
                if topic == MOCAP and self._mocap is not None:
                    self._pose = self._mocap.read(data) or self._pose
                if topic != STATES:
                    continue
                if not self._arms.states.clock.known:
                    self._timeless = True
                    continue
                if holder is not None and holder is not self._arms:
                    holder.states.read(data)
                states = self._arms.states.read(data)
                if states is None:
                    continue
                if states.complaint:
                    raise InputError(f"not armed: {STATES}: {states.complaint}")
                if first:  # the timeout counts from the first state of a robot
                    deadline, first = self._monotonic() + ARMING_TIMEOUT_S, False
                yield states
            if holder is not None:
                holder.rest()

    def _age_of(self, pose: TrackedPose) -> float:
        """Difference between now and the timestamp of a pose [s]."""
        stamp = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec
        return abs(1e-9 * (self._arms.states.clock.now() - stamp))


def start_complaint(plan: TrialPlan, states: ArmStates, tolerance: float) -> str:
    """Reason why the arms are not at rest at the start of a trial; empty: they are.

    Args:
        plan: The trial.
        states: States of the arms.
        tolerance: Largest distance of a joint from the start [rad].
    """
    for name, arm_plan in plan.arms.items():
        arm = states.arms[name]
        distances = arm.position - arm_plan.initial
        index = int(np.argmax(np.abs(distances)))
        if abs(distances[index]) > tolerance:
            start = ", ".join(f"{value:.4f}" for value in arm_plan.initial)
            return (
                f"joint {index + 1} of {name} is {distances[index]:+.4f} rad from where the trial starts, "
                f"start_tolerance is {tolerance:g} rad; move the arm to [{start}]"
            )
        if not np.all(np.abs(arm.velocity) <= MAX_REST_SPEED):
            fastest = np.abs(arm.velocity).max()
            return f"{name} moves at {fastest:.3g} rad/s; a trial starts at rest, below {MAX_REST_SPEED:g} rad/s"
    return ""


def distance_from_scenario(plan: TrialPlan, pose: TrackedPose) -> str:
    """Distance of the object from its position in the scenario, in words; shows a wrong placement of the tracker.

    Args:
        plan: The trial.
        pose: Pose of the object, in ``world``.
    """
    nominal = pin.SE3(plan.scene.object.rotation, plan.scene.object.position)
    displacement = nominal.actInv(pin.XYZQUATToSE3(pose_values(pose.pose)))
    distance, angle = (
        float(np.linalg.norm(part)) for part in (displacement.translation, pin.log3(displacement.rotation))
    )
    return f"{1e3 * distance:.1f} mm and {np.degrees(angle):.1f} deg from its place in the scenario"
