# SPDX-License-Identifier: Apache-2.0
"""Checks of a run against its mapping: units and signs, joints in a hit, and the clocks of joints and object."""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS, ClocksApart, clocks_apart
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.checks.joint_jumps import MIN_JUMP_SHARE, jumps_of
from impact_rs_trials.recordings.importing.hypotheses import (
    Role,
    RoleChoice,
    choose,
    positions,
    torques,
    velocities,
)
from impact_rs_trials.recordings.joint_motion import JointMotion
from impact_rs_trials.recordings.mapping import REQUIRED, Mapping, SignalName
from impact_rs_trials.recordings.readers.series import Names, Series
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.runs import ArmSignals

MAX_CHECKED_SAMPLES = 20_000
MIN_CHECKED_SAMPLES = 20
MIN_OBJECT_DISPLACEMENT_M = 0.005  # of an object that was hit
SI = {"rad", "m", "rad/s", "m/s", "N m", "N"}


def mapping_warning(path: Path, mapping: Mapping, names: Names, model: RobotModel) -> str | None:
    """Contradiction between a mapping and the joints of a run.

    Args:
        path: The run.
        mapping: Describes it.
        names: Values of the placeholders of the mapping.
        model: Of the robot.

    Returns:
        The contradiction in words; None: consistent.

    Raises:
        InputError: The run cannot be read.
    """
    needed: tuple[SignalName, ...] = ("position",) if mapping.servo is not None else ("position", "torque")
    read = read_series(path, mapping, (*needed, "velocity"), needed, names)
    rows = usable_rows(read["position"])
    time, q = read["position"].time[rows], read["position"].values[rows]
    if rows.size <= MIN_CHECKED_SAMPLES:
        return f"{rows.size} samples of the positions can be used"
    dq, tau = read["velocity"].at(time), read["torque"].at(time) if "torque" in read else np.zeros_like(q)
    if not np.isfinite(np.hstack((dq, tau))).all():
        return None
    position = choose(positions(q, model.facts), -np.inf)
    if position is None or not _is_si(position.best.unit):
        in_other_unit = f" but in {position.best.unit}" if position else ""
        return f"its positions do not lie within the limits of the joints{in_other_unit}"
    motion = JointMotion.of(time, q, dq, model)
    velocity = choose(velocities(motion, motion.sampled(dq))) if "velocity" in mapping.signals else None
    if velocity is not None and _contradicts(velocity, "velocity"):
        return f"the velocities are {velocity.best.evidence}"
    torque = choose(torques(motion, motion.sampled(tau)))
    if torque is not None and _contradicts(torque, "torque"):
        return f"as described its torques are {torque.best.evidence}"
    return None


def _contradicts(choice: RoleChoice, role: Role) -> bool:
    """Whether numbers in SI units surely have another unit or sign."""
    best = choice.best
    return choice.sure and best.role == role and (not _is_si(best.unit) or "factor" in best.further)


def _is_si(unit: Any) -> bool:
    """Whether a unit, or the units of all joints, are SI units."""
    return ({unit} if isinstance(unit, str) else set(unit)) <= SI


def usable_rows(series: Series) -> NDArray[np.signedinteger]:
    """Indices of the rows with finite values and increasing timestamps, up to the number of checked samples."""
    usable = np.isfinite(series.values).all(axis=1) & np.isfinite(series.time)
    latest = np.fmax.accumulate(np.where(np.isfinite(series.time), series.time, -np.inf))
    usable &= np.diff(latest, prepend=-np.inf) > 0.0
    return np.flatnonzero(usable)[:MAX_CHECKED_SAMPLES]


def travel_of(path: Path, mapping: Mapping, names: Names) -> float | None:
    """Largest displacement of the object of a run from its initial position [m]; None: not recorded.

    Args:
        path: The run.
        mapping: Describes it.
        names: Values of the placeholders of the mapping.

    Raises:
        InputError: The run cannot be read.
    """
    name: SignalName = "object_pose" if "object_pose" in mapping.signals else "object_position"
    read = read_series(path, mapping, [name], [], names).get(name)
    if read is None or not (tracked := np.isfinite(read.values).all(axis=1)).any():
        return None
    track = read.values[tracked, :3]
    return float(np.max(np.linalg.norm(track - np.median(track[:5], axis=0), axis=1)))


def object_moves(path: Path, mapping: Mapping, names: Names) -> bool:
    """Whether the object of a run was recorded and moves; see :func:`travel_of`."""
    return (travel_of(path, mapping, names) or 0.0) > MIN_OBJECT_DISPLACEMENT_M


def impact_warnings(read: AbstractMapping[SignalName, Series], mapping: Mapping) -> list[str]:
    """Warnings about the joints of a run with an impact.

    Args:
        read: Its signals, with position and torque.
        mapping: Describes it.
    """
    if mapping.servo is not None:  # the torque of servos is not compared in contact
        return []
    time = read["position"].time
    signals = {name: read[name].at(time) for name in REQUIRED if name in read}
    if "velocity" not in signals:
        signals["velocity"] = read["position"].derivative().values
    arm = ArmSignals(signals["position"], signals["velocity"], signals["torque"])
    return arm_warnings(time, arm, mapping, mapping.robot_model(), contact=True)


def clocks_of(path: Path, mapping: Mapping, names: Names) -> ClocksApart | None:
    """Offset between the clocks of joints and object of a run.

    Args:
        path: The run.
        mapping: Describes it.
        names: Values of the placeholders of the mapping.

    Returns:
        The offset; None: no evidence, or the run cannot be read.
    """
    wanted: list[SignalName] = ["position", *(name for name in OBJECT_SIGNALS if name in mapping.signals)]
    try:
        read = read_series(path, mapping, wanted, wanted, names)
    except InputError:
        return None
    position, pose = read["position"], read["object_pose" if "object_pose" in read else "object_position"]
    usable = np.isfinite(pose.values).all(axis=1)
    pose = replace(pose, time=pose.time[usable], values=pose.values[usable])
    return clocks_apart(pose, position, list(jumps_of(position, MIN_JUMP_SHARE)), path) if usable.any() else None
