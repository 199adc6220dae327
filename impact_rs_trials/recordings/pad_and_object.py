# SPDX-License-Identifier: Apache-2.0
"""Pad and object of a hit: the frame of the motion capture, and whether they meet."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.checks.joint_jumps import impact_time
from impact_rs_trials.recordings.checks.plausibility import FIRST_POSE_S, check_object, check_touch, height_on_support
from impact_rs_trials.recordings.contact_frame import CARRIED_S, FLAT_CONTACT_S, PadOnFace
from impact_rs_trials.recordings.experiment import MotionCapture, RunRow
from impact_rs_trials.recordings.joint_clock import on_clock_of_joints
from impact_rs_trials.recordings.laboratory import ArmSeries, Laboratory
from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.remarks import remark
from impact_rs_trials.recordings.run_pieces import MIN_POSE_RATE_HZ

logger = logging.getLogger(__name__)


def touches_of(task: tuple[Laboratory, RunRow]) -> list[PadOnFace]:
    """Pad and face of every arm in a hit, for the estimate of the motion-capture frame; empty if it cannot be read."""
    laboratory, run = task
    wanted: tuple[SignalName, ...] = ("position", "velocity", *OBJECT_SIGNALS)
    try:
        arms = on_clock_of_joints(laboratory, run, wanted, wanted[:2], [])
        pose = arms[laboratory.tracker].get("object_pose")
        cleaned = {arm: laboratory.without_faults(arm, series, run.hit)[0] for arm, series in arms.items()}
        touches = [_touch(laboratory, run, arm, series, pose) for arm, series in cleaned.items()]
    except InputError as error:
        logger.debug("%s: not used to place the motion capture: %s", run.name, error)
        return []
    # Arms that clamp an object move towards each other; the object moves with their mean.
    mean_displacement = np.mean([touch.pad_displacement for touch in touches], axis=0)
    return [replace(touch, pad_displacement=mean_displacement) for touch in touches]


def _touch(laboratory: Laboratory, run: RunRow, arm: str, series: ArmSeries, pose_series: Series | None) -> PadOnFace:
    """Pad and face of one arm in a hit."""
    assert run.object is not None
    joints, model = series["position"], laboratory.models[arm]
    if pose_series is None or pose_series.time.size < 2:
        raise InputError("the object was not tracked", file=run.path)
    motion_capture = laboratory.motion_capture
    tilted = motion_capture.model_copy(update={"position": (0.0, 0.0, 0.0), "rpy": (*motion_capture.rpy[:2], 0.0)})
    pose = in_inertial_frame(tilted, run, pose_series.values)  # with roll and pitch, which hits do not determine
    impact = impact_time(joints, series["velocity"])
    first, last = (impact + moment for moment in FLAT_CONTACT_S)
    times = pose_series.time[(pose_series.time >= first) & (pose_series.time <= last)]
    times = times if times.size else np.array([0.5 * (first + last)])
    pads = [model.placement(q) for q in joints.at(times)]
    in_tilted_frame = replace(pose_series, values=pose)
    objects = [pin.XYZQUATToSE3(row) for row in in_tilted_frame.at(times)]
    initial_pose = np.median(pose[pose_series.time <= pose_series.time[0] + FIRST_POSE_S], axis=0)
    size = np.array(laboratory.scenario.object(run.object).size)
    ends = np.array([impact, min(impact + CARRIED_S, float(joints.time[-1]), float(pose_series.time[-1]))])
    pad_displacement = np.diff([model.placement(q).translation[:2] for q in joints.at(ends)], axis=0)[0]
    return PadOnFace(
        run=run.name,
        pad=np.array([pad.translation for pad in pads]),
        pad_normal=np.array([pad.rotation[:, 2] for pad in pads]),
        position=np.array([placement.translation for placement in objects]),
        rotation=np.array([placement.rotation for placement in objects]),
        size=size,
        standing=height_on_support(laboratory.scenario, run.object, pin.XYZQUATToSE3(pose[0]).rotation),
        standing_height=float(initial_pose[2]),
        pad_displacement=pad_displacement,
        object_displacement=np.diff(in_tilted_frame.at(ends)[:, :2], axis=0)[0],
    )


def in_inertial_frame(motion_capture: MotionCapture, run: RunRow, pose: Array) -> Array:
    """Poses of the object in A, ``(p, 7)``, from poses of the tracked frame in the world of the motion capture.

    Args:
        motion_capture: Where its world is, and the object in the frame that is tracked.
        run: Knows the object.
        pose: As tracked, ``(p, 7)``.
    """
    assert run.object is not None
    world = motion_capture.placement
    body = motion_capture.bodies.get(run.object)
    inner = pin.SE3.Identity() if body is None else body.placement
    placed = np.empty_like(pose)
    for row, numbers in enumerate(pose):
        quaternion = numbers[3:] / np.linalg.norm(numbers[3:])
        placement = world * pin.SE3(pin.Quaternion(quaternion).matrix(), numbers[:3]) * inner
        placed[row] = pin.SE3ToXYZQUAT(placement)
        if row and placed[row, 3:] @ placed[row - 1, 3:] < 0.0:  # the same attitude has two quaternions
            placed[row, 3:] *= -1.0
    return placed


def check_object_of_run(
    laboratory: Laboratory, run: RunRow, arm: str, time: Array, position: Array, object_time: Array, pose: Array
) -> list[str]:
    """Check that the object rests on the support and that the pad of an arm reaches it; returns warnings."""
    assert run.object is not None
    scenario = laboratory.scenario
    remarks = check_object(run.path, scenario, arm, run.object, object_time, pose)
    overlap = (object_time >= time[0]) & (object_time <= time[-1])
    if not np.any(overlap):
        return remarks
    position_at_poses = np.column_stack([np.interp(object_time[overlap], time, column) for column in position.T])
    model = laboratory.models[arm]
    touch_warnings = check_touch(run.path, scenario, model, run.object, position_at_poses, pose[overlap])
    slow_tracker = object_time.size > 1 and float(np.median(np.diff(object_time))) > 1.0 / MIN_POSE_RATE_HZ
    if slow_tracker:  # which does not record where pad and object meet
        return remarks
    return [*remarks, *(remark("{}{}", laboratory.label(arm), warning) for warning in touch_warnings)]
