"""Measured, predicted and residual signals of one trial on a common clock, for figures and for aligned bags."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_analysis.evidence.runs import Condition, MeasuredTrial, Runs
from impact_rs_analysis.evidence.signals import Signals, signals_of_bag
from impact_rs_analysis.evidence.twin import observed_until, run_twin
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
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
        feedback: a_fb, ``(k, 3)`` [m/s^2].
    """

    position: Array
    velocity: Array
    torque: Array
    placement: Array
    quaternion: Array
    twist: Array
    feedback: Array


@dataclass(frozen=True)
class Track:
    """One side of an aligned trial.

    Attributes:
        arms: By arm.
        object_position: Geometric centre in A, ``(k, 3)`` [m].
        object_yaw: Rotation about z, ``(k,)`` [rad].
    """

    arms: dict[str, ArmTrack]
    object_position: Array
    object_yaw: Array


@dataclass(frozen=True)
class AlignedTrial:
    """Measurement and twin of one trial on the control ticks that both have.

    Attributes:
        condition: What was run.
        path: Bag of the measurement.
        time: Trial time, ``(k,)`` [s].
        measured: What was measured.
        predicted: What the twin does when it starts where the measurement started.
    """

    condition: Condition
    path: Path
    time: Array
    measured: Track
    predicted: Track


def align(trial: MeasuredTrial, model: Model) -> AlignedTrial:
    """Run the twin of a trial and put both on one clock."""
    plan = trial.condition.plan
    measured = signals_of_bag(TrialBag.open(trial.path))
    predicted = run_twin(plan, model.apply(plan.scene.physics), trial.start, observed_until(plan))
    time = predicted.time[predicted.time <= measured.time[-1] + 1e-9]
    return AlignedTrial(trial.condition, trial.path, time, _track(measured, plan, time), _track(predicted, plan, time))


def _align(task: tuple[MeasuredTrial, Model]) -> AlignedTrial:
    return align(*task)


def aligned_trials(runs: Runs, model: Model, map_tasks: Any) -> list[AlignedTrial]:
    """The first trial of every condition."""
    first: dict[Condition, MeasuredTrial] = {}
    for trial in runs.trials:
        first.setdefault(trial.condition, trial)
    return list(map_tasks(_align, [(trial, model) for trial in first.values()]))


def _columns(time: Array, source: Array, values: Array) -> Array:
    """Columns at ``time``; constant beyond their ends."""
    return np.stack([np.interp(time, source, column) for column in values.T], axis=-1)


def _track(signals: Signals, plan: TrialPlan, time: Array) -> Track:
    arms = {}
    for name, arm in signals.arms.items():
        q, dq = _columns(time, signals.time, arm.position), _columns(time, signals.time, arm.velocity)
        model = plan.scene.models[name]
        places = [model.placement(row) for row in q]
        feedback = _columns(time, signals.time, arm.feedback) if arm.feedback.size else np.zeros((time.size, 3))
        arms[name] = ArmTrack(
            position=q,
            velocity=dq,
            torque=_columns(time, signals.time, arm.torque),
            placement=np.array([place.translation for place in places]),
            quaternion=np.array([pin.Quaternion(place.rotation).coeffs() for place in places]),
            twist=np.array([model.jacobian(row) @ velocity for row, velocity in zip(q, dq, strict=True)]),
            feedback=feedback,
        )
    if signals.object_time.size:
        position = _columns(time, signals.object_time, signals.object_position)
        yaw = np.interp(time, signals.object_time, signals.object_yaw)
    else:
        position, yaw = np.tile(plan.scene.object.position, (time.size, 1)), np.zeros(time.size)
    return Track(arms, position, yaw)


def aligned_name(condition: Condition) -> str:
    """Folder name of the aligned bag of a condition."""
    return condition.label.replace("/", "__")


def check_free(runs: Runs, directory: Path) -> None:
    """Check that no aligned bag is in the way before any is made.

    Raises:
        InputError: One exists already.
    """
    for condition in runs.conditions:
        if (directory / aligned_name(condition)).exists():
            raise InputError("this aligned bag exists already", file=directory / aligned_name(condition))


def write_aligned(aligned: AlignedTrial, directory: Path) -> Path:
    """Write one aligned mcap: ``/measured/...``, ``/predicted/...`` and ``/residual/...`` in standard messages.

    Per arm ``joint_states`` (JointState), ``end_effector/twist`` (TwistStamped) and ``end_effector/pose``
    (PoseStamped); ``object/pose`` (PoseStamped). Residuals are measured minus predicted; that of a pose is the
    difference of positions and the rotation from the predicted to the measured orientation.

    Raises:
        InputError: It exists already or cannot be written.
    """
    path = directory / aligned_name(aligned.condition)
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


def _write(writer: Writer, aligned: AlignedTrial) -> None:
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
            feedback=a.feedback - b.feedback,
        )
    return Track(arms, measured.object_position - predicted.object_position, measured.object_yaw - predicted.object_yaw)
