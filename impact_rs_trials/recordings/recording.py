"""Recordings that were not made here: bags (SQLite or MCAP, with or without ``metadata.yaml``), CSV and NPZ files.

What cannot be used is refused with one line that names file, topic, field and what was expected.
"""

from __future__ import annotations

import csv
import logging
from collections.abc import Mapping as AbstractMapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.mapping import REQUIRED, UNITS, Mapping, SignalName, SignalSource

logger = logging.getLogger(__name__)

BAG_SUFFIXES = (".db3", ".mcap")
FILE_SUFFIXES = (*BAG_SUFFIXES, ".csv", ".npz")
LARGEST_GAP = 5.0  # sampling periods
LEAST_SAMPLES = 100
MARGIN = 0.1  # rad, how far a measured position may lie outside the data sheet's limits


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
    if path.suffix in (".csv", ".npz"):
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
    """One recording, checked."""
    if path.is_file() and path.stat().st_size == 0:
        raise InputError("this file is empty", file=path)
    readers = {".csv": _read_csv, ".npz": _read_npz}
    time, signals = readers.get(path.suffix, _read_bag)(path, mapping)
    recording = Recording(
        path,
        time,
        signals["position"],
        signals["velocity"],
        signals["torque"],
        {name: values for name, values in signals.items() if name not in REQUIRED},
    )
    _check(recording, mapping)
    return recording


Columns = tuple[Array, dict[str, Array]]


def _typestore(mapping: Mapping) -> Typestore:
    """Standard messages and the definitions that the mapping asks for."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for package in mapping.definitions:
        folder = config_directory() / "mappings" / "messages" / package
        if not folder.is_dir():
            raise InputError(f"definitions names {package!r}, but there is no folder {folder}")
        types: dict[str, Any] = {}
        for file in sorted(folder.glob("*.msg")):
            types |= get_types_from_msg(file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}")
        store.register(types)
    return store


def _register(store: Typestore, connection: Connection) -> None:
    """Prefer the definition that the bag carries itself."""
    kind, definition = connection.msgtype, connection.msgdef
    if connection.msgdef.format == MessageDefinitionFormat.NONE or kind.startswith(("sensor_msgs/", "std_msgs/")):
        return
    parse = {
        MessageDefinitionFormat.MSG: lambda: get_types_from_msg(definition.data, kind),
        MessageDefinitionFormat.IDL: lambda: get_types_from_idl(definition.data),
    }
    types = parse[definition.format]()
    package = kind.split("/")[0]
    own = {name: value for name, value in types.items() if name.split("/")[0] == package}
    for name in own:
        for table in (store.fielddefs, store.types):
            table.pop(name, None)
    store.register(own)


def _read_bag(path: Path, mapping: Mapping) -> Columns:
    store = _typestore(mapping)
    try:
        with Reader(path) as reader:
            connections = list(reader.connections)
            wanted = {name: _connection(path, connections, name, source) for name, source in mapping.signals.items()}
            chosen = {connection.topic: connection for connection in wanted.values() if connection is not None}
            for used in chosen.values():
                _register(store, used)
            messages: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in chosen}
            for source, stamp, data in reader.messages(connections=list(chosen.values())):
                message = store.deserialize_cdr(data, source.msgtype)
                messages[source.topic].append((_stamp(message, stamp, mapping), message))
    except InputError:
        raise
    except Exception as error:  # a damaged file can fail anywhere inside the library
        text = str(error).splitlines()[0] if str(error) else ""
        raise InputError(f"not a readable bag ({type(error).__name__}: {text})", file=path) from None
    base_topic = next(c.topic for name, c in wanted.items() if c is not None and name == "position")
    time = np.array([stamp for stamp, _ in messages[base_topic]])
    _check_time(path, time, base_topic)
    signals: dict[str, Array] = {}
    for name, connection in wanted.items():
        if connection is None:
            continue
        rows = messages[connection.topic]
        values = _extract(path, connection, name, mapping, [message for _, message in rows])
        if values is None:
            continue
        if connection.topic != base_topic:
            own = np.array([stamp for stamp, _ in rows])
            _check_time(path, own, connection.topic)
            values = np.column_stack([np.interp(time, own, column) for column in values.T])
        signals[name] = values * mapping.factor(name)
    return time, signals


def _connection(path: Path, connections: list[Connection], name: SignalName, source: SignalSource) -> Connection | None:
    """The topic of a signal; None for an optional signal that is not there."""
    if source.topic is None or source.field is None:
        if name in REQUIRED:
            raise InputError(f"the mapping says no topic and field for {name}", file=path)
        return None
    named = [c for c in connections if fnmatchcase(c.topic, source.topic)]
    found = [c for c in named if source.type is None or c.msgtype == source.type]
    if len(found) == 1 and found[0].msgcount > 0:
        return found[0]
    if name not in REQUIRED:
        return None
    expected = f"{name}: expected topic {source.topic} of type {source.type}"
    if not connections:
        raise InputError(f"{expected}, the bag is empty", file=path)
    if found and len(found) == 1:
        raise InputError(f"{expected}, topic {found[0].topic} holds no message", file=path)
    if found:
        topics = ", ".join(c.topic for c in found)
        raise InputError(f"{expected}, found several: {topics}; name one of them in a mapping file", file=path)
    shown = ", ".join(f"{c.topic} ({c.msgtype})" for c in (named or connections)[:5])
    raise InputError(f"{expected}, found {shown}", file=path)


def _stamp(message: Any, log: int, mapping: Mapping) -> float:
    if mapping.time.stamp == "log":
        return 1e-9 * log
    try:
        stamp = message.header.stamp
    except AttributeError:
        raise InputError("messages have no header: set time.stamp to log in the mapping") from None
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _extract(
    path: Path, connection: Connection, name: SignalName, mapping: Mapping, messages: list[Any]
) -> Array | None:
    """One signal of one topic, ``(k, n)``, joints in the mapping's order; None where an optional field is empty."""
    source = mapping.signals[name]
    assert source.field is not None
    place = f"{connection.topic}: {source.field}"
    try:
        rows = list(map(attrgetter(source.field), messages))
        names = None if source.names is None else list(attrgetter(source.names)(messages[0]))
        renamed = source.names is not None and any(list(attrgetter(source.names)(m)) != names for m in messages)
    except AttributeError as error:
        raise InputError(f"{place} ({name}): {connection.msgtype} has no such field ({error})", file=path) from None
    if renamed:
        raise InputError(f"{place}: the joint names change from message to message", file=path)
    sizes = {np.size(row) for row in rows}
    if sizes == {0}:
        if name in REQUIRED:
            raise InputError(f"{place} ({name}) is empty; expected {len(mapping.joints)} numbers", file=path)
        return None
    if len(sizes) > 1:
        raise InputError(f"{place} ({name}) changes its length: {sorted(sizes)}", file=path)
    values = np.asarray(rows, dtype=float)
    if names:
        if len(names) != values.shape[1]:
            raise InputError(f"{place} ({name}) has {values.shape[1]} numbers for {len(names)} joint names", file=path)
        return values[:, _order(path, place, names, mapping.joints)]
    if values.shape[1] != len(mapping.joints):
        raise InputError(f"{place} ({name}) has {values.shape[1]} numbers, expected {len(mapping.joints)}", file=path)
    return values


def _order(path: Path, place: str, names: list[str], joints: tuple[str, ...]) -> list[int]:
    order = []
    for joint in joints:
        found = [index for index, name in enumerate(names) if fnmatchcase(name, joint)]
        if len(found) != 1:
            what = "is missing" if not found else "fits several joints"
            raise InputError(f"{place}: joint {joint} {what}; the message names {', '.join(names)}", file=path)
        order += found
    return order


def _read_csv(path: Path, mapping: Mapping) -> Columns:
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    if len(rows) < 2:
        raise InputError("expected a line of column names and lines of numbers", file=path)
    header = [name.strip() for name in rows[0]]
    try:
        table = np.array([[float(cell or "nan") for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise InputError(f"not a table of numbers: {error}", file=path) from None
    if table.ndim != 2 or table.shape[1] != len(header):
        raise InputError(f"the lines do not all have {len(header)} numbers", file=path)
    columns = dict(zip(header, table.T, strict=True))

    def column(name: str) -> Array:
        if name not in columns:
            near = did_you_mean(name, columns)
            raise InputError(f"no column {name!r}{near}; found: {', '.join(header[:8])} ...", file=path)
        return columns[name]

    time = column(mapping.time.column) * UNITS["time"][mapping.time.unit]
    signals: dict[str, Array] = {}
    for name, source in mapping.signals.items():
        if source.column is None:
            continue
        names = [source.column.format(joint=index + 1) for index in range(len(mapping.joints))]
        if name not in REQUIRED and not all(item in columns for item in names):
            continue
        signals[name] = np.column_stack([column(item) for item in names]) * mapping.factor(name)
    return _complete(path, time, signals, "column")


def _read_npz(path: Path, mapping: Mapping) -> Columns:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays: AbstractMapping[str, Array] = {name: np.asarray(archive[name], float) for name in archive.files}
    except Exception as error:  # a damaged archive fails in zipfile, in zlib or in NumPy
        raise InputError(f"not a readable NPZ file ({error})", file=path) from None

    def array(name: str) -> Array:
        if name not in arrays:
            raise InputError(f"no array {name!r}{did_you_mean(name, arrays)}; found: {', '.join(arrays)}", file=path)
        return arrays[name]

    time = array(mapping.time.array) * UNITS["time"][mapping.time.unit]
    signals: dict[str, Array] = {}
    for name, source in mapping.signals.items():
        if source.array is None or (name not in REQUIRED and source.array not in arrays):
            continue
        values = array(source.array)
        if values.shape != (time.size, len(mapping.joints)):
            expected = f"{time.size} samples x {len(mapping.joints)} joints"
            raise InputError(f"array {source.array!r} ({name}) is {values.shape}, expected {expected}", file=path)
        signals[name] = values * mapping.factor(name)
    return _complete(path, time, signals, "array")


def _complete(path: Path, time: Array, signals: dict[str, Array], what: str) -> Columns:
    for name in REQUIRED:
        if name not in signals:
            raise InputError(f"the mapping says no {what} for {name}", file=path)
    _check_time(path, time, what=f"time {what}")
    return time, signals


def _check_time(path: Path, time: Array, what: str) -> None:
    if time.size < LEAST_SAMPLES:
        raise InputError(f"{what}: {time.size} samples, at least {LEAST_SAMPLES} are needed", file=path)
    if not np.isfinite(time).all():
        raise InputError(f"{what}: sample {int(np.argmin(np.isfinite(time)))} has no finite time", file=path)
    steps = np.diff(time)
    if np.any(steps <= 0.0):
        index = int(np.argmax(steps <= 0.0))
        how = "stand still" if steps[index] == 0.0 else "run backwards"
        raise InputError(f"{what}: time stamps {how} at t = {time[index] - time[0]:.3f} s", file=path)
    period = float(np.median(steps))
    if steps.max() > LARGEST_GAP * period:
        index = int(np.argmax(steps))
        raise InputError(
            f"{what}: gap of {steps[index]:.3f} s at t = {time[index] - time[0]:.3f} s (period {period:.4f} s); cut "
            "the recording there",
            file=path,
        )


def _check(recording: Recording, mapping: Mapping) -> None:
    """Finite, within the robot's limits, and in the unit that the mapping says."""
    start = recording.time - recording.time[0]
    for name in REQUIRED:
        values = getattr(recording, name)
        if not np.isfinite(values).all():
            row, joint = np.argwhere(~np.isfinite(values))[0]
            raise InputError(
                f"{name} of joint {joint + 1} is not a number at t = {start[row]:.3f} s", file=recording.path
            )
    limits = mapping.facts.limits
    low, high = np.array(limits.position_min_rad) - MARGIN, np.array(limits.position_max_rad) + MARGIN
    _refuse(
        recording, "position", (recording.position < low) | (recording.position > high), "rad",
        lambda j: f"{low[j] + MARGIN:.3g} ... {high[j] - MARGIN:.3g} rad", mapping,
    )  # fmt: skip
    fastest = 1.2 * np.array(limits.velocity_rad_s)
    _refuse(
        recording, "velocity", np.abs(recording.velocity) > fastest, "rad/s",
        lambda j: f"at most {fastest[j] / 1.2:.3g} rad/s", mapping,
    )  # fmt: skip
    strongest = 1.2 * np.array(limits.torque_Nm)
    _refuse(
        recording, "torque", np.abs(recording.torque) > strongest, "N m",
        lambda j: f"at most {strongest[j] / 1.2:.3g} N m", mapping,
    )  # fmt: skip
    derived = np.gradient(recording.position, recording.time, axis=0)
    power = float(np.sum(np.square(derived)))
    if power > 0.0:
        ratio = float(np.sum(derived * recording.velocity)) / power
        if not 0.5 < ratio < 2.0:
            raise InputError(
                f"velocity is {ratio:.3g} times the derivative of position, expected 1: wrong unit (now "
                f"{mapping.signals['velocity'].unit}), wrong sign or other joints",
                file=recording.path,
            )


def _refuse(
    recording: Recording, name: SignalName, wrong: NDArray[np.bool_], unit: str, expected: Any, mapping: Mapping
) -> None:
    if not np.any(wrong):
        return
    row, joint = np.argwhere(wrong)[0]
    value = getattr(recording, name)[row, joint]
    raise InputError(
        f"{name} of joint {joint + 1} is {value:.4g} {unit} at t = {recording.time[row] - recording.time[0]:.3f} s, "
        f"expected {expected(joint)} for {mapping.robot}: wrong unit (now {mapping.signals[name].unit}) or joints?",
        file=recording.path,
    )
