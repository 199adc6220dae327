# SPDX-License-Identifier: Apache-2.0
"""Mechanics of a plant that is the twin (:mod:`impact_rs_sim.twin`), tick by tick: for studies of many trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
import pinocchio as pin

from impact_rs_sim import _kernel
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.mechanics import Mechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState
from impact_rs_sim.twin import BOX_COLUMNS, CONTACT_REFINEMENT, arm_start, box_starts, kernel_twin, motions


class TwinMechanics(Mechanics):
    """See :class:`~impact_rs_sim.plant.mechanics.Mechanics`.

    Args:
        physics: Parameters of the scene.
        twin: Their form in the kernel.
    """

    def __init__(self, physics: Physics, twin: _kernel.Twin) -> None:
        self.physics, self._twin = physics, twin
        self._numbers = {name: number for number, name in enumerate(physics.arms)}

    @classmethod
    def load(cls, physics: Physics, period: float) -> Self:
        """See :meth:`Mechanics.load`."""
        return cls(physics, kernel_twin(physics, period, joint_torque=False, refinement=CONTACT_REFINEMENT))

    def start(self, arms: Mapping[str, ArmState], drives: Mapping[str, DriveStart], object_: BodyState) -> None:
        """See :meth:`Mechanics.start`."""
        starts = [arm_start(arms[name], drives[name]) for name in self._numbers]
        self._run = _kernel.TwinRun(self._twin, starts, box_starts(self.physics, object_))
        self._update(self._run.state)

    def step(self, desired: Mapping[str, Array], periods: int, time: float) -> None:
        """See :meth:`Mechanics.step`.

        Raises:
            InputError: A load is not finite, or a step was not solved.
        """
        try:
            state = self._run.step(time, periods, [desired[name] for name in self._numbers])
        except RuntimeError as error:
            raise InputError(str(error)) from None
        self._update(state)
        if self._run.failed and np.isfinite(state[0]):  # non-finite values are detected in the measurement
            raise InputError(
                f"the twin left its step at t = {self._run.failed[0]:.5f} s unsolved; trials also run on --plant bullet"
            )

    def _update(self, state: Array) -> None:
        """Split a state of the kernel into arms and objects."""
        self._arms, self._bodies = motions(self.physics, state)

    def arm(self, name: str) -> ArmMotion:
        """See :meth:`Mechanics.arm`."""
        return self._arms[name]

    def object_state(self, number: int = 0) -> BodyState:
        """See :meth:`Mechanics.object_state`."""
        pose, twist = np.split(self._bodies[BOX_COLUMNS * number : BOX_COLUMNS * (number + 1)], [7])
        return BodyState(pose[:3], pin.Quaternion(pose[3:]).matrix(), twist)

    def pad_force(self, name: str) -> Array:
        """See :meth:`Mechanics.pad_force`."""
        return self._run.pad_force(self._numbers[name])

    def close(self) -> None:
        """See :meth:`Mechanics.close`; there is nothing to release."""
