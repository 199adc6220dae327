# SPDX-License-Identifier: Apache-2.0
"""Recordings of free motion that were not made here: bags (with or without ``metadata.yaml``), tables and arrays.

Unusable data is refused with one line that names file, topic, field and the expected value.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ArmPhysics, JointFriction, ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array, joined_units
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags.topics import TRIAL_INFO
from impact_rs_trials.recordings.checks.clock_offset import on_one_clock
from impact_rs_trials.recordings.checks.faults import MAX_OUTLIER_SHARE, beyond_data_sheet, without_faults
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.checks.lost_rows import without_lost_rows
from impact_rs_trials.recordings.checks.sampling_times import timestamp_warning
from impact_rs_trials.recordings.checks.torque_readings import check_includes_gravity, whole_torque
from impact_rs_trials.recordings.file_units import CURRENTS
from impact_rs_trials.recordings.mapping import JOINT_SIGNALS, REQUIRED, Mapping, SignalName
from impact_rs_trials.recordings.readers.bag_file import open_bag
from impact_rs_trials.recordings.readers.clock import check_stamps, gaps, gaps_in_words
from impact_rs_trials.recordings.readers.clock_steps import without_steps_back
from impact_rs_trials.recordings.readers.guesses import at_rest
from impact_rs_trials.recordings.readers.run_finder import BAG_SUFFIXES, FILE_SUFFIXES, find_recordings, find_runs
from impact_rs_trials.recordings.readers.series import MAX_BRIDGED_PERIODS, Series
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.relations import PLAUSIBLE_FACTORS, pooled
from impact_rs_trials.runs import ArmSignals, Run, Signals

logger = logging.getLogger(__name__)

ARM = "arm"  # name of the arm of a recording
MAX_GAP_LOW_PASS_PERIODS = 0.1  # of the low-pass; a longer gap cuts the recording
MIN_RECORDING_SAMPLES = 100
MAX_NAMED_RECORDINGS = 3  # in a message
MAX_SATURATED_SHARE = 0.5  # of the samples of a servo, beyond which its gain or target has another unit
SERVO_SIGNALS: tuple[SignalName, ...] = ("position", "velocity", "q_desired")
SAMPLED_SIGNALS: tuple[SignalName, ...] = ("position", "velocity", "torque", "motor_position", "motor_velocity")
MIN_TAIL_LOW_PASS_PERIODS = 4.2  # that a piece loses at its ends
MIN_KEPT_SAMPLES = 60  # between the ends
MAX_RATE_PER_LOW_PASS = 10.0  # of these samples, per period of the low-pass


class TooShort(InputError):
    """Recording too short after cleaning; skipped with the reason if others remain."""


def is_foreign(path: Path) -> bool:
    """Whether ``path`` is a recording, or a folder of them, and none is a trial of impact_rs (``/trial_info``)."""
    if path.is_file():
        recordings = [path] if suffix_of(path) in FILE_SUFFIXES else []
    else:
        try:
            recordings = find_recordings(path)
        except InputError as error:
            logger.debug("not taken for a recording: %s", error)
            return False
    return bool(recordings) and not any(_is_trial(item) for item in recordings)


def _is_trial(path: Path) -> bool:
    if path.is_file() and suffix_of(path) not in BAG_SUFFIXES:
        return False
    try:
        with open_bag(path) as reader:
            return any(connection.topic == TRIAL_INFO for connection in reader.connections)
    except Exception as error:  # a damaged file can fail anywhere inside the library; reading it gives the reason
        logger.debug("%s: cannot be opened (%s: %s)", path, type(error).__name__, error)
        return path.is_dir()


def read_recordings(path: Path, mapping: Mapping) -> list[Run]:
    """Every recording at ``path``, checked: a file, a run inside of it or in files of its name, or a folder.

    Raises:
        InputError: A recording cannot be used; the message has the expected value.
    """
    return [piece for item in find_runs(path, mapping) for piece in _pieces(item, mapping)]


def read_long_enough(path: Path, mapping: Mapping) -> tuple[list[Run], list[tuple[str, str]]]:
    """The recordings of :func:`read_recordings` that are long enough; path and reason of the others.

    Raises:
        InputError: A recording cannot be used, or none is long enough.
    """
    recordings = find_runs(path, mapping)
    runs: list[Run] = []
    left_out: list[tuple[str, str]] = []
    for item in recordings:
        try:
            runs += _pieces(item, mapping)
        except TooShort as error:
            if len(recordings) == 1:
                raise
            left_out.append((str(item), error.message))
    if not runs:
        text = "; ".join(f"{Path(name).name}: {why}" for name, why in left_out[:MAX_NAMED_RECORDINGS])
        raise TooShort(f"none of {len(left_out)} recordings is long enough: {text}", file=path)
    return runs, left_out


def _pieces(path: Path, mapping: Mapping) -> list[Run]:
    """One recording, checked, cut at gaps and faults of sensors."""
    needed = REQUIRED if mapping.servo is None else SERVO_SIGNALS
    recorded = read_series(path, mapping, JOINT_SIGNALS, needed)
    recorded |= {name: signal.filled().without_held() for name, signal in recorded.items() if name in SAMPLED_SIGNALS}
    recorded, steps_back_remarks = without_steps_back(recorded)
    measured = {name: signal for name, signal in recorded.items() if name != "velocity" or name in mapping.signals}
    recorded, lost_row_remarks = without_lost_rows(measured)
    if "velocity" not in mapping.signals:
        recorded["velocity"] = recorded["position"].derivative()
    gap_remarks = _checked_times(path, recorded, needed, mapping)
    model = mapping.robot_model()
    recorded = on_one_clock(path, recorded, mapping, model)
    series, remarks = without_faults(recorded, mapping, model)
    if mapping.servo is not None:
        series, saturation_remarks = with_servo_torque(path, series, mapping)
        remarks += saturation_remarks
    remarks = [
        *steps_back_remarks,
        *lost_row_remarks,
        *gap_remarks,
        *_unmeasured(path, series["torque"], mapping),
        *remarks,
    ]
    time = series["position"].time
    if (rest_reason := at_rest(time, series["position"].values, mapping.facts)) is not None:
        raise TooShort(rest_reason, file=path)
    remarks = list(dict.fromkeys([*(remark for signal in series.values() for remark in signal.remarks), *remarks]))
    pieces = []
    for first, last in _between_faults(series, mapping.low_pass):
        rows = (time >= first) & (time <= last)
        signals = {name: signal.at(time[rows]) for name, signal in series.items()}
        command_time = {"command_time": time[rows]} if "command" in signals else {}
        arm = ArmSignals(**signals, **command_time)
        check_arm(path, time[rows], arm, mapping)
        if mapping.torque_meaning != "whole":
            arm = replace(arm, torque=whole_torque(path, time[rows], arm, mapping.torque_meaning, model))
        elif mapping.servo is not None or mapping.signals["torque"].units[0] not in CURRENTS:
            check_includes_gravity(path, time[rows], arm, model)
        nominal_stamps = timestamp_warning(time[rows], arm.position)
        warnings = [
            *arm_warnings(time[rows], arm, mapping, model),
            *([] if nominal_stamps is None else [nominal_stamps]),
        ]
        remarks += [text for text in warnings if text not in remarks]
        pieces.append(
            Run(
                path=path,
                name=path.name,
                condition="free motion",
                condition_key=(path.name, "", ""),
                hit=False,
                physics=nominal_physics(mapping, arm.position, model),
                signals=Signals(time[rows], {ARM: arm}),
                begin=float(first - time[0]),
                remarks=tuple(remarks),
            )
        )
    if not pieces:
        raise TooShort(f"no piece is long enough: {'; '.join(remarks)}", file=path)
    return pieces


def _checked_times(
    path: Path, recorded: dict[SignalName, Series], needed: Collection[SignalName], mapping: Mapping
) -> list[str]:
    """Check times and numbers of the signals; returns a warning per gap, with all signals that have it."""
    clocks_by_text: dict[str, list[str]] = {}  # clocks by the text about their gaps
    for name, signal in recorded.items():
        if name not in mapping.signals:  # the velocity, which was computed from the position
            continue
        clock = signal.label if name == "position" or signal.log is not None else f"time of {signal.label}"
        for text in _check_time(path, signal.time, clock, mapping.low_pass):
            clocks_by_text.setdefault(text, []).append(clock)
        if name in needed:
            _check_numbers(path, name, signal.time, signal.values)
    return [f"{', '.join(clocks)}: {text}" for text, clocks in clocks_by_text.items()]


def with_servo_torque(
    path: Path, series: dict[SignalName, Series], mapping: Mapping
) -> tuple[dict[SignalName, Series], list[str]]:
    """Signals with the torque of the servos, and warnings about saturation.

    Args:
        path: Recording, for messages.
        series: Positions, velocities and desired positions.
        mapping: Has the gains.

    Raises:
        InputError: A servo is saturated most of the time.
    """
    law = mapping.servo_law
    assert law is not None
    position, desired_position = series["position"], series["q_desired"]
    time, q, dq = position.time, position.values, series["velocity"].at(position.time)
    target = desired_position.on(time)
    rate = series["dq_desired"].on(time) if "dq_desired" in series else np.gradient(target, time, axis=0)
    shares = np.mean(np.abs(law.unlimited(q, dq, target, rate)) > law.torque_max, axis=0)
    remarks = []
    for joint in np.flatnonzero(shares > 0.0):
        text = (
            f"the servo of joint {joint + 1} is at its largest torque in {100.0 * shares[joint]:.2g} % of the samples"
        )
        if shares[joint] > MAX_SATURATED_SHARE:
            raise InputError(
                f"{text} ({law.torque_max[joint]:.3g} {mapping.facts.units[joint].effort}): wrong unit of the gain or "
                "of q_desired?",
                file=path,
                key="servo.kp of the mapping",
            )
        remarks.append(f"{text}, and its torque is taken to be that limit (servo.torque_max of the mapping)")
    torque = Series(f"servo of {desired_position.label}", time, law.torque(q, dq, target, rate))
    resampled: dict[SignalName, Series] = {
        "q_desired": Series(desired_position.label, time, target),
        "dq_desired": Series(desired_position.label, time, rate),
    }
    return {**series, **resampled, "torque": torque}, remarks


def _unmeasured(path: Path, torque: Series, mapping: Mapping) -> list[str]:
    """Warnings about joints whose torque never changes; their torque balance is omitted."""
    constant = np.ptp(torque.values, axis=0) == 0.0
    if np.all(constant):
        raise InputError(
            f"{torque.label} (torque): the torque of no joint ever changes: nothing was measured", file=path
        )
    return [
        f"torque of joint {joint + 1} is {torque.values[0, joint]:.3g} {mapping.facts.units[joint].effort} in all "
        "samples: it was not measured, and its torque balance is left out"
        for joint in np.flatnonzero(constant)
    ]


def nominal_physics(mapping: Mapping, position: Array, model: RobotModel) -> Physics:
    """Nominal physics of a recorded arm: rigid, frictionless, with the mounted mass of the mapping.

    Args:
        mapping: Robot, base and mounted mass.
        position: Recorded q, ``(k, n)`` [rad].
        model: Its rigid-body model.
    """
    facts = mapping.facts
    count = facts.joint_count
    has_motor_inertia = mapping.torque_measured_at == "motor" and mapping.motor_inertia is not None
    inertia = np.array(mapping.motor_inertia) if has_motor_inertia else np.zeros(count)
    tip_positions = [model.placement(q).translation for q in position[:: max(1, len(position) // 50)]]
    arm = ArmPhysics(
        facts=facts,
        base=mapping.base,
        end_effector=mapping.end_effector.build(),
        motor_inertia_rotor=inertia,
        motor_inertia_reduced=inertia,
        stiffness=np.full(count, np.inf),
        damping=np.zeros(count),
        friction=JointFriction.none(facts.joint_types),
        torque_offset=np.zeros(count),
        torque_gain=np.ones(count),
        actuation_delay=0.0,
        pad_stiffness=None,
        pad_damping=0.0,
        impact_position=np.mean(tip_positions, axis=0),
        assumed=facts.assumed,
    )
    nothing = ObjectPhysics(1.0, np.ones(3), np.ones(3), np.zeros(3))
    return Physics({ARM: arm}, nothing, None, (1.0, 1.0), 0.0, 0.0, 0.0)


def _between_faults(series: dict[SignalName, Series], low_pass: float) -> list[tuple[float, float]]:
    """Stretches with all joint signals measured, long enough for the low-pass [s]."""
    needed = [series[name].time for name in REQUIRED]
    if min(stamps.size for stamps in needed) < MIN_RECORDING_SAMPLES:
        return []
    time = series["position"].time
    period = float(np.median(np.diff(time)))
    start, end = max(float(stamps[0]) for stamps in needed), min(float(stamps[-1]) for stamps in needed)
    cuts = [gap for stamps in needed for gap in gaps(stamps, _longest_gap(period, low_pass))]
    if not cuts and start <= time[0] + MAX_BRIDGED_PERIODS * period and end >= time[-1] - MAX_BRIDGED_PERIODS * period:
        return [(float(time[0]), float(time[-1]))]
    firsts = [start, *sorted(gap.end for gap in cuts)]
    lasts = [*sorted(gap.start for gap in cuts), end]
    min_length = MIN_TAIL_LOW_PASS_PERIODS / low_pass + MIN_KEPT_SAMPLES * max(
        period, 1.0 / (MAX_RATE_PER_LOW_PASS * low_pass)
    )
    return [(a, b) for a, b in zip(firsts, lasts, strict=True) if b - a >= min_length]


def _longest_gap(period: float, low_pass: float) -> float:
    """Longest gap that the low-pass bridges [s]."""
    return max(MAX_BRIDGED_PERIODS * period, MAX_GAP_LOW_PASS_PERIODS / low_pass)


def _check_time(path: Path, time: Array, label: str, low_pass: float) -> list[str]:
    """Check that timestamps increase; returns a warning about gaps, which cut the recording."""
    if time.size < MIN_RECORDING_SAMPLES:
        raise TooShort(f"{label}: {time.size} samples, at least {MIN_RECORDING_SAMPLES} are needed", file=path)
    check_stamps(path, label, time)
    period = float(np.median(np.diff(time)))
    long_gaps = gaps(time, _longest_gap(period, low_pass))
    if not long_gaps:
        return []
    text = gaps_in_words(long_gaps, time[0])
    return [f"gap of {text} (period {period:.4f} s, low-pass {low_pass:g} Hz); the pieces between are used"]


def check_arm(path: Path, time: Array, arm: ArmSignals, mapping: Mapping, briefly: float = 0.0) -> None:
    """Check that signals are finite, within the robot's limits, and in the unit of the mapping.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        arm: Recorded signals.
        mapping: Knows robot and units.
        briefly: Share of the samples in which a velocity or torque may be beyond its limit, as in an impact [-].

    Raises:
        InputError: A signal is not; the message names signal, joint, time, value and expected range.
    """
    for name in REQUIRED:
        _check_numbers(path, name, time, getattr(arm, name))
    for name in REQUIRED:
        check_limits(path, name, time, getattr(arm, name), mapping, briefly)
    if "velocity" in mapping.signals:
        check_velocity(path, time, arm.position, arm.velocity, mapping)


def _check_numbers(path: Path, name: SignalName, time: Array, values: Array) -> None:
    """Finite numbers."""
    if not np.isfinite(values).all():
        row, joint = np.argwhere(~np.isfinite(values))[0]
        start = time[row] - time[0]
        raise InputError(f"{name} of joint {joint + 1} is not a number at t = {start:.3f} s", file=path)


def check_limits(
    path: Path, name: SignalName, time: Array, values: Array, mapping: Mapping, briefly: float = 0.0
) -> None:
    """Check that position, velocity or torque are within the limits of the robot.

    Args:
        path: Recording, for messages.
        name: Which of the three.
        time: Stamps, ``(k,)`` [s].
        values: SI, ``(k, n)``.
        mapping: Knows robot and units.
        briefly: Share of the samples of a joint that may be beyond the limit, as in an impact or where outliers are
            left out later [-].

    Raises:
        InputError: The signal is not; the message names signal, joint, time, value and expected range.
    """
    limits = mapping.facts.limits
    if name == "position":
        ends = zip(limits.position_min_rad, limits.position_max_rad, strict=True)
        expected, quantity = [f"{lowest:.3g} ... {highest:.3g}" for lowest, highest in ends], "position"
    else:
        highest, quantity = (limits.velocity_rad_s, "velocity") if name == "velocity" else (limits.torque_Nm, "effort")
        expected = [f"at most {limit:.3g}" for limit in highest]
    beyond_limit = beyond_data_sheet(name, values, mapping.facts)
    beyond_limit &= beyond_limit.mean(axis=0) > briefly
    if not np.any(beyond_limit):
        return
    row, joint = np.argwhere(beyond_limit)[0]
    value, unit = values[row, joint], getattr(mapping.facts.units[joint], quantity)
    stated = name if name in mapping.signals else "position"  # whose derivative it is
    raise InputError(
        f"{name} of joint {joint + 1} is {value:.4g} {unit} at t = {time[row] - time[0]:.3f} s, "
        f"expected {expected[joint]} {unit} for {mapping.robot}: wrong unit (now {mapping.unit(stated, joint)}) or "
        "joints?",
        file=path,
    )


def check_velocity(path: Path, time: Array, position: Array, velocity: Array, mapping: Mapping) -> None:
    """Check that velocities are the derivative of positions.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        position: SI, ``(k, n)``.
        velocity: SI, ``(k, n)``.
        mapping: Knows the units.

    Raises:
        InputError: Velocities differ from the derivative by a factor of two or more.
    """
    derived = np.gradient(position, time, axis=0)
    outliers = np.any([beyond_data_sheet("velocity", rates, mapping.facts) for rates in (derived, velocity)], axis=0)
    outliers &= outliers.mean(axis=0) <= MAX_OUTLIER_SHARE  # single samples are no evidence of a unit
    derived, velocity = np.where(outliers, 0.0, derived), np.where(outliers, 0.0, velocity)
    if not np.any(derived):
        return
    ratio = float(pooled(derived, velocity).factor[0])
    if not PLAUSIBLE_FACTORS[0] < ratio < PLAUSIBLE_FACTORS[1]:
        raise InputError(
            f"velocity is {ratio:.3g} times the derivative of position, expected 1: wrong unit (now "
            f"{joined_units(mapping.signals['velocity'].units)}), wrong sign or other joints",
            file=path,
        )
