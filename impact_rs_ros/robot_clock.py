# SPDX-License-Identifier: Apache-2.0
"""The clock of the robot's stamps: this machine's, or with ``use_sim_time`` that of a simulator."""

from __future__ import annotations

import time

from rclpy.node import Node

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.node_parameters import value
from impact_rs_ros.qos import WATCH
from impact_rs_trials.bags import topics

MAX_CLOCK_SILENCE_S = 0.5  # of a simulator that runs


class RobotClock:
    """Time of stamps, and time that never goes back.

    Args:
        node: Its parameter ``use_sim_time`` says which clock.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._inbox: Inbox | None = None
        self._simulated = self._seen = 0  # by /clock, and by the newest state
        self._steady = self._read = 0.0  # s; the latter when it was last read, by the simulator
        self._asked = self._moved = time.monotonic()  # when that was, and when the simulator last went on
        if value(node, "use_sim_time"):  # past the executor of the node, which does not run while a trial does
            self._inbox = Inbox(node, "clock", WATCH)
            self._inbox.connect({topics.CLOCK: topics.CLOCK_TYPE})

    def now(self) -> int:
        """Time that stamps are compared with [ns]."""
        if self._inbox is None:
            return int(self._node.get_clock().now().nanoseconds)
        self._inbox.gather()
        for _, message in self._inbox.take():
            self._simulated = message.clock.sec * 10**9 + message.clock.nanosec
        return max(self._simulated, self._seen) if self._simulated else 0

    def steady(self) -> float:
        """Time of which differences are taken [s]; it never goes back, also when the clock of the machine is set.

        It follows a simulator, however slow, and this machine where the simulator has stopped.
        """
        real = time.monotonic()
        if self._inbox is None:
            return real
        simulated = 1e-9 * self.now()
        passed = max(0.0, simulated - self._read) if self._read else 0.0
        if passed:
            self._moved = real
        stopped = real - max(self._asked, self._moved + MAX_CLOCK_SILENCE_S)
        self._steady += passed or max(0.0, stopped)
        self._read, self._asked = simulated, real
        return self._steady

    def saw(self, stamp: int) -> None:
        """A state with this stamp [ns] has come: in a simulation it is that late at least, ``/clock`` may follow."""
        self._seen = max(self._seen, stamp)

    @property
    def known(self) -> bool:
        """Whether the time is known; that of a simulator is not until it was published."""
        return self.now() != 0

    def forget(self) -> None:
        """Forget the time of a simulator, which may have been started again."""
        if self._inbox is not None:
            self._inbox.clear()
            self._simulated = self._seen = 0

    def close(self) -> None:
        """Unsubscribe."""
        if self._inbox is not None:
            self._inbox.close()
