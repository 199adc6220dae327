# SPDX-License-Identifier: Apache-2.0
"""The torque of an arm without a controller: carry its weight, and come to rest.

    tau = g(q) - s (M(q) + B) dq / T,   s = min(1, min_i SHARE tau_max_i / |(M + B) dq / T|_i)

B is the inertia of the motors that the torque loop leaves. Joint velocities decay with the time constant T, whatever
the arm; without B a wrist, whose motor is heavier than its link, would take fifteen times as long. A brake that asks
for too much is scaled as a whole: its power, -s dq^T (M + B) dq / T, is never positive, which limiting joint by joint
would not ensure. A delay d turns the decay into dq' = -dq(t - d) / T, which does not oscillate for d <= T / e and
diverges for d > pi T / 2 (Hayes, J. London Math. Soc. 25, 1950): a brake on old states is worse than none.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

SETTLE = 0.1  # s, time constant T
SHARE = 0.5  # of the torque limits, that the brake takes at most; the other half carries weight
FRESH = 0.03  # s, that the state of a brake may be old; below T / e


def holding_torque(model: RobotModel, motor_inertia: Array, position: Array, velocity: Array) -> Array:
    """Torque of the module text, ``(n,)`` [N m].

    Args:
        model: The arm.
        motor_inertia: B that the torque loop leaves, ``(n,)`` [kg m^2].
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """
    brake = (model.mass_matrix(position) @ velocity + motor_inertia * velocity) / SETTLE
    excess = float(np.max(np.abs(brake) / (SHARE * model.torque_max)))
    torque = model.gravity_torque(position) - brake / max(1.0, excess)
    return np.asarray(np.clip(torque, -model.torque_max, model.torque_max))
