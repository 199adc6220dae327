# SPDX-License-Identifier: Apache-2.0
"""Fallback torque of an arm without a controller: gravity compensation and a brake.

    tau = g(q) - s (M(q) + B) dq / T,   s = min(1, min_i a tau_max_i / |(M + B) dq / T|_i)

B is the motor inertia that the torque loop leaves, a = ``MAX_BRAKE_SHARE`` the share of the torque limits for the
brake. Joint velocities decay with the time constant T on every arm; without B a wrist, whose motor has more inertia
than its link, would take fifteen times as long. A braking torque beyond its share is scaled as a vector: its power, -s
dq^T (M + B) dq / T, is then never positive, which clipping joint by joint would not ensure. A delay d turns the decay
into dq' = -dq(t - d) / T, which does not oscillate for d <= T / e and diverges for d > pi T / 2 (Hayes, J. London Math.
Soc. 25, 1950): a brake on old states is worse than none.
"""

from __future__ import annotations

import math

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel

SETTLING_TIME_S = 0.1  # time constant T
MAX_BRAKE_SHARE = 0.5  # of the torque limits; the other half carries the gravity torque
MAX_STATE_AGE_S = 0.03  # of the state that a brake acts on; below T / e


def holding_torque(model: RobotModel, motor_inertia: Array, position: Array, velocity: Array) -> Array:
    """Gravity compensation plus brake, as in the module docstring, ``(n,)`` [N m].

    Args:
        model: The arm.
        motor_inertia: B that the torque loop leaves, ``(n,)`` [kg m^2].
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """
    brake = (model.mass_matrix(position) @ velocity + motor_inertia * velocity) / SETTLING_TIME_S
    excess = float(np.max(np.abs(brake) / (MAX_BRAKE_SHARE * model.torque_max)))
    torque = model.gravity_torque(position) - brake / max(1.0, excess)
    return np.asarray(np.clip(torque, -model.torque_max, model.torque_max))


def braked_state(position: Array, velocity: Array, elapsed: float) -> tuple[Array, Array]:
    """Position and velocity of a braked arm after ``elapsed`` [s], dq' = -dq / T, ``(n,)`` [rad], [rad/s] each.

    The total braking impulse on this prediction is at most (M + B) dq. On the last measured state it would grow without
    bound.
    """
    decay = math.exp(-elapsed / SETTLING_TIME_S)
    return position + SETTLING_TIME_S * (1.0 - decay) * velocity, decay * velocity
