# SPDX-License-Identifier: Apache-2.0
"""The clock of the robot's timestamps: this machine's, or a simulator's with ``use_sim_time``."""

from __future__ import annotations

import time

from rclpy.node import Node

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.node_parameters import value
from impact_rs_ros.qos import WATCH
from impact_rs_trials.bags import topics

MAX_CLOCK_SILENCE_S = 0.5  # of a simulator that runs


class RobotClock:
    """Time of timestamps, and monotonic time.

    Args:
        node: Node with the parameter ``use_sim_time``.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._inbox: Inbox | None = None
        self._simulated = self._newest_stamp = 0  # time of /clock, and timestamp of the newest state [ns]
        self._steady = self._last_simulated = 0.0  # monotonic time, and simulated time at its last query [s]
        self._last_query = self._last_advance = time.monotonic()  # of the simulator, on this machine's clock [s]
        if value(node, "use_sim_time"):  # past the executor of the node, which does not run while a trial does
            self._inbox = Inbox(node, WATCH)
            self._inbox.connect({topics.CLOCK: topics.CLOCK_TYPE})

    def now(self) -> int:
        """Time for comparisons with timestamps [ns]."""
        if self._inbox is None:
            return int(self._node.get_clock().now().nanoseconds)
        self._listen()
        return max(self._simulated, self._newest_stamp) if self._simulated else 0

    def _listen(self) -> None:
        """Read what has come on ``/clock``."""
        if self._inbox is not None:
            self._inbox.gather()
            for _, message in self._inbox.take():
                self._simulated = message.clock.sec * 10**9 + message.clock.nanosec

    def steady(self) -> float:
        """Monotonic time for differences [s], also when the clock of the machine is set.

        It follows a simulator, however slow, and this machine where the simulator has stopped.
        """
        real = time.monotonic()
        if self._inbox is None:
            return real
        simulated = 1e-9 * self.now()
        simulated_elapsed = max(0.0, simulated - self._last_simulated) if self._last_simulated else 0.0
        if simulated_elapsed:
            self._last_advance = real
        stopped_elapsed = real - max(self._last_query, self._last_advance + MAX_CLOCK_SILENCE_S)
        self._steady += simulated_elapsed or max(0.0, stopped_elapsed)
        self._last_simulated, self._last_query = simulated, real
        return self._steady

    def saw(self, stamp: int) -> None:
        """Note the timestamp [ns] of a received state: a lower bound of the simulated time, as ``/clock`` may lag.

        It lags by no more than ``MAX_CLOCK_SILENCE_S``; a state from further ahead is not of this clock.
        """
        self._listen()
        if stamp - self._simulated <= 1e9 * MAX_CLOCK_SILENCE_S:
            self._newest_stamp = max(self._newest_stamp, stamp)

    @property
    def known(self) -> bool:
        """Whether the time is known; simulated time only after its first message."""
        return self.now() != 0

    def forget(self) -> None:
        """Forget the time of a simulator, which may have been restarted."""
        if self._inbox is not None:
            self._inbox.clear()
            self._simulated = self._newest_stamp = 0

    def close(self) -> None:
        """Unsubscribe."""
        if self._inbox is not None:
            self._inbox.close()
