# SPDX-License-Identifier: Apache-2.0
"""Detection of clocks and poses in raw numbers, each with its evidence.

    clock     the column that increases and gives a sampling rate of 1 Hz to 100 kHz in its unit
    pose      a unit quaternion and three numbers, in the unit in which they fall with g or are within reach

Roles of the joints' streams are found by their likelihood (:mod:`hypotheses`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping as AbstractMapping
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import shortened
from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2
from impact_rs_sim.rotations import MAX_NORM_ERROR
from impact_rs_trials.recordings.file_units import UNITS
from impact_rs_trials.recordings.readers.clock import seconds_of, seconds_of_dates
from impact_rs_trials.recordings.readers.clock_steps import MAX_STEPS_BACK
from impact_rs_trials.recordings.readers.series import MAX_UNSTAMPED_SHARE
from impact_rs_trials.recordings.readers.table_file import DATE
from impact_rs_trials.recordings.relations import (
    MIN_AVERAGED_SAMPLES,
    MIN_CORRELATION_OF_COLUMNS,
    SAME_UNIT_FACTORS,
    AveragedMotion,
    averaged,
)
from impact_rs_trials.since import MIN_WALL_CLOCK_S

STAMP = re.compile(r"(^|[^a-z])(t|time|times|timestamp|stamp|sec|secs|nsec)([^a-z]|$)|time|stamp", re.IGNORECASE)
STEP = re.compile(r"(^|[^a-z])(dt|delta_?t|delta_?time|time_?(delta|step))([^a-z]|$)", re.IGNORECASE)
AXIS = re.compile(r"(^|[^a-z])[xyz]([^a-z]|$)", re.IGNORECASE)  # of a position, which may increase like time
FRAME = re.compile(r"(^|[^a-z])frames?([^a-z]|$)|frame_?(nr|no|num|number|index|id)([^a-z]|$)", re.IGNORECASE)
NANOSECONDS = re.compile(r"nano|n_?sec|(^|[^a-z])ns([^a-z]|$)", re.IGNORECASE)
STAMP_UNITS = ("s", "ms", "us", "ns")
RATES_HZ = (1.0, 1e5)  # of a recording: lowest and highest
MIN_RANGE_SHARE = 1e-3  # of a joint's range, travelled by a joint that moves; encoders and sag make less
MAX_SHOWN_STEPS = 3  # backwards in time, in a message
MAX_CLOCK_JITTER = 0.1  # of the usual step, within which a step is even
MIN_EVEN_SHARE = 0.95  # of the steps; a column with more even steps is a clock, whatever its name
MIN_STAMPED_SHARE = 1.0 - MAX_UNSTAMPED_SHARE  # of the rows of a clock
OUTLIERS = np.errstate(over="ignore", invalid="ignore")  # outliers may overflow; such columns fit no hypothesis
MIN_TURN = 0.1  # range of two numbers of the quaternion of a body that turns
FALL_HALF_WIDTH_S = 0.04  # of second differences, in which a fall bends a track by 16 mm
MAX_FALL_RATIO = 1.3  # of the largest to the smallest second difference of one flight
MIN_FALLING_SHARE = 0.2  # of the samples; noise about 0 has at most an eighth of its samples within that ratio
MAX_SCALE_ERROR = 0.05  # relative, of a ruler in a picture
MAX_DISTANCE_M = 20.0  # of an object; a position beyond it is in millimetres


@dataclass(frozen=True)
class Guess:
    """A value of a key, with its evidence.

    Attributes:
        value: The value.
        evidence: Evidence in words.
        sure: Whether there is evidence; else the value is assumed.
        further: Further keys of the same section with their values.
        remarks: Warnings to the user.
    """

    value: Any
    evidence: str
    sure: bool = True
    further: AbstractMapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def clock_of(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> Guess | None:
    """The column of timestamps or time steps with its unit, or a pair of seconds and nanoseconds; None: not found."""
    columns = {
        name: cells for name, cells in columns.items() if not (isinstance(cells, np.ndarray) and np.iscomplexobj(cells))
    }
    pair = _clock_of_two(columns)
    steps = next((guess for name, cells in columns.items() if (guess := _steps(name, cells)) is not None), None)
    for allowed in (0, MAX_STEPS_BACK):  # a clock that was set back if there is no other
        candidates: list[tuple[float, str, Guess]] = []
        for index, (name, cells) in enumerate(columns.items()):
            guess = _clock(name, cells, allowed)
            if guess is not None:
                candidates.append((2.0 * bool(STAMP.search(name)) - 0.01 * index, name, guess))
        named = any(STAMP.search(name) for _, name, _ in candidates)
        if pair or (candidates and (named or steps is None)):
            return pair or max(candidates)[2]
    return steps


def steps_back(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> str | None:
    """Warning about a column with the name of a clock that steps backwards; None: there is no such column."""
    for name, cells in columns.items():
        try:
            stamps = np.asarray(cells, dtype=float) if STAMP.search(name) else np.zeros(0)
        except (ValueError, TypeError):
            continue
        steps = np.diff(stamps)
        if stamps.ndim != 1 or stamps.size < 3 or not np.isfinite(stamps).all() or not 0.0 < np.mean(steps < 0.0) < 0.5:
            continue
        rows = np.flatnonzero(steps < 0.0) + 1
        listed = [
            f"from {stamps[row - 1]:.10g} to {stamps[row]:.10g} at sample {row + 1}" for row in rows[:MAX_SHOWN_STEPS]
        ]
        more = f" and {rows.size - MAX_SHOWN_STEPS} times more" if rows.size > MAX_SHOWN_STEPS else ""
        return f"{name!r} steps back {', '.join(listed)}{more}: the clock was set, or rows are not in order"
    return None


def strange_stamp(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> str | None:
    """First cell of a column with the name of a clock that is neither number nor date; None: not found."""
    for name, cells in columns.items():
        for row, cell in enumerate(cells if STAMP.search(name) and isinstance(cells, list) else (), start=1):
            if cell.strip() and not DATE.fullmatch(cell.strip()) and not _is_number(cell):
                return f"{name!r} has {shortened(cell, 40)!r} in row {row}"
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _clock_of_two(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> Guess | None:
    """A pair of columns: whole seconds, and nanoseconds that begin anew with each second; None: not found."""
    integers = {name: stamps for name, cells in columns.items() if (stamps := _integers(cells)) is not None}
    for name, nanoseconds in integers.items():
        if not (NANOSECONDS.search(name) and nanoseconds.max() < 10**9):
            continue
        for other, seconds in integers.items():
            if other == name or np.any(np.diff(seconds) < 0) or seconds[-1] >= 5e9:
                continue
            steps = np.diff(seconds * 10**9 + nanoseconds)
            usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else np.inf
            if np.all(steps >= 0) and RATES_HZ[0] <= 1e9 / usual <= RATES_HZ[1]:
                evidence = f"whole seconds and nanoseconds; together they increase, at {1e9 / usual:.4g} Hz"
                repeats = int(np.sum(steps == 0))
                remarks = (f"{repeats} of {nanoseconds.size} stamps repeat the one before",) if repeats else ()
                return Guess([other, name], evidence, True, {"unit": "s"}, remarks)
    return None


def _integers(cells: Sequence[str] | NDArray[Any]) -> NDArray[np.int64] | None:
    """A column of non-negative integers; None: it holds other numbers."""
    try:
        numbers = np.asarray(cells, dtype=float)
    except (ValueError, TypeError):
        return None
    if numbers.ndim != 1 or numbers.size < 3 or not np.isfinite(numbers).all() or numbers.min() < 0.0:
        return None
    return numbers.astype(np.int64) if numbers.max() < 5e9 and not np.any(np.mod(numbers, 1.0)) else None


def _clock(name: str, cells: Sequence[str] | NDArray[Any], steps_back: int) -> Guess | None:
    """A column of timestamps with at most ``steps_back`` steps back; None: no clock, e.g. frames or positions."""
    if FRAME.search(name) or (AXIS.search(name) and not STAMP.search(name)):
        return None
    if isinstance(cells, list) and cells and all(DATE.fullmatch(cell.strip()) for cell in cells):
        return Guess(name, "holds dates", further={"unit": "date"})
    possible: Sequence[str] = STAMP_UNITS
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "mM":
        cells, possible = 1e9 * seconds_of_dates(cells), ("ns",)
    try:
        stamps = numbers_of(cells)
    except (ValueError, TypeError):
        return None
    finite = np.isfinite(stamps)
    if stamps.ndim != 1 or stamps.size < 3 or np.mean(finite) < MIN_STAMPED_SHARE:
        return None
    stamps = stamps[finite]
    steps = np.diff(stamps)
    usual_step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    if usual_step == 0.0 or float(np.mean(np.abs(steps[steps > 0.0] / usual_step - 1.0) < 0.9)) < 0.5:
        return None
    is_even = float(np.mean(np.abs(steps / usual_step - 1.0) < MAX_CLOCK_JITTER)) > MIN_EVEN_SHARE
    if np.count_nonzero(steps < 0.0) > steps_back * (is_even or bool(STAMP.search(name))):
        return None
    units = [unit for unit in possible if _plausible(unit, stamps, usual_step)]
    named = [unit for unit in units if re.search(rf"(^|[^a-z]){unit}([^a-z]|$)", name, re.IGNORECASE)]
    if not units:
        return None
    unit = (named or units)[0]
    rate = 1.0 / (usual_step * UNITS["time"][unit])
    backwards = np.count_nonzero(steps < 0.0)
    evidence = f"increases{f', {backwards} steps back aside' if backwards else ''}; in {unit} that is {rate:.4g} Hz"
    if stamps[0] * UNITS["time"][unit] > MIN_WALL_CLOCK_S:
        evidence += f", from {_year(stamps[0] * UNITS['time'][unit])} on"
    repeats = int(np.sum(steps == 0.0))
    remarks = (f"{repeats} of {stamps.size} stamps repeat the one before",) if repeats else ()
    return Guess(name, evidence, bool(named or len(units) == 1), {"unit": unit}, remarks)


def _steps(name: str, cells: Sequence[str] | NDArray[Any]) -> Guess | None:
    """A column of time steps, whose first cell may be empty; None: not found."""
    if not STEP.search(name) or np.ndim(cells) != 1 or len(cells) < 3:
        return None
    try:
        steps = np.asarray(cells[1:], dtype=float)
    except (ValueError, TypeError):
        return None
    usual_step = float(np.median(steps)) if np.isfinite(steps).all() and np.all(steps >= 0.0) else 0.0
    units = [unit for unit in STAMP_UNITS if usual_step > 0.0 and _plausible(unit, np.zeros(1), usual_step)]
    if not units:
        return None
    rate = 1.0 / (usual_step * UNITS["time"][units[0]])
    evidence = f"times since the row before, by its name; in {units[0]} that is {rate:.4g} Hz"
    return Guess(name, evidence, len(units) == 1, {"unit": units[0], "steps": True})


def numbers_of(cells: Sequence[str] | NDArray[Any]) -> Array:
    """Numbers of a column, ``(k,)``; nan in an empty cell."""
    return np.asarray(cells if isinstance(cells, np.ndarray) else [cell or "nan" for cell in cells], dtype=float)


def other_units(clock: Guess, stamps: Array) -> list[str]:
    """Units that fit the timestamps as well as the assumed unit; empty if there is evidence for the unit.

    Args:
        clock: Result of :func:`clock_of`.
        stamps: Numbers of the column of that clock, ``(k,)``.
    """
    steps = np.diff(stamps)
    usual_step = float(np.median(steps[steps > 0.0]))
    alternatives = [] if clock.sure else [unit for unit in STAMP_UNITS if unit != clock.further["unit"]]
    return [unit for unit in alternatives if _plausible(unit, stamps, usual_step)]


def _plausible(unit: str, stamps: Array, step: float) -> bool:
    """Whether timestamps in a unit give a plausible sampling rate and year."""
    seconds = UNITS["time"][unit]
    start = float(seconds_of(stamps[:1], seconds)[0])
    return RATES_HZ[0] <= 1.0 / (step * seconds) <= RATES_HZ[1] and start < 5e9


def _year(seconds: float) -> str:
    return str(np.datetime64(int(seconds), "s").astype("datetime64[Y]"))


def at_rest(time: Array, position: Array, facts: RobotFacts) -> str | None:
    """Warning that no joint moves, so that units, signs, inertia and friction remain unknown; None: some joint moves.

    Args:
        time: Stamps, ``(k,)`` [s].
        position: q, ``(k, n)`` [rad].
        facts: Facts with the ranges of the joints.
    """
    if time.size < 2 * MIN_AVERAGED_SAMPLES:
        return None
    ranges = np.array(facts.limits.position_max_rad) - np.array(facts.limits.position_min_rad)
    moved = np.ptp(averaged(time, position)[1], axis=0)
    if np.any(moved > MIN_RANGE_SHARE * ranges):
        return None
    joint = int(np.argmax(moved / ranges))
    unit = facts.units[joint].position
    return (
        f"no motion, nothing to identify: joint {joint + 1} moves most, by {moved[joint]:.2g} {unit} in "
        f"{time[-1] - time[0]:.3g} s, expected at least {MIN_RANGE_SHARE * ranges[joint]:.2g} {unit}"
    )


@OUTLIERS
def are_derivatives(time: Array, values: Array, raw: Array) -> NDArray[np.bool_]:
    """Mask of the columns of ``raw``, ``(k, c)``, that are derivatives of the same columns of ``values``, ``(c,)``."""
    relation = AveragedMotion.of(time, values).velocity_relation(time, raw)
    one_unit = (relation.factor > SAME_UNIT_FACTORS[0]) & (relation.factor < SAME_UNIT_FACTORS[1])
    return np.asarray(one_unit & (relation.correlation > MIN_CORRELATION_OF_COLUMNS))


def unit_of_length(position: Array) -> Guess:
    """Unit of positions ``(k, 3)`` of an object near a robot."""
    largest = float(np.nanmax(np.abs(position)))
    unit = "mm" if largest > MAX_DISTANCE_M else "m"
    return Guess(unit, f"up to {largest:.3g} from the origin, which is a position near a robot in {unit}")


def unit_of_flight(time: Array, position: Array) -> Guess:
    """Unit of positions of a body without a robot: the unit in which it falls with g, else an assumed unit.

    Args:
        time: Stamps, ``(k,)`` [s].
        position: Positions along any axes, one of which is vertical, ``(k, 3)``.
    """
    tracked = np.isfinite(position).all(axis=1)
    fall = fall_in(time[tracked], position[tracked])
    if fall is not None and fall[1].sure:
        return Guess(fall[1].value, fall[1].evidence)
    length = unit_of_length(position)
    return replace(length, evidence=f"nothing falls freely; {length.evidence}", sure=False)


def fall_in(time: Array, position: Array) -> tuple[int, Guess] | None:
    """Index of the coordinate in free fall, with unit and factors from its acceleration; None: nothing falls freely.

    Second differences are nearly equal in a flight, and unequal in a bounce or while a ball rests or is held.

    Args:
        time: Stamps, ``(k,)`` [s].
        position: Horizontal and vertical coordinate in any order and unit, ``(k, 2)``, or the vertical, ``(k, 1)``.
    """
    reach = max(1, round(FALL_HALF_WIDTH_S / float(np.median(np.diff(time)))))
    if len(time) < 4 * reach:
        return None
    first, last = time[reach:-reach] - time[: -2 * reach], time[2 * reach :] - time[reach:-reach]
    middle = position[reach:-reach]
    slopes = (middle - position[: -2 * reach]) / first[:, None], (position[2 * reach :] - middle) / last[:, None]
    second_differences = 2.0 * (slopes[1] - slopes[0]) / (first + last)[:, None]
    candidates = [
        (*_densest(sign * second_differences[:, axis]), sign, axis)
        for axis in range(position.shape[1])
        for sign in (-1.0, 1.0)
    ]
    share, size, sign, up = max(candidates)
    if share < MIN_FALLING_SHARE:
        return None
    fall = sign * size
    unit = next((name for name, size in UNITS["length"].items() if _is_gravity(abs(fall) * size)), None)
    scale = UNITS["length"].get(unit or "", GRAVITY_M_S2 / abs(fall))
    evidence = f"it falls by {abs(fall):.4g} per s^2{' towards larger numbers' if fall > 0.0 else ''}"
    if unit is not None and fall < 0.0:
        return up, Guess(unit, f"{evidence}: {unit}")
    factor = 1.0 if unit is not None else float(f"{scale:.4g}")
    further = {"factor": [*[factor] * (position.shape[1] - 1), -factor if fall > 0.0 else factor]}
    if unit is not None:
        return up, Guess(unit, f"{evidence}: {unit}", True, further)
    return up, Guess("m", f"{evidence}, which is g with this scale; a measured scale is better", False, further)


def _densest(values: Array) -> tuple[float, float]:
    """Largest share of positive values within a factor of ``MAX_FALL_RATIO`` of each other, and their median."""
    logs = np.sort(np.log(values[values > 0.0]))
    if not logs.size:
        return 0.0, 0.0
    ends = np.searchsorted(logs, logs + np.log(MAX_FALL_RATIO), side="right")
    first = int(np.argmax(ends - np.arange(logs.size)))
    densest = logs[first : ends[first]]
    return densest.size / values.size, float(np.exp(np.median(densest)))


def _is_gravity(fall: float) -> bool:
    """Whether an acceleration [m/s^2] equals g within the error of a scale in a picture."""
    return abs(fall / GRAVITY_M_S2 - 1.0) < MAX_SCALE_ERROR


def holds_a_turn(raw: Array) -> bool:
    """Whether four neighbouring numbers of a stream ``(k, n)`` are the unit quaternion of a body that turns."""
    for first in range(raw.shape[1] - 3):
        quaternion = raw[:, first : first + 4]
        if np.sum(np.ptp(quaternion, axis=0) > MIN_TURN) > 1 and quaternion_order(quaternion) is not None:
            return True
    return False


def quaternion_order(quaternion: Array) -> Guess | None:
    """Order of unit quaternions ``(k, 4)``; None: their length is not 1."""
    tracked = quaternion[np.isfinite(quaternion).all(axis=1)]
    if not len(tracked) or not np.all(np.abs(np.linalg.norm(tracked, axis=1) - 1.0) < MAX_NORM_ERROR):
        return None
    middle = np.median(np.abs(tracked), axis=0)  # q and -q are one orientation
    if middle[0] > 0.9 or middle[3] > 0.9:
        order = "xyzw" if middle[3] > middle[0] else "wxyz"
        word = "last" if order == "xyzw" else "first"
        return Guess(order, f"the {word} number of the unit quaternion is near 1, as w of a body that hardly turns")
    return Guess("xyzw", "nothing shows which number of the unit quaternion is w; taken as x y z w", False)
