# SPDX-License-Identifier: Apache-2.0
"""Rotations as quaternions."""

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
