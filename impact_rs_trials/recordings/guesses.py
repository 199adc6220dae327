# SPDX-License-Identifier: Apache-2.0
"""What raw numbers are, guessed from physics: clock, units and signs, each with the evidence for it.

    clock     the column that increases and gives a sampling rate of 1 Hz to 100 kHz in its unit
    position  the unit in which all of them lie within the limits of the joints
    velocity  v = a dq/dt:  a is unit and sign
    torque    tau = a (M ddq + h):  a is unit and sign; motor currents give another a for every joint, of one sign and
              size; what repeats the motion with one factor in all joints was asked for, and is no torque
    pose      a unit quaternion beside three numbers within reach

Signals and derivatives are compared after a moving average, because encoders are quantised.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as AbstractMapping
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robot import Array, RobotFacts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.clock import seconds_of
from impact_rs_trials.recordings.mapping import SLIDES, TURNS, UNITS
from impact_rs_trials.recordings.relations import (
    MAX_FACTOR_SPREAD,
    MIN_AVERAGED,
    MIN_CORRELATION,
    MIN_CORRELATION_ASSUMED,
    MIN_CORRELATION_AT_RATE,
    ONE_UNIT,
    TORQUE_UNIT,
    WRONG_FACTOR,
    AveragedMotion,
    averaged,
    fit,
    moves,
)
from impact_rs_trials.recordings.table_file import DATE

STAMP = re.compile(r"(^|[^a-z])(t|time|times|timestamp|stamp|sec|secs|nsec)([^a-z]|$)|time|stamp", re.IGNORECASE)
NANOSECONDS = re.compile(r"nano|n_?sec|(^|[^a-z])ns([^a-z]|$)", re.IGNORECASE)
STAMP_UNITS = ("s", "ms", "us", "ns")
RATES = (1.0, 1e5)  # Hz, that a recording may have
MARGIN = 0.05  # of the range of a joint, by which positions may lie beyond it
COPIED = 0.9  # correlation of a copy of the motion, of three joints and more,
EXACTLY, EXACT_FACTOR = 0.999, (0.98, 1.02)  # and of fewer, of which a torque might look like one
FEWEST_COPIED = 3
MOST_OF_TRAVEL, SOME_TRAVEL = 0.5, 0.2  # of the joint that travels farthest, from which others show a relation
MOST_APART = 30.0  # ratio of torque constants of one arm
STILL = 1e-3  # of the range of a joint, below which it does not move; encoders and sag make less
NOTICED = 0.3  # of what the largest joint takes by weight and inertia, in proportion to the robot [N m]
MOST_SHOWN = 3  # steps back in a message
LOOKED_AT = 400  # samples in which the torque is compared
OUTLIERS = np.errstate(over="ignore", invalid="ignore")  # may be of any size; what they spoil fits nothing
UNIT_LENGTH = 0.02  # by which a quaternion may be off length 1
REACH = 20.0  # m; a position beyond it is in millimetres


@dataclass(frozen=True)
class Guess:
    """A value of a key, and what shows it.

    Attributes:
        value: The value.
        evidence: What shows it, in words.
        sure: Whether something shows it; else it is assumed.
        further: Further keys of the same section with their values.
        remarks: What the user should know besides.
    """

    value: Any
    evidence: str
    sure: bool = True
    further: AbstractMapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def clock_of(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> Guess | None:
    """The column of the stamps, with its unit, or those of whole seconds and of nanoseconds; None: none can be."""
    columns = {
        name: cells for name, cells in columns.items() if not (isinstance(cells, np.ndarray) and np.iscomplexobj(cells))
    }
    found: list[tuple[float, str, Guess]] = []
    for place, (name, cells) in enumerate(columns.items()):
        guess = _clock(name, cells)
        if guess is not None:
            found.append((2.0 * bool(STAMP.search(name)) - 0.01 * place, name, guess))
    pair = _clock_of_two(columns)
    return pair or (max(found)[2] if found else None)


def steps_back(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> str | None:
    """Which column is called a clock and would be one, did it not step back, and where; None: none is."""
    for name, cells in columns.items():
        try:
            stamps = np.asarray(cells, dtype=float) if STAMP.search(name) else np.zeros(0)
        except (ValueError, TypeError):
            continue
        steps = np.diff(stamps)
        if stamps.ndim != 1 or stamps.size < 3 or not np.isfinite(stamps).all() or not 0.0 < np.mean(steps < 0.0) < 0.5:
            continue
        rows = np.flatnonzero(steps < 0.0) + 1
        listed = [f"from {stamps[row - 1]:.10g} to {stamps[row]:.10g} at sample {row + 1}" for row in rows[:MOST_SHOWN]]
        more = f" and {rows.size - MOST_SHOWN} times more" if rows.size > MOST_SHOWN else ""
        return f"{name!r} steps back {', '.join(listed)}{more}: the clock was set, or rows are not in order"
    return None


def _clock_of_two(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]]) -> Guess | None:
    """Whole seconds that stay for many samples, and nanoseconds beside them that begin anew with each."""
    whole = {name: stamps for name, cells in columns.items() if (stamps := _whole(cells)) is not None}
    for name, rest in whole.items():
        if not (NANOSECONDS.search(name) and rest.max() < 10**9):
            continue
        for other, seconds in whole.items():
            if other == name or np.any(np.diff(seconds) < 0) or seconds[-1] >= 5e9:
                continue
            steps = np.diff(seconds * 10**9 + rest)
            usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else np.inf
            if np.all(steps >= 0) and RATES[0] <= 1e9 / usual <= RATES[1]:
                said = f"whole seconds and nanoseconds; together they increase, at {1e9 / usual:.4g} Hz"
                repeats = int(np.sum(steps == 0))
                remarks = (f"{repeats} of {rest.size} stamps repeat the one before",) if repeats else ()
                return Guess([other, name], said, True, {"unit": "s"}, remarks)
    return None


def _whole(cells: Sequence[str] | NDArray[Any]) -> NDArray[np.int64] | None:
    """A column of whole numbers from 0 on; None: it is none."""
    try:
        numbers = np.asarray(cells, dtype=float)
    except (ValueError, TypeError):
        return None
    if numbers.ndim != 1 or numbers.size < 3 or not np.isfinite(numbers).all() or numbers.min() < 0.0:
        return None
    return numbers.astype(np.int64) if numbers.max() < 5e9 and not np.any(np.mod(numbers, 1.0)) else None


def _clock(name: str, cells: Sequence[str] | NDArray[Any]) -> Guess | None:
    if isinstance(cells, list) and cells and all(DATE.fullmatch(cell.strip()) for cell in cells):
        return Guess(name, "holds dates", further={"unit": "date"})
    try:
        stamps = np.asarray(cells, dtype=float)
    except (ValueError, TypeError):
        return None
    if stamps.ndim != 1 or stamps.size < 3 or not np.isfinite(stamps).all():
        return None
    steps = np.diff(stamps)
    if np.any(steps < 0.0):
        return None
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    if usual == 0.0 or float(np.mean(np.abs(steps[steps > 0.0] / usual - 1.0) < 0.9)) < 0.5:
        return None
    units = [unit for unit in STAMP_UNITS if _plausible(unit, stamps, usual)]
    named = [unit for unit in units if re.search(rf"(^|[^a-z]){unit}([^a-z]|$)", name, re.IGNORECASE)]
    if not units:
        return None
    unit = (named or units)[0]
    rate = 1.0 / (usual * UNITS["time"][unit])
    said = f"increases; in {unit} that is {rate:.4g} Hz"
    if stamps[0] * UNITS["time"][unit] > 1e8:
        said += f", from {_year(stamps[0] * UNITS['time'][unit])} on"
    repeats = int(np.sum(steps == 0.0))
    remarks = (f"{repeats} of {stamps.size} stamps repeat the one before",) if repeats else ()
    return Guess(name, said, bool(named or len(units) == 1), {"unit": unit}, remarks)


def other_units(clock: Guess, stamps: Array) -> list[str]:
    """Units that stamps may have as well as the one that was assumed; none where something shows it.

    Args:
        clock: What :func:`clock_of` found.
        stamps: Its column, ``(k,)``.
    """
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0]))
    others = [] if clock.sure else [unit for unit in STAMP_UNITS if unit != clock.further["unit"]]
    return [unit for unit in others if _plausible(unit, stamps, usual)]


def _plausible(unit: str, stamps: Array, step: float) -> bool:
    """Whether stamps in a unit give a sampling rate, and a year, that can be."""
    seconds = UNITS["time"][unit]
    start = float(seconds_of(stamps[:1], seconds)[0])
    return RATES[0] <= 1.0 / (step * seconds) <= RATES[1] and start < 5e9


def _year(seconds: float) -> str:
    return str(np.datetime64(int(seconds), "s").astype("datetime64[Y]"))


def at_rest(time: Array, position: Array, facts: RobotFacts) -> str | None:
    """That no joint moves, so that units, signs, inertia and friction cannot be seen; None: some joint does.

    Args:
        time: Stamps, ``(k,)`` [s].
        position: q, ``(k, n)`` [rad].
        facts: Know the ranges of the joints.
    """
    if time.size < 2 * MIN_AVERAGED:
        return None
    ranges = np.array(facts.limits.position_max_rad) - np.array(facts.limits.position_min_rad)
    moved = np.ptp(averaged(time, position)[1], axis=0)
    if np.any(moved > STILL * ranges):
        return None
    joint = int(np.argmax(moved / ranges))
    unit = facts.units[joint].position
    return (
        f"no motion, nothing to identify: joint {joint + 1} moves most, by {moved[joint]:.2g} {unit} in "
        f"{time[-1] - time[0]:.3g} s, expected at least {STILL * ranges[joint]:.2g} {unit}"
    )


def unit_of_position(raw: Array, facts: RobotFacts, name: str) -> Guess | None:
    """Unit in which positions ``(k, n)`` lie within the joints' limits; None: in none."""
    low, high = np.array(facts.limits.position_min_rad), np.array(facts.limits.position_max_rad)
    margin = MARGIN * (high - low)
    slides = [kind == "prismatic" for kind in facts.joint_types]
    tried: list[str] = []
    for turns, slide in (("rad", "m"), ("deg", "mm"), ("mrad", "mm")):
        units = [slide if sliding else turns for sliding in slides]
        factor = np.array([{**TURNS["position"], **SLIDES["position"]}[unit] for unit in units])
        inside = np.mean((raw * factor >= low - margin) & (raw * factor <= high + margin), axis=0)
        written = units[0] if len(set(units)) == 1 else units
        span = ", ".join(
            f"{one:.3g} ... {other:.3g}" for one, other in zip(raw.min(axis=0), raw.max(axis=0), strict=True)
        )
        if np.all(inside > 0.99):
            said = f"the joints reach {span}, which lies within their limits in {turns}"
            said += f" and not in {' or '.join(tried)}" if tried else ""
            return Guess(written, said, further={"factor_": factor})
        tried.append(turns)
    return None


@OUTLIERS
def times_derivative(time: Array, position: Array, raw: Array) -> float | None:
    """By how much a signal is larger than the derivative of positions ``(k, n)`` in all joints; None: it is another."""
    motion = AveragedMotion.of(time, position)
    relation, moving = motion.velocity_relation(time, raw), _travels(motion.position, MOST_OF_TRAVEL)
    ratio, usual = relation.factor[moving], float(np.median(relation.factor[moving]))
    alike = usual != 0.0 and bool(np.all(np.abs(ratio / usual - 1.0) < MAX_FACTOR_SPREAD))
    return usual if alike and np.all(np.abs(relation.correlation[moving]) > MIN_CORRELATION_AT_RATE) else None


@OUTLIERS
def are_derivatives(time: Array, values: Array, raw: Array) -> NDArray[np.bool_]:
    """Which columns of signals ``(k, c)`` are the derivatives of the columns beside them in ``values``, ``(c,)``."""
    found = AveragedMotion.of(time, values).velocity_relation(time, raw)
    one_unit = (found.factor > ONE_UNIT[0]) & (found.factor < ONE_UNIT[1])
    return np.asarray(one_unit & (found.correlation > MIN_CORRELATION_AT_RATE))


@OUTLIERS
def velocity_of(time: Array, position: Array, raw: Array, facts: RobotFacts) -> tuple[float, Guess] | None:
    """How surely a signal is the velocity of positions ``(k, n)`` [rad], and its unit and signs; None: it is not."""
    motion = AveragedMotion.of(time, position)
    moving = moves(motion.velocity, facts)
    if not np.any(moving):
        moving = _travels(motion.position, MOST_OF_TRAVEL)
    relation = motion.velocity_relation(time, raw)
    ratio, together = relation.factor, relation.correlation
    slides = [kind == "prismatic" for kind in facts.joint_types]
    sure = float(np.mean(np.abs(together[moving])))
    usual = float(np.median(np.abs(ratio[moving])))
    for turns, slide in (("rad/s", "m/s"), ("deg/s", "mm/s"), ("mrad/s", "mm/s")):
        per_unit = 1.0 / TURNS["velocity"][turns]
        if ONE_UNIT[0] < usual / per_unit < ONE_UNIT[1] and sure > MIN_CORRELATION:
            signs = np.where(moving & (np.abs(together) > MIN_CORRELATION), np.sign(ratio), _usual_sign(ratio[moving]))
            units = [slide if sliding else turns for sliding in slides]
            said = (
                f"{_range(ratio[moving] / per_unit)} times the derivative of the position in {turns} "
                f"(correlation {_range(together[moving])})"
            )
            further = {} if np.all(signs > 0.0) else {"factor": _signs(signs)}
            remarks = _against_each_other(moving, ratio, together)
            return sure, Guess(_common(units), said, True, further, remarks)
    return None


def _against_each_other(moving: NDArray[np.bool_], ratio: Array, together: Array) -> tuple[str, ...]:
    """Joints whose velocity has another sign than that of the others, or is not the derivative of their position."""
    related, turned = np.abs(together) >= MIN_CORRELATION, np.sign(ratio) != _usual_sign(ratio[moving])
    apart, other = np.flatnonzero(moving & ~related), np.flatnonzero(moving & related & turned)
    said = []
    if apart.size:
        said.append(f"velocities of joints {_joints(apart)} are not the derivative of their positions: other columns?")
    if other.size:
        said.append(
            f"velocities of joints {_joints(other)} have another sign than those of the others: their positions or "
            "their velocities are turned round, which nothing here shows; taken that velocities are"
        )
    return tuple(said)


def _joints(numbers: NDArray[np.signedinteger]) -> str:
    return ", ".join(str(number + 1) for number in numbers)


@OUTLIERS
def copy_of_motion(time: Array, position: Array, velocity: Array, raw: Array) -> str | None:
    """Which part of a motion ``(k, n)`` a signal repeats with one factor in all joints, as what was asked for does.

    A torque has another factor in every joint. Copies may lag and lie beside the motion by a constant.

    Returns:
        What it is, in words; None: it may be a torque.
    """
    at, q = averaged(time, position)
    dq, signal = averaged(time, velocity)[1], averaged(time, raw)[1]
    moving = _travels(q, SOME_TRAVEL)
    many = int(np.sum(moving)) >= FEWEST_COPIED
    together_least, (low, high) = (COPIED, ONE_UNIT) if many else (EXACTLY, EXACT_FACTOR)
    for what, part in (("positions", q), ("velocities", dq), ("accelerations", np.gradient(dq, at, axis=0))):
        copy = fit(part - part.mean(axis=0), signal - signal.mean(axis=0))
        for unit, factor in TURNS["position"].items():
            own = np.abs(copy.factor[moving]) * factor
            if np.all((own > low) & (own < high)) and np.all(np.abs(copy.correlation[moving]) > together_least):
                return f"repeats the {what}, in {unit}" if unit != "rad" else f"repeats the {what}"
    return None


@OUTLIERS
def torque_of(
    time: Array, position: Array, velocity: Array, raw: Array, model: RobotModel, name: str
) -> tuple[float, Guess] | None:
    """How surely a signal is the torque of a motion in SI units, with its unit and signs; None: it may not be."""
    at, q = averaged(time, position)
    dq, tau = averaged(time, velocity)[1], averaged(time, raw)[1]
    ddq = np.gradient(dq, at, axis=0)
    rows = np.unique(np.linspace(0, at.size - 1, LOOKED_AT).astype(int))
    needed = np.array([model.inverse_dynamics(q[row], dq[row], ddq[row]) for row in rows])
    tau = tau[rows]
    relation = fit(needed, tau)
    ratio, together = relation.factor, relation.correlation
    heavy = takes_torque(needed, model)
    shown = heavy & (np.abs(together) > MIN_CORRELATION)
    clear = bool(np.any(shown))
    shown = shown if clear else heavy & (np.abs(together) > MIN_CORRELATION_ASSUMED)
    slides = [kind == "prismatic" for kind in model.facts.joint_types]
    if not np.any(shown):
        return None
    sure = float(np.max(np.abs(together[shown])))
    usual = float(np.median(np.abs(ratio[shown])))
    said = (
        f"{_range(ratio[shown])} times the torque that weight and inertia of the arm take in joint"
        f"{'s' if np.sum(shown) > 1 else ''} {', '.join(str(joint + 1) for joint in np.flatnonzero(shown))}"
    )
    signs = np.where(shown, np.sign(ratio), _usual_sign(ratio[shown]))
    further: dict[str, Any] = {} if np.all(signs > 0.0) else {"factor": _signs(signs)}
    if not np.all(shown):
        said += "; the others show nothing and are taken like them"
    for turns, slide in (("N m", "N"), ("mN m", "mN")):
        if TORQUE_UNIT[0] < usual * TURNS["torque"][turns] < TORQUE_UNIT[1]:
            certain = clear and WRONG_FACTOR[0] < usual * TURNS["torque"][turns] < WRONG_FACTOR[1]
            said += "" if clear else f" (correlation {sure:.2g})"
            return sure, Guess(_common([slide if one else turns for one in slides]), said, certain, further)
    apart = float(np.max(np.abs(ratio[shown])) / np.min(np.abs(ratio[shown])))
    if apart > MOST_APART or len(set(np.sign(ratio[shown]))) > 1:
        return None
    constants = np.where(shown, 1.0 / np.maximum(np.abs(ratio), 1e-12), 1.0 / usual)
    said += ": no unit of torque; taken for motor currents, with the constants that the weight shows"
    written = [float(f"{constant:.3g}") for constant in constants]
    return sure, Guess("A", said, False, {**further, "torque_constant": written})


def takes_torque(needed: Array, model: RobotModel) -> NDArray[np.bool_]:
    """Which joints a motion drives noticeably, by the torque ``(k, n)`` [N m] that it takes; ``(n,)``."""
    size = Proportion.of_robots([model.facts], np.asarray(model.pinocchio.gravity.linear)).factor("N m")
    return np.asarray(np.sqrt(np.mean(np.square(needed), axis=0)) > NOTICED * size)


def pose_of(raw: Array) -> Guess | None:
    """Unit and order of poses ``(k, 7)``; None: they hold no unit quaternion."""
    place, quaternion = raw[:, :3], raw[:, 3:]
    order = quaternion_order(quaternion)
    if order is None:
        return None
    length = unit_of_length(place)
    further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
    return Guess(length.value, f"{length.evidence}; {order.evidence}", order.sure, further)


def unit_of_length(place: Array) -> Guess:
    """Unit of positions ``(k, 3)`` of an object near a robot."""
    largest = float(np.nanmax(np.abs(place)))
    unit = "mm" if largest > REACH else "m"
    return Guess(unit, f"up to {largest:.3g} from the origin, which is a place near a robot in {unit}")


def quaternion_order(quaternion: Array) -> Guess | None:
    """Order of unit quaternions ``(k, 4)``; None: they are none."""
    seen = quaternion[np.isfinite(quaternion).all(axis=1)]
    if not len(seen) or not np.all(np.abs(np.linalg.norm(seen, axis=1) - 1.0) < UNIT_LENGTH):
        return None
    middle = np.abs(np.median(seen, axis=0))
    if middle[0] > 0.9 or middle[3] > 0.9:
        order = "xyzw" if middle[3] > middle[0] else "wxyz"
        which = "last" if order == "xyzw" else "first"
        return Guess(order, f"the {which} number of the unit quaternion is near 1, as w of a body that hardly turns")
    return Guess("xyzw", "which number of the unit quaternion is w, nothing shows; taken as x y z w", False)


def _travels(position: Array, share: float) -> NDArray[np.bool_]:
    """Joints that travel at least a share of the farthest travel of all, ``(n,)``."""
    travel = np.ptp(position, axis=0)
    return np.asarray(travel >= share * float(np.max(travel)))


def _usual_sign(ratio: Array) -> float:
    """The sign of most; where as many contradict each other, a signal is taken as it is."""
    return -1.0 if np.sum(np.sign(ratio)) < 0.0 else 1.0


def _range(values: Array) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} ... {high:.3g}"


def _signs(signs: Array) -> Any:
    return float(signs[0]) if np.all(signs == signs[0]) else [float(sign) for sign in signs]


def _common(units: list[str]) -> Any:
    return units[0] if len(set(units)) == 1 else units
