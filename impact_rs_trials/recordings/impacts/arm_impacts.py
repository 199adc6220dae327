# SPDX-License-Identifier: Apache-2.0
"""Impacts of arms on an object, in runs of another controller: states of joints and object before and after.

Joint velocities jump (:mod:`joint_jumps`). The object rests or moves before; after, it slides (velocity and
deceleration are fitted) or flies (if it falls with g). If it is tracked too slowly for a fit and comes to rest, the
sliding distance D gives v with v^2 = 2 mu g D and the friction of the scenario's support.

If a force-torque sensor at the wrist, or an accelerometer, is at least twice as fast as the joint positions, its
onset gives the time of the impact, and the motion is fitted about it (:mod:`contact_onset`).

A run may hold several impacts. An impact changes the velocities of joints and object by at least ``MIN_JUMP_SHARE`` of
the largest change; smaller jumps are a pushed object that rattles at the pad. The motion of the object is fitted
between consecutive impacts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2, STANDARD_GRAVITY
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS, clocks_apart
from impact_rs_trials.recordings.checks.joint_jumps import MIN_JUMP_SHARE, JointJump, jump_at, jumps_of
from impact_rs_trials.recordings.checks.plausibility import check_touch
from impact_rs_trials.recordings.experiment import RunRow
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.contact_onset import onset_of
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup
from impact_rs_trials.recordings.impacts.impact_rows import BY_SLIDING_DISTANCE, Impact, NoRow
from impact_rs_trials.recordings.impacts.motion_fits import MAX_REST_SIGMA, FittedMotion, contact_noise, fly, move, rest
from impact_rs_trials.recordings.joint_clock import on_clock_of_joints
from impact_rs_trials.recordings.laboratory import ArmSeries, Laboratory
from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.pad_and_object import in_inertial_frame
from impact_rs_trials.recordings.run_pieces import MIN_POSE_RATE_HZ

Jumps = Mapping[str, JointJump]  # velocity jumps of all arms in one impact, by arm
Rows = NDArray[np.signedinteger]

ONSETS: dict[SignalName, str] = {"wrench": "the force at the wrist", "acceleration": "the acceleration"}
REQUIRED: tuple[SignalName, ...] = ("position", "velocity")
MAX_SPREAD_OF_IMPACTS_S = 0.1  # between the hits of the first and the last arm
OBJECT_BEFORE_S = 0.2  # before the impact, in which the object rests or moves
OBJECT_AFTER_S = (0.06, 0.15)  # after the impact: window of a first fit, and longest window
FITTED_SLIDING_SHARE = 0.8  # fitted part of the time until rest
MIN_FALL_SHARE = 0.5  # of g; an object that falls faster flies
MIN_OBJECT_SAMPLES = 5  # on either side of the impact
MIN_OBJECT_JUMP_SIGMA = 3.0  # standard deviations; an object with a larger velocity jump was hit


@dataclass(frozen=True)
class _TrackedObject:
    """Motion of the object of a run, in the scene's frame.

    Attributes:
        laboratory: Scenario and arms.
        run: The run.
        time: Timestamps of the object, ``(p,)`` [s].
        positions: Positions of the geometric centre, ``(p, 3)`` [m].
        rotations: Orientations, ``(p, 3, 3)``.
        start: Start of the run [s].
    """

    laboratory: Laboratory
    run: RunRow
    time: Array
    positions: Array
    rotations: Array
    start: float

    @property
    def rate(self) -> float:
        """Sampling rate of the object [Hz]."""
        return 1.0 / float(np.median(np.diff(self.time))) if self.time.size > 1 else 0.0


def impacts_of_run(laboratory: Laboratory, run: RunRow) -> tuple[list[Impact | NoRow], tuple[str, ...]]:
    """Impacts of a run in temporal order, or the reason why there is no row; and warnings about reading the run.

    Raises:
        InputError: A file is there and cannot be read.
    """
    assert run.object is not None
    remarks: list[str] = []
    wanted: tuple[SignalName, ...] = (*REQUIRED, *ONSETS, *OBJECT_SIGNALS)
    try:
        arms = on_clock_of_joints(laboratory, run, wanted, REQUIRED, remarks)
    except InputError as error:
        return [NoRow(run.label, error.message)], ()
    pose = arms[laboratory.tracker].get("object_pose")
    if pose is None:
        return [NoRow(run.label, "the object was not tracked")], tuple(remarks)
    candidates = _coinciding_jumps(laboratory, arms)
    if isinstance(candidates, str):
        return [NoRow(run.label, candidates)], tuple(remarks)
    candidates = refined_by_onset(arms, candidates, remarks)
    poses = in_inertial_frame(laboratory.motion_capture, run, pose.values)
    rotations = np.array([pin.XYZQUATToSE3(row).rotation for row in poses])
    start = float(arms[laboratory.tracker]["position"].time[0])
    tracked = _TrackedObject(laboratory, run, pose.time, poses[:, :3], rotations, start)
    hits, results = _hits(tracked, candidates)
    tracker_jumps = [jumps[laboratory.tracker] for jumps in candidates]
    clock_offset = clocks_apart(pose, arms[laboratory.tracker]["position"], tracker_jumps, run.path)
    if clock_offset is not None and (abs(clock_offset.offset) < OBJECT_BEFORE_S or isinstance(results[0], NoRow)):
        return [NoRow(run.label, clock_offset.in_words(laboratory.mappings[laboratory.tracker]))], tuple(remarks)
    if 0 < len(hits) < len(candidates):
        remarks.append(
            "joint velocities jump at other times as well: no rows, for the object changes its velocity much less "
            "there, is tracked too shortly, or is not at the pad"
        )
    return [_with_number(result, number) for number, result in enumerate(results, start=1)], tuple(remarks)


def _hits(tracked: _TrackedObject, candidates: list[Jumps]) -> tuple[list[Jumps], list[Impact | NoRow]]:
    """Jumps that are impacts on the object, with their rows in temporal order; or no jump, with the reason."""
    hits: list[Jumps] = []
    reasons: list[NoRow] = []
    largest = 0.0
    for jumps in sorted(candidates, key=_size, reverse=True):
        result = _impact_or_reason(tracked, jumps, _neighbour_times(jumps, hits))
        if isinstance(result, NoRow):
            reasons.append(result)
            continue
        change = (result.after - result.before)[:3]
        if not hits or (np.linalg.norm(change) >= MIN_JUMP_SHARE * largest and _pushed(tracked, jumps, change)):
            hits = sorted([*hits, jumps], key=_time)
            largest = max(largest, float(np.linalg.norm(change)))
    if not hits:
        return [], [reasons[0]]
    return hits, [_impact_or_reason(tracked, jumps, _neighbour_times(jumps, hits)) for jumps in hits]


def _pushed(tracked: _TrackedObject, jumps: Jumps, change: Array) -> bool:
    """Whether the push of a pad explains the object's change of velocity; pads cannot pull."""
    models = tracked.laboratory.models
    return any(float(models[arm].placement(jump.position).rotation[:, 2] @ change) > 0.0 for arm, jump in jumps.items())


def _neighbour_times(jumps: Jumps, hits: list[Jumps]) -> tuple[float, float]:
    """Times of the previous and the next impact [s]; infinite if missing."""
    times = [_time(hit) for hit in hits if hit is not jumps]
    time = _time(jumps)
    return max((t for t in times if t < time), default=-np.inf), min((t for t in times if t > time), default=np.inf)


def _with_number(result: Impact | NoRow, number: int) -> Impact | NoRow:
    if number == 1:
        return result
    if isinstance(result, Impact):
        return replace(result, run=f"{result.run}, impact {number}")
    return NoRow(f"{result.name}, impact {number}", result.reason)


def _coinciding_jumps(laboratory: Laboratory, arms: Mapping[str, ArmSeries]) -> list[Jumps] | str:
    """Velocity jumps of all arms by impact in temporal order, or the reason why there is no jump."""
    jumps_by_arm = {arm: list(jumps_of(series["position"], MIN_JUMP_SHARE)) for arm, series in arms.items()}
    for arm, jumps in jumps_by_arm.items():
        if not jumps:
            return (
                f"{laboratory.label(arm)}the joint velocities never jump beyond their noise, or too few samples of "
                "the joints are about the impact"
            )
    first, *other_arms = jumps_by_arm
    coinciding = []
    for jump in jumps_by_arm[first]:
        nearest = {
            arm: min(jumps_by_arm[arm], key=lambda candidate: abs(candidate.time - jump.time)) for arm in other_arms
        }  # noqa: B023
        if all(abs(other.time - jump.time) <= MAX_SPREAD_OF_IMPACTS_S for other in nearest.values()):
            coinciding.append({first: jump, **nearest})
    if not coinciding:
        times = ", ".join(f"arm {arm!r} at {jumps[0].time - _start(arms):.3f} s" for arm, jumps in jumps_by_arm.items())
        return f"the arms do not hit together: the joint velocities jump most of {times}"
    return sorted(coinciding, key=_time)


def refined_by_onset(arms: Mapping[str, ArmSeries], candidates: list[Jumps], remarks: list[str]) -> list[Jumps]:
    """Refine the times of jumps by the onset of the fastest force or acceleration, if faster than the joints.

    Args:
        arms: Signals of every arm.
        candidates: Jumps by the joint positions alone.
        remarks: List to which warnings are appended.
    """
    refined: list[Jumps] = []
    used: list[str] = []
    for jumps in candidates:
        refined_jumps = dict(jumps)
        for arm, jump in jumps.items():
            position = arms[arm]["position"]
            sensors = {label: arms[arm][name] for name, label in ONSETS.items() if name in arms[arm]}
            onsets = [
                (onset_and_error, label)
                for label, sensor in sensors.items()
                if (onset_and_error := onset_of(sensor, position, jump.time))
            ]
            if not onsets:
                continue
            (onset, error), label = min(onsets, key=lambda pair: pair[0][1])
            refit = jump_at(position, onset, error)
            if refit is not None:
                refined_jumps[arm] = refit
                used.append(label)
        refined.append(refined_jumps)
    remarks += [
        f"impacts are timed by the onset of {label}, which is faster than the joint positions"
        for label in dict.fromkeys(used)
    ]
    return refined


def _start(arms: Mapping[str, ArmSeries]) -> float:
    """Start of the earliest arm [s]."""
    return min(float(series["position"].time[0]) for series in arms.values())


def _time(jumps: Jumps) -> float:
    """Mean time of the jumps of all arms [s]."""
    return float(np.mean([jump.time for jump in jumps.values()]))


def _size(jumps: Jumps) -> float:
    """Norm of the velocity changes of all joints of all arms."""
    return float(np.sqrt(sum(np.sum(np.square(jump.after - jump.before)) for jump in jumps.values())))


def _impact_or_reason(tracked: _TrackedObject, jumps: Jumps, neighbours: tuple[float, float]) -> Impact | NoRow:
    """One impact, with the object's motion between the previous and the next impact."""
    run, laboratory, pose_time = tracked.run, tracked.laboratory, tracked.time
    assert run.object is not None
    time = _time(jumps)
    rows_before = np.flatnonzero((pose_time >= max(time - OBJECT_BEFORE_S, neighbours[0])) & (pose_time < time))
    rows_after = np.flatnonzero((pose_time > time) & (pose_time <= min(time + OBJECT_AFTER_S[1], neighbours[1])))
    if rows_before.size < MIN_OBJECT_SAMPLES:
        return NoRow(run.label, f"{rows_before.size} samples of the object before the impact, of {MIN_OBJECT_SAMPLES}")
    ante = _motion_before(pose_time, tracked.positions, tracked.rotations, rows_before, time)
    scenario = laboratory.scenario
    outcomes = _sliding_distance(tracked, time, ante) if neighbours[1] == np.inf else {}
    rotation_tracked = True
    if tracked.rate < MIN_POSE_RATE_HZ or rows_after.size < MIN_OBJECT_SAMPLES:
        distance = outcomes.get(col.SLIDE_DISTANCE)
        if distance is None:
            return NoRow(
                run.label,
                f"{rows_after.size} samples of the object at {tracked.rate:.0f} Hz after the impact, and it does not "
                "come to rest: no velocity after",
            )
        post_twist, noise, law = _by_distance(tracked, time, distance)
        rotation_tracked = False
    else:
        post, law = _motion_after(pose_time, tracked.positions, tracked.rotations, rows_after, time)
        post_twist, noise = post.at(time)[2], post.noise
        sliding = -float(post.acceleration @ post_twist[:3]) / max(float(np.linalg.norm(post_twist[:3])), 1e-9)
        if law == "sliding" and sliding > 0.0:
            outcomes = {col.SUPPORT_FRICTION: sliding / GRAVITY_M_S2, **outcomes}
    noise = (float(np.hypot(noise[0], ante.noise[0])), float(np.hypot(noise[1], ante.noise[1])))
    ante_twist = ante.at(time)[2]
    if float(np.linalg.norm(post_twist[:3] - ante_twist[:3])) < MIN_OBJECT_JUMP_SIGMA * noise[0]:
        return NoRow(run.label, "the velocity of the object does not change beyond its noise")
    position, rotation, _ = ante.at(time)
    size = np.array(scenario.object(run.object).size)
    pose = np.concatenate((position, pin.Quaternion(rotation).coeffs()))[None]
    for arm, jump in jumps.items():
        try:
            check_touch(run.path, scenario, laboratory.models[arm], run.object, jump.position[None], pose)
        except InputError as error:
            return NoRow(run.label, f"{laboratory.label(arm)}{error.message}")
    tolerance = 2.0 * (ante.scatter[0] + 0.5 * ante.scatter[1] * float(np.max(size)))
    facts = {arm: scenario.robots[arm].robot_facts for arm in jumps}
    return Impact(
        run.label, run.condition, run.object, time - tracked.start, position, rotation, ante_twist, post_twist, noise,
        tolerance, law, jumps, facts, outcomes, rotation_tracked, session=run.session,
        contact_noise=contact_noise(ante, rows_before.size, float(np.max(size)), turns=True),
    )  # fmt: skip


def _motion_before(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> FittedMotion:
    """Motion before the impact: rest, unless the object moves beyond the noise."""
    if rows.size >= MIN_OBJECT_SAMPLES + 1:
        moving = move(time[rows], positions[rows], rotations[rows], at)
        speed = float(np.linalg.norm(moving.at(at)[2][:3]))
        if speed > 3.0 * MAX_REST_SIGMA * moving.noise[0]:
            return moving
    return rest(positions[rows], rotations[rows], at)


def _motion_after(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> tuple[FittedMotion, str]:
    """Motion after the impact and its law: sliding, or free flight if the object falls with g."""
    first = rows[time[rows] <= at + OBJECT_AFTER_S[0]]
    first = first if first.size >= MIN_OBJECT_SAMPLES else rows[:MIN_OBJECT_SAMPLES]
    first_fit = move(time[first], positions[first], rotations[first], at)
    if first_fit.acceleration[2] < -MIN_FALL_SHARE * GRAVITY_M_S2:
        gravity = np.array(STANDARD_GRAVITY)
        return fly(time[rows], positions[rows], rotations[rows], gravity, np.ones(3), at), "free flight"
    speed, deceleration = float(np.linalg.norm(first_fit.at(at)[2][:3])), float(np.linalg.norm(first_fit.acceleration))
    duration = FITTED_SLIDING_SHARE * speed / deceleration if deceleration > 0.0 else OBJECT_AFTER_S[1]
    fitted = rows[time[rows] <= at + max(min(duration, OBJECT_AFTER_S[1]), float(time[first[-1]] - at))]
    return move(time[fitted], positions[fitted], rotations[fitted], at), "sliding"


def _sliding_distance(tracked: _TrackedObject, time: float, ante: FittedMotion) -> dict[ColumnGroup, float]:
    """Sliding distance from the impact to rest, if the object comes to rest while tracked."""
    positions_after = tracked.positions[tracked.time > time]
    if len(positions_after) < 2 * MIN_OBJECT_SAMPLES:
        return {}
    end = positions_after[-MIN_OBJECT_SAMPLES:]
    noise = max(ante.scatter[0], 1e-4)
    if float(np.max(np.ptp(end, axis=0))) > 4.0 * noise:
        return {}
    distance = float(np.linalg.norm((np.mean(end, axis=0) - ante.at(time)[0])[:2]))
    return {col.SLIDE_DISTANCE: distance} if distance > 4.0 * noise else {}


def _by_distance(tracked: _TrackedObject, time: float, distance: float) -> tuple[Array, tuple[float, float], str]:
    """Twist after the impact, its noise and law: v = sqrt(2 mu g D); the angular velocity remains unknown."""
    start, end = tracked.positions[tracked.time <= time][-1], tracked.positions[-1]
    direction = (end - start) * [1.0, 1.0, 0.0]
    speed = float(np.sqrt(2.0 * tracked.laboratory.scenario.support.friction * GRAVITY_M_S2 * distance))
    twist = np.concatenate((speed * direction / np.linalg.norm(direction), np.full(3, np.nan)))
    return twist, (0.5 * tracked.laboratory.friction_noise * speed, np.nan), BY_SLIDING_DISTANCE
