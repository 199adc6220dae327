# SPDX-License-Identifier: Apache-2.0
"""Impacts in the runs of an experiment: a body on a plane, or arms on an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.experiment import Body, Experiment, Plane, RunRow, read_runs
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.arm_impacts import impacts_of_run
from impact_rs_trials.recordings.impacts.body_impacts import TrackedBody, impacts_of_bodies
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup
from impact_rs_trials.recordings.impacts.impact_rows import Impact, NoRow
from impact_rs_trials.recordings.joint_clock import with_object
from impact_rs_trials.recordings.laboratory import Laboratory
from impact_rs_trials.recordings.laboratory_runs import with_tracker_frame
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.run_finder import find_runs, unique_names
from impact_rs_trials.recordings.readers.series import Names
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.remarks import merged, remark
from impact_rs_trials.workers import Map

SPIN = (
    "the rotation of the ball was not tracked: its spin before the impacts is body.spin, on which its friction "
    "depends, and its spin after them is not compared"
)
SOME_BY_DISTANCE = (
    "in {} of {} impacts the velocity after follows from the sliding distance, which gives no angular velocity: the "
    "table has no columns w_after"
)
ALL_BY_DISTANCE = (
    "the outcome of all impacts is the sliding distance (slide_distance): the object was tracked too slowly, so "
    "the table has no columns v_after and w_after, and predictions depend on the friction of the support"
)
MAX_TRACKED_M = 1e4  # farther than any tracker sees
NEIGHBOUR_SAMPLES = 4  # on either side of a step, whose speeds are compared with its speed
MAX_STEP_RATIO = 5.0  # of the speed of a step to the speeds around it; no impact on a fixed plane exceeds it
REASONS_OF_STILL_AXES = (
    "",
    "a motion in a plane, or it was not tracked",
    "a motion along a line, or they were not tracked",
)


@dataclass(frozen=True)
class FoundImpacts:
    """Found impacts of an experiment.

    Attributes:
        impacts: Impacts in the order of the runs.
        left_out: Runs and impacts without a row, with the reason.
        runs: Number of searched runs.
        constants: Constant columns of the table: properties of the body, and assumptions about the contact.
        remarks: Warnings about reading the runs.
    """

    impacts: tuple[Impact, ...]
    left_out: tuple[NoRow, ...]
    runs: int
    constants: dict[str, float | str]
    remarks: tuple[str, ...] = ()


def find_impacts(directory: Path, experiment: Experiment, map_tasks: Map) -> FoundImpacts:
    """Impacts of all runs of an experiment.

    Args:
        directory: Folder of the recordings.
        experiment: Description of the runs.
        map_tasks: Maps a function over the runs, serially or by workers.

    Raises:
        InputError: The experiment, its table of runs or a file cannot be used.
    """
    if experiment.body is not None:
        return _of_bodies(directory, experiment, experiment.body, map_tasks)
    laboratory = Laboratory.of(experiment)
    rows = read_runs(directory, experiment, laboratory.scenario)
    hits = [run for run in rows if run.hit]
    if not hits:
        raise InputError("the table of runs names no hit; expected rows with kind hit", file=directory)
    laboratory = with_tracker_frame(laboratory, rows, map_tasks)
    impacts: list[Impact] = []
    left_out: list[NoRow] = []
    remarks: list[tuple[str, str]] = []
    tasks = [(laboratory, run) for run in hits]
    for run, (results, run_remarks) in zip(hits, map_tasks(_arm_task, tasks), strict=True):
        remarks += [(run.label, text) for text in run_remarks]
        impacts += [result for result in results if isinstance(result, Impact)]
        left_out += [result for result in results if isinstance(result, NoRow)]
    warnings = merged(remarks, len(hits))
    if unknown := sum(not impact.turn_tracked for impact in impacts):
        warnings.append(ALL_BY_DISTANCE if unknown == len(impacts) else SOME_BY_DISTANCE.format(unknown, len(impacts)))
    return FoundImpacts(tuple(impacts), tuple(left_out), len(hits), {}, tuple(warnings))


def _arm_task(task: tuple[Laboratory, RunRow]) -> tuple[list[Impact | NoRow], tuple[str, ...]]:
    return impacts_of_run(*task)


# ---- a body on a plane ----------------------------------------------------------------------------------------------


def _of_bodies(directory: Path, experiment: Experiment, body: Body, map_tasks: Map) -> FoundImpacts:
    """Impacts of a body on a plane; a run whose file cannot be read is left out with the reason."""
    (mapping,) = experiment.load_mappings(["body"]).values()
    plane = experiment.plane or Plane()
    tables = (directory / experiment.runs, experiment.folder / experiment.runs)
    if any(table.is_file() for table in tables):
        rows = [row for row in read_runs(directory, experiment, None) if row.hit]
    else:
        rows = [RunRow(run, "body", True, "") for run in find_runs(directory, mapping)]
    runs, left_out = [], []
    remarks: list[tuple[str, str]] = []
    by_name = dict(zip(unique_names([row.label for row in rows], [row.path for row in rows]), rows, strict=True))
    tracks = map_tasks(_track, [(row, mapping, body, plane) for row in rows])
    for name, result in zip(by_name, tracks, strict=True):
        if isinstance(result, InputError):
            left_out.append(NoRow(name, result.message))
        else:
            run, warnings = result
            runs.append(replace(run, run=name))
            remarks += [(name, text) for text in warnings]
    impacts, omitted = impacts_of_bodies(runs, body)
    named = [_with_condition(impact, by_name) for impact in impacts]
    constants = body_columns(body, plane)
    assumed = () if all(impact.turn_tracked for impact in impacts) else (SPIN,)
    all_remarks = (*merged(remarks, len(rows)), *assumed)
    return FoundImpacts(tuple(named), (*left_out, *omitted), len(rows), constants, all_remarks)


def _with_condition(impact: Impact, rows: dict[str, RunRow]) -> Impact:
    """The impact with condition and session of its run."""
    row = rows[impact.run if impact.run in rows else impact.run.rsplit(", impact ", 1)[0]]
    return replace(impact, condition=row.condition, session=row.session)


def body_columns(body: Body, plane: Plane) -> dict[str, float | str]:
    """Constant columns of an impact table by header: properties of the body, assumptions about the contact."""
    columns: list[tuple[ColumnGroup, Sequence[float | str]]] = [(col.MASS, (body.mass,))]
    if body.radius is None or body.inertia is not None:
        columns.append((col.MOMENTS, body.item.inertia.tolist()))
    if body.mesh is not None:
        columns.append((col.MESH, (body.mesh,)))
    elif body.shape != "box":
        columns.append((col.SHAPE, (body.shape,)))
    if body.radius is not None:
        columns += [(col.RADIUS, (body.radius,)), (col.SHELL, (float(body.shell),))]
    if body.size is not None:
        columns.append((col.SIZE, body.size))
    columns += [(col.FRICTION, (plane.friction,)), (col.RESTITUTION, (plane.restitution,))]
    return {header: value for column, values in columns for header, value in zip(column.headers, values, strict=True)}


def tracked_body(
    name: str, time: Array, pose: Array, body: Body, plane: Plane, spin: Array | None = None
) -> TrackedBody:
    """A run in a frame whose z axis is the normal of the plane and whose plane is z = 0.

    Args:
        name: Of the run.
        time: Stamps, ``(k,)`` [s].
        pose: Pose of the tracked frame, position and quaternion x y z w, ``(k, 7)``.
        body: Body, with its placement in that frame.
        plane: Plane in the tracker's world.
        spin: Angular velocity before impacts in that world, if the orientation was not tracked, ``(3,)`` [rad/s].
    """
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    levelling = pin.Quaternion.FromTwoVectors(normal, np.array([0.0, 0.0, 1.0])).matrix()
    placements = [pin.XYZQUATToSE3(np.concatenate((row[:3], row[3:] / np.linalg.norm(row[3:])))) for row in pose]
    bodies = [placement * body.place.placement for placement in placements]
    position = np.array([placed.translation for placed in bodies]) @ levelling.T - np.array([0.0, 0.0, plane.height])
    rotation = np.array([levelling @ placed.rotation for placed in bodies])
    level_spin = None if spin is None else levelling @ spin
    return TrackedBody(name, time - time[0], position, rotation, levelling @ np.array(plane.gravity), level_spin)


def _track(task: tuple[RunRow, Mapping, Body, Plane]) -> tuple[TrackedBody, list[str]] | InputError:
    """A tracked run with warnings, or the error for which it is left out."""
    remarks: list[str] = []
    row, mapping, body, plane = task
    rotation_tracked = "object_quaternion" in mapping.signals or "object_pose" in mapping.signals
    if not rotation_tracked and body.spin is None:
        text = "the orientation of the body was not tracked (object_quaternion), and how it bounces depends on its spin"
        return InputError(f"{text}; for a ball give body.spin, [0, 0, 0] if it was dropped without spin")
    wanted = [name for name in OBJECT_SIGNALS if name in mapping.signals]
    try:
        signals = dict(read_series(row.path, mapping, wanted, wanted, Names(run=row.name)))
        if not rotation_tracked:
            position = signals.pop("object_position")
            upright = np.tile([0.0, 0.0, 0.0, 1.0], (position.time.size, 1))
            signals["object_pose"] = replace(position, values=np.hstack((position.values, upright)))
        pose = with_object(row.path, signals, remarks)["object_pose"]
        remarks += pose.remarks
        finite = np.isfinite(pose.values).all(axis=1)
        if not finite.any():
            raise InputError(f"{pose.label}: every sample has a number that is not finite")
        if np.any(np.diff(pose.time) <= 0.0):
            raise InputError("time stamps stand still or run backwards; time.repeated: keep_first keeps one of each")
        spin = None if rotation_tracked else np.array(body.spin)
        farthest = float(np.max(np.abs(pose.values[finite, :3]), initial=0.0))
        if farthest > MAX_TRACKED_M:
            raise InputError(f"{pose.label} is up to {farthest:.3g} m from the tracker's origin: wrong unit or column?")
        if not finite.all():
            words = "{}: {:d} of {:d} samples are not finite and left out"
            remarks.append(remark(words, pose.label, int(np.sum(~finite)), finite.size))
        remarks += _motion_warnings(pose.label, pose.time[finite], pose.values[finite, :3])
        return tracked_body(row.label, pose.time[finite], pose.values[finite], body, plane, spin), remarks
    except InputError as error:
        return error


def _motion_warnings(label: str, time: Array, position: Array) -> list[str]:
    """Warnings about impossible motions of a free body: a constant coordinate, or a jump; positions ``(k, 3)`` [m]."""
    varying = np.ptp(position, axis=0) > 0.0
    warnings = []
    if still := [axis for axis, varies in zip("xyz", varying, strict=True) if not varies and varying.any()]:
        warnings.append(f"{label}: {' and '.join(still)} the same in all samples: {REASONS_OF_STILL_AXES[len(still)]}")
    speeds = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(time)
    if speeds.size <= 2 * NEIGHBOUR_SAMPLES:
        return warnings
    neighbours = np.array(
        [np.roll(speeds, shift) for shift in range(-NEIGHBOUR_SAMPLES, NEIGHBOUR_SAMPLES + 1) if abs(shift) > 1]
    ).max(axis=0)
    inside = slice(NEIGHBOUR_SAMPLES, -NEIGHBOUR_SAMPLES)  # rolled steps come from the other end
    jumps = NEIGHBOUR_SAMPLES + np.flatnonzero(
        speeds[inside] > MAX_STEP_RATIO * np.maximum(neighbours[inside], np.median(speeds))
    )
    if jumps.size:
        jump = np.linalg.norm(position[jumps[0] + 1] - position[jumps[0]])
        words = (
            "{}: jumps by {:.3g} mm between two samples at t = {:.3f} s, "
            f"{MAX_STEP_RATIO:g} times as fast as before and after: columns, units or a marker that changed?"
        )
        warnings.append(remark(words, label, 1e3 * float(jump), float(time[jumps[0]] - time[0])))
    return warnings
