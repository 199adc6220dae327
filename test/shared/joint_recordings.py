# SPDX-License-Identifier: Apache-2.0
"""Recordings of the joints alone, by column: time [s], position [rad], velocity [rad/s], effort [N m], ``(k, n)``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ros_messages import message
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags.types import typestore

Columns = dict[str, np.ndarray]
SIGNALS = ("position", "velocity", "effort")


def swinging(
    model: RobotModel,
    time: np.ndarray,
    centre: np.ndarray | float,
    frequencies: tuple[np.ndarray, np.ndarray],
    sizes: tuple[np.ndarray | float, np.ndarray | float],
) -> Columns:
    """Every joint swings at two frequencies of its own [Hz] about a centre; torques are those of inverse dynamics."""
    low, high = (2.0 * np.pi * frequency for frequency in frequencies)
    phase, t, (large, small) = np.arange(low.size), time[:, None], sizes
    q = centre + large * np.sin(low * t + phase) + small * np.sin(high * t)
    dq = large * low * np.cos(low * t + phase) + small * high * np.cos(high * t)
    ddq = -large * low**2 * np.sin(low * t + phase) - small * high**2 * np.sin(high * t)
    effort = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    return {"time": time, "position": q, "velocity": dq, "effort": effort}


def write_npz(path: Path, columns: Columns, **further: np.ndarray) -> Path:
    """An array file."""
    np.savez(path, **columns | further)
    return path


def write_csv(path: Path, columns: Columns) -> Path:
    """A table with a remark above its header."""
    count = columns["position"].shape[1]
    names = ["time", *(f"{name}_{joint}" for name in SIGNALS for joint in range(1, count + 1))]
    table = np.column_stack([columns[name] for name in ("time", *SIGNALS)])
    np.savetxt(path, table, delimiter=",", header="# made up\n" + ",".join(names), comments="", fmt="%.17g")
    return path


def write_bag(
    path: Path,
    columns: Columns,
    order: Sequence[int],
    storage: StoragePlugin = StoragePlugin.MCAP,
    behind: float = 0.0,
    names: Sequence[str] = tuple(f"fer_joint{joint}" for joint in range(1, 8)),
) -> Path:
    """A bag of JointState messages with the joints in some order; stamps are ``behind`` [s] the log."""
    store, kind = typestore(), "sensor_msgs/msg/JointState"
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/arm/joint_states", kind, typestore=store)
        for row, time in enumerate(columns["time"]):
            signals = {name: columns[name][row, list(order)] for name in SIGNALS}
            stamp, own = divmod(round((time + behind) * 1e9), 10**9), [names[joint] for joint in order]
            state = message(kind, {"header.stamp": stamp, "name": own, **signals})
            writer.write(connection, round(time * 1e9), store.serialize_cdr(state, kind))
    return path


def write_ros1_bag(
    path: Path,
    columns: Columns,
    order: Sequence[int],
    names: Sequence[str] = tuple(f"fer_joint{joint}" for joint in range(1, 8)),
    gripper: str | None = None,
) -> Path:
    """A bag of ROS 1 with JointState messages, whose headers have a number ``seq`` that those of ROS 2 lack.

    With ``gripper``, the name of its joint, a second node publishes that joint on the same topic.
    """
    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/arm/joint_states", kind, typestore=store, callerid="/arm")
        if gripper is not None:
            second = writer.add_connection("/arm/joint_states", kind, typestore=store, callerid="/gripper")
        for row, time in enumerate(columns["time"]):
            signals = {name: columns[name][row, list(order)] for name in SIGNALS}
            stamp, own = divmod(round(time * 1e9), 10**9), [names[joint] for joint in order]
            content = {"header.seq": row, "header.stamp": stamp, "name": own, **signals}
            writer.write(connection, round(time * 1e9), store.serialize_ros1(message(kind, content, store), kind))
            if gripper is not None:
                content = {"header.stamp": stamp, "name": [gripper], **{name: np.zeros(1) for name in SIGNALS}}
                writer.write(second, round(time * 1e9), store.serialize_ros1(message(kind, content, store), kind))
    return path
