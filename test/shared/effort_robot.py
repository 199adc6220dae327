# SPDX-License-Identifier: Apache-2.0
"""Stands for a robot with ros2_control: a process with the topics of broadcaster, effort controller and mocap.

It publishes ``/joint_states``, with a gripper among the joints and in an order of its own, ``/mocap/object_pose`` and
``/clock``; it takes ``/arm/effort_controller/commands`` and compensates gravity as franka_ros2 does. Its world is that
of ``examples/foreign_plant.py``. Once it is sent torques it waits for the one of each state, so that a slow machine
makes it slow and no trial worse; it is the clock of who uses its time.

    python effort_robot.py SCENARIO OBJECT CASE [--no-gravity] [--offset RAD] [--silent-after N] [--nan-after N]

N counts states from when the arm has left its place.
"""

from __future__ import annotations

import argparse
import importlib.util
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pinocchio as pin
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impact_msgs_py.conversions import pose_to_message
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "foreign_plant.py"
WAITING = 5.0  # s, for a torque, once some came
AWAY = 0.02  # rad; who is further from where it started takes part in a trial, and is not held
GRIPPER = "fr3_finger_joint1"


def world_class() -> type:
    """``World`` of the example."""
    found = importlib.util.spec_from_file_location("foreign_plant", EXAMPLE)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules["foreign_plant"] = module
    found.loader.exec_module(module)
    return module.World  # type: ignore[no-any-return]


def main() -> None:
    """Run until told to end."""
    parser = argparse.ArgumentParser()
    parser.add_argument("trial", nargs=3)
    parser.add_argument("--no-gravity", action="store_true")
    parser.add_argument("--offset", type=float, default=0.0)
    parser.add_argument("--silent-after", type=int, default=sys.maxsize)
    parser.add_argument("--nan-after", type=int, default=sys.maxsize)
    options = parser.parse_args()
    name, thing, case = options.trial
    spec = TrialSpec.of(load_scenario(name), thing, case)
    (arm,) = spec.plan.arms
    placed = spec.scene.object
    pose = np.concatenate((placed.position, pin.Quaternion(placed.rotation).coeffs()))
    world = world_class()(spec.scene, {arm: spec.plan.arms[arm].initial + options.offset}, pose)
    model, period = spec.scene.models[arm], world.period

    node = Node("controller_manager")
    executor = EventsExecutor()
    executor.add_node(node)
    received: list[np.ndarray] = []
    node.create_subscription(
        Float64MultiArray,
        f"{arm}/effort_controller/commands",
        lambda message: received.append(np.array(message.data)),
        10,
    )
    states = node.create_publisher(JointState, "joint_states", 10)
    poses = node.create_publisher(PoseStamped, "mocap/object_pose", 10)
    clock = node.create_publisher(Clock, "/clock", 10)
    joints = [f"fr3_joint{number}" for number in range(7, 0, -1)]
    sent: np.ndarray | None = None
    start, moved, led = world.arms[arm].q.copy(), 0, False
    began, step = time.time_ns(), 0
    print("ready", flush=True)
    while True:
        due = time.monotonic() + period
        stamp = Time()
        stamp.sec, stamp.nanosec = divmod(began + round(1e9 * step * period), 10**9)
        clock.publish(Clock(clock=stamp))
        moving = world.arms[arm]
        moved += moved > 0 or bool(np.abs(moving.q - start).max() > AWAY)
        message = JointState(name=[GRIPPER, *joints])
        message.header.stamp = stamp
        measured = moving.q.copy()
        if moved >= options.nan_after:
            measured[0] = np.nan
        message.position = [0.04, *measured[::-1]]
        message.velocity = [0.0, *moving.dq[::-1]]
        message.effort = [np.nan, *moving.torque[::-1]]
        if moved < options.silent_after:
            states.publish(message)
        if step % 4 == 0:
            seen = PoseStamped(pose=pose_to_message(world.object_pose))
            seen.header.stamp, seen.header.frame_id = stamp, "world"
            poses.publish(seen)
        until = time.monotonic() + WAITING if led else due
        while not received and (left := until - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        led = bool(received)
        if led:
            sent = received[-1]
            received.clear()
        if sent is not None:  # its brakes are on until then
            carried = np.zeros(7) if options.no_gravity else model.gravity_torque(moving.q)
            world.step({arm: sent + carried})
        step += 1
        if (left := due - time.monotonic()) > 0.0:
            time.sleep(left)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    with suppress(KeyboardInterrupt):
        main()
    rclpy.try_shutdown()
