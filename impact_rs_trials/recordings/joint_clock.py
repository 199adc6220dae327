# SPDX-License-Identifier: Apache-2.0
"""Signals of a run on the clock of its joint positions, with the pose of the object as one signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.rotations import MAX_NORM_ERROR
from impact_rs_trials.bags.types import STAMP_ROUNDING_S
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS, on_one_clock, shifted_to_impact
from impact_rs_trials.recordings.experiment import RunRow
from impact_rs_trials.recordings.laboratory import ArmSeries, Laboratory
from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.readers.clock import MAX_GRID_ERROR_PERIODS
from impact_rs_trials.recordings.remarks import remark


def with_object(path: Path, series: ArmSeries, remarks: list[str]) -> ArmSeries:
    """Signals with the pose as one signal, without the samples in which the object was not tracked.

    Args:
        path: File, for messages.
        series: Signals of an arm, or of an object alone.
        remarks: Warnings, appended to.

    Raises:
        InputError: Position and quaternion have different stamps, quaternions no unit length, or the object is never
            tracked.
    """
    series = dict(series)
    position, quaternion = series.pop("object_position", None), series.pop("object_quaternion", None)
    if position is not None and quaternion is not None:
        period = float(np.ptp(position.time)) / max(position.time.size - 1, 1)
        closest = max(MAX_GRID_ERROR_PERIODS * period, STAMP_ROUNDING_S)
        if position.time.size != quaternion.time.size or not np.allclose(
            position.time, quaternion.time, rtol=0.0, atol=closest
        ):
            raise InputError(
                f"{position.label} and {quaternion.label} have different time stamps; expected the same", file=path
            )
        values = np.hstack((position.values, quaternion.values))
        series["object_pose"] = replace(position, values=values)
    pose = series.get("object_pose")
    if pose is None:
        return series
    norm = np.linalg.norm(pose.values[:, 3:], axis=1)
    tracked = ~(np.isnan(pose.values[:, :3]).all(axis=1) | np.isnan(pose.values[:, 3:]).all(axis=1) | (norm == 0.0))
    if not np.any(tracked):
        raise InputError(f"{pose.label}: the object is not seen in any of {tracked.size} samples", file=path)
    lengths = norm[tracked & np.isfinite(norm)]
    if np.any(np.abs(lengths - 1.0) > MAX_NORM_ERROR):
        raise InputError(
            f"{pose.label}: quaternions have lengths of {lengths.min():.3g} ... {lengths.max():.3g}, expected 1: "
            "columns of something else?",
            file=path,
        )
    if not np.all(tracked):
        words = "{}: the object is not seen in {:d} of {:d} samples"
        remarks.append(remark(words, pose.label, int(np.sum(~tracked)), tracked.size))
    series["object_pose"] = pose.in_rows(tracked)
    return series


def on_clock_of_joints(
    laboratory: Laboratory,
    run: RunRow,
    wanted: Sequence[SignalName],
    needed: Sequence[SignalName],
    remarks: list[str],
) -> dict[str, ArmSeries]:
    """Signals of every arm, all on the clock of its joint positions, with the object's pose as one signal.

    Args:
        laboratory: Knows arms and mappings.
        run: The run.
        wanted: Signals to read, as far as a mapping has them.
        needed: Those of them that must be there.
        remarks: Warnings, appended to.

    Raises:
        InputError: A needed signal is missing, or a signal cannot be used.
    """
    arms = laboratory.series(run, wanted, needed)
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            arms[arm] = on_one_clock(run.path, series, laboratory.mappings[arm], laboratory.models[arm])
    remarks += dict.fromkeys(
        warning for series in arms.values() for signal in series.values() for warning in signal.remarks
    )
    if run.hit:
        arms[laboratory.tracker] = with_object(run.path, arms[laboratory.tracker], remarks)
        _start_in_the_impact(laboratory, run, arms, remarks)
    return arms


def _start_in_the_impact(laboratory: Laboratory, run: RunRow, arms: dict[str, ArmSeries], remarks: list[str]) -> None:
    """Bring the object's pose to the clock of the joints, where it has one of its own."""
    tracker, mapping = laboratory.tracker, laboratory.mappings[laboratory.tracker]
    name = next((name for name in OBJECT_SIGNALS if name in mapping.signals), None)
    if "object_pose" not in arms[tracker] or name is None or mapping.signals[name].clock == "shared":
        return
    pose = arms[tracker]["object_pose"]
    shifted_pose = shifted_to_impact(run.path, pose, arms[tracker]["position"], f"signals.{name}.clock")
    remarks += [warning for warning in shifted_pose.remarks if warning not in pose.remarks]
    arms[tracker] = {**arms[tracker], "object_pose": shifted_pose}
