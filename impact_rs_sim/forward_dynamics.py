# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics of an arm with rigid joints: motion under given torque, from several states at once.

    (M(q) + B) ddq = tau - h(q, dq) + tau_fric(dq) + tau_load(q, dq)          (cf. paper eq. eom)

ddq comes from the articulated-body algorithm of Pinocchio (Featherstone 2008, sec. 7.3), with B as its armature. The
elasticity of the transmissions is left out: it acts at tens of Hz, above the motion of a rollout.

Dry friction changes within some mrad/s, which an explicit method resolves with tiny steps only. The step is that of the
Rosenbrock method ROS2 (Verwer, Spee, Blom, Hundsdorfer 1999), of second order for any matrix A in place of the
Jacobian; here A holds the slope of all resistance that opposes a velocity, -(M + B)^-1 D:

    (M + B + g h D) k1 = tau - h + tau_fric + tau_load                        at q, dq;        g = 1 - 1 / sqrt(2)
    (M + B + g h D) k2 = (M + B) (ddq(q + h dq, dq + h k1) - 2 k1)
    dq' = dq + h (3 k1 + k2) / 2,    q' = q + h (dq + h k1 / 2)

D is the secant of the resistance through rest, so that friction alone does not reverse a velocity. Without friction it
is Heun's method.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from impact_rs_sim.physics import LoadState, Physics
from impact_rs_sim.robot import Array

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)  # of ROS2; damps the fastest decay at once (L-stable)
MIN_SECANT_SPEED = 1e-6  # rad/s, m/s; a slower joint has the slope of friction at this speed


class ForwardDynamics:
    """Forward dynamics of one arm.

    Args:
        physics: Physics of the scene.
        arm: Name of the arm.
        with_motor: Whether the torque accelerates the inertia of the motors, B.
        with_drive: Whether friction and loads of the motors act on the torque.
    """

    def __init__(self, physics: Physics, arm: str, with_motor: bool = True, with_drive: bool = True) -> None:
        self._arm, self._with_drive = physics.arms[arm], with_drive
        self.model = physics.robot_model(arm)
        self._pinocchio, self._data = self.model.pinocchio, self.model.data
        inertia = self._arm.motor_inertia_reduced
        self.motor_inertia = inertia if with_motor else np.zeros_like(inertia)

    def motion(self, time: Array, position: Array, velocity: Array, torque: Array, step: float) -> tuple[Array, Array]:
        """Positions and velocities at the end of every step and before the first, ``(K + 1, S, n)`` each.

        Args:
            time: Of the starts, for loads that depend on time, ``(S,)`` [s].
            position: q of the starts, ``(S, n)`` [rad].
            velocity: dq of the starts, ``(S, n)`` [rad/s].
            torque: Mean driving torque of every step, ``(K, S, n)`` [N m].
            step: Duration of a step h [s].
        """
        q, dq = [position], [velocity]
        for number, driving in enumerate(torque):
            found = self._step(time + number * step, q[-1], dq[-1], driving, step)
            q.append(found[0])
            dq.append(found[1])
        return np.array(q), np.array(dq)

    def acceleration(self, position: Array, velocity: Array, torque: Array, armature: Array) -> Array:
        """(M + armature)^-1 (torque - h), ``(S, n)`` [rad/s^2]; all arguments ``(S, n)``."""
        found = np.empty_like(position)
        for row, (q, dq, tau, inertia) in enumerate(zip(position, velocity, torque, armature, strict=True)):
            self._pinocchio.armature = inertia
            found[row] = pin.aba(self._pinocchio, self._data, q, dq, tau)
        return found

    def _step(self, time: Array, q: Array, dq: Array, driving: Array, h: float) -> tuple[Array, Array]:
        resistance, secant = self._resistance(time, q, dq, driving)
        torque, bare = driving + resistance, np.broadcast_to(self.motor_inertia, q.shape)
        implicit = GAMMA * h * secant
        k1 = self.acceleration(q, dq, torque, bare + implicit)
        later = q + h * dq, dq + h * k1
        again, _ = self._resistance(time + h, *later, driving)
        k2 = self.acceleration(*later, driving + again, bare) - 2.0 * k1
        if np.any(implicit):  # (M + B + g h D)^-1 (M + B) = 1 - (M + B + g h D)^-1 g h D; ddq is linear in the torque
            k2 = k2 - (self.acceleration(q, dq, torque + implicit * k2, bare + implicit) - k1)
        return q + h * (dq + 0.5 * h * k1), dq + h * (1.5 * k1 + 0.5 * k2)

    def _resistance(self, time: Array, q: Array, dq: Array, driving: Array) -> tuple[Array, Array]:
        """Torque of friction and loads, and its secant through rest where it opposes the velocity, ``(S, n)`` each."""
        moving = np.where(np.abs(dq) < MIN_SECANT_SPEED, np.copysign(MIN_SECANT_SPEED, dq), dq)
        rest = np.zeros_like(dq)
        friction = self._arm.friction.torque(moving) if self._with_drive else rest
        loads, at_rest = rest, rest
        if self._arm.loads:
            loads, at_rest = (self._loads(time, q, speed, driving + friction) for speed in (moving, rest))
        torque = friction + loads
        return torque, np.maximum((at_rest - torque) / moving, 0.0)

    def _loads(self, time: Array, q: Array, dq: Array, transmitted: Array) -> Array:
        """Torque of all loads, ``(S, n)`` [N m]."""
        jacobian = np.array([self.model.jacobian(row)[:3] for row in q])
        state = LoadState(
            time=time,
            joint_position=q,
            joint_velocity=dq,
            position=np.array([self.model.placement(row).translation for row in q]),
            velocity=np.einsum("kan,kn->ka", jacobian, dq),
            impact_position=self._arm.impact_position,
            joint_torque=transmitted,
        )
        on_links, on_motors = self._arm.load_torques(state, jacobian)
        return on_links + on_motors if self._with_drive else on_links
