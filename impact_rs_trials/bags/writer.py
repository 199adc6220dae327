# SPDX-License-Identifier: Apache-2.0
"""Writing a trial: mcap by ``rosbags``, into a hidden folder that gets its name when the trial is complete."""

from __future__ import annotations

import shutil
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.cdr import encode
from impact_rs_trials.bags.trial_info import Outcome, TrialInfo
from impact_rs_trials.bags.types import typestore

LATCHED = (topics.TRIAL_INFO, topics.ROBOT_DESCRIPTION)
FILES = ("scenario_json", "model_yaml")  # with a friction compensation 200 kB, which YAML takes a second for
LARGEST_BLOCK = 100_000  # messages kept in memory; several trials' worth


def _latched() -> Qos:
    """Quality of service of topics that late subscribers need; all others are played back with ROS's default."""
    infinite = QosTime(sec=2147483647, nsec=4294967295)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=infinite,
        lifespan=infinite,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=infinite,
        avoid_ros_namespace_conventions=False,
    )


def partial_path(path: Path) -> Path:
    """Where the bag ``path`` lies while it is being written."""
    return path.parent / ".partial" / path.name


class BagWriter:
    """Writes the bag of one trial; a context manager, which :meth:`create` makes.

    Leaving the context without :meth:`finish` keeps the bag under its hidden name, readable as far as it got, and a
    campaign runs that trial again. Where the disk is full nothing is kept.

    Args:
        path: Folder of the bag when it is complete.
        writer: Open, on the hidden folder.
        connections: Connections of the writer, by topic.
        store: Definitions of their types.
    """

    def __init__(self, path: Path, writer: Writer, connections: dict[str, Connection], store: Typestore) -> None:
        self.path = path
        self.messages = 0
        self._writer = writer
        self._connections = connections
        self._store = store
        self._ended = False
        self._pending: list[tuple[str, int, Any]] = []

    @classmethod
    def create(cls, path: Path, arms: list[str], truth: bool = True) -> BagWriter:
        """Begin a bag with every topic of a trial.

        Args:
            path: Folder of the bag; must not exist yet.
            arms: Names of the arms.
            truth: Whether the bag has topics for the truth.

        Raises:
            InputError: The folder exists already or cannot be made.
        """
        if path.exists():
            raise InputError("this bag exists already", file=path)
        hidden = partial_path(path)
        shutil.rmtree(hidden, ignore_errors=True)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            writer = Writer(hidden, version=9, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            writer.open()
        except OSError as error:
            shutil.rmtree(hidden, ignore_errors=True)
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
        store = typestore()
        connections = {
            topic: writer.add_connection(
                topic, kind, typestore=store, offered_qos_profiles=[_latched()] if topic in LATCHED else []
            )
            for topic, kind in topics.recorded(arms, truth).items()
        }
        return cls(path, writer, connections, store)

    def describe(self, info: TrialInfo) -> None:
        """Put the trial's identity into the bag's metadata; whole files are in ``/trial_info`` alone."""
        for name, value in info.values().items():
            if name not in FILES:
                self._writer.set_custom_data(name, str(value))

    def write(self, topic: str, nanoseconds: int, message: Any) -> None:
        """Write a message of the ``rosbags`` typestore at trial time [ns]; it must not be changed afterwards.

        Messages are kept and serialized together, which is several times faster than one by one.
        """
        self._pending.append((topic, nanoseconds, message))
        self.messages += 1
        if len(self._pending) >= LARGEST_BLOCK:
            self._flush()

    def write_raw(self, topic: str, nanoseconds: int, data: bytes | memoryview) -> None:
        """Write a serialized (CDR) message at trial time [ns]."""
        self._flush()
        self._writer.write(self._connections[topic], nanoseconds, data)
        self.messages += 1

    def _flush(self) -> None:
        """Serialize what is pending, topic by topic, and write it in the order it came."""
        if not self._pending:
            return
        pending, self._pending = self._pending, []
        grouped: dict[str, list[Any]] = defaultdict(list)
        for topic, _, message in pending:
            grouped[topic].append(message)
        encoded = {
            topic: iter(encode(self._store, self._connections[topic].msgtype, messages))
            for topic, messages in grouped.items()
        }
        for topic, nanoseconds, _ in pending:
            self._writer.write(self._connections[topic], nanoseconds, next(encoded[topic]))

    def finish(self, outcome: Outcome, reason: str = "") -> None:
        """Close the bag and give it its name.

        Args:
            outcome: How the trial ended.
            reason: Why, in one line; empty where there is nothing to say.
        """
        self._close(outcome, reason)
        partial_path(self.path).rename(self.path)
        self._tidy()

    def _close(self, outcome: Outcome, reason: str = "") -> None:
        try:
            self._flush()
            self._writer.set_custom_data("outcome", outcome)
            if reason:
                self._writer.set_custom_data("outcome_reason", reason)
            self._writer.set_custom_data(checksums.NAME, checksums.KIND)
            self._writer.close()
            checksums.seal(partial_path(self.path))
        except OSError as error:
            self._discard(error)
            raise
        self._ended = True

    def _discard(self, error: OSError) -> None:
        """Remove the half-written bag, which would only take up space, and let the error say what it was."""
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
