# SPDX-License-Identifier: Apache-2.0
"""What the watchdog adds to a torque's way to the robot: ``./run python benchmarks/watchdog_hop.py [SECONDS]``.

Three processes: a cell that sends a torque every millisecond, in turns through the watchdog node and past it on a topic
of its own, the watchdog, and a robot that publishes states at 1 kHz and notes when torques come. Printed are median and
99 % quantile of the time on either way, by one clock, and what the watchdog adds. Torques carry their number.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from array import array

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impact_rs_ros.effort_arms import commands_topic, watched_topic
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.middleware import set_middleware
from impact_rs_ros.qos import COMMAND, RECORD
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

PERIOD = 0.001  # s
PAST = "/past/arm/commands"
WAYS = (commands_topic("arm"), PAST)
STEP = 1e-6  # N m from one torque to the next, so that the rate limit changes none and each tells its number
SETTLING = 500  # torques that are not counted


def robot() -> None:
    """Publish states of a resting arm, and print when each torque came [s]."""
    spec = TrialSpec.of(load_scenario("push"), "cat_food", "case_2").plan
    node = Node("robot")
    inbox = Inbox(node, "inbox", RECORD)
    inbox.connect(dict.fromkeys(WAYS, "std_msgs/msg/Float64MultiArray"))
    states = node.create_publisher(JointState, "/joint_states", 10)
    model, q = spec.scene.models["arm"], spec.arms["arm"].initial
    message = JointState(name=[f"arm_joint{number}" for number in range(1, q.size + 1)])
    message.position, message.velocity, message.effort = list(q), [0.0] * q.size, list(model.gravity_torque(q))
    rows: list[str] = []
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    print("ready", flush=True)
    due = time.monotonic()
    while not stopped:
        message.header.stamp = node.get_clock().now().to_msg()
        states.publish(message)
        due += PERIOD
        while (left := due - time.monotonic()) > 0.0:
            inbox.wait(left)
            now = time.monotonic()
            for topic, came in inbox.take():
                rows.append(f"{WAYS.index(topic)} {round(came.data[0] / STEP)} {now}")
    print("\n".join(rows), flush=True)


def main(seconds: float) -> None:
    """Measure."""
    set_middleware(os.environ)
    os.environ.setdefault("ROS_DOMAIN_ID", "93")
    node_of = [sys.executable, "-m", "impact_rs_ros.watchdog_node"]
    with (
        subprocess.Popen(node_of, stderr=subprocess.DEVNULL) as watchdog,
        subprocess.Popen([sys.executable, __file__, "robot"], stdout=subprocess.PIPE, text=True) as listener,
    ):
        assert listener.stdout is not None
        listener.stdout.readline()
        rclpy.init()
        node = Node("cell")
        ways = [node.create_publisher(Float64MultiArray, name, COMMAND) for name in (watched_topic("arm"), PAST)]
        while not all(way.get_subscription_count() for way in ways) or not node.count_publishers(WAYS[0]):
            time.sleep(0.05)
        time.sleep(1.0)  # until the watchdog has matched the robot, which nobody else can see
        sent, due = [], time.monotonic()
        for number in range(round(seconds / PERIOD)):
            message = Float64MultiArray(data=array("d", [number * STEP] * 7))
            sent.append(time.monotonic())
            ways[number % 2].publish(message)
            due = max(due + PERIOD, time.monotonic() - PERIOD)
            time.sleep(max(0.0, due - time.monotonic()))
        time.sleep(0.5)
        for process in (watchdog, listener):
            process.terminate()
        rows = [line.split() for line in listener.stdout.read().splitlines()]
        rclpy.try_shutdown()
    took = [
        np.array([float(when) - sent[int(n)] for way, n, when in rows if int(way) == index and int(n) >= SETTLING])
        for index in range(2)
    ]
    for name, own in zip(("through the watchdog", "past it"), took, strict=True):
        middle, most = np.quantile(own, (0.5, 0.99))
        print(f"{name}: median {1e3 * middle:.3f} ms, 99 % {1e3 * most:.3f} ms, {own.size} torques")
    print(f"the watchdog adds {1e3 * (np.median(took[0]) - np.median(took[1])):.3f} ms in the median")


if __name__ == "__main__":
    if sys.argv[1:] == ["robot"]:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        robot()
    else:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
