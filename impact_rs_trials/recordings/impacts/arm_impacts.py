# SPDX-License-Identifier: Apache-2.0
"""Impacts of arms on an object, in runs of another controller: states of joints and object before and after.

Joint velocities jump (:mod:`joint_jumps`). The object rests or moves before; after, it slides (velocity and
deceleration are fitted) or flies (if it falls with g). If it is tracked too slowly for a fit and comes to rest, the
sliding distance D gives v with v^2 = 2 mu g D and the friction of the scenario's support.

If a force-torque sensor at the wrist, or an accelerometer, is at least twice as fast as the joint positions, its
onset gives the time of the impact, and the motion is fitted about it (:mod:`contact_onset`).

A run may hold several impacts. Each changes the velocities of joints and object by a part of the largest change at
least, because a pushed object rattles at the pad; the motion of the object is fitted between one and the next.
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
from impact_rs_trials.recordings.laboratory import (
    MIN_POSE_RATE_HZ,
    ArmSeries,
    Laboratory,
    in_inertial_frame,
    on_clock_of_joints,
)
from impact_rs_trials.recordings.mapping import SignalName

Jumps = Mapping[str, JointJump]  # of every arm, in one impact
Rows = NDArray[np.signedinteger]

ONSETS: dict[SignalName, str] = {"wrench": "the force at the wrist", "acceleration": "the acceleration"}
NEEDED: tuple[SignalName, ...] = ("position", "velocity")
MAX_SPREAD_OF_IMPACTS_S = 0.1  # between the first and the last arm that hits
OBJECT_BEFORE_S = 0.2  # before the impact, in which the object rests or moves
OBJECT_AFTER_S = (0.06, 0.15)  # after the impact: window of a first fit, and longest window
FITTED_SLIDING_SHARE = 0.8  # of the time until rest
MIN_FALL_SHARE = 0.5  # of g; an object that falls faster flies
MIN_OBJECT_SAMPLES = 5  # before and after the impact, each
MIN_OBJECT_JUMP_SIGMA = 3.0  # standard deviations; an object with a larger velocity jump was hit


@dataclass(frozen=True)
class _Seen:
    """Motion of the object of a run, in the scene's frame.

    Attributes:
        laboratory: Scenario and arms.
        run: The run.
        time: Timestamps of the object, ``(p,)`` [s].
        positions: Of its geometric centre, ``(p, 3)`` [m].
        rotations: ``(p, 3, 3)``.
        start: Of the run [s].
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
    wanted: tuple[SignalName, ...] = (*NEEDED, *ONSETS, *OBJECT_SIGNALS)
    try:
        arms = on_clock_of_joints(laboratory, run, wanted, NEEDED, remarks)
    except InputError as error:
        return [NoRow(run.label, error.message)], ()
    pose = arms[laboratory.tracker].get("object_pose")
    if pose is None:
        return [NoRow(run.label, "the object was not tracked")], tuple(remarks)
    moments = _moments(laboratory, arms)
    if isinstance(moments, str):
        return [NoRow(run.label, moments)], tuple(remarks)
    moments = refined_by_onset(arms, moments, remarks)
    values = in_inertial_frame(laboratory.motion_capture, run, pose.values)
    rotations = np.array([pin.XYZQUATToSE3(row).rotation for row in values])
    start = float(arms[laboratory.tracker]["position"].time[0])
    seen = _Seen(laboratory, run, pose.time, values[:, :3], rotations, start)
    found, result = _hits(seen, moments)
    own = [jumps[laboratory.tracker] for jumps in moments]
    apart = clocks_apart(pose, arms[laboratory.tracker]["position"], own, run.path)
    if apart is not None and (abs(apart.offset) < OBJECT_BEFORE_S or isinstance(result[0], NoRow)):
        return [NoRow(run.label, apart.in_words(laboratory.mappings[laboratory.tracker]))], tuple(remarks)
    if 0 < len(found) < len(moments):
        remarks.append(
            "joint velocities jump at other times as well: no rows, for the object changes its velocity much less "
            "there, is seen too shortly, or is not at the pad"
        )
    return [_numbered(one, number) for number, one in enumerate(result, start=1)], tuple(remarks)


def _hits(seen: _Seen, moments: list[Jumps]) -> tuple[list[Jumps], list[Impact | NoRow]]:
    """Jumps that are impacts on the object, with their rows in temporal order; or no jump, with the reason."""
    found: list[Jumps] = []
    reasons: list[NoRow] = []
    largest = 0.0
    for jumps in sorted(moments, key=_size, reverse=True):
        result = _with_object(seen, jumps, _between(jumps, found))
        if isinstance(result, NoRow):
            reasons.append(result)
            continue
        change = (result.after - result.before)[:3]
        if not found or (np.linalg.norm(change) >= MIN_JUMP_SHARE * largest and _pushed(seen, jumps, change)):
            found = sorted([*found, jumps], key=_time)
            largest = max(largest, float(np.linalg.norm(change)))
    if not found:
        return [], [reasons[0]]
    return found, [_with_object(seen, jumps, _between(jumps, found)) for jumps in found]


def _pushed(seen: _Seen, jumps: Jumps, change: Array) -> bool:
    """Whether the push of a pad explains the object's change of velocity; pads cannot pull."""
    models = seen.laboratory.models
    return any(float(models[arm].placement(jump.position).rotation[:, 2] @ change) > 0.0 for arm, jump in jumps.items())


def _between(jumps: Jumps, others: list[Jumps]) -> tuple[float, float]:
    """Times of the previous and the next impact [s]; infinite if missing."""
    times = [_time(one) for one in others if one is not jumps]
    at = _time(jumps)
    return max((one for one in times if one < at), default=-np.inf), min(
        (one for one in times if one > at), default=np.inf
    )


def _numbered(one: Impact | NoRow, number: int) -> Impact | NoRow:
    if number == 1:
        return one
    if isinstance(one, Impact):
        return replace(one, run=f"{one.run}, impact {number}")
    return NoRow(f"{one.name}, impact {number}", one.reason)


def _moments(laboratory: Laboratory, arms: Mapping[str, ArmSeries]) -> list[Jumps] | str:
    """Velocity jumps of all arms by impact in temporal order, or the reason why there is no jump."""
    own = {arm: list(jumps_of(series["position"], MIN_JUMP_SHARE)) for arm, series in arms.items()}
    for arm, jumps in own.items():
        if not jumps:
            return (
                f"{laboratory.label(arm)}the joint velocities never jump beyond their noise, or too few samples of "
                "the joints are about the impact"
            )
    first, *others = own
    moments = []
    for jump in own[first]:
        near = {arm: min(own[arm], key=lambda one: abs(one.time - jump.time)) for arm in others}  # noqa: B023
        if all(abs(one.time - jump.time) <= MAX_SPREAD_OF_IMPACTS_S for one in near.values()):
            moments.append({first: jump, **near})
    if not moments:
        each = ", ".join(f"arm {arm!r} at {jumps[0].time - _start(arms):.3f} s" for arm, jumps in own.items())
        return f"the arms do not hit together: the joint velocities jump most of {each}"
    return sorted(moments, key=_time)


def refined_by_onset(arms: Mapping[str, ArmSeries], moments: list[Jumps], remarks: list[str]) -> list[Jumps]:
    """Refine the times of jumps by the onset of the fastest force or acceleration, if faster than the joints.

    Args:
        arms: Signals of every arm.
        moments: Jumps by the joint positions alone.
        remarks: Warnings, appended to.
    """
    found: list[Jumps] = []
    used: list[str] = []
    for jumps in moments:
        own = dict(jumps)
        for arm, jump in jumps.items():
            position = arms[arm]["position"]
            seen = {what: arms[arm][name] for name, what in ONSETS.items() if name in arms[arm]}
            onsets = [(one, what) for what, sensor in seen.items() if (one := onset_of(sensor, position, jump.time))]
            if not onsets:
                continue
            (onset, error), what = min(onsets, key=lambda one: one[0][1])
            again = jump_at(position, onset, error)
            if again is not None:
                own[arm] = again
                used.append(what)
        found.append(own)
    remarks += [
        f"impacts are timed by the onset of {what}, which is faster than the joint positions"
        for what in dict.fromkeys(used)
    ]
    return found


def _start(arms: Mapping[str, ArmSeries]) -> float:
    return min(float(series["position"].time[0]) for series in arms.values())


def _time(jumps: Jumps) -> float:
    return float(np.mean([jump.time for jump in jumps.values()]))


def _size(jumps: Jumps) -> float:
    return float(np.sqrt(sum(np.sum(np.square(jump.after - jump.before)) for jump in jumps.values())))


def _with_object(seen: _Seen, jumps: Jumps, between: tuple[float, float]) -> Impact | NoRow:
    """One impact, with the object's motion between the previous and the next impact."""
    run, laboratory, pose_time = seen.run, seen.laboratory, seen.time
    assert run.object is not None
    time = _time(jumps)
    early = np.flatnonzero((pose_time >= max(time - OBJECT_BEFORE_S, between[0])) & (pose_time < time))
    late = np.flatnonzero((pose_time > time) & (pose_time <= min(time + OBJECT_AFTER_S[1], between[1])))
    if early.size < MIN_OBJECT_SAMPLES:
        return NoRow(run.label, f"{early.size} samples of the object before the impact, of {MIN_OBJECT_SAMPLES}")
    ante = _before(pose_time, seen.positions, seen.rotations, early, time)
    scenario = laboratory.scenario
    outcomes = _slid(seen, time, ante) if between[1] == np.inf else {}
    turn_tracked = True
    if seen.rate < MIN_POSE_RATE_HZ or late.size < MIN_OBJECT_SAMPLES:
        way = outcomes.get(col.SLIDE_DISTANCE)
        if way is None:
            return NoRow(
                run.label,
                f"{late.size} samples of the object at {seen.rate:.0f} Hz after the impact, and it does not come to "
                "rest: no velocity after",
            )
        post_twist, noise, law = _by_distance(seen, time, way)
        turn_tracked = False
    else:
        post, law = _after(pose_time, seen.positions, seen.rotations, late, time)
        post_twist, noise = post.at(time)[2], post.noise
        sliding = -float(post.acceleration @ post_twist[:3]) / max(float(np.linalg.norm(post_twist[:3])), 1e-9)
        if law == "sliding" and sliding > 0.0:
            outcomes = {col.SUPPORT_FRICTION: sliding / GRAVITY_M_S2, **outcomes}
    noise = (float(np.hypot(noise[0], ante.noise[0])), float(np.hypot(noise[1], ante.noise[1])))
    before = ante.at(time)[2]
    if float(np.linalg.norm(post_twist[:3] - before[:3])) < MIN_OBJECT_JUMP_SIGMA * noise[0]:
        return NoRow(run.label, "the velocity of the object does not change beyond its noise")
    position, rotation, _ = ante.at(time)
    size = np.array(scenario.object(run.object).size)
    placed = np.concatenate((position, pin.Quaternion(rotation).coeffs()))[None]
    for arm, jump in jumps.items():
        try:
            check_touch(run.path, laboratory.models[arm], run.object, size, jump.position[None], placed)
        except InputError as error:
            return NoRow(run.label, f"{laboratory.label(arm)}{error.message}")
    tolerance = 2.0 * (ante.scatter[0] + 0.5 * ante.scatter[1] * float(np.max(size)))
    facts = {arm: scenario.robots[arm].robot_facts for arm in jumps}
    return Impact(
        run.label, run.condition, run.object, time - seen.start, position, rotation, before, post_twist, noise,
        tolerance, law, jumps, facts, outcomes, turn_tracked, session=run.session,
        contact_noise=contact_noise(ante, early.size, float(np.max(size)), turns=True),
    )  # fmt: skip


def _before(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> FittedMotion:
    """Rest, unless the object moves beyond the noise."""
    if rows.size >= MIN_OBJECT_SAMPLES + 1:
        moving = move(time[rows], positions[rows], rotations[rows], at)
        speed = float(np.linalg.norm(moving.at(at)[2][:3]))
        if speed > 3.0 * MAX_REST_SIGMA * moving.noise[0]:
            return moving
    return rest(positions[rows], rotations[rows], at)


def _after(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> tuple[FittedMotion, str]:
    """Sliding, or free flight if the object falls with g."""
    first = rows[time[rows] <= at + OBJECT_AFTER_S[0]]
    first = first if first.size >= MIN_OBJECT_SAMPLES else rows[:MIN_OBJECT_SAMPLES]
    slide = move(time[first], positions[first], rotations[first], at)
    if slide.acceleration[2] < -MIN_FALL_SHARE * GRAVITY_M_S2:
        gravity = np.array(STANDARD_GRAVITY)
        return fly(time[rows], positions[rows], rotations[rows], gravity, np.ones(3), at), "free flight"
    speed, slows = float(np.linalg.norm(slide.at(at)[2][:3])), float(np.linalg.norm(slide.acceleration))
    lasts = FITTED_SLIDING_SHARE * speed / slows if slows > 0.0 else OBJECT_AFTER_S[1]
    kept = rows[time[rows] <= at + max(min(lasts, OBJECT_AFTER_S[1]), float(time[first[-1]] - at))]
    return move(time[kept], positions[kept], rotations[kept], at), "sliding"


def _slid(seen: _Seen, time: float, ante: FittedMotion) -> dict[ColumnGroup, float]:
    """Sliding distance from the impact to rest, if the object comes to rest while tracked."""
    late = seen.positions[seen.time > time]
    if len(late) < 2 * MIN_OBJECT_SAMPLES:
        return {}
    end = late[-MIN_OBJECT_SAMPLES:]
    noise = max(ante.scatter[0], 1e-4)
    if float(np.max(np.ptp(end, axis=0))) > 4.0 * noise:
        return {}
    way = float(np.linalg.norm((np.mean(end, axis=0) - ante.at(time)[0])[:2]))
    return {col.SLIDE_DISTANCE: way} if way > 4.0 * noise else {}


def _by_distance(seen: _Seen, time: float, way: float) -> tuple[Array, tuple[float, float], str]:
    """Velocity after by the sliding distance, v = sqrt(2 mu g D); the rotation remains unknown."""
    start, end = seen.positions[seen.time <= time][-1], seen.positions[-1]
    direction = (end - start) * [1.0, 1.0, 0.0]
    speed = float(np.sqrt(2.0 * seen.laboratory.scenario.support.friction * GRAVITY_M_S2 * way))
    twist = np.concatenate((speed * direction / np.linalg.norm(direction), np.full(3, np.nan)))
    return twist, (0.5 * seen.laboratory.friction_noise * speed, np.nan), BY_SLIDING_DISTANCE
