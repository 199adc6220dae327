# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2 (SQLite or MCAP) and of ROS 1, and MCAP files without ROS (:mod:`mcap_messages`).

A signal has a topic, a message type and a field. A topic may have several publishers, each with a connection of its own
in bags of ROS 1 and in MCAP files without ROS.

A run has one clock. If header timestamps define it, times of a topic without headers are computed from log times:

    stamp  =  log - median(log - stamp of the joint states)

The common transport delay cancels; the excess over the delay of the joint states remains as an error. If the joint
states lie in another file, no delay is subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags.cdr import stacked
from impact_rs_trials.recordings.mapping import WIDTHS, Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.readers.mcap_messages import McapMessages, is_without_ros
from impact_rs_trials.recordings.readers.read_once import once
from impact_rs_trials.recordings.readers.run_finder import ROS1_SUFFIX
from impact_rs_trials.recordings.readers.series import MissingSignal, Names, Series
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.remarks import remark

MAX_STAMP_DRIFT_S = 0.002  # between log and header timestamps without a warning
EXPECTED_LOG_DELAY_S = (-0.005, 0.05)  # behind the joint states; outside of this range comes a warning

FIELDLESS: tuple[SignalName, ...] = ("object_pose", "wrench", "acceleration")  # the message type determines the field

MESSAGE_SUFFIXES = (".db3", ".mcap", ".zstd")  # endings of files of messages

OTHER_PROFILE = "Profile is not ros2"  # message of rosbags about a file in a folder
POSE_PARTS = (("position", "orientation"), ("translation", "rotation"))


BagReader = Reader | Ros1Reader | McapMessages


def open_bag(path: Path) -> BagReader:
    """Reader of a ROS 2 bag, a ROS 1 bag (``.bag``) or an MCAP file without ROS."""
    if suffix_of(path) == ROS1_SUFFIX:
        return Ros1Reader(path)
    return McapMessages(path) if is_without_ros(path) else Reader(path)


def unreadable(path: Path, error: Exception) -> InputError:
    """Error of a bag that could not be read, with a remedy for MCAP files without ROS messages.

    Args:
        path: The bag.
        error: Exception of its reader.
    """
    text = str(error).splitlines()[0] if str(error) else ""
    if OTHER_PROFILE in text:
        return InputError(
            "a bag's folder whose MCAP file is not of ROS 2 (JSON or Protobuf, as Foxglove writes them); "
            "give the .mcap file itself",
            file=path,
        )
    return InputError(f"not a readable bag ({type(error).__name__}: {text})", file=path)


def deserialized(store: Typestore, path: Path, data: Any, kind: str) -> Any:
    """A message of a bag from its bytes; a message that the reader has decoded is returned unchanged."""
    if not isinstance(data, bytes):
        return data
    return store.deserialize_ros1(data, kind) if suffix_of(path) == ROS1_SUFFIX else store.deserialize_cdr(data, kind)


def typestore_for(path: Path, definitions: Sequence[str] = ()) -> Typestore:
    """Standard message types of the ROS version of a bag, and packages of definitions that a mapping names.

    Raises:
        InputError: There is no such package of definitions.
    """
    store = get_typestore(Stores.ROS1_NOETIC if suffix_of(path) == ROS1_SUFFIX else Stores.ROS2_JAZZY)
    for package in definitions:
        folder = config_directory() / "mappings" / "messages" / package
        if not folder.is_dir():
            raise InputError(f"definitions names {package!r}, but there is no folder {folder}")
        types: dict[str, Any] = {}
        for file in sorted(folder.glob("*.msg")):
            types |= get_types_from_msg(file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}")
        store.register(types)
    return store


def register(store: Typestore, connection: Connection) -> None:
    """Register the message definition of the bag in place of the standard one."""
    kind, definition = connection.msgtype, connection.msgdef
    if connection.msgdef.format == MessageDefinitionFormat.NONE or kind.startswith(("sensor_msgs/", "std_msgs/")):
        return
    parse = {
        MessageDefinitionFormat.MSG: lambda: get_types_from_msg(definition.data, kind),
        MessageDefinitionFormat.IDL: lambda: get_types_from_idl(definition.data),
    }
    types = parse[definition.format]()
    package = kind.split("/")[0]
    package_types = {name: value for name, value in types.items() if name.split("/")[0] == package}
    for name in package_types:
        for table in (store.fielddefs, store.types):
            table.pop(name, None)
    store.register(package_types)


@dataclass(frozen=True)
class Recorded:
    """Messages of a topic.

    Attributes:
        logs: Log times, ``(k,)`` [ns].
        messages: k messages, or one message with the numbers of all (:func:`~impact_rs_trials.bags.cdr.stacked`).
        stacked: Whether ``messages`` is that one message.
    """

    logs: NDArray[np.int64]
    messages: list[Any]
    stacked: bool

    def size(self, value: Any) -> int:
        """Count of numbers that a field, with this value in ``messages``, has in each recorded message."""
        return np.size(value[0]) if self.stacked and isinstance(value, np.ndarray) else np.size(value)


class OpenedBag:
    """Messages of a bag by topic, read on demand.

    Attributes:
        messages: By topic.
        unread: Warnings about unread files in its folder.
    """

    def __init__(self, path: Path, store: Typestore) -> None:
        self._path, self._store = path, store
        self._connections: list[Connection] | None = None
        self.messages: dict[str, Recorded] = {}
        self.unread: tuple[str, ...] = ()

    def read(self, choose: Callable[[list[Connection]], list[Connection]]) -> list[Connection]:
        """Read the messages of the chosen connections unless they are read already.

        Raises:
            InputError: It is not a readable bag.
        """
        if self._connections is not None:
            chosen = choose(self._connections)
            if all(connection.topic in self.messages for connection in chosen):
                return chosen
        _check_pages(self._path)
        try:
            with open_bag(self._path) as reader:
                self.unread, self._connections = _unnamed_files(self._path, reader), list(reader.connections)
                chosen = choose(self._connections)
                missing = [connection for connection in chosen if connection.topic not in self.messages]
                rows: dict[str, list[tuple[int, str, Any]]] = {connection.topic: [] for connection in missing}
                for connection in missing:
                    register(self._store, connection)
                for connection, log, data in reader.messages(connections=missing) if missing else ():  # [] is all
                    rows[connection.topic].append((log, connection.msgtype, data))
            read_messages = {topic: self._recorded(topic_rows) for topic, topic_rows in rows.items()}
        except InputError:
            raise
        except Exception as error:  # a damaged file can fail anywhere inside the library
            raise unreadable(self._path, error) from None
        self.messages |= read_messages
        return chosen

    def _recorded(self, rows: list[tuple[int, str, Any]]) -> Recorded:
        """Messages of a topic from log times [ns], types and bytes, or messages that were decoded."""
        logs = np.array([log for log, _, _ in rows], dtype=np.int64)
        in_cdr = suffix_of(self._path) != ROS1_SUFFIX and all(isinstance(data, bytes) for _, _, data in rows)
        if in_cdr and len({kind for _, kind, _ in rows}) == 1:
            stacked_message = stacked(self._store, rows[0][1], [data for _, _, data in rows])
            if stacked_message is not None:
                return Recorded(logs, [stacked_message], True)
        return Recorded(logs, [deserialized(self._store, self._path, data, kind) for _, kind, data in rows], False)


@once
def _opened(path: Path, definitions: tuple[str, ...]) -> OpenedBag:
    return OpenedBag(path, typestore_for(path, definitions))


def read_topics(path: Path, topics: Collection[str]) -> None:
    """Read messages of several topics in one pass, for later use (:mod:`read_once`).

    Raises:
        InputError: It is not a readable bag.
    """
    _opened(path, ()).read(lambda every: [connection for connection in every if connection.topic in topics])


class BagFile:
    """One bag.

    Args:
        path: Folder, or bare ``.db3``, ``.mcap`` or ``.bag`` file.
        mapping: Where the signals are.
        names: Values of the placeholders of the mapping.
        wanted: Signals to read.

    Raises:
        InputError: It is not a readable bag.
    """

    def __init__(self, path: Path, mapping: Mapping, names: Names, wanted: tuple[SignalName, ...]) -> None:
        self._path, self._mapping, self._names = path, mapping, names
        self._joints = tuple(names.fill(joint) for joint in mapping.joints)
        files = {mapping.signals[name].file for name in wanted if name in mapping.signals}
        position = mapping.signals.get("position")
        self._joint_states = None if position is None or position.file not in files else position  # in this file
        self._lost: dict[str, tuple[str, ...]] = {}
        self._connections: list[Connection] = []
        opened = _opened(path, mapping.definitions)
        chosen = opened.read(lambda connections: self._chosen(wanted, connections))
        self._messages = opened.messages
        for topic in {connection.topic for connection in chosen}:
            count = self._messages[topic].logs.size
            counted = sum(connection.msgcount for connection in chosen if connection.topic == topic)
            if count != counted:
                text = f"{topic}: {count} messages, {counted} are counted in the bag's metadata"
                if not count:
                    raise InputError(text, file=path)
                self._lost[topic] = (f"{text}: a part is lost, or the metadata are of another bag",)
        self._unread = opened.unread
        self._shift: tuple[float, str] | None = None

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The bag lacks it.
            InputError: It cannot be used.
        """
        connection, *_ = self._publishers(name, source)
        recorded = self._messages[connection.topic]
        label = f"{connection.topic}: {source.field or connection.msgtype} ({name})"
        if name in FIELDLESS:
            samples = self._samples(label, name, source, recorded)
            indices, headers = [index for index, _, _ in samples], [header for _, header, _ in samples]
            values = _in_rows(np.array([numbers for _, _, numbers in samples], dtype=float))
        else:
            indices, values = self._numbers(label, name, source, recorded)
            headers = [getattr(recorded.messages[index], "header", None) for index in indices]
        log = 1e-9 * (recorded.logs if recorded.stacked else recorded.logs[indices]).astype(float)
        time, remarks = self._clock(name, source, connection.topic, headers, log)
        remarks += (*self._unread, *self._lost.get(connection.topic, ()))
        return Series(label, time + source.delay, values, log, remarks)

    def _chosen(self, wanted: tuple[SignalName, ...], connections: list[Connection]) -> list[Connection]:
        self._connections = connections
        chosen: dict[str, list[Connection]] = {}
        clocks: tuple[SignalName, ...] = () if self._joint_states is None else ("position",)
        for name in dict.fromkeys((*wanted, *clocks)):  # other signals are put on the clock of the joint states
            try:
                publishers = self._publishers(name, self._mapping.signals[name])
            except MissingSignal:
                continue  # the caller of series() decides whether it is needed
            chosen[publishers[0].topic] = publishers
        return [connection for publishers in chosen.values() for connection in publishers]

    def _publishers(self, name: SignalName, source: SignalSource) -> list[Connection]:
        """Connections of the publishers of a signal's topic, all of one message type."""
        if source.topic is None or (source.field is None and name not in FIELDLESS):
            raise MissingSignal(f"the mapping says no topic and field for {name}", file=self._path)
        topic = self._names.fill(source.topic)
        of_topic = [c for c in self._connections if fnmatchcase(c.topic, topic)]
        matches = [c for c in of_topic if source.type is None or c.msgtype == source.type]
        expected = f"{name}: expected topic {topic}" + ("" if source.type is None else f" of type {source.type}")
        if not self._connections:
            raise MissingSignal(f"{expected}, the bag is empty", file=self._path)
        matches = [c for c in matches if c.msgcount > 0] or matches
        kinds = dict.fromkeys(f"{c.topic} ({c.msgtype})" for c in matches)
        if len(kinds) > 1:
            raise InputError(
                f"{expected}, found several: {', '.join(kinds)}; name one of them in a mapping file", file=self._path
            )
        if not matches:
            suggestion = did_you_mean(topic, [c.topic for c in self._connections]) if not of_topic else ""
            shown = ", ".join(f"{c.topic} ({c.msgtype})" for c in (of_topic or self._connections)[:5])
            raise MissingSignal(f"{expected}, found {shown}{suggestion}", file=self._path)
        if matches[0].msgcount == 0:
            raise MissingSignal(f"{expected}, topic {matches[0].topic} holds no message", file=self._path)
        return matches

    # ---- time -------------------------------------------------------------------------------------------------------

    def _clock(
        self, name: SignalName, source: SignalSource, topic: str, headers: list[Any], log: Array
    ) -> tuple[Array, tuple[str, ...]]:
        """Timestamps on the clock of the run, and warnings about them."""
        clock = self._mapping.time.stamp
        stamped = headers[0] is not None
        if clock == "log" and source.stamp != "header":
            return log, ()
        if name == "position" and not stamped:
            raise InputError(f"{topic}: messages have no header: set time.stamp to log in the mapping", file=self._path)
        if clock == "header" and (source.stamp == "log" or not stamped):
            shift, drifts = self._log_after_stamp()
            words = "{}: log time, less {:.1f} ms to be on the stamps' clock{}"
            return log - shift, (remark(words, topic, 1e3 * shift, drifts),)
        if not stamped:
            raise InputError(f"{topic}: messages have no header, but signals.{name}.stamp asks for it", file=self._path)
        stamps = _stamps(headers)
        if not np.any(stamps):
            raise InputError(
                f"{topic}: no header is stamped (all are zero): set time.stamp to log in the mapping", file=self._path
            )
        if clock == "log":
            return stamps + float(np.median(log - stamps)), ()
        if self._joint_states is None:  # nothing to be late against
            return stamps, ()
        excess_delay = float(np.median(log - stamps)) - self._log_after_stamp()[0]
        if name in WIDTHS and not EXPECTED_LOG_DELAY_S[0] < excess_delay < EXPECTED_LOG_DELAY_S[1]:
            words = (
                "{}: logged {:+.1f} ms after joint states of the same stamp: a slow tracker, or another clock? "
                "signals.{}.delay corrects it"
            )
            return stamps, (remark(words, topic, 1e3 * excess_delay, name),)
        return stamps, ()

    def _log_after_stamp(self) -> tuple[float, str]:
        """Median log delay of the joint states [s], 0 without them, and a warning if it drifts."""
        if self._joint_states is None:
            return 0.0, ""
        if self._shift is None:
            connection, *_ = self._publishers("position", self._joint_states)
            recorded = self._messages[connection.topic]
            log = 1e-9 * recorded.logs.astype(float)
            delay = log - _stamps([message.header for message in recorded.messages])
            tenth = max(1, delay.size // 10)
            drift = float(np.median(delay[-tenth:]) - np.median(delay[:tenth]))
            text = remark(" (which drifts by {:.1f} ms during the run)", 1e3 * drift)
            self._shift = float(np.median(delay)), text if abs(drift) > MAX_STAMP_DRIFT_S else ""
        return self._shift

    # ---- numbers ----------------------------------------------------------------------------------------------------

    def _numbers(
        self, label: str, name: SignalName, source: SignalSource, recorded: Recorded
    ) -> tuple[list[int], Array]:
        """Indices of the messages with a signal, and its numbers ``(k, n)``, joints in the mapping's order."""
        assert source.field is not None
        orders: dict[tuple[str, ...], list[int] | None] = {}
        indices: list[int] = []
        rows: list[Array] = []
        width, entries = self._mapping.width(name), source.entries
        first = self._field(label, recorded.messages[0], source.field, recorded)
        count = None if entries is None else recorded.size(first)
        if entries is not None and count is not None and 0 < count < max(entries):
            text = f"{label} has {count} numbers, expected at least the {max(entries)} of entries"
            raise InputError(text, file=self._path, key=f"signals.{name}.entries of the mapping")
        for index, message in enumerate(recorded.messages):
            row = self._field(label, message, source.field, recorded)
            size = recorded.size(row)
            joints = () if source.names is None else tuple(self._field(label, message, source.names, recorded))
            if joints not in orders:
                entry_order = list(range(width)) if entries is None else [entry - 1 for entry in entries]
                orders[joints] = self._order(label, joints) if joints else entry_order
            order = orders[joints]
            if order is None:  # another device on the same topic, a gripper for example
                continue
            if size == 0 and not rows:
                if name in ("position", "velocity", "torque"):
                    raise InputError(f"{label} is empty; expected {width} numbers", file=self._path)
                raise MissingSignal(f"{label} is empty; expected {width} numbers", file=self._path)
            if size != (len(joints) or count or width):
                expected = (
                    f"{len(joints)} joint names, expected one each" if joints else f"{width} joints, expected one each"
                )
                if not joints and count is not None:
                    expected = f"the {count} of the first message, expected as many in all"
                elif not joints and size > width:
                    expected += f"; entries in the mapping says which of the {size}"
                raise InputError(f"{label}: message {index} has {size} numbers for {expected}", file=self._path)
            indices.append(index)
            rows.append(np.asarray(row, dtype=float).reshape(-1, size).take(order, axis=1))
        if not rows:
            named_joints = ", ".join(sorted({joint for joints in orders for joint in joints}))
            raise InputError(
                f"{label}: joint {self._joints[0]} is missing; the messages name {named_joints}", file=self._path
            )
        return indices, np.concatenate(rows) * self._mapping.factor(name) + self._mapping.offset(name)

    def _field(self, label: str, message: Any, path: str, recorded: Recorded) -> Any:
        """Value at a path of fields and indices, ``points.0.effort``, of one of the recorded messages."""
        value = message
        try:
            for part in path.split("."):
                if not part.isdigit():
                    value = getattr(value, part)
                else:
                    value = value[:, int(part)] if recorded.stacked else value[int(part)]
        except (AttributeError, IndexError, TypeError):
            fields = [field for field in vars(message) if not field.startswith("__")]
            raise InputError(
                f"{label}: {message.__msgtype__} has no such field{did_you_mean(path, fields)}; it has: "
                f"{', '.join(fields)}",
                file=self._path,
            ) from None
        return value

    def _order(self, label: str, names: tuple[str, ...]) -> list[int] | None:
        """Indices of the mapping's joints among the names of a message; None if it names no such joint."""
        candidates = [[i for i, name in enumerate(names) if fnmatchcase(name, joint)] for joint in self._joints]
        if not any(candidates):
            return None
        if any(
            len(indices) > 1 for indices in candidates
        ):  # finger_joint1 besides joint1: what * stands for must be common to all
            prefixes = [
                {_text_of_star(joint, names[i]) for i in indices}
                for joint, indices in zip(self._joints, candidates, strict=True)
            ]
            common = set.intersection(*prefixes)
            if len(common) == 1:
                candidates = [
                    [i for i in indices if _text_of_star(joint, names[i]) in common]
                    for joint, indices in zip(self._joints, candidates, strict=True)
                ]
        for joint, indices in zip(self._joints, candidates, strict=True):
            if len(indices) != 1:
                problem = "is missing" if not indices else "fits several joints"
                raise InputError(
                    f"{label}: joint {joint} {problem}; the message names {', '.join(names)}", file=self._path
                )
        return [indices[0] for indices in candidates]

    def _samples(
        self, label: str, name: SignalName, source: SignalSource, recorded: Recorded
    ) -> list[tuple[int, Any, list[Any]]]:
        """Index of the message, header and numbers of every pose, wrench or acceleration."""
        messages = recorded.messages
        if name == "object_pose" and source.field is None and hasattr(messages[0], "transforms"):
            child = self._child(label, source, messages)
            return [
                (index, transform.header, self._pose(label, transform))
                for index, message in enumerate(messages)
                for transform in message.transforms
                if transform.child_frame_id == child
            ]
        numbers_of = {"object_pose": self._pose, "wrench": self._wrench, "acceleration": self._acceleration}[name]
        samples = []
        for index, message in enumerate(messages):
            holder = message if source.field is None else self._field(label, message, source.field, recorded)
            numbers = numbers_of(label, holder)
            samples.append((index, getattr(message, "header", None), numbers))
        return samples

    def _child(self, label: str, source: SignalSource, messages: list[Any]) -> str:
        """The one child frame of transforms that the mapping selects."""
        children = sorted({transform.child_frame_id for message in messages for transform in message.transforms})
        pattern = self._names.fill(source.child_frame or "*")
        chosen = [child for child in children if fnmatchcase(child, pattern)]
        if not chosen:
            suggestion = did_you_mean(pattern, children)
            raise MissingSignal(
                f"{label}: no child_frame_id {pattern}{suggestion}; found: {', '.join(children)}", file=self._path
            )
        if len(chosen) > 1:
            raise InputError(
                f"{label}: {', '.join(chosen)} all fit child_frame {pattern}; name one of them in a mapping file",
                file=self._path,
            )
        return chosen[0]

    def _wrench(self, label: str, holder: Any) -> list[Any]:
        """Force and torque of a Wrench or WrenchStamped."""
        holder = getattr(holder, "wrench", holder)
        if not (hasattr(holder, "force") and hasattr(holder, "torque")):
            raise InputError(f"{label}: expected a WrenchStamped, or a field that holds a wrench", file=self._path)
        factor = float(self._mapping.factor("wrench"))
        return [factor * number for number in (*_xyz(holder.force), *_xyz(holder.torque))]

    def _acceleration(self, label: str, holder: Any) -> list[Any]:
        """Linear acceleration of an Imu or AccelStamped, or of a field that holds it."""
        holder = getattr(holder, "accel", holder)
        holder = getattr(holder, "linear_acceleration", getattr(holder, "linear", holder))
        if not all(hasattr(holder, axis) for axis in "xyz"):
            raise InputError(f"{label}: expected an Imu, an AccelStamped, or a field x, y, z", file=self._path)
        factor = float(self._mapping.factor("acceleration"))
        return [factor * number for number in _xyz(holder)]

    def _pose(self, label: str, holder: Any) -> list[Any]:
        """Position and quaternion, x y z w, of a pose or transform, however deep it lies."""
        scale = float(self._mapping.factor("object_pose"))
        for _ in range(3):  # PoseWithCovarianceStamped and Odometry hold a pose in a pose
            for position, orientation in POSE_PARTS:
                if hasattr(holder, position) and hasattr(holder, orientation):
                    quaternion = getattr(holder, orientation)
                    numbers = [scale * number for number in _xyz(getattr(holder, position))]
                    return [*numbers, *_xyz(quaternion), _double(quaternion.w)]
            holder = getattr(holder, "pose", getattr(holder, "transform", holder))
        raise InputError(
            f"{label}: expected a PoseStamped, TransformStamped, TFMessage or Odometry, or a field that holds a pose",
            file=self._path,
        )


def _check_pages(path: Path) -> None:
    """Refuse a truncated SQLite file by the page count in its header; SQLite reads such a file without an error."""
    for file in sorted(path.glob("*.db3")) if path.is_dir() else [path]:
        if suffix_of(file) != ".db3":
            continue
        with file.open("rb") as stream:
            head = stream.read(100)
        if not head.startswith(b"SQLite format 3\0") or head[24:28] != head[92:96]:  # no such file, or an old count
            continue
        size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        size = 65536 if size == 1 else size
        if file.stat().st_size < size * pages:
            text = f"cut off: {file.stat().st_size} bytes are left of {size * pages}, expected the whole file"
            raise InputError(text, file=file)


def _unnamed_files(path: Path, reader: BagReader) -> tuple[str, ...]:
    """A warning about message files in the folder of a bag that its metadata do not name."""
    if not path.is_dir():
        return ()
    storage = getattr(reader, "storage", None)
    named = {Path(str(storage_file.path)).name for storage_file in getattr(storage, "storages", ())}
    unnamed = sorted(
        file.name
        for file in path.iterdir()
        if {file.name, file.stem}.isdisjoint(named) and suffix_of(file) in MESSAGE_SUFFIXES
    )
    return (f"not read, for metadata.yaml does not name them: {', '.join(unnamed)}",) if unnamed else ()


def _stamps(headers: list[Any]) -> Array:
    return np.array([header.stamp.sec + 1e-9 * header.stamp.nanosec for header in headers], dtype=float).reshape(-1)


def _xyz(vector: Any) -> list[Any]:
    return [_double(vector.x), _double(vector.y), _double(vector.z)]


def _double(number: Any) -> Any:
    """A number in double precision, or a column of numbers."""
    return number.astype(float) if isinstance(number, np.ndarray) else float(number)


def _in_rows(numbers: Array) -> Array:
    """A row per message of numbers ``(k, n)``, or of columns in one message, ``(1, n, k)``."""
    return np.ascontiguousarray(numbers[0].T) if numbers.ndim == 3 else numbers


def _text_of_star(pattern: str, name: str) -> str:
    """Text of the first ``*`` of a pattern in a matching name."""
    before, _, after = pattern.partition("*")
    return name[len(before) : len(name) - len(after)]
