# SPDX-License-Identifier: Apache-2.0
"""Limits of a real arm: plausibility of measured states, and limits and rate of commanded torques.

A state or torque beyond a limit is reported, and the caller stops the arm. The torque rate is limited instead:

    |tau_k - tau_(k-1)| <= rate (t_k - t_(k-1))

A torque may jump when the references change at an impact, and a robot that refuses jumps would end every trial there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel

TORQUE_ROUNDING_NM = 1e-6  # by which a torque at its limit may exceed it
MAX_MEASURED_TORQUE_RATIO = 5.0  # measured torque over torque limit; link-side sensors see the peak of an impact


def state_complaint(model: RobotModel, joints: Sequence[str], position: Array, velocity: Array, torque: Array) -> str:
    """Joint beyond its limits, and by how much; empty if all are within.

    Args:
        model: The arm.
        joints: Names of its joints.
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
        torque: Measured, ``(n,)`` [N m].
    """
    inside = (model.position_min <= position) & (position <= model.position_max)  # false for NaN
    for index in np.flatnonzero(~inside).tolist():
        unit = model.facts.units[index].position
        least, greatest = model.position_min[index], model.position_max[index]
        return f"{joints[index]} at {position[index]:.4g} {unit}, limits {least:.4g} to {greatest:.4g} {unit}"
    for index in np.flatnonzero(~(np.abs(velocity) <= model.velocity_max)).tolist():
        unit = model.facts.units[index].velocity
        return f"{joints[index]} at {velocity[index]:.4g} {unit}, limit {model.velocity_max[index]:.4g} {unit}"
    for index in np.flatnonzero(~(np.abs(torque) <= MAX_MEASURED_TORQUE_RATIO * model.torque_max)).tolist():
        unit, limit = model.facts.units[index].effort, model.torque_max[index]
        excess = f"more than {MAX_MEASURED_TORQUE_RATIO:g} times its limit of {limit:.4g} {unit}"
        return f"{joints[index]} measures {torque[index]:.4g} {unit}, {excess}"
    return ""


def torque_complaint(model: RobotModel, joints: Sequence[str], torque: Array) -> str:
    """Joint whose commanded torque exceeds its limit; empty if all are within.

    Args:
        model: The arm.
        joints: Names of its joints.
        torque: With gravity, ``(n,)`` [N m].
    """
    for index in np.flatnonzero(~(np.abs(torque) <= model.torque_max + TORQUE_ROUNDING_NM)).tolist():
        unit = model.facts.units[index].effort
        return f"torque of {torque[index]:.4g} {unit} for {joints[index]}, limit {model.torque_max[index]:.4g} {unit}"
    return ""


def rate_limited(torque: Array, previous: Array, largest_change: float) -> Array:
    """Torque nearest to the desired one that respects the rate limit, ``(n,)`` [N m].

    Args:
        torque: Desired torque, ``(n,)`` [N m].
        previous: Last commanded torque, ``(n,)`` [N m].
        largest_change: Rate limit times the time since the last command [N m].
    """
    return previous + np.clip(torque - previous, -largest_change, largest_change)
