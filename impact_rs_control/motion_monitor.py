# SPDX-License-Identifier: Apache-2.0
"""Consistency check of the positions and velocities that an arm reports.

Two checks per joint over the window w = ``WINDOW_S``:

    |q(t) - q(t - w) - integral of dq| <= T_lag dq_max     position and velocity agree
    q and dq unchanged for w  =>  torque varies <= r tau_max   a frozen sensor of a joint that is not driven

The first finds position jumps and stuck velocity sensors; it allows for a filtered or differentiated velocity, delayed
by T_lag = ``MAX_VELOCITY_LAG_S``. The second finds frozen encoders behind live messages, r = ``FROZEN_TORQUE_RATIO``.
Both scale with the limits of the joint, not with an absolute angle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel

WINDOW_S = 0.1  # s
MAX_VELOCITY_LAG_S = 0.01  # s
FROZEN_TORQUE_RATIO = 0.05  # variation of the torque over the torque limit [-]


class MotionMonitor:
    """Checks the reported states of one arm.

    Args:
        model: The arm.
        joints: Names of its joints, for complaints.
    """

    def __init__(self, model: RobotModel, joints: Sequence[str]) -> None:
        self._joints = joints
        self._units = [unit.position for unit in model.facts.units]
        self._efforts = [unit.effort for unit in model.facts.units]
        self._largest_gap = MAX_VELOCITY_LAG_S * model.velocity_max
        self._largest_range = FROZEN_TORQUE_RATIO * model.torque_max
        self._offsets: deque[tuple[float, Array]] = deque()  # time, position less the integral of velocity
        self._last: tuple[float, Array, Array] | None = None
        self._integral = np.zeros(model.joint_count)
        self._led = False
        self._unchanged_since = np.zeros(model.joint_count)
        self._least = self._greatest = np.zeros(model.joint_count)

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
            self._frozen(time, position, velocity, torque),
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
        gap = offset - first
        for index in np.flatnonzero(~(np.abs(gap) <= self._largest_gap)).tolist():
            unit, limit = self._units[index], self._largest_gap[index]
            return (
                f"position of {self._joints[index]} changed by {gap[index]:.4g} {unit} more than its velocity says, "
                f"within {time - began:.3f} s; {limit:.2g} {unit} are allowed"
            )
        return ""

    def _frozen(self, time: float, position: Array, velocity: Array, torque: Array | None) -> str:
        """Joint with bitwise constant signals under a varying torque."""
        last, led, self._led = self._last, self._led, torque is not None
        if torque is None:
            return ""
        changed = np.ones_like(position, dtype=bool)
        if last is not None and led:
            changed = (position != last[1]) | (velocity != last[2])
        self._unchanged_since = np.where(changed, time, self._unchanged_since)
        self._least = np.where(changed, torque, np.minimum(self._least, torque))
        self._greatest = np.where(changed, torque, np.maximum(self._greatest, torque))
        varied = self._greatest - self._least
        frozen = (time - self._unchanged_since >= WINDOW_S) & (varied > self._largest_range)
        for index in np.flatnonzero(frozen).tolist():
            return (
                f"{self._joints[index]} reports the same position and velocity for "
                f"{time - self._unchanged_since[index]:.3f} s while its torque varied by {varied[index]:.3g} "
                f"{self._efforts[index]}: a frozen sensor"
            )
        return ""
