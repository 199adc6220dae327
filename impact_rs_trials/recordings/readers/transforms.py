# SPDX-License-Identifier: Apache-2.0
"""Poses as homogeneous matrices: samples x 4 x 4, or 4 x 4 x samples as in MATLAB and HDF5."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

MATRIX_ROWS = 4  # of a homogeneous transform
LAST_ROW = (0.0, 0.0, 0.0, 1.0)
MAX_ORTHONORMAL_ERROR = 0.02  # of rows of a rotation, in length and right angles


def are_transforms(shape: tuple[int, ...]) -> bool:
    """Whether an array of a shape may hold homogeneous matrices."""
    return len(shape) == 3 and (shape[1:] == (MATRIX_ROWS, MATRIX_ROWS) or shape[:2] == (MATRIX_ROWS, MATRIX_ROWS))


def poses_of(transforms: Array) -> Array | None:
    """Positions and unit quaternions x y z w, ``(k, 7)``, in the unit of the matrices; None: not rigid motions.

    Samples that are not finite were not tracked, and stay so.

    Args:
        transforms: ``(k, 4, 4)`` or ``(4, 4, k)``, matrices or their transposes.
    """
    matrices = transforms if transforms.shape[1:] == (MATRIX_ROWS, MATRIX_ROWS) else np.moveaxis(transforms, 2, 0)
    seen = np.isfinite(matrices).all(axis=(1, 2))
    for own in (matrices, np.swapaxes(matrices, 1, 2)):
        turns = own[seen, :3, :3]
        straight = np.allclose(turns @ np.swapaxes(turns, 1, 2), np.eye(3), atol=MAX_ORTHONORMAL_ERROR)
        if seen.any() and np.allclose(own[seen, 3], LAST_ROW) and straight and np.all(np.linalg.det(turns) > 0.0):
            poses = np.full((len(own), 7), np.nan)
            poses[seen, :3] = own[seen, :3, 3]
            quaternions = [pin.Quaternion(turn).normalized().coeffs() for turn in turns]
            poses[seen, 3:] = np.array(quaternions)
            return poses
    return None
