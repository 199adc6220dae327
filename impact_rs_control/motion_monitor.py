# SPDX-License-Identifier: Apache-2.0
"""Consistency check of the positions and velocities that an arm reports.

Two checks per joint over the window w = ``WINDOW_S``:

    |q(t) - q(t - w) - integral of dq| <= T_lag dq_max     position and velocity agree
    q and dq unchanged for w  =>  |dq| <= v and torque varies <= r tau_max   the joint rests and is not driven

The first finds position jumps and stuck velocity sensors; it allows for a filtered or differentiated velocity, delayed
by T_lag = ``MAX_VELOCITY_LAG_S``, and scales with the limits of the joint, not with an absolute angle. The second finds
frozen encoders behind live messages, v = ``MAX_UNCHANGED_SPEED``, r = ``FROZEN_TORQUE_RATIO``. A joint stays frozen
until its signals change, also when it is no longer driven: a brake on a frozen velocity would accelerate it for ever.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel

WINDOW_S = 0.1
MAX_VELOCITY_LAG_S = 0.01
MAX_UNCHANGED_SPEED = 0.02  # rad/s, m/s; a joint at rest: a brake on it is a thousandth of the gravity torque
FROZEN_TORQUE_RATIO = 0.05  # variation of the torque over the torque limit [-]


class MotionMonitor:
    """Checks the reported states of one arm.

    Args:
        model: The arm.
        joints: Names of its joints, for complaints.
    """

    def __init__(self, model: RobotModel, joints: Sequence[str]) -> None:
        self._joints = joints
        self._units = model.facts.units
        self._largest_gap = MAX_VELOCITY_LAG_S * model.velocity_max
        self._largest_range = FROZEN_TORQUE_RATIO * model.torque_max
        self._offsets: deque[tuple[float, Array]] = deque()  # time, position less the integral of velocity
        self._last: tuple[float, Array, Array] | None = None
        self._integral = np.zeros(model.joint_count)
        self._frozen = np.zeros(model.joint_count, dtype=bool)
        self._unchanged_since = np.zeros(model.joint_count)
        self._least = np.full(model.joint_count, np.inf)  # range of the torque since ``_unchanged_since``
        self._greatest = -self._least

    def complaint(self, time: float, position: Array, velocity: Array, torque: Array | None) -> str:
        """Joint whose signals are inconsistent; empty if all are consistent. A decreasing time resets the monitor.

        Args:
            time: When the state was measured [s].
            position: q, ``(n,)`` [rad].
            velocity: dq, ``(n,)`` [rad/s].
            torque: Commanded by a controller, ``(n,)`` [N m]; None: the arm is held.
        """
        if self._last is not None and time <= self._last[0]:
            self._last = None
            self._offsets.clear()
        disagreement, frozen = (
            self._disagreement(time, position, velocity),
            self._frozen_joint(time, position, velocity, torque),
        )
        self._last = time, position, velocity
        return disagreement or frozen

    def _disagreement(self, time: float, position: Array, velocity: Array) -> str:
        """Compare the position with the integral of velocity (trapezoidal rule)."""
        if self._last is not None:
            self._integral = self._integral + 0.5 * (time - self._last[0]) * (velocity + self._last[2])
        offset = position - self._integral
        self._offsets.append((time, offset))
        while self._offsets[0][0] < time - WINDOW_S:
            self._offsets.popleft()
        began, first = self._offsets[0]
        difference = offset - first
        for index in np.flatnonzero(~(np.abs(difference) <= self._largest_gap)).tolist():
            unit, limit = self._units[index].position, self._largest_gap[index]
            return (
                f"position of {self._joints[index]} changed by {difference[index]:.4g} {unit} more than its velocity "
                f"says, within {time - began:.3f} s; {limit:.2g} {unit} are allowed"
            )
        return ""

    def _frozen_joint(self, time: float, position: Array, velocity: Array, torque: Array | None) -> str:
        """Joint with bitwise constant signals though it moves or its torque varies."""
        changed, moving = np.ones_like(position, dtype=bool), np.abs(velocity) > MAX_UNCHANGED_SPEED
        if self._last is not None:
            changed = (position != self._last[1]) | (velocity != self._last[2])
        if torque is None:
            changed |= ~self._frozen & ~moving  # held at rest
        self._unchanged_since = np.where(changed, time, self._unchanged_since)
        self._least, self._greatest = np.where(changed, np.inf, self._least), np.where(changed, -np.inf, self._greatest)
        if torque is not None:
            self._least, self._greatest = np.minimum(self._least, torque), np.maximum(self._greatest, torque)
        varied = self._greatest - self._least
        unchanged_time, driven = time - self._unchanged_since, varied > self._largest_range
        self._frozen = (unchanged_time >= WINDOW_S) & (moving | driven)
        for index in np.flatnonzero(self._frozen).tolist():
            unit, speed = self._units[index], abs(velocity[index])
            cause = f"torque varied by {varied[index]:.3g} {unit.effort}"
            return (
                f"{self._joints[index]} reports the same position and velocity for {unchanged_time[index]:.3f} s while "
                f"its {cause if driven[index] else f'velocity is {speed:.3g} {unit.velocity}'}: a frozen sensor"
            )
        return ""
