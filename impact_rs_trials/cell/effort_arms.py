# SPDX-License-Identifier: Apache-2.0
"""Torques for arms behind ros2_control, one effort controller per arm.

A robot that compensates gravity itself (franka_ros2) is sent ``tau - g(q)``, every other one ``tau``. The torque
changes no faster than the robot allows, in time and not by message. Where no controller leads, :meth:`EffortArms.rest`
brakes on a fresh state and carries the weight, no more, without one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from impact_rs_control.arm_limits import rate_limited
from impact_rs_control.fallback import MAX_STATE_AGE_S, holding_torque
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.cell.robot_states import STATES, ArmStates, Clock, RobotStates, joint_names
from impact_rs_trials.lockstep.wires import Incoming

MAX_REST_SPEED = 0.02  # rad/s, m/s; the holding torque then changes by a thousandth of the gravity torque
MAX_BRAKING_S = 0.6  # until arms rest before they are left; six time constants of the brake


def commands_topic(arm: str) -> str:
    """Topic of the arm's JointGroupEffortController."""
    return f"/{arm}/effort_controller/commands"


def watched_topic(arm: str) -> str:
    """Topic of the torques that the watchdog passes on to the arm's effort controller."""
    return f"/watchdog/{arm}/commands"


class EffortArms:
    """The arms of one trial.

    Args:
        states: States of the robot, with its models, period and clock.
        states: States of the robot.
        motor_inertia: B that the torque loop leaves, ``(n,)`` [kg m^2], by arm.
        adds_gravity: Whether the robot compensates gravity itself.
        rate: Largest rate of a torque [N m/s].
        send: Sends an arm's effort controller its torques.

    Attributes:
        states: States of the robot.
        adds_gravity: Whether the robot compensates gravity itself.
        limited: Number of torques that were changed because they jumped too far.
        states: States of the robot.
        held: Whether the last torques may stay: the arms rest, with no more than the holding torque.
    """

    def __init__(
        self,
        states: RobotStates,
        motor_inertia: Mapping[str, Array],
        adds_gravity: bool,
        rate: float,
        send: Callable[[str, Array], None],
    ) -> None:
        self.states = states
        self.limited = 0
        self.held = False
        self._motor_inertia = motor_inertia
        self.adds_gravity = adds_gravity
        self._rate = rate
        self._send = send
        self._sent: dict[str, tuple[float, Array]] = {}  # when [s], and what, by arm
        self._braked: ArmStates | None = None  # last state that the brake answered

    def command(self, arm: str, torque: Array) -> None:
        """Send a controller's torque, ``(n,)`` [N m], with gravity; there must be a state."""
        self.states.commanded[arm] = torque
        self.held = False
        self._braked = None
        self._set(arm, torque)

    def pass_on(self, arm: str, wanted: Array) -> bool:
        """Send the torques of another process to the effort controller, ``(n,)`` [N m], limited in rate.

        Returns:
            Whether it was sent; not if there is no state yet, or not one finite torque per joint.
        """
        known = self.states.latest is not None and wanted.shape == (self.states.models[arm].joint_count,)
        if not known or not np.isfinite(wanted).all():
            return False
        self.states.commanded[arm] = wanted
        self.held = False
        self._braked = None
        self._limited(arm, wanted)
        return True

    def continue_from(self, arm: str, sent: Array) -> None:
        """Another process sent the robot this torque last, ``(n,)`` [N m]: the next one changes it within the rate."""
        if sent.shape == (self.states.models[arm].joint_count,) and np.isfinite(sent).all():
            self._sent[arm] = self.states.clock.steady(), sent

    def rest(self) -> None:
        """Brake and hold on a fresh state, once a state; without one carry the arms' weight and no more.

        A brake on an old state drives the arm (:mod:`impact_rs_control.fallback`). Without any state nothing is sent.
        """
        self.states.commanded.clear()
        latest = self.states.latest
        if latest is None:
            return
        fresh = 0.0 <= self.states.age <= MAX_STATE_AGE_S
        if fresh and latest is self._braked:
            return
        self._braked = latest if fresh else None
        reached = []
        for name, arm in latest.arms.items():
            model = self.states.models[name]
            torque = model.gravity_torque(arm.position)
            if fresh:
                torque = holding_torque(model, self._motor_inertia[name], arm.position, arm.velocity)
            still = bool(np.all(np.abs(arm.velocity) <= MAX_REST_SPEED))
            reached.append(self._set(name, torque) and fresh and still)
        self.held = all(reached)

    def _set(self, arm: str, torque: Array) -> bool:
        """Send a torque with gravity as far as the rate allows; whether all of it could be sent."""
        return self._limited(arm, torque - self._weight(arm) if self.adds_gravity else torque)

    def _limited(self, arm: str, wanted: Array) -> bool:
        """Send torques to the effort controller, limited in rate; whether they were sent in full."""
        now = self.states.clock.steady()
        if arm not in self._sent:  # an arm at rest that its weight was carried for
            self._sent[arm] = now - self.states.period, 0.0 * wanted if self.adds_gravity else self._weight(arm)
        last, before = self._sent[arm]
        elapsed = min(max(now - last, 0.0), self.states.period)  # a pause permits no jump
        largest = self._rate * elapsed
        sent = rate_limited(wanted, before, largest)
        reached = bool(np.abs(wanted - before).max() <= largest)
        self.limited += not reached
        self._sent[arm] = now, sent
        self._send(arm, sent)
        return reached

    def _weight(self, arm: str) -> Array:
        """Gravity torque at the last state, ``(n,)`` [N m]."""
        assert self.states.latest is not None
        return self.states.models[arm].gravity_torque(self.states.latest.arms[arm].position)


def arms_of(
    plan: TrialPlan, parameter: Callable[[str], Any], clock: Clock, send: Callable[[str, Array], None]
) -> EffortArms:
    """The arms of a trial, as the parameters of a robot's node describe them.

    Args:
        plan: The trial.
        parameter: Value of a parameter of the node.
        clock: Clock of the robot.
        send: Sends an arm's effort controller its torques.

    Raises:
        InputError: Two joints would have one name.
    """
    scene = plan.scene
    models = {arm: scene.models[arm] for arm in plan.arms}
    joints = joint_names(parameter("joints"), {arm: model.joint_count for arm, model in models.items()})
    period = scene.scenario.timing.control_period
    return EffortArms(
        RobotStates(models, joints, period, parameter("state_timeout"), clock),
        {arm: scene.physics.arms[arm].motor_inertia_reduced for arm in models},
        parameter("robot_adds_gravity"),
        parameter("torque_rate_limit"),
        send,
    )


def rest_until(arms: EffortArms, inbox: Incoming, until: float, monotonic: Callable[[], float]) -> None:
    """Brake and hold, or carry the weight, until ``until`` on the clock ``monotonic`` [s].

    Args:
        arms: The arms.
        inbox: Subscription to the robot's states; other messages are dropped.
        until: Time of return [s].
        monotonic: A clock that never goes back [s].
    """
    while (left := until - monotonic()) > 0.0:
        inbox.wait(min(left, arms.states.period))
        for topic, data in inbox.take():
            if topic == STATES:
                arms.states.read(data)
        arms.rest()  # on the newest state alone: states that waited move the torque no further than time allows
