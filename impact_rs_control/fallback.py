# SPDX-License-Identifier: Apache-2.0
"""What an arm is told where its controller has nothing to say: hold against gravity, and come to rest.

    tau = g(q) - M(q) dq / T

With it joint velocities decay with the time constant T, whatever the arm; the torque stays within the limits.
"""

from __future__ import annotations

import numpy as np

from impact_rs_control.controller import ArmCommand, Mode
from impact_rs_control.qp import QpStatus
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

SETTLE = 0.1  # s, time constant T


def holding_torque(model: RobotModel, position: Array, velocity: Array) -> Array:
    """Torque of the module text, ``(n,)`` [N m].

    Args:
        model: The arm.
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """
    torque = model.gravity_torque(position) - model.mass_matrix(position) @ velocity / SETTLE
    return np.asarray(np.clip(torque, -model.torque_max, model.torque_max))


def fallback_command(model: RobotModel, position: Array, velocity: Array, tasks: int) -> ArmCommand:
    """The same as a command; its QP counts as failed.

    Args:
        model: The arm.
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
        tasks: Number of task accelerations that the arm's controller follows.
    """
    terms = model.terms(position, velocity)
    return ArmCommand(
        torque=holding_torque(model, position, velocity),
        mode=Mode.ANTE,
        gamma=0.0,
        position=terms.position.copy(),
        twist=terms.twist,
        task_feedback=np.zeros(tasks),
        net_feedback=np.zeros(3),
        wrench=np.zeros(6),
        qp_status=QpStatus.FAILED,
        qp_iterations=0,
        qp_solve_time=0.0,
        detection=None,
    )
