# SPDX-License-Identifier: Apache-2.0
"""Forwards the torques of the cell to a real robot, and brakes the arms when no more torques come.

A JointGroupEffortController of ros2_control holds the last command for ever. This node is a process of its own and the
only one that sends commands to the robot. It receives the torques of the cell on a separate topic and forwards each at
once, limited to the torque rate of the robot. If no torque has come for ``command_timeout`` of the robot's clock while
a joint moves, the watchdog brakes and holds the arms as the cell does
(:meth:`~impact_rs_trials.cell.effort_arms.EffortArms.rest`), and drops torques of the cell until a call of ``~/reset``.
Meanwhile ``~/braking`` (latched) is true, and the cell arms nothing.

It shares machine, Python and middleware with the cell: it is no safety function.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Sequence

from rclpy.publisher import Publisher
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import torques_of
from impact_rs_ros.names import on_network
from impact_rs_ros.process import NodeProgram, run
from impact_rs_ros.qos import AWAITED, COMMAND, LATCHED
from impact_rs_ros.robot_clock import RobotClock
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.cell.effort_arms import (
    MAX_BRAKING_S,
    arms_of,
    commands_topic,
    rest_until,
    watched_topic,
)
from impact_rs_trials.cell.robot_states import STATES
from impact_rs_trials.cell.watchdog import Watchdog
from impact_rs_trials.spec import TrialSpec

BRAKING_TOPIC = "/watchdog/braking"
TORQUES = "std_msgs/msg/Float64MultiArray"
SERVICE_POLL_S = 0.02
MAX_INBOX_PAUSE_S = 0.01  # between two reads of the inbox; after a longer one all of it is read before anything is sent


class WatchdogNode(NodeProgram):
    """Passes the commands of the cell on to the robot."""

    kind = "watchdog"
    background = False

    def __init__(self) -> None:
        super().__init__()
        self._clock = RobotClock(self.node)
        self._inbox = Inbox(self.node, AWAITED, raw=True)
        self._publishers: dict[str, Publisher] = {}
        self._braking = self.node.create_publisher(Bool, on_network(BRAKING_TOPIC), LATCHED)
        self._arm_of: dict[str, str] = {}
        self._watchdog: Watchdog | None = None
        self._last_check = 0.0  # time of the last check [s]

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        del neighbours
        self._arm_of = {watched_topic(arm): arm for arm in arms}
        self._inbox.connect({STATES: topics.JOINT_STATE} | dict.fromkeys(self._arm_of, TORQUES))
        self._publishers = {
            arm: self.node.create_publisher(Float64MultiArray, on_network(commands_topic(arm)), COMMAND) for arm in arms
        }

    def rehearse(self, spec: TrialSpec) -> None:
        arms = arms_of(spec.plan, self.parameter, self._clock, self._send)
        self._watchdog = Watchdog(arms, self.parameter("command_timeout"))

    def offer(self) -> None:
        self.node.create_service(Trigger, "~/reset", self._on_reset)
        self._braking.publish(Bool(data=False))

    def turn(self) -> None:
        until = time.monotonic() + SERVICE_POLL_S
        while (remaining := until - time.monotonic()) > 0.0:
            self._inbox.wait(min(remaining, 0.002))
            self._check()
        self.serve(0.0)
        self.diagnose()

    def _check(self) -> None:
        """Forward received torques, check the silence up to now, and brake if due."""
        assert self._watchdog is not None
        watchdog, now = self._watchdog, time.monotonic()
        if now - self._last_check > MAX_INBOX_PAUSE_S:
            self._inbox.gather()
        self._last_check = now
        self._take()
        if watchdog.silent(self._clock.steady()):
            self._inbox.gather()  # commands that waited while this process did not run are no silence of the cell
            self._take()
            if watchdog.look(self._clock.steady()):
                self.log.error("no torques of the cell while the arm moves: braking until ~/reset is called")
                self._braking.publish(Bool(data=True))
        if watchdog.braking:
            watchdog.arms.rest()

    def _take(self) -> None:
        """Forward the newest command of each arm first, because the robot waits for it; then read the states."""
        assert self._watchdog is not None
        states, commands = [], {}
        for topic, data in self._inbox.take():
            if topic == STATES:
                states.append(data)
            else:
                commands[self._arm_of[topic]] = data
        for arm, data in commands.items():
            self._watchdog.heard(arm, torques_of(data), self._clock.steady())
        for data in states:
            self._watchdog.arms.states.read(data)

    def status(self) -> tuple[str, dict[str, object]]:
        if self._watchdog is not None and self._watchdog.deposed:
            return "passed over: the cell saw no torque passed on; start this node again", {"braking": False}
        if self._watchdog is None or not self._watchdog.braking:
            return "ok", {"braking": False}
        return "braking: the cell sent no torques while the arm moved; call ~/reset", {"braking": True}

    def close(self) -> None:
        self.brake()
        self._inbox.close()
        self._clock.close()

    def brake(self) -> None:
        """Brake until the arms are at rest, where their last torque may stay: no other process can change it."""
        watchdog, until = self._watchdog, time.monotonic() + MAX_BRAKING_S
        while watchdog is not None and watchdog.commanded and not watchdog.arms.held:
            if time.monotonic() > until:
                self.log.error(f"the arms did not come to rest within {MAX_BRAKING_S:g} s: press the emergency stop")
                return
            rest_until(watchdog.arms, self._inbox, time.monotonic() + SERVICE_POLL_S, time.monotonic)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if self._watchdog is None or not self._watchdog.braking:
            response.message = "watchdog: it is not braking"
        elif not self._watchdog.arms.held:
            response.message = "watchdog: the arms are not at rest yet"
        else:
            self._watchdog.reset()
            self._braking.publish(Bool(data=False))
            self.log.info("reset: watching again")
            response.success = True
        return response

    def _send(self, arm: str, torque: Array) -> None:
        self._publishers[arm].publish(Float64MultiArray(data=array("d", torque.tobytes())))


def main() -> None:
    """Run the node."""
    run(WatchdogNode)


if __name__ == "__main__":
    main()
