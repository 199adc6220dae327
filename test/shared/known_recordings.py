# SPDX-License-Identifier: Apache-2.0
"""Recordings with signals that are known: an arm that moves evenly, hits a parcel, and goes on more slowly."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from ros_messages import message
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.cdr import Template
from impact_rs_trials.bags.types import typestore

TF = "tf2_msgs/msg/TFMessage"
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

    def _stamped(self, kind: str, nanoseconds: int, content: Mapping[str, Any]) -> Any:
        stamp = divmod(START * 10**9 + int(nanoseconds), 10**9) if self.stamps else (0, 0)
        return message(kind, {"header.stamp": stamp, "header.frame_id": "world", **content})

    def _state(self, nanoseconds: int, **numbers: np.ndarray) -> Any:
        """A JointState with numbers in the arm's order."""
        ordered = {name: values[list(self.order)] for name, values in numbers.items()}
        return self._stamped("sensor_msgs/msg/JointState", nanoseconds, {"name": list(self.joints), **ordered})

    def _pose(self, nanoseconds: int, row: np.ndarray) -> Any:
        place, turn = row[:3].tolist(), row[3:].tolist()
        if self.pose in ("PoseStamped", "Odometry"):
            inside = "pose.pose" if self.pose == "Odometry" else "pose"
            content = {f"{inside}.position": place, f"{inside}.orientation": turn}
            child = {"child_frame_id": self.child} if self.pose == "Odometry" else {}
            return self._stamped(self._kinds["/mocap/box/pose"], nanoseconds, content | child)
        content = {"transform.translation": place, "transform.rotation": turn}
        both = [
            self._stamped("geometry_msgs/msg/TransformStamped", nanoseconds, {**content, "child_frame_id": child})
            for child in ("table", self.child)
        ]
        return message(TF, {"transforms": both}) if self.pose == "TFMessage" else both[1]

    @functools.cached_property
    def _plain(self) -> Any:
        return message("std_msgs/msg/Float64MultiArray")

    def _command(self, nanoseconds: int, torque: np.ndarray) -> Any:
        kind, ordered = self._kinds["/effort_controller/commands"], torque[list(self.order)]
        if self.command == "Float64MultiArray":
            return typestore().serialize_cdr(replace(self._plain, data=torque), kind)
        if self.command == "JointState":
            return self._state(nanoseconds, effort=torque)
        point = message("trajectory_msgs/msg/JointTrajectoryPoint", {"effort": ordered})
        return self._stamped(kind, nanoseconds, {"joint_names": list(self.joints), "points": [point]})

    @property
    def _kinds(self) -> dict[str, str]:
        """Types of the messages by topic."""
        packages = {"JointState": "sensor_msgs", "JointTrajectory": "trajectory_msgs", "Float64MultiArray": "std_msgs"}
        of_pose = {"Odometry": "nav_msgs", "TFMessage": "tf2_msgs"}
        return {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/effort_controller/commands": f"{packages[self.command]}/msg/{self.command}",
            "/mocap/box/pose": f"{of_pose.get(self.pose, 'geometry_msgs')}/msg/{self.pose}",
        } | ({"/wrench": "geometry_msgs/msg/WrenchStamped"} if self.wrench else {})

    def write(self, path: Path, signals: Signals) -> Path:
        kinds, store = self._kinds, typestore()
        messages: list[tuple[int, str, Any]] = []
        logs = self.log_rate * np.maximum.accumulate(signals.time)  # the log's clock never runs backwards
        measured = {"position": signals.position, "velocity": signals.velocity, "effort": signals.torque}
        first = self._state(0, **{name: values[0].astype(float) for name, values in measured.items()})
        stamps = np.divmod(START * 10**9 + signals.time, 10**9) if self.stamps else (0, 0)
        columns = {name: values[:, list(self.order)] for name, values in measured.items()}
        columns |= dict(zip(("header.stamp.sec", "header.stamp.nanosec"), stamps, strict=True))
        states = Template.of(store, kinds["/joint_states"], first).rows(columns, signals.time.size)
        commands = [self._command(*pair) for pair in zip(signals.time, signals.command, strict=True)]
        for log, state, command in zip(logs, states, commands, strict=True):
            messages.append((int(log) + self.logged_late, "/joint_states", state))
            messages.append((int(log) + COMMAND_LATE, "/effort_controller/commands", command))
        for time in signals.time[::2] if self.wrench else ():
            content = {"wrench.force": (1.0, float(time), 3.0), "wrench.torque": (4.0, 5.0, 6.0)}
            messages.append((int(time) + LOG_LATE, "/wrench", self._stamped(kinds["/wrench"], time, content)))
        for row, time in enumerate(signals.object_time):
            seen = self._pose(time, signals.pose[row])
            messages.append((int(time) + self.pose_logged_late, "/mocap/box/pose", seen))
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                topic: writer.add_connection(self.topics.get(topic, topic), kind, typestore=store)
                for topic, kind in kinds.items()
                if self.topics.get(topic, topic)
            }
            for log, topic, content in sorted(messages, key=lambda item: item[0]):
                if topic in connections:
                    data = (
                        content
                        if isinstance(content, bytes | memoryview)
                        else store.serialize_cdr(content, kinds[topic])
                    )
                    writer.write(connections[topic], START * 10**9 + log, data)
        return path
