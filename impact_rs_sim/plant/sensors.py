# SPDX-License-Identifier: Apache-2.0
"""Errors of the measurement: sensor models, quantisation, noise and a slow object tracker."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.readings import EXACT, ArmReadings, Filter, TrackerReadings
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenarios.trial_settings import Sensors
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
        time: Time of the sample [s].
        position: Position in A, ``(3,)`` [m].
        quaternion: Orientation in A, x y z w, ``(4,)``.
    """

    time: float
    position: Array
    quaternion: Array


class ArmSensors:
    """Sensors of one arm; the noise of a whole trial is drawn at once.

    Args:
        sensors: Resolution and noise.
        joint_count: Number of joints.
        samples: Number of control ticks.
        rng: Generator of the noise.
        readings: Sensor models; a negative delay is not causal and is treated as 0.
        period: Control period [s].
    """

    def __init__(
        self,
        sensors: Sensors,
        joint_count: int,
        samples: int,
        rng: np.random.Generator,
        readings: ArmReadings = EXACT,
        period: float = 1e-3,
    ) -> None:
        self._readings = readings
        self._mixing = readings.mixing(joint_count)
        self._velocity = Filter(readings.velocity_delay, readings.velocity_filters, period)
        self._torque = Filter(readings.torque_delay, readings.torque_filters, period)
        self._resolution = sensors.joint_position_resolution
        self._lines = 1.0 / self._resolution if self._resolution > 0.0 else 0.0
        shape = (samples, joint_count)
        self._velocity_noise = sensors.joint_velocity_noise * rng.standard_normal(shape)
        self._motor_velocity_noise = sensors.joint_velocity_noise * rng.standard_normal(shape)
        self._torque_noise = sensors.joint_torque_noise * rng.standard_normal(shape)

    def measure(self, tick: int, true: ArmMotion) -> ArmMeasurement:
        """The measurement of one control tick; ticks in order."""
        read = true if self._readings is EXACT else self._read(tick, true)
        return ArmMeasurement(
            position=self._quantise(read.position),
            velocity=read.velocity + self._velocity_noise[tick],
            torque=read.torque + self._torque_noise[tick],
            motor_position=self._quantise(read.motor_position),
            motor_velocity=true.motor_velocity + self._motor_velocity_noise[tick],
        )

    def _read(self, tick: int, true: ArmMotion) -> ArmMotion:
        """Readings of the true motion by the sensor models."""
        readings = self._readings
        return replace(
            true,
            position=readings.position(true.position),
            velocity=self._velocity(tick, readings.position_scale * readings.velocity_gain * true.velocity),
            torque=self._torque(tick, self._mixing @ true.torque + readings.torque_offset),
            motor_position=true.motor_position + readings.motor_offset,
        )

    def _quantise(self, angle: Array) -> Array:
        if self._resolution == 0.0:
            return angle.copy()
        return np.asarray(np.rint(angle * self._lines) * self._resolution)


class ObjectTracker:
    """A motion-capture-like tracker of the object's pose.

    Args:
        sensors: Noise.
        samples: Number of samples.
        rng: Generator of the noise.
        readings: Sensor model.
        period: Time between samples [s].
    """

    def __init__(
        self,
        sensors: Sensors,
        samples: int,
        rng: np.random.Generator,
        readings: TrackerReadings | None = None,
        period: float = 4e-3,
    ) -> None:
        self._readings = readings or TrackerReadings()
        self._filter = Filter(self._readings.delay, self._readings.filters, period)
        self._position_noise = sensors.object_position_noise * rng.standard_normal((samples, 3))
        self._orientation_noise = sensors.object_orientation_noise * rng.standard_normal((samples, 3))

    def measure(self, sample: int, time: float, position: Array, rotation: Array) -> ObjectMeasurement:
        """One sample of the tracker."""
        if not self._readings.exact:
            position, rotation = self._readings.pose(*self._filtered(sample, position, rotation))
        noisy = rotation @ pin.exp3(self._orientation_noise[sample])
        return ObjectMeasurement(
            time=time,
            position=position + self._position_noise[sample],
            quaternion=quaternion_of(noisy),
        )

    def _filtered(self, sample: int, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Pose after delay and filter, for small rotations between samples."""
        if self._readings.delay == 0.0 and not any(self._readings.filters):
            return position, rotation
        filtered = self._filter(sample, np.concatenate((position, rotation.ravel())))
        left, _, right = np.linalg.svd(filtered[3:].reshape(3, 3))  # the nearest rotation (Schoenemann 1966)
        return filtered[:3], left @ right
