# SPDX-License-Identifier: Apache-2.0
"""Arms in free motion, several copies at a time: the links of :mod:`impact_rs_sim.mechanics` without Bullet.

    ddq = ABA(q, dq, tau),    dq += h ddq,    q += h dq                     (Featherstone; Bullet's own order of steps)

Stretches of a measured motion that start in different states are independent of each other and have the same physics:
one array for all of them costs the torque loop as much as one stretch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.drive import Drive, DriveStart, LinkTorque
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState


@dataclass(frozen=True)
class FreeStretch:
    """Input of one copy of an arm.

    Attributes:
        arm: Initial state of the links.
        drive: Initial state of the drive.
        torque: Driving torque of every period of the torque loop, ``(s, n)`` [N m].
        time: Start time, for loads that depend on it [s].
    """

    arm: ArmState
    drive: DriveStart
    torque: Array
    time: float


@dataclass(frozen=True)
class FreePath:
    """Resulting motion of one arm, at every tick; arrays are ``(k, n)``.

    Attributes:
        position: q [rad].
        velocity: dq [rad/s].
        torque: tau_J [N m].
        motor_position: theta [rad].
        motor_velocity: dtheta [rad/s].
    """

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array
    motor_velocity: Array


def run_free(
    physics: Physics,
    arm: str,
    stretches: Sequence[FreeStretch],
    period: float,
    substeps: int,
    drive: type[Drive] | type[LinkTorque] = Drive,
) -> list[FreePath]:
    """Move copies of one arm.

    Args:
        physics: Parameters of the scene; the actuation delay is ignored, because the torques are those that arrive.
        arm: Name of the arm.
        stretches: Copies, with the same number of periods.
        period: Period of the torque loop [s].
        substeps: Periods from tick to tick.
        drive: Torque loop, or measured torque without one.
    """
    model = physics.robot_model(arm)
    links, loaded = model.chain, bool(physics.arms[arm].loads)
    motors = drive(replace(physics.arms[arm], actuation_delay=0.0), period)
    link = ArmState(
        np.array([one.arm.position for one in stretches]), np.array([one.arm.velocity for one in stretches])
    )
    torque = np.array([one.drive.torque for one in stretches])
    motors.start(link, DriveStart(torque, np.array([one.drive.torque_rate for one in stretches])))
    torques = np.stack([one.torque for one in stretches], axis=1)
    ticks = torques.shape[0] // substeps + 1
    kept = np.empty((5, ticks, *torque.shape))
    on_links, on_motors = np.zeros_like(torque), np.zeros_like(torque)
    for tick in range(ticks):
        kept[:, tick] = link.position, link.velocity, motors.elastic_torque, motors.position, motors.velocity
        if tick + 1 == ticks:
            break
        if loaded:
            for row, one in enumerate(stretches):
                now = one.time + tick * substeps * period
                on_links[row], on_motors[row] = physics.load_torques(
                    arm, model, now, link.position[row], link.velocity[row]
                )
            motors.load(on_motors)
        link = motors.step_free(links, link, torques[tick * substeps : (tick + 1) * substeps], on_links)
    return [FreePath(*kept[:, :, row]) for row in range(len(stretches))]
