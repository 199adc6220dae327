# SPDX-License-Identifier: Apache-2.0
"""Impacts of arms on an object, in runs of another controller: states of joints and object on both sides.

Joint positions are continuous and their velocities jump. With T the time of the impact, every joint obeys

    q(t) = q_0 + dq_minus (t - T) + c_minus (t - T)^2 / 2                                         t <= T
    q(t) = q_0 + dq_plus  (t - T) + c_plus  (t - T)^2 / 2                                         t >  T

in a window about it, linear but for T, which is where the residuals are least. Positions alone are used: a recorded
velocity is often low-passed, and an encoder is not. The object rests or moves before; after, it slides (velocity and
deceleration are fitted) or flies (if it falls with g). Where it is seen too seldom for that, and comes to rest, the way
D that it slid gives v with v^2 = 2 mu g D and the friction of the scenario's support.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.experiment import RunRow
from impact_rs_trials.recordings.impact_rows import ArmInImpact, Impact, NoRow
from impact_rs_trials.recordings.laboratory import (
    OBJECT_SIGNALS,
    SLOW_POSE,
    ArmSeries,
    Laboratory,
    impact_time,
    in_inertial_frame,
    on_clock_of_joints,
)
from impact_rs_trials.recordings.mapping import SignalName
from impact_rs_trials.recordings.motion_fits import AT_REST, FittedMotion, fly, move, rest
from impact_rs_trials.recordings.plausibility import check_touch
from impact_rs_trials.recordings.series import Series

Rows = NDArray[np.signedinteger]

NEEDED: tuple[SignalName, ...] = ("position", "velocity")
WINDOW = 0.04  # s on either side, in which joint motion is a parabola,
FEWEST = 6  # and at least so many samples
SEARCHED = 0.02  # s about the largest change of velocity, in which the impact lies
STEPS = 41  # times that are tried there
BEFORE = 0.2  # s before the impact, in which the object rests or moves
AFTER = (0.06, 0.15)  # s after it: of a first fit, and at most
SLIDING = 0.8  # of the time until rest, that is fitted
FALLS = 0.5  # of g, from which an object flies
LEAST_OBJECT = 5  # samples of the object on a side
JUMPS = 3.0  # standard deviations, from which the joints of an arm or the object are hit
FRICTION_KNOWN = 0.1  # relative standard deviation of a scenario's friction


@dataclass(frozen=True)
class JointJump:
    """Joint motion about an impact.

    Attributes:
        time: T [s].
        position: q_0, ``(n,)`` [rad].
        before: dq_minus, ``(n,)`` [rad/s].
        after: dq_plus, ``(n,)`` [rad/s].
        noise: Standard deviation of the jump of every joint, ``(n,)`` [rad/s].
    """

    time: float
    position: Array
    before: Array
    after: Array
    noise: Array


def joint_jump(position: Series, near: float) -> JointJump | None:
    """Joint motion about an impact near a time [s]; None: there are too few samples."""
    period = float(np.median(np.diff(position.time)))
    half = max(WINDOW, FEWEST * period)
    rows = np.abs(position.time - near) <= half + max(SEARCHED, 2.0 * period)
    time, values = position.time[rows], position.values[rows]
    if time.size < 2 * FEWEST or near - time[0] < half / 2.0 or time[-1] - near < half / 2.0:
        return None
    reach = max(SEARCHED, 2.0 * period)
    size = np.maximum(np.std(np.diff(values, n=2, axis=0), axis=0), 1e-12)
    tried = near + np.linspace(-reach, reach, STEPS)
    left = [float(np.sum(np.square(_broken(time, values, one)[1] / size))) for one in tried]
    best = tried[int(np.argmin(left))]
    inside = np.abs(time - best) <= half
    fit, residual, covariance = _broken(time[inside], values[inside], best)
    scatter = np.sqrt(np.sum(residual**2, axis=0) / max(int(inside.sum()) - fit.shape[0], 1))
    jump = np.array([0.0, -1.0, 1.0, 0.0, 0.0])
    noise = scatter * float(np.sqrt(jump @ covariance @ jump))
    return JointJump(float(best), fit[0], fit[1], fit[2], noise)


def _broken(time: Array, values: Array, impact: float) -> tuple[Array, Array, Array]:
    """Coefficients of two parabolas that meet at the impact, residuals, and covariance over the squared scatter."""
    t = time - impact
    before, after = np.minimum(t, 0.0), np.maximum(t, 0.0)
    basis = np.column_stack((np.ones_like(t), before, after, 0.5 * before**2, 0.5 * after**2))
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return fit, values - basis @ fit, np.linalg.pinv(basis.T @ basis)


def impact_of_run(laboratory: Laboratory, run: RunRow) -> tuple[Impact | NoRow, tuple[str, ...]]:
    """The impact of a run, or why it gives none; and what the user should know of how it was read.

    Raises:
        InputError: A file is there and cannot be read.
    """
    assert run.object is not None
    remarks: list[str] = []
    wanted: tuple[SignalName, ...] = (*NEEDED, *OBJECT_SIGNALS)
    try:
        arms = on_clock_of_joints(laboratory, run, wanted, NEEDED, remarks)
    except InputError as error:
        return NoRow(run.label, error.message), ()
    tracker = arms[laboratory.tracker]
    pose = tracker.get("object_pose")
    if pose is None:
        return NoRow(run.label, "the object was not tracked"), tuple(remarks)
    jumps: dict[str, JointJump] = {}
    for arm, own in arms.items():
        found = joint_jump(own["position"], impact_time(own["velocity"]))
        if found is None:
            return NoRow(run.label, f"{laboratory.label(arm)}too few samples of the joints about the impact"), tuple(
                remarks
            )
        jumps[arm] = found
    result = _with_object(laboratory, run, arms, pose, jumps)
    return result, tuple(remarks)


def _with_object(
    laboratory: Laboratory, run: RunRow, arms: dict[str, ArmSeries], pose: Series, jumps: dict[str, JointJump]
) -> Impact | NoRow:
    assert run.object is not None
    time = float(np.mean([jump.time for jump in jumps.values()]))
    values = in_inertial_frame(laboratory.motion_capture, run, pose.values)
    positions = values[:, :3]
    rotations = np.array([pin.XYZQUATToSE3(row).rotation for row in values])
    early = np.flatnonzero((pose.time >= time - BEFORE) & (pose.time < time))
    late = np.flatnonzero((pose.time > time) & (pose.time <= time + AFTER[1]))
    if early.size < LEAST_OBJECT:
        return NoRow(run.label, f"{early.size} samples of the object before the impact, of {LEAST_OBJECT}")
    ante = _before(pose.time, positions, rotations, early, time)
    scenario = laboratory.scenario
    outcomes = _slid(pose, positions, time, ante)
    friction = scenario.support.friction
    rate = 1.0 / float(np.median(np.diff(pose.time)))
    if rate < SLOW_POSE or late.size < LEAST_OBJECT:
        way = outcomes.get("slide_distance [m]")
        if way is None:
            return NoRow(run.label, f"the object is seen at {rate:.0f} Hz and does not come to rest: no velocity after")
        post_twist, noise, law = _by_distance(positions, time, pose, way, friction)
    else:
        post, law = _after(pose.time, positions, rotations, late, time)
        post_twist, noise = post.at(time)[2], post.noise
        sliding = -float(post.acceleration @ post_twist[:3]) / max(float(np.linalg.norm(post_twist[:3])), 1e-9)
        if law == "sliding" and sliding > 0.0:
            outcomes = {"support_friction [-]": sliding / 9.81, **outcomes}
    noise = (float(np.hypot(noise[0], ante.noise[0])), float(np.hypot(noise[1], ante.noise[1])))
    before = ante.at(time)[2]
    if float(np.linalg.norm(post_twist[:3] - before[:3])) < JUMPS * noise[0]:
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
    states = {
        arm: ArmInImpact(
            jump.position,
            jump.before,
            jump.after,
            float(np.sqrt(np.mean(jump.noise**2))),
            tuple((unit.position, unit.velocity) for unit in scenario.robots[arm].robot_facts.units),
        )
        for arm, jump in jumps.items()
    }
    since = time - float(arms[laboratory.tracker]["position"].time[0])
    return Impact(
        run.label, run.condition, run.object, since, position, rotation, before, post_twist, noise, tolerance, law,
        states, outcomes, session=run.session,
    )  # fmt: skip


def _before(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> FittedMotion:
    """Rest, unless the object moves beyond the noise."""
    if rows.size >= LEAST_OBJECT + 1:
        moving = move(time[rows], positions[rows], rotations[rows], at)
        speed = float(np.linalg.norm(moving.at(at)[2][:3]))
        if speed > 3.0 * AT_REST * moving.noise[0]:
            return moving
    return rest(positions[rows], rotations[rows], at)


def _after(time: Array, positions: Array, rotations: Array, rows: Rows, at: float) -> tuple[FittedMotion, str]:
    """Sliding, or flight where the object falls with g."""
    first = rows[time[rows] <= at + AFTER[0]]
    first = first if first.size >= LEAST_OBJECT else rows[:LEAST_OBJECT]
    slide = move(time[first], positions[first], rotations[first], at)
    if slide.acceleration[2] < -FALLS * 9.81:
        gravity = np.array([0.0, 0.0, -9.81])
        return fly(time[rows], positions[rows], rotations[rows], gravity, np.ones(3), at), "free flight"
    speed, slows = float(np.linalg.norm(slide.at(at)[2][:3])), float(np.linalg.norm(slide.acceleration))
    lasts = SLIDING * speed / slows if slows > 0.0 else AFTER[1]
    kept = rows[time[rows] <= at + max(min(lasts, AFTER[1]), float(time[first[-1]] - at))]
    return move(time[kept], positions[kept], rotations[kept], at), "sliding"


def _slid(pose: Series, positions: Array, time: float, ante: FittedMotion) -> dict[str, float]:
    """Way from the impact to rest, if the object comes to rest while it is seen."""
    late = positions[pose.time > time]
    if len(late) < 2 * LEAST_OBJECT:
        return {}
    end = late[-LEAST_OBJECT:]
    noise = max(ante.scatter[0], 1e-4)
    if float(np.max(np.ptp(end, axis=0))) > 4.0 * noise:
        return {}
    way = float(np.linalg.norm((np.mean(end, axis=0) - ante.at(time)[0])[:2]))
    return {"slide_distance [m]": way} if way > 4.0 * noise else {}


def _by_distance(
    positions: Array, time: float, pose: Series, way: float, friction: float
) -> tuple[Array, tuple[float, float], str]:
    """Velocity after by the way that the object slid."""
    start, end = positions[pose.time <= time][-1], positions[-1]
    direction = (end - start) * [1.0, 1.0, 0.0]
    speed = float(np.sqrt(2.0 * friction * 9.81 * way))
    twist = np.concatenate((speed * direction / np.linalg.norm(direction), np.zeros(3)))
    # v = sqrt(2 mu g D): half of the relative error of mu. The turn is not known from the distance.
    return twist, (0.5 * FRICTION_KNOWN * speed, speed), "sliding distance"
