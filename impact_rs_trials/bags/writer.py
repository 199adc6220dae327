# SPDX-License-Identifier: Apache-2.0
"""Writing a trial: MCAP by ``rosbags``, into a hidden folder that gets its name when the trial is complete.

MCAP keeps messages in chunks. A chunk is written to the disk with its checksum when it is full, or on
:meth:`BagWriter.save`. If the process is killed, :mod:`~impact_rs_trials.bags.recovery` reads the bag up to there.
"""

from __future__ import annotations

import shutil
import struct
import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, zstd
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.cdr import encode
from impact_rs_trials.bags.trial_info import Outcome, TrialInfo
from impact_rs_trials.bags.types import typestore

MISSING = "missing"  # key of the metadata: topics without a message
RECORDED = "recorded"  # key of the metadata: date and time (UTC) of the recording
ORIGIN = "origin_ns"  # key of the metadata: stamp of trial time 0 [ns], ROS time; without it stamps are trial time
FILES = ("scenario_json", "model_yaml")  # not in the metadata: 200 kB with a friction compensation take YAML a second
MAX_BLOCK_MESSAGES = 100_000  # kept in memory; several trials' worth
MAX_CHUNK_BYTES = 2**20  # before compression, as in rosbags
ZSTD_LEVEL = 1  # 3, the default of zstd, takes twice the time for a bag smaller by a few percent

_RECORD = struct.Struct("<BQHIQQ")  # of a message: kind, size, channel, sequence, time, time of publication


def _offered(topic: str) -> Qos:
    """Quality of service of a topic's publisher, for ``ros2 bag play``."""
    infinite = QosTime(sec=2147483647, nsec=4294967295)
    offer = topics.offer(topic)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=offer.depth,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if offer.latched else QosDurability.VOLATILE,
        deadline=infinite,
        lifespan=infinite,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=infinite,
        avoid_ros_namespace_conventions=False,
    )


class _Storage(McapWriter):
    """An MCAP file whose chunks can be read, and checked, before it is closed; many messages go into it at once."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        if compression == CompressionMode.STORAGE:
            self.compressor = partial(zstd.compress, level=ZSTD_LEVEL)

    def write_many(self, messages: Sequence[tuple[int, Connection, bytes | memoryview]]) -> None:
        """Write messages with their times [ns], in the order of time."""
        chunk = self.chunk
        for nanoseconds, connection, data in messages:
            if nanoseconds < chunk.message_start_time:
                chunk.message_start_time = nanoseconds
            if nanoseconds > chunk.message_end_time:
                chunk.message_end_time = nanoseconds
            channel, start, size = connection.id, chunk.bio.tell(), _RECORD.size + len(data)
            self.channel_stats[channel] += 1
            chunk.msgs[channel].append((nanoseconds, start))
            head = (checksums.MESSAGE_OPCODE, size - checksums.RECORD_HEAD_BYTES, channel, 0, nanoseconds, nanoseconds)
            chunk.bio.write(_RECORD.pack(*head))
            chunk.bio.write(data)
            if start + size > MAX_CHUNK_BYTES:
                self.close_chunk()
                chunk = self.chunk
        self.message_start_time = min(self.message_start_time, messages[0][0])
        self.message_end_time = max(self.message_end_time, messages[-1][0])

    def close_chunk(self) -> None:
        start, content = self.bio.tell(), self.chunk.bio.getbuffer()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + checksums.RECORD_HEAD_BYTES + checksums.CHUNK_CHECKSUM_OFFSET_BYTES)
        self.bio.write(crc32(content).to_bytes(4, "little"))
        self.bio.seek(end)
        self.bio.flush()

    def close(self, version: int, metadata: str) -> None:
        super().close(version, metadata)
        checksums.seal(self.path)
        self.metadata = metadata


class SealedWriter(Writer):
    """Writes a bag that :func:`~impact_rs_trials.bags.checksums.check` finds sealed; many messages go in at once."""

    STORAGE_PLUGINS = Writer.STORAGE_PLUGINS | {StoragePlugin.MCAP: _Storage}  # type: ignore[operator]

    def write_many(self, messages: Sequence[tuple[int, Connection, bytes | memoryview]]) -> None:
        """Write messages with their times [ns], in the order of time, as :meth:`write` does one by one."""
        assert isinstance(self.storage, _Storage)
        self.storage.write_many(messages)
        for _, connection, _ in messages:
            self.counts[connection.id] += 1
        self.min_timestamp = min(self.min_timestamp, messages[0][0])
        self.max_timestamp = max(self.max_timestamp, messages[-1][0])

    def close(self) -> None:
        """Close the bag; its ``metadata.yaml`` has the text that lies in the MCAP file."""
        self.set_custom_data(checksums.NAME, checksums.KIND)
        storage = self.storage
        assert isinstance(storage, _Storage)
        super().close()
        self.metapath.write_text(checksums.metadata_text(storage.metadata), encoding="utf-8")


def partial_path(path: Path) -> Path:
    """Temporary path of the bag ``path`` while it is being written."""
    return path.parent / ".partial" / path.name


class BagWriter:
    """Writes the bag of one trial; a context manager, made by :meth:`create`.

    Leaving the context without :meth:`finish` keeps the incomplete bag, readable, under its hidden name, and a campaign
    runs that trial again. If the disk is full, nothing is kept.

    Args:
        path: Folder of the bag when it is complete.
        writer: Open, on the hidden folder.
        bodies: Names of the arms, and of the neighbours of the object.
        connections: Connections of the writer, by topic.
        store: Definitions of their types.
    """

    def __init__(
        self,
        path: Path,
        writer: SealedWriter,
        bodies: tuple[Sequence[str], Sequence[str]],
        connections: dict[str, Connection],
        store: Typestore,
    ) -> None:
        self.path = path
        self._origin_ns = 0
        self._early: list[tuple[str, int, bytes | memoryview]] | None = None  # messages that wait for the origin
        self._arms, self._neighbours = bodies
        self.messages = 0
        self._writer = writer
        self._connections = connections
        self._store = store
        self._ended = False
        self._present: set[str] = set()
        self._pending: list[tuple[str, int, Any]] = []
        self._rows: list[tuple[int, Connection, bytes | memoryview]] = []

    @classmethod
    def create(
        cls,
        path: Path,
        arms: Sequence[str],
        truth: bool = True,
        origin_ns: int | None = 0,
        neighbours: Sequence[str] = (),
    ) -> BagWriter:
        """Begin a bag with every topic of a trial.

        Args:
            path: Folder of the bag; must not exist yet.
            arms: Names of the arms.
            truth: Whether the bag has topics for the truth.
            origin_ns: Stamp of trial time 0 [ns]: ROS time of a robot, 0 in simulation; None: not before :meth:`begin`.
            neighbours: Names of the neighbours of the object.

        Raises:
            InputError: The folder exists already or cannot be made.
        """
        hidden = partial_path(path)
        try:
            if path.exists():
                raise InputError("this bag exists already", file=path)
            shutil.rmtree(hidden, ignore_errors=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            writer = SealedWriter(hidden, version=9, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            writer.open()
        except OSError as error:
            shutil.rmtree(hidden, ignore_errors=True)
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
        store = typestore()
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=[_offered(topic)])
            for topic, kind in topics.recorded(arms, truth, neighbours).items()
        }
        bag = cls(path, writer, (arms, neighbours), connections, store)
        bag.date(time.time())
        if origin_ns is None:
            bag._early = []
        else:
            bag.begin(origin_ns)
        return bag

    def begin(self, origin_ns: int) -> None:
        """Set the stamp of trial time 0 [ns], and write the messages that waited for it."""
        self._origin_ns = origin_ns
        if origin_ns:
            self._writer.set_custom_data(ORIGIN, str(origin_ns))
        early, self._early = self._early or [], None
        for message in early:
            self.write_raw(*message)

    def date(self, recorded: float) -> None:
        """Write the time of the recording, seconds since 1970, to the metadata."""
        self._writer.set_custom_data(RECORDED, datetime.fromtimestamp(recorded, UTC).isoformat(timespec="seconds"))

    def describe(self, info: TrialInfo) -> None:
        """Write the trial's identity to the metadata of the bag; texts of files are in ``/trial_info`` only."""
        for name, value in info.values().items():
            if name not in FILES:
                self._writer.set_custom_data(name, str(value))

    def write(self, topic: str, nanoseconds: int, message: Any) -> None:
        """Write a message of the ``rosbags`` typestore at trial time [ns]; it must not be changed afterwards.

        Messages are kept and serialized together, which is several times faster than one by one.
        """
        self._pending.append((topic, nanoseconds, message))
        self._present.add(topic)
        self.messages += 1
        if len(self._pending) >= MAX_BLOCK_MESSAGES:
            self._flush()

    def write_rows(self, topic: str, nanoseconds: Sequence[int], rows: Sequence[bytes | memoryview]) -> None:
        """Write serialized (CDR) messages of one topic at trial times [ns], among the others in the order of time."""
        if not rows:
            return
        connection = self._connections[topic]
        self._rows += [(time, connection, row) for time, row in zip(nanoseconds, rows, strict=True)]
        self._present.add(topic)
        self.messages += len(rows)

    def write_raw(self, topic: str, nanoseconds: int, data: bytes | memoryview) -> None:
        """Write a serialized (CDR) message at trial time [ns]."""
        if self._early is not None:
            self._early.append((topic, nanoseconds, data))
            return
        self._flush()
        self._writer.write(self._connections[topic], self._origin_ns + nanoseconds, data)
        self._present.add(topic)
        self.messages += 1

    def save(self) -> None:
        """Flush all messages to the disk, readable even if the bag is never closed."""
        self._flush()
        storage = self._writer.storage
        if isinstance(storage, _Storage) and storage.chunk.msgs:
            storage.close_chunk()

    def _flush(self) -> None:
        """Serialize pending messages, topic by topic, and write them in temporal order."""
        pending, self._pending = self._pending, []
        rows, self._rows = self._rows, []
        grouped: dict[str, list[tuple[int, Any]]] = defaultdict(list)
        for topic, nanoseconds, message in pending:
            grouped[topic].append((nanoseconds, message))
        for topic, entries in grouped.items():
            connection = self._connections[topic]
            times, messages = zip(*entries, strict=True)
            encoded = encode(self._store, connection.msgtype, messages)
            rows += [(time, connection, row) for time, row in zip(times, encoded, strict=True)]
        if rows:
            origin = self._origin_ns
            stamped = [(origin + time, connection, row) for time, connection, row in rows] if origin else rows
            self._writer.write_many(sorted(stamped, key=itemgetter(0)))

    def finish(self, outcome: Outcome, reason: str = "") -> None:
        """Close the bag and give it its name; topics without messages are listed in its metadata.

        Args:
            outcome: Outcome of the trial.
            reason: Reason of the outcome, in one line; may be empty.

        Raises:
            InputError: The folder has been made by another program meanwhile.
        """
        if lacking := topics.lacking(self._arms, self._present, self._neighbours):
            self._writer.set_custom_data(MISSING, ", ".join(lacking))
        self._close(outcome, reason)
        hidden = partial_path(self.path)
        try:
            hidden.rename(self.path)
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}; the bag is in {hidden}", file=self.path) from None
        self._tidy()

    def _close(self, outcome: Outcome, reason: str = "") -> None:
        try:
            if self._early is not None:
                self.begin(0)
            self._flush()
            self._writer.set_custom_data("outcome", outcome)
            if reason:
                self._writer.set_custom_data("outcome_reason", reason)
            self._writer.close()
        except OSError as error:
            self._discard(error)
            raise
        self._ended = True

    def _discard(self, error: OSError) -> None:
        """Remove the incomplete bag, and add its path to the error."""
        self._ended = True
        error.filename = error.filename or str(self.path)
        with suppress(OSError):
            self._writer.abort()
        shutil.rmtree(partial_path(self.path), ignore_errors=True)
        self._tidy()

    def _tidy(self) -> None:
        with suppress(OSError):  # other trials may still be in there
            partial_path(self.path).parent.rmdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._ended:
            return
        if isinstance(error, OSError):
            self._discard(error)
        else:
            self._close("ABORTED")
