# SPDX-License-Identifier: Apache-2.0
"""Displacement of an object after an impact: sliding distance to rest, or horizontal distance of a falling flight.

With v the velocity of its centre just after, v_h its horizontal part, v_z its vertical one and g gravity along -z,

    slides to rest by Coulomb friction mu:     D = |v_h|^2 / (2 mu g)
    flies until it has fallen by h:            D = |v_h| t,        t = (v_z + sqrt(v_z^2 + 2 g h)) / g

The object does not turn over while it slides, and there is no drag. A difference dD corresponds to the velocity dD / T
with T = dD/d|v_h|: |v_h| / (mu g) = sqrt(2 D / (mu g)) at the measured D, and t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array

MIN_FLIGHT_S = 0.01  # shorter flights do not determine a velocity


@dataclass(frozen=True)
class Distance:
    """Horizontal displacement of the centre of an object after an impact.

    Attributes:
        measured: Measured D [m]; nan: to be predicted.
        fall: Height h of the fall [m]; None: the object slid to rest.
        friction: Measured Coulomb coefficient of the support [-]; None: the nominal one.
        noise: Standard deviation of the measured D [m]; None: unknown.
    """

    measured: float
    fall: float | None = None
    friction: float | None = None
    noise: float | None = None

    @property
    def law(self) -> str:
        """``sliding`` or ``flight``."""
        return "sliding" if self.fall is None else "flight"

    def predicted(self, velocity: Array, physics: Physics) -> float:
        """D predicted from a velocity just after the impact [m].

        Args:
            velocity: Of the centre, axes of A, ``(3,)`` [m/s].
            physics: Friction of the support, and gravity.
        """
        speed = float(np.hypot(velocity[0], velocity[1]))
        if self.fall is None:
            return speed**2 / (2.0 * self._friction(physics) * _gravity(physics))
        return speed * self._flight_time(float(velocity[2]), physics)

    def distance_per_speed(self, velocity: Array, physics: Physics) -> float:
        """T = dD/d|v_h| [s]: derivative of the distance by the horizontal speed.

        Args:
            velocity: Predicted velocity of the centre, axes of A, ``(3,)`` [m/s]; T depends on it in a flight only.
            physics: Friction of the support, and gravity.
        """
        if self.fall is None:
            return float(np.sqrt(2.0 * self.measured / (self._friction(physics) * _gravity(physics))))
        return max(self._flight_time(float(velocity[2]), physics), MIN_FLIGHT_S)

    def _friction(self, physics: Physics) -> float:
        return max(physics.support_friction if self.friction is None else self.friction, 1e-6)

    def _flight_time(self, vertical_velocity: float, physics: Physics) -> float:
        """Duration t of the flight [s]."""
        assert self.fall is not None
        g = _gravity(physics)
        return float(max(vertical_velocity + np.sqrt(vertical_velocity**2 + 2.0 * g * self.fall), 0.0)) / g


def _gravity(physics: Physics) -> float:
    return float(np.linalg.norm(physics.gravity))
