# SPDX-License-Identifier: Apache-2.0
"""Effects of the surroundings: a cell that is not level, and a cable that pulls on the end effector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.effects.base import ArmEffect, Parameter, SceneEffect, Values, number, vector3
from impact_rs_sim.physics import ArmPhysics, Load, LoadState, Physics
from impact_rs_sim.robots.robot import Array


def _base_tilt(physics: Physics, values: Values) -> Physics:
    """Effect law: in a cell rotated by R = Ry(pitch) Rx(roll) against the vertical, gravity is R^T g."""
    tilt = pin.rpy.rpyToMatrix(number(values, "roll"), number(values, "pitch"), 0.0)
    return replace(physics, gravity=tilt.T @ physics.gravity)


def _external_spring(arm: ArmPhysics, values: Values) -> ArmPhysics:
    spring = Spring(vector3(values, ("pull_x", "pull_y", "pull_z")), number(values, "stiffness"))
    if not np.any(spring.pull) and spring.stiffness == 0.0:
        return arm
    return replace(arm, loads=(*arm.loads, spring))


@dataclass(frozen=True)
class Spring(Load):
    """A cable or hose that pulls on the end effector: ``f = f_0 - k (p - p_impact)`` at frame E.

    Attributes:
        pull: f_0, force where E is at the nominal impact, axes of A, ``(3,)`` [N].
        stiffness: k [N/m].
    """

    pull: Array
    stiffness: float

    @property
    def vectorised(self) -> bool:
        """See :class:`Load`."""
        return True

    def end_effector_force(self, state: LoadState) -> Array | None:
        """Force at E, axes of A, ``(3,)`` [N]."""
        return np.asarray(self.pull - self.stiffness * (state.position - state.impact_position))


BASE_TILT = SceneEffect(
    name="base_tilt",
    acts_on="scene",
    sentence="The table and the robot are not level, so gravity pulls a little sideways.",
    parameters=(
        Parameter("roll", "rad", 0.0, -0.2, 0.2, 0.01, "tilt about x"),
        Parameter("pitch", "rad", 0.0, -0.2, 0.2, 0.01, "tilt about y"),
    ),
    law=_base_tilt,
    lasting=True,
)

EXTERNAL_SPRING = ArmEffect(
    name="external_spring",
    acts_on="joint torque",
    sentence="A cable or hose pulls on the end effector, more the further it moves.",
    parameters=(
        Parameter("pull_x", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along x"),
        Parameter("pull_y", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along y"),
        Parameter("pull_z", "N", 0.0, -30.0, 30.0, 1.0, "force at the impact pose along z"),
        Parameter("stiffness", "N/m", 0.0, 0.0, 500.0, 5.0, "growth of the force with distance"),
    ),
    law=_external_spring,
)
