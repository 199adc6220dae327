# SPDX-License-Identifier: Apache-2.0
"""What stands between a controller and a real arm: is the state within the arm's limits, and is the torque?

State and torque beyond a limit are told, and whoever asked stops the arm. The rate of a torque is limited instead:

    |tau_k - tau_(k-1)| <= rate * period

A torque may jump when the references change at an impact, and a robot that refuses jumps would end every trial there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

ROUNDING = 1e-6  # N m, that a torque at its limit may be beyond it


def state_complaint(model: RobotModel, joints: Sequence[str], position: Array, velocity: Array) -> str:
    """Which joint is beyond its limits, and how far; empty: none.

    Args:
        model: The arm.
        joints: Names of its joints.
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """
    inside = (model.position_min <= position) & (position <= model.position_max)  # a NaN is nowhere inside
    for index in np.flatnonzero(~inside).tolist():
        unit = model.facts.units[index].position
        least, greatest = model.position_min[index], model.position_max[index]
        return f"{joints[index]} at {position[index]:.4g} {unit}, limits {least:.4g} to {greatest:.4g} {unit}"
    for index in np.flatnonzero(~(np.abs(velocity) <= model.velocity_max)).tolist():
        unit = model.facts.units[index].velocity
        return f"{joints[index]} at {velocity[index]:.4g} {unit}, limit {model.velocity_max[index]:.4g} {unit}"
    return ""


def torque_complaint(model: RobotModel, joints: Sequence[str], torque: Array) -> str:
    """Which joint is asked for more than it may give; empty: none.

    Args:
        model: The arm.
        joints: Names of its joints.
        torque: With gravity, ``(n,)`` [N m].
    """
    for index in np.flatnonzero(~(np.abs(torque) <= model.torque_max + ROUNDING)).tolist():
        unit = model.facts.units[index].effort
        return f"torque of {torque[index]:.4g} {unit} for {joints[index]}, limit {model.torque_max[index]:.4g} {unit}"
    return ""


def rate_limited(torque: Array, before: Array, largest_change: float) -> Array:
    """The torque nearest to a wanted one that the last one may be followed by, ``(n,)`` [N m].

    Args:
        torque: Wanted, ``(n,)`` [N m].
        before: What was commanded last, ``(n,)`` [N m].
        largest_change: Rate times period [N m].
    """
    return before + np.clip(torque - before, -largest_change, largest_change)
