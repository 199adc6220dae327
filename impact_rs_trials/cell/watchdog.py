# SPDX-License-Identifier: Apache-2.0
"""Watchdog: takes over arms that move without commands of the cell, and brakes them."""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.cell.effort_arms import MAX_REST_SPEED, EffortArms


class Watchdog:
    """Passes torques on until they stop coming, and then brakes.

    Args:
        arms: The arms.
        timeout: Largest time without a command before moving arms are taken over [s].

    Attributes:
        braking: Whether the arms were taken over.
        deposed: Whether the cell bypasses the watchdog, because it forwarded no torque.
    """

    def __init__(self, arms: EffortArms, timeout: float) -> None:
        self.arms = arms
        self.braking = False
        self.deposed = False
        self._timeout = timeout
        self._heard: dict[str, float] = {}  # time of the last command [s], by arm

    def heard(self, arm: str, torque: Array | None, now: float) -> None:
        """Pass a command of the cell, ``(n,)`` [N m], on to the robot, unless the arms were taken over.

        None: the command cannot be read. An empty command means that the cell now sends its torques to the robot
        itself, and the watchdog sends nothing any more.
        """
        if torque is not None and not torque.size:
            self.deposed, self.braking = self.deposed or self.commanded, False
        elif torque is not None and not self.braking and not self.deposed and self.arms.pass_on(arm, torque):
            self._heard[arm] = now

    def silent(self, now: float) -> bool:
        """Whether arms move although commands are missing for longer than the timeout."""
        if self.braking or self.deposed or not self._heard or self.arms.states.latest is None:
            return False
        speed = max(float(np.abs(arm.velocity).max()) for arm in self.arms.states.latest.arms.values())
        return now - min(self._heard.values()) > self._timeout and speed > MAX_REST_SPEED

    def look(self, now: float) -> bool:
        """Take over the arms if commands are missing; whether this happened just now."""
        taken_over = self.silent(now)
        self.braking |= taken_over
        return taken_over

    @property
    def commanded(self) -> bool:
        """Whether the watchdog was the last to send the robot a torque since the last reset."""
        return self.braking or (bool(self._heard) and not self.deposed)

    def reset(self) -> None:
        """Pass torques on again; the timeout counts from the next one."""
        self.braking = False
        self._heard.clear()
