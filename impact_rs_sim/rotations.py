# SPDX-License-Identifier: Apache-2.0
"""Names of axes, unit vectors, rotations as quaternions, and quaternions as angles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

AXES = ("x", "y", "z")
UNIT_TOLERANCE = 1e-6  # of the length of a unit vector [-]
MAX_NORM_ERROR = 0.02  # of a measured unit quaternion; a tracker that lost its body sends zeros or NaN
_ORIGIN = np.zeros(3)


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion of a rotation matrix, ``(4,)``, x y z w.

    Computed from an SE3: ``pin.Quaternion(rotation)`` of eigenpy 3.13 leaks 80 bytes at every call.

    Args:
        rotation: ``(3, 3)``.
    """
    return np.asarray(pin.SE3ToXYZQUAT(pin.SE3(rotation, _ORIGIN))[3:])


def continuous(quaternion: Array) -> Array:
    """Quaternions with continuous signs along the rows (q and -q are one orientation), ``(m, 4)``."""
    flips = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0, -1.0, 1.0))
    return np.asarray(quaternion * np.concatenate(([1.0], flips))[: len(quaternion), None])


def yaw_of_quaternions(quaternion: Array) -> Array:
    """Rotation about z, unwrapped along time, ``(..., m)`` [rad].

    Args:
        quaternion: x y z w, ``(..., m, 4)``.
    """
    if quaternion.size == 0:
        return np.zeros(quaternion.shape[:-1])
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    return np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def is_unit(vector: Array | tuple[float, ...]) -> bool:
    """Whether a vector has length 1 up to rounding."""
    return bool(abs(np.linalg.norm(vector) - 1.0) <= UNIT_TOLERANCE)


def check_unit(name: str, vector: tuple[float, ...]) -> None:
    """Refuse a direction that is no unit vector."""
    if not is_unit(vector):
        raise ValueError(f"{name} must be a unit vector")
