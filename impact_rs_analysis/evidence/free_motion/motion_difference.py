# SPDX-License-Identifier: Apache-2.0
"""Difference of two recordings of one motion, for example with and without a load.

The residual torque of a reference is subtracted from the recorded torque, at the same position of the motion:

    tau'(t) = tau(t) - (tau_r - tau_r,model)(t + s)

Friction, offsets and wrong link parameters are in both recordings and cancel; the residual of tau' arises from a change
between the recordings. Each recording is predicted along its own measured motion, so a small difference of the motions
changes tau' only by the errors of the model. The shift s minimises the mean square distance of the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from impact_rs_analysis.evidence.free_motion.torque_balance import Motion, TorqueBalance
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.since import MIN_WALL_CLOCK_S

SHIFTS_PER_PERIOD = 4.0  # of the cut-off frequency, tried before the best one is refined
MIN_OVERLAP_SHARE = 0.5  # of the shorter motion
PATH_POINTS = 200  # at equal arc length, where two paths are compared
MAX_DISTANCE_SHARE = 0.05  # rms distance over the size of the motion; above, it is another motion
MAX_ORDER_IMBALANCE = 0.2  # of the time of all recordings, between the mean times of both kinds


@dataclass(frozen=True)
class Match:
    """Best alignment of a motion with a reference.

    Attributes:
        number: Index of the reference.
        shift: Time of the reference minus time of the motion [s].
        distance: Distance of their positions, rms over time and joints [rad].
    """

    number: int
    shift: float
    distance: float


def minus_references(
    motions: Sequence[Motion],
    files: Sequence[Path],
    references: Sequence[Motion],
    physics: Physics,
    at_motor: bool,
) -> list[Motion]:
    """Every motion with the residual torque of the nearest reference subtracted, where the two overlap.

    Args:
        motions: Motions of the recordings.
        files: Their files, for messages.
        references: Motions of the recordings to subtract.
        physics: Physics of the arm under the model.
        at_motor: Whether the torque was measured at the motors.

    Raises:
        InputError: No reference follows the motion of a recording.
    """
    predicted = TorqueBalance([reference.without_motors for reference in references], at_motor).predicted(physics)
    residuals = [reference.torque - torque for reference, torque in zip(references, predicted, strict=True)]
    differences = []
    for motion, file in zip(motions, files, strict=True):
        match = nearest(motion, references)
        size = float(np.sqrt(np.mean(np.square(motion.position - motion.position.mean(axis=0)))))
        if match is None or match.distance > MAX_DISTANCE_SHARE * size:
            mismatch = "too short" if match is None else f"{match.distance:.3g} rad rms apart at best"
            reason = f"{mismatch}; the motion has {size:.3g} rad rms"
            if (speed := _speed_ratio_on_path(motion, references, MAX_DISTANCE_SHARE * size)) is not None:
                reason = (
                    f"one follows the same path {speed:.2g} times as fast; friction and inertial torques then differ, "
                    "and their residuals do not cancel"
                )
            raise InputError(
                f"follows the motion of no recording of --minus ({reason}): record the same motion twice at the same "
                "speed, without and with the load",
                file=file,
            )
        reference = references[match.number]
        reference_time = motion.time + match.shift
        first, last = reference.time[reference.inner][[0, -1]]
        inside = np.flatnonzero((reference_time >= first) & (reference_time <= last))
        differences.append(
            replace(
                motion.without_motors,
                torque=motion.torque - _at(reference_time, reference.time, residuals[match.number]),
                noise=np.hypot(motion.noise, reference.noise),
                measured=motion.measured & reference.measured,
                inner=slice(max(motion.inner.start, int(inside[0])), min(motion.inner.stop, int(inside[-1]) + 1)),
            )
        )
    return differences


def order_warning(recorded: Sequence[Array], subtracted: Sequence[Array]) -> str | None:
    """Warning that a drift (friction of warming gears) does not cancel; None: it cancels, or times are unknown.

    A drift linear in time cancels if both kinds of recordings have equal mean times, as in the order ABBA.

    Args:
        recorded: Timestamps of the recordings, ``(k,)`` each [s].
        subtracted: Timestamps of the recordings of ``--minus``, likewise.
    """
    timestamps = [*recorded, *subtracted]
    if any(time[0] < MIN_WALL_CLOCK_S for time in timestamps):
        return None
    span = max(float(time[-1]) for time in timestamps) - min(float(time[0]) for time in timestamps)
    means = [float(np.mean([time.mean() for time in times])) for times in (recorded, subtracted)]
    lag = means[0] - means[1]
    if abs(lag) <= MAX_ORDER_IMBALANCE * span:
        return None
    when = "later" if lag > 0.0 else "earlier"
    return (
        f"the recordings are on average {abs(lag) / 60.0:.3g} minutes {when} "
        "than the recordings of --minus: a drift meanwhile, as of friction while gears warm up, stays in the "
        "difference. The order without, with, with, without cancels a linear drift"
    )


def _speed_ratio_on_path(motion: Motion, references: Sequence[Motion], near: float) -> float | None:
    """Speed of a reference on the same path, within ``near`` [rad] rms, over the speed of the motion; None: no such."""
    path, speed = _path(motion)
    for reference in references:
        reference_path, reference_speed = _path(reference)
        if np.sqrt(np.mean(np.square(path - reference_path))) <= near:
            return reference_speed / speed
    return None


def _path(motion: Motion) -> tuple[Array, float]:
    """Positions at equal arc length along the path, ``(k, n)`` [rad], and the mean speed on it [rad/s]."""
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(motion.position, axis=0), axis=1))))
    return _at(np.linspace(0.0, length[-1], PATH_POINTS), length, motion.position), float(length[-1] / motion.time[-1])


def nearest(motion: Motion, references: Sequence[Motion]) -> Match | None:
    """The reference and time shift nearest to a motion; None if no reference overlaps it for long enough."""
    matches = [_match(motion, number, reference) for number, reference in enumerate(references)]
    return min(filter(None, matches), key=lambda match: match.distance, default=None)


def _match(motion: Motion, number: int, reference: Motion) -> Match | None:
    """Alignment with one reference; None if it does not overlap the motion for long enough."""
    time, position = motion.time[motion.inner], motion.position[motion.inner]
    first, last = reference.time[reference.inner][[0, -1]]
    least = MIN_OVERLAP_SHARE * min(time.size / motion.rate, last - first)

    def distance(shift: float) -> float:
        inside = (time + shift >= first) & (time + shift <= last)
        if np.count_nonzero(inside) < least * motion.rate:
            return np.inf
        difference = position[inside] - _at(time[inside] + shift, reference.time, reference.position)
        return float(np.sqrt(np.mean(np.square(difference))))

    step = 1.0 / (SHIFTS_PER_PERIOD * motion.cut_off)
    shifts = np.arange(first - time[-1] + least, last - time[0] - least + step, step)
    best = min(shifts.tolist(), key=distance, default=None)
    if best is None or not np.isfinite(distance(best)):
        return None
    fine = scipy.optimize.minimize_scalar(distance, bounds=(best - step, best + step), method="bounded")
    shift = min((best, float(fine.x)), key=distance)
    return Match(number, shift, distance(shift))


def _at(moments: Array, time: Array, values: Array) -> Array:
    """Columns of ``values`` interpolated at other times."""
    return np.column_stack([np.interp(moments, time, column) for column in values.T])
