# SPDX-License-Identifier: Apache-2.0
"""Motor side of the joints, with the torque loop that reduces the motor inertia.

    B_rho ddtheta + tau_J + D K^-1 dtau_J = tau_act + tau_fric,m                              (paper eq. EOM_motor)
    tau_J   = K (theta - q)
    tau_act = B_rho B_theta^-1 tau_d + (I - B_rho B_theta^-1)(tau_J + D K^-1 dtau_J)   (paper eq. torque_control_law)

B_theta is a setting of the loop, not an inertia of the drive: the motor is integrated with B_rho, and the reduced
inertia emerges. One step is one period of the loop; semi-implicit Euler, velocity first.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.physics import ArmPhysics, JointFriction, ShaftFriction
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmState

if TYPE_CHECKING:
    from impact_rs_sim._kernel import Friction, Shafts


@dataclass(frozen=True)
class DriveStart:
    """Initial state of the drive of one arm.

    Attributes:
        torque: tau_J, ``(n,)`` [N m].
        torque_rate: dtau_J, ``(n,)`` [N m/s].
        earlier: Previous commands, time relative to the start (negative) [s] and torque [N m]; a delayed actuation
            still delivers them. If empty, ``torque`` was commanded at all earlier times.
    """

    torque: Array
    torque_rate: Array
    earlier: tuple[tuple[float, Array], ...] = ()


class Drive(_kernel.Motors):
    """Motor side of one arm.

    Returned arrays are copies.

    Args:
        physics: Motor inertias, stiffness, damping, friction and actuation.
        period: Period of the torque loop [s].

    Attributes:
        period: Period of the torque loop [s].
        position: Motor position theta, ``(n,)`` [rad].
        velocity: Motor velocity, ``(n,)`` [rad/s].
        transmission_torque: tau_J + D K^-1 dtau_J, torque on the link, ``(n,)`` [N m].
        elastic_torque: tau_J, torque at the joint torque sensor, ``(n,)`` [N m].
        actuation_torque: tau_act of the last step, ``(n,)`` [N m].
        friction_torque: tau_fric,m of the last step, ``(n,)`` [N m].
    """

    def __init__(self, physics: ArmPhysics, period: float) -> None:
        self._shaping = physics.motor_inertia_rotor / physics.motor_inertia_reduced
        super().__init__(
            physics.stiffness,
            physics.damping,
            1.0 - self._shaping,
            1.0 / physics.motor_inertia_rotor,
            _on_motors(physics.friction, self._shaping),
            period,
        )
        self.period = period
        self._stiffness = physics.stiffness
        self._damping = physics.damping
        self._gain = physics.torque_gain
        self._offset = physics.torque_offset
        self._delay = physics.actuation_delay
        self._clock = 0.0
        self._commands: deque[tuple[float, Array]] = deque()
        self._desired: Array | None = None
        self._shaped = self._load = np.zeros_like(physics.stiffness)

    def reset(self, link_position: Array, load: Array) -> None:
        """Reset to static equilibrium: the spring carries ``load`` ``(n,)`` [N m] at link position ``(n,)`` [rad]."""
        still = np.zeros_like(load)
        self.start(ArmState(link_position, still), DriveStart(load, still))

    def start(self, link: ArmState, drive: DriveStart) -> None:
        """Set the initial state: spring torque ``drive.torque`` and its rate ``drive.torque_rate``."""
        self.place(
            link.position + drive.torque / self._stiffness,
            link.velocity + drive.torque_rate / self._stiffness,
            drive.torque,
            drive.torque + self._damping / self._stiffness * drive.torque_rate,
        )
        self._desired = None
        self._clock = 0.0
        self._commands.clear()
        self._commands.extend(drive.earlier or ((-np.inf, drive.torque),))

    def load(self, torque: Array) -> None:
        """Set a further torque on the motors, ``(n,)`` [N m]; scaled by B_rho / B_theta as friction is."""
        self._load = torque
        self._desired = None

    def step(self, desired: Array) -> None:
        """One period of the torque loop with desired torque ``(n,)`` [N m]; call :meth:`sense` first."""
        if self._delay > 0.0:
            desired = self._delayed(desired)
        if desired is not self._desired:  # the command is held over several periods of the loop
            self._desired = desired
            self._shaped = self._driving(desired)
        self.integrate(self._shaped)

    def _driving(self, desired: Array) -> Array:
        """Torque on the motor due to desired torque and load, times B_rho / B_theta [N m]."""
        return np.asarray(self._shaping * (self._gain * desired + self._offset + self._load))

    def _delayed(self, desired: Array) -> Array:
        """Mean of the piecewise constant commands over the period that began ``delay`` ago, ``(n,)`` [N m]."""
        commands = self._commands
        if not commands:
            commands.append((-np.inf, desired))
        if commands[-1][1] is not desired:
            commands.append((self._clock, desired))
        start = self._clock - self._delay
        end = start + self.period
        self._clock += self.period
        while len(commands) > 1 and commands[1][0] <= start:
            commands.popleft()
        total = np.zeros_like(desired)
        for number, (since, torque) in enumerate(commands):
            until = commands[number + 1][0] if number + 1 < len(commands) else np.inf
            overlap = min(until, end) - max(since, start)
            if overlap > 0.0:
                total += overlap / self.period * torque
        return total


def _on_motors(friction: JointFriction, shaping: Array) -> Friction | None:
    """tau_fric,m = B_rho B_theta^-1 tau_fric, in the form of the kernel; None: no friction."""
    if friction.is_zero:
        return None
    sigmoid, zeros = friction.sigmoid, np.zeros_like(shaping)
    return (
        shaping * friction.coulomb,
        shaping * friction.viscous,
        shaping * friction.stribeck,
        friction.stribeck_velocity,
        zeros + friction.smoothing,
        zeros if friction.asymmetry is None else shaping * friction.asymmetry,
        zeros if friction.load is None else shaping * friction.load,
        None if sigmoid is None else (shaping * sigmoid.a, np.array(sigmoid.b), np.array(sigmoid.c)),
        _shafts(friction.shafts, shaping) if friction.shafts else None,
    )


def _shafts(shafts: Sequence[ShaftFriction], shaping: Array) -> Shafts:
    """Friction of shafts in the form of the kernel."""
    return (
        np.concatenate([shaft.coulomb for shaft in shafts]),
        np.concatenate([shaft.viscous for shaft in shafts]),
        np.concatenate([np.full(shaft.viscous.size, shaft.ratio) for shaft in shafts]),
        shaping,
    )
