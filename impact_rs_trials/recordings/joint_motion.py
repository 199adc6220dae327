# SPDX-License-Identifier: Apache-2.0
"""Motion of the joints of a recorded arm, and its inverse dynamics, at a subset of the samples."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.relations import AveragedMotion, averaged, evenly

COMPARED_SAMPLES = 400  # of a motion and a stream


@dataclass(frozen=True)
class JointMotion:
    """Motion of the joints at a subset of the samples, after moving averages, ``(k, n)`` each.

    Attributes:
        time: Stamps of the recording, ``(m,)`` [s].
        rows: Indices of the averaged samples, ``(k,)``.
        moments: Their times, ``(k,)`` [s].
        position: q [rad, m].
        derivative: dq/dt of the positions [rad/s, m/s].
        velocity: dq, measured or else the derivative [rad/s, m/s].
        acceleration: ddq, the derivative of the velocity [rad/s^2, m/s^2].
        model: Nominal arm.
    """

    time: Array
    rows: NDArray[np.signedinteger]
    moments: Array
    position: Array
    derivative: Array
    velocity: Array
    acceleration: Array
    model: RobotModel

    @staticmethod
    def of(
        time: Array, position: Array, velocity: Array | None, model: RobotModel, samples: int = COMPARED_SAMPLES
    ) -> JointMotion:
        """Motion from signals ``(m, n)`` at common timestamps [s]; velocity None: the derivative of the position."""
        motion = AveragedMotion.of(time, position)
        rows = evenly(motion.time.size, samples)
        dq = motion.velocity if velocity is None else averaged(time, velocity)[1]
        ddq = np.gradient(dq, motion.time, axis=0)
        q, derivative = motion.position[rows], motion.velocity[rows]
        return JointMotion(time, rows, motion.time[rows], q, derivative, dq[rows], ddq[rows], model)

    @property
    def facts(self) -> RobotFacts:
        """The robot."""
        return self.model.facts

    @functools.cached_property
    def gravity_torque(self) -> Array:
        """g, ``(k, n)`` [N m, N]."""
        return np.array([self.model.gravity_torque(q) for q in self.position])

    @functools.cached_property
    def rigid_torque(self) -> Array:
        """M ddq + h, ``(k, n)`` [N m, N]."""
        states = zip(self.position, self.velocity, self.acceleration, strict=True)
        return np.array([self.model.inverse_dynamics(*state) for state in states])

    def sampled(self, values: Array) -> Array:
        """Another stream ``(m, c)`` on the same timestamps: averaged, at the samples of the motion, ``(k, c)``."""
        return averaged(self.time, values)[1][self.rows]

    def unit(self, turns: str, slide: str) -> Any:
        """Unit of joints that turn and joints that slide: a single unit if all joints share it, else a list."""
        return unit_of_joints(self.facts, turns, slide)


def unit_of_joints(facts: RobotFacts, turns: str, slide: str) -> Any:
    """Unit of the joints of a robot, as in a mapping: a single unit if all joints share it, else a list."""
    units = [slide if kind == "prismatic" else turns for kind in facts.joint_types]
    return units[0] if len(set(units)) == 1 else units
