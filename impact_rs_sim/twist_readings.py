# SPDX-License-Identifier: Apache-2.0
"""Readings of the twist of a body just before and just after a single impact.

With v and omega the true velocities of the centre, R the rotation of the body, and c the tracked point, the tracker
reads

    v_r     = Q (v + omega x R c)             velocity of a point of a rigid body, in the axes of velocities
    omega_r = Q g S omega,                    S = exp([s]), Q = exp([q])

g = 1 is right, and g = -1 is a left-handed sense of rotation: a mirror M turns angular velocities by M det(M), so that
readings of all components in mirrored axes are those in turned axes times -1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

Three = tuple[float, float, float]
ZERO_VECTOR = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TwistReadings:
    """Sensor model of the twist of a body at a single impact.

    Attributes:
        spin_axes: s, rotation vector from the axes of velocities to those of angular velocities [rad].
        spin_factor: g [-].
        axes: q, rotation vector from A to the axes in which both velocities were measured [rad].
        point: c, tracked point from the geometric centre, axes of the body [m].
    """

    spin_axes: Three = ZERO_VECTOR
    spin_factor: float = 1.0
    axes: Three = ZERO_VECTOR
    point: Three = ZERO_VECTOR

    @property
    def exact(self) -> bool:
        """Whether readings are the true twists."""
        return self == TwistReadings()

    @property
    def numbers(self) -> tuple[float, ...]:
        """All parameters as one tuple."""
        return (*self.spin_axes, self.spin_factor, *self.axes, *self.point)

    def lever(self, rotation: Array) -> Array:
        """R c: the tracked point from the centre in A, ``(3,)`` [m].

        Args:
            rotation: R, rotation matrix of the body.
        """
        return np.asarray(rotation @ np.array(self.point))

    def twist(self, true: Array, rotation: Array) -> Array:
        """Readings of a true twist of the centre, velocity and angular velocity, ``(6,)`` [m/s, rad/s].

        Args:
            true: v and omega.
            rotation: R, rotation matrix of the body.
        """
        axes, spin_axes = self._rotations
        velocity = true[:3] + np.cross(true[3:], self.lever(rotation))
        return np.concatenate((axes @ velocity, axes @ (self.spin_factor * (spin_axes @ true[3:]))))

    def twist_of(self, reading: Array, rotation: Array) -> Array:
        """Twist of the centre for a reading: the inverse of :meth:`twist`, ``(6,)`` [m/s, rad/s]."""
        axes, spin_axes = self._rotations
        spin = spin_axes.T @ (axes.T @ reading[3:]) / self.spin_factor
        return np.concatenate((axes.T @ reading[:3] - np.cross(spin, self.lever(rotation)), spin))

    @property
    def _rotations(self) -> tuple[Array, Array]:
        """Q and S."""
        return np.asarray(pin.exp3(np.array(self.axes))), np.asarray(pin.exp3(np.array(self.spin_axes)))
