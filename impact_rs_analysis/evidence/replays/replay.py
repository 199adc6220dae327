# SPDX-License-Identifier: Apache-2.0
"""Replays: the twin from a measured state, driven by recorded torque, over short windows.

No controller is modelled, so runs of any controller can be replayed. Two drives:

    command         recorded desired torque through torque loop, motor and transmission
    joint torque    recorded tau_J applied to the links; covers links, contact and object only

Windows are stretches of free motion, and one about the impact. Their start is a local fit to the measurement: q and dq
jointly (cubic), and tau_J (quadratic). The motor state follows from the joint elasticity,

    theta = q + tau_J / K,    dtheta = dq + dtau_J / K                                     (paper eq. EOM_motor)

Errors grow with time in open loop: windows are long enough to show an effect, and short enough to stay near the path.

Sensor models (:mod:`impact_rs_sim.readings`) correct the start and the driving torque, and predict the readings of the
simulated signals, which are compared with the recorded ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.readings import ArmReadings
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.twin import Result, TwinJob, simulate
from impact_rs_trials.runs import ArmSignals, DriveName, Poses, Run, Signals

FREE_WINDOW_S = 0.1  # length of a window of free motion
FREE_WINDOWS_WITH_IMPACT = 4  # per run
FREE_WINDOWS_WITHOUT_IMPACT = 12  # per run
MIN_MOVING_SPEED_SHARE = 0.05  # of the largest joint speed; a slower arm rests
WINDOW_BEFORE_IMPACT_S = 0.02  # from the begin of the window about the impact to the impact
WINDOW_AFTER_IMPACT_S = 0.4  # from the impact to the end of that window
START_FIT_HALF_WIDTH_S = 0.008  # of the local fit for the start; ends before the impact begins
CURVATURE_FIT_S = 0.04  # from the begin of the fit of a curvature to the start; shorter ones are mostly noise
RESTING_POSE_SAMPLES = 25  # averaged for the pose of the object before the impact
MAX_HISTORY_SAMPLES = 60  # before the start, for formulas with memory; from the begin of the run
COMMAND_HISTORY_S = 0.03  # before the start: commands that a delayed actuation may still deliver


@dataclass(frozen=True)
class Window:
    """A time window of a run for replay.

    Attributes:
        contact: Whether it contains the impact.
        number: Index among all windows of free motion, with gaps or not; 0 for the window about the impact.
        time: Ticks, ``(k,)`` [s].
        arms: Joint states at its start.
        drives: State of the drives at its start.
        object: State of the object at its start.
        torque: By arm, driving torques in the order in which they act, ``(m, n)`` [N m].
        acting: By arm, row of ``torque`` in every period of the torque loop, ``((k - 1) s,)``.
        tracked_times: Times at which the object was tracked, ``(m,)`` [s].
        neighbour_times: Times at which its neighbours were tracked, by name.
        before: By arm, samples from the begin of the run to the start (:attr:`TwinJob.before`).
        from_velocity: By arm, contributions of velocity readings, their slopes and their curvatures to position and
            velocity of the start, ``(3, 2, n)`` [rad and rad/s over s^0, s^1, s^2].
        velocity: By arm, reading of the velocity at the start and its slope, ``(2, n)`` [rad/s, rad/s^2].
        age: Time of the run since the first one of the campaign [s].
    """

    contact: bool
    number: int
    time: Array
    arms: dict[str, ArmState]
    drives: dict[str, DriveStart]
    object: BodyState
    torque: dict[str, Array]
    acting: dict[str, NDArray[np.int32]]
    tracked_times: Array
    before: dict[str, Array] = field(default_factory=dict)
    from_velocity: dict[str, Array] = field(default_factory=dict)
    velocity: dict[str, Array] = field(default_factory=dict)
    age: float = 0.0
    neighbour_times: dict[str, Array] = field(default_factory=dict)

    @property
    def substeps(self) -> int:
        """Periods of the torque loop from tick to tick."""
        return len(next(iter(self.acting.values()))) // (self.time.size - 1)

    def start_from_velocity(self, arm: str) -> Array:
        """Contributions of velocity readings and their slopes to a start, and the reading, ``(5, n)``, for digests."""
        if arm not in self.from_velocity:
            return np.zeros(0)
        return np.vstack((*self.from_velocity[arm][:2], self.velocity[arm][0]))

    def commanded(self, arm: str) -> Array:
        """Driving torque at every tick, ``(k, n)`` [N m]."""
        rows = self.acting[arm][:: self.substeps]
        return self.torque[arm][np.append(rows, self.acting[arm][-1])]


def windows_of(run: Run, impacts: dict[str, float]) -> list[Window]:
    """Windows of a run: windows of free motion, then the window about the impact.

    Args:
        run: The run.
        impacts: Begin of the impact by arm [s]; empty in free motion.

    Raises:
        InputError: A gap lies in the window about the impact.
    """
    time = run.signals.time
    assert run.object is not None
    box = run.object
    windows = []
    if impacts:
        box = _resting(run.signals, run.object, min(impacts.values()) - WINDOW_BEFORE_IMPACT_S)
    for number, start in enumerate(free_starts(run, impacts)):
        if recorded(run, start):
            windows.append(_window(run, start, start + FREE_WINDOW_S, box, number))
    if impacts:
        first = min(impacts.values())
        end = min(first + WINDOW_AFTER_IMPACT_S, float(time[-1]))
        if run.within_gap(first - WINDOW_BEFORE_IMPACT_S - START_FIT_HALF_WIDTH_S, end):
            raise InputError(
                "a gap lies in the window about the impact, which begins "
                f"{WINDOW_BEFORE_IMPACT_S + START_FIT_HALF_WIDTH_S:g} s before it"
            )
        windows.append(_window(run, first - WINDOW_BEFORE_IMPACT_S, end, box, None))
    return windows


def recorded(run: Run, start: float) -> bool:
    """Whether the window of free motion from ``start`` [s], and the fit of its start, are free of gaps."""
    return not run.within_gap(start - START_FIT_HALF_WIDTH_S, start + FREE_WINDOW_S + START_FIT_HALF_WIDTH_S)


def free_starts(run: Run, impacts: dict[str, float]) -> list[float]:
    """Begin of the windows of free motion [s], spread evenly over the motion before an impact.

    Gaps do not shift them, so that windows of repeats cover the same part of the motion.
    """
    time = run.signals.time
    speed = np.max([np.abs(arm.velocity).max(axis=1) for arm in run.signals.arms.values()], axis=0)
    last = float(time[-1]) - START_FIT_HALF_WIDTH_S
    if impacts:
        last = min(impacts.values()) - WINDOW_BEFORE_IMPACT_S
    before = time <= last
    moving = np.nonzero(before & (speed > MIN_MOVING_SPEED_SHARE * speed[before].max()))[0]
    if not moving.size:
        return []
    begin = max(float(time[moving[0]]), float(time[0]) + START_FIT_HALF_WIDTH_S)
    end = min(float(time[moving[-1]]), last)
    most = FREE_WINDOWS_WITH_IMPACT if impacts else FREE_WINDOWS_WITHOUT_IMPACT
    count = min(most, int((end - begin) / FREE_WINDOW_S + 1e-6))
    if count < 1:
        return []
    slack = (end - begin - count * FREE_WINDOW_S) / count
    return [begin + (number + 0.5) * slack + number * FREE_WINDOW_S for number in range(count)]


def _window(run: Run, start: float, end: float, box: BodyState, number: int | None) -> Window:
    """Window of free motion; without a number, the window about the impact."""
    contact = number is None
    time = run.signals.time
    first, last = (int(np.argmin(np.abs(time - moment))) for moment in (start, end))
    ticks = time[first : last + 1]
    substeps = max(1, round(run.period / run.drive_period))
    grid = (ticks[:-1, None] + np.arange(substeps) * (run.period / substeps)).ravel()
    arms, drives, torques, acting, before, from_velocity, velocity = {}, {}, {}, {}, {}, {}, {}
    rows = np.arange(first - 1, -1, -max(1, math.ceil(first / MAX_HISTORY_SAMPLES)))[::-1]
    for name, arm in run.signals.arms.items():
        q, dq, from_velocity[name], velocity[name] = _joint_fit(time, arm.position, arm.velocity, ticks[0])
        torque, rate = _slope_fit(time, arm.torque, ticks[0])
        before[name] = np.column_stack((time[rows], arm.position[rows], arm.velocity[rows], arm.torque[rows]))
        arms[name] = ArmState(q, dq)
        earlier: tuple[tuple[float, Array], ...] = ()
        if run.commanded:
            sent, values = arm.command_time, arm.command
            torques[name], acting[name] = _held_commands(sent, values, grid, run.period / substeps)
            delayed = np.nonzero((sent < ticks[0]) & (sent > ticks[0] - COMMAND_HISTORY_S))[0]
            earlier = tuple((float(sent[row] - ticks[0]), values[row]) for row in delayed)
        else:
            ends = grid + run.period / substeps
            torques[name] = np.column_stack([np.interp(ends, time, column) for column in arm.torque.T])
            acting[name] = np.arange(grid.size, dtype=np.int32)
        drives[name] = DriveStart(torque, rate, earlier)
    tracked = _within_ticks(run.signals.object_time, ticks, contact)
    neighbours = {name: _within_ticks(poses.time, ticks, contact) for name, poses in run.signals.neighbours.items()}
    return Window(
        contact,
        number or 0,
        ticks,
        arms,
        drives,
        box,
        torques,
        acting,
        tracked,
        before,
        from_velocity,
        velocity,
        neighbour_times=neighbours,
    )


def _within_ticks(tracked: Array, ticks: Array, contact: bool) -> Array:
    """Times of tracking within the window of the impact; empty in others."""
    return tracked[contact & (tracked >= ticks[0] - 1e-9) & (tracked <= ticks[-1] + 1e-9)]


def _held_commands(sent: Array, values: Array, grid: Array, period: float) -> tuple[Array, NDArray[np.int32]]:
    """Zero-order-hold commands by period of the torque loop.

    Args:
        sent: Times at which commands take effect, ``(c,)`` [s].
        values: Commands, ``(c, n)`` [N m].
        grid: Begin of the periods, ``(s,)`` [s].
        period: Duration of a period [s].

    Returns:
        Torques in the order in which they act, ``(m, n)``, and the row that acts in every period, ``(s,)``; with
        commands that change within a period, the means over the periods.
    """
    edge = 4e-3 * period  # tolerance: a command on the edge of a period belongs to it
    rows, last = (
        np.maximum(np.searchsorted(sent, moments, side="right") - 1, 0)
        for moments in (grid + edge, grid + period - edge)
    )
    if np.array_equal(rows, last):
        return values[rows[0] : rows[-1] + 1], (rows - rows[0]).astype(np.int32)
    return held_means(sent, values, np.append(grid, grid[-1] + period)), np.arange(grid.size, dtype=np.int32)


def held_means(sent: Array, values: Array, edges: Array) -> Array:
    """Means of zero-order-hold commands from edge to edge, ``(s, n)`` [N m].

    Args:
        sent: Times at which commands take effect, ``(c,)`` [s]; the first one also acts before.
        values: Commands, ``(c, n)`` [N m].
        edges: Edges in time, ``(s + 1,)`` [s].
    """
    first = max(int(np.searchsorted(sent, edges[0], side="right")) - 1, 0)
    last = max(int(np.searchsorted(sent, edges[-1])), first + 1)
    knots, held = np.append(sent[first:last], np.inf), values[first:last]
    knots[0], knots[-1] = edges[0], max(knots[-2], edges[-1]) + 1.0
    sums = np.vstack((np.zeros(held.shape[1]), np.cumsum(np.diff(knots)[:, None] * held, axis=0)))
    at = np.column_stack([np.interp(edges, knots, column) for column in sums.T])
    return np.asarray(np.diff(at, axis=0) / np.diff(edges)[:, None])


def _near(time: Array, moment: float) -> slice:
    first = int(np.searchsorted(time, moment - START_FIT_HALF_WIDTH_S - 1e-9))
    last = int(np.searchsorted(time, moment + START_FIT_HALF_WIDTH_S + 1e-9))
    if last - first < 5:  # slow sampling: the nearest five samples
        first = max(0, min(first - 2, time.size - 5))
        last = first + 5
    return slice(first, last)


def _joint_fit(time: Array, position: Array, velocity: Array, moment: float) -> tuple[Array, Array, Array, Array]:
    """q and dq at a moment, ``(n,)`` each, by one cubic fitted to both, weighted by their inverse noise.

    Returns:
        q, dq, :attr:`Window.from_velocity` and :attr:`Window.velocity`.
    """
    rows = _near(time, moment)
    t = time[rows] - moment
    ones, zeros = np.ones_like(t), np.zeros_like(t)
    on_position = np.column_stack((ones, t, t**2 / 2.0, t**3 / 6.0))
    on_velocity = np.column_stack((zeros, ones, t, t**2 / 2.0))
    q, dq, parts = np.empty(position.shape[1]), np.empty(position.shape[1]), np.empty((3, 2, position.shape[1]))
    readings, slopes = np.linalg.lstsq(np.column_stack((ones, t)), velocity[rows], rcond=None)[0]
    curvatures = _curvature(time, velocity, moment)
    for joint in range(q.size):
        a, b = position[rows, joint], velocity[rows, joint]
        wa, wb = 1.0 / _noise(position[:, joint], 1e-7), 1.0 / _noise(velocity[:, joint], 1e-5)
        design = np.vstack((wa * on_position, wb * on_velocity))
        solution = np.linalg.lstsq(design, np.concatenate((wa * (a - a[0]), wb * b)), rcond=None)[0]
        q[joint], dq[joint] = solution[0] + a[0], solution[1]
        of_velocity = wb * np.column_stack((b, slopes[joint] * ones, curvatures[joint] * ones))
        of_both = np.concatenate((np.zeros_like(of_velocity), of_velocity))
        parts[:, :, joint] = np.linalg.lstsq(design, of_both, rcond=None)[0][:2].T
    return q, dq, parts, np.stack((readings, slopes))


def _curvature(time: Array, values: Array, moment: float) -> Array:
    """Second derivative at a moment, ``(n,)``, by a parabola through samples before it: an impact may follow."""
    first, last = np.searchsorted(time, (moment - CURVATURE_FIT_S, moment + START_FIT_HALF_WIDTH_S + 1e-9))
    t = time[first:last] - moment
    if t.size < 5:
        return np.zeros(values.shape[1])
    return np.asarray(2.0 * np.polyfit(t, values[first:last], 2)[0])


def _slope_fit(time: Array, values: Array, moment: float) -> tuple[Array, Array]:
    """Value and slope at a moment, ``(n,)`` each, by a parabola."""
    rows = _near(time, moment)
    t = time[rows] - moment
    solution = np.linalg.lstsq(np.column_stack((np.ones_like(t), t, t**2)), values[rows], rcond=None)[0]
    return solution[0], solution[1]


def _noise(values: Array, least: float) -> float:
    """Noise of a smooth signal, from the median of its third differences, which ignores the impact."""
    third = np.diff(values, 3)
    return max(float(np.median(np.abs(third))) / (0.6745 * math.sqrt(20.0)), least)


def replays(
    tasks: Sequence[tuple[Sequence[Window], Physics]], drive_period: float, drive: DriveName, threads: int = 1
) -> list[list[Signals]]:
    """Simulated signals of the windows of several replays, by the twin (:mod:`impact_rs_sim.twin`).

    Args:
        tasks: Windows of a run, and physics of the model, of every replay.
        drive_period: Period of the torque loop [s].
        drive: Model between the recorded torque and the links.
        threads: Largest number of threads.

    Raises:
        NotABody: Mass and inertia of an end effector are not those of a body.
    """
    jobs = [_job(window, physics, drive_period, drive) for windows, physics in tasks for window in windows]
    results = iter(simulate(jobs, threads))
    return [[_signals(window, physics, next(results)) for window in windows] for windows, physics in tasks]


def _job(window: Window, physics: Physics, drive_period: float, drive: DriveName) -> TwinJob:
    """The simulation of a window; before contact the object is left out."""
    arms, drives, box = window.arms, window.drives, window.object
    torque, acting = window.torque, window.acting
    joint_torque = drive == "joint torque"
    if not all(arm.readings.exact for arm in physics.arms.values()):
        arms = {name: _true_start(window, name, arm.readings) for name, arm in physics.arms.items()}
        drives = {name: _true_drive(window, name, arm.readings) for name, arm in physics.arms.items()}
        shifted = _true_torque if joint_torque else _true_command
        torque = {name: shifted(window, name, arm.readings) for name, arm in physics.arms.items()}
        acting = {name: np.arange(len(torques), dtype=np.int32) for name, torques in torque.items()}
    if not physics.tracker.exact:
        position, rotation = physics.tracker.pose_of(box.position, box.rotation)
        box = replace(box, position=position, rotation=rotation)
    return TwinJob(
        physics=physics,
        arms=arms,
        drives=drives,
        torque=torque,
        acting=acting,
        time=window.time,
        period=drive_period,
        object=box if window.contact else None,
        joint_torque=joint_torque,
        before=window.before,
    )


def _true_start(window: Window, name: str, readings: ArmReadings) -> ArmState:
    """State of the arm from the readings at the start; the fit is linear in them."""
    start, parts = window.arms[name], window.from_velocity[name]
    q_v, dq_v = parts[0]
    q_true, dq_true = np.tensordot((1.0, readings.velocity_late, readings.velocity_curvature), parts, 1)
    scale = readings.position_scale * readings.velocity_gain
    return ArmState(
        readings.position_of(start.position - q_v) + q_true / scale,
        (start.velocity - dq_v) / readings.position_scale + dq_true / scale,
    )


def _true_drive(window: Window, name: str, readings: ArmReadings) -> DriveStart:
    """State of a drive from the readings at the start and the known command."""
    start = window.drives[name]
    torque = readings.torque_of(start.torque, start.torque_rate, window.age)
    return replace(start, torque=torque, torque_rate=readings.torque_rate_of(start.torque_rate))


def _true_command(window: Window, name: str, readings: ArmReadings) -> Array:
    """Desired torque in every period of the torque loop, ``(s, n)`` [N m], from the commands and their delay."""
    acting = window.torque[name][window.acting[name]]
    if readings.command_delay == 0.0:
        return acting
    edges = np.linspace(window.time[0], window.time[-1], len(acting) + 1)
    earlier = window.drives[name].earlier
    sent = np.array([window.time[0] + moment for moment, _ in earlier])
    values = np.vstack([*(value[None, :] for _, value in earlier), acting])
    return held_means(np.append(sent, edges[:-1]), values, edges - readings.command_delay)


def _true_torque(window: Window, name: str, readings: ArmReadings) -> Array:
    """True driving joint torque from its readings in every period, ``(s, n)``; corrected for lag and delay."""
    reading = window.torque[name][window.acting[name]]
    period = (window.time[-1] - window.time[0]) / max(len(reading), 1)
    ahead = np.arange(len(reading)) + readings.torque_late / period
    later = np.column_stack([np.interp(ahead, np.arange(len(reading)), column) for column in reading.T])
    return readings.torque_of(later, np.zeros_like(later), window.age)


def _signals(window: Window, physics: Physics, result: Result) -> Signals:
    """Readings of the simulated signals, with the object at its times of tracking: means of few samples depend on them.

    A simulation with an unsolved step is NaN, so that no fit and no model can use it.
    """
    solved = 1.0 if not result.failed else np.nan
    arms = {}
    for name, path in result.arms.items():
        true = (path.position, path.velocity, path.torque, path.motor_position, path.motor_velocity)
        readings, drive = physics.arms[name].readings, window.drives[name]
        if not readings.exact:
            velocity, acceleration = window.velocity[name]
            true = (
                readings.position(path.position),
                readings.velocity(window.time, path.velocity, (velocity, acceleration)),
                readings.torque(window.time, path.torque, window.age, (drive.torque, drive.torque_rate)),
                path.motor_position + readings.motor_offset,
                path.motor_velocity,
            )
        arms[name] = ArmSignals(*(solved * values for values in true))
    if not window.contact:
        return Signals(window.time, arms)
    poses = _tracked_poses(window, physics, result.poses, window.tracked_times)
    neighbours = {
        name: _tracked_poses(window, physics, result.neighbours[name][0], times)
        for name, times in window.neighbour_times.items()
    }
    return Signals(window.time, arms, poses.time, poses.position, poses.quaternion, neighbours)


def _tracked_poses(window: Window, physics: Physics, poses: Array, times: Array) -> Poses:
    """Poses of a body, ``(k, 7)``, as the tracker reads them at its times ``(m,)`` [s]."""
    if physics.tracker.exact:
        read = np.column_stack([np.interp(times, window.time, column) for column in poses.T])
    else:
        read = physics.tracker.poses(window.time, poses, times)
    return Poses(times, read[:, :3], read[:, 3:])


def _resting(signals: Signals, nominal: BodyState, until: float) -> BodyState:
    """State of the object before ``until`` [s]: position and yaw as measured, upright on its support.

    Args:
        signals: The measurement; without tracking the object has its position in the scenario.
        nominal: Its nominal state.
        until: Earliest time of the impact.
    """
    rows = np.nonzero(signals.object_time < until)[0][-RESTING_POSE_SAMPLES:]
    if rows.size == 0:
        return nominal
    position = nominal.position.copy()
    position[:2] = np.median(signals.object_position[rows, :2], axis=0)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.median(signals.object_yaw[rows])))
    return BodyState(position, turn, np.zeros(6))
