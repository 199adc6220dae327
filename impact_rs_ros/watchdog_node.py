# SPDX-License-Identifier: Apache-2.0
"""Brakes a real robot whose cell has died: a process of its own, for an effort controller keeps its last torque.

A JointGroupEffortController of ros2_control holds the last command for ever. This node hears the same joint states and
commands as the robot. Commands that have stopped for ``command_timeout`` of the robot's clock while a joint moves make
it take over: it brakes and holds the arms as the cell does (:meth:`impact_rs_ros.effort_arms.EffortArms.rest`) until a
call of ``~/reset``. It says so on ``~/braking`` (latched), where the cell arms nothing.
"""

from __future__ import annotations

import time
from array import array
from contextlib import suppress

import numpy as np
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from impact_rs_ros.effort_arms import REST, EffortArms, arms_of, commands_topic
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.names import on_network
from impact_rs_ros.process import NodeProgram, run
from impact_rs_ros.qos import AWAITED, COMMAND, LATCHED
from impact_rs_ros.robot_clock import RobotClock
from impact_rs_ros.robot_states import STATES
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.spec import TrialSpec

BRAKING = "/watchdog/braking"
TORQUES = "std_msgs/msg/Float64MultiArray"
SLICE = 0.02  # s, between two looks at services


class Watchdog:
    """When to take over.

    Args:
        arms: The arms.
        timeout: Without a command for so long, arms that move are taken over [s].

    Attributes:
        braking: Whether they were taken over.
    """

    def __init__(self, arms: EffortArms, timeout: float) -> None:
        self.arms = arms
        self.braking = False
        self._timeout = timeout
        self._commands: dict[str, tuple[float, bytes]] = {}  # the last one and when it came [s], by arm

    def heard(self, arm: str, data: bytes, now: float) -> None:
        """A command came."""
        self._commands[arm] = now, data

    def look(self, now: float) -> bool:
        """Whether the arms are taken over just now."""
        if self.braking or not self._commands or self.arms.states.latest is None:
            return False
        silent = now - min(when for when, _ in self._commands.values())
        speed = max(float(np.abs(arm.velocity).max()) for arm in self.arms.states.latest.arms.values())
        if silent <= self._timeout or speed <= REST:
            return False
        for arm, (_, data) in self._commands.items():
            with suppress(Exception):  # a last command that cannot be read is no reason not to brake
                self.arms.continue_from(arm, np.array(deserialize_message(data, Float64MultiArray).data))
        self.braking = True
        return True

    def reset(self) -> None:
        """Watch again, from the next command on."""
        self.braking = False
        self._commands.clear()


class WatchdogNode(NodeProgram):
    """Watches the commands of the cell."""

    kind = "watchdog"
    background = False

    def __init__(self) -> None:
        super().__init__()
        self._clock = RobotClock(self.node)
        self._inbox = Inbox(self.node, "inbox", AWAITED, raw=True)
        self._publishers: dict[str, Publisher] = {}
        self._braking = self.node.create_publisher(Bool, on_network(BRAKING), LATCHED)
        self._arm_of: dict[str, str] = {}
        self._watchdog: Watchdog | None = None

    def connect(self, arms: list[str]) -> None:
        self._arm_of = {commands_topic(arm): arm for arm in arms}
        self._inbox.connect({STATES: topics.JOINT_STATE} | dict.fromkeys(self._arm_of, TORQUES))
        self._publishers = {
            arm: self.node.create_publisher(Float64MultiArray, on_network(topic), COMMAND)
            for topic, arm in self._arm_of.items()
        }

    def rehearse(self, spec: TrialSpec) -> None:
        arms = arms_of(spec.plan, self.parameter, self._clock, self._send)
        self._watchdog = Watchdog(arms, self.parameter("command_timeout"))

    def offer(self) -> None:
        self.node.create_service(Trigger, "~/reset", self._on_reset)
        self._braking.publish(Bool(data=False))

    def turn(self) -> None:
        until = time.monotonic() + SLICE
        while (left := until - time.monotonic()) > 0.0:
            self._inbox.wait(min(left, 0.002))
            self._look()
        self.serve(0.0)
        self.diagnose()

    def _look(self) -> None:
        """Hear all that has come, then judge the silence up to the moment before, and brake if it is due."""
        assert self._watchdog is not None
        watchdog, now = self._watchdog, self._clock.steady()
        self._inbox.gather()  # commands that waited while this process did not run are no silence of the cell
        for topic, data in self._inbox.take():
            if topic == STATES:
                watchdog.arms.states.read(data)
            elif not watchdog.braking:  # else it hears itself
                watchdog.heard(self._arm_of[topic], data, now)
        if watchdog.look(now):
            self.log.error("no torques of the cell while the arm moves: braking until ~/reset is called")
            self._braking.publish(Bool(data=True))
        if watchdog.braking:
            watchdog.arms.rest()

    def status(self) -> tuple[str, dict[str, object]]:
        if self._watchdog is None or not self._watchdog.braking:
            return "ok", {"braking": False}
        return "braking: the cell sent no torques while the arm moved; call ~/reset", {"braking": True}

    def close(self) -> None:
        self._inbox.close()
        self._clock.close()

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
