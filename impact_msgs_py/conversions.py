# SPDX-License-Identifier: Apache-2.0
"""Conversions between ROS messages and NumPy.

Vectors are ``(x, y, z)``, quaternions ``(x, y, z, w)``; units and frames are those of the message.
"""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import JointState

FloatArray = NDArray[np.float64]

_NANOSECONDS = 10**9  # [ns] / [s]


def _vector(values: ArrayLike, size: int, label: str) -> list[float]:
    """Return ``values`` as a list of ``size`` floats, or raise a ``ValueError`` that says why."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{label} needs the shape ({size},), not {array.shape}")
    result: list[float] = array.tolist()
    return result


def time_to_message(seconds: float) -> Time:
    """Return the time that is nearest to ``seconds`` [s], exact to the nanosecond.

    Raises:
        ValueError: The time is not finite or outside of what the message can hold.
    """
    if not np.isfinite(seconds):
        raise ValueError(f"a time must be finite, not {seconds}")
    sec, nanosec = divmod(round(Fraction(seconds) * _NANOSECONDS), _NANOSECONDS)
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"{seconds} s is outside of the range of a ROS time")
    return Time(sec=sec, nanosec=nanosec)


def time_from_message(message: Time) -> float:
    """Return the time [s] as the nearest float.

    Together with :func:`time_to_message` this is exact for times below 2**23 s (97 days).
    """
    return (message.sec * _NANOSECONDS + message.nanosec) / _NANOSECONDS


def point_to_message(point: ArrayLike) -> Point:
    """Return the point ``(3,)`` [m] as a message."""
    x, y, z = _vector(point, 3, "a point")
    return Point(x=x, y=y, z=z)


def point_from_message(message: Point) -> FloatArray:
    """Return the point ``(3,)`` [m]."""
    return np.array([message.x, message.y, message.z])


def vector_to_message(vector: ArrayLike) -> Vector3:
    """Return the vector ``(3,)`` as a message."""
    x, y, z = _vector(vector, 3, "a vector")
    return Vector3(x=x, y=y, z=z)


def vector_from_message(message: Vector3) -> FloatArray:
    """Return the vector ``(3,)``."""
    return np.array([message.x, message.y, message.z])


def pose_to_message(pose: ArrayLike) -> Pose:
    """Return the pose ``(7,)``, position [m] and unit quaternion ``(x, y, z, w)``, as a message."""
    values = _vector(pose, 7, "a pose")
    x, y, z, w = values[3:]
    return Pose(position=point_to_message(values[:3]), orientation=Quaternion(x=x, y=y, z=z, w=w))


def pose_from_message(message: Pose) -> FloatArray:
    """Return the pose ``(7,)``: position [m], then unit quaternion ``(x, y, z, w)``."""
    p, q = message.position, message.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def twist_to_message(twist: ArrayLike) -> Twist:
    """Return the twist ``(6,)``, linear [m/s] then angular [rad/s], as a message."""
    values = _vector(twist, 6, "a twist")
    return Twist(linear=vector_to_message(values[:3]), angular=vector_to_message(values[3:]))


def twist_from_message(message: Twist) -> FloatArray:
    """Return the twist ``(6,)``: linear [m/s], then angular [rad/s]."""
    v, w = message.linear, message.angular
    return np.array([v.x, v.y, v.z, w.x, w.y, w.z])


def wrench_to_message(wrench: ArrayLike) -> Wrench:
    """Return the wrench ``(6,)``, force [N] then torque [N m], as a message."""
    values = _vector(wrench, 6, "a wrench")
    return Wrench(force=vector_to_message(values[:3]), torque=vector_to_message(values[3:]))


def wrench_from_message(message: Wrench) -> FloatArray:
    """Return the wrench ``(6,)``: force [N], then torque [N m]."""
    f, t = message.force, message.torque
    return np.array([f.x, f.y, f.z, t.x, t.y, t.z])


def joint_state_to_message(
    names: Sequence[str],
    position: ArrayLike,
    velocity: ArrayLike = (),
    effort: ArrayLike = (),
    time: float = 0.0,
) -> JointState:
    """Return joint signals as a message.

    Args:
        names: Names of the ``n`` joints.
        position: ``(n,)`` [rad], or empty if unknown.
        velocity: ``(n,)`` [rad/s], or empty if unknown.
        effort: ``(n,)`` [N m], or empty if unknown.
        time: Time of the signals [s].
    """
    message = JointState(name=list(names))
    message.header.stamp = time_to_message(time)
    for field, values in (("position", position), ("velocity", velocity), ("effort", effort)):
        size = np.size(values)
        if size:
            setattr(message, field, _vector(values, len(names), f"the {field} of {names}"))
    return message


def joint_state_from_message(
    message: JointState,
) -> tuple[list[str], FloatArray, FloatArray, FloatArray]:
    """Return names, position ``(n,)`` [rad], velocity ``(n,)`` [rad/s], effort ``(n,)`` [N m].

    Fields that the message leaves empty have the shape ``(0,)``.
    """
    return (
        list(message.name),
        np.array(message.position, dtype=np.float64),
        np.array(message.velocity, dtype=np.float64),
        np.array(message.effort, dtype=np.float64),
    )
