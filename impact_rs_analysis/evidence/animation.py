# SPDX-License-Identifier: Apache-2.0
"""Motion of a run for the 3D view: arms, object, contact forces, and velocities before and after the impact.

Contact forces are those of the momentum observer (:mod:`impact_rs_control.detection`), for model and measurement alike.
They include errors of the nominal rigid model of the arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_analysis.evidence.aligned import AlignedRun, Track
from impact_rs_analysis.evidence.features import JUMP_BEFORE, JUMP_WINDOWS, OBJECT_WINDOWS, SETTLED
from impact_rs_analysis.evidence.impacts import impacts_of, observe
from impact_rs_analysis.evidence.laboratory import run_of as laboratory_run
from impact_rs_analysis.evidence.torque_balance import Motion
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenario import Scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, JointColumns, TrialBag
from impact_rs_trials.recordings.laboratory import LaboratoryRun

OBJECT = "object"  # name of the object among the arms
AFTER = JUMP_WINDOWS[SETTLED]  # s from the begin of the impact; window of the velocity after it


@dataclass(frozen=True)
class VelocityJump:
    """Velocity of one body before and after the impact.

    Attributes:
        body: Name of the arm, whose end effector it is, or ``object``.
        place: Position of the body at the begin of the impact, in A, ``(3,)`` [m].
        before: Velocity 18 to 3 ms before that, in A, ``(3,)`` [m/s].
        after: Velocity 20 to 40 ms after it, of the object 6 to 40 ms, in A, ``(3,)`` [m/s].
    """

    body: str
    place: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Movement:
    """Motion of arms and object, measured or predicted.

    Attributes:
        joints: Joint positions by arm, ``(k, n)`` [rad].
        rates: Joint velocities by arm, ``(k, n)`` [rad/s]; missing if not known.
        velocities: Velocity of E in A by arm, ``(k, 3)`` [m/s]; missing if not known.
        forces: Contact force of every arm on its environment, at E, axes of A, ``(k, 3)`` [N]; missing if not known.
        object: Position of the object's centre in A [m] and quaternion x y z w, ``(k, 7)``; NaN where not tracked.
        jumps: Velocities before and after the impact.
    """

    joints: dict[str, Array]
    rates: dict[str, Array]
    velocities: dict[str, Array]
    forces: dict[str, Array]
    object: Array
    jumps: tuple[VelocityJump, ...]


@dataclass(frozen=True)
class Animation:
    """A run for the 3D view.

    Attributes:
        label: Name of the run.
        physics: Nominal physics of the scene.
        time: Of the run, ``(k,)`` [s].
        starts: Rows in which a stretch begins; there are no data between two stretches.
        impact: Begin of the first impact [s]; None without an impact.
        measured: The measurement.
        model: The replay from the measured start of every stretch; None without a model.
    """

    label: str
    physics: Physics
    time: Array
    starts: tuple[int, ...]
    impact: float | None
    measured: Movement
    model: Movement | None = None


def animation_of_run(aligned: AlignedRun, label: str) -> Animation:
    """A run beside its replay, window by window."""
    run = aligned.run
    models = run.setup.physics.robot_models()
    sides = [_of_track(aligned, track, models) for track in (aligned.measured, aligned.predicted)]
    return Animation(label, run.setup.physics, aligned.time, aligned.starts, aligned.impact, *sides)


def _of_track(aligned: AlignedRun, track: Track, models: Mapping[str, RobotModel]) -> Movement:
    run, time = aligned.run, aligned.time
    edges = (*aligned.starts, time.size)
    poses = np.full((time.size, 7), np.nan)
    half = 0.5 * track.object_yaw
    poses[:, :3] = track.object_position
    poses[:, 3:] = np.column_stack((0.0 * half, 0.0 * half, np.sin(half), np.cos(half)))
    for window, rows in zip(run.setup.windows, _slices(edges), strict=True):
        if run.hit and not window.contact:  # the object rests where it will be hit
            poses[rows] = [*window.object.position, *quaternion_of(window.object.rotation)]
    forces, velocities = {}, {}
    for name, arm in track.arms.items():
        parts = [
            observe(time[rows], arm.position[rows], arm.velocity[rows], arm.torque[rows], models[name])
            for rows in _slices(edges)
        ]
        forces[name] = -np.concatenate([part.force for part in parts])
        velocities[name] = np.concatenate([part.velocity for part in parts])
    joints = {name: arm.position for name, arm in track.arms.items()}
    rates = {name: arm.velocity for name, arm in track.arms.items()}
    jumps = _jumps(time, joints, velocities, poses, run.impacts, models)
    return Movement(joints, rates, velocities, forces, poses, jumps)


def _slices(edges: Sequence[int]) -> list[slice]:
    return [slice(start, end) for start, end in zip(edges, edges[1:], strict=False)]


def animation_of_motion(label: str, physics: Physics, arm: str, motion: Motion) -> Animation:
    """A recording of free motion, with the joints of one arm only."""
    time, kept = motion.time[motion.kept], motion.kept
    nowhere = np.full((time.size, 7), np.nan)
    moved = Movement({arm: motion.position[kept]}, {arm: motion.velocity[kept]}, {}, {}, nowhere, ())
    return Animation(label, physics, time, (0,), None, moved)


def animation_of_laboratory(item: LaboratoryRun, scenario: Scenario) -> Animation:
    """A laboratory run as measured, stretch by stretch between gaps.

    Args:
        item: The run.
        scenario: Its scene.
    """
    run = laboratory_run(item, scenario)
    models = run.physics.robot_models()
    kept = np.ones(item.time.size, dtype=bool)
    for gap in item.gaps:
        kept &= (item.time <= gap.start) | (item.time >= gap.end)
    time = item.time[kept]
    starts = (0, *(int(np.searchsorted(time, gap.end)) for gap in item.gaps))
    forces, velocities = {}, {}
    for name, own in run.signals.arms.items():
        parts = [
            observe(
                time[rows], own.position[kept][rows], own.velocity[kept][rows], own.torque[kept][rows], models[name]
            )
            for rows in _slices((*starts, time.size))
        ]
        forces[name] = -np.concatenate([part.force for part in parts])
        velocities[name] = np.concatenate([part.velocity for part in parts])
    joints = {name: own.position[kept] for name, own in run.signals.arms.items()}
    rates = {name: own.velocity[kept] for name, own in run.signals.arms.items()}
    poses = _poses_at(time, item.object_time, item.object_position, item.object_quaternion)
    try:
        impacts = {arm: begin for arm, (begin, _) in impacts_of(run).items()} if item.hit else {}
    except InputError:  # no impact: the run is shown all the same
        impacts = {}
    jumps = _jumps(time, joints, velocities, poses, impacts, models)
    return Animation(
        label=item.name,
        physics=run.physics,
        time=time,
        starts=starts,
        impact=min(impacts.values(), default=None),
        measured=Movement(joints, rates, velocities, forces, poses, jumps),
    )


def animation_of_bag(bag: TrialBag) -> Animation:
    """A recorded trial, from the robot's own topics; ``/truth`` is not read.

    Raises:
        BagError: An arm's joint states are missing or damaged.
        InputError: The scenario in the bag cannot be read.
    """
    physics = bag.info.spec.scene.physics
    models = physics.robot_models()
    columns = {arm: _joint_states(bag, arm) for arm in bag.info.robots}
    time = next(iter(columns.values())).time
    joints, rates, forces, velocities = {}, {}, {}, {}
    for arm, own in columns.items():
        joints[arm] = _at(time, own.time, own.position)
        if own.velocity.size and own.effort.size:
            rates[arm] = _at(time, own.time, own.velocity)
            observed = observe(time, joints[arm], rates[arm], _at(time, own.time, own.effort), models[arm])
            forces[arm], velocities[arm] = -observed.force, observed.velocity
    poses = _object_poses(bag, time)
    found = {arm: bag.impact_time(arm) for arm in columns}
    impacts = {arm: moment for arm, moment in found.items() if np.isfinite(moment)}
    jumps = _jumps(time, joints, velocities, poses, impacts, models)
    return Animation(
        label=bag.path.name,
        physics=physics,
        time=time,
        starts=(0,),
        impact=min(impacts.values(), default=None),
        measured=Movement(joints, rates, velocities, forces, poses, jumps),
    )


def _joint_states(bag: TrialBag, arm: str) -> JointColumns:
    topic = topics.joint_states(arm)
    columns = bag.joints(topic)
    if columns.time.size < 2 or not columns.position.size:
        raise BagError(bag.path, f"{topic} has no joint positions")
    if not np.isfinite(columns.position).all() or np.any(np.diff(columns.time) <= 0.0):
        raise BagError(bag.path, f"{topic} has positions that are not finite, or stamps that run backwards")
    return columns


def _object_poses(bag: TrialBag, time: Array) -> Array:
    """Pose of the object at some times, ``(k, 7)``; NaN where it is not tracked."""
    seen = bag.poses(topics.OBJECT_POSE)
    if bag.info.spec.scenario.excursion is not None:
        return np.full((time.size, 7), np.nan)
    flips = np.cumprod(np.where(np.sum(seen.quaternion[1:] * seen.quaternion[:-1], axis=1) < 0.0, -1.0, 1.0))
    turned = seen.quaternion * np.concatenate(([1.0], flips))[: seen.time.size, None]  # q and -q: one orientation
    return _poses_at(time, seen.time, seen.position, turned)


def _poses_at(time: Array, seen: Array, position: Array, quaternion: Array) -> Array:
    """Tracked poses interpolated at some times, ``(k, 7)``; NaN outside the tracked time.

    Args:
        time: Times of the result, ``(k,)`` [s].
        seen: Times of the poses, ``(p,)`` [s].
        position: ``(p, 3)`` [m].
        quaternion: x y z w, without changes of sign between samples, ``(p, 4)``.
    """
    if seen.size < 2:
        return np.full((time.size, 7), np.nan)
    poses = _at(time, seen, np.column_stack((position, quaternion)))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
    period = float(np.median(np.diff(seen)))
    poses[(time < seen[0] - period) | (time > seen[-1] + period)] = np.nan
    return poses


def _at(time: Array, known: Array, values: Array) -> Array:
    return np.column_stack([np.interp(time, known, column) for column in values.T])


def _jumps(
    time: Array,
    joints: Mapping[str, Array],
    velocities: Mapping[str, Array],
    poses: Array,
    impacts: Mapping[str, float],
    models: Mapping[str, RobotModel],
) -> tuple[VelocityJump, ...]:
    """Velocity jumps of every arm that hit, and of the object; none if the windows hold no samples."""
    found = []
    for arm, begin in impacts.items():
        if arm not in velocities:
            continue
        before, after = _within(time, begin, JUMP_BEFORE), _within(time, begin, AFTER)
        row = min(int(np.searchsorted(time, begin)), time.size - 1)
        if before.any() and after.any():
            place = models[arm].placement(joints[arm][row]).translation
            means = [velocities[arm][rows].mean(axis=0) for rows in (before, after)]
            found.append(VelocityJump(arm, place, *means))
    if impacts:
        first, last = min(impacts.values()), max(impacts.values())
        before, after = _within(time, first, JUMP_BEFORE), _within(time, last, OBJECT_WINDOWS[0])
        rows = np.logical_or(before, after)
        if before.sum() > 1 and after.sum() > 1 and np.isfinite(poses[rows]).all():
            slopes = [np.polyfit(time[part], poses[part, :3], 1)[0] for part in (before, after)]
            row = min(int(np.searchsorted(time, first)), time.size - 1)
            found.append(VelocityJump(OBJECT, poses[row, :3], *slopes))
    return tuple(found)


def _within(time: Array, begin: float, window: tuple[float, float]) -> Array:
    """Mask of the samples in a window relative to the begin of the impact."""
    return np.asarray((time >= begin + window[0]) & (time <= begin + window[1]))
