# SPDX-License-Identifier: Apache-2.0
"""Reading trials as columns. Ground truth is read only by its topic."""

from __future__ import annotations

import math
import struct
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import yaml
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.urdf import joint_names
from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.cdr import decode
from impact_rs_trials.bags.recovery import recover
from impact_rs_trials.bags.trial_info import OUTCOMES, VIA, TrialInfo
from impact_rs_trials.bags.types import NS_PER_S, typestore, typestore_of
from impact_rs_trials.bags.writer import ORIGIN, RECORDED
from impact_rs_trials.file_names import BAG_METADATA
from impact_rs_trials.runs import ArmSignals, Poses, Run, Signals, run_of_trial

OF_THE_TWIN = (
    "the twin recorded these trials and replays them as well, so that the comparison contains no difference between "
    "simulators"
)
MAX_STAMP_DIFFERENCE_S = 1e-6  # between joint and motor states of one tick
FRAME_OFFSET_BYTES = 12  # of the frame name in a serialized message with a header


class BagError(Exception):
    """A folder is not a readable trial: truncated, empty or of another kind. The message names folder and reason."""

    def __init__(self, path: Path, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")


def reason_of(error: Exception) -> str:
    """Reason why one bag cannot be used, in one line, for any exception."""
    if isinstance(error, BagError):
        return error.reason
    if isinstance(error, InputError):
        return str(error)
    return " ".join(f"damaged ({type(error).__name__}: {str(error)[:200]})".split())


@dataclass(frozen=True)
class JointColumns:
    """One ``sensor_msgs/JointState`` topic as columns.

    Attributes:
        time: Trial times by the header stamps, ``(k,)`` [s].
        position: ``(k, n)`` [rad]; empty where the topic has none.
        velocity: ``(k, n)`` [rad/s]; empty where the topic has none.
        effort: ``(k, n)`` [N m]; empty where the topic has none.
    """

    time: Array
    position: Array
    velocity: Array
    effort: Array

    @classmethod
    def of(cls, columns: dict[str, Array]) -> JointColumns:
        """From the columns of :func:`columns_of`."""
        return cls(*(_column(columns, name) for name in ("time", "position", "velocity", "effort")))


@dataclass(frozen=True)
class ControllerColumns:
    """The ``ControllerState`` topic of one arm as columns; see the message for units and frames.

    ``(k,)`` for scalars, ``(k, 3)``, ``(k, 6)`` or ``(k, n)`` for vectors.
    """

    time: Array
    mode: Array
    gamma: Array
    ante_position: Array
    ante_velocity: Array
    ante_acceleration: Array
    post_position: Array
    post_velocity: Array
    post_acceleration: Array
    ante_posture: Array
    post_posture: Array
    position: Array
    twist: Array
    feedback_acceleration: Array
    net_feedback: Array
    commanded_torque: Array
    external_wrench: Array
    qp_status: Array
    qp_iterations: Array
    qp_solve_time: Array

    @classmethod
    def of(cls, columns: dict[str, Array]) -> ControllerColumns:
        """From the columns of :func:`columns_of`."""
        return cls(**{name: _column(columns, name) for name in cls.__dataclass_fields__})


@dataclass(frozen=True)
class PoseColumns(Poses):
    """One ``geometry_msgs/PoseStamped`` topic as columns, at trial times by the header stamps."""

    @classmethod
    def of(cls, columns: dict[str, Array]) -> PoseColumns:
        """From the columns of :func:`columns_of`."""
        position = [_column(columns, f"pose.position.{axis}") for axis in "xyz"]
        quaternion = [_column(columns, f"pose.orientation.{axis}") for axis in "xyzw"]
        return cls(_column(columns, "time"), np.stack(position, axis=-1), np.stack(quaternion, axis=-1))


Columns = TypeVar("Columns", JointColumns, ControllerColumns, PoseColumns)


def recorded_at(path: Path) -> float:
    """Time of a bag's recording, seconds since 1970, by its metadata alone, or else the time of writing.

    Args:
        path: Folder of the bag; its messages may be damaged.
    """
    recorded = _recorded(_custom(path))
    return path.stat().st_mtime if recorded is None else recorded


def stamped_at(path: Path) -> float | None:
    """Time stamp by the recorder of a bag, seconds since 1970, simulated or not, by its metadata alone; None: missing.

    Args:
        path: Folder of the bag; its messages may be damaged.
    """
    return _stamp(_custom(path))


def _custom(path: Path) -> dict[str, str]:
    """Custom metadata of a bag; empty: missing or not readable."""
    with suppress(OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError):
        text = (path / BAG_METADATA).read_text(encoding="utf-8")
        return dict(yaml.load(text, yaml.CSafeLoader)["rosbag2_bagfile_information"]["custom_data"] or {})
    return {}


def _recorded(metadata: Mapping[str, str]) -> float | None:
    """Time of a bag's recording, seconds since 1970; None: by another program, or simulated."""
    return None if metadata.get("via") in VIA.values() else _stamp(metadata)


def _stamp(metadata: Mapping[str, str]) -> float | None:
    """Time of writing a bag by its recorder, seconds since 1970; None: without a time stamp."""
    with suppress(KeyError, ValueError, TypeError):
        return datetime.fromisoformat(metadata[RECORDED]).timestamp()
    return None


class TrialBag:
    """One trial on disk, by :meth:`open`; a topic is read on demand.

    Args:
        path: Folder of the bag.
        reader: Open reader, which the bag closes.
        info: Identity of the trial.
        metadata: Custom metadata of the recorder.
        sealed: Whether it has checksums, all correct; bags of 0.1.0 and of other programs lack them.

    Attributes:
        counts: Number of messages by topic.
        origin_ns: Stamp of trial time 0 [ns]: ROS time of a real robot, 0 in simulation and in bags of 0.1.0.
    """

    def __init__(
        self, path: Path, reader: Reader, info: TrialInfo, metadata: dict[str, str], sealed: bool = False
    ) -> None:
        self.path = path
        self.sealed = sealed
        self.info = info
        self.metadata = metadata
        self.origin_ns = int(metadata.get(ORIGIN, 0))
        self.counts = {connection.topic: connection.msgcount for connection in reader.connections}
        self._reader = reader
        self._ahead: dict[str, list[bytes]] = {}
        weakref.finalize(self, reader.close)

    @classmethod
    def open(cls, path: Path) -> TrialBag:
        """The trial in a folder; a truncated recording is ``ABORTED`` and has the messages that reached the disk.

        Raises:
            BagError: The folder is no readable bag, or holds no ``/trial_info``.
        """
        if path.is_dir() and any(path.glob("*.mcap")) and not (path / BAG_METADATA).exists():
            return cls._recovered(path)
        with ExitStack() as opened:
            try:
                if not path.is_dir():
                    raise BagError(path, "a bare file; a trial is a folder with metadata.yaml")
                if not (path / BAG_METADATA).is_file():
                    reason = "no metadata.yaml: the recording was cut off" if any(path.iterdir()) else "an empty folder"
                    raise BagError(path, reason)
                sealed = checksums.check(path)
                reader = opened.enter_context(Reader(path))
                metadata = {str(name): str(value) for name, value in (reader.storage.metadata.custom or {}).items()}
                bag = cls(path, reader, _identity(path, reader), metadata, sealed)
            except BagError:
                raise
            except checksums.ChecksumError as error:
                raise BagError(path, str(error)) from None
            except (ReaderError, OSError) as error:
                raise BagError(path, f"not a readable bag ({error})") from None
            except Exception as error:  # a damaged file can fail anywhere inside the library
                raise BagError(path, f"damaged bag ({type(error).__name__}: {error})") from None
            opened.pop_all()
        return bag

    @classmethod
    def _recovered(cls, path: Path) -> TrialBag:
        with TemporaryDirectory() as folder:  # the open file outlives it
            try:
                recovered = recover(path, Path(folder) / path.name)
            except Exception as error:  # a damaged message can fail anywhere
                raise BagError(path, f"the recording was cut off ({type(error).__name__}: {error})") from None
            if not recovered:
                raise BagError(path, "no metadata.yaml: the recording was cut off, and nothing of it is left")
            bag = cls.open(Path(folder) / path.name)
        bag.path = path
        return bag

    @property
    def outcome(self) -> str:
        """One of ``OUTCOMES``; ``ABORTED`` if the recorder wrote no outcome."""
        return self.metadata.get("outcome", "ABORTED")

    @property
    def reason(self) -> str:
        """Reason of the outcome, in one line: the recorder's, or the meaning of the outcome."""
        return self.metadata.get("outcome_reason") or OUTCOMES.get(self.outcome, "an outcome that is not known here")

    @property
    def missing(self) -> list[str]:
        """Topics of a trial without messages in this one; ``/truth`` means all topics below it."""
        present = [topic for topic, count in self.counts.items() if count]
        return topics.lacking(self.info.robots, present, self.info.neighbours)

    def serialized(self, topic: str) -> list[bytes]:
        """All messages of a topic as they were recorded (CDR).

        Raises:
            BagError: The bag breaks off inside this topic.
        """
        return _raw(self.path, self._reader, topic)[1]

    def messages(self, topic: str) -> list[Any]:
        """All messages of a topic, as objects of the ``rosbags`` typestore.

        Raises:
            BagError: The bag breaks off inside this topic.
        """
        return _messages(self.path, self._reader, topic)

    def _columns(self, topic: str, make: Callable[[dict[str, Array]], Columns]) -> Columns:
        """All numbers of a topic, and trial ``time`` by the header stamps [s], as columns of a kind."""
        connection, rows = _raw(self.path, self._reader, topic, self._ahead)
        try:
            if connection is None:
                return make({})
            return make(columns_of(connection.msgtype, rows, typestore_of(connection), self.origin_ns))
        except Exception as error:  # damaged, or a topic of another type
            raise BagError(self.path, f"{topic}: damaged ({type(error).__name__}: {error})") from None

    def joints(self, topic: str) -> JointColumns:
        """A JointState topic."""
        return self._columns(topic, JointColumns.of)

    def controller(self, arm: str) -> ControllerColumns:
        """The ControllerState topic of an arm."""
        return self._columns(topics.controller_state(arm), ControllerColumns.of)

    def poses(self, topic: str) -> PoseColumns:
        """A PoseStamped topic."""
        return self._columns(topic, PoseColumns.of)

    def run(self) -> Run:
        """The trial as a run; ``/truth`` is not read.

        Raises:
            BagError: A topic is missing, damaged, has NaN, gaps or decreasing timestamps.
            InputError: The scenario in it cannot be read.
        """
        remarks = (OF_THE_TWIN,) if self.info.simulator == "twin" else ()
        run = run_of_trial(self.info.spec, self._signals(), self.path)
        return replace(run, recorded=_recorded({**self.metadata, "via": self.info.via}), remarks=remarks)

    def _signals(self) -> Signals:
        """Measured signals, checked."""
        arms, time = {}, None
        of_arm = (topics.joint_states, topics.motor_states, topics.controller_state)
        neighbour_topics = {name: topics.pose(name) for name in self.info.neighbours}
        of_arms = (topic(arm) for arm in self.info.robots for topic in of_arm)
        self._read_ahead(topics.OBJECT_POSE, *neighbour_topics.values(), *of_arms)
        for arm in self.info.robots:
            time, arms[arm] = self._arm(arm)
        if time is None:
            raise BagError(self.path, "names no robots")
        tracked = self._tracked(topics.OBJECT_POSE)
        neighbours = {name: self._tracked(topic) for name, topic in neighbour_topics.items()}
        return Signals(time, arms, tracked.time, tracked.position, tracked.quaternion, neighbours)

    def _tracked(self, topic: str) -> Poses:
        """Tracked poses of a body, checked; empty where they were not recorded, as in bags of 0.1.0."""
        poses = self.poses(topic)
        if np.any(decreasing := np.diff(poses.time) < 0.0):  # a tracker may repeat its last sample
            first = float(poses.time[1:][np.argmax(decreasing)])
            raise BagError(self.path, f"{topic}: time stamps run backwards at t = {first:.3f} s")
        return poses

    def _read_ahead(self, *names: str) -> None:
        """Read several topics in one pass over the file; if that fails, each is read alone later."""
        rows: dict[str, list[bytes]] = {name: [] for name in names}
        connections = [connection for connection in self._reader.connections if connection.topic in rows]
        with suppress(Exception):
            for connection, _, data in self._reader.messages(connections=connections):
                rows[connection.topic].append(data)
            self._ahead = rows

    def _arm(self, arm: str) -> tuple[Array, ArmSignals]:
        """Times and signals of one arm, checked."""
        measured, motor = self.joints(topics.joint_states(arm)), self.joints(topics.motor_states(arm))
        controller, time = self.controller(arm), measured.time
        _check_times(self.path, topics.joint_states(arm), time)
        if topics.motor_states(arm) in self.missing:
            raise BagError(
                self.path,
                f"no {topics.motor_states(arm)}, which the replay of a model starts from: describe such bags with an "
                "experiment file (docs/files.md)",
            )
        for topic, size in (
            (topics.motor_states(arm), motor.time.size),
            (topics.controller_state(arm), controller.time.size),
        ):
            if size != time.size:
                raise BagError(self.path, f"{topic} has {size} messages, {topics.joint_states(arm)} has {time.size}")
        if np.any(differing := np.abs(motor.time - time) > MAX_STAMP_DIFFERENCE_S):
            first = float(time[np.argmax(differing)])
            pair = f"{topics.motor_states(arm)} and {topics.joint_states(arm)}"
            raise BagError(self.path, f"{pair} have different stamps at t = {first:.3f} s")
        for topic in (topics.joint_states(arm), topics.motor_states(arm)):
            self._check_joints(topic, arm, time)
        for name, values in (
            ("position", measured.position),
            ("velocity", measured.velocity),
            ("effort", measured.effort),
        ):
            if not np.isfinite(values).all():
                first = float(time[np.argmax(~np.isfinite(values).all(axis=1))])
                raise BagError(self.path, f"{topics.joint_states(arm)}: {name} is not finite at t = {first:.3f} s")
        return time, ArmSignals(
            position=measured.position,
            velocity=measured.velocity,
            torque=measured.effort,
            motor_position=motor.position,
            motor_velocity=motor.velocity,
            command_time=time,
            command=controller.commanded_torque,
        )

    def _check_joints(self, topic: str, arm: str, time: Array) -> None:
        """Check that every message names the same joints, in the order of the robot if they are the robot's."""
        _, rows = _raw(self.path, self._reader, topic, self._ahead)
        names, part = _joints_of(rows[0])
        if (index := next((n for n, row in enumerate(rows) if row[part] != rows[0][part]), None)) is not None:
            raise BagError(self.path, f"{topic}: other joints, or another order, at t = {time[index]:.3f} s")
        facts = self.info.spec.scenario.robots[arm].robot_facts
        expected = [f"{arm}_{joint}" for joint in joint_names(facts)]
        if names != expected and sorted(names) == sorted(expected):
            raise BagError(
                self.path, f"{topic}: joints in the order {', '.join(names)}; expected {', '.join(expected)}"
            )

    def impact_time(self, arm: str) -> float:
        """Detected impact time of an arm [s]; NaN: not detected."""
        events = self.messages(topics.impact_event(arm))
        return float(events[0].detected_time) if events else math.nan


def _joints_of(row: bytes) -> tuple[list[str], slice]:
    """Names of the joints in a serialized ``sensor_msgs/JointState``, and their offsets."""
    order = "<" if row[1] else ">"
    (length,) = struct.unpack_from(f"{order}I", row, FRAME_OFFSET_BYTES)
    at = FRAME_OFFSET_BYTES + 4 + length
    start = at = at + -at % 4
    (count,) = struct.unpack_from(f"{order}I", row, at)
    at += 4
    names = []
    for _ in range(count):
        at += -at % 4
        (length,) = struct.unpack_from(f"{order}I", row, at)
        at += 4 + length
        names.append(bytes(row[at - length : at - 1]).decode("utf-8", "replace"))
    return names, slice(start, at)


def columns_of(
    kind: str, rows: Sequence[bytes], store: Typestore | None = None, origin_ns: int = 0
) -> dict[str, Array]:
    """All numbers of serialized messages of a stamped type by field path, and trial ``time`` by the stamps [s].

    The origin is subtracted in integers: a double of seconds since 1970 resolves 0.2 us, and no trial would have the
    same numbers twice.

    Args:
        kind: ``package/msg/Name`` of all of them.
        rows: The messages.
        store: Type definitions of the writer; None: this version's.
        origin_ns: Stamp of trial time 0 [ns].
    """
    columns = decode(store or typestore(), kind, rows)
    if columns:
        stamps = columns["header.stamp.sec"].astype(np.int64) * NS_PER_S + columns["header.stamp.nanosec"]
        seconds, nanoseconds = np.divmod(stamps - origin_ns, NS_PER_S)
        columns["time"] = seconds + 1e-9 * nanoseconds
    return columns


def _raw(
    path: Path, reader: Reader, topic: str, ahead: Mapping[str, list[bytes]] = MappingProxyType({})
) -> tuple[Connection | None, list[bytes]]:
    """Connection and serialized messages of a topic, perhaps read ``ahead``; None if the bag lacks it."""
    connections = [c for c in reader.connections if c.topic == topic]
    if not connections:
        return None, []
    try:
        rows = ahead[topic] if topic in ahead else [data for _, _, data in reader.messages(connections=connections)]
    except Exception as error:  # a damaged file can fail anywhere inside the library
        raise BagError(path, f"{topic}: damaged ({type(error).__name__}: {error})") from None
    expected = connections[0].msgcount
    if not isinstance(expected, int):  # as metadata.yaml has it
        raise BagError(path, f"{topic}: damaged (metadata.yaml counts {expected!r} messages)")
    if len(rows) < expected:
        raise BagError(path, f"{topic}: damaged ({len(rows)} of {expected} messages are left)")
    return connections[0], rows


def _messages(path: Path, reader: Reader, topic: str) -> list[Any]:
    connection, rows = _raw(path, reader, topic)
    if connection is None:
        return []
    try:
        store = typestore_of(connection)
        return [store.deserialize_cdr(data, connection.msgtype) for data in rows]
    except Exception as error:
        raise BagError(path, f"{topic}: damaged ({type(error).__name__}: {error})") from None


def _identity(path: Path, reader: Reader) -> TrialInfo:
    if all(connection.topic != topics.TRIAL_INFO for connection in reader.connections):
        raise BagError(path, f"no {topics.TRIAL_INFO}: not a trial of impact_rs")
    messages = _messages(path, reader, topics.TRIAL_INFO)
    if not messages:
        raise BagError(path, f"{topics.TRIAL_INFO} is empty: the recording was cut off")
    try:
        return TrialInfo.from_message(messages[0])
    except AttributeError as error:
        raise BagError(path, f"{topics.TRIAL_INFO} is of another kind: {error}") from None


def _check_times(path: Path, topic: str, time: Array) -> None:
    """Times that increase in even steps."""
    if time.size < 2:
        raise BagError(path, f"{topic} has {time.size} messages")
    steps = np.diff(time)
    if np.any(steps <= 0.0):
        raise BagError(path, f"{topic}: time stamps run backwards at t = {time[np.argmax(steps <= 0.0)]:.3f} s")
    if steps.max() > 1.5 * np.median(steps):
        raise BagError(path, f"{topic}: gap of {steps.max():.4f} s at t = {time[np.argmax(steps)]:.3f} s")


def _column(columns: dict[str, Array], name: str) -> Array:
    return columns[name].astype(float) if columns else np.zeros(0)
