# SPDX-License-Identifier: Apache-2.0
"""How far an object goes after an impact: the way it slides to rest, or the way it flies while it falls.

With v the velocity of its centre just after, v_h its horizontal part, v_z its vertical one and g gravity along -z,

    slides to rest by Coulomb friction mu:     D = |v_h|^2 / (2 mu g)
    flies until it has fallen by h:            D = |v_h| t,        t = (v_z + sqrt(v_z^2 + 2 g h)) / g

The object does not turn over while it slides, and there is no drag. A difference dD is worth the velocity dD / T that
makes it, with T = dD/d|v_h|: |v_h| / (mu g) = sqrt(2 D / (mu g)) at the measured D, and t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array

MIN_FLIGHT_S = 0.01  # shorter flights do not determine a velocity


@dataclass(frozen=True)
class Distance:
    """The horizontal way of the centre of an object after an impact.

    Attributes:
        way: D as measured [m]; nan: it is asked for.
        fall: Height h by which the object fell while it flew [m]; None: it slid to rest.
        friction: Coulomb coefficient of the support on which it slid, as measured [-]; None: that of the physics.
        noise: Standard deviation of the measured D [m]; None: not known.
    """

    way: float
    fall: float | None = None
    friction: float | None = None
    noise: float | None = None

    @property
    def law(self) -> str:
        """``sliding`` or ``flight``."""
        return "sliding" if self.fall is None else "flight"

    def predicted(self, velocity: Array, physics: Physics) -> float:
        """D that follows from a velocity just after the impact [m].

        Args:
            velocity: Of the centre, axes of A, ``(3,)`` [m/s].
            physics: Friction of the support, and gravity.
        """
        speed = float(np.hypot(velocity[0], velocity[1]))
        if self.fall is None:
            return speed**2 / (2.0 * self._friction(physics) * _gravity(physics))
        return speed * self._flight(float(velocity[2]), physics)

    def lasting(self, velocity: Array, physics: Physics) -> float:
        """T of the module: change of D by one of the horizontal speed [s].

        Args:
            velocity: As predicted, of the centre, axes of A, ``(3,)`` [m/s]; only a flight depends on it.
            physics: Friction of the support, and gravity.
        """
        if self.fall is None:
            return float(np.sqrt(2.0 * self.way / (self._friction(physics) * _gravity(physics))))
        return max(self._flight(float(velocity[2]), physics), MIN_FLIGHT_S)

    def _friction(self, physics: Physics) -> float:
        return max(physics.support_friction if self.friction is None else self.friction, 1e-6)

    def _flight(self, upwards: float, physics: Physics) -> float:
        """t of the module [s]."""
        assert self.fall is not None
        g = _gravity(physics)
        return float(max(upwards + np.sqrt(upwards**2 + 2.0 * g * self.fall), 0.0)) / g


def _gravity(physics: Physics) -> float:
    return float(np.linalg.norm(physics.gravity))
