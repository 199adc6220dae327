# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics of an arm with rigid joints: motion under given torque, from several states at once.

    (M(q) + B) ddq = tau - h(q, dq) + r(q, dq),    r = tau_fric + tau_load          (cf. paper eq. eom)

Without the resistance r, ddq comes from the articulated-body algorithm of Pinocchio (Featherstone 2008, sec. 7.3), with
B as its armature. The elasticity of the transmissions is left out: it acts at tens of Hz, above the motion of an arm.

Dry friction changes its sign within some mrad/s, which an explicit method resolves with tiny steps only. So steps are
those of ARS(2,2,2) (Ascher, Ruuth, Spiteri 1997), a second-order method that is implicit and L-stable in r alone. With
a(q, dq) the acceleration without r, the step h, g = 1 - 1 / sqrt(2) and d = 1 - 1 / (2 g):

    q_2 = q + g h dq                          dq_2 = dq + g h (a_1 + b_2)
    q'  = q + h (d dq + (1 - d) dq_2)         dq'  = dq + h (d a_1 + (1 - d) a_2 + (1 - g) b_2 + g b')

with b = (M + B)^-1 r at the state of its own stage. Friction that grows with the speed has a potential, so that dq of a
stage is the minimum of a convex function. Newton's method with a line search finds it (Nocedal and Wright 2006, ch. 3).
Servos of the joints are part of r as well: their damping is implicit, and their stiffness acts at the q of the stage.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.physics import LoadState, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import symmetric

Rows = NDArray[np.int_]
Servo = Callable[[Array, Array, Array], Array]  # torque of servos at times (S,), q and dq (S, n), (S, n) [N m]

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
DELTA = 1.0 - 0.5 / GAMMA
MAX_NEWTON_STEPS = 20  # of a stage; two are usual, ten at a reversal of a joint
MAX_VELOCITY_ERROR = 1e-6  # rad/s, m/s, of a stage
MAX_SLOPE_RATIO = (
    0.5  # slope of the function at the end of a Newton step over its start; above it the step is shortened
)
SLOPE_CHANGE = 1e-6  # rad/s, m/s, for the slope of the resistance by differences


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

    def motion(
        self, time: Array, position: Array, velocity: Array, torque: Array, step: float, servo: Servo | None = None
    ) -> tuple[Array, Array]:
        """Positions and velocities at the end of every step and before the first, ``(K + 1, S, n)`` each.

        Args:
            time: Time of the starts, for loads that depend on time, ``(S,)`` [s].
            position: q of the starts, ``(S, n)`` [rad].
            velocity: dq of the starts, ``(S, n)`` [rad/s].
            torque: Mean driving torque of every step, ``(K, S, n)`` [N m].
            step: Duration of a step h [s].
            servo: Torque of servos by time and state, which falls with the velocity; None: no servos.
        """
        q, dq, slowed = [position], [velocity], np.zeros_like(velocity)
        for number, driving in enumerate(torque):
            position, velocity, slowed = self._step(time + number * step, q[-1], dq[-1], driving, step, slowed, servo)
            q.append(position)
            dq.append(velocity)
        return np.array(q), np.array(dq)

    def acceleration(self, position: Array, velocity: Array, torque: Array) -> Array:
        """(M + B)^-1 (torque - h), ``(S, n)`` [rad/s^2]; all arguments ``(S, n)``."""
        self._pinocchio.armature = self.motor_inertia
        states = zip(position, velocity, torque, strict=True)
        return np.array([pin.aba(self._pinocchio, self._data, *state) for state in states])

    def inertia(self, position: Array) -> Array:
        """M(q) + B at several positions ``(S, n)`` [rad], ``(S, n, n)`` [kg m^2]."""
        self._pinocchio.armature = self.motor_inertia  # which the mass matrix of Pinocchio contains
        return symmetric(np.array([pin.crba(self._pinocchio, self._data, q).copy() for q in position]))

    def _step(
        self, time: Array, q: Array, dq: Array, driving: Array, h: float, slowed: Array, servo: Servo | None
    ) -> tuple[Array, Array, Array]:
        """Position, velocity and g h b' at the end of a step, from those at its begin."""
        first = self.acceleration(q, dq, driving)
        middle = q + GAMMA * h * dq
        explicit = dq + GAMMA * h * first
        fast = self._resisted(time + GAMMA * h, middle, explicit, driving, GAMMA * h, slowed, servo)
        second = self.acceleration(middle, fast, driving)
        end = q + h * (DELTA * dq + (1.0 - DELTA) * fast)
        explicit_end = dq + h * (DELTA * first + (1.0 - DELTA) * second) + (1.0 / GAMMA - 1.0) * (fast - explicit)
        final = self._resisted(time + h, end, explicit_end, driving, GAMMA * h, fast - explicit, servo)
        return end, final, final - explicit_end

    def _resisted(
        self, time: Array, q: Array, explicit: Array, driving: Array, duration: float, guess: Array, servo: Servo | None
    ) -> Array:
        """Velocity dq with (M + B) (dq - explicit) = duration r(q, dq), near explicit + guess, ``(S, n)`` [rad/s]."""
        if servo is None and not self._arm.loads and (self._arm.friction.is_zero or not self._with_drive):
            return explicit
        inertia, resistance = self.inertia(q), self._resistance(time, q, driving, servo)

        def imbalance(dq: Array, rows: Rows) -> tuple[Array, Array]:
            momentum, resisting = np.einsum("sij,sj->si", inertia[rows], dq - explicit[rows]), resistance(dq, rows)
            return momentum - duration * resisting, resisting

        velocity, rows = explicit + guess, np.arange(len(q))
        residual, resisting = imbalance(velocity, rows)
        for _ in range(MAX_NEWTON_STEPS):
            dq = velocity[rows]
            slope = (resistance(dq + SLOPE_CHANGE, rows) - resisting) / SLOPE_CHANGE
            implicit = inertia[rows] - duration * np.minimum(slope, 0.0)[:, :, None] * np.eye(q.shape[1])
            change = np.linalg.solve(implicit, -residual[:, :, None])[:, :, 0]
            residual_after, resisting = imbalance(dq + change, rows)
            begin, end = (np.einsum("si,si->s", change, residual_at) for residual_at in (residual, residual_after))
            overshoots = end > -MAX_SLOPE_RATIO * begin
            if np.any(overshoots):
                change[overshoots] *= (begin[overshoots] / (begin[overshoots] - end[overshoots]))[:, None]
                residual_after[overshoots], resisting[overshoots] = imbalance(
                    dq[overshoots] + change[overshoots], rows[overshoots]
                )
            velocity[rows] = dq + change
            active = np.any(np.abs(change) > MAX_VELOCITY_ERROR, axis=1)
            rows, residual, resisting = rows[active], residual_after[active], resisting[active]
            if not rows.size:
                break
        return velocity

    def _resistance(self, time: Array, q: Array, driving: Array, servo: Servo | None) -> Callable[[Array, Rows], Array]:
        """Torque of servos, friction and loads by velocities in some rows, at their positions, ``(s, n)`` [N m]."""
        arm, with_drive = self._arm, self._with_drive

        def friction(dq: Array, rows: Rows) -> Array:
            if servo is None:
                return arm.friction.torque(dq, driving[rows]) if with_drive else np.zeros_like(dq)
            servo_torque = servo(time[rows], q[rows], dq)
            return servo_torque + (arm.friction.torque(dq, driving[rows] + servo_torque) if with_drive else 0.0)

        if not arm.loads:
            return friction
        jacobian = np.array([self.model.jacobian(row)[:3] for row in q])
        positions = np.array([self.model.placement(row).translation for row in q])

        def torque(dq: Array, rows: Rows) -> Array:
            drive_torque = friction(dq, rows)
            state = LoadState(
                time=time[rows],
                joint_position=q[rows],
                joint_velocity=dq,
                position=positions[rows],
                velocity=np.einsum("kan,kn->ka", jacobian[rows], dq),
                impact_position=arm.impact_position,
                joint_torque=driving[rows] + drive_torque,
            )
            on_links, on_motors = arm.load_torques(state, jacobian[rows])
            return drive_torque + on_links + (on_motors if with_drive else 0.0)

        return torque
