# SPDX-License-Identifier: Apache-2.0
"""Tracks: one run over time, measured and predicted on a common clock, for figures, the 3D view and aligned bags.

Contact forces of model and measurement are estimates of the momentum observer (:mod:`impact_rs_control.detection`).
They include errors of the nominal rigid model of the arm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.free_motion.torque_balance import Motion
from impact_rs_analysis.evidence.replays.features import JUMP_BEFORE_S, JUMP_WINDOWS_S, OBJECT_WINDOWS_S, SETTLED_WINDOW
from impact_rs_analysis.evidence.replays.impacts import impacts_of, observe
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replays.replay_cache import with_effects
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES, continuous, quaternion_of, yaw_of_quaternions
from impact_rs_sim.scene import standing
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.recordings.recording import ARM
from impact_rs_trials.runs import NONE, ArmSignals, Poses, Run, Signals, none

OBJECT = "object"  # name of the object among the bodies
JUMP_AFTER_S = JUMP_WINDOWS_S[SETTLED_WINDOW]  # s from the begin of the impact; window of the velocity after it


@dataclass(frozen=True)
class ComparedSignal:
    """One signal, measured and predicted.

    Attributes:
        name: Name of the signal.
        unit: Its unit.
        measured: Measured values, ``(k,)`` in the unit.
        predicted: Predicted values, ``(k,)`` in the unit.
    """

    name: str
    unit: str
    measured: Array
    predicted: Array


@dataclass(frozen=True)
class VelocityJump:
    """Velocity of one body before and after the impact.

    Attributes:
        body: Name of the arm (its end effector), or ``object``.
        position: Position of the body at the begin of the impact, in A, ``(3,)`` [m].
        before: Velocity 18 to 3 ms before it, in A, ``(3,)`` [m/s].
        after: Velocity 20 to 40 ms after it, of the object 6 to 40 ms, in A, ``(3,)`` [m/s].
    """

    body: str
    position: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class ArmTrack:
    """Motion of one arm; empty where it is not known.

    Attributes:
        position: q, ``(k, n)`` [rad].
        velocity: dq, ``(k, n)`` [rad/s].
        torque: tau_J, ``(k, n)`` [N m].
        pose: Pose of frame E in A as position and quaternion x y z w, ``(k, 7)`` [m, -].
        twist: Twist of E in E[A], ``(k, 6)`` [m/s, rad/s].
        force: Contact force of the arm on its environment, at E, axes of A, ``(k, 3)`` [N].
    """

    position: Array
    velocity: Array = field(default_factory=none)
    torque: Array = field(default_factory=none)
    pose: Array = field(default_factory=none)
    twist: Array = field(default_factory=none)
    force: Array = field(default_factory=none)


@dataclass(frozen=True)
class TrackSide:
    """Motion of arms and object, measured or predicted.

    Attributes:
        arms: By name.
        object: Pose of the object's centre in A as position and quaternion x y z w, ``(k, 7)`` [m, -]; NaN where not
            tracked.
        jumps: Velocities before and after the impact.
        neighbours: Poses of the object's neighbours by name, likewise.
    """

    arms: dict[str, ArmTrack]
    object: Array
    jumps: tuple[VelocityJump, ...] = ()
    neighbours: dict[str, Array] = field(default_factory=dict)

    @property
    def poses(self) -> dict[str, Array]:
        """Poses of the object, ``object``, and of its neighbours, by name."""
        return {OBJECT: self.object, **self.neighbours}


@dataclass(frozen=True)
class Track:
    """One run over time.

    Attributes:
        label: Name of the run, or of recording and model.
        time: Time of the run, or since the start of the recording [s]; for a table the numbers of the rows, ``(k,)``.
        impact: Begin of the first impact [s]; None without an impact.
        starts: Rows in which a stretch begins; there are no data between two stretches.
        curves: Signals for figures.
        physics: Nominal physics of the scene; None: not known.
        measured: The measurement; None without motion.
        predicted: The replay from the measured start of every stretch; None without a model.
    """

    label: str
    time: Array
    impact: float | None = None
    starts: tuple[int, ...] = (0,)
    curves: tuple[ComparedSignal, ...] = ()
    physics: Physics | None = None
    measured: TrackSide | None = None
    predicted: TrackSide | None = None

    @property
    def in_3d(self) -> bool:
        """Whether it can be shown in 3D."""
        return self.physics is not None and self.measured is not None


# ---- runs and their replays ------------------------------------------------------------------------------------------


def tracks_of_runs(runs: Runs, model: Model, map_tasks: Any, added: Added = ()) -> tuple[Track, ...]:
    """The first run of every condition and its replay, runs with an impact first."""
    firsts = sorted((group[0] for group in runs.conditions.values()), key=lambda run: not run.hit)
    return tuple(map_tasks(_track_of_task, [(run, model, added) for run in firsts]))


def _track_of_task(task: tuple[MeasuredRun, Model, Added]) -> Track:
    return track_of_run(*task)


def track_of_run(run: MeasuredRun, model: Model, added: Added = ()) -> Track:
    """A run and its replay, window by window.

    Args:
        run: The measurement.
        model: The model.
        added: Effects added to it.
    """
    setup = run.setup
    replayed = setup.replayed(with_effects(model, setup.physics, added))
    time = np.concatenate([window.time for window in setup.windows])
    starts = tuple(np.cumsum([0, *(window.time.size for window in setup.windows[:-1])]).tolist())
    measured, predicted = (_windowed_side(run, windows, time, starts) for windows in (run.windowed, replayed))
    label = run.condition.removeprefix(f"{run.condition_key[0]}/").replace("/", ", ")
    impact = min(run.impacts.values(), default=None)
    track = Track(label, time, impact, starts, (), setup.physics, measured, predicted)
    return replace(track, curves=tuple(_curves(track, measured, predicted, run.axis)))


def _windowed_side(run: MeasuredRun, windows: Sequence[Signals], time: Array, starts: Sequence[int]) -> TrackSide:
    """Motion in all windows; before the window of the impact a tracked object rests at its last measured pose."""
    arms = {
        name: ArmSignals(
            *(
                np.concatenate([getattr(window.arms[name], key) for window in windows])
                for key in ("position", "velocity", "torque")
            )
        )
        for name in windows[0].arms
    }
    poses: dict[str, list[Array]] = {}
    for window, signals in zip(run.setup.windows, windows, strict=True):
        resting = (window.object, *standing(run.setup.physics, window.object))
        for name, body in zip(run.setup.physics.bodies, resting, strict=True):
            pose = _untracked(window.time)
            if name in run.setup.bodies and window.contact:  # the tracker is slower than the joints
                pose = _extended(_poses_at(window.time, signals.poses[name]))
            elif name in run.setup.bodies:
                pose[:] = [*body.position, *quaternion_of(body.rotation)]
            poses.setdefault(name, []).append(pose)
    whole = {name: np.concatenate(parts) for name, parts in poses.items()}
    return _side(run.setup.physics, time, starts, arms, whole, run.impacts)


def _extended(poses: Array) -> Array:
    """Poses, with the first and last tracked pose held beyond the ends."""
    tracked = np.flatnonzero(np.isfinite(poses[:, 0]))
    return poses[np.clip(np.arange(len(poses)), tracked[0], tracked[-1])] if tracked.size else poses


def _curves(track: Track, measured: TrackSide, predicted: TrackSide, main: int) -> list[ComparedSignal]:
    """Signals of a run: end effectors (main axis first), joints, then the object."""
    assert track.physics is not None
    signals: list[ComparedSignal] = []
    axes = [(axis, AXES[axis], "m/s") for axis in (main, *(axis for axis in range(3) if axis != main))]
    for name, arm in measured.arms.items():
        model = predicted.arms[name]
        units = track.physics.arms[name].facts.units
        torques = [(joint, str(joint + 1), unit.effort) for joint, unit in enumerate(units)]
        speeds = [(joint, str(joint + 1), unit.velocity) for joint, unit in enumerate(units)]
        curves = [
            *_columns("end-effector velocity", arm.twist, model.twist, axes),
            *_columns("torque of joint", arm.torque, model.torque, torques),
            *_columns("velocity of joint", arm.velocity, model.velocity, speeds),
        ]
        several = len(measured.arms) > 1
        signals += [replace(curve, name=f"{name}: {curve.name}") for curve in curves] if several else curves
    for name, pose in measured.poses.items():
        predicted_pose = predicted.poses[name]
        if not np.isfinite(pose).any():
            continue
        signals += _columns(f"{name} position", pose, predicted_pose, [(axis, AXES[axis], "m") for axis in range(2)])
        a, b = (_rate(track, values[:, :3]) for values in (pose, predicted_pose))
        signals += _columns(f"{name} velocity", a, b, [(axis, AXES[axis], "m/s") for axis in range(2)])
        a, b = (_yaw(track, values) for values in (pose, predicted_pose))
        signals.append(ComparedSignal(f"{name} yaw", "rad", a, b))
        signals.append(ComparedSignal(f"{name} yaw rate", "rad/s", _rate(track, a), _rate(track, b)))
    return signals


def _yaw(track: Track, poses: Array) -> Array:
    """Rotation about z, stretch by stretch, ``(k,)`` [rad]."""
    return np.concatenate([yaw_of_quaternions(poses[rows, 3:]) for rows in _slices(track.starts, len(poses))])


def _rate(track: Track, values: Array) -> Array:
    """Time derivative of a position, stretch by stretch; NaN for a stretch of one sample."""
    rates = np.full(values.shape, np.nan)
    for rows in _slices(track.starts, len(values)):
        if rows.stop - rows.start > 1:
            rates[rows] = np.gradient(values[rows], track.time[rows], axis=0)
    return rates


def _columns(
    name: str, measured: Array, predicted: Array, picks: Iterable[tuple[int, str, str]]
) -> list[ComparedSignal]:
    return [ComparedSignal(f"{name} {label}", unit, measured[:, i], predicted[:, i]) for i, label, unit in picks]


# ---- runs as measured -----------------------------------------------------------------------------------------------


def track_of_recording(run: Run) -> Track:
    """A whole run as measured, stretch by stretch between gaps."""
    signals, time = run.signals, run.signals.time
    recorded = np.ones(time.size, dtype=bool)
    for start, end in run.gaps:
        recorded &= (time <= start) | (time >= end)
    time = time[recorded]
    starts = (0, *(int(np.searchsorted(time, end)) for _, end in run.gaps))
    arms = {name: arm.at(recorded) for name, arm in signals.arms.items()}
    try:
        impacts = {arm: begin for arm, (begin, _) in impacts_of(run).items()} if run.hit else {}
    except InputError:  # no impact: the run is shown without jumps
        impacts = {}
    poses = {name: _poses_at(time, tracked) for name, tracked in signals.poses.items()}
    side = _side(run.physics, time, starts, arms, poses, impacts)
    return Track(run.name, time, min(impacts.values(), default=None), starts, (), run.physics, side)


def track_of_bag(bag: TrialBag) -> Track:
    """A trial over the time that all of its arms were recorded, from the robot's topics; ``/truth`` is not read.

    Raises:
        BagError: An arm's joint states are missing or damaged.
        InputError: The scenario in the bag cannot be read.
    """
    physics = bag.info.spec.scene.physics
    columns = {arm: _joint_states(bag, arm) for arm in bag.info.robots}
    first, last = max(times[0] for times, _ in columns.values()), min(times[-1] for times, _ in columns.values())
    time = next(iter(columns.values()))[0]
    time = time[(time >= first) & (time <= last)]
    arms = {}
    for name, (arm_time, arm) in columns.items():
        at = {key: _at(time, arm_time, getattr(arm, key)) for key in arm.measured}
        arms[name] = ArmSignals(**({"velocity": NONE, "torque": NONE} | at))
    tracked = bag.info.spec.scenario.excursion is None
    poses = {
        name: _poses_at(time, bag.poses(topics.pose(name))) if tracked else _untracked(time) for name in physics.bodies
    }
    impacts = {arm: moment for arm in arms if np.isfinite(moment := bag.impact_time(arm))}
    side = _side(physics, time, (0,), arms, poses, impacts)
    return Track(bag.path.name, time, min(impacts.values(), default=None), physics=physics, measured=side)


def _joint_states(bag: TrialBag, arm: str) -> tuple[Array, ArmSignals]:
    """Times and joint signals of an arm; velocity and torque are empty if one of them is missing."""
    topic = topics.joint_states(arm)
    columns = bag.joints(topic)
    if columns.time.size < 2 or not columns.position.size:
        raise BagError(bag.path, f"{topic} has no joint positions")
    if not np.isfinite(columns.position).all() or np.any(np.diff(columns.time) <= 0.0):
        raise BagError(bag.path, f"{topic} has positions that are not finite, or stamps that run backwards")
    complete = columns.velocity.size and columns.effort.size
    signals = (columns.position, columns.velocity, columns.effort) if complete else (columns.position, NONE, NONE)
    return columns.time, ArmSignals(*signals)


def track_of_motion(label: str, physics: Physics, motion: Motion, curves: Sequence[ComparedSignal]) -> Track:
    """A recording of free motion, with the joints of its arm only."""
    inner = motion.inner
    time = motion.time[inner]
    side = TrackSide({ARM: ArmTrack(motion.position[inner], motion.velocity[inner])}, _untracked(time))
    return Track(label, time, curves=tuple(curves), physics=physics, measured=side)


# ---- one side -------------------------------------------------------------------------------------------------------


def _side(
    physics: Physics,
    time: Array,
    starts: Sequence[int],
    arms: Mapping[str, ArmSignals],
    poses: Mapping[str, Array],
    impacts: Mapping[str, float],
) -> TrackSide:
    """Motion with pose, twist and contact force of every end effector, and the velocity jumps."""
    models = physics.robot_models()
    tracks = {name: _arm_track(arm, models[name], time, starts) for name, arm in arms.items()}
    neighbours = {name: tracked for name, tracked in poses.items() if name != OBJECT}
    return TrackSide(tracks, poses[OBJECT], _jumps(time, tracks, poses[OBJECT], impacts), neighbours)


def _arm_track(arm: ArmSignals, model: RobotModel, time: Array, starts: Sequence[int]) -> ArmTrack:
    pose = np.array([pin.SE3ToXYZQUAT(model.placement(q)) for q in arm.position])
    if not (arm.velocity.size and arm.torque.size):
        return ArmTrack(arm.position, arm.velocity, arm.torque, pose)
    force = np.concatenate(
        [
            -observe(time[rows], arm.position[rows], arm.velocity[rows], arm.torque[rows], model).force
            for rows in _slices(starts, time.size)
        ]
    )
    twist = np.array([model.jacobian(q) @ dq for q, dq in zip(arm.position, arm.velocity, strict=True)])
    return ArmTrack(arm.position, arm.velocity, arm.torque, pose, twist, force)


def _slices(starts: Sequence[int], size: int) -> list[slice]:
    return [slice(start, end) for start, end in pairwise((*starts, size))]


def _untracked(time: Array) -> Array:
    """Poses of an object that was not tracked, ``(k, 7)``."""
    return np.full((time.size, 7), np.nan)


def _poses_at(time: Array, tracked: Poses) -> Array:
    """Tracked poses of an object interpolated at some times, ``(k, 7)``; NaN outside the tracked time."""
    tracked_time = tracked.time
    if tracked_time.size < 2:
        return _untracked(time)
    poses = _at(time, tracked_time, np.column_stack((tracked.position, continuous(tracked.quaternion))))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
    period = float(np.median(np.diff(tracked_time)))
    poses[(time < tracked_time[0] - period) | (time > tracked_time[-1] + period)] = np.nan
    return poses


def _at(time: Array, known_time: Array, values: Array) -> Array:
    """Columns of ``values`` interpolated at other times."""
    return np.column_stack([np.interp(time, known_time, column) for column in values.T])


def _jumps(
    time: Array, arms: Mapping[str, ArmTrack], poses: Array, impacts: Mapping[str, float]
) -> tuple[VelocityJump, ...]:
    """Velocity jumps of every arm that hit, and of the object; empty if the windows hold no samples."""
    jumps = []
    for arm, begin in impacts.items():
        if not arms[arm].twist.size:
            continue
        before, after = _within(time, begin, JUMP_BEFORE_S), _within(time, begin, JUMP_AFTER_S)
        row = min(int(np.searchsorted(time, begin)), time.size - 1)
        if before.any() and after.any():
            means = [arms[arm].twist[rows, :3].mean(axis=0) for rows in (before, after)]
            jumps.append(VelocityJump(arm, arms[arm].pose[row, :3], *means))
    if impacts:
        first, last = min(impacts.values()), max(impacts.values())
        before, after = _within(time, first, JUMP_BEFORE_S), _within(time, last, OBJECT_WINDOWS_S[0])
        rows = np.logical_or(before, after)
        if before.sum() > 1 and after.sum() > 1 and np.isfinite(poses[rows]).all():
            slopes = [np.polyfit(time[part], poses[part, :3], 1)[0] for part in (before, after)]
            row = min(int(np.searchsorted(time, first)), time.size - 1)
            jumps.append(VelocityJump(OBJECT, poses[row, :3], *slopes))
    return tuple(jumps)


def _within(time: Array, begin: float, window: tuple[float, float]) -> Array:
    """Mask of the samples in a window relative to the begin of the impact."""
    return np.asarray((time >= begin + window[0]) & (time <= begin + window[1]))
