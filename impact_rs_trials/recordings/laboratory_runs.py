# SPDX-License-Identifier: Apache-2.0
"""Runs of a laboratory with its own controller: from its files to checked signals on one clock.

Invalid data is refused in one line. Gaps split a run into pieces (:mod:`impact_rs_trials.recordings.run_pieces`); they
are listed, so that interpolated samples are not used as measurements. A run whose pieces are all too short is left out,
with the reason.

Several arms share the grid of the arm with the highest rate of joint states, over the time in which all of them were
recorded.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import BodyState, resting_pose
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.checks.plausibility import check_gravity_torque, gravity_torques
from impact_rs_trials.recordings.experiment import Experiment, RunRow, read_runs, run_named
from impact_rs_trials.recordings.joint_clock import on_clock_of_joints
from impact_rs_trials.recordings.laboratory import ArmSeries, Laboratory
from impact_rs_trials.recordings.mapping import REQUIRED, SignalName
from impact_rs_trials.recordings.pad_and_object import check_object_of_run, in_inertial_frame, touches_of
from impact_rs_trials.recordings.readers.clock import grid_from
from impact_rs_trials.recordings.recording import TooShort, check_arm
from impact_rs_trials.recordings.remarks import remark
from impact_rs_trials.recordings.run_pieces import (
    ARM_SIGNALS,
    MIN_RUN_SAMPLES,
    around_grid,
    check_overlap,
    check_signal,
    inside_pieces,
    on_grid,
    usable_pieces,
    warn_of_pose_rate,
    warn_of_rates,
)
from impact_rs_trials.runs import NONE, ArmSignals, Run, Signals
from impact_rs_trials.since import MIN_WALL_CLOCK_S
from impact_rs_trials.workers import Map

MAX_IMPACT_SHARE = 0.02  # of the samples, in which an impact may take a velocity or torque beyond the data sheet
OUT_OF_REACH_M = 5.0  # distance of the object in free motion


def read_laboratory(directory: Path, experiment: Experiment, map_tasks: Map) -> tuple[list[Run], list[tuple[str, str]]]:
    """Every run of an experiment.

    Args:
        directory: Folder of the recordings.
        experiment: Describes them.
        map_tasks: Maps the reader over the runs.

    Returns:
        Runs in the order of the table; path and reason of the skipped runs.

    Raises:
        InputError: Experiment, table or a recording cannot be used; or no run remains.
    """
    laboratory = Laboratory.of(experiment)
    table = read_runs(directory, experiment, laboratory.scenario)
    read: list[Run] = []
    skipped: list[tuple[str, str]] = []
    laboratory = with_tracker_frame(laboratory, table, map_tasks)
    tasks = [(laboratory, run) for run in table]
    for run, result in zip(table, map_tasks(_try_to_read, tasks), strict=True):
        if isinstance(result, Run):
            read.append(result)
        elif isinstance(result, TooShort):
            skipped.append((str(run.path), result.message))
        else:
            raise result
    if not read:
        raise InputError(f"no run can be used; {Path(skipped[0][0]).name}: {skipped[0][1]}", file=directory)
    return read, skipped


def read_one(directory: Path, experiment: Experiment, name: str, map_tasks: Map) -> Run:
    """One run of an experiment; other runs are read only to place the motion capture.

    Args:
        directory: Folder of the recordings.
        experiment: Describes them.
        name: Name of the run (:func:`~impact_rs_trials.recordings.experiment.run_named`).
        map_tasks: Maps the reader over the runs.

    Raises:
        InputError: There is no such run, or experiment, table or recording cannot be used.
    """
    laboratory = Laboratory.of(experiment)
    table = read_runs(directory, experiment, laboratory.scenario)
    row = run_named(table, directory, name)
    return read_run(with_tracker_frame(laboratory, table, map_tasks), row)


def with_tracker_frame(laboratory: Laboratory, table: Sequence[RunRow], map_tasks: Map) -> Laboratory:
    """The laboratory with the frame of its motion capture, estimated from the hits if the experiment asks for it.

    Raises:
        InputError: No hit can be used for the estimate.
    """
    if not laboratory.motion_capture.estimate:
        return laboratory
    hits = [(laboratory, run) for run in table if run.hit]
    return laboratory.with_frame_from([touch for touches in map_tasks(touches_of, hits) for touch in touches])


def _try_to_read(task: tuple[Laboratory, RunRow]) -> Run | InputError:
    """:func:`read_run`; errors are returned, because dask retries tasks that raise."""
    try:
        return read_run(*task)
    except InputError as error:
        return error


def read_run(laboratory: Laboratory, run: RunRow) -> Run:
    """One run, checked.

    Raises:
        TooShort: The pieces between gaps are too short.
        InputError: The run cannot be used; the message states place, reason and remedy.
    """
    path, tracker = run.path, laboratory.tracker
    wanted: list[SignalName] = [*ARM_SIGNALS, "command", "wrench", *(OBJECT_SIGNALS if run.hit else ())]
    remarks: list[str] = []
    arms = on_clock_of_joints(laboratory, run, wanted, _needed(laboratory, run), remarks)
    faults: list[str] = []
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            for name, signal in series.items():
                check_signal(path, name, signal)
            arms[arm], left_out = laboratory.without_faults(arm, series, run.hit)
            faults += [f"{laboratory.label(arm)}{warning}" for warning in left_out]
            if any(arms[arm][name].time.size < MIN_RUN_SAMPLES for name in REQUIRED):
                raise TooShort("; ".join(faults), file=path)
    remarks += faults
    base = _fastest(arms)
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            check_overlap(path, arms[base]["position"], series)
    origin = float(arms[base]["position"].time[0])  # numbers of the wall clock have no room for microseconds
    position = arms[base]["position"]
    began = origin if position.log is None or origin > MIN_WALL_CLOCK_S else float(position.log[0])
    arms = {
        arm: {name: replace(signal, time=signal.time - origin) for name, signal in series.items()}
        for arm, series in arms.items()
    }
    pose_series = arms[tracker].pop("object_pose", None)

    try:
        pieces, main = usable_pieces(run, arms, pose_series, remarks)
    except TooShort as error:
        raise TooShort("; ".join([error.message, *faults]), file=error.file) from None
    raw = arms[base]["position"].time
    grid = grid_from(raw[inside_pieces(raw, pieces)], raw[inside_pieces(raw, [main])])
    for arm, series in arms.items():
        warn_of_rates(series["position"], grid, pieces, main if arm != base else None, remarks)
    warn_of_pose_rate(pose_series, remarks)
    time = grid - grid[0]
    signals_of_arms = {arm: _arm_of(laboratory, run, arm, series, grid, remarks) for arm, series in arms.items()}
    object_time, pose = around_grid(pose_series, grid, np.zeros((0, 7)))
    if object_time.size:
        if laboratory.estimated_frame is not None:
            remarks.append(str(laboratory.estimated_frame))
        pose = in_inertial_frame(laboratory.motion_capture, run, pose)
        for arm, joints in signals_of_arms.items():
            with laboratory.errors_of(arm):
                remarks += check_object_of_run(laboratory, run, arm, time, joints.position, object_time, pose)
    elif run.hit:
        remarks.append("the object was not tracked: it starts where the scenario places it")
    signals = Signals(time, _alike(signals_of_arms), object_time, pose[:, :3], pose[:, 3:])
    gaps_between = tuple((end - grid[0], start - grid[0]) for (_, end), (start, _) in itertools.pairwise(pieces))
    result = _in_scene(laboratory.scenario, run, signals, gaps_between, tuple(dict.fromkeys(remarks)))
    return replace(result, recorded=began if began > MIN_WALL_CLOCK_S else None)


def _alike(arms: Mapping[str, ArmSignals]) -> dict[str, ArmSignals]:
    """The arms with their common signals, because all arms of a replay have the same drive."""
    common = set.intersection(*(set(signals.measured) for signals in arms.values()))
    left_out = {name: NONE for signals in arms.values() for name in signals.measured if name not in {*common, "wrench"}}
    left_out |= {"command_time": NONE} if "command" in left_out else {}
    return {name: replace(signals, **left_out) for name, signals in arms.items()}


def _in_scene(
    scenario: Scenario, row: RunRow, signals: Signals, gaps: tuple[tuple[float, float], ...], remarks: tuple[str, ...]
) -> Run:
    """The run of a row of the table in the scene of its scenario."""
    object_name = row.object or next(iter(scenario.objects))
    object_state = resting_pose(scenario, object_name)
    if not row.hit:
        away = object_state.position + [OUT_OF_REACH_M, OUT_OF_REACH_M, 0.0]
        object_state = BodyState(away, object_state.rotation, object_state.twist)
    return Run(
        path=row.path,
        name=row.name,
        condition="/".join(part for part in (row.object or "free motion", row.condition) if part),
        condition_key=(scenario.name, row.object or "none", row.condition),
        hit=row.hit,
        physics=Physics.nominal(scenario, object_name),
        signals=signals,
        object=object_state,
        drive_period=scenario.timing.drive_period,
        axis=scenario.axis_index,
        gaps=gaps,
        remarks=remarks,
    )


def _needed(laboratory: Laboratory, run: RunRow) -> list[SignalName]:
    """Required signals of a run: the joints' signals, and further signals of the mappings."""
    in_mappings = {name for mapping in laboratory.mappings.values() for name in mapping.signals}
    optional: tuple[SignalName, ...] = ("command", *(OBJECT_SIGNALS if run.hit else ()))
    return [*REQUIRED, *(name for name in optional if name in in_mappings)]


def _fastest(arms: Mapping[str, ArmSeries]) -> str:
    """The arm with the shortest period of joint states; of equal ones the first."""
    return min(arms, key=lambda arm: round(float(np.median(np.diff(arms[arm]["position"].time))), 6))


def _arm_of(
    laboratory: Laboratory, run: RunRow, arm: str, series: ArmSeries, grid: Array, remarks: list[str]
) -> ArmSignals:
    """One arm on the grid of the run; warnings are appended to the remarks."""
    mapping, path = laboratory.mappings[arm], run.path
    joints = ArmSignals(**{name: on_grid(series[name], grid) for name in ARM_SIGNALS if name in series})
    time, none = grid - grid[0], np.zeros((0, len(mapping.joints)))
    with laboratory.errors_of(arm):
        check_arm(path, time, joints, mapping, MAX_IMPACT_SHARE if run.hit else 0.0)
        remedy = "wrong sign or unit, or without the gravity torque?"
        check_gravity_torque(path, "torque", laboratory.models[arm], joints.position, joints.torque, remedy)
        warnings = arm_warnings(time, joints, mapping, laboratory.models[arm], run.hit)
        remarks += [remark("{}{}", laboratory.label(arm), warning) for warning in warnings]
        command_time, command = around_grid(series.get("command"), grid, none)
        if command_time.size:
            command = _with_gravity(laboratory, path, arm, time, joints.position, command_time, command)
        else:
            remarks.append(
                f"{laboratory.label(arm)}no command was recorded: the joint torque has to drive the replay, which "
                "hides gears and motors"
            )
    wrench_time, wrench = around_grid(series.get("wrench"), grid, np.zeros((0, 6)))
    return replace(joints, command_time=command_time, command=command, wrench_time=wrench_time, wrench=wrench)


def _with_gravity(
    laboratory: Laboratory, path: Path, arm: str, time: Array, position: Array, command_time: Array, command: Array
) -> Array:
    """Desired torque with gravity, ``(m, n)`` [N m]; checks ``command_includes_gravity`` against the numbers."""
    position_at_commands = np.column_stack([np.interp(command_time, time, column) for column in position.T])
    included, model = laboratory.mappings[arm].command_includes_gravity, laboratory.models[arm]
    with_gravity = command if included else command + gravity_torques(model, position_at_commands)
    remedy = (
        "command_includes_gravity: false in the mapping, where it comes without the gravity torque"
        if included
        else "command_includes_gravity: true in the mapping, where it holds the gravity torque already"
    )
    check_gravity_torque(path, "command", model, position_at_commands, with_gravity, remedy)
    return with_gravity
