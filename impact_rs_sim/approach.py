# SPDX-License-Identifier: Apache-2.0
"""Arms approaching an object at rest, simulated without Bullet as long as no pad is near another body.

    ddq = ABA(q, dq, tau),    dq += h ddq,    q += h dq                     (Featherstone; Bullet's own order of steps)

Only pads and the object can touch each other; the support carries the object and touches no pad. Nearness is judged by
axis-aligned bounding boxes in A. Bullet lets an object sleep until such boxes, each ``BULLET_MARGIN`` larger than the
body, overlap. Switching to Bullet before that gives the same motion as Bullet from the start, up to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Final

import numpy as np

from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState

BULLET_MARGIN: Final = 0.02  # m, gContactBreakingThreshold
NEAR: Final = 2.0 * BULLET_MARGIN + 0.01  # m between two boxes; a pad comes closer by a millimetre in a tick


class Approach:
    """Arms alone, stepped like a :class:`~impact_rs_sim.bullet_world.BulletWorld`.

    Args:
        physics: Parameters of the scene.
        models: Rigid-body models by arm.
        period: Step [s].
        arms: Joint states by arm, at the start.
        object_: The object, at rest.
    """

    def __init__(
        self,
        physics: Physics,
        models: Mapping[str, RobotModel],
        period: float,
        arms: Mapping[str, ArmState],
        object_: BodyState,
    ) -> None:
        self._models = models
        self._period = period
        self._pads = {}
        for name in arms:
            end_effector = physics.arms[name].end_effector
            self._pads[name] = (end_effector.pad_placement, np.array(end_effector.pad_size) / 2.0)
        self._object = (object_.position, np.abs(object_.rotation) @ (physics.object.size / 2.0))
        self._position = {name: state.position for name, state in arms.items()}
        self._velocity = {name: state.velocity for name, state in arms.items()}
        self._torque: dict[str, Array] = {}

    def apply_torque(self, name: str, torque: Array) -> None:
        """Joint torque of an arm over the next step, ``(n,)`` [N m]."""
        self._torque[name] = torque

    def step(self) -> None:
        """Advance by one step."""
        for name, torque in self._torque.items():
            self._position[name], self._velocity[name] = self._models[name].chain.advance(
                self._position[name], self._velocity[name], torque, self._period
            )

    def joint_motion(self, name: str) -> tuple[Array, Array]:
        """Joint positions ``(n,)`` [rad] and velocities ``(n,)`` [rad/s] of an arm."""
        return self._position[name], self._velocity[name]

    @property
    def is_near(self) -> bool:
        """Whether a pad is ``NEAR`` the object or another pad, or a joint position is NaN."""
        boxes = [self._pad_box(name) for name in self._position]
        pairs = [(box, self._object) for box in boxes] + list(combinations(boxes, 2))
        return not all(_gap(*first, *second) > NEAR for first, second in pairs)

    def _pad_box(self, name: str) -> tuple[Array, Array]:
        """Middle and half extents along the axes of A of the box about a pad [m]."""
        placement, half = self._pads[name]
        pad = self._models[name].placement(self._position[name]) * placement
        return pad.translation, np.abs(pad.rotation) @ half


def _gap(first: Array, first_half: Array, second: Array, second_half: Array) -> float:
    """Largest distance of two boxes along an axis of A [m]; negative where they overlap."""
    return float((np.abs(first - second) - first_half - second_half).max())
