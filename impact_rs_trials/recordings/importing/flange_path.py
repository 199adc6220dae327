# SPDX-License-Identifier: Apache-2.0
"""Path of the flange of a robot, to distinguish the pose of its tool from the pose of an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.relations import evenly

MAX_SAMPLES = 400
MIN_TRAVEL_M = 0.02  # rms, of a point whose motion is compared
MAX_RMS_RATIO = 0.02  # of residual over travel, for a point fixed on the flange: kinematics are known to some mm
MAX_RMS_RATIO_OF_TARGET = 0.3  # for the target of a tool, which the tool follows with an error


@dataclass(frozen=True)
class FlangePath:
    """Placements of the flange, by the forward kinematics of recorded joint positions.

    Attributes:
        time: Timestamps, ``(k,)`` [s].
        position: In the base of the robot, ``(k, 3)`` [m].
        rotation: In the base of the robot, ``(k, 3, 3)``.
    """

    time: Array
    position: Array
    rotation: Array

    @classmethod
    def of(cls, time: Array, q: Array, model: RobotModel) -> FlangePath:
        """The path at joint positions ``(k, n)`` [rad, m]."""
        rows = evenly(time.size, MAX_SAMPLES)
        placements = [model.placement(configuration) for configuration in q[rows]]
        return cls(
            time[rows],
            np.array([placement.translation for placement in placements]),
            np.array([placement.rotation for placement in placements]),
        )

    def carries(self, path: Array, max_rms_ratio: float = MAX_RMS_RATIO) -> tuple[float, float] | None:
        """Distance from the flange and rms residual [m] of a point that is fixed on it; None: the point is not.

        Least squares of p = x + R c + b over the position c on the flange and the origin b of the frame in which p was
        measured, in the axes of the base of the robot.

        Args:
            path: Path of the point at the same times, ``(k, 3)`` [m].
            max_rms_ratio: Largest rms residual over the rms travel of the point.
        """
        if not np.isfinite(path).all():
            return None
        travel = float(np.sqrt(np.mean(np.sum(np.square(path - path.mean(axis=0)), axis=1))))
        if travel < MIN_TRAVEL_M:
            return None
        origin = np.broadcast_to(np.eye(3), self.rotation.shape)
        terms = np.concatenate([self.rotation, origin], axis=2).reshape(-1, 6)
        offset = (path - self.position).reshape(-1)
        fixed, *_ = np.linalg.lstsq(terms, offset, rcond=None)
        residual_rms = float(np.sqrt(np.mean(np.sum(np.square((offset - terms @ fixed).reshape(-1, 3)), axis=1))))
        return (float(np.linalg.norm(fixed[:3])), residual_rms) if residual_rms < max_rms_ratio * travel else None
