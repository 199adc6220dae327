# SPDX-License-Identifier: Apache-2.0
"""Decides when arms that move without a command of the cell are taken over and braked."""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.cell.effort_arms import MAX_REST_SPEED, EffortArms


class Watchdog:
    """Passes torques on until they stop coming, and then brakes.

    Args:
        arms: The arms.
        timeout: Without a command for so long, arms that move are taken over [s].

    Attributes:
        braking: Whether they were taken over.
        deposed: Whether the cell bypasses the watchdog, because it forwarded no torque.
    """

    def __init__(self, arms: EffortArms, timeout: float) -> None:
        self.arms = arms
        self.braking = False
        self.deposed = False
        self._timeout = timeout
        self._heard: dict[str, float] = {}  # when the last command came [s], by arm

    def heard(self, arm: str, torque: Array | None, now: float) -> None:
        """A command of the cell came, ``(n,)`` [N m]; it goes to the robot, unless the arms were taken over.

        None: it cannot be read. One without torques says that the cell sends them itself: who had passed torques on
        sends nothing any more.
        """
        if torque is not None and not torque.size:
            self.deposed, self.braking = self.deposed or self.commanded, False
        elif torque is not None and not self.braking and not self.deposed and self.arms.pass_on(arm, torque):
            self._heard[arm] = now

    def silent(self, now: float) -> bool:
        """Whether an arm moves that no command has come for."""
        if self.braking or self.deposed or not self._heard or self.arms.states.latest is None:
            return False
        speed = max(float(np.abs(arm.velocity).max()) for arm in self.arms.states.latest.arms.values())
        return now - min(self._heard.values()) > self._timeout and speed > MAX_REST_SPEED

    def look(self, now: float) -> bool:
        """Whether the arms are taken over just now."""
        taken = self.silent(now)
        self.braking |= taken
        return taken

    @property
    def commanded(self) -> bool:
        """Whether the robot was sent anything since the last reset, and by no one else after it."""
        return self.braking or (bool(self._heard) and not self.deposed)

    def reset(self) -> None:
        """Pass torques on again, and watch from the next one on."""
        self.braking = False
        self._heard.clear()
