# SPDX-License-Identifier: Apache-2.0
"""What the watchdog adds to a torque's way to the robot.

Three processes: a cell that sends a torque every millisecond, in turns through the watchdog node and past it on a topic
of its own, the watchdog, and a robot that publishes states at 1 kHz and notes when torques come. Both ways are timed by
one clock. Torques carry their number.
"""

from __future__ import annotations

import argparse
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

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.middleware import set_middleware
from impact_rs_ros.qos import COMMAND, RECORD
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.cell.effort_arms import commands_topic, watched_topic
from impact_rs_trials.spec import TrialSpec

PERIOD = 0.001  # s
PAST = "/past/arm/commands"
ROUTES = (commands_topic("arm"), PAST)
STEP = 1e-6  # N m from one torque to the next, so that the rate limit changes none and each tells its number
SETTLING = 500  # torques that are not counted


def robot() -> None:
    """Publish states of a resting arm, and print when each torque came [s]."""
    spec = TrialSpec.of(load_scenario("push"), "cat_food", "case_2").plan
    node = Node("robot")
    inbox = Inbox(node, RECORD)
    inbox.connect(dict.fromkeys(ROUTES, "std_msgs/msg/Float64MultiArray"))
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
        while (remaining := due - time.monotonic()) > 0.0:
            inbox.wait(remaining)
            now = time.monotonic()
            for topic, message_received in inbox.take():
                rows.append(f"{ROUTES.index(topic)} {round(message_received.data[0] / STEP)} {now}")
    print("\n".join(rows), flush=True)


def add_options(parser: argparse.ArgumentParser) -> None:
    """How long."""
    parser.add_argument("--duration", type=float, default=20.0, help="of sending torques [s]")


def cases(options: argparse.Namespace) -> list[Case]:
    """Both ways at once."""
    del options
    return [Case("torques")]


def run(case: Case, work: Work) -> Row:
    """Times on both ways [s]."""
    del case
    set_middleware(os.environ)
    os.environ.setdefault("ROS_DOMAIN_ID", "93")
    node_of = [sys.executable, "-m", "impact_rs_ros.watchdog_node"]
    with (
        subprocess.Popen(node_of, stderr=subprocess.DEVNULL) as watchdog,
        subprocess.Popen([sys.executable, "-m", __name__], stdout=subprocess.PIPE, text=True) as listener,
    ):
        assert listener.stdout is not None
        listener.stdout.readline()
        rclpy.init()
        node = Node("cell")
        routes = [node.create_publisher(Float64MultiArray, name, COMMAND) for name in (watched_topic("arm"), PAST)]
        while not all(route.get_subscription_count() for route in routes) or not node.count_publishers(ROUTES[0]):
            time.sleep(0.05)
        time.sleep(1.0)  # until the watchdog has matched the robot, which nobody else can see
        sent, due = [], time.monotonic()
        for number in range(round(work.options.duration / PERIOD)):
            message = Float64MultiArray(data=array("d", [number * STEP] * 7))
            sent.append(time.monotonic())
            routes[number % 2].publish(message)
            due = max(due + PERIOD, time.monotonic() - PERIOD)
            time.sleep(max(0.0, due - time.monotonic()))
        time.sleep(0.5)
        for process in (watchdog, listener):
            process.terminate()
        rows = [line.split() for line in listener.stdout.read().splitlines()]
        rclpy.try_shutdown()
    return {
        str(index): [
            float(when) - sent[int(n)] for route, n, when in rows if int(route) == index and int(n) >= SETTLING
        ]
        for index in range(2)
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Both ways, and their difference."""
    del options
    through, past = ([1e3 * value for value in rows[0][route]] for route in ("0", "1"))
    lines = [
        (name, *(f"{value:.3f}" for value in np.quantile(times, (0.5, 0.99))), str(len(times)))
        for name, times in (("through the watchdog", through), ("past it", past))
    ]
    added = (f"{np.quantile(through, q) - np.quantile(past, q):.3f}" for q in (0.5, 0.99))
    return Table(("Way of a torque", "median [ms]", "99 % [ms]", "torques"), (*lines, ("added", *added, "")))


if __name__ == "__main__":  # the process of the robot
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    robot()
