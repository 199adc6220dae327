# SPDX-License-Identifier: Apache-2.0
"""Samples that a sensor did not measure: outliers (Hampel filter) and frozen values, removed joint by joint.

A sample x_k of a signal is an *outlier* of a Hampel filter (median of 5, local median absolute deviation), if

    d_k = |x_k - median(x_{k-2} ... x_{k+2})|  >  max(MIN_OUTLIER_SIGMA * 1.4826 * median |d| about it, F)

with a floor F that no joint reaches and leaves within two samples: half the data sheet's velocity or torque, the path
of the fastest motion in a sampling period, and at least 12 steps of the sensor's resolution. A sample beyond the data
sheet is an outlier as well, except in the 50 ms after an impact. Steps, as an impact makes them,
are no outliers: three of five samples are on one side.

False alarms: normal noise exceeds 12 standard deviations with a probability of 4e-33 per sample, Laplace noise exceeds
the same threshold with 4e-6, and either has to exceed F too. Where more than 2 % of a joint's samples would be outliers
the signal is noisy, or in another unit: they stay, and the limits of the data sheet decide.

A run of identical values is *frozen* where other measurements contradict it: a joint stands still by its position and
moves by its velocity (or the reverse), it stops dead while other joints keep moving, or its torque stays constant while
the gravity torque changes. If a sensor repeats values as a rule (quantised, or sampled more slowly than it is
recorded), a frozen run is at least ten times as long as its median run. A joint that stands still in the whole
recording, with velocity 0, rests.

False alarms: none in 2000 simulated recordings of quantised encoders that rest, creep and turn back (the first 300 of
them in ``test_faults.py``), which is less than 0.15 % of recordings at 95 % confidence. Found of 208 joints that freeze
for half a recording and would have moved by 0.1 rad: 90 % if the velocity has another sensor, 79 % of frozen
velocities, and 28 % if the velocity is a difference of the frozen encoder, which shows the fault only if the joint
moves as it freezes. Found as well: all torques whose gravity part changes by 1 N m, and all single samples of 50 rad/s.
"""

from __future__ import annotations

from collections.abc import Mapping as AbstractMapping

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.joint_jumps import impact_time
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.relations import MIN_SPEED_SHARE, PLAUSIBLE_FACTORS, pooled
from impact_rs_trials.recordings.remarks import remark

Mask = NDArray[np.bool_]

MAX_POSITION_EXCESS = 0.1  # rad or m, of a measured position beyond the data sheet's limits
MAX_LIMIT_FACTOR = 1.2  # of the data sheet, for a measured velocity or torque
MIN_OUTLIER_SIGMA = 12.0  # robust standard deviations of the Hampel filter: 1.4826 median absolute deviations
MAD_HALF_WINDOW = 50  # samples on either side, of the median absolute deviation
MIN_OUTLIER_SHARE = 0.5  # of the data sheet's velocity or torque
MAX_OUTLIER_SHARE = 0.02  # of a joint's samples
AFTER_IMPACT_S = 0.05  # in which the velocities and torques of an impact may be beyond the data sheet
BEFORE_IMPACT_S = 0.01
MIN_FROZEN_S = 0.05  # of a frozen run
MIN_FROZEN_SAMPLES = 20
MIN_FROZEN_RATIO = 10  # of a frozen run to the median run of identical values
SPEED_QUANTILE = 0.9  # of a run and its neighbours; the fastest tenth is no evidence, because the joint may rest in it
EDGE_S = 0.02  # before and after the edge of a run, for the speed there
STEADY_SPEED_RATIO = (0.8, 1.25)  # of neighbouring stretches of a joint that neither brakes nor accelerates
MIN_CHANGE_RESOLUTIONS = 10  # of a sensor; a larger change is certainly measured
MIN_GRAVITY_CHANGE_SHARE = 0.01  # of the data sheet's torque; a torque sensor certainly measures more than that

PAIRS: tuple[tuple[SignalName, SignalName], ...] = (("position", "velocity"), ("motor_position", "motor_velocity"))


def without_faults(
    series: AbstractMapping[SignalName, Series],
    mapping: Mapping,
    model: RobotModel | None = None,
    hit: bool = False,
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals without outliers and frozen samples.

    Args:
        series: Signals of one arm in SI units, with checked stamps.
        mapping: Mapping with the robot and its limits.
        model: Model for the gravity torque; None: torques are not compared with it.
        hit: Whether the arm hits something; else it moves freely.

    Returns:
        The signals, and a warning about the removed samples of every joint.
    """
    cleaned, remarks = dict(series), []
    impact = _impact(cleaned["position"], cleaned["velocity"], mapping) if hit else None
    checked: tuple[SignalName, ...] = ("position", "velocity", "torque", "motor_position", "motor_velocity")
    for name in checked:
        if name in cleaned:
            faulty = outliers(name, cleaned[name], mapping, impact)
            remarks += _remarks(cleaned[name], faulty, "outlier", mapping, name)
            cleaned[name] = _without(cleaned[name], faulty)
    frozen: dict[SignalName, Mask] = {}
    for position_name, velocity_name in PAIRS:
        if position_name in cleaned and velocity_name in cleaned:
            frozen[position_name] = _constant_in_motion(cleaned[position_name], cleaned[velocity_name], mapping, impact)
            frozen[velocity_name] = _constant_unlike_derivative(cleaned[velocity_name], cleaned[position_name], mapping)
    if "torque" in cleaned and "position" in cleaned and model is not None:
        position = cleaned["position"]
        moving = _without(position, frozen.get("position", np.zeros(position.values.shape, dtype=bool)))
        if moving.time.size:
            frozen["torque"] = _constant_unlike_gravity(cleaned["torque"], moving, mapping, model)
    for frozen_name, faulty in frozen.items():
        remarks += _remarks(cleaned[frozen_name], faulty, "frozen", mapping, frozen_name)
        cleaned[frozen_name] = _without(cleaned[frozen_name], faulty)
    return cleaned, remarks


def _impact(position: Series, velocity: Series, mapping: Mapping) -> float:
    """Time of the arm's impact, by positions and velocities without their outliers [s]."""
    velocity_outliers = _hampel_outliers(
        velocity.values, MIN_OUTLIER_SHARE * np.array(mapping.facts.limits.velocity_rad_s)
    )
    cleaned = _without(position, outliers("position", position, mapping, None))
    return impact_time(cleaned, _without(velocity, velocity_outliers))


def beyond_data_sheet(name: SignalName, values: Array, facts: RobotFacts) -> Mask:
    """Mask of the samples beyond the data sheet's position, velocity or torque, ``(k, n)``.

    Args:
        name: Position, velocity or torque of joints or motors.
        values: SI, ``(k, n)``.
        facts: Has the limits.
    """
    limits = facts.limits
    if name.endswith("position"):
        low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
        return np.asarray((values < low - MAX_POSITION_EXCESS) | (values > high + MAX_POSITION_EXCESS))
    limit = limits.torque_Nm if name == "torque" else limits.velocity_rad_s
    return np.asarray(np.abs(values) > MAX_LIMIT_FACTOR * np.array(limit))


# ---- outliers -------------------------------------------------------------------------------------------------------


def outliers(name: SignalName, series: Series, mapping: Mapping, impact: float | None) -> Mask:
    """Mask of the outliers of a joint signal by Hampel filter and data sheet, ``(k, n)``.

    Args:
        name: Position, velocity or torque of joints or motors.
        series: The signal in SI units.
        mapping: Knows robot and limits.
        impact: Time of the impact [s]; None: free motion.
    """
    values, time = series.values, series.time
    limits = mapping.facts.limits
    if name.endswith("position"):
        floor = MAX_LIMIT_FACTOR * np.array(limits.velocity_rad_s) * float(np.median(np.diff(time)))
    else:
        floor = MIN_OUTLIER_SHARE * np.array(limits.torque_Nm if name == "torque" else limits.velocity_rad_s)
    floor = np.maximum(floor, MIN_OUTLIER_SIGMA * _resolution(values))
    beyond_limits = beyond_data_sheet(name, values, mapping.facts)
    if impact is not None and not name.endswith("position"):
        beyond_limits[(time >= impact - BEFORE_IMPACT_S) & (time <= impact + AFTER_IMPACT_S)] = False
    if name.startswith("motor"):  # the data sheet has no limits of motors
        beyond_limits[:] = False
    isolated = _hampel_outliers(values, floor)
    if name == "torque" and impact is not None:  # an impact may last a single sample
        isolated[(time >= impact - BEFORE_IMPACT_S) & (time <= impact + AFTER_IMPACT_S)] = False
    isolated[:, isolated.mean(axis=0) > MAX_OUTLIER_SHARE] = False
    outlier_mask = isolated | beyond_limits
    outlier_mask[:, outlier_mask.mean(axis=0) > MAX_OUTLIER_SHARE] = False
    return np.asarray(outlier_mask)


def _hampel_outliers(values: Array, floor: Array) -> Mask:
    """Mask of the samples far from the median of the five samples around them, ``(k, n)``."""
    if values.shape[0] < 5:
        return np.zeros(values.shape, dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(values, 5, axis=0)
    median = np.median(windows, axis=-1)
    median = np.concatenate((median[[0, 0]], median, median[[-1, -1]]))
    deviation = np.abs(values - median)
    # The first and last two samples have no two neighbours on either side: deviation from lines through the next ones.
    for ends, inwards in ((deviation[:2], values), (deviation[:-3:-1], values[::-1])):
        for row in (0, 1):
            first, second, third = inwards[row + 1], inwards[row + 2], inwards[row + 3]
            lines = 2.0 * first - second, 3.0 * second - 2.0 * third
            ends[row] = np.minimum(*(np.abs(inwards[row] - line) for line in lines))
    mask = deviation > floor
    for row, joint in np.argwhere(mask):
        nearby = deviation[max(0, row - MAD_HALF_WINDOW) : row + MAD_HALF_WINDOW + 1, joint]
        mask[row, joint] = deviation[row, joint] > MIN_OUTLIER_SIGMA * 1.4826 * float(np.median(nearby))
    return np.asarray(mask)


def _resolution(values: Array) -> Array:
    """Smallest change of each joint's numbers, ``(n,)``; 0 where nothing changes."""
    steps = np.abs(np.diff(values, axis=0))
    steps = np.where(steps > 0.0, steps, np.inf)
    smallest = np.min(steps, axis=0)
    return np.where(np.isfinite(smallest), smallest, 0.0)


# ---- frozen values --------------------------------------------------------------------------------------------------


def _runs(series: Series, joint: int) -> list[slice]:
    """Runs of identical values that are much longer than usual."""
    time, values = series.time, series.values[:, joint]
    edges = np.flatnonzero(np.diff(values) != 0.0)
    first, last = np.append(0, edges + 1), np.append(edges, values.size - 1)
    usual_length = float(np.median((last - first + 1)[1:-1])) if first.size > 2 else 1.0
    min_length = max(MIN_FROZEN_SAMPLES, MIN_FROZEN_RATIO * usual_length)
    return [
        slice(int(a), int(b) + 1)
        for a, b in zip(first, last, strict=True)
        if b - a + 1 >= min_length and time[b] - time[a] >= MIN_FROZEN_S
    ]


def _constant_in_motion(position: Series, velocity: Series, mapping: Mapping, impact: float | None) -> Mask:
    """Mask of positions that stay constant while the joint moves by its velocity or stops dead, ``(k, n)``."""
    time, values = position.time, position.values
    speed = velocity.at(time)
    min_speed = MIN_SPEED_SHARE * np.array(mapping.facts.limits.velocity_rad_s)
    resolution = _resolution(values)
    frozen = np.zeros(values.shape, dtype=bool)
    for joint in range(values.shape[1]):
        for run in _runs(position, joint):
            distance = np.append(
                0.0, np.cumsum(0.5 * (speed[run, joint][1:] + speed[run, joint][:-1]) * np.diff(time[run]))
            )
            speeds = np.quantile(np.abs(_speeds(time[run], distance)), SPEED_QUANTILE)
            by_velocity = speeds > min_speed[joint] and np.ptp(distance) > MIN_CHANGE_RESOLUTIONS * resolution[joint]
            at_impact = impact is not None and abs(time[run.start] - impact) < AFTER_IMPACT_S
            if by_velocity or (not at_impact and _stops_dead(position, run, joint, min_speed, resolution)):
                frozen[run, joint] = True
    return frozen


def _stops_dead(position: Series, run: slice, joint: int, min_speed: Array, resolution: Array) -> bool:
    """Whether a joint stops (or starts) without braking (or accelerating) while other joints keep moving."""
    return _dead_edge(position.time, position.values, run.start, joint, min_speed, resolution) or _dead_edge(
        -position.time[::-1], position.values[::-1], position.time.size - run.stop, joint, min_speed, resolution
    )


def _dead_edge(time: Array, values: Array, edge: int, joint: int, min_speed: Array, resolution: Array) -> bool:
    """Whether a joint stops without braking at the sample ``edge`` while other joints keep moving."""
    width = max(3, int(np.searchsorted(time - time[0], EDGE_S)))
    moved = edge - 1  # the last sample of the motion
    if moved < 2 * width or edge + width >= time.size:
        return False

    def speed(first: int, last: int) -> Array:
        return np.asarray((values[last] - values[first]) / (time[last] - time[first]))

    before, earlier = speed(moved - width, moved), speed(moved - 2 * width, moved - width)
    after = speed(edge, edge + width)
    distance = abs(values[moved, joint] - values[moved - width, joint])
    if abs(before[joint]) < min_speed[joint] or distance < 2.0 * MIN_CHANGE_RESOLUTIONS * resolution[joint]:
        return False
    if not STEADY_SPEED_RATIO[0] < abs(before[joint]) / max(abs(earlier[joint]), 1e-12) < STEADY_SPEED_RATIO[1]:
        return False
    other_joints = np.arange(values.shape[1]) != joint
    shares = (
        np.abs(before[other_joints]) / min_speed[other_joints],
        np.abs(after[other_joints]) / min_speed[other_joints],
    )
    return bool(np.max(shares[0], initial=0.0) > 1.0 and np.sum(shares[1]) > STEADY_SPEED_RATIO[0] * np.sum(shares[0]))


def _speeds(time: Array, position: Array) -> Array:
    """Mean speeds over stretches of at least ``MIN_FROZEN_S`` and half of a least run, ``(p,)``."""
    stretches = max(1, min(int((time[-1] - time[0]) / MIN_FROZEN_S), 2 * time.size // MIN_FROZEN_SAMPLES))
    edges = np.linspace(float(time[0]), float(time[-1]), stretches + 1)
    return np.asarray(np.diff(np.interp(edges, time, position)) / (edges[1] - edges[0]))


def _constant_unlike_derivative(velocity: Series, position: Series, mapping: Mapping) -> Mask:
    """Mask of velocities that stay constant while the derivative of the position differs, ``(k, n)``.

    If velocities differ from that derivative outside of such runs as well, unit or sign are wrong, not the sensor.
    """
    time, values, positions = velocity.time, velocity.values, position.at(velocity.time)
    min_speed = MIN_SPEED_SHARE * np.array(mapping.facts.limits.velocity_rad_s)
    resolution, position_resolution = _resolution(values), _resolution(position.values)
    derived = np.gradient(positions, time, axis=0)
    frozen = np.zeros(values.shape, dtype=bool)
    for joint in range(values.shape[1]):
        for run in _runs(velocity, joint):
            differences = np.abs(_speeds(time[run], positions[run, joint]) - values[run.start, joint])
            if (
                np.quantile(differences, SPEED_QUANTILE)
                > min_speed[joint] + 2.0 * resolution[joint] + 4.0 * position_resolution[joint] / MIN_FROZEN_S
            ):
                frozen[run, joint] = True
        live = ~frozen[:, joint]
        ratio = float(pooled(derived[live, joint], values[live, joint]).factor[0])
        if not PLAUSIBLE_FACTORS[0] < ratio < PLAUSIBLE_FACTORS[1]:
            frozen[:, joint] = False
    return frozen


def _constant_unlike_gravity(torque: Series, position: Series, mapping: Mapping, model: RobotModel) -> Mask:
    """Mask of torques that stay constant while the gravity torque of the joint changes, ``(k, n)``."""
    time, values = torque.time, torque.values
    min_change = np.maximum(
        MIN_CHANGE_RESOLUTIONS * _resolution(values),
        MIN_GRAVITY_CHANGE_SHARE * np.array(mapping.facts.limits.torque_Nm),
    )
    frozen = np.zeros(values.shape, dtype=bool)
    for joint in range(values.shape[1]):
        for run in _runs(torque, joint) if np.ptp(values[:, joint]) > 0.0 else ():  # else it was not measured at all
            rows = np.unique(np.linspace(run.start, run.stop - 1, MIN_FROZEN_SAMPLES).astype(int))
            gravity = [float(model.gravity_torque(q)[joint]) for q in position.at(time[rows])]
            if np.ptp(gravity) > min_change[joint]:
                frozen[run, joint] = True
    return frozen


# ---- remarks --------------------------------------------------------------------------------------------------------


def _without(series: Series, faulty: Mask) -> Series:
    """The signal without the rows in which a joint is faulty."""
    good = ~faulty.any(axis=1)
    return series if good.all() else series.in_rows(np.asarray(good))


def _remarks(series: Series, faulty: Mask, kind: str, mapping: Mapping, name: SignalName) -> list[str]:
    """One remark for every joint with faulty samples."""
    remarks: list[str] = []
    for joint in np.flatnonzero(faulty.any(axis=0)).tolist():
        rows = np.flatnonzero(faulty[:, joint])
        start = series.time[rows] - series.time[0]
        units = mapping.facts.units[joint]
        unit = units.position if name.endswith("position") else units.effort if name == "torque" else units.velocity
        location, value = f"{series.label}: joint {joint + 1}", float(series.values[rows[0], joint])
        share = remark("{:d} of {:d} samples", rows.size, series.time.size)
        if kind == "outlier":
            verb = "is an outlier" if rows.size == 1 else "are outliers"
            words = "{}: {} {}, first {:.4g} {} at t = {:.3f} s: left out"
            remarks.append(remark(words, location, share, verb, value, unit, start[0]))
        else:
            words = "{}: frozen at {:.4g} {} within t = {:.3f} ... {:.3f} s ({}): left out"
            remarks.append(remark(words, location, value, unit, start[0], start[-1], share))
    return remarks
