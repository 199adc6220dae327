# SPDX-License-Identifier: Apache-2.0
"""Faults of readings: effects of a wrong calibration, filter or clock on recorded signals, and on a folder of bags.

Every fault is a function of recorded signals; it changes neither physics nor control, and is independent of the sensor
models of the library. Filters are those of :mod:`scipy.signal`, a delay moves stamps, and a driver's own velocity is a
difference of recorded positions.

``FAULTS`` lists all of them with their sizes and the diagnosis to expect. Parameters are differences from the value at
which an effect does nothing: a gain of 0.93 and a relative error of -0.07 are equal.
"""

from __future__ import annotations

import csv
import math
import re
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags.types import typestore

STORE = typestore()
JOINT_STATES, POSES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
SIGNALS = ("position", "velocity", "effort")
BEGIN, BETWEEN = 1_763_500_000 * 10**9, 120 * 10**9  # ns: of the first run on the wall clock, and from run to run


@dataclass(frozen=True)
class Readings:
    """Sensor readings of one run.

    Attributes:
        time: Stamps of the joints, ``(k,)`` [s].
        position: ``(k, n)`` [rad]; joints in the order of their names, as in the next two.
        velocity: ``(k, n)`` [rad/s].
        torque: ``(k, n)`` [N m].
        object_time: Stamps of the object's pose, ``(m,)`` [s]; empty where it was not tracked.
        object_position: ``(m, 3)`` [m], in the base of the robot.
        object_rotation: ``(m, 4)``, quaternion x, y, z, w, from axes of the object to axes of the base.
        share: Elapsed share of the campaign: 0 in the first run, 1 in the last [-].
    """

    time: Array
    position: Array
    velocity: Array
    torque: Array
    object_time: Array
    object_position: Array
    object_rotation: Array
    share: float = 0.0


@dataclass(frozen=True)
class Drawn:
    """One fault of a campaign.

    Attributes:
        size: In the unit of the fault.
        joint: Joint that has it, counted from 0.
        sign: 1 or -1.
        angle: Of its direction in the horizontal plane [rad].
        seconds: From the first run of the campaign to the last [s].
    """

    size: float
    joint: int
    sign: float
    angle: float
    seconds: float = 0.0

    @property
    def value(self) -> float:
        """Size with its sign."""
        return self.sign * self.size

    def at(self, name: str, joint: int | None = None) -> str:
        """Name of the parameter of a joint, that which has the fault."""
        return f"{name}_joint{(self.joint if joint is None else joint) + 1}"


Truths = Mapping[str, Mapping[str, float]]  # by effect: differences from nominal by parameter, SI; empty: not known


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes:
        name: Name.
        unit: Unit of its sizes.
        sizes: The two that are tried, the clear one last.
        rewrite: Applies the fault to readings.
        truths: Effects that describe it, its own effect first, with their true parameters; empty: no effect does.
        joints: Joints that may have it, counted from 0; without those in which it hardly shows.
    """

    name: str
    unit: str
    sizes: tuple[float, ...]
    rewrite: Callable[[Readings, Drawn], Readings]
    truths: Callable[[Drawn], Truths]
    joints: tuple[int, ...] = (1, 2, 3, 4, 5)

    def drawn(self, size: float, seed: int, seconds: float = 0.0) -> Drawn:
        """Draw joint, sign and direction by a seed and the size."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), round(1000.0 * size)])
        joint, sign = int(rng.choice(self.joints)), float(rng.choice((-1.0, 1.0)))
        return Drawn(size, joint, sign, float(rng.uniform(-np.pi, np.pi)), seconds)


def _with_column(values: Array, joint: int, column: Array) -> Array:
    """A copy in which the column of a joint is replaced."""
    changed = values.copy()
    changed[:, joint] = column
    return changed


def untouched(run: Readings, drawn: Drawn) -> Readings:
    """Nothing is wrong."""
    del drawn
    return run


def quantised(run: Readings, drawn: Drawn) -> Readings:
    """Coarse converters; size 1: 2^16 counts a turn, 0.005 rad/s, 0.05 N m, 0.1 mm, and multiples of these steps."""

    def rounded(values: Array, step: float) -> Array:
        return np.round(values / (drawn.size * step)) * drawn.size * step

    return replace(
        run,
        position=rounded(run.position, 2.0 * np.pi / 2**16),
        velocity=rounded(run.velocity, 0.005),
        torque=rounded(run.torque, 0.05),
        object_position=rounded(run.object_position, 1e-4),
    )


def encoder_offset(run: Readings, drawn: Drawn) -> Readings:
    """The zero of an encoder is off; size in degrees."""
    shifted = run.position[:, drawn.joint] + np.radians(drawn.value)
    return replace(run, position=_with_column(run.position, drawn.joint, shifted))


def encoder_scale(run: Readings, drawn: Drawn) -> Readings:
    """A wrong gear ratio: position and the velocity that the driver takes from it; size in percent."""
    factor = 1.0 + drawn.value / 100.0
    return replace(
        run,
        position=_with_column(run.position, drawn.joint, factor * run.position[:, drawn.joint]),
        velocity=_with_column(run.velocity, drawn.joint, factor * run.velocity[:, drawn.joint]),
    )


def torque_gain(run: Readings, drawn: Drawn) -> Readings:
    """A torque sensor shows too much or too little; size in percent."""
    scaled = (1.0 + drawn.value / 100.0) * run.torque[:, drawn.joint]
    return replace(run, torque=_with_column(run.torque, drawn.joint, scaled))


def torque_offset(run: Readings, drawn: Drawn) -> Readings:
    """A torque sensor does not show 0 at rest; size in N m."""
    return replace(run, torque=_with_column(run.torque, drawn.joint, run.torque[:, drawn.joint] + drawn.value))


def torque_crosstalk(run: Readings, drawn: Drawn) -> Readings:
    """Each of two neighbouring torque sensors shows a share of the other joint's torque; size in percent."""
    joint, neighbour, share = drawn.joint, drawn.joint + 1, drawn.value / 100.0
    mixed = run.torque.copy()
    mixed[:, joint] += share * run.torque[:, neighbour]
    mixed[:, neighbour] += share * run.torque[:, joint]
    return replace(run, torque=mixed)


def torque_drift(run: Readings, drawn: Drawn) -> Readings:
    """A torque sensor that was set to zero before the first run drifts evenly; size in N m until the last run."""
    drifted = run.torque[:, drawn.joint] + drawn.value * run.share
    return replace(run, torque=_with_column(run.torque, drawn.joint, drifted))


def low_passed(time: Array, values: Array, cutoff: float, order: int) -> Array:
    """Butterworth low-pass; order 1 is an RC filter. It starts in the steady state of the first value.

    Args:
        time: Stamps, ``(k,)`` [s].
        values: ``(k, n)``.
        cutoff: Frequency of 3 dB [Hz].
        order: Of the filter.
    """
    b, a = butter(order, cutoff, fs=1.0 / float(np.median(np.diff(time))))
    filtered, _ = lfilter(b, a, values, axis=0, zi=np.multiply.outer(lfilter_zi(b, a), values[0]))
    return np.asarray(filtered)


def torque_low_pass(run: Readings, drawn: Drawn) -> Readings:
    """RC filter on all torques; size: its cutoff in Hz."""
    return replace(run, torque=low_passed(run.time, run.torque, drawn.size, 1))


def torque_butterworth(run: Readings, drawn: Drawn) -> Readings:
    """Butterworth filter of second order on all torques; size: its cutoff in Hz."""
    return replace(run, torque=low_passed(run.time, run.torque, drawn.size, 2))


def velocity_low_pass(run: Readings, drawn: Drawn) -> Readings:
    """RC filter on all velocities; size: its cutoff in Hz."""
    return replace(run, velocity=low_passed(run.time, run.velocity, drawn.size, 1))


def velocity_butterworth(run: Readings, drawn: Drawn) -> Readings:
    """Butterworth filter of second order on all velocities; size: its cutoff in Hz."""
    return replace(run, velocity=low_passed(run.time, run.velocity, drawn.size, 2))


def own_difference(run: Readings, drawn: Drawn) -> Readings:
    """Velocity as difference of the positions over the last samples; size: how many. The first ones repeat."""
    n = round(drawn.size)
    slopes = (run.position[n:] - run.position[:-n]) / (run.time[n:] - run.time[:-n])[:, None]
    return replace(run, velocity=np.concatenate((np.repeat(slopes[:1], n, axis=0), slopes)))


def velocity_gain(run: Readings, drawn: Drawn) -> Readings:
    """The velocity of a joint is shown too large or too small; size in percent."""
    scaled = (1.0 + drawn.value / 100.0) * run.velocity[:, drawn.joint]
    return replace(run, velocity=_with_column(run.velocity, drawn.joint, scaled))


def tracker_turned(run: Readings, drawn: Drawn) -> Readings:
    """Poses are turned about z of the robot's base, for the motion capture has other axes; size in degrees."""
    rotation = Rotation.from_euler("z", drawn.value, degrees=True)
    quaternions = (rotation * Rotation.from_quat(run.object_rotation)).as_quat()
    return replace(run, object_position=rotation.apply(run.object_position), object_rotation=quaternions)


def tracker_shifted(run: Readings, drawn: Drawn) -> Readings:
    """Poses are shifted, for the motion capture has another origin; size in mm."""
    return replace(run, object_position=run.object_position + _across(drawn))


def tracked_point(run: Readings, drawn: Drawn) -> Readings:
    """A point of the object beside its centre is tracked, the same of all objects, in their axes; size in mm."""
    offset = Rotation.from_quat(run.object_rotation).apply(_across(drawn))
    return replace(run, object_position=run.object_position + offset)


def tracker_late(run: Readings, drawn: Drawn) -> Readings:
    """Poses have stamps of when they were ready; size in ms."""
    return replace(run, object_time=run.object_time + drawn.size / 1000.0)


def tracker_low_pass(run: Readings, drawn: Drawn) -> Readings:
    """RC filter on the pose of the object; size: its cutoff in Hz."""
    if not run.object_time.size:
        return run
    first = Rotation.from_quat(run.object_rotation[0])
    rotation_vectors = (
        first.inv() * Rotation.from_quat(run.object_rotation)
    ).as_rotvec()  # a box turns far less than pi
    filtered = first * Rotation.from_rotvec(low_passed(run.object_time, rotation_vectors, drawn.size, 1))
    positions = low_passed(run.object_time, run.object_position, drawn.size, 1)
    return replace(run, object_position=positions, object_rotation=filtered.as_quat())


def _across(drawn: Drawn) -> Array:
    """A horizontal shift of so many mm [m]."""
    return drawn.size / 1000.0 * np.array([math.cos(drawn.angle), math.sin(drawn.angle), 0.0])


def _horizontal(drawn: Drawn) -> dict[str, float]:
    x, y, _ = _across(drawn)
    return {"x": float(x), "y": float(y)}


def _rc(drawn: Drawn) -> float:
    """Time constant of an RC filter [s]."""
    return 1.0 / (2.0 * math.pi * drawn.size)


def _delay(drawn: Drawn) -> float:
    """Delay of a Butterworth filter of second order at low frequencies [s]."""
    return math.sqrt(2.0) * _rc(drawn)


def _crosstalk(drawn: Drawn) -> Truths:
    share = drawn.value / 100.0
    of_both = {drawn.at("from_next"): share, drawn.at("from_previous", drawn.joint + 1): share}
    return {"torque_sensor_crosstalk": of_both}


FAULTS = {
    fault.name: fault
    for fault in (
        Fault("none", "", (0.0,), untouched, lambda _: {}),
        Fault("quantised", "steps", (1.0, 2.0), quantised, lambda _: {}),
        Fault(
            "encoder_offset", "deg", (0.5, 1.0), encoder_offset,
            lambda drawn: {"encoder_offset": {drawn.at("offset"): math.radians(drawn.value)}},
        ),
        Fault(
            "encoder_scale", "%", (0.3, 1.0), encoder_scale,
            lambda drawn: {"encoder_scale": {drawn.at("scale"): drawn.value / 100.0}}, (2, 3, 4, 5),
        ),
        Fault(
            "torque_gain", "%", (3.0, 7.0), torque_gain,
            lambda drawn: {"torque_sensor_gain": {drawn.at("gain"): drawn.value / 100.0}}, (1, 2, 3),
        ),
        Fault(
            "torque_offset", "N m", (0.3, 1.0), torque_offset,
            lambda drawn: {"torque_sensor_offset": {drawn.at("offset"): drawn.value}}, tuple(range(7)),
        ),
        Fault("torque_crosstalk", "%", (2.0, 5.0), torque_crosstalk, _crosstalk, (0, 1, 2, 3)),
        Fault(
            "torque_low_pass", "Hz", (20.0, 8.0), torque_low_pass,
            lambda drawn: {
                "torque_sensor_lag": {"lag": _rc(drawn)}, "torque_sensor_butterworth": {}, "torque_delay": {},
            },
        ),
        Fault(
            "torque_butterworth", "Hz", (20.0, 8.0), torque_butterworth,
            lambda drawn: {
                "torque_sensor_butterworth": {"lag": _delay(drawn)}, "torque_sensor_lag": {}, "torque_delay": {},
            },
        ),
        Fault(
            "torque_drift", "N m", (0.15, 0.35), torque_drift,
            lambda drawn: {"torque_sensor_drift": {drawn.at("rate"): drawn.value / drawn.seconds}}, tuple(range(7)),
        ),
        Fault(
            "velocity_low_pass", "Hz", (25.0, 12.0), velocity_low_pass,
            lambda drawn: {"velocity_lag": {"lag": _rc(drawn)}, "velocity_butterworth": {}, "velocity_delay": {}},
        ),
        Fault(
            "velocity_butterworth", "Hz", (25.0, 12.0), velocity_butterworth,
            lambda drawn: {"velocity_butterworth": {"lag": _delay(drawn)}, "velocity_lag": {}, "velocity_delay": {}},
        ),
        Fault(
            "velocity_difference", "samples", (10.0, 25.0), own_difference,
            lambda drawn: {
                "velocity_delay": {"delay": 0.5e-3 * drawn.size}, "velocity_butterworth": {}, "velocity_lag": {},
            },
        ),
        Fault(
            "velocity_gain", "%", (1.0, 3.0), velocity_gain,
            lambda drawn: {"velocity_gain": {drawn.at("gain"): drawn.value / 100.0}},
        ),
        Fault(
            "tracker_turned", "deg", (0.8, 1.6), tracker_turned,
            lambda drawn: {"tracker_frame": {"x": 0.0, "y": 0.0, "yaw": math.radians(drawn.value)}},
        ),
        Fault(
            "tracker_shifted", "mm", (4.0, 8.0), tracker_shifted,
            lambda drawn: {"tracker_frame": _horizontal(drawn) | {"yaw": 0.0}},
        ),
        Fault(
            "tracked_point", "mm", (5.0, 15.0), tracked_point,
            lambda drawn: {"tracked_point": _horizontal(drawn)},
        ),
        Fault(
            "tracker_late", "ms", (8.0, 18.0), tracker_late,
            lambda drawn: {
                "tracker_delay": {"delay": drawn.size / 1000.0}, "tracker_butterworth": {}, "tracker_lag": {},
            },
        ),
        Fault(
            "tracker_low_pass", "Hz", (20.0, 8.0), tracker_low_pass,
            lambda drawn: {"tracker_lag": {"lag": _rc(drawn)}, "tracker_butterworth": {}, "tracker_delay": {}},
        ),
    )
}  # fmt: skip


@dataclass
class _Row:
    """One message of a bag: connection, log time [ns], bytes, and the decoded message if it holds readings."""

    connection: Any
    log: int
    raw: bytes
    message: Any

    @property
    def stamp(self) -> int:
        """Stamp of the message [ns]."""
        stamp = self.message.header.stamp
        return int(stamp.sec) * 10**9 + int(stamp.nanosec)

    def later(self, by: int, stamped: int = 0) -> None:
        """Move the message in time, its stamp as well where it has one [ns]."""
        self.log += by + stamped
        if self.message is not None:
            stamp = self.message.header.stamp
            stamp.sec, stamp.nanosec = divmod(self.stamp + by + stamped, 10**9)
            self.raw = bytes(STORE.serialize_cdr(self.message, self.connection.msgtype))


def rewrite_bag(source: Path, target: Path, change: Callable[[Readings], Readings], share: float, begin: int) -> None:
    """Write the bag of a run of one arm with other readings; commands stay.

    Args:
        source: Bag of joint states, commands and poses.
        target: New folder.
        change: What becomes of the readings.
        share: Of the campaign that had passed [-].
        begin: When the run begins on the wall clock [ns].
    """
    with Reader(source) as bag:
        shift = begin - bag.start_time
        rows = [
            _Row(
                connection,
                log,
                raw,
                STORE.deserialize_cdr(raw, connection.msgtype) if connection.msgtype in (JOINT_STATES, POSES) else None,
            )
            for connection, log, raw in bag.messages()
        ]
    joints, poses = ([row for row in rows if row.connection.msgtype == kind] for kind in (JOINT_STATES, POSES))
    before = _read(joints, poses, share)
    after = change(before)
    _put(joints, poses, after)
    extra_delay = {
        id(row): round(1e9 * seconds)
        for row, seconds in zip(poses, after.object_time - before.object_time, strict=True)
    }
    for row in rows:
        row.later(shift, extra_delay.get(id(row), 0))
    with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics: dict[str, Any] = {}
        for row in sorted(rows, key=lambda row: row.log):
            connection = row.connection
            if connection.topic not in topics:
                topics[connection.topic] = bag.add_connection(connection.topic, connection.msgtype, typestore=STORE)
            bag.write(topics[connection.topic], row.log, row.raw)


def _order(names: Sequence[str]) -> list[int]:
    """Indices of joints in the natural order of their names: joint 9 comes before joint 10."""
    return sorted(range(len(names)), key=lambda index: [int(n) for n in re.findall(r"\d+", names[index])])


def _read(joints: Sequence[_Row], poses: Sequence[_Row], share: float) -> Readings:
    """Readings in messages; times are relative to the first stamp of the joints."""
    origin, order = joints[0].stamp, _order(joints[0].message.name)  # seconds since 1970 have no room for nanoseconds
    time, pose_time = (np.array([row.stamp - origin for row in rows]) / 1e9 for rows in (joints, poses))
    position, velocity, torque = (
        np.array([getattr(row.message, name) for row in joints])[:, order] for name in SIGNALS
    )
    pose_messages = [row.message.pose for row in poses]
    positions = np.array([(pose.position.x, pose.position.y, pose.position.z) for pose in pose_messages]).reshape(-1, 3)
    quaternions = [
        (pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w) for pose in pose_messages
    ]
    return Readings(time, position, velocity, torque, pose_time, positions, np.array(quaternions).reshape(-1, 4), share)


def _put(joints: Sequence[_Row], poses: Sequence[_Row], readings: Readings) -> None:
    """Write readings into their messages, but for their times."""
    inverse_order = np.argsort(_order(joints[0].message.name))
    for name, values in zip(SIGNALS, (readings.position, readings.velocity, readings.torque), strict=True):
        for row, numbers in zip(joints, np.ascontiguousarray(values[:, inverse_order]), strict=True):
            setattr(row.message, name, numbers)
    for row, position, quaternion in zip(poses, readings.object_position, readings.object_rotation, strict=True):
        pose = row.message.pose
        pose.position.x, pose.position.y, pose.position.z = map(float, position)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, quaternion)


def seconds_of(folder: Path) -> float:
    """From the first run of a rewritten campaign to the last [s]."""
    return (len(_bags(folder)) - 1) * BETWEEN / 1e9


def _bags(folder: Path) -> list[str]:
    """Bags of a campaign, in the order of its table."""
    with (folder / "runs.csv").open(newline="", encoding="utf-8") as file:
        return [row["bag"] for row in csv.DictReader(file)]


def rewrite_campaign(source: Path, target: Path, fault: Fault, drawn: Drawn) -> None:
    """Write the folder of a campaign whose readings have a fault; every two minutes a run begins.

    Args:
        source: Folder of bags with ``runs.csv`` and ``experiment.yaml``; it stays.
        target: Folder; an earlier one is replaced.
        fault: The fault.
        drawn: Its size, joint and direction.
    """
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    names = _bags(source)
    for number, name in enumerate(names):
        rewrite_bag(
            source / name, target / name, lambda run: fault.rewrite(run, drawn),
            number / max(len(names) - 1, 1), BEGIN + number * BETWEEN,
        )  # fmt: skip
    for name in ("runs.csv", "experiment.yaml"):
        shutil.copyfile(source / name, target / name)
