# SPDX-License-Identifier: Apache-2.0
"""Outcome of a trial, by its measured and recorded signals.

Every rule checks one condition and yields findings. The verdict is the gravest finding, of equally grave ones the
earliest. A limit may be exceeded briefly: an impact takes a wrist beyond its torque limit for some milliseconds. The
time beyond a limit is summed over the trial, because an oscillating signal returns within its limits again and again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from impact_rs_control.closed_loop import RUNAWAY, Tick
from impact_rs_control.controller import Mode
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags.reader import JointColumns
from impact_rs_trials.bags.trial_info import OUTCOMES, Outcome
from impact_rs_trials.runs import Poses

MAX_SUNK_SHARE = 0.5  # of the commanded lift, below the commanded height; beyond it the object slipped or fell
MAX_VIOLATION_S = 0.005  # beyond a limit of position, speed or tilt; a shorter violation is a spike of a sensor
MAX_TORQUE_VIOLATION_S = 0.05  # the impact of a healthy grab takes 6 ms, with up to 1.9 times the limit
MAX_UNSOLVED_S = 0.05  # without a solution of the QP
COMMANDED_LIMIT_FACTOR = 1.001  # of the limit; separates a command at its limit from one beyond it
MEASURED_LIMIT_FACTOR = 1.05  # of the limit; noise and vibration of the joint reach it when a command is at its limit
MAX_TILT_IN_TRIAL_RAD = np.radians(20.0)  # of the object from upright; healthy ones turn by 2 degrees
PERIOD_ROUNDING_S = 1e-9  # of a sum of periods


@dataclass(frozen=True)
class Verdict:
    """Outcome of a trial.

    Attributes:
        outcome: A key of ``OUTCOMES``.
        reason: Time, joint, value and limit in one line; empty for ``OK``.
    """

    outcome: Outcome
    reason: str = ""


@dataclass(frozen=True)
class ArmRecord:
    """Record of one arm.

    Attributes:
        joints: Measured state.
        command_time: Times of the commands, ``(m,)`` [s].
        command: Commanded torque, ``(m, n)`` [N m].
        qp_status: Status of the QP, ``(m,)``; see :class:`~impact_rs_control.qp.QpStatus`.
        hit: Whether it detected an impact.
        mode: Mode of the controller, ``(m,)``; see :class:`~impact_rs_control.controller.Mode`.
    """

    joints: JointColumns
    command_time: Array
    command: Array
    qp_status: Array
    hit: bool
    mode: Array


@dataclass(frozen=True)
class TrialRecord:
    """Record of a trial, with the signals that its outcome depends on.

    Attributes:
        arms: By name.
        object: Measurements of the tracker.
    """

    arms: dict[str, ArmRecord]
    object: Poses


class TickLog:
    """Tick log of a trial in this process, for its outcome.

    Args:
        plan: The trial.
    """

    def __init__(self, plan: TrialPlan) -> None:
        self._arms = list(plan.arms)
        self._ticks: list[Tick] = []

    def append(self, tick: Tick) -> None:
        """Add one tick."""
        self._ticks.append(tick)

    def record(self) -> TrialRecord:
        """The record so far."""
        return TrialRecord({name: self._arm(name) for name in self._arms}, self._object())

    def _arm(self, name: str) -> ArmRecord:
        measured = [tick.measurement.arms[name] for tick in self._ticks]
        commands = [tick.commands[name] for tick in self._ticks]
        time = np.array([tick.measurement.time for tick in self._ticks])
        return ArmRecord(
            joints=JointColumns(
                time=time,
                position=np.array([arm.position for arm in measured]),
                velocity=np.array([arm.velocity for arm in measured]),
                effort=np.array([arm.torque for arm in measured]),
            ),
            command_time=time,
            command=np.array([command.torque for command in commands]),
            qp_status=np.array([command.qp_status for command in commands]),
            hit=any(command.detection is not None for command in commands),
            mode=np.array([command.mode for command in commands]),
        )

    def _object(self) -> Poses:
        return Poses.of_samples(
            [tick.measurement.object for tick in self._ticks if tick.measurement.object is not None]
        )


@dataclass(frozen=True)
class _Finding:
    """A violated condition.

    Attributes:
        outcome: Resulting outcome of the trial.
        time: Begin of the violation [s].
        reason: Reason in one line.
    """

    outcome: Outcome
    time: float
    reason: str


def judge(plan: TrialPlan, recorded: TrialRecord) -> Verdict:
    """Outcome of a trial that ran to its end, or ran away.

    Args:
        plan: Plan of the trial.
        recorded: Measured and commanded signals.
    """
    gravity = list(OUTCOMES)
    findings = sorted(_findings(plan, recorded), key=lambda finding: (gravity.index(finding.outcome), finding.time))
    return Verdict(findings[0].outcome, findings[0].reason) if findings else Verdict("OK")


def _findings(plan: TrialPlan, recorded: TrialRecord) -> Iterator[_Finding]:
    period = plan.scene.scenario.timing.control_period
    for name, arm in recorded.arms.items():
        model = plan.scene.models[name]
        yield from _runaway(name, arm, model)
        yield from _beyond_limits(name, arm, model, period)
        yield from _unsolved(name, arm, period)
    if plan.expects_impact:
        yield from _untouched(recorded)
        yield from _too_early(plan, recorded)
        object_ = plan.scene.physics.object
        if not object_.round and object_.guide is None:  # a ball rolls, and a flap turns on its hinge
            yield from _tipped(recorded.object, object_.shape.kind in ("capsule", "cylinder"))
    yield from _dropped(plan, recorded.object)


def _runaway(name: str, arm: ArmRecord, model: RobotModel) -> Iterator[_Finding]:
    """First joint over its speed limit, and first non-finite values."""
    joints = arm.joints
    if joints.time.size:
        speed = np.abs(joints.velocity) / model.velocity_max
        for row in np.flatnonzero(~(speed <= RUNAWAY).all(axis=1))[:1]:  # a NaN is below no bound
            joint, time = int(np.argmax(speed[row])), float(joints.time[row])
            unit = model.facts.units[joint].velocity
            yield _Finding(
                "DIVERGED",
                time,
                f"{name} joint{joint + 1} at {abs(joints.velocity[row, joint]):.4g} {unit} against "
                f"{model.velocity_max[joint]:.4g} {unit} at {time:.3f} s",
            )
    for signal, times, values in (
        ("position", joints.time, joints.position),
        ("torque", joints.time, joints.effort),
        ("commanded torque", arm.command_time, arm.command),
    ):
        for row, joint in np.argwhere(~np.isfinite(values))[:1]:
            time = float(times[row])
            yield _Finding("DIVERGED", time, f"{name} joint{joint + 1}: {signal} not finite at {time:.3f} s")


def _beyond_limits(name: str, arm: ArmRecord, model: RobotModel, period: float) -> Iterator[_Finding]:
    """Every joint that was beyond one of its limits for too long."""
    joints, torque = arm.joints, model.torque_max
    stops = (model.position_min, model.position_max)
    for signal, quantity, time, values, (low, high), margin, max_duration in (
        ("position", "position", joints.time, joints.position, stops, 1.0, MAX_VIOLATION_S),
        (
            "speed",
            "velocity",
            joints.time,
            joints.velocity,
            (-model.velocity_max, model.velocity_max),
            1.0,
            MAX_VIOLATION_S,
        ),
        (
            "torque",
            "effort",
            joints.time,
            joints.effort,
            (-torque, torque),
            MEASURED_LIMIT_FACTOR,
            MAX_TORQUE_VIOLATION_S,
        ),
        (
            "commanded torque",
            "effort",
            arm.command_time,
            arm.command,
            (-torque, torque),
            COMMANDED_LIMIT_FACTOR,
            MAX_TORQUE_VIOLATION_S,
        ),
    ):
        if not time.size:
            continue
        beyond = (values < margin * low) | (values > margin * high)
        duration = beyond.sum(axis=0) * period
        for joint in np.flatnonzero(duration > max_duration + PERIOD_ROUNDING_S):
            rows = np.flatnonzero(beyond[:, joint])
            excess = np.maximum(values[rows, joint] - high[joint], low[joint] - values[rows, joint])
            worst = values[rows[np.argmax(excess)], joint]
            limit = high[joint] if worst > high[joint] else low[joint]
            since, unit = float(time[rows[0]]), getattr(model.facts.units[joint], quantity)
            yield _Finding(
                "LIMIT",
                since,
                f"{name} joint{joint + 1}: {signal} {worst:.4g} {unit} against {limit:.4g} {unit}, beyond it for "
                f"{1e3 * duration[joint]:.0f} ms from {since:.3f} s",
            )


def _unsolved(name: str, arm: ArmRecord, period: float) -> Iterator[_Finding]:
    """A controller whose limits contradicted each other for too long."""
    rows = np.flatnonzero(arm.qp_status != QpStatus.SOLVED)
    if rows.size * period > MAX_UNSOLVED_S + PERIOD_ROUNDING_S:
        since, duration_ms = float(arm.command_time[rows[0]]), 1e3 * rows.size * period
        yield _Finding(
            "INFEASIBLE",
            since,
            f"{name}: no torque within the limits solved its QP for {duration_ms:.0f} ms from {since:.3f} s",
        )


def _untouched(recorded: TrialRecord) -> Iterator[_Finding]:
    """Arms without a planned impact."""
    missed = [name for name, arm in recorded.arms.items() if not arm.hit]
    if missed:
        yield _Finding("NO-IMPACT", 0.0, f"{', '.join(missed)} detected no impact")


def _too_early(plan: TrialPlan, recorded: TrialRecord) -> Iterator[_Finding]:
    """An impact that was detected before the pad could touch the object."""
    timing, detection = plan.scene.scenario.timing, plan.scene.scenario.control.detection
    begin = timing.window[0]
    for name, arm in recorded.arms.items():
        for row in np.flatnonzero(arm.mode != Mode.ANTE)[:1]:
            if float(arm.command_time[row]) < begin - PERIOD_ROUNDING_S:
                time = float(arm.command_time[row])
                yield _Finding(
                    "EARLY",
                    time,
                    f"{name} detected an impact at {time:.3f} s, before the window from {begin:.3f} s: "
                    f"raise control.detection.threshold, now {detection.threshold:g} N",
                )


def _tipped(poses: Poses, about_axis: bool) -> Iterator[_Finding]:
    """An object that tips over, by the angle between the vertical in body axes now and at the start.

    Args:
        poses: Tracked poses of the object.
        about_axis: Whether the object is round about its z axis and may roll: then only the angle of that axis counts.
    """
    # The vertical in body axes is the last row of R: (2 (x z - y w), 2 (y z + x w), 1 - 2 (x^2 + y^2)).
    if poses.time.size < 2:
        return
    x, y, z, w = poses.quaternion.T
    vertical = np.stack((2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x**2 + y**2)), axis=-1)
    tilt = np.arccos(np.clip(vertical @ vertical[0], -1.0, 1.0))
    if about_axis:
        lean = np.arccos(np.clip(vertical[:, 2], -1.0, 1.0))
        tilt = np.abs(lean - lean[0])
    rows = np.flatnonzero(tilt > MAX_TILT_IN_TRIAL_RAD)
    if rows.size * np.median(np.diff(poses.time)) > MAX_VIOLATION_S + PERIOD_ROUNDING_S:
        since, worst, limit = float(poses.time[rows[0]]), np.degrees(tilt.max()), np.degrees(MAX_TILT_IN_TRIAL_RAD)
        yield _Finding(
            "TIPPED", since, f"the object leaned by {worst:.0f} degrees against {limit:.0f} degrees from {since:.3f} s"
        )


def _dropped(plan: TrialPlan, poses: Poses) -> Iterator[_Finding]:
    """An object that should be lifted and had not risen enough in its last tracked pose."""
    if not poses.time.size:  # it was not tracked
        return
    last = float(poses.time[-1])
    expected_lift = plan.expected_lift_at(last)
    lift = float(poses.position[-1, 2] - poses.position[0, 2])
    if expected_lift - lift > MAX_SUNK_SHARE * plan.expected_lift > 0.0:
        yield _Finding(
            "DROPPED", last, f"the object rose {lift:.3f} m until {last:.3f} s, it was to rise {expected_lift:.3f} m"
        )
