# SPDX-License-Identifier: Apache-2.0
"""Runs of another controller: reading, and the offset between the clocks of commands and joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.replays.features import FreeBalances
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replays.replay import FREE_WINDOW_S, free_starts, held_means, recorded
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.experiment import Experiment
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.recordings.remarks import merged, remark
from impact_rs_trials.runs import ArmSignals, Run
from impact_rs_trials.workers import Map

MAX_OFFSET_PERIODS = 0.5  # sampling periods; a larger offset is a delay, left to the diagnosis
SLOPE_AVERAGING_S = 0.002  # of the command at both ends of a window, for its slope
MIN_WINDOWS_OF_JOINT = 8  # for five terms


def read_laboratory_runs(directory: Path, experiment: Experiment, map_tasks: Map) -> Runs:
    """Every run of an experiment.

    Args:
        directory: Folder of the recordings.
        experiment: Description of the recordings.
        map_tasks: Parallel map.

    Raises:
        InputError: A file cannot be used; the message names it.
    """
    return read_runs_of_scenes(directory, (experiment,), map_tasks)


def read_runs_of_scenes(directory: Path, experiments: Sequence[Experiment], map_tasks: Map) -> Runs:
    """Every run of several experiments with the same arms, each in its own scene; they share one clock offset.

    Args:
        directory: Folder of the recordings.
        experiments: Descriptions of the recordings, each with its scenario and its table of runs.
        map_tasks: Parallel map.

    Raises:
        InputError: A file cannot be used; the message names it.
    """
    read = [read_laboratory(directory, experiment, map_tasks) for experiment in experiments]
    runs, skipped = ([item for part in parts for item in part] for parts in zip(*read, strict=True))
    remarks = [(run.name, text) for run in runs for text in run.remarks]
    estimates = {arm: command_offset(runs, arm) for arm in runs[0].signals.arms}
    offsets = {arm: offset for arm, (offset, _) in estimates.items()}
    runs = [run.commands_later(offsets) for run in runs]
    for arm, offset in offsets.items():
        if offset == 0.0:
            continue
        whose = f"commands of arm {arm!r}" if len(offsets) > 1 else "commands"
        warning = (
            f"{whose} act {1e3 * abs(offset):.2f} ms {'after' if offset > 0.0 else 'before'} their stamps, by the "
            "torque balance of free motion; they are shifted by that (below half a sampling period it is an offset of "
            "clocks)"
        )
        remarks.append(("", warning))
    measured = list(map_tasks(measured_or_why_not, runs))
    dropped = "{:d} of {:d} windows of free motion touch a gap, and are dropped from all such runs"
    remarks += [
        (run.name, remark(dropped, len(run.lost), run.free))
        for run in measured
        if isinstance(run, MeasuredRun) and run.lost
    ]
    measured_runs = Runs.of(directory, [*measured, *skipped])
    clock = MAX_OFFSET_PERIODS * max((run.period for run in runs if run.commanded), default=0.0)
    late = _late(measured_runs, runs, {arm: error for arm, (_, error) in estimates.items()}, map_tasks)
    return replace(measured_runs, remarks=tuple(merged(remarks)), clock=clock, late=late)


def _late(measured: Runs, runs: Sequence[Run], errors: Mapping[str, float], map_tasks: Map) -> dict[str, MeasuredRun]:
    """The first run of every condition with commands that act later by a standard error of their offset."""
    if not any(errors.values()):
        return {}
    by_path = {run.path: run for run in runs}
    firsts = {condition: repeats[0] for condition, repeats in measured.conditions.items()}
    shifted = map_tasks(measured_or_why_not, [by_path[first.path].commands_later(errors) for first in firsts.values()])
    return {
        condition: late.only(set(first.features)).aged(first.setup.windows[0].age)
        for (condition, first), late in zip(firsts.items(), shifted, strict=True)
        if isinstance(late, MeasuredRun) and set(first.features) <= set(late.features)
    }


def measured_or_why_not(run: Run) -> MeasuredRun | tuple[str, str]:
    """The measured run, or its path and the reason why it cannot be used."""
    try:
        return MeasuredRun.of(run)
    except InputError as error:
        return str(run.path), error.message


def command_offset(runs: Sequence[Run], name: str) -> tuple[float, float]:
    """Offset of an arm's commands after their timestamps, and its standard error [s].

    An offset above the limit is a delay of commands or torques, which is left to the diagnosis; the clock then keeps
    its prior uncertainty.

    In free motion the motor-side balance of a window is

        b_m = delta dtau_d/dt + (contributions of friction, offset, gain and inertia of the joint)

    to first order in the offset delta. A regression over all windows has one delta and, for every joint, a constant,
    the sign and the mean of its velocity, the mean torque and the acceleration. Windows in which a joint reverses are
    not used for that joint, because the sign of its dry friction changes. Runs in free motion are preferred, because
    there are few windows before an impact.

    The prior of delta is uniform over half a sampling period either way.

    Args:
        runs: Runs of one laboratory.
        name: Name of the arm.

    Returns:
        Posterior mean and standard deviation of delta.
    """
    chosen = [run for run in runs if run.commanded and not run.hit] or [run for run in runs if run.commanded]
    rows: dict[int, list[Array]] = {}
    for run in chosen:
        starts = free_starts(run, {}) if not run.hit else free_starts(run, _rough_impact(run))
        for start in (start for start in starts if recorded(run, start)):
            terms, reverses = _window_terms(run, name, run.signals.arms[name], start)
            for joint in np.flatnonzero(np.logical_not(reverses)).tolist():
                rows.setdefault(joint, []).append(terms[joint])
    tables = [np.array(windows) for windows in rows.values() if len(windows) >= MIN_WINDOWS_OF_JOINT]
    if not tables:
        return 0.0, 0.0
    slopes, residuals = [], []
    for table in tables:
        balance, slope, regressors = table[:, 0], table[:, 1], table[:, 2:]
        design = np.column_stack((np.ones(len(table)), regressors))
        basis = np.linalg.qr(design / np.maximum(np.linalg.norm(design, axis=0), 1e-12))[0]
        slopes.append(slope - basis @ (basis.T @ slope))
        residuals.append(balance - basis @ (basis.T @ balance))
    # Weights: the inverse noise of each joint.
    weights = [1.0 / max(float(np.std(residual)), 1e-9) for residual in residuals]
    a = np.concatenate([weight * slope for weight, slope in zip(weights, slopes, strict=True)])
    b = np.concatenate([weight * residual for weight, residual in zip(weights, residuals, strict=True)])
    offset = float(a @ b / (a @ a))
    error = float(np.sqrt(np.mean(np.square(b - offset * a)) / (a @ a)))
    # The time at which the torque loop takes a command within its period is unknown: uniform, half a period either way.
    error = math.hypot(error, chosen[0].drive_period / math.sqrt(12.0))
    largest = MAX_OFFSET_PERIODS * chosen[0].period
    prior_variance = largest**2 / 3.0  # of a uniform distribution
    if abs(offset) > largest:
        return 0.0, math.sqrt(prior_variance)
    share = prior_variance / (prior_variance + error**2)
    return float(np.clip(share * offset, -largest, largest)), math.sqrt(share) * error


def _rough_impact(run: Run) -> dict[str, float]:
    """Rough time of the impact by arm: the fastest change of a joint velocity."""
    change = np.max([np.abs(np.diff(arm.velocity, axis=0)).max(axis=1) for arm in run.signals.arms.values()], axis=0)
    return {name: float(run.signals.time[int(np.argmax(change))]) for name in run.signals.arms}


def _window_terms(run: Run, name: str, arm: ArmSignals, start: float) -> tuple[Array, Array]:
    """Terms of :func:`command_offset` for one window.

    Returns:
        By joint its balance, the slope of its command and the other regressors, ``(n, 6)``; whether it reverses,
        ``(n,)``.
    """
    time = run.signals.time
    rows = (time >= start - 1e-9) & (time <= start + FREE_WINDOW_S + 1e-9)
    cut = arm.at(rows)
    physics = run.physics.arms[name]
    model, stacked = run.physics.robot_model(name), ArmSignals.stack([cut])
    balances = FreeBalances.of(time[rows], stacked, physics, model, run.motor_measured)
    begin, end = balances.middle
    (acceleration,), (transmitted,) = balances.acceleration, balances.transmitted
    sent, values = arm.command_time, arm.command
    torque = _held_mean(sent, values, begin, end)
    slope = (
        _held_mean(sent, values, end - SLOPE_AVERAGING_S, end + SLOPE_AVERAGING_S)
        - _held_mean(sent, values, begin - SLOPE_AVERAGING_S, begin + SLOPE_AVERAGING_S)
    ) / (end - begin)
    balance = torque - transmitted - physics.motor_inertia_reduced * acceleration
    speed = cut.velocity.mean(axis=0)
    reverses = np.min(cut.velocity, axis=0) * np.max(cut.velocity, axis=0) < 0.0
    return np.column_stack((balance, slope, np.sign(speed), speed, torque, acceleration)), reverses


def _held_mean(sent: Array, values: Array, start: float, end: float) -> Array:
    """Mean over a window of zero-order-hold commands, ``(n,)`` [N m]."""
    return np.asarray(held_means(sent, values, np.array([start, end]))[0])
