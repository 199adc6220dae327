# SPDX-License-Identifier: Apache-2.0
"""Rotations as quaternions, and quaternions as angles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim.robot import Array

_ORIGIN = np.zeros(3)


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion of a rotation matrix, ``(4,)``, x y z w.

    By way of a placement: ``pin.Quaternion(rotation)`` of eigenpy 3.13 keeps 80 bytes for ever, at every call.

    Args:
        rotation: ``(3, 3)``.
    """
    return np.asarray(pin.SE3ToXYZQUAT(pin.SE3(rotation, _ORIGIN))[3:])


def yaw_of_quaternions(quaternion: Array) -> Array:
    """Rotation about z, unwrapped, ``(m,)`` [rad].

    Args:
        quaternion: x y z w, ``(m, 4)``.
    """
    if quaternion.size == 0:
        return np.zeros(0)
    x, y, z, w = quaternion.T
    return np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
