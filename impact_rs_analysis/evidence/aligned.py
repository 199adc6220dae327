# SPDX-License-Identifier: Apache-2.0
"""Measured, replayed and residual signals of one run on a common clock, for figures and for aligned bags."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_analysis.evidence.runs import Runs
from impact_rs_analysis.evidence.signals import Signals
from impact_rs_analysis.evidence.store import with_effects
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.rotations import quaternion_of
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.types import typestore


@dataclass(frozen=True)
class ArmTrack:
    """Signals of one arm; columns ``(k, ...)``.

    Attributes:
        position: q, ``(k, n)`` [rad].
        velocity: dq, ``(k, n)`` [rad/s].
        torque: tau_J, ``(k, n)`` [N m].
        placement: Position of frame E, ``(k, 3)`` [m].
        quaternion: Orientation of E as x y z w, ``(k, 4)``.
        twist: Twist of E in E[A], ``(k, 6)`` [m/s, rad/s].
    """

    position: Array
    velocity: Array
    torque: Array
    placement: Array
    quaternion: Array
    twist: Array


@dataclass(frozen=True)
class Track:
    """One side of an aligned run.

    Attributes:
        arms: By arm.
        object_position: Geometric centre in A, ``(k, 3)`` [m]; NaN where not tracked.
        object_yaw: Rotation about z, ``(k,)`` [rad]; NaN where not tracked.
    """

    arms: dict[str, ArmTrack]
    object_position: Array
    object_yaw: Array


@dataclass(frozen=True)
class AlignedRun:
    """Measurement and replay of one run on the ticks of its windows.

    Attributes:
        run: The measurement.
        time: Ticks of all windows, ``(k,)`` [s].
        starts: Rows in which a window begins.
        measured: The measurement.
        predicted: The replay from the measured start of every window.
    """

    run: MeasuredRun
    time: Array
    starts: tuple[int, ...]
    measured: Track
    predicted: Track

    @property
    def impact(self) -> float | None:
        """Begin of the impact [s]; None without an impact."""
        return min(self.run.impacts.values()) if self.run.impacts else None


def align(run: MeasuredRun, model: Model, added: Added = ()) -> AlignedRun:
    """Replay a run and align it with the measurement.

    Args:
        run: The measurement.
        model: The model.
        added: Effects added to it.
    """
    setup = run.setup
    replayed = setup.replayed(with_effects(model, setup.physics, added))
    models = setup.physics.robot_models()
    sizes = [window.time.size for window in setup.windows]
    return AlignedRun(
        run=run,
        time=np.concatenate([window.time for window in setup.windows]),
        starts=tuple(np.cumsum([0, *sizes[:-1]]).tolist()),
        measured=_track(run.signals, models),
        predicted=_track(replayed, models),
    )


def _align(task: tuple[MeasuredRun, Model, Added]) -> AlignedRun:
    return align(*task)


def aligned_runs(runs: Runs, model: Model, map_tasks: Any, added: Added = ()) -> list[AlignedRun]:
    """The first run of every condition."""
    return list(map_tasks(_align, [(group[0], model, added) for group in runs.conditions.values()]))


def _track(windows: tuple[Signals, ...] | list[Signals], models: dict[str, RobotModel]) -> Track:
    arms = {}
    for name, model in models.items():
        q, dq, torque = (
            np.concatenate([getattr(window.arms[name], key) for window in windows])
            for key in ("position", "velocity", "torque")
        )
        places = [model.placement(row) for row in q]
        arms[name] = ArmTrack(
            position=q,
            velocity=dq,
            torque=torque,
            placement=np.array([place.translation for place in places]),
            quaternion=np.array([quaternion_of(place.rotation) for place in places]),
            twist=np.array([model.jacobian(row) @ velocity for row, velocity in zip(q, dq, strict=True)]),
        )
    poses = [_object(window) for window in windows]
    return Track(arms, np.concatenate([pose for pose, _ in poses]), np.concatenate([yaw for _, yaw in poses]))


def _object(window: Signals) -> tuple[Array, Array]:
    """Position and yaw of the object at the ticks of a window; NaN where it is not tracked."""
    if window.object_time.size < 2:
        return np.full((window.time.size, 3), np.nan), np.full(window.time.size, np.nan)
    columns = [np.interp(window.time, window.object_time, column) for column in window.object_position.T]
    return np.column_stack(columns), np.interp(window.time, window.object_time, window.object_yaw)


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


def write_aligned(aligned: AlignedRun, directory: Path) -> Path:
    """Write one aligned mcap: ``/measured/...``, ``/predicted/...`` and ``/residual/...`` in standard messages.

    Per arm ``joint_states`` (JointState), ``end_effector/twist`` (TwistStamped) and ``end_effector/pose``
    (PoseStamped); ``object/pose`` (PoseStamped). Residuals are measured minus predicted; that of a pose is the
    difference of positions and the rotation from the predicted to the measured orientation.

    Raises:
        InputError: It exists already or cannot be written.
    """
    path = directory / aligned_name(aligned.run.condition)
    if path.exists():
        raise InputError("this aligned bag exists already", file=path)
    hidden = directory / f".{path.name}"
    shutil.rmtree(hidden, ignore_errors=True)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        writer = Writer(hidden, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        try:
            _write(writer, aligned)
        finally:
            writer.close()
        hidden.rename(path)
    except OSError as error:
        shutil.rmtree(hidden, ignore_errors=True)
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    return path


def _write(writer: Writer, aligned: AlignedRun) -> None:
    store = typestore()
    types = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    quaternion, pose = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Pose"]
    twist = types["geometry_msgs/msg/Twist"]
    sides = {
        "measured": aligned.measured,
        "predicted": aligned.predicted,
        "residual": _residual(aligned.measured, aligned.predicted),
    }
    rows: list[tuple[int, str, Any, str]] = []

    def pose_of(head: Any, position: Array, turned: Array) -> Any:
        x, y, z = position.tolist()
        return types[topics.POSE](
            header=head, pose=pose(position=point(x, y, z), orientation=quaternion(*turned.tolist()))
        )

    for side, track in sides.items():
        for k, moment in enumerate(aligned.time):
            nanoseconds = round(float(moment) * 1e9)
            head = header(stamp=stamp(*divmod(nanoseconds, 1_000_000_000)), frame_id="world")
            for name, arm in track.arms.items():
                message = types[topics.JOINT_STATE](
                    header=head,
                    name=[f"joint{index + 1}" for index in range(arm.position.shape[1])],
                    position=arm.position[k],
                    velocity=arm.velocity[k],
                    effort=arm.torque[k],
                )
                rows.append((nanoseconds, f"/{side}/{name}/joint_states", message, topics.JOINT_STATE))
                values = arm.twist[k].tolist()
                moving = types[topics.TWIST](
                    header=head, twist=twist(linear=vector(*values[:3]), angular=vector(*values[3:]))
                )
                rows.append((nanoseconds, f"/{side}/{name}/end_effector/twist", moving, topics.TWIST))
                placed = pose_of(head, arm.placement[k], arm.quaternion[k])
                rows.append((nanoseconds, f"/{side}/{name}/end_effector/pose", placed, topics.POSE))
            if not np.isfinite(track.object_yaw[k]):
                continue
            half = 0.5 * track.object_yaw[k]
            turned = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
            message = pose_of(head, track.object_position[k], turned)
            rows.append((nanoseconds, f"/{side}/object/pose", message, topics.POSE))
    connections: dict[str, Any] = {}
    for nanoseconds, topic, message, kind in sorted(rows, key=lambda row: row[0]):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(connections[topic], nanoseconds, store.serialize_cdr(message, kind))


def _residual(measured: Track, predicted: Track) -> Track:
    """Measured minus predicted."""
    arms = {}
    for name, a in measured.arms.items():
        b = predicted.arms[name]
        turned = [
            (pin.Quaternion(p).conjugate() * pin.Quaternion(m)).coeffs()
            for m, p in zip(a.quaternion, b.quaternion, strict=True)
        ]
        arms[name] = ArmTrack(
            position=a.position - b.position,
            velocity=a.velocity - b.velocity,
            torque=a.torque - b.torque,
            placement=a.placement - b.placement,
            quaternion=np.array(turned),
            twist=a.twist - b.twist,
        )
    return Track(arms, measured.object_position - predicted.object_position, measured.object_yaw - predicted.object_yaw)
