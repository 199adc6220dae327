# SPDX-License-Identifier: Apache-2.0
"""A robot that moves behind a watchdog, without processes."""

from __future__ import annotations

import numpy as np
from robot_bench import PERIOD, START, Robot

from impact_rs_trials.cell.watchdog import Watchdog

TIMEOUT = 0.05  # s
MOVING = np.full(7, 0.5)


class WatchedRobot:
    """A robot that moves, and a cell that sends five newton metres until it dies."""

    def __init__(self, velocity: np.ndarray = MOVING) -> None:
        self.robot = Robot()
        self.watchdog = Watchdog(self.robot.arms, TIMEOUT)
        self.velocity, self.position = velocity, START
        self.count = 0

    def period(self, sent: np.ndarray | None = None) -> bool:
        """A state comes, and a command of the cell if it lives; whether the arms are taken over."""
        self.robot.state(position=self.position, velocity=self.velocity)
        self.position = self.position + self.velocity * PERIOD
        self.count += 1
        if sent is not None:
            self.watchdog.heard("arm", sent, self.robot.clock())
        return self.watchdog.look(self.robot.clock())
