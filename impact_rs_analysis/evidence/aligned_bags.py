# SPDX-License-Identifier: Apache-2.0
"""Aligned bags: measured, predicted and residual signals of one run on a common clock, for Foxglove and PlotJuggler."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.tracks import ArmTrack, Track, TrackSide
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.types import typestore


def aligned_name(condition: str) -> str:
    """Folder name of the aligned bag of a condition."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", condition.replace("/", "__"))


def check_free(runs: Runs, directory: Path) -> None:
    """Check that no aligned bag exists, before any is written.

    Raises:
        InputError: One exists already.
    """
    for condition in runs.conditions:
        if (directory / aligned_name(condition)).exists():
            raise InputError("this aligned bag exists already", file=directory / aligned_name(condition))


def write_aligned(track: Track, condition: str, directory: Path) -> Path:
    """Write one aligned mcap: ``/measured/...``, ``/predicted/...`` and ``/residual/...`` in standard messages.

    Per arm ``joint_states`` (JointState), ``end_effector/twist`` (TwistStamped) and ``end_effector/pose``
    (PoseStamped); ``object/pose`` (PoseStamped). Residuals are measured minus predicted; the residual of a pose is the
    difference of positions and the rotation from the predicted to the measured orientation. In windows before the
    impact the object has the median of its last tracked poses, on both sides.

    Args:
        track: A run and its replay.
        condition: Its condition, which names the bag.
        directory: Folder of the bag.

    Raises:
        InputError: It exists already or cannot be written.
    """
    path = directory / aligned_name(condition)
    if path.exists():
        raise InputError("this aligned bag exists already", file=path)
    hidden = directory / f".{path.name}"
    shutil.rmtree(hidden, ignore_errors=True)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        writer = Writer(hidden, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        try:
            _write(writer, track)
        finally:
            writer.close()
        hidden.rename(path)
    except OSError as error:
        shutil.rmtree(hidden, ignore_errors=True)
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    return path


def _write(writer: Writer, track: Track) -> None:
    assert track.measured is not None and track.predicted is not None
    store = typestore()
    types = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    quaternion, pose = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Pose"]
    twist = types["geometry_msgs/msg/Twist"]
    sides = {
        "measured": track.measured,
        "predicted": track.predicted,
        "residual": _residual(track.measured, track.predicted),
    }
    rows: list[tuple[int, str, Any, str]] = []

    def pose_of(head: Any, row: Array) -> Any:
        x, y, z, *turned = row.tolist()
        return types[topics.POSE](header=head, pose=pose(position=point(x, y, z), orientation=quaternion(*turned)))

    for side_name, side in sides.items():
        for k, moment in enumerate(track.time):
            nanoseconds = round(float(moment) * 1e9)
            head = header(stamp=stamp(*divmod(nanoseconds, 1_000_000_000)), frame_id="world")
            for name, arm in side.arms.items():
                message = types[topics.JOINT_STATE](
                    header=head,
                    name=[f"joint{index + 1}" for index in range(arm.position.shape[1])],
                    position=arm.position[k],
                    velocity=arm.velocity[k],
                    effort=arm.torque[k],
                )
                rows.append((nanoseconds, f"/{side_name}/{name}/joint_states", message, topics.JOINT_STATE))
                values = arm.twist[k].tolist()
                moving = types[topics.TWIST](
                    header=head, twist=twist(linear=vector(*values[:3]), angular=vector(*values[3:]))
                )
                rows.append((nanoseconds, f"/{side_name}/{name}/end_effector/twist", moving, topics.TWIST))
                placed = pose_of(head, arm.pose[k])
                rows.append((nanoseconds, f"/{side_name}/{name}/end_effector/pose", placed, topics.POSE))
            for name, poses in side.poses.items():
                if np.isfinite(poses[k]).all():
                    rows.append((nanoseconds, f"/{side_name}/{name}/pose", pose_of(head, poses[k]), topics.POSE))
    connections: dict[str, Any] = {}
    for nanoseconds, topic, message, kind in sorted(rows, key=lambda row: row[0]):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(connections[topic], nanoseconds, store.serialize_cdr(message, kind))


def _residual(measured: TrackSide, predicted: TrackSide) -> TrackSide:
    """Measured minus predicted."""
    arms = {}
    for name, a in measured.arms.items():
        b = predicted.arms[name]
        arms[name] = ArmTrack(
            position=a.position - b.position,
            velocity=a.velocity - b.velocity,
            torque=a.torque - b.torque,
            pose=_pose_difference(a.pose, b.pose),
            twist=a.twist - b.twist,
        )
    neighbours = {
        name: _pose_difference(pose, predicted.neighbours[name]) for name, pose in measured.neighbours.items()
    }
    return TrackSide(arms, _pose_difference(measured.object, predicted.object), neighbours=neighbours)


def _pose_difference(measured: Array, predicted: Array) -> Array:
    """Difference of positions, and the rotation from the predicted to the measured orientation, ``(k, 7)``."""
    turned = [
        (pin.Quaternion(p).conjugate() * pin.Quaternion(m)).coeffs()
        for m, p in zip(measured[:, 3:], predicted[:, 3:], strict=True)
    ]
    return np.column_stack((measured[:, :3] - predicted[:, :3], np.array(turned)))
