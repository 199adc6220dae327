# SPDX-License-Identifier: Apache-2.0
"""Errors of the measurement: quantisation, noise and a slow object tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenario import Sensors
from impact_rs_sim.scene import ArmMotion


@dataclass(frozen=True)
class ArmMeasurement:
    """Measured state of one arm.

    Attributes:
        position: Link position q, ``(n,)`` [rad].
        velocity: Link velocity dq, ``(n,)`` [rad/s].
        torque: Joint torque tau_J, ``(n,)`` [N m].
        motor_position: Motor position theta, ``(n,)`` [rad].
        motor_velocity: Motor velocity, ``(n,)`` [rad/s].
    """

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array
    motor_velocity: Array


@dataclass(frozen=True)
class ObjectMeasurement:
    """Pose of the object's geometric centre from the tracker.

    Attributes:
        time: When it was taken [s].
        position: Position in A, ``(3,)`` [m].
        quaternion: Orientation in A, x y z w, ``(4,)``.
    """

    time: float
    position: Array
    quaternion: Array


class ArmSensors:
    """Sensors of one arm; the noise of a whole trial is drawn at once."""

    def __init__(self, sensors: Sensors, joint_count: int, samples: int, rng: np.random.Generator) -> None:
        self._resolution = sensors.joint_position_resolution
        self._lines = 1.0 / self._resolution if self._resolution > 0.0 else 0.0
        shape = (samples, joint_count)
        self._velocity_noise = sensors.joint_velocity_noise * rng.standard_normal(shape)
        self._motor_velocity_noise = sensors.joint_velocity_noise * rng.standard_normal(shape)
        self._torque_noise = sensors.joint_torque_noise * rng.standard_normal(shape)

    def measure(self, tick: int, true: ArmMotion) -> ArmMeasurement:
        """The measurement of one control tick."""
        return ArmMeasurement(
            position=self._quantise(true.position),
            velocity=true.velocity + self._velocity_noise[tick],
            torque=true.torque + self._torque_noise[tick],
            motor_position=self._quantise(true.motor_position),
            motor_velocity=true.motor_velocity + self._motor_velocity_noise[tick],
        )

    def _quantise(self, angle: Array) -> Array:
        if self._resolution == 0.0:
            return angle.copy()
        return np.asarray(np.rint(angle * self._lines) * self._resolution)


class ObjectTracker:
    """A motion-capture-like tracker of the object's pose."""

    def __init__(self, sensors: Sensors, samples: int, rng: np.random.Generator) -> None:
        self._position_noise = sensors.object_position_noise * rng.standard_normal((samples, 3))
        self._orientation_noise = sensors.object_orientation_noise * rng.standard_normal((samples, 3))

    def measure(self, sample: int, time: float, position: Array, rotation: Array) -> ObjectMeasurement:
        """One sample of the tracker."""
        noisy = rotation @ pin.exp3(self._orientation_noise[sample])
        return ObjectMeasurement(
            time=time,
            position=position + self._position_noise[sample],
            quaternion=quaternion_of(noisy),
        )
