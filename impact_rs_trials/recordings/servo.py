# SPDX-License-Identifier: Apache-2.0
"""Position servos: the torque of logs without torque, from desired and measured positions.

A proportional-derivative law drives a joint towards its desired position, with the target held at zero velocity, or
with the velocity error damped (``damps``):

    tau = clip(K_p (q_d - q) - K_d dq)            velocity     legs, position actuators of MuJoCo and Isaac
    tau = clip(K_p (q_d - q) + K_d (dq_d - dq))   error        trajectory controllers

clip limits it to +- the largest torque of the joint (saturation). A command that acts late by d gives

    tau_d = clip(K_p (q_d(t - d) - q) + ...)

Such a log does not determine everything: without known gains, K_p scales with the masses of the model (gravity gives
K_p (q_d - q) = g(q)); without a known K_d, damping of the servo is viscous friction. Encoder offsets common to q_d and
q cancel in the difference and show in gravity alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from impact_rs_sim.readings import delayed
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import NonNegativeVector, PositiveVector, Schema

Damps = Literal["velocity", "error"]


class Servo(Schema):
    """Gains of the position servos of the joints."""

    kp: PositiveVector = Field(description="torque over position error [N m/rad], prismatic [N/m]")
    kd: NonNegativeVector | None = Field(
        None,
        description="torque over velocity [N m s/rad], prismatic [N s/m]; absent: 0, and viscous friction in "
        "diagnose includes it",
    )
    damps: Damps = Field(
        "velocity", description="'velocity': - kd dq; 'error': + kd (dq_desired - dq), as trajectory controllers do"
    )
    gains: Literal["given", "estimated"] = Field(
        "given",
        description="'estimated': kp was found from gravity and inertia of the model; each, with a standard "
        "deviation of 30 %, is fitted with every model",
    )
    torque_max: PositiveVector | None = Field(
        None, description="largest torque [N m], prismatic [N]; absent: the limit of the robot"
    )


@dataclass(frozen=True)
class ServoLaw:
    """Servos of the joints of one recording, with their desired motion.

    Attributes:
        kp: K_p, ``(n,)`` [N m/rad].
        kd: K_d, ``(n,)`` [N m s/rad].
        damps: Whether K_d damps velocity or velocity error.
        torque_max: Saturation, ``(n,)`` [N m].
    """

    kp: Array
    kd: Array
    damps: Damps
    torque_max: Array

    @staticmethod
    def of(servo: Servo, torque_max: Array) -> ServoLaw:
        """Law of the servos of a mapping; ``torque_max`` ``(n,)``: limits of the robot [N m]."""
        kp = np.array(servo.kp)
        kd = np.zeros_like(kp) if servo.kd is None else np.array(servo.kd)
        return ServoLaw(kp, kd, servo.damps, np.array(torque_max if servo.torque_max is None else servo.torque_max))

    def unlimited(self, q: Array, dq: Array, q_desired: Array, dq_desired: Array) -> Array:
        """Torque before saturation, all arguments ``(..., n)`` [N m]."""
        target = dq_desired if self.damps == "error" else 0.0
        return np.asarray(self.kp * (q_desired - q) + self.kd * (target - dq))

    def torque(self, q: Array, dq: Array, q_desired: Array, dq_desired: Array) -> Array:
        """Torque, all arguments ``(..., n)`` [N m]."""
        return np.clip(self.unlimited(q, dq, q_desired, dq_desired), -self.torque_max, self.torque_max)

    def late(self, time: Array, q: Array, dq: Array, q_desired: Array, dq_desired: Array, delay: float) -> Array:
        """Torque along a motion if commands act late, ``(k, n)`` [N m].

        Args:
            time: Samples, ``(k,)`` [s].
            q: Readings of positions, ``(k, n)`` [rad].
            dq: Readings of velocities, ``(k, n)`` [rad/s].
            q_desired: Desired positions by their stamps, ``(k, n)`` [rad].
            dq_desired: Desired velocities, likewise [rad/s].
            delay: From the stamp of a command until it acts [s].
        """
        return self.torque(q, dq, delayed(time, q_desired, delay), delayed(time, dq_desired, delay))
