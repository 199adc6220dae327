# SPDX-License-Identifier: Apache-2.0
"""Poses as homogeneous matrices: samples x 4 x 4, or 4 x 4 x samples as in MATLAB and HDF5."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

MATRIX_ROWS = 4  # of a homogeneous transform
LAST_ROW = (0.0, 0.0, 0.0, 1.0)
MAX_ORTHONORMAL_ERROR = 0.02  # largest entry of R R^T - 1


def are_transforms(shape: tuple[int, ...]) -> bool:
    """Whether an array of a shape may hold homogeneous matrices."""
    return len(shape) == 3 and (shape[1:] == (MATRIX_ROWS, MATRIX_ROWS) or shape[:2] == (MATRIX_ROWS, MATRIX_ROWS))


def poses_of(transforms: Array) -> Array | None:
    """Positions and unit quaternions x y z w, ``(k, 7)``, in the unit of the matrices; None: not rigid motions.

    Samples that are not finite were not tracked; their poses are nan.

    Args:
        transforms: Matrices or their transposes, ``(k, 4, 4)`` or ``(4, 4, k)``.
    """
    matrices = transforms if transforms.shape[1:] == (MATRIX_ROWS, MATRIX_ROWS) else np.moveaxis(transforms, 2, 0)
    tracked = np.isfinite(matrices).all(axis=(1, 2))
    for candidates in (matrices, np.swapaxes(matrices, 1, 2)):
        rotations = candidates[tracked, :3, :3]
        orthonormal = np.allclose(rotations @ np.swapaxes(rotations, 1, 2), np.eye(3), atol=MAX_ORTHONORMAL_ERROR)
        if (
            tracked.any()
            and np.allclose(candidates[tracked, 3], LAST_ROW)
            and orthonormal
            and np.all(np.linalg.det(rotations) > 0.0)
        ):
            poses = np.full((len(candidates), 7), np.nan)
            poses[tracked, :3] = candidates[tracked, :3, 3]
            quaternions = [pin.Quaternion(rotation).normalized().coeffs() for rotation in rotations]
            poses[tracked, 3:] = np.array(quaternions)
            return poses
    return None
