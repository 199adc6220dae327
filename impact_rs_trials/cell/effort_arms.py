# SPDX-License-Identifier: Apache-2.0
"""Torques for arms behind ros2_control, one effort controller per arm.

A robot that compensates gravity itself (franka_ros2) is sent ``tau - g(q)``, every other one ``tau``. The torque
changes no faster than the robot allows; the rate is limited per time, not per message. Without a controller
:meth:`EffortArms.rest` brakes if the state is fresh, and otherwise compensates gravity only.
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
        motor_inertia: B that the torque loop leaves, ``(n,)`` [kg m^2], by arm.
        adds_gravity: Whether the robot compensates gravity itself.
        rate: Largest rate of a torque [N m/s].
        send: Sends an arm's effort controller its torques.

    Attributes:
        states: States of the robot.
        adds_gravity: Whether the robot compensates gravity itself.
        limited: Number of torques that were changed by the rate limit.
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
        self._sent: dict[str, tuple[float, Array]] = {}  # time [s] and torque last sent, by arm
        self._braked: ArmStates | None = None  # last state that the brake answered

    def command(self, arm: str, torque: Array) -> None:
        """Send a torque of the controller, gravity included, ``(n,)`` [N m]; needs a state of the robot."""
        self.states.commanded[arm] = torque
        self.held = False
        self._braked = None
        self._send_torque(arm, torque)

    def pass_on(self, arm: str, torque: Array) -> bool:
        """Send the torques of another process to the effort controller, ``(n,)`` [N m], limited in rate.

        Returns:
            Whether the torques were sent: there is a state, and one finite torque per joint.
        """
        valid = self.states.latest is not None and torque.shape == (self.states.models[arm].joint_count,)
        if not valid or not np.isfinite(torque).all():
            return False
        self.states.commanded[arm] = torque
        self.held = False
        self._braked = None
        self._send_limited(arm, torque)
        return True

    def continue_from(self, arm: str, sent: Array) -> None:
        """Start the rate limit at the torque that another process sent last, ``(n,)`` [N m]."""
        if sent.shape == (self.states.models[arm].joint_count,) and np.isfinite(sent).all():
            self._sent[arm] = self.states.clock.steady(), sent

    def rest(self) -> None:
        """Brake and hold if the state is fresh, once per state; otherwise compensate gravity only.

        A brake with an old state drives the arm (:mod:`impact_rs_control.fallback`). Without any state nothing is sent.
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
            reached.append(self._send_torque(name, torque) and fresh and still)
        self.held = all(reached)

    def _send_torque(self, arm: str, torque: Array) -> bool:
        """Send a torque with gravity as far as the rate allows; whether all of it could be sent."""
        return self._send_limited(arm, torque - self._weight(arm) if self.adds_gravity else torque)

    def _send_limited(self, arm: str, torque: Array) -> bool:
        """Send torques to the effort controller, limited in rate; whether they were sent in full."""
        now = self.states.clock.steady()
        if arm not in self._sent:  # an arm at rest with gravity compensated
            self._sent[arm] = now - self.states.period, 0.0 * torque if self.adds_gravity else self._weight(arm)
        previous_time, previous = self._sent[arm]
        elapsed = min(max(now - previous_time, 0.0), self.states.period)  # a pause permits no jump
        largest = self._rate * elapsed
        sent = rate_limited(torque, previous, largest)
        reached = bool(np.abs(torque - previous).max() <= largest)
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
    while (remaining := until - monotonic()) > 0.0:
        inbox.wait(min(remaining, arms.states.period))
        for topic, data in inbox.take():
            if topic == STATES:
                arms.states.read(data)
        arms.rest()  # once, with the newest state: the rate limit counts time, not states
