# SPDX-License-Identifier: Apache-2.0
"""Path of the flange of a robot, which separates the pose of its own tool from the pose of an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.relations import evenly

MAX_SAMPLES = 400
MIN_TRAVEL_M = 0.02  # rms, of a point whose motion is compared
MAX_RMS_RATIO = 0.02  # of what a fixed place on the flange leaves, over the travel: kinematics are known to some mm
MAX_RMS_RATIO_OF_TARGET = 0.3  # of the target of a tool, which the tool follows with an error


@dataclass(frozen=True)
class FlangePath:
    """Places of the flange, by the forward kinematics of recorded joint positions.

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
        places = [model.placement(one) for one in q[rows]]
        return cls(
            time[rows], np.array([one.translation for one in places]), np.array([one.rotation for one in places])
        )

    def carries(self, place: Array, most: float = MAX_RMS_RATIO) -> tuple[float, float] | None:
        """Distance from the flange and rms deviation [m] of a point that is fixed on it; None: it is not.

        Least squares of p = x + R c + b over the place c on the flange and the origin b of the frame in which p was
        measured, in the axes of the robot's base.

        Args:
            place: Path of the point at the same times, ``(k, 3)`` [m].
            most: Largest rms deviation over the rms travel of the point.
        """
        if not np.isfinite(place).all():
            return None
        travel = float(np.sqrt(np.mean(np.sum(np.square(place - place.mean(axis=0)), axis=1))))
        if travel < MIN_TRAVEL_M:
            return None
        origin = np.broadcast_to(np.eye(3), self.rotation.shape)
        terms = np.concatenate([self.rotation, origin], axis=2).reshape(-1, 6)
        away = (place - self.position).reshape(-1)
        fixed, *_ = np.linalg.lstsq(terms, away, rcond=None)
        left = float(np.sqrt(np.mean(np.sum(np.square((away - terms @ fixed).reshape(-1, 3)), axis=1))))
        return (float(np.linalg.norm(fixed[:3])), left) if left < most * travel else None
