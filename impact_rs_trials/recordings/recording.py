# SPDX-License-Identifier: Apache-2.0
"""Recordings of free motion that were not made here: bags (with or without ``metadata.yaml``), tables and arrays.

What cannot be used is refused with one line that names file, topic, field and what was expected.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array, told_units
from impact_rs_trials.recordings.clock import check_stamps, gaps, tell_gaps
from impact_rs_trials.recordings.mapping import JOINT_SIGNALS, REQUIRED, Mapping, SignalName
from impact_rs_trials.recordings.sources import BAG_SUFFIXES, FILE_SUFFIXES, read_series

logger = logging.getLogger(__name__)

LARGEST_GAP = 5.0  # sampling periods, or
GAP_IN_LOW_PASS = 0.1  # periods of the low-pass, which is what a gap falls into
LEAST_SAMPLES = 100
MARGIN = 0.1  # rad or m, how far a measured position may lie outside the data sheet's limits
EXCESS = 1.2  # times those of the data sheet, which a measured velocity or torque may be


@dataclass(frozen=True)
class Recording:
    """Signals of one recording in SI units; arrays are ``(k, n)``, empty where a signal is not measured.

    Attributes:
        path: File or folder it was read from.
        time: Stamps, strictly increasing, ``(k,)`` [s].
        position: q [rad].
        velocity: dq [rad/s].
        torque: tau [N m], measured where the mapping says.
        others: What else was found: motor_position [rad], motor_velocity [rad/s], command [N m], torque_rate [N m/s].
    """

    path: Path
    time: Array
    position: Array
    velocity: Array
    torque: Array
    others: dict[str, Array]


def find_recordings(path: Path) -> list[Path]:
    """The recording at ``path``, or all recordings below a folder.

    Raises:
        InputError: There is nothing here that can be read.
    """
    if path.is_file():
        if path.suffix not in FILE_SUFFIXES:
            raise InputError(f"expected a recording ({', '.join(FILE_SUFFIXES)}), or a folder of them", file=path)
        return [path]
    if not path.is_dir():
        raise InputError("no such file or folder", file=path)
    if (path / "metadata.yaml").is_file():
        return [path]
    bags = {file.parent for file in path.rglob("metadata.yaml")}
    files = {file for suffix in FILE_SUFFIXES for file in path.rglob(f"*{suffix}") if file.parent not in bags}
    if not bags | files:
        raise InputError(f"no recording here; expected {', '.join(FILE_SUFFIXES)} or the folder of a bag", file=path)
    return sorted(bags | files)


def is_foreign(path: Path) -> bool:
    """Whether ``path`` is a recording, or a folder of recordings, without a trial of ours (no ``/trial_info``)."""
    if path.is_file():
        found = [path] if path.suffix in FILE_SUFFIXES else []
    else:
        try:
            found = find_recordings(path)
        except InputError as error:
            logger.debug("not taken for a recording: %s", error)
            return False
    return bool(found) and not any(_is_trial(item) for item in found)


def _is_trial(path: Path) -> bool:
    if path.is_file() and path.suffix not in BAG_SUFFIXES:
        return False
    try:
        with Reader(path) as reader:
            return any(connection.topic == "/trial_info" for connection in reader.connections)
    except Exception as error:  # a damaged file can fail anywhere inside the library; whoever reads it says why
        logger.debug("%s: cannot be opened (%s: %s)", path, type(error).__name__, error)
        return path.is_dir()


def read_recordings(path: Path, mapping: Mapping) -> list[Recording]:
    """Every recording at ``path``, checked.

    Raises:
        InputError: A recording cannot be used; the message says what was expected.
    """
    return [read_recording(item, mapping) for item in find_recordings(path)]


def read_recording(path: Path, mapping: Mapping) -> Recording:
    """One recording, checked.

    Raises:
        InputError: It cannot be used; the message says what was expected.
    """
    series = read_series(path, mapping, JOINT_SIGNALS, REQUIRED)
    for name, one in series.items():
        what = one.place if name == "position" or one.log is not None else f"time of {one.place}"
        _check_time(path, one.time, what, mapping.low_pass)
    time = series["position"].time
    signals = {name: one.at(time) for name, one in series.items()}
    recording = Recording(
        path,
        time,
        signals["position"],
        signals["velocity"],
        signals["torque"],
        {name: values for name, values in signals.items() if name not in REQUIRED},
    )
    check_recording(recording, mapping)
    return recording


def _check_time(path: Path, time: Array, what: str, low_pass: float) -> None:
    if time.size < LEAST_SAMPLES:
        raise InputError(f"{what}: {time.size} samples, at least {LEAST_SAMPLES} are needed", file=path)
    check_stamps(path, what, time)
    period = float(np.median(np.diff(time)))
    found = gaps(time, max(LARGEST_GAP * period, GAP_IN_LOW_PASS / low_pass))
    if found:
        raise InputError(
            f"{what}: gap of {tell_gaps(found, time[0])} (period {period:.4f} s, low-pass {low_pass:g} Hz); cut the "
            "recording there",
            file=path,
        )


def check_recording(recording: Recording, mapping: Mapping, briefly: float = 0.0) -> None:
    """Finite, within the robot's limits, and in the unit that the mapping says.

    Args:
        recording: What was recorded.
        mapping: Knows robot and units.
        briefly: Share of the samples in which a velocity or torque may be beyond its limit, as in an impact [-].

    Raises:
        InputError: It is not; the message names signal, joint, time, value and what was expected.
    """
    start = recording.time - recording.time[0]
    for name in REQUIRED:
        values = getattr(recording, name)
        if not np.isfinite(values).all():
            row, joint = np.argwhere(~np.isfinite(values))[0]
            raise InputError(
                f"{name} of joint {joint + 1} is not a number at t = {start[row]:.3f} s", file=recording.path
            )
    for name in REQUIRED:
        check_limits(recording.path, name, recording.time, getattr(recording, name), mapping, briefly)
    check_velocity(recording.path, recording.time, recording.position, recording.velocity, mapping)


def check_limits(
    path: Path, name: SignalName, time: Array, values: Array, mapping: Mapping, briefly: float = 0.0
) -> None:
    """Position, velocity or torque within what the robot can do.

    Args:
        path: Recording, for messages.
        name: Which of the three.
        time: Stamps, ``(k,)`` [s].
        values: SI, ``(k, n)``.
        mapping: Knows robot and units.
        briefly: Share of the samples in which a velocity or torque may be beyond its limit, as in an impact [-].

    Raises:
        InputError: It is not; the message names signal, joint, time, value and what was expected.
    """
    limits = mapping.facts.limits
    if name == "position":
        low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
        wrong, quantity = (values < low - MARGIN) | (values > high + MARGIN), "position"
        expected = [f"{least:.3g} ... {most:.3g}" for least, most in zip(low, high, strict=True)]
    else:
        most, quantity = (limits.velocity_rad_s, "velocity") if name == "velocity" else (limits.torque_Nm, "effort")
        wrong = np.abs(values) > EXCESS * np.array(most)
        wrong &= wrong.mean(axis=0) > briefly
        expected = [f"at most {limit:.3g}" for limit in most]
    if not np.any(wrong):
        return
    row, joint = np.argwhere(wrong)[0]
    value, unit = values[row, joint], getattr(mapping.facts.units[joint], quantity)
    raise InputError(
        f"{name} of joint {joint + 1} is {value:.4g} {unit} at t = {time[row] - time[0]:.3f} s, "
        f"expected {expected[joint]} {unit} for {mapping.robot}: wrong unit (now {mapping.unit(name, joint)}) or "
        "joints?",
        file=path,
    )


def check_velocity(path: Path, time: Array, position: Array, velocity: Array, mapping: Mapping) -> None:
    """Velocities are the derivative of positions.

    Args:
        path: Recording, for messages.
        time: Stamps, ``(k,)`` [s].
        position: SI, ``(k, n)``.
        velocity: SI, ``(k, n)``.
        mapping: Knows the units.

    Raises:
        InputError: They are not, by a factor of two and more.
    """
    derived = np.gradient(position, time, axis=0)
    power = float(np.sum(np.square(derived)))
    if power == 0.0:
        return
    ratio = float(np.sum(derived * velocity)) / power
    if not 0.5 < ratio < 2.0:
        raise InputError(
            f"velocity is {ratio:.3g} times the derivative of position, expected 1: wrong unit (now "
            f"{told_units(mapping.signals['velocity'].units)}), wrong sign or other joints",
            file=path,
        )
