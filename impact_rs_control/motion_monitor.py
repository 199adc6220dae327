# SPDX-License-Identifier: Apache-2.0
"""Do position and velocity that an arm reports belong to one motion?

Two checks over the last WINDOW of states, made for every joint:

    |q(t) - q(t - WINDOW) - integral of dq| <= LAG dq_max             position and velocity agree
    q and dq unchanged for WINDOW  =>  torque varied <= STIR tau_max    a sensor that stands still is not driven

The first finds positions that jump and sensors of velocity that are stuck; it allows for a velocity that is filtered
or differentiated and so late by LAG. The second finds encoders that are frozen although messages keep coming. Both
scale with the limits of the joint, not with an absolute angle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

WINDOW = 0.1  # s
LAG = 0.01  # s
STIR = 0.05  # of the torque limit


class MotionMonitor:
    """Watches the states of one arm.

    Args:
        model: The arm.
        joints: Names of its joints, for complaints.
    """

    def __init__(self, model: RobotModel, joints: Sequence[str]) -> None:
        self._joints = joints
        self._units = [unit.position for unit in model.facts.units]
        self._efforts = [unit.effort for unit in model.facts.units]
        self._largest_gap = LAG * model.velocity_max
        self._largest_range = STIR * model.torque_max
        self._offsets: deque[tuple[float, Array]] = deque()  # time, position less the integral of velocity
        self._last: tuple[float, Array, Array] | None = None
        self._integral = np.zeros(model.joint_count)
        self._led = False
        self._unchanged_since = np.zeros(model.joint_count)
        self._least = self._greatest = np.zeros(model.joint_count)

    def complaint(self, time: float, position: Array, velocity: Array, torque: Array | None) -> str:
        """Which joint's signals do not belong together; empty: none. A time that goes back begins anew.

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
        """Position against the integral of velocity (trapezoidal rule)."""
        if self._last is not None:
            self._integral = self._integral + 0.5 * (time - self._last[0]) * (velocity + self._last[2])
        offset = position - self._integral
        self._offsets.append((time, offset))
        while self._offsets[0][0] < time - WINDOW:
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
        """A joint whose signals stay the same to the last bit while its torque varies."""
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
        frozen = (time - self._unchanged_since >= WINDOW) & (varied > self._largest_range)
        for index in np.flatnonzero(frozen).tolist():
            return (
                f"{self._joints[index]} reports the same position and velocity for "
                f"{time - self._unchanged_since[index]:.3f} s while its torque varied by {varied[index]:.3g} "
                f"{self._efforts[index]}: a frozen sensor"
            )
        return ""
