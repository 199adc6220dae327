# SPDX-License-Identifier: Apache-2.0
"""Stands for a robot with ros2_control: a process with the topics of broadcaster, effort controller and mocap.

Its world is the MuJoCo cell (``mujoco_cell.py``): elastic joints, motors with inertia behind a torque loop of
4 kHz, a pad that yields, sensors with noise. It publishes ``/joint_states``, with a gripper among the joints and in an
order of its own, ``/mocap/object_pose``, 250 times a second, in the frame of the tracker and some milliseconds after it
was taken, and ``/clock``; it takes ``/arm/effort_controller/commands`` and compensates gravity as franka_ros2 does.
Once it is sent torques it waits for the one of each state, so that a slow machine makes it slow and no trial worse; it
is the clock of who uses its time.

    python effort_robot.py SCENARIO OBJECT CASE [--offset RAD] [--silent-after N] [--nan-after N]
                           [--tracker X Y Z ROLL PITCH YAW] [--kill PID] [--kill-after N] [--slower N]
                           [--stall PID AFTER FOR]

N counts states from when the arm has left its place. With ``--kill`` the robot kills the cell after N of them, waits
for torques no longer, as no robot does, and prints whether its arm comes to rest; ``--slower`` N times as slowly as by
the clock on the wall, for who is left on a busy machine. With ``--stall`` it stops a process
AFTER so many states FOR so many, in which it waits for no torque, and prints what torques it was sent until a second
after that.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections import deque
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pinocchio as pin
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from mujoco_cell import MujocoCell
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impact_msgs_py.conversions import pose_to_message
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.spec import TrialSpec

LIFETIME = 240.0  # s of the robot's time, which the cell draws its noise for; longer than any test
WAITING = 5.0  # s, for a torque, once some came
AFTERWARDS = 1000  # states after a stall, whose torques are still looked at
QUIET = 0.1  # s, in which the torques come that are still on their way
WATCHED, RESTING = 4000, 0.02  # states after the cell was killed, and rad/s
AWAY = 0.02  # rad; who is further from where it started takes part in a trial, and is not held
POSE_EVERY = 4  # states
POSE_LATE = 6  # states, until a pose that was taken is on its way
QUEUE = 1000  # torques, of which none may get lost where they are looked at
FINGERS = ("fr3_finger_joint1", "fr3_finger_joint2")
TRACKER = "tracker"  # what motion capture calls its frame


def world_of(spec: TrialSpec, offset: float) -> MujocoCell:
    """The cell where a trial starts, or ``offset`` [rad] beside it in every joint."""
    scenario = spec.scene.scenario
    lasting = scenario.model_copy(update={"timing": scenario.timing.model_copy(update={"duration": LIFETIME})})
    start = {name: arm.initial + offset for name, arm in spec.plan.arms.items()}
    return MujocoCell(lasting, spec.scene.physics, start, spec.scene.object, seed=1)


def main() -> None:
    """Run until it is terminated."""
    parser = argparse.ArgumentParser()
    parser.add_argument("trial", nargs=3)
    parser.add_argument("--offset", type=float, default=0.0)
    parser.add_argument("--tracker", type=float, nargs=6, default=[0.0] * 6)
    parser.add_argument("--silent-after", type=int, default=sys.maxsize)
    parser.add_argument("--nan-after", type=int, default=sys.maxsize)
    parser.add_argument("--kill", type=int, default=0)
    parser.add_argument("--kill-after", type=int, default=sys.maxsize)
    parser.add_argument("--slower", type=int, default=1)  # wall time after a kill over its own
    parser.add_argument("--stall", type=int, nargs=3, default=[0, sys.maxsize, 0])
    options = parser.parse_args()
    name, item, case = options.trial
    spec = TrialSpec.of(load_scenario(name), item, case)
    (arm,) = spec.plan.arms
    world = world_of(spec, options.offset)
    model, period = spec.scene.models[arm], spec.scene.scenario.timing.control_period
    tracker = pin.SE3(pin.rpy.rpyToMatrix(*options.tracker[3:]), np.array(options.tracker[:3]))

    node = Node("controller_manager")
    executor = EventsExecutor()
    executor.add_node(node)
    received: list[np.ndarray] = []
    node.create_subscription(
        Float64MultiArray,
        f"{arm}/effort_controller/commands",
        lambda message: received.append(np.array(message.data)),
        QUEUE,
    )
    states = node.create_publisher(JointState, "joint_states", 10)
    poses = node.create_publisher(PoseStamped, "mocap/object_pose", 10)
    clock = node.create_publisher(Clock, "/clock", 10)
    joints = [f"fr3_joint{number}" for number in range(model.joint_count, 0, -1)]
    names = [FINGERS[0], *joints, FINGERS[1]]
    start = world.measure().arms[arm].position
    sent: np.ndarray | None = None  # its brakes are on until then, and its time stands still
    taken: deque[tuple[int, PoseStamped]] = deque()  # with the state in which they are published
    moved, led = 0, False
    killed, resting, since = False, 0, 0
    stall, merged = range(0), [(0, np.zeros(model.joint_count))]  # steps of the stall; every torque, and in which step
    began, step = time.time_ns(), 0
    print("ready", flush=True)
    while True:
        due = time.monotonic() + period * (options.slower if killed else 1)
        stamp = Time()
        stamp.sec, stamp.nanosec = divmod(began + round(1e9 * step * period), 10**9)
        clock.publish(Clock(clock=stamp))
        measured = world.measure()
        moving = measured.arms[arm]
        moved += moved > 0 or bool(np.abs(moving.position - start).max() > AWAY)
        carried = model.gravity_torque(moving.position)
        if not killed and moved >= options.kill_after:
            os.kill(options.kill, signal.SIGKILL)
            killed, since = True, step
            print(f"killed at {np.abs(moving.velocity).max():.3f} rad/s", flush=True)
        if not stall and moved >= options.stall[1]:
            os.kill(options.stall[0], signal.SIGSTOP)
            stall = range(step, step + options.stall[2])
            print(f"stalled at {np.abs(moving.velocity).max():.3f} rad/s", flush=True)
        if stall and step == stall.stop:
            os.kill(options.stall[0], signal.SIGCONT)
        if stall and step == stall.stop + AFTERWARDS:
            jumps = [float(np.abs(b - a).max()) for (_, a), (_, b) in pairwise(merged)]
            late = sum(when > stall.stop for when, _ in merged)
            fastest = float(np.abs(moving.velocity).max())
            print(f"merged: at most {max(jumps):.6f} N m, {late} after the stall, {fastest:.3f} rad/s", flush=True)
        if killed and resting >= 0:
            resting = resting + 1 if np.abs(moving.velocity).max() < RESTING else 0
            if resting == 100 or step - since == WATCHED:
                print(f"{'at rest' if resting == 100 else 'moving'} after {step - since} states", flush=True)
                resting = -1
        message = JointState(name=names)
        message.header.stamp = stamp
        if moved >= options.nan_after:
            moving.position[0] = np.nan
        message.position = [0.04, *moving.position[::-1], 0.04]
        message.velocity = [0.0, *moving.velocity[::-1], 0.0]
        message.effort = [np.nan, *moving.torque[::-1], np.nan]
        if moved < options.silent_after:
            states.publish(message)
        if measured.object is not None and (sent is not None or step % POSE_EVERY == 0):
            pose = tracker.actInv(pin.XYZQUATToSE3(np.append(measured.object.position, measured.object.quaternion)))
            seen = PoseStamped(pose=pose_to_message(pin.SE3ToXYZQUAT(pose)))
            seen.header.stamp, seen.header.frame_id = stamp, TRACKER
            taken.append((step + POSE_LATE, seen))
        if taken and taken[0][0] <= step:
            poses.publish(taken.popleft()[1])
        waits = led and not killed and step not in stall
        until = time.monotonic() + WAITING if waits else due
        while not received and (left := until - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        if (
            received and not led and not killed and step not in stall
        ):  # torques of states that it did not wait for: from now on it does
            quiet = time.monotonic() + QUIET
            while (left := quiet - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
        before = 0
        while stall and len(received) > before:  # every torque, also of several in one step
            before = len(received)
            executor.spin_once(timeout_sec=0.0)
        led = bool(received)
        if led:
            sent = received[-1]
            merged += [(step, torque) for torque in received]
            received.clear()
        if sent is not None:
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
