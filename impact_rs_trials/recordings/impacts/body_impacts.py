# SPDX-License-Identifier: Apache-2.0
"""Impacts of a tracked body on a fixed plane: change points of its free flight, and the states before and after.

In free flight the second difference of the height over k samples, (z(i+k) - 2 z(i) + z(i-k)) / (k h)^2, is g; where it
differs, the body is in contact. k is the smallest number for which rest and flight differ by more than the noise of the
tracker, which follows from third differences of the recording itself. An impact disturbs at most 2 k differences in a
row; at its time the parabolas before and after have the same height. These are omitted with a reason, because they give
no state before and after:

* too few samples of flight on a side, or several impacts in a row;
* a body that rests, is carried or let go: its acceleration jumps, not its velocity;
* a body that gains energy, which a fixed plane cannot give: it was thrown, or hit by something that moves;
* a body whose approach is slower than the noise of its velocity;
* a ball of unknown spin: its rotation was not tracked, and an earlier impact has no row;
* a body that lands on an edge or a face: the next corner hits so soon that two impacts look like one;
* a run that was recorded twice (equal poses).

A ball whose rotation was not tracked has an assumed spin before its first impact. The impulse m (v+ - v-) acts at the
lowest point, r = (0, 0, -R) from the centre, so that the next one has w = w- + r x m (v+ - v-) / I.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.experiment import Body
from impact_rs_trials.recordings.impacts.impact_rows import Impact, NoRow
from impact_rs_trials.recordings.impacts.motion_fits import FittedMotion, contact_noise, fly
from impact_rs_trials.recordings.relations import DECISIVE_LOG_ODDS

Rows = NDArray[np.signedinteger]

UNSEEN = "the tracker does not see the impact"
MIN_FLIGHT_SAMPLES = 5  # on either side of an impact
MAX_FLIGHT_S = 0.12  # of the used samples; longer flights feel drag
MAX_DISTURBED = 2  # consecutive disturbed differences, over k; a single impact, on or between samples, disturbs no more
MAX_CONTACT_S = 0.02  # of a ball on something soft, like paper or a lawn; a box in contact so long lands on two corners
MAX_DIFFERENCE_S = 0.04  # k h: enough for the noise of trackers, shorter than flights between bounces
MIN_DISTURBANCE_SIGMA = 4.0  # standard deviations of a second difference; beyond both limits it is disturbed
MIN_DISTURBANCE_G = 0.5  # of g
MAX_NOISE_G = 0.9  # of g; a larger limit makes rest look like flight
MIN_APPROACH_SIGMA = 5.0  # standard deviations of the normal velocity; a slower approach is no impact
MIN_NEXT_CORNER_SAMPLES = 2  # if a second corner hits earlier, two impacts look like one
MAX_ROTATION_RAD = 1.2  # of a body on either side of the middle of a window


@dataclass(frozen=True)
class TrackedBody:
    """One run of a body, in a frame whose z axis is the normal of the plane and whose plane is z = 0.

    Attributes:
        run: Name of the run.
        time: Stamps, ``(k,)`` [s].
        position: Positions of the geometric centre (middle of the bounding box), ``(k, 3)`` [m].
        rotation: Rotations from the axes of the body, ``(k, 3, 3)``.
        gravity: Gravity vector, ``(3,)`` [m/s^2].
        spin: Assumed angular velocity before the first impact, ``(3,)`` [rad/s]; None: the orientation was tracked.
    """

    run: str
    time: Array
    position: Array
    rotation: Array
    gravity: Array
    spin: Array | None = None


def impacts_of_bodies(runs: Sequence[TrackedBody], body: Body) -> tuple[list[Impact], list[NoRow]]:
    """Impacts of all runs, and omitted impacts with their reasons.

    Args:
        runs: Tracked runs.
        body: The body.
    """
    impacts: list[Impact] = []
    left_out: list[NoRow] = []
    run_of_poses: dict[bytes, str] = {}
    for run in runs:
        key = run.position.round(6).tobytes() + run.rotation.round(6).tobytes()
        if key in run_of_poses:
            left_out.append(NoRow(run.run, f"recorded twice: the same poses as {run_of_poses[key]}"))
            continue
        run_of_poses[key] = run.run
        impacts_of_run, omitted = _impacts_of(run, body)
        impacts += impacts_of_run
        left_out += omitted
    return impacts, left_out


def _impacts_of(run: TrackedBody, body: Body) -> tuple[list[Impact], list[NoRow]]:
    if len(run.time) < 2 * MIN_FLIGHT_SAMPLES + 2:
        return [], [NoRow(run.run, f"{len(run.time)} samples, at least {2 * MIN_FLIGHT_SAMPLES + 2} are needed")]
    item = body.item
    run = replace(run, position=run.position + run.rotation @ item.com_offset)  # the centre of mass flies freely
    disturbed_and_reach = disturbed_samples(run.time, run.position[:, 2], float(run.gravity[2]))
    if disturbed_and_reach is None:
        return [], [NoRow(run.run, _too_noisy(run.time, run.position[:, 2], float(run.gravity[2])))]
    disturbed, reach = disturbed_and_reach
    if not disturbed[reach:-reach].any():
        return [], [NoRow(run.run, "nothing is hit")]
    results: list[Impact | NoRow] = []
    flights = _stretches(~disturbed)
    for pair in zip(flights, flights[1:], strict=False):
        name = f"{run.run}, impact {len(results) + 1}" if results else run.run
        result = _impact_between(run, item, name, pair, reach)
        if run.spin is not None and isinstance(result, Impact):
            previous = results[-1] if results else None
            # Before the first impact a hand may have moved the ball. An impact without samples changes the spin, too.
            any_contact = any(isinstance(earlier, Impact) or UNSEEN in earlier.reason for earlier in results)
            if isinstance(previous, NoRow) and any_contact:
                result = NoRow(name, "the spin of the ball is unknown after an impact without a row")
            else:
                run = replace(run, spin=run.spin + _spin_change(result, item))
        results.append(result)
    if not results:
        results.append(NoRow(run.run, "too few samples of free flight on one side of what is hit"))
    impacts = [result for result in results if isinstance(result, Impact)]
    return impacts, [result for result in results if isinstance(result, NoRow)]


def _impact_between(
    run: TrackedBody, item: ObjectPhysics, name: str, flights: tuple[tuple[int, int], tuple[int, int]], reach: int
) -> Impact | NoRow:
    """The impact between two neighbouring flights, by their first and last undisturbed sample."""
    before, after = flights
    longest = MAX_DISTURBED * reach + (round(MAX_CONTACT_S / float(np.median(np.diff(run.time)))) if item.round else 0)
    if after[0] - before[1] - 1 > longest:
        return NoRow(name, "several impacts in a row, or a contact that lasts")
    # A difference about sample i reaches k samples further; the last of them may lie beyond the impact.
    ante, post = np.arange(before[0] - reach, before[1] + reach), np.arange(after[0] - reach + 1, after[1] + reach + 1)
    if min(ante.size, post.size) < MIN_FLIGHT_SAMPLES:
        message = f"too few samples of free flight: {ante.size} before, {post.size} after, of {MIN_FLIGHT_SAMPLES}"
        return NoRow(name, message)
    return _fitted_impact(run, item, name, ante, post, reach)


def _spin_change(impact: Impact, item: ObjectPhysics) -> Array:
    """Change of the angular velocity of a ball by an impact, ``(3,)`` [rad/s]."""
    lever = np.array([0.0, 0.0, -0.5 * item.size[2]])
    return np.asarray(np.cross(lever, item.mass * (impact.after[:3] - impact.before[:3])) / item.inertia)


def disturbed_samples(time: Array, height: Array, gravity: float) -> tuple[NDArray[np.bool_], int] | None:
    """Mask of the samples not in free flight, ``(k,)``, ends included, and the half width k; None: too noisy.

    Args:
        time: Stamps, ``(k,)`` [s].
        height: ``(k,)`` [m].
        gravity: Along the height, negative [m/s^2].
    """
    noise = _difference_noise(time, height)
    for reach in range(1, _longest_reach(time) + 1):
        limit = max(MIN_DISTURBANCE_SIGMA * noise / reach**2, MIN_DISTURBANCE_G * abs(gravity))
        if limit <= MAX_NOISE_G * abs(gravity):
            disturbed = np.ones(len(time), dtype=bool)
            disturbed[reach:-reach] = np.abs(_second_differences(time, height, reach) - gravity) > limit
            return disturbed, reach
    return None


def _too_noisy(time: Array, height: Array, gravity: float) -> str:
    """Message: noise of the heights, and the largest noise at which rest differs from free flight."""
    period, height_per_difference = float(np.median(np.diff(time))), _height_per_difference(time)
    largest_noise = MAX_NOISE_G * abs(gravity) * max(_longest_reach(time), 1) ** 2 / MIN_DISTURBANCE_SIGMA
    return (
        f"the heights have noise of {1e3 * height_per_difference * _difference_noise(time, height):.2g} mm (standard "
        f"deviation); above {1e3 * height_per_difference * largest_noise:.2g} mm at {1.0 / period:.3g} Hz rest looks "
        "like free flight: track it at a higher rate"
    )


def _difference_noise(time: Array, height: Array) -> float:
    """Standard deviation of the second differences over one sample [m/s^2]."""
    # Third differences of white noise are sqrt(20 / 6) times as large as second ones, and impacts are few.
    thirds = np.abs(np.diff(_second_differences(time, height, 1)))
    return 1.4826 * float(np.median(thirds)) / float(np.sqrt(20.0 / 6.0))


def _height_per_difference(time: Array) -> float:
    """Factor from the noise of second differences to the noise of heights, if it is white: period^2 / sqrt(6) [s^2]."""
    return float(np.median(np.diff(time))) ** 2 / float(np.sqrt(6.0))


def _longest_reach(time: Array) -> int:
    """Largest half width k of second differences, in samples."""
    return min(round(MAX_DIFFERENCE_S / float(np.median(np.diff(time)))), (len(time) - 2) // 4)


def _second_differences(time: Array, height: Array, reach: int) -> Array:
    """Second differences over ``reach`` samples on either side [m/s^2]."""
    first, last = time[reach:-reach] - time[: -2 * reach], time[2 * reach :] - time[reach:-reach]
    slopes = (height[2 * reach :] - height[reach:-reach]) / last, (height[reach:-reach] - height[: -2 * reach]) / first
    return np.asarray(2.0 * (slopes[0] - slopes[1]) / (first + last))


def _stretches(flying: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every stretch of flight."""
    edges = np.diff(np.concatenate(([False], flying, [False])).astype(int))
    return [(int(a), int(b) - 1) for a, b in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)]


def _fitted_impact(
    run: TrackedBody, item: ObjectPhysics, name: str, before: Rows, after: Rows, reach: int
) -> Impact | NoRow:
    """An impact by the flights of the centre of mass before and after."""
    period = float(np.median(np.diff(run.time)))
    before, after = _window(run, before, -1), _window(run, after, 1)
    edges = (float(run.time[before[-1]]), float(run.time[after[0]]))
    contact_duration = MAX_CONTACT_S if item.round else 0.0
    if edges[1] - edges[0] > (MAX_DISTURBED + 2.0) * reach * period + contact_duration:
        return NoRow(name, f"{UNSEEN}: {edges[1] - edges[0]:.3f} s without a sample")
    ante, post = (
        fly(run.time[rows], run.position[rows], run.rotation[rows], run.gravity, item.inertia, at)
        for rows, at in ((before, edges[0]), (after, edges[1]))
    )
    if _log_odds_of_a_jump(run, before, after, (ante, post)) < DECISIVE_LOG_ODDS:
        return NoRow(name, "rests, is carried or let go: a motion without a jump of the velocity fits as well")
    time = _crossing_time(ante, post, edges)
    position, rotation, twist = ante.at(time)
    post_twist = post.at(time)[2]
    if run.spin is not None:
        twist = np.concatenate((twist[:3], run.spin))
    noise = (float(np.hypot(ante.noise[0], post.noise[0])), float(np.hypot(ante.noise[1], post.noise[1])))
    lever = rotation @ item.com_offset
    position = position - lever
    twist, post_twist = (
        np.concatenate((at_com[:3] - np.cross(at_com[3:], lever), at_com[3:])) for at_com in (twist, post_twist)
    )
    corners = position + item.shape.first_points(item.size, -rotation[2]) @ rotation.T
    heights = np.sort(corners[:, 2])
    speeds = twist[2] + np.cross(twist[3:], corners - position)[:, 2]
    approach = -float(speeds[int(np.argmin(corners[:, 2]))])
    gap = float(heights[1] - heights[0]) if heights.size > 1 else np.inf
    if gap < max(MIN_NEXT_CORNER_SAMPLES, reach) * period * max(approach, 0.0):
        return NoRow(name, "lands on an edge or a face: another corner comes too soon after the first")
    if (reason := _contradiction(item, approach, noise[0], post_twist[2] - twist[2] * (not item.round))) is None:
        reason = _energy_gain(item, ante, post, time)
    if reason is not None:
        return NoRow(name, reason)
    extent = 0.0 if item.round else float(np.max(item.size))
    return Impact(
        run=name,
        condition="",
        object_name="",
        time=time,
        position=position,
        rotation=rotation,
        before=twist,
        after=post_twist,
        noise=noise,
        tolerance=2.0 * (ante.scatter[0] + 0.5 * ante.scatter[1] * extent),
        model="free flight",
        turn_tracked=run.spin is None,
        contact_noise=contact_noise(ante, before.size, extent, turns=False),
    )


def _log_odds_of_a_jump(
    run: TrackedBody, before: Rows, after: Rows, flights: tuple[FittedMotion, FittedMotion]
) -> float:
    """Log odds of a jump of the velocity between two flights over a jump of the acceleration alone, from all heights.

        z(t) = z_0 + v t + a t^2 / 2 + b max(t - t_0, 0)^2 / 2                 rest, a hand, a release, a catch
        (S_smooth - S_flights) / (2 sigma^2) + (5 - 4 - m) log(k) / 2          (Schwarz 1978)

    S are the sums of squared residuals of k heights, sigma is the noise of the tracker. The smooth motion has five
    parameters, two flights with their impact have four, and the m heights between the flights are free.
    """
    rows = np.arange(before[0], after[-1] + 1)
    t, height = run.time[rows] - run.time[before[-1]], run.position[rows, 2]
    smooth_squares = min(
        _residual_squares(np.column_stack((np.ones_like(t), t, t**2, np.square(np.maximum(t - knot, 0.0)))), height)
        for knot in t[1:-1]
    )
    flight_residuals = [
        run.position[row, 2] - flight.at(float(run.time[row]))[0][2]
        for part, flight in zip((before, after), flights, strict=True)
        for row in part
    ]
    noise = _difference_noise(run.time, run.position[:, 2]) * _height_per_difference(run.time)
    gain = smooth_squares - float(np.sum(np.square(flight_residuals)))
    free_heights = rows.size - before.size - after.size
    return gain / (2.0 * max(noise, 1e-12) ** 2) + 0.5 * (1 - free_heights) * float(np.log(rows.size))


def _residual_squares(basis: Array, values: Array) -> float:
    """Sum of squared residuals of least squares."""
    return float(np.sum(np.square(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])))


def _contradiction(item: ObjectPhysics, approach: float, noise: float, departure: float) -> str | None:
    """Reason why two motions are no impact on the plane; None: they may be an impact.

    Args:
        item: The body.
        approach: Speed at which its lowest point comes down [m/s].
        noise: Standard deviation of a velocity [m/s].
        departure: Normal velocity after the impact; for a body that is no ball, the change of it [m/s].
    """
    threshold = MIN_APPROACH_SIGMA * noise
    if approach < -threshold:
        return f"moves away from the plane before it, at {-approach:.2f} m/s: thrown or caught"
    if approach < threshold:
        return f"comes down at {approach:.2f} m/s, less than {MIN_APPROACH_SIGMA:g} standard deviations of the velocity"
    if departure < (-threshold if item.round else 0.0):
        return "goes on downwards: not this plane"
    return None


def _energy_gain(item: ObjectPhysics, ante: FittedMotion, post: FittedMotion, time: float) -> str | None:
    """Reason if the kinetic energy rises beyond its noise; None: it does not rise.

    For a ball the normal velocity alone decides: friction may turn its spin into a tangential velocity.
    """
    energies = []
    for motion in (ante, post):
        _, rotation, twist = motion.at(time)
        if item.round:
            energies.append((twist[2] ** 2, 2.0 * abs(twist[2]) * motion.noise[0]))
            continue
        spin = item.inertia * (rotation.T @ twist[3:])
        energy = item.mass * float(twist[:3] @ twist[:3]) + float(spin @ (rotation.T @ twist[3:]))
        noise = item.mass * np.linalg.norm(twist[:3]) * motion.noise[0], np.linalg.norm(spin) * motion.noise[1]
        energies.append((energy, 2.0 * float(np.hypot(*noise))))
    (energy_before, noise_before), (energy_after, noise_after) = energies
    if energy_after - energy_before <= MIN_APPROACH_SIGMA * np.hypot(noise_before, noise_after):
        return None
    return (
        f"leaves with {energy_after / energy_before - 1.0:.0%} more energy than before, which no fixed plane gives: "
        "thrown, hit by something that moves, or timestamps that run backwards"
    )


def _window(run: TrackedBody, rows: Rows, side: int) -> Rows:
    """Samples nearest to the impact, limited in duration and rotation."""
    rows = rows if side > 0 else rows[::-1]
    within_duration = np.abs(run.time[rows] - run.time[rows[0]]) <= MAX_FLIGHT_S
    rows = rows[: max(MIN_FLIGHT_SAMPLES, int(np.argmin(np.append(within_duration, False))))]
    angles = np.array([np.linalg.norm(pin.log3(run.rotation[row] @ run.rotation[rows[0]].T)) for row in rows])
    within_rotation = angles <= 2.0 * MAX_ROTATION_RAD
    rows = rows[: max(MIN_FLIGHT_SAMPLES, int(np.argmin(np.append(within_rotation, False))))]
    return np.asarray(rows if side > 0 else rows[::-1])


def _crossing_time(ante: FittedMotion, post: FittedMotion, edges: tuple[float, float]) -> float:
    """Time of equal heights of both flights [s]; both fall with g, so that the difference is linear in time."""
    start = edges[0]
    gap = ante.at(start)[0][2] - post.at(start)[0][2]
    slope = ante.at(start)[2][2] - post.at(start)[2][2]
    return float(np.clip(start - gap / slope, *edges)) if slope != 0.0 else start
