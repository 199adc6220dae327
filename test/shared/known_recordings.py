# SPDX-License-Identifier: Apache-2.0
"""Recordings with signals that are known: an arm that moves evenly, hits a parcel, and goes on more slowly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.types import typestore

IMPACT = 0.4  # s
START = 1_763_500_000  # s, of the wall clock
LOG_LATE, COMMAND_LATE, POSE_LATE = 200_000, 350_000, 4_200_000  # ns after the stamp of the state
JOINTS = [f"panda_joint{joint}" for joint in (3, 1, 7, 2, 4, 6, 5)]
ORDER = [int(name[-1]) - 1 for name in JOINTS]
ARM = Physics.nominal(load_scenario("push"), "parcel").robot_model("arm")


@dataclass(frozen=True)
class Signals:
    """What is recorded, ``(k, 7)`` in the arm's order; times are nanoseconds since the start of the run."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    command: np.ndarray
    object_time: np.ndarray
    pose: np.ndarray

    @classmethod
    def known(cls, length: float = 0.7) -> Signals:
        time = np.arange(0, round(length * 1e9), 1_000_000)
        seconds = 1e-9 * time[:, None]
        speed = 0.2 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])  # rad/s
        after = np.maximum(seconds - IMPACT, 0.0)
        position = np.array([-0.277, -0.295, 0.557, -2.365, -1.305, 1.426, -0.682]) + speed * (seconds - 0.6 * after)
        weight = np.array([ARM.gravity_torque(q) for q in position])
        wave = np.sin(20.0 * seconds + np.arange(7))
        object_time = np.arange(0, time[-1], 4_000_000)
        moved = np.maximum(1e-9 * object_time - IMPACT, 0.0)
        pose = np.zeros((object_time.size, 7))
        pose[:, :3] = [0.43, -0.15, 0.485]
        pose[:, 1] -= 0.4 * moved
        pose[:, 6] = 1.0
        return cls(
            time=time,
            position=position,
            velocity=np.where(seconds < IMPACT, speed, 0.4 * speed),
            torque=weight + wave,
            command=weight - wave,
            object_time=object_time,
            pose=pose,
        )

    def without(self, first: float, last: float) -> Signals:
        """Without what lies between two times [s]."""
        kept = (self.time <= round(first * 1e9)) | (self.time >= round(last * 1e9))
        arm = {name: getattr(self, name)[kept] for name in ("time", "position", "velocity", "torque", "command")}
        return replace(self, **arm)


@dataclass
class BagFormat:
    """How a bag is written."""

    joints: Sequence[str] = tuple(JOINTS)
    order: Sequence[int] = tuple(ORDER)
    pose: str = "PoseStamped"
    command: str = "Float64MultiArray"
    child: str = "box"
    wrench: bool = False
    stamps: bool = True
    log_rate: float = 1.0  # of the clock of the log, by that of the stamps
    logged_late: int = LOG_LATE  # ns after the stamp of the joint states
    pose_logged_late: int = POSE_LATE
    topics: dict[str, str] = field(default_factory=dict)  # others than usual, by the usual one

    def write(self, path: Path, signals: Signals) -> Path:
        store = typestore()
        make, dump = store.types, store.serialize_cdr
        std, geometry = "std_msgs/msg/", "geometry_msgs/msg/"

        def header(nanoseconds: int, frame: str = "world") -> object:
            total = START * 10**9 + int(nanoseconds) if self.stamps else 0
            stamp = make["builtin_interfaces/msg/Time"](sec=total // 10**9, nanosec=total % 10**9)
            return make[std + "Header"](stamp=stamp, frame_id=frame)

        def pose(nanoseconds: int, row: np.ndarray) -> object:
            x, y, z, qx, qy, qz, qw = row.tolist()
            quaternion = make[geometry + "Quaternion"](x=qx, y=qy, z=qz, w=qw)
            placed = make[geometry + "Pose"](position=make[geometry + "Point"](x=x, y=y, z=z), orientation=quaternion)
            if self.pose == "PoseStamped":
                return make[geometry + "PoseStamped"](header=header(nanoseconds), pose=placed)
            if self.pose == "Odometry":
                zero = make[geometry + "Vector3"](x=0.0, y=0.0, z=0.0)
                twist = make[geometry + "Twist"](linear=zero, angular=zero)
                return make["nav_msgs/msg/Odometry"](
                    header=header(nanoseconds),
                    child_frame_id=self.child,
                    pose=make[geometry + "PoseWithCovariance"](pose=placed, covariance=np.zeros(36)),
                    twist=make[geometry + "TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
                )
            transform = make[geometry + "TransformStamped"](
                header=header(nanoseconds),
                child_frame_id=self.child,
                transform=make[geometry + "Transform"](
                    translation=make[geometry + "Vector3"](x=x, y=y, z=z), rotation=quaternion
                ),
            )
            if self.pose == "TransformStamped":
                return transform
            other = replace(transform, child_frame_id="table")
            return make["tf2_msgs/msg/TFMessage"](transforms=[other, transform])

        def command(nanoseconds: int, row: int) -> object:
            torque = signals.command[row]
            if self.command == "Float64MultiArray":
                return make[std + "Float64MultiArray"](
                    layout=make[std + "MultiArrayLayout"](dim=[], data_offset=0), data=torque
                )
            none, names = np.zeros(0), list(self.joints)
            torque = torque[list(self.order)]
            if self.command == "JointState":
                return make["sensor_msgs/msg/JointState"](
                    header=header(nanoseconds), name=names, position=none, velocity=none, effort=torque
                )
            point = make["trajectory_msgs/msg/JointTrajectoryPoint"](
                positions=none,
                velocities=none,
                accelerations=none,
                effort=torque,
                time_from_start=make["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
            )
            return make["trajectory_msgs/msg/JointTrajectory"](
                header=header(nanoseconds), joint_names=names, points=[point]
            )

        kinds = {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/effort_controller/commands": {
                "JointState": "sensor_msgs/msg/JointState",
                "JointTrajectory": "trajectory_msgs/msg/JointTrajectory",
            }.get(self.command, std + self.command),
            "/mocap/box/pose": {
                "Odometry": "nav_msgs/msg/Odometry",
                "TFMessage": "tf2_msgs/msg/TFMessage",
            }.get(self.pose, geometry + self.pose),
        }
        if self.wrench:
            kinds["/wrench"] = geometry + "WrenchStamped"
        messages: list[tuple[int, str, object]] = []
        logs = self.log_rate * np.maximum.accumulate(signals.time)  # the log's clock never runs backwards
        for row, (time, log) in enumerate(zip(signals.time, logs, strict=True)):
            numbers = {
                name: getattr(signals, source)[row, list(self.order)].astype(float)
                for name, source in (("position", "position"), ("velocity", "velocity"), ("effort", "torque"))
            }
            state = make[kinds["/joint_states"]](header=header(time), name=list(self.joints), **numbers)
            messages.append((int(log) + self.logged_late, "/joint_states", state))
            messages.append((int(log) + COMMAND_LATE, "/effort_controller/commands", command(time, row)))
        for time in signals.time[::2] if self.wrench else ():
            force = make[geometry + "Vector3"](x=1.0, y=float(time), z=3.0)
            wrench = make[geometry + "Wrench"](force=force, torque=make[geometry + "Vector3"](x=4.0, y=5.0, z=6.0))
            stamped = make[geometry + "WrenchStamped"](header=header(time), wrench=wrench)
            messages.append((int(time) + LOG_LATE, "/wrench", stamped))
        for row, time in enumerate(signals.object_time):
            messages.append((int(time) + self.pose_logged_late, "/mocap/box/pose", pose(time, signals.pose[row])))
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                topic: writer.add_connection(self.topics.get(topic, topic), kind, typestore=store)
                for topic, kind in kinds.items()
                if self.topics.get(topic, topic)
            }
            for log, topic, message in sorted(messages, key=lambda item: item[0]):
                if topic in connections:
                    writer.write(connections[topic], START * 10**9 + log, dump(message, kinds[topic]))
        return path
