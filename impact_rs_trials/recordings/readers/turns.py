# SPDX-License-Identifier: Apache-2.0
"""Continuous angles of joints whose controller reports 0 ... 360 or -180 ... 180 degrees.

A reported angle jumps by a full turn where the joint passes the end of that range. The step is impossible at the
velocity limit of the joint, and possible without the turn. A joint with other steps above half a turn has a fault, and
stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_trials.recordings.readers.series import Series

TURN = 2.0 * np.pi
MAX_STEP_RAD = 0.1  # between two samples in addition to the velocity limit: noise
ROUNDING_RAD = 1e-6


def unwrapped(series: Series, facts: RobotFacts, measured: Series | None = None) -> Series:
    """Joint positions without jumps by a full turn, and a warning; unchanged without a jump.

    The turn is the one within the joint limits. A joint that does not jump may be a turn above them, if all joints that
    turn are within 0 ... 360 degrees.

    Args:
        series: Positions, or desired positions, ``(k, n)`` [rad, m].
        facts: Has joint types and limits.
        measured: Positions, to which desired positions are nearest; None: they are positions.
    """
    turning = [joint for joint, kind in enumerate(facts.joint_types) if kind == "revolute"]
    reported = series.values[:, turning]
    in_one_turn = not np.any((reported < -ROUNDING_RAD) | (reported > TURN + ROUNDING_RAD))
    limits, values, changed = facts.limits, series.values.copy(), []
    for joint in turning:
        rows = np.isfinite(series.values[:, joint])
        time, wrapped = series.time[rows], series.values[rows, joint]
        angle = _continuous(time, wrapped, limits.velocity_rad_s[joint])
        if angle is None or not (in_one_turn or np.any(angle != wrapped)):
            continue
        if measured is None:
            least = limits.position_min_rad[joint] - angle.min()
            most = limits.position_max_rad[joint] - angle.max()
        else:
            least = most = float(np.nanmedian(measured.values[:, joint] - np.interp(measured.time, time, angle)))
        values[rows, joint] = angle + min((0.0, -TURN, TURN), key=lambda turn: max(least - turn, turn - most, 0.0))
        if np.any(values[rows, joint] != wrapped):
            changed.append(str(joint + 1))
    if not changed:
        return series
    noun = "joints" if len(changed) > 1 else "joint"
    text = f"angles of {noun} {', '.join(changed)} are reported within one turn: unwrapped, within the joint limits"
    return replace(series, values=values).with_remark("{}: {}", text)


def _continuous(time: Array, wrapped: Array, speed: float) -> Array | None:
    """An angle without jumps by a full turn, ``(k,)`` [rad]; None: it has other jumps.

    Args:
        time: Timestamps, ``(k,)`` [s].
        wrapped: The angle as reported, ``(k,)`` [rad].
        speed: Velocity limit [rad/s].
    """
    if wrapped.size < 2:
        return None
    steps, largest = np.diff(wrapped), MAX_STEP_RAD + speed * np.abs(np.diff(time))
    turns = np.where(np.abs(steps) > np.maximum(0.5 * TURN, largest), np.sign(steps), 0.0)
    if np.any((turns != 0.0) & (np.abs(steps - TURN * turns) > largest)):
        return None
    return np.asarray(wrapped - TURN * np.append(0.0, np.cumsum(turns)))
